"""Walk and batches: the same search, run from outside; and what a search learns."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close
from hock_schittkowski import PROBLEMS
from polishopt.optimize import solve
from polishopt.optimize.batches import in_batches, looked_at, walked
from polishopt.optimize.model import Merit, Model, learned, least_of_model
from polishopt.optimize.penalty import Duals
from polishopt.optimize.values import Values
from polishopt.optimize.walk import Rules, problem_of


LOWER, UPPER = {"a": -2.0, "b": -2.0}, {"a": 2.0, "b": 2.0}


def bent(x) -> Values:
    """Rosenbrock's valley, cut by a disc and a line; NaN in a corner."""
    a, b = x["a"], x["b"]
    lost = jnp.where((a < -1.9) & (b > 1.9), jnp.nan, 1.0)
    return Values(
        residual=(10 * (b - a**2) * lost, 1 - a),
        inequality={"disc": a**2 + b**2 - 1.2},
        equality={"line": a + 0.5 * b - 1.0},
    )


def places(count, seed=0):
    cloud = np.random.default_rng(seed).uniform(-2, 2, (2, count))
    return {"a": jnp.asarray(cloud[0]), "b": jnp.asarray(cloud[1])}


def everywhere(side, count):
    return {name: jnp.full(count, bound) for name, bound in side.items()}


look = jax.jit(lambda x, skipped: looked_at(bent, x, skipped))


def test_a_search_run_from_outside_ends_where_a_compiled_one_does():
    """Both are the same turns; only what is compiled together differs."""
    starts, rules = places(8), Rules(1e-8, 20, 40)
    low, high = everywhere(LOWER, 8), everywhere(UPPER, 8)
    out = walked(look, starts, low, high, rules)

    @jax.jit
    @jax.vmap
    def inside(x):
        return solve(bent, None, x, LOWER, UPPER, tolerance=1e-8)

    want = inside(starts)
    assert (np.asarray(out.status) == np.asarray(want.status)).all()
    assert (np.asarray(out.status) == 0).all()
    for name in LOWER:
        assert_close(out.x[name], want.x[name], rtol=0, atol=1e-7)
    assert_close(out.objective, want.objective, rtol=1e-6, atol=1e-9)
    assert_close(
        out.inequality_multipliers["disc"],
        want.inequality_multipliers["disc"],
        rtol=1e-5,
        atol=1e-6,
    )


def test_a_search_that_is_over_is_left_alone():
    """Alone or beside slower ones, it ends at the same numbers after as many points."""
    starts, rules = places(4, seed=1), Rules(1e-8, 20, 40)
    low, high = everywhere(LOWER, 4), everywhere(UPPER, 4)
    together = walked(look, starts, low, high, rules)
    spent = np.asarray(together.evaluations)
    assert spent.min() < spent.max()
    for i in range(4):
        one = {name: jnp.full(4, x[i]) for name, x in starts.items()}
        alone = walked(look, one, low, high, rules)
        assert int(alone.evaluations[0]) == spent[i]
        for name in LOWER:
            assert_close(alone.x[name][0], together.x[name][i], rtol=0, atol=1e-12)


def test_what_is_skipped_is_not_looked_at():
    seen = []

    def told(x):
        jax.debug.callback(lambda a: seen.append(float(a)), x["a"])
        return bent(x)

    x = {"a": jnp.arange(4.0), "b": jnp.zeros(4)}
    parts, columns = looked_at(told, x, jnp.array([False, True, False, True]))
    jax.effects_barrier()
    assert sorted(set(seen)) == [0.0, 2.0]
    assert not np.any(columns[1])
    assert_close(parts[0][1][2], -1.0)


def test_a_search_that_meets_nan_does_not_stop_the_others():
    starts = {"a": jnp.array([-1.95, 0.5]), "b": jnp.array([1.95, 0.5])}
    out = walked(
        look, starts, everywhere(LOWER, 2), everywhere(UPPER, 2), Rules(1e-8, 20, 40)
    )
    assert out.status.tolist() == [3, 0]


def test_no_batch_begins_after_one_has_failed():
    begun = []

    def search(places, vacant):
        begun.append(places)
        raise RuntimeError("lost")

    with pytest.raises(RuntimeError, match="lost"):
        in_batches(search, {"a": np.arange(32.0)}, 2)
    assert len(begun) <= 2


@pytest.mark.parametrize(
    ("count", "size", "batches"),
    [(1, 3, [1]), (2, 8, [1, 1]), (8, 8, [4, 4]), (7, 3, [3, 2, 2]), (6, 1, [1] * 6)],
)
def test_room_that_is_left_in_a_batch_is_vacant(count, size, batches):
    """The last ones may have less to do, and there are two for two threads."""
    met = {}
    one = everywhere(LOWER, 1)
    found = walked(look, one, one, everywhere(UPPER, 1), Rules(1e-8, 1, 1))

    def search(places, extra, vacant):
        assert places["a"].shape == extra.shape == vacant.shape == (size,)
        assert not np.any(np.diff(vacant.astype(int)) < 0)
        met[int(places["a"][0])] = int(np.sum(~vacant))
        x = {"a": places["a"], "twice": 2 * extra}
        return eqx.tree_at(lambda solution: solution.x, found, x)

    a = np.arange(float(count))
    out = in_batches(search, {"a": a}, size, None, a)
    assert [met[i] for i in sorted(met)] == batches
    assert_close(out.x["a"], a)
    assert_close(out.x["twice"], 2 * a)


