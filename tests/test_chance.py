"""Errors of constants, carried to outcomes and to a limit that may fail with a chance."""

import dataclasses
import json
from pathlib import Path
from statistics import NormalDist
from types import SimpleNamespace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close, assert_gradient
from polishopt import report, results
from polishopt.chain import polish
from polishopt.constants import START, part, with_constants
from polishopt.contact.flat import flat_force
from polishopt.contact.pressure import patch
from polishopt.files import assemble
from polishopt.files.config import ConfigError, load
from polishopt.files.results import write_json
from polishopt.files.summary import describe
from polishopt.margin import margin_deviations
from polishopt.optimize.goals import Goal, Limits, excesses
from polishopt.optimize.tune import tune
from polishopt.optimize.uncertainty import OUTCOMES, Spread, plan_spread, spread
from polishopt.parts import Process
from polishopt.path.surface import SphereCap
from polishopt.plan import Plan
from rich.console import Console


CONFIGS = Path(__file__).parent.parent / "configs"
PLANE, PLAN = (CONFIGS / f"pessoles2009_{name}.yaml" for name in ("plane", "plan"))
SMALL = ["guide.order=1", "part.size_mm=[40, 40]", "sampling.grid=12"]
SMALL += ["process.tilt_deg={start: 3.5, between: [3.2, 4.8]}", "process.step_mm=1"]
SMALL += ["process.trochoid_radius_mm=6", "sampling.phases=8"]
SMALL += ["start={roughness: {Sq_nm: 300, Ssk: -0.5, Sku: 4}}"]
ERRORS = {
    "tool.diameter_mm": 0.05,
    "tool.foundation_N_mm3": 0.012,
    "tool.stiffening_1_mm": 0.02,
    "tool.unstick.force_N[0]": 0.5,
    "tool.unstick.force_N[1]": 0.4,
    "tool.unstick.tilt_deg[1]": 0.1,
    "abrasive.preston_1_Pa": 1e-14,
    "abrasive.active_fraction": 0.001,
    "start.roughness.Sku": 0.1,
}
ASKED = [f"errors={json.dumps(ERRORS)}", "limits.unstick={probability_percent: 1}"]
LOADED = load(PLANE, [*SMALL, *ASKED])
JOB = assemble.job(LOADED.config)
TARGET = {"mean_removal": Goal(0.01, 0.01)}
K, TABLE = "tool.foundation", "tool.unstick_forces"
CAP = SphereCap(size=JOB.setup.size, radius=jnp.asarray(100.0))
LEVEL = jnp.zeros((1, 2, 2))
BENT = jnp.asarray([[[0.003, 0.001], [0.001, 0.004]], [[0.01, -0.001], [-0.001, 0.008]]])


@pytest.fixture(scope="module")
def tuned():
    """Asked for more removal than there is, it presses as hard as the chance allows."""
    return tune(JOB.setup, JOB.process, JOB.between, TARGET, JOB.limits, "none", starts=2)


@pytest.fixture(scope="module")
def scattered(tuned):
    return eqx.filter_jit(spread)(tuned.process, JOB.setup)


# from the keys of a config to constants


def test_errors_bear_the_names_and_units_of_constants():
    want = {
        "tool.radius": 0.025,
        "tool.foundation": 0.012,
        "tool.stiffening": 0.02,
        "tool.unstick_forces[0]": 0.5,
        "tool.unstick_forces[1]": 0.4,
        "tool.unstick_tilts[1]": np.deg2rad(0.1),
        "abrasive.preston": 1e-8,
        "abrasive.active_fraction": 0.001,
        "start.roughness.Sku": 0.1,
    }
    assert set(JOB.errors) == set(want)
    for name, error in want.items():
        assert_close(JOB.errors[name], error, rtol=1e-12)
        moved = with_constants(JOB.setup, {name: part(JOB.setup, name) + error})
        assert_close(part(moved, name) - part(JOB.setup, name), error, rtol=1e-9)
        others = [other for other in (*want, *START) if other != name]
        for other in others:
            assert_close(part(moved, other), part(JOB.setup, other), rtol=1e-9)


