"""Plan: steps handed from one to the next, as functions, as a config and as a command."""

import csv
import functools
import json
import os
import subprocess
import sys
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close
from polishopt.chain import finish
from polishopt.files.answered import optimum
from polishopt.files.assemble import plan_job
from polishopt.files.config import ConfigError, load
from polishopt.files.summary import describe
from polishopt.mechanics import mechanics
from polishopt.optimize.goals import (
    Limits,
    PlanLimits,
    all_excesses,
    all_misses,
    applied,
    setting,
)
from polishopt.plan import Plan, follow, follow_forward
from polishopt.setup import Sampling, Start


CONFIG = Path(__file__).parent.parent / "configs" / "pessoles2009_plan.yaml"
run = eqx.filter_jit(follow)


@functools.cache
def whole():
    job = plan_job(load(CONFIG).steps)
    return job, run(job.processes, job.plan)


@pytest.mark.slow
def test_steps_are_handed_on_as_if_run_one_by_one():
    """However the mechanics of like steps are batched."""
    job, together = whole()
    for i in (0, 1, 2):
        setup, got = job.plan.setups[i], together.steps[i]
        start = together.steps[i - 1].left if i else setup.start
        alone = finish(alone_jit(job.processes[i], setup), setup, start)
        for name in ("Sa", "Sq", "Ssk", "Sku", "Sz", "Sz_before", "time", "mean_removal"):
            assert_close(getattr(got, name), getattr(alone, name), rtol=1e-9)
        assert len(got.left.scratches) == 2 * (i + 1)
    assert together.last is together.steps[-1]
    assert_close(together.time, sum(float(one.time) for one in together.steps))


@eqx.filter_jit
def alone_jit(process, setup):
    return mechanics(process, eqx.tree_at(lambda s: s.start, setup, Start()))


def test_a_plan_wants_one_process_for_each_step():
    job, _ = whole()
    with pytest.raises(ValueError, match="6 entries, must have one for each of the 7"):
        follow(job.processes[1:], job.plan)


def test_the_paper_s_plan_goes_from_milled_to_mirror():
    """Roughness falls at every step to the nm; each removes what the one before left."""
    job, outcome = whole()
    Sa = np.asarray([one.Sa for one in outcome.steps]) * 1e6
    assert (np.diff(Sa) < 0).all()
    assert Sa[0] > 100
    assert Sa[-1] < 10
    for one in outcome.steps:
        assert one.mean_removal > one.Sz_before
    excess = all_excesses(outcome, job.limits)
    assert max(float(x) for x in excess.values()) < 0
    # 15 min in the paper, with sharp corners: rounded ones save 13 % on the curve, and
    # eight lines are a little longer
    minutes = np.asarray([one.time for one in outcome.steps]) / 60
    assert ((minutes > 12) & (minutes < 15)).all()


def test_a_plan_that_does_not_touch_leaves_the_start():
    job, _ = whole()
    idle = [eqx.tree_at(lambda p: p.displacement, p, jnp.zeros(())) for p in job.processes]
    outcome = run(tuple(idle), job.plan)
    assert_close(outcome.last.Sz, job.plan.setups[0].start.Sz, rtol=1e-9)
    assert_close(outcome.last.Sq, outcome.steps[0].Sq, rtol=1e-9)


def test_slopes_by_jobs_and_by_settings_agree():
    """By settings alone they are worked out step by step; by the job too, as usual."""
    job, _ = whole()
    coarse = Sampling(1, 6, 2, 2, (8, 8), 6)
    setups = [eqx.tree_at(lambda s: s.sampling, s, coarse) for s in job.plan.setups[:2]]

    def removals(tilts, factor):
        plan = Plan(
            job.plan.names[:2],
            tuple(
                eqx.tree_at(lambda s: s.abrasive.preston, s, factor * s.abrasive.preston)
                for s in setups
            ),
        )
        changed = [
            eqx.tree_at(lambda p: p.tilt, p, tilt)
            for p, tilt in zip(job.processes[:2], tilts, strict=True)
        ]
        return jnp.stack([step.mean_removal for step in follow(changed, plan).steps])

    @jax.jit
    def slopes(tilts, factor):
        alone = jax.jacfwd(lambda tilts: removals(tilts, factor))(tilts)
        return removals(tilts, factor), alone, jax.jacfwd(removals, (0, 1))(tilts, factor)

    tilts = jnp.stack([p.tilt for p in job.processes[:2]])
    values, alone, (beside, by_factor) = slopes(tilts, jnp.asarray(1.0))
    assert_close(alone, beside, rtol=1e-10)
    assert (np.diag(alone) != 0).all()
    assert_close(alone - np.diag(np.diag(alone)), 0.0)
    assert_close(by_factor, values, rtol=1e-10)


