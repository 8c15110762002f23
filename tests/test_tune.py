"""Tuning: the target is met, limits hold, and what cannot be met is named."""

import dataclasses
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close
from polishopt import Goal, Limits, Outcome, Process, Setup, Start, tune
from polishopt.files.assemble import job
from polishopt.files.config import load
from polishopt.optimize.basins import basins
from polishopt.optimize.certificate import Status
from polishopt.optimize.starts import spread_starts
from polishopt.optimize.tune import AIM, HIT, Verdict, excesses, misses
from polishopt.texture.scratches import Population
from scipy.optimize import minimize


CONFIGS = Path(__file__).parent.parent / "configs"
SETUP = job(load(CONFIGS / "pessoles2009_plane.yaml").config).setup


def toy(process: Process, setup: Setup) -> Outcome:
    """A smooth stand-in for the chain, with the same kind of family of answers."""
    del setup
    e, p = process.displacement, process.step
    radius, tilt = process.trochoid_radius, process.tilt
    hard = e**2 / tilt
    given = {
        "Ssk": -jnp.tanh(hard) - 0.1 * p,
        "Sku": 3 + hard**2 + 0.3 * radius / 6,
        "time": 1000 / p * radius / 6 + 50 * tilt,
        "force_max": 5 * hard,
        "mean_removal": hard / p,
        "spread": 0.1 * p,
        "unstick_margin": 4 - 5 * hard + 10 * tilt,
        "body_clearance": 0.6 + 4 * tilt - e,
        "removal": jnp.zeros((1, 1)),
        "load": jnp.zeros((1, 1)),
        "waves": Population(),
        "parts": (),
        "left": Start(),
        "maps": None,
    }
    rest = {field.name: jnp.zeros(()) for field in dataclasses.fields(Outcome)}
    fields: dict[str, Any] = rest | given
    return Outcome(**fields)


START = Process(0.1, 0.3, 1.0, 6.0, 16.7, 209.0)
START_AT = {"tilt": 0.1, "displacement": 0.3, "step": 1.0, "trochoid_radius": 6.0}
BETWEEN = {
    "tilt": (0.05, 0.26),
    "displacement": (0.1, 1.2),
    "step": (0.5, 3.0),
    "trochoid_radius": (2.0, 8.0),
}


@pytest.fixture(scope="module")
def solved():
    target = {"Ssk": Goal(-0.75, 0.05), "Sku": Goal(3.6, 0.1)}
    limits = Limits(time=jnp.asarray(1200.0))
    return target, limits, tune(SETUP, START, BETWEEN, target, limits, chain=toy)


def test_target_is_met_and_limits_hold(solved):
    _, _, answer = solved
    assert int(answer.verdict) == Verdict.SOLVED
    # to 1 % of their tolerances
    assert_close(answer.outcome.Ssk, -0.75, atol=5e-4)
    assert_close(answer.outcome.Sku, 3.6, atol=1e-3)
    assert all(float(excess) <= 1e-6 for excess in answer.excesses.values())
    for name, (low, high) in BETWEEN.items():
        assert low <= float(getattr(answer.process, name)) <= high
    assert float(answer.kkt) <= 1e-4


def test_distinct_answers_are_told_apart_and_counted(solved):
    _, _, answer = solved
    found = basins(answer, BETWEEN)
    assert_close(found[0].cost, float(answer.outcome.time))
    assert int(answer.best) in found[0].starts
    costs = [basin.cost for basin in found]
    assert costs == sorted(costs)
    counted = [start for basin in found for start in basin.starts]
    ended = np.asarray(answer.statuses) == Status.SOLVED
    ended[int(answer.best)] = True
    ended &= np.asarray(answer.followed)
    assert sorted(counted) == list(np.flatnonzero(ended))
    for name, value in found[0].answer.items():
        low, high = BETWEEN[name]
        assert_close(value, getattr(answer.process, name), rtol=0, atol=1e-3 * (high - low))


def test_answers_a_little_apart_are_one(solved):
    _, _, answer = solved
    nudged = 1e-4 * jnp.arange(16.0).reshape(2, 8).T.reshape(-1) / 16
    moved = {name: jnp.full(16, START_AT[name]) + nudged for name in BETWEEN}
    step = moved["step"].at[::2].add(0.5)
    same = eqx.tree_at(
        lambda t: (t.answers, t.statuses, t.followed),
        answer,
        (moved | {"step": step}, jnp.zeros(16, int), jnp.ones(16, bool)),
    )
    found = basins(same, BETWEEN)
    assert sorted(len(basin.starts) for basin in found) == [8, 8]


def test_a_goal_multiplier_is_what_moving_that_goal_costs(solved):
    """Each under its own name, though the goals are not in alphabetical order."""
    target, limits, answer = solved
    for name, goal in target.items():
        times = []
        for shift in (-0.05, 0.05):
            value = goal.value + shift * goal.tolerance
            moved = {**target, name: Goal(value, goal.tolerance)}
            again = tune(SETUP, START, BETWEEN, moved, limits, chain=toy)
            assert int(again.verdict) == Verdict.SOLVED
            times.append(float(again.outcome.time))
        slope = (times[1] - times[0]) / 0.1
        assert_close(answer.goal_multipliers[name], slope, rtol=2e-2)


def alike(process: Process, setup: Setup) -> Outcome:
    """The same with a kurtosis that all but says what the skewness says."""
    found = toy(process, setup)
    apart = 2e-4 * (process.trochoid_radius - 5)
    return eqx.tree_at(lambda o: o.Sku, found, 3.6 - 2 * (found.Ssk + 0.75) + apart)