def test_a_key_that_some_step_of_a_plan_has_may_have_an_error():
    """Felt is not glued, and a start belongs to the first step."""
    known = '{tool.foundation_N_mm3: 0.01, "tool.unstick.force_N[3]": 1}'
    loaded = load(PLAN, [f"errors={known}", "limits.unstick={probability_percent: 5}"])
    found = [set(assemble.errors(config)) for _, config in loaded.steps]
    assert found[3] == {K, f"{TABLE}[3]"}
    assert found[4] == {K}
    limits = assemble.limits(loaded.steps[3][1])
    assert_close(limits.unstick_quantile, 1.6448536269514722, rtol=1e-12)
    assert not assemble.limits(loaded.steps[4][1]).unstick
    assert "unstick with a chance of at most 5 %" in describe(loaded)
    with pytest.raises(ConfigError, match="tool.unstick.force_N.9. must stand under a key"):
        load(PLAN, ['errors={"tool.unstick.force_N[9]": 1}'])


@pytest.mark.parametrize(
    ("value", "sentence"),
    [
        ("{probability_percent: 90}", "percent is 90, must lie in (0, 50) %"),
        ("{probability_percent: 0}", "percent is 0, must lie in (0, 50) %"),
        ("{probability_percent: 1 %}", "the key says the unit, write 1"),
        ("{probability: 1}", "use 'probability_percent', in %"),
        ("{}", "limits.unstick lacks the key 'probability_percent'"),
        ("[1]", "is [1], must be true or false, or {probability_percent: 1}"),
        ("{probability_percent: 1}", "write, say, errors: {tool.foundation_N_mm3: 0.01}"),
    ],
)
def test_a_wrong_chance_is_a_sentence(value, sentence):
    useless = "errors={abrasive.active_fraction: 0.001}"
    with pytest.raises(ConfigError) as caught:
        load(PLANE, [f"limits.unstick={value}", useless])
    assert sentence in str(caught.value)


def test_a_summary_names_errors_and_the_chance():
    summary = describe(LOADED)
    assert "unstick with a chance of at most 1 %" in summary
    assert "tool.foundation_N_mm3 ± 0.012" in summary


# the margin


def deviation(x, names=tuple(JOB.errors), curvatures=BENT, size=1.0):
    """Of both margins, of tilt and displacement."""
    process = dataclasses.replace(JOB.process, tilt=x[0], displacement=x[1])
    errors = {name: size * JOB.errors[name] for name in names}
    surface = JOB.setup.surface if curvatures is LEVEL else CAP
    setup = dataclasses.replace(JOB.setup, errors=errors, surface=surface)
    forces = jnp.asarray([1.0, 2.0])[: curvatures.shape[0]]
    return jnp.stack(margin_deviations(process, setup, curvatures, forces))


def test_deviation_of_the_margin_in_closed_form():
    """Linear in the stiffness and in the table."""
    tilt, displacement = jnp.deg2rad(jnp.asarray(3.5)), jnp.asarray(0.5)
    names = (K, f"{TABLE}[0]", f"{TABLE}[1]")
    unstick, shear = deviation(jnp.stack([tilt, displacement]), names, LEVEL)
    tool = JOB.setup.tool
    force = flat_force(tool.radius, tool.foundation, tilt, displacement)
    spring = float(force / tool.foundation) * 0.012
    # a quarter of the way from 3 to 5 degrees
    assert_close(unstick, np.sqrt(spring**2 + (0.75 * 0.5) ** 2 + (0.25 * 0.4) ** 2), 2e-3)
    assert_close(shear, tool.friction * displacement * 0.012)


def test_the_margin_is_known_where_the_part_presses_hardest():
    """Its error there, from differences of the force of that contact."""
    process = dataclasses.replace(JOB.process, tilt=jnp.asarray(0.07))

    @jax.jit
    def force(radius, stiffening):
        tool = dataclasses.replace(JOB.setup.tool, radius=radius, stiffening=stiffening)
        return patch(process, tool, BENT[1], JOB.setup.side, 64, 4, JOB.setup.panels).force

    radius, step = float(JOB.setup.tool.radius), 1e-4
    by_radius = (force(radius + step, 0.0) - force(radius - step, 0.0)) / (2 * step)
    by_growth = (force(radius, step) - force(radius, -step)) / (2 * step)
    want = np.hypot(by_radius * 0.025, by_growth * 0.02)
    x = jnp.stack([process.tilt, process.displacement])
    unstick, _ = deviation(x, ("tool.radius", "tool.stiffening"))
    assert_close(unstick, want, rtol=1e-6)


