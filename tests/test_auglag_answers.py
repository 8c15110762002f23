"""What an answer says beyond the point: what conflicts, what a limit is worth, its moves.

Every derivative is checked against problems solved again, every least violation against
scipy from many starts.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
import scipy.optimize
from helpers import assert_close
from polishopt.optimize import Status, active, conflict, minimise, solve


stack = jnp.stack


def hs71(theta, **options):
    """HS71 with its limits, a price and a bound as parameters: (25, 40, 1, 1)."""
    product, square, price, least = theta

    def objective(x):
        return x[0] * x[3] * (x[0] + x[1] + x[2]) + price * x[2]

    return minimise(
        objective,
        lambda x: {"product": product - jnp.prod(x)},
        jnp.array([1.0, 5.0, 5.0, 1.0]),
        jnp.array([1.0, 1.0, 1.0, 1.0]) * least,
        jnp.full(4, 5.0),
        equality=lambda x: {"square": jnp.sum(x**2) - square},
        **options,
    )


THETA = np.array([25.0, 40.0, 1.0, 1.0])
again = jax.jit(hs71)


def told(got):
    return got.x, got.objective, got.inequality_multipliers, got.bound_multipliers


def test_relaxing_a_limit_is_worth_its_multiplier():
    got = again(THETA)
    # product may be 1 % less, the sum of squares 1 % more, the bound 1 % lower
    for i, change, worth in (
        (0, -0.25, got.inequality_multipliers["product"]),
        (1, 0.4, got.equality_multipliers["square"]),
        (3, -0.01, -got.bound_multipliers[0]),
    ):
        relaxed = again(THETA + change * np.eye(4)[i])
        assert_close(got.objective - relaxed.objective, abs(change) * worth, rtol=2e-2)
    assert set(active(got)) == {"product", "lower bound of x[0]"}


def test_derivatives_of_the_optimum_are_those_of_solving_again():
    """Forwards, backwards and for several problems at once, under `jit`."""

    @jax.jit
    def both(theta):
        backward = jax.grad(lambda theta: hs71(theta).x @ jnp.arange(4.0))
        return jax.jacfwd(lambda theta: told(hs71(theta)))(theta), backward(theta)

    forward, backward = jax.tree.map(
        lambda leaf: leaf[0], jax.jit(jax.vmap(both))(np.stack([THETA, 1.01 * THETA]))
    )
    step = 1e-4
    for i in range(4):
        up, down = (told(again(THETA + s * step * np.eye(4)[i])) for s in (1, -1))
        want = jax.tree.map(lambda a, b: (a - b) / (2 * step), up, down)
        got = jax.tree.map(lambda leaf, i=i: leaf[..., i], forward)
        jax.tree.map(lambda g, w: assert_close(g, w, rtol=1e-4, atol=1e-4), got, want)
        assert_close(backward[i], want[0] @ np.arange(4.0), rtol=1e-4, atol=1e-4)


def test_the_shortest_move_where_many_points_are_optimal():
    """min 1/2 (x + y - t)^2 in the unit square: x and y share the change of t."""

    def run(t):
        return solve(
            lambda x: x[0] + x[1] - t, None, jnp.full(2, 0.4), jnp.zeros(2), jnp.ones(2)
        ).x

    assert_close(jax.jit(jax.jacfwd(run))(jnp.array(0.9)), [0.5, 0.5], atol=1e-6)


def infeasible(index, x):
    """Five problems without a feasible point, of one shape."""
    first, second = x

    def four(*terms):
        return stack(jnp.broadcast_arrays(*[jnp.asarray(t, float) for t in terms]))

    return jax.lax.switch(
        index,
        [
            # x <= -1 and x >= 1 in other units, beside a limit that holds
            lambda: four(first + 1, 1000 * (1 - first), second - 4, -1),
            # a disc and a half-plane; the third holds
            lambda: four(first**2 + second**2 - 1, 3 - first - second, first - 4, -1),
            # flat where it is least violated
            lambda: four(1 + first**2, second - 3, -1, -1),
            # exp(x) below y, y below -1/2: far to the left, where a limit stands
            lambda: four(jnp.exp(first) - second, second + 0.5, -first - 3, -1),
            # the box is in the way, and a curved limit
            lambda: four(25 - first**2 - second**2, first - second - 11, -1, -1),
        ],
    )


NAMES = ("wear", "force", "time", "heat")
BOX = [
    ((-10, -10), (10, 10)),
    ((-5, -5), (5, 5)),
    ((-10, -10), (10, 10)),
    ((-5, -5), (5, 5)),
    ((0, 0), (2, 2)),
]
IN_CONFLICT = [
    {"wear", "force"},
    {"wear", "force"},
    {"wear"},
    {"wear", "force", "time"},
    {"wear", "upper bound of x[0]", "upper bound of x[1]"},
]


@jax.jit
def run_infeasible(index, lower, upper):
    def limits(x):
        return dict(zip(NAMES, infeasible(index, x), strict=True))

    return minimise(
        lambda x: x[0] + x[0] * x[1], limits, jnp.array([0.3, 1.1]), lower, upper
    )


@jax.jit
def amount(index, x):
    def half(x):
        return 0.5 * jnp.sum(jnp.maximum(infeasible(index, x), 0.0) ** 2)

    return jax.value_and_grad(half)(x)


@pytest.mark.parametrize("index", range(5))
def test_infeasible_problems_end_at_the_least_violation(index):
    lower, upper = (np.array(b, dtype=float) for b in BOX[index])
    got = run_infeasible(index, lower, upper)
    assert got.status == Status.INFEASIBLE

    def half(x):
        value, slope = amount(index, x)
        return float(value), np.asarray(slope)

    least = min(
        scipy.optimize.minimize(
            half, start, jac=True, bounds=list(zip(lower, upper, strict=True)), tol=1e-14
        ).fun
        for start in np.random.default_rng(0).uniform(lower, upper, (8, 2))
    )
    violation = np.maximum(np.stack([*got.inequality.values()]), 0.0)
    assert_close(np.linalg.norm(violation), (2 * least) ** 0.5, rtol=1e-4)
    assert_close(got.infeasibility, np.linalg.norm(violation))
    assert set(conflict(got)) == IN_CONFLICT[index]


def test_the_least_violation_counts_in_the_units_it_is_given():
    """x <= 0 and x >= 1, the second in units of a tenth: 100 times the weight."""

    def limits(x):
        return {"a": x[0], "b": 1 - x[0]}

    got = jax.jit(
        lambda s: minimise(
            lambda x: jnp.sum(x), limits, s, s - 9, s + 9, unit=({"a": 1.0, "b": 0.1}, None)
        )
    )(jnp.array([4.0]))
    assert_close(got.x, 100 / 101, atol=1e-8)
    assert list(conflict(got)) == ["a", "b"]
    assert_close(got.inequality_multipliers["b"], 100 / 101, rtol=1e-6)


def recorded(f, record):
    def watched(x):
        jax.debug.callback(lambda x: record.append(np.asarray(x)), x)
        return f(x)

    return watched


@pytest.mark.parametrize(
    "solver", [optx.BFGS(1e-8, 1e-8), optx.LevenbergMarquardt(1e-8, 1e-8)]
)
def test_other_solvers_of_optimistix_stay_in_the_box_too(solver):
    """HS71 as a minimum, and as a least-squares problem of one residual."""
    record: list[np.ndarray] = []

    def objective(x):
        return x[0] * x[3] * (x[0] + x[1] + x[2]) + x[2]

    squares = isinstance(solver, optx.AbstractLeastSquaresSolver)
    what = (lambda x: jnp.sqrt(2 * objective(x))[None]) if squares else objective
    got = eqx.filter_jit(
        lambda start: (solve if squares else minimise)(
            recorded(what, record),
            lambda x: 25 - jnp.prod(x),
            start,
            jnp.full(4, 1.0),
            jnp.full(4, 5.0),
            equality=lambda x: jnp.sum(x**2) - 40,
            solver=solver,
            max_inner=200,
        )
    )(jnp.array([1.0, 5.0, 5.0, 1.0]))
    jax.effects_barrier()
    assert got.status == Status.SOLVED
    assert_close(got.objective, 17.0140173, rtol=1e-7)
    assert_close(got.bound_multipliers[0], -1.08787121, rtol=1e-5)
    seen = np.stack(record)
    assert len(seen) > 20
    assert (seen >= 1).all()
    assert (seen <= 5).all()


def test_a_solver_for_squares_is_refused_for_an_objective():
    with pytest.raises(
        ValueError, match=r"`solver` is GaussNewton, .* must be a minimiser"
    ):
        minimise(
            lambda x: jnp.sum(x),
            None,
            jnp.zeros(2),
            -jnp.ones(2),
            jnp.ones(2),
            solver=optx.GaussNewton(1e-8, 1e-8),
        )