def test_a_vacant_place_costs_nothing_and_changes_nothing():
    looked = []

    def told(x, skipped):
        looked.append(np.asarray(skipped))
        return look(x, skipped)

    starts, rules = places(4, seed=1), Rules(1e-8, 20, 40)
    low, high = everywhere(LOWER, 4), everywhere(UPPER, 4)
    vacant = np.array([False, False, True, True])
    some = walked(told, starts, low, high, rules, vacant)
    assert all(skipped[2:].all() for skipped in looked)
    full = walked(look, starts, low, high, rules)
    for name in LOWER:
        np.testing.assert_array_equal(some.x[name][:2], full.x[name][:2])


@pytest.mark.parametrize("seed", range(5))
def test_the_curvature_of_a_quadratic_is_known_after_as_many_steps_as_unknowns(seed):
    """Of each value by itself, whatever the steps are, if they are independent."""
    key = jax.random.split(jax.random.key(seed), 2)
    n, m = 5, 7
    half = jax.random.normal(key[0], (m, n, n))
    true = half + jnp.swapaxes(half, 1, 2)
    known = jnp.zeros_like(true)
    for step in jax.random.normal(key[1], (n, n)):
        known = learned(known, step, true @ step)
    # where no denominator had to be held up, which is most of the seven
    right = jnp.max(jnp.abs(known - true), axis=(1, 2)) < 1e-8
    assert int(jnp.sum(right)) >= m // 2


def test_curvature_keeps_to_the_unknowns_that_a_value_depends_on():
    key = jax.random.key(0)
    true = jnp.zeros((1, 6, 6)).at[0, :2, :2].set(jnp.array([[2.0, 1.0], [1.0, -3.0]]))
    known = jnp.zeros_like(true)
    for step in jax.random.normal(key, (8, 6)):
        known = learned(known, step, true @ step)
        assert not np.any(known[0, 2:])
        assert not np.any(known[0, :, 2:])
    assert_close(known, true, atol=1e-8)


def test_an_update_of_curvature_is_never_much_larger_than_what_it_explains():
    """A step all but across the surprise would ask for one without bound."""
    step, change = jnp.array([1.0, 0.0]), jnp.array([[1e-9, 1.0]])
    known = learned(jnp.zeros((1, 2, 2)), step, change)
    assert float(jnp.max(jnp.abs(known))) <= 10.0 + 1e-9
    still = learned(known, step, known @ step)
    assert_close(still, known)
    assert_close(learned(known, 0 * step, 0 * change), known)


@pytest.mark.parametrize("restoring", [False, True])
def test_the_merit_is_the_augmented_lagrangian(restoring):
    """By hand: a residual, an objective, two inequalities, one of them idle, and h = 0."""
    values = jnp.array([0.3, 2.0, 0.5, -4.0, -0.7])
    scale, multiplier, penalty = np.array(
        [[2.0, 0.5, 4.0], [0.6, 0.2, -1.5], [9.0, 16.0, 25.0]]
    )
    x = {"a": jnp.array(1.0)}
    parts = (jnp.zeros(1), jnp.zeros(1), jnp.zeros(2), jnp.zeros(1))
    problem = problem_of(parts, x, {"a": jnp.array(0.0)}, {"a": jnp.array(2.0)})
    one, no = jnp.array(1.0), jnp.array(False)
    duals = Duals(
        scale=jnp.asarray(scale),
        multiplier=jnp.asarray(multiplier),
        penalty=jnp.asarray(penalty),
        most=one,
        leeway=one,
        restoring=no | restoring,
        measuring=no,
    )
    merit = problem.merit(duals)

    c = np.asarray(values)[2:] / scale
    rows = c if restoring else np.sqrt(penalty) * c + multiplier / np.sqrt(penalty)
    rows = np.where([True, True, False], np.maximum(rows, 0.0), rows)
    want = 0.5 * np.sum(rows**2) + (0.0 if restoring else 0.5 * 0.3**2 + 2.0)
    assert_close(merit(values), want, rtol=1e-14)
    assert_close(merit.pull(values), jax.grad(merit)(values), rtol=1e-14)


def test_the_model_follows_a_curved_constraint():
    """Onto a circle in one step, which a linear model would overshoot by half the bend."""
    values = jnp.array([1.0, -0.5])  # a weak pull along x, and the circle's equation
    model = Model(
        values,
        jnp.array([[1e-3, 0.0], [1.0, 0.0]]),
        jnp.array([jnp.zeros((2, 2)), 2.0 * jnp.eye(2)]),
    )
    none = jnp.zeros(2)
    merit = Merit(jnp.array([1.0, 1e4]), none, none > 0, none)
    low, high = jnp.full(2, -1.0), jnp.full(2, 1.0)
    step, change = least_of_model(merit, model, low, high)
    assert abs(float(model(step)[1])) < 1e-9
    assert_close(change, merit(model(step)) - merit(values), rtol=1e-9)
    assert_close(model.slopes(step), jax.jacfwd(model)(step), rtol=1e-12)


@pytest.mark.parametrize("name", ["HS71", "HS43", "HS100", "HS113"])
def test_few_points_suffice(name):
    """Curved constraints are followed: no more than a handful of points an unknown."""
    from test_hock_schittkowski import answer

    assert int(answer(name).evaluations) <= 6 * len(PROBLEMS[name].start)