def test_the_deviation_has_exact_derivatives():
    assert_gradient(deviation, [np.deg2rad(3.7), 0.5], rtol=1e-5)


def test_without_an_error_nothing_scatters_and_gradients_are_finite():
    x = jnp.asarray([0.06, 0.5])
    assert_close(deviation(x, ("abrasive.preston",)), 0.0)

    def still(x):
        return deviation(x, size=0.0)

    assert_close(still(x), 0.0)
    assert_close(jax.jit(jax.jacrev(still))(x), 0.0)


def test_an_excess_holds_its_quantile_back(tuned):
    outcome = dataclasses.replace(
        tuned.outcome,
        unstick_margin=jnp.asarray(1.0),
        unstick_deviation=jnp.asarray(0.5),
        shear_margin=jnp.asarray(0.03),
        shear_deviation=jnp.asarray(0.01),
    )
    limits = Limits(shear=True, rigid_body=False)
    assert_close(list(excesses(outcome, limits).values()), [-1.0, -0.03])
    limits = dataclasses.replace(limits, unstick_quantile=jnp.asarray(2.0))
    assert_close(list(excesses(outcome, limits).values()), [0.0, -0.01])


# the answer


def test_c8_a_chance_of_one_percent_is_one_percent(tuned):
    """The limit is active; of 10 000 discs with constants drawn, 1 % come unstuck."""
    # the search ends at 1e-6 of the limit's slope at the start, in N per width of the box
    assert abs(float(tuned.excesses["unstick force"])) <= 4e-5
    draws = np.random.default_rng(8).standard_normal((10_000, len(JOB.errors)))
    drawn = {
        name: part(JOB.setup, name) + error * draws[:, i]
        for i, (name, error) in enumerate(JOB.errors.items())
    }

    @jax.jit
    @jax.vmap
    def left(values):
        tool, process = with_constants(JOB.setup, values).tool, tuned.process
        # the closed form, not the quadrature that the limit was kept with
        force = flat_force(
            tool.radius,
            tool.foundation,
            process.tilt,
            process.displacement,
            tool.stiffening,
        )
        return jnp.interp(process.tilt, tool.unstick_tilts, tool.unstick_forces) - force

    share = float(jnp.mean(left(drawn) < 0))
    assert 0.005 <= share <= 0.015
    margin, deviation = tuned.outcome.unstick_margin, tuned.outcome.unstick_deviation
    assert_close(NormalDist().cdf(-float(margin / deviation)), 0.01, rtol=2e-4)


def test_spread_is_exact_to_first_order_and_that_of_small_errors(tuned, scattered):
    """Slopes are those of differences, deviations those of draws."""
    names, errors = scattered.constants, np.asarray(scattered.errors)
    middle = np.asarray([part(JOB.setup, name) for name in names])

    @jax.jit
    def outcomes(points):
        def one(values):
            made = with_constants(JOB.setup, dict(zip(names, values, strict=True)))
            outcome = polish(tuned.process, made)
            return jnp.stack([getattr(outcome, name) for name in OUTCOMES])

        return jax.lax.map(one, points, batch_size=32)

    # whitened draws: moments of second order are exact, and what is left is of higher order
    noise = np.random.default_rng(1).standard_normal((256, len(names)))
    noise -= noise.mean(axis=0)
    noise = noise @ np.linalg.inv(np.linalg.cholesky(noise.T @ noise / 256)).T
    steps = 1e-4 * np.diag(errors)
    points = np.concatenate([0.05 * errors * noise, steps, -steps])
    reached = np.asarray(outcomes(jnp.asarray(middle + points)))
    still = [OUTCOMES.index(name) for name in ("time", "shear_margin")]
    assert (reached[:, still] == reached[0, still]).all()  # the disc's glue never fails
    drawn, above, below = np.split(
        np.delete(reached, still, axis=1), [256, 256 + len(names)]
    )
    slopes = np.delete(np.asarray(scattered.slopes) * errors, still, axis=0)
    size = np.linalg.norm(slopes, axis=1)
    differences = (above - below).T / 2e-4
    assert_close(differences / size[:, None], slopes / size[:, None], rtol=1e-4, atol=1e-6)
    assert_close(drawn.std(axis=0), 0.05 * size, rtol=0.01)
    margin = OUTCOMES.index("unstick_margin")
    assert_close(scattered.deviations[margin], tuned.outcome.unstick_deviation, rtol=1e-9)
    assert_close(jnp.sum(scattered.shares[:margin], axis=1), 1.0)
    # axes that are far from their limits bound the feed by next to nothing, not by nothing
    time = OUTCOMES.index("time")
    assert float(scattered.deviations[time]) <= 1e-9 * float(tuned.outcome.time)


