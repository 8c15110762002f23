"""Constrained least squares: published optima, closed forms, and what must never happen.

The problems HS* are those of Hock & Schittkowski (1981), Test examples for nonlinear
programming codes. An objective that is a sum of squares there is entered as such, another
one as the square root of twice itself, after a constant that makes it positive.
"""

import functools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
import scipy.optimize
from helpers import assert_close
from polishopt.optimize import BoxLevenbergMarquardt, Status, sentence, solve
from polishopt.parts import Process


INF = float("inf")
R2 = 2**0.5
stack = jnp.stack


def squares(*terms):
    """Residuals whose half sum of squares is the sum of squares of the terms."""
    return R2 * stack(terms)


def whole(objective):
    """One residual whose half square is the objective."""
    return jnp.sqrt(2.0 * objective)[None]


class Case(eqx.Module):
    residual: Callable
    inequality: Callable | None
    equality: Callable | None
    start: list
    lower: object
    upper: object
    objective: float
    x: object = None  # None where the book has several optima
    most: int = 45  # evaluations: about twice what they take, to notice a slow-down

    def solve(self, start=None, **options):
        """Solved from its own start, or another, under `jit`."""
        start = jnp.array(self.start) if start is None else start
        lower, upper = (
            jnp.broadcast_to(jnp.array(b, start.dtype), start.shape)
            for b in (self.lower, self.upper)
        )
        options["equality"] = self.equality
        return answer(self.residual, self.inequality, start, lower, upper, **options)


def answer(residual, inequality, start, lower, upper, **options):
    def run(start):
        return solve(residual, inequality, start, lower, upper, **options)

    return jax.jit(run)(start)


@functools.cache
def solved(name):
    return CASES[name].solve()


def hs43(x):
    a, b, c, d = x
    return a**2 + b**2 + 2 * c**2 + d**2 - 5 * a - 5 * b - 21 * c + 7 * d


def hs43_limits(x):
    a, b, c, d = x
    return stack(
        [
            a**2 + b**2 + c**2 + d**2 + a - b + c - d - 8,
            a**2 + 2 * b**2 + c**2 + 2 * d**2 - a - d - 10,
            2 * a**2 + b**2 + c**2 + 2 * a - b - d - 5,
        ]
    )


def hs35(x):
    a, b, c = x
    square = 2 * a**2 + 2 * b**2 + c**2 + 2 * a * b + 2 * a * c
    return 9 - 8 * a - 6 * b - 4 * c + square