def test_two_goals_that_say_the_same_do_not_stand_in_the_way_of_the_least_time():
    """Both can be met exactly with a radius of 5 mm only, and as well as asked with any."""
    target = {"Ssk": Goal(-0.75, 0.05), "Sku": Goal(3.6, 0.1)}
    answer = tune(SETUP, START, BETWEEN, target, chain=alike, starts=8)
    assert int(answer.verdict) == Verdict.SOLVED
    assert all(abs(float(miss)) <= HIT for miss in answer.misses.values())
    assert_close(answer.process.trochoid_radius, BETWEEN["trochoid_radius"][0], rtol=1e-6)


def test_no_better_point_is_found_by_slsqp(solved):
    target, limits, answer = solved
    names = list(BETWEEN)

    def both(x):
        at = toy(dataclasses.replace(START, **dict(zip(names, x, strict=True))), SETUP)
        off = jnp.stack(list(misses(at, target).values()))
        kept = -jnp.stack(list(excesses(at, limits).values()))
        # what `tune` allows itself on either side of a goal, and nothing more
        return at.time / 1000, jnp.concatenate([AIM - off, AIM + off, kept])

    both, slopes = jax.jit(both), jax.jit(jax.jacfwd(both))

    def part(function, i):
        return lambda x: np.asarray(function(x)[i])

    best = np.inf
    for start in np.stack(list(spread_starts(vars(START), BETWEEN, 8, 1).values()), 1):
        found = minimize(
            part(both, 0),
            start,
            jac=part(slopes, 0),
            bounds=list(BETWEEN.values()),
            constraints=[
                {"type": "ineq", "fun": part(both, 1), "jac": part(slopes, 1)},
            ],
        )
        if found.success:
            best = min(best, 1000 * found.fun)
    assert np.isfinite(best)
    assert float(answer.outcome.time) <= best * (1 + 1e-5)


def test_multiplier_is_what_a_limit_is_worth():
    """Relaxing the active limit changes the time as its multiplier says."""
    target = {"Ssk": Goal(-0.75, 0.05)}
    times, answers = [], []
    for most in (3.9, 4.0, 4.1):
        limits = Limits(
            force=jnp.asarray(most), unstick=False, most_removal=jnp.asarray(0.5)
        )
        answers.append(tune(SETUP, START, BETWEEN, target, limits, chain=toy, starts=8))
        assert int(answers[-1].verdict) == Verdict.SOLVED
        times.append(float(answers[-1].outcome.time))
    slope = (times[0] - times[2]) / 0.2
    assert_close(float(answers[1].multipliers["force"]), slope, rtol=0.03, atol=1e-3)


def test_infeasible_target_names_what_is_in_the_way():
    target = {"Ssk": Goal(-0.99, 0.05), "Sku": Goal(3.0, 0.1)}
    limits = Limits(force=jnp.asarray(3.0))
    answer = tune(SETUP, START, BETWEEN, target, limits, chain=toy)
    assert int(answer.verdict) == Verdict.INFEASIBLE
    assert max(abs(float(miss)) for miss in answer.misses.values()) > 0.1
    assert all(float(excess) <= 1e-6 for excess in answer.excesses.values())
    # nothing better within the limits, by brute force
    grid = np.random.default_rng(0).uniform(size=(20000, 4))
    low, high = np.array(list(BETWEEN.values())).T
    points = jnp.asarray(low + grid * (high - low))

    def score(x):
        given = dict(zip(BETWEEN, x, strict=True))
        outcome = toy(dataclasses.replace(START, **given), SETUP)
        over = jnp.stack(list(excesses(outcome, limits).values()))
        missed = jnp.stack(list(misses(outcome, target).values()))
        return jnp.where(jnp.all(over <= 0), jnp.sum(missed**2), jnp.inf)

    best = float(jnp.min(jax.jit(jax.vmap(score))(points)))
    reached = sum(float(miss) ** 2 for miss in answer.misses.values())
    assert reached <= best * (1 + 1e-6)


def test_starts_lie_in_the_bounds_and_begin_with_the_given_one():
    places = spread_starts(vars(START), BETWEEN, 16, seed=3)
    for name, (low, high) in BETWEEN.items():
        assert places[name].shape == (16,)
        assert float(places[name][0]) == pytest.approx(float(getattr(START, name)))
        assert (places[name] >= low).all()
        assert (places[name] <= high).all()


@pytest.mark.parametrize(
    ("change", "fragment"),
    [
        ({"between": {"tilt": (0.2, 0.3)}}, "must lie between"),
        ({"between": {"lean": (0.0, 1.0)}}, "no setting of `Process`"),
        ({"between": {}}, "`between` is empty"),
        (
            {"target": {"Shine": Goal(1.0, 0.1)}},
            "`target` has 'Shine', which is no outcome",
        ),
        ({"starts": 0}, "`starts` is 0, must be 1 or more"),
        ({"secondary": "beauty"}, "must be 'time', 'force' or 'none'"),
    ],
)
def test_senseless_arguments_are_refused(change, fragment):
    given = {"between": BETWEEN, "target": {"Ssk": Goal(-0.5, 0.05)}} | change
    with pytest.raises(ValueError, match=fragment):
        tune(SETUP, START, given.pop("between"), given.pop("target"), chain=toy, **given)