def test_slopes_by_way_of_the_strains_are_those_of_every_map():
    """`follow_forward` gives the values and slopes of `follow`, in either mode."""
    job, _ = whole()
    coarse = Sampling(1, 6, 2, 2, (8, 8), 3)
    setups = [eqx.tree_at(lambda s: s.sampling, s, coarse) for s in job.plan.setups[:2]]
    plan = Plan(job.plan.names[:2], tuple(setups))
    names = ("tilt", "displacement")
    x = jnp.asarray([[float(getattr(p, n)) for n in names] for p in job.processes[:2]])

    def texture(follow, x):
        changed = [
            eqx.tree_at(lambda p: tuple(getattr(p, n) for n in names), p, tuple(row))
            for p, row in zip(job.processes[:2], x, strict=True)
        ]
        steps = follow(changed, plan).steps
        rough = steps[-1].parts[0].k3 * 1e9
        return jnp.stack([*(1e3 * step.left.Sz for step in steps), steps[-1].Ssk, rough])

    @jax.jit
    def both(x):
        def along(follow):
            # not jacfwd, which throws the values away that are asked for here
            push = jax.vmap(
                lambda way: jax.jvp(lambda x: texture(follow, x), (x,), (way,)),
                out_axes=(None, 0),
            )
            return push(jnp.eye(x.size).reshape(-1, *x.shape))

        return along(follow), along(follow_forward)

    (want, slopes), (got, others) = both(x)
    assert_close(got, want, rtol=1e-12)
    assert_close(others, slopes, rtol=1e-9, atol=1e-12 * float(jnp.max(jnp.abs(slopes))))
    assert (slopes[:2, -2] != 0).all()  # the first step is still seen in the last
    last = jax.jit(jax.grad(lambda x: texture(follow_forward, x)[-2]))(x).reshape(-1)
    assert_close(last, slopes[:, -2], rtol=1e-9, atol=1e-12 * float(jnp.max(jnp.abs(last))))


@pytest.mark.slow
def test_gradient_of_a_plan_with_a_large_patch():
    """12 settings, 256 x 256 points: equal to differences, in less than 1 GB.

    `benchmarks/bench_plan.py` takes all seven steps, setting by setting; here it is three
    and random directions, each of which moves all settings at once.
    """
    job, _ = whole()
    rng = np.random.default_rng(0)
    coarse = Sampling(1, 6, 2, 2, (8, 8), 6)
    chosen = (0, 1, 2)
    setups = [eqx.tree_at(lambda s: s.sampling, job.plan.setups[i], coarse) for i in chosen]
    setups[0] = eqx.tree_at(
        lambda s: (s.start.heights, s.start.spacing),
        setups[0],
        (jnp.asarray(rng.normal(0, 1e-3, (256, 256))), jnp.full(2, 2e-3)),
    )
    plan = Plan(tuple(job.plan.names[i] for i in chosen), tuple(setups))
    processes = [job.processes[i] for i in chosen]
    names = ("tilt", "displacement", "step", "trochoid_radius")
    first = np.asarray([[float(getattr(p, n)) for n in names] for p in processes])

    def texture(x):
        changed = tuple(
            eqx.tree_at(lambda p: tuple(getattr(p, n) for n in names), p, tuple(row))
            for p, row in zip(processes, x, strict=True)
        )
        outcome = follow(changed, plan)
        end = outcome.last
        return 1e5 * end.Sq + end.Ssk + end.Sku + outcome.time / 1e4

    compiled = jax.jit(jax.value_and_grad(texture)).lower(jnp.asarray(first)).compile()
    used: int = compiled.memory_analysis().temp_size_in_bytes  # pyright: ignore[reportOptionalMemberAccess, reportAttributeAccessIssue]
    assert used < 1e9
    _, gradient = compiled(jnp.asarray(first))
    assert np.isfinite(gradient).all()
    assert (np.abs(gradient) > 0).all()
    for _ in range(3):
        way = first * rng.normal(size=first.shape) * 1e-5
        above, below = (compiled(jnp.asarray(first + sign * way))[0] for sign in (1, -1))
        assert_close(np.sum(gradient * way), (above - below) / 2, rtol=1e-4)


def test_goals_and_settings_carry_the_name_of_their_step():
    job, outcome = whole()
    names = job.plan.names
    assert setting(job.processes, names, "9 um displacement") == 0.3
    new = applied(job.processes, names, {"P240 tilt": jnp.asarray(0.1)})
    assert isinstance(new, tuple)
    assert [float(p.tilt) for p in new].count(0.1) == 1
    assert float(new[1].tilt) == 0.1
    for wrong in ("P241 tilt", "P240 tlit", "tilt"):
        with pytest.raises(ValueError, match="`between` has"):
            setting(job.processes, names, wrong)
    keep = PlanLimits((*(Limits(rigid_body=False, unstick=False),) * 6, Limits()))
    assert set(all_excesses(outcome, keep)) == {"1 um unstick force", "1 um rigid body"}
    assert all_misses(outcome, {}) == {}