def test_the_report_names_both_kinds_of_error(tuned, scattered, tmp_path):
    console = Console(width=80, markup=False)
    job, scatter = (
        dataclasses.replace(JOB, target=TARGET),
        report.Scatter(0.5, {"mean_removal": 1e-5}),
    )
    with console.capture() as caught:
        report.show(console, tuned, job, LOADED, scatter, scattered)
    text = caught.get()
    for part_ in ("± patch", "± constants", "for a chance of 1 %", "forces[1]"):
        assert part_ in text
    deviation = scattered.deviations[OUTCOMES.index("unstick_margin")]
    line = next(line for line in text.splitlines() if "unstick force " in line)
    assert f"{float(deviation):.2g}" in line
    with console.capture() as caught:
        report.show(console, tuned, job, LOADED, scatter)
    assert "constants" not in caught.get()
    write_json(tmp_path / "r.json", results.spread_numbers(scattered))
    written = json.loads((tmp_path / "r.json").read_text())["spread_from_constants"]
    assert_close(written["deviations"]["unstick_margin"], deviation)
    assert set(written["shares_of_variance"]["Ssk"]) == set(JOB.errors)


def test_the_errors_of_a_plan_go_from_step_to_step():
    """One tool for two steps is one error; every abrasive has an error of its own."""
    base = dataclasses.replace(JOB.setup, errors={})
    error = {"abrasive.preston": jnp.asarray(0.1), K: jnp.asarray(0.2)}

    def setup(preston, foundation):
        values = {"abrasive.preston": jnp.asarray(preston), K: jnp.asarray(foundation)}
        return dataclasses.replace(with_constants(base, values), errors=error)

    def chain(processes, plan) -> Any:
        steps, total = [], jnp.zeros(())
        for one in plan.setups:
            total = total + one.abrasive.preston * one.tool.foundation
            steps.append(SimpleNamespace(Sq=total, force=one.tool.foundation))
        return SimpleNamespace(steps=steps)

    plan = Plan(("a", "b", "c"), (setup(1.0, 2.0), setup(3.0, 2.0), setup(4.0, 5.0)))
    process = Process(0.1, 0.3, 1.0, 6.0, 16.7, 209.0)
    found = plan_spread([process] * 3, plan, ("Sq", "force"), chain)
    names = [f"{s} abrasive.preston" for s in "abc"] + [f"a, b {K}", f"c {K}"]
    assert sorted(found[0].constants) == sorted(names)
    slopes = [dict(zip(one.constants, one.slopes.T.tolist(), strict=True)) for one in found]
    a, b, c = (f"{s} abrasive.preston" for s in "abc")
    want = [
        {a: [2, 0], b: [0, 0], c: [0, 0], f"a, b {K}": [1, 1], f"c {K}": [0, 0]},
        {a: [2, 0], b: [2, 0], c: [0, 0], f"a, b {K}": [4, 1], f"c {K}": [0, 0]},
        {a: [2, 0], b: [2, 0], c: [5, 0], f"a, b {K}": [4, 0], f"c {K}": [4, 1]},
    ]
    assert slopes == want
    assert_close(found[0].deviations, [np.hypot(0.2, 0.2), 0.2])
    assert isinstance(found[0], Spread)