CASES = {
    "HS21": Case(
        lambda x: squares(0.1 * x[0], x[1]),
        lambda x: (10 - 10 * x[0] + x[1])[None],
        None, [2.0, -1.0], [2.0, -50.0], 50.0, 0.04, [2.0, 0.0],
    ),
    "HS26": Case(
        lambda x: squares(x[0] - x[1], (x[1] - x[2]) ** 2),
        None, lambda x: ((1 + x[1] ** 2) * x[0] + x[2] ** 4 - 3)[None],
        [-2.6, 2.0, 2.0], -INF, INF, 0.0, None, 60,
    ),
    "HS27": Case(
        lambda x: squares(0.1 * (x[0] - 1), x[1] - x[0] ** 2),
        None, lambda x: (x[0] + x[2] ** 2 + 1)[None],
        [2.0, 2.0, 2.0], -INF, INF, 0.04, None,
    ),
    "HS35": Case(
        lambda x: whole(hs35(x) + 1),
        lambda x: (x[0] + x[1] + 2 * x[2] - 3)[None],
        None, [0.5, 0.5, 0.5], 0.0, INF, 1 + 1 / 9, [4 / 3, 7 / 9, 4 / 9],
    ),
    "HS42": Case(
        lambda x: squares(x[0] - 1, x[1] - 2, x[2] - 3, x[3] - 4),
        None, lambda x: stack([x[0] - 2, x[2] ** 2 + x[3] ** 2 - 2]),
        [1.0] * 4, -INF, INF, 28 - 10 * R2, [2.0, 2.0, 0.6 * R2, 0.8 * R2],
    ),
    "HS43": Case(
        lambda x: whole(hs43(x) + 200), hs43_limits,
        None, [0.0] * 4, -INF, INF, 156.0, [0.0, 1.0, 2.0, -1.0], 60,
    ),
    "HS65": Case(
        lambda x: squares(x[0] - x[1], (x[0] + x[1] - 10) / 3, x[2] - 5),
        lambda x: (jnp.sum(x**2) - 48)[None],
        None, [-5.0, 5.0, 0.0], [-4.5, -4.5, -5.0], [4.5, 4.5, 5.0], 0.9535288567,
        [3.650461821, 3.65046169, 4.6204170507],
    ),
    "HS71": Case(
        lambda x: whole(x[0] * x[3] * (x[0] + x[1] + x[2]) + x[2]),
        lambda x: (25 - jnp.prod(x))[None],
        lambda x: (jnp.sum(x**2) - 40)[None],
        [1.0, 5.0, 5.0, 1.0], 1.0, 5.0, 17.0140173,
        [1.0, 4.742999, 3.821150, 1.379408],
    ),
    "bounded Rosenbrock": Case(
        lambda x: stack([10 * (x[1] - x[0] ** 2), 1 - x[0]]),
        None, None, [-1.2, 1.0], [-2.0, -2.0], [0.5, 2.0], 0.125, [0.5, 0.25],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_published_optima(name):
    case = CASES[name]
    got = solved(name)
    assert got.status == Status.SOLVED, sentence(got.status)
    assert_close(got.objective, case.objective, rtol=1e-6, atol=1e-9)
    assert got.violation < 1e-8
    assert got.kkt < 1e-6
    assert got.evaluations <= case.most
    if case.x is not None:
        # the book prints 7 digits; a flat valley spreads them to 1e-6
        assert_close(got.x, case.x, rtol=2e-6, atol=2e-6)


def test_multipliers_have_the_user_s_units_and_signs():
    # HS43 has the multipliers (1, 0, 2); HS71's are Ipopt's, in its tutorial
    got = solved("HS43")
    assert_close(got.inequality_multipliers, [1.0, 0.0, 2.0], atol=1e-6)
    assert got.active.tolist() == [True, False, True]
    got = solved("HS71")
    assert_close(got.inequality_multipliers, [0.55229366], rtol=1e-5)
    assert_close(got.equality_multipliers, [0.16146857], rtol=1e-5)
    assert_close(got.bound_multipliers, [-1.08787121, 0.0, 0.0, 0.0], rtol=1e-5)
    # min 1/2 (x - 3)^2 + 1/2 (y + 1)^2 on [0, 1]^2: the gradient at (1, 0) is (-2, 1)
    got = answer(
        lambda x: x - jnp.array([3.0, -1.0]),
        None,
        jnp.full(2, 0.5),
        jnp.zeros(2),
        jnp.ones(2),
    )
    assert_close(got.x, [1.0, 0.0])
    assert_close(got.bound_multipliers, [2.0, -1.0])


def test_the_unit_of_a_constraint_does_not_matter():
    case, factor = CASES["HS43"], 1e3
    scaled = eqx.tree_at(lambda c: c.inequality, case, lambda x: factor * hs43_limits(x))
    want, got = solved("HS43"), scaled.solve()
    assert_close(got.x, want.x, atol=1e-7)
    # 1e-7 of the largest: the inactive limit's multiplier is zero in both
    assert_close(
        factor * got.inequality_multipliers, want.inequality_multipliers, atol=1e-6
    )
    # only the last digits of a violation are a matter of its unit
    assert abs(int(got.evaluations) - int(want.evaluations)) <= 3


def test_infeasible_interval():
    """Limits x >= 1 and x <= 0 of equal slope: the middle violates both by a half."""
    got = answer(
        lambda x: x - 5.0,
        lambda x: stack([1 - x[0], x[0]]),
        jnp.array([3.0]),
        jnp.array([-10.0]),
        jnp.array([10.0]),
    )
    assert got.status == Status.INFEASIBLE
    assert_close(got.x, 0.5, atol=1e-8)
    assert_close(got.violation, 0.5, atol=1e-8)
    assert (got.inequality_multipliers > 0).all()
    assert "No feasible point" in sentence(got.status)


def test_infeasible_disc_and_half_plane():
    """Where (2 a^2 - 1)^2 + (3 - 2 a)^2 is least, 16 a^3 = 12; equal slopes at the start.

    A third limit holds with room to spare: it is no part of the conflict.
    """
    got = answer(
        lambda x: x - jnp.array([2.0, 0.0]),
        lambda x: stack([jnp.sum(x**2) - 1, 3 - jnp.sum(x), x[0] - 4]),
        jnp.array([0.5, 0.5]),
        jnp.full(2, -5.0),
        jnp.full(2, 5.0),
    )
    assert got.status == Status.INFEASIBLE
    assert_close(got.x, 0.75 ** (1 / 3), atol=1e-7)
    assert (got.inequality_multipliers > 0).tolist() == [True, True, False]
    assert got.kkt < 1e-7


def test_infeasible_in_a_box():
    """A circle of radius 5 about the origin misses [0, 2]^2: the corner is nearest."""
    got = answer(
        lambda x: x,
        None,
        jnp.array([0.3, 0.2]),
        jnp.zeros(2),
        jnp.full(2, 2.0),
        equality=lambda x: jnp.sum(x**2) - 25,
    )
    assert got.status == Status.INFEASIBLE
    assert_close(got.x, 2.0)
    assert_close(got.violation, 17.0)


@pytest.mark.parametrize("name", ["HS71", "bounded Rosenbrock"])
def test_no_evaluation_leaves_the_box(name):
    case = CASES[name]
    record: list[np.ndarray] = []

    def recorded(x):
        jax.debug.callback(lambda x: record.append(np.asarray(x)), x)
        return case.residual(x)

    watched = eqx.tree_at(lambda c: c.residual, case, recorded)
    got = watched.solve()
    jax.effects_barrier()
    seen = np.stack(record)
    assert len(seen) >= int(got.evaluations) >= 5
    # exactly: not by one unit in the last place
    assert (seen >= np.asarray(case.lower)).all()
    assert (seen <= np.asarray(case.upper)).all()


def test_many_starts_under_vmap_equal_one_by_one():
    case = CASES["HS65"]
    starts = jax.random.uniform(jax.random.key(0), (16, 3), minval=-4.5, maxval=4.5)
    lower, upper = jnp.array(case.lower), jnp.array(case.upper)

    def run(start):
        return solve(case.residual, case.inequality, start, lower, upper)

    together, alone = jax.jit(jax.vmap(run))(starts), jax.lax.map(run, starts)
    assert (together.status == Status.SOLVED).all()
    # batched and single linear algebra round differently, the optimum is the same
    assert_close(together.x, alone.x, atol=1e-6)
    assert_close(together.objective, case.objective, rtol=1e-7)
    # and nobody pays for the others
    assert (jnp.abs(together.evaluations - alone.evaluations) <= 3).all()


def test_not_a_number_stays_where_it_is():
    """A start outside the domain is named; a step outside it is only refused."""

    def residual(x):
        return stack([jnp.log(x[0]) + 3, x[1] - 1])

    def run(start):
        return solve(residual, None, start, jnp.array([-2.0, 0.0]), jnp.array([2.0, 2.0]))

    starts = jnp.array([[1.9, 0.3], [-1.0, 0.3], [0.5, 1.0]])
    got = jax.jit(jax.vmap(run))(starts)
    assert got.status.tolist() == [Status.SOLVED, Status.NOT_A_NUMBER, Status.SOLVED]
    assert_close(got.x[jnp.array([0, 2])], [[np.exp(-3), 1.0]] * 2, atol=1e-7)
    assert_close(got.x[1], starts[1])  # it stays where it was
    assert got.evaluations[1] == 1


def test_optimum_behind_the_edge_of_the_domain_is_not_a_number():
    got = answer(
        lambda x: x + 1 + 0 * jnp.sqrt(x), None, jnp.array([1.9]), -jnp.ones(1), jnp.ones(1)
    )
    assert got.status == Status.NOT_A_NUMBER
    assert jnp.isfinite(got.x).all()


def test_fixed_variables_stay_and_say_what_they_cost():
    """min 1/2 [(x - 3)^2 + (y - 1)^2 + (x y)^2], x = 1, y <= 0.2, by hand."""
    got = answer(
        lambda x: stack([x[0] - 3, x[1] - 1, x[0] * x[1]]),
        lambda x: x[1] - 0.2,
        jnp.array([1.0, 0.1]),
        jnp.array([1.0, 0.0]),
        jnp.array([1.0, 2.0]),
    )
    assert got.status == Status.SOLVED
    assert_close(got.x, [1.0, 0.2], atol=1e-9)
    assert_close(got.inequality_multipliers, 0.6, atol=1e-7)
    assert_close(got.bound_multipliers, [2 - 0.2**2, 0.0], atol=1e-7)
    got = answer(lambda x: x - 3, None, jnp.ones(2), jnp.ones(2), jnp.ones(2))
    assert got.status == Status.SOLVED
    assert_close(got.x, 1.0)


def test_a_process_goes_in_and_comes_out():
    def process(*values):
        return Process(*values)

    def residual(p, gain):
        return {"a": p.tilt * gain - 0.2, "b": stack([p.step - 1.0, p.feed / 10 - 2])}

    def limits(p, gain):
        del gain
        return {"force": 40 * p.displacement - 10, "time": 10 / p.feed - 1}

    got = answer(
        residual,
        limits,
        process(0.1, 0.4, 2.0, 3.0, 20.0, 200.0),
        process(0.0, 0.1, 0.5, 1.0, 5.0, 200.0),
        process(0.2, 1.0, 4.0, 5.0, 15.0, 200.0, 1.0),
        args=jnp.array(2.0),
    )
    assert got.status == Status.SOLVED
    assert isinstance(got.x, Process)
    assert_close(got.x.tilt, 0.1, atol=1e-8)
    assert_close(got.x.step, 1.0, atol=1e-8)
    assert_close(got.x.feed, 15.0)
    assert got.inequality["force"] <= 1e-8
    assert_close(got.bound_multipliers.feed, 0.05, atol=1e-8)
    assert got.active["time"].shape == ()
    assert got.equality is None


@pytest.mark.parametrize("name", ["HS35", "HS71"])
def test_single_precision(name):
    case = CASES[name]
    start = jnp.array(case.start, dtype=jnp.float32)
    got = case.solve(start)
    assert got.x.dtype == jnp.float32
    assert got.status == Status.SOLVED
    # the default tolerance is 2e-4 there
    assert_close(got.objective, case.objective, rtol=1e-3)


def test_the_limit_on_work_is_named():
    got = CASES["HS71"].solve(max_outer=1)
    assert got.status == Status.WORK_LIMIT
    assert got.outer_steps == 1
    assert jnp.isfinite(got.x).all()


def oracle(f, sign=1.0) -> dict[str, Any]:
    """A function of JAX and its Jacobian, as scipy wants them."""
    return {
        "fun": lambda x: sign * np.asarray(f(jnp.asarray(x))),
        "jac": lambda x: sign * np.asarray(jax.jacfwd(f)(jnp.asarray(x))),
    }


# two quantities of four unknowns, as in tuning: many answers, so time decides
def finish(x):
    tilt, displacement, step, radius = x
    skewness = jnp.tanh(tilt * displacement) - 0.3 * step - 0.2
    kurtosis = jnp.log(1 + displacement * radius) - 0.5 * tilt - 0.1
    return stack([skewness, kurtosis])


def time(x):
    return 1 / (x[2] * x[3] + 0.1) + 0.2 * x[0]


def limits(x):
    return stack([x[0] * x[1] - 0.6, x[2] + x[3] - 1.5])


def test_ties_are_broken_by_a_second_stage():
    start, lower, upper = jnp.full(4, 0.5), jnp.full(4, 0.05), jnp.full(4, 2.0)
    first = answer(finish, limits, start, lower, upper)
    assert first.status == Status.SOLVED
    assert_close(first.residual, 0.0, atol=1e-8)
    assert first.evaluations <= 10

    def relative(x):
        return time(x) / time(first.x)

    second = jax.jit(lambda s: solve(relative, limits, s, lower, upper, equality=finish))(
        first.x
    )
    assert second.status == Status.SOLVED
    assert second.objective < 0.5
    assert second.evaluations <= 30

    want = scipy.optimize.minimize(
        x0=np.asarray(first.x),
        **oracle(lambda x: 0.5 * relative(x) ** 2),
        bounds=[(0.05, 2.0)] * 4,
        constraints=[
            {"type": "eq", **oracle(finish)},
            {"type": "ineq", **oracle(limits, -1.0)},
        ],
        method="SLSQP",
        options={"ftol": 1e-14},
    )
    assert_close(second.x, want.x, atol=1e-6)
    assert_close(second.objective, want.fun, rtol=1e-7)
    # the limit that holds costs what its multiplier says
    relaxed = answer(
        relative, lambda x: limits(x) - 1e-3, first.x, lower, upper, equality=finish
    )
    gain = second.objective - relaxed.objective
    assert_close(gain, 1e-3 * jnp.sum(second.inequality_multipliers), rtol=1e-2)


def test_the_solver_works_inside_optimistix():
    """Alone: bounds, a pytree of unknowns, and the same answer as scipy."""

    def powell(x, _):
        a, b, c, d = x["a"], x["b"], x["c"], x["d"]
        return a + 10 * b, 5**0.5 * (c - d), (b - 2 * c) ** 2, 10**0.5 * (a - d) ** 2

    start = {"a": 1.0, "b": 0.9, "c": 0.8, "d": 1.0}
    start = jax.tree.map(jnp.asarray, start)
    lower = {"a": 0.3, "b": -4.0, "c": -4.0, "d": -4.0}
    got = optx.least_squares(
        powell,
        BoxLevenbergMarquardt(rtol=1e-9, atol=1e-10),
        start,
        options={
            "lower": jax.tree.map(jnp.asarray, lower),
            "upper": jax.tree.map(lambda s: 4 * jnp.ones_like(s), start),
        },
        max_steps=50,
        throw=False,
    )
    assert got.result == optx.RESULTS.successful

    def flat(x):
        return stack(powell(dict(zip("abcd", x, strict=True)), None))

    want = scipy.optimize.least_squares(
        **oracle(flat),
        x0=np.array([1.0, 0.9, 0.8, 1.0]),
        bounds=([0.3, -4.0, -4.0, -4.0], [4.0] * 4),
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-12,
    )
    assert_close(jnp.stack([got.value[k] for k in "abcd"]), want.x, atol=1e-6)
    assert got.value["a"] == 0.3  # the bound itself
    assert got.stats["num_steps"] <= 25