PLAN = """\
schema: 1
part: {surface: plane, size_mm: [30, 30]}
tool: disc_18mm
machine: mikron_ucp710
guide: {family: lines, count: 2}
process:
  tilt_deg: 3
  displacement_mm: 0.4
  step_mm: 2
  trochoid_radius_mm: 4
  feed_mm_min: 1000
  spindle_rpm: 2000
start:
  roughness: {Sq_nm: 300}
sampling: {phases: 6, grid: 8}
solver: {starts: 2}
steps:
  - name: coarse
    abrasive: P600
  - name: fine   # keep me
    abrasive: P1200
    process:
      step_mm: {start: 2, between: [1, 3]}
      displacement_mm: {start: 0.4, between: [0.2, 0.6]}
target:
  Ssk: -0.8
  Sku: 3.9
"""


def read(folder, text=PLAN, overrides=()):
    path = folder / "plan.yaml"
    path.write_text(text)
    return load(path, overrides)


def test_a_step_takes_from_the_top_what_it_does_not_say(tmp_path):
    loaded = read(tmp_path, overrides=["steps.0.process.tilt_deg=5", "limits.time_min=9"])
    (first, coarse), (second, fine) = loaded.steps
    assert (first, second) == ("coarse", "fine")
    assert coarse.process.tilt_deg == 5
    assert fine.process.tilt_deg == 3
    assert coarse.process.step_mm == 2
    assert set(fine.tuned()) == {"step_mm", "displacement_mm"}
    assert coarse.abrasive.grain_um > fine.abrasive.grain_um
    assert coarse.limits.time_min == fine.limits.time_min == 9
    assert coarse.target is None
    assert fine.target is not None
    assert "step 2, fine" in describe(loaded)
    written = optimum(loaded, {"fine step_mm": 1.25})
    assert "step_mm: {start: 1.25, between: [1, 3]}" in written
    assert "# keep me" in written


# what to replace, by what, line, a part of the sentence
WRONG = {
    "a value in a step": ("[1, 3]", "[3, 1]", 23, "lower end first"),
    "a value at the top": ("tilt_deg: 3", "tilt_deg: 95", 7, "must lie in (0, 45]"),
    "an unknown key": ("    abrasive: P600", "    abrasiv: P600", 19, "did you mean"),
    "an unknown preset": ("abrasive: P600", "abrasive: P601", 19, "no preset 'P601'"),
    "a section of the top": ("    abrasive: P600", "    part: plane", 19, "unknown key"),
    "no name": ("- name: coarse\n    abrasive", "- abrasive", 18, "must be a word"),
    "a name twice": ("name: fine", "name: coarse", 20, "already"),
    "no list": ("steps:\n", "steps: 3\nx:\n", 17, "must be a list"),
    "a missing key": ("  tilt_deg: 3\n", "", 6, "lacks the key 'tilt_deg'"),
    "no target": ("target:\n  Ssk: -0.8\n  Sku: 3.9\n", "", 17, "needs a `target`"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_mistake_in_a_plan_has_its_place(name, tmp_path):
    old, new, line, part = WRONG[name]
    assert PLAN.count(old) == 1
    with pytest.raises(ConfigError) as caught:
        read(tmp_path, PLAN.replace(old, new))
    assert "Traceback" not in str(caught.value)
    found = [p for p in caught.value.problems if part in p.sentence]
    assert len(found) == 1, str(caught.value)
    assert found[0].line == line, str(caught.value)


@pytest.mark.slow
def test_fit_tunes_a_plan(tmp_path):
    """To a texture after the last step; the answer is a config that gives it again."""
    read(tmp_path)
    target = tmp_path / "run"
    ran = subprocess.run(
        [sys.executable, "-m", "polishopt.fit", tmp_path / "plan.yaml", "-o", target],
        capture_output=True,
        text=True,
        env={**os.environ, "POLISHOPT_CACHE": "off"},
        check=False,
    )
    assert "Traceback" not in ran.stderr, ran.stderr
    assert ran.returncode in (0, 3), ran.stderr
    for word in ("Steps", "Tuned", "Targets", "coarse", "fine Ssk"):
        assert word in ran.stdout
    names = {path.name for path in target.iterdir()}
    written = {"result.json", "optimum.yaml", "steps.csv", "steps.png"}
    assert names == {"program", "searches"} | written
    result = json.loads((target / "result.json").read_text())
    assert result["verdict"] == {0: "solved", 3: "infeasible"}[ran.returncode]
    rows = list(csv.reader((target / "steps.csv").read_text().splitlines()))
    assert [row[0] for row in rows] == ["step", "coarse", "fine"]
    again = plan_job(load(target / "optimum.yaml").steps)
    outcome = run(again.processes, again.plan)
    assert_close(outcome.last.Ssk, result["steps"]["fine"]["Ssk"], rtol=1e-4)
