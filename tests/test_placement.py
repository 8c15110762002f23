"""Placement: where the part stands, as something to set and to tune."""

import dataclasses
import functools
import json
import math
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close
from polishopt import postprocess
from polishopt.blocks import cut
from polishopt.files import library
from polishopt.files.answered import optimum
from polishopt.files.assemble import job, machine as assembled, plan_job
from polishopt.files.config import ConfigError, load
from polishopt.files.ncode import DIALECTS
from polishopt.files.shop import Machine as Section
from polishopt.files.summary import describe
from polishopt.fit import fit
from polishopt.machine import forward, inverse
from polishopt.machine.kinematics import placed
from polishopt.mechanics import mechanics
from polishopt.optimize.goals import setting
from polishopt.optimize.sensitivity import sensitivities
from polishopt.optimize.tune import Verdict, tune
from polishopt.parts import Process, Scalar
from polishopt.path.toolpath import posture, resolved
from polishopt.resolved import run, samples
from polishopt.results import INNER_UNITS
from polishopt.setup import Sampling
from scipy.spatial.transform import Rotation


ROOT = Path(__file__).parent.parent
CAP = ROOT / "configs" / "pessoles2009_convex.yaml"
PLANE = ROOT / "configs" / "pessoles2009_plane.yaml"
PLAN = ROOT / "configs" / "pessoles2009_plan.yaml"
WEDGED = Path(__file__).parent / "jobs" / "wedged_cap.yaml"
DEG = math.pi / 180
MOVES = ("shift_x", "shift_y", "shift_z", "wedge_x", "wedge_y", "wedge_z")
# one corner of the guide, few loops, and the pole in the middle of the part
SMALL = ["guide.order=1", "process.step_mm=3"]
COARSE = Sampling(stations=2, phases=8, rows=2, columns=2, pixels=(8, 8))
SETTLED = Process(0.05, 0.4, 3.0, 6.0, 1000 / 60, 209.4)


@functools.cache
def small(path, *more):
    """A small job of a config, sampled coarsely."""
    made = job(load(path, [*SMALL, *more]).config)
    return made.process, dataclasses.replace(made.setup, sampling=COARSE)


def moved(process, values):
    return dataclasses.replace(process, **dict(zip(MOVES, values, strict=True)))


@eqx.filter_jit
def duration(process, setup):
    return mechanics(process, setup).time


def time_at(x, process, setup):
    """Time by the six moves."""
    return mechanics(moved(process, x), setup).time


@eqx.filter_jit
def slopes(around, process, setup):
    """Values at points, and at the first of them the derivatives, forwards."""

    def time(x):
        return time_at(x, process, setup)

    return jax.lax.map(time, around), jax.jacfwd(time)(around[0])


@eqx.filter_jit
def backwards(x, process, setup):
    return jax.grad(time_at)(x, process, setup)


def turned(wedge):
    """Oracle: about the fixed X, then Y, then Z."""
    return Rotation.from_euler("xyz", np.asarray(wedge)).as_matrix()


@functools.cache
def bare(name):
    """A preset whose part stands straight and at its zero, and one whose part does not."""
    given = {"preset": name, **library.preset("machines", name)}
    straight = assembled(Section.model_validate(given))
    placement = {"offset_mm": [5, -7, 11], "wedge_deg": [3, -5, 10]}
    return straight, assembled(Section.model_validate(given | {"placement": placement}))


@pytest.mark.parametrize("name", library.names("machines"))
def test_a_moved_part_is_run_as_its_moved_poses(name):
    """Axes for a pose on a moved part are those for the moved pose on one that stands."""
    straight, aside = bare(name)
    process = moved(SETTLED, (20.0, -3.0, 4.0, 0.05, -0.1, 0.2))
    offset = np.array([25.0, -10.0, 15.0])
    turn = turned([3 * DEG + 0.05, -5 * DEG - 0.1, 10 * DEG + 0.2])
    machine = placed(aside, process)
    tip, axis = np.array([10.0, 20.0, -2.0]), np.array([0.1, -0.05, 1.0])
    axis /= np.linalg.norm(axis)
    found = inverse(jnp.asarray(tip), jnp.asarray(axis), machine)
    there = turn @ tip + offset
    assert_close(found, inverse(jnp.asarray(there), jnp.asarray(turn @ axis), straight))
    back = forward(found, machine)
    assert_close(back[0], tip, atol=1e-9)
    assert_close(back[1], axis, atol=1e-12)
    # what is not set does not move, alone or beside what is
    assert placed(aside, SETTLED) is aside
    along = placed(aside, dataclasses.replace(SETTLED, shift_y=2.0))
    assert_close(along.offset, [5, -5, 11])
    assert all(a is b for a, b in zip(along.wedge, aside.wedge, strict=True))


def test_process_and_machine_move_the_part_alike():
    """The same sum of offsets and angles, whoever adds; and zeros are no move at all."""
    process, setup = small(CAP)
    placement = ["machine.placement.offset_mm=[30, -10, 5]"]
    placement += ["machine.placement.wedge_deg=[2, 12, -4]"]
    other, aside = small(CAP, *placement)
    assert not other.wedged
    values = (30.0, -10.0, 5.0, 2 * DEG, 12 * DEG, -4 * DEG)
    same = duration(moved(process, values), setup)
    assert_close(same, duration(other, aside), rtol=1e-9)
    straight = duration(process, setup)
    assert_close(duration(moved(process, np.zeros(6)), setup), straight, rtol=1e-12)
    # and it matters: past the pole C turns round, and far off it X and Y must follow it
    assert abs(float(same / straight) - 1) > 0.01


def test_a_wedge_keeps_the_tool_off_the_pole():
    """Off the pole there is nothing that C could be too slow for."""
    process, setup = small(WEDGED, "process.wedge_y_deg=0")
    level, aslant = (
        float(duration(moved(process, (0, 0, 0, 0, y * DEG, 0)), setup)) for y in (0, 25)
    )
    fast = dataclasses.replace(
        setup,
        machine=eqx.tree_at(
            lambda m: (m.max_speed, m.max_acceleration, m.max_jerk),
            setup.machine,
            (jnp.asarray(np.full(5, 1e9)),) * 3,
        ),
    )
    least = float(duration(moved(process, np.zeros(6)), fast))
    assert level > 1.03 * least
    assert least <= aslant < least + 0.3 * (level - least)


# shifts and wedges, and the feed [mm/s]: with the pole on the part, and with it far away,
# where a feed has to be high for the axes to hold it back
PLACES = {
    "near the pole": ((12.0, -8.0, 3.0, 2 * DEG, 3 * DEG, -4 * DEG), 16.7),
    "off the pole": ((40.0, 25.0, -20.0, 15 * DEG, -20 * DEG, 30 * DEG), 80.0),
}
SIZES = np.array([10.0, 10.0, 10.0, 0.1, 0.1, 0.1])
POINTS = 13


def onto_the_pole(axis):
    """Wedges about X and Y that turn a tool axis of the part to where C points."""
    x, y, z = (float(c) for c in axis)
    return math.atan2(y, z), math.atan2(-x, math.hypot(y, z))


def at_the_pole():
    """A job, and wedges that have one node of its averaged path at the pole."""
    process, setup = small(CAP)
    s, _ = setup.guide.stations(setup.sampling.stations)
    lean = (setup.pulling, setup.lean)
    point, phase = setup.guide(s[3]), jnp.zeros(())
    at = posture(setup.surface, point, phase, process, setup.tool.radius, *lean)
    a, b = onto_the_pole(at.axis)
    machine = placed(setup.machine, moved(process, (0, 0, 0, a, b, 0)))
    assert_close(forward(jnp.zeros(5), machine)[1], at.axis, atol=1e-15)
    return process, setup, jnp.asarray([0, 0, 0, a, b, 0.0])


@pytest.mark.parametrize("place", PLACES)
def test_slopes_of_time_are_its_differences(place):
    process, setup = small(CAP)
    x, feed = PLACES[place]
    process = dataclasses.replace(process, feed=feed)
    steps = np.diag(1e-6 * SIZES)
    around = np.concatenate([np.asarray(x)[None], x + steps, x - steps])
    values, ahead = slopes(jnp.asarray(around), process, setup)
    above, below = np.split(np.asarray(values)[1:], 2)
    ahead = np.asarray(ahead) * SIZES
    largest = np.abs(ahead).max()
    assert largest > 1e-3 * values[0]
    assert_close((above - below) / 2e-6, ahead, rtol=0, atol=1e-5 * largest)


def test_slopes_are_finite_with_the_tool_at_the_pole():
    process, setup, x = at_the_pole()
    near = jnp.linspace(0.0, 1e-9, POINTS)
    values, ahead = slopes(jnp.tile(x, (POINTS, 1)).at[:, 3].add(near), process, setup)
    assert_close(values, values[0], rtol=1e-6)
    assert np.isfinite(ahead).all()


@pytest.mark.slow
def test_slopes_backwards_are_those_forwards():
    cases = []
    for x, feed in PLACES.values():
        process, setup = small(CAP)
        cases.append((dataclasses.replace(process, feed=feed), setup, jnp.asarray(x)))
    for process, setup, x in (*cases, at_the_pole()):
        _, ahead = slopes(jnp.tile(x, (POINTS, 1)), process, setup)
        back = backwards(x, process, setup) * SIZES
        largest = np.abs(ahead * SIZES).max()
        assert_close(back, ahead * SIZES, rtol=0, atol=1e-9 * largest)


def test_a_plane_on_a_wedge_may_pass_the_pole():
    """As steep as the tool leans, the wedge takes whole lines of the guide to the pole."""
    process, setup = small(PLANE, "process.tilt_deg=5", "process.feed_mm_min=4000")
    assert setup.flat
    wedges = DEG * jnp.asarray([5, 5 - 1e-6, 5 - 1e-9, 5 + 1e-9, 5 + 1e-6, 4.9, 5.1, 0])
    around = jnp.zeros((POINTS, 6)).at[:8, 4].set(wedges)
    values, ahead = slopes(around, process, setup)
    assert np.isfinite(ahead).all()
    # time is a smooth function of the wedge there too
    assert_close(values[:5], values[0], rtol=1e-6)
    assert_close(values[5:7], values[0], rtol=1e-3)
    # and turns cost something, of which there is less on a level table
    level = float(duration(process, setup))
    assert_close(values[7], level, rtol=1e-3)
    assert values[0] > 1.005 * level


def test_what_is_not_set_is_not_there():
    """Compiled programs, and lists of settings, are as they were without the six."""
    process, setup = small(PLANE)
    assert len(jax.tree.leaves(process)) == 7
    assert not process.wedged
    assert float(setting(process, (), "wedge_y")) == 0
    # a plane whose machine says that it stands aslant is as one on a wedge of the process
    turned, _ = small(PLANE, "machine.placement.wedge_deg=[0, 5, 0]")
    assert turned.wedged
    assert float(setting(turned, (), "wedge_x")) == 0
    told = describe(load(CAP, SMALL))
    assert "wedge" not in told
    assert "shift" not in told
    told = describe(load(CAP, [*SMALL, "process.wedge_y_deg={start: 1, between: [0, 9]}"]))
    assert "wedge y" in told
    assert "tuned in [0, 9] °, from 1" in told


MOVED = [
    "machine.placement.offset_mm=[10, 0, 0]",
    "machine.placement.wedge_deg=[0, 0, 30]",
    "process.shift_x_mm=20",
    "process.wedge_y_deg=8",
]


@pytest.fixture(scope="module")
def made():
    """Config, job and path of a small part that was moved."""
    config = load(PLANE, [*SMALL, *MOVED]).config
    one = job(config, first=False)
    count = samples(one.process, one.setup)
    path = eqx.filter_jit(run)(one.process, one.setup, count, jerk=False)
    return config, one, path


def test_a_program_moves_the_axes_and_not_the_tool_on_the_part(made):
    config, one, path = made
    setup, process = one.setup, one.process
    found = postprocess.programs(path, process, setup, config)
    assert not found.prevented
    blocks = cut(path, process, setup, config.program.chord_tolerance_mm)
    # on the part: the posture that no machine knows of
    at = resolved(
        setup.surface, setup.guide, process, setup.tool.radius, jnp.asarray(blocks.s)
    )
    assert_close(blocks.poses.tip, at.tip, atol=1e-9)
    assert_close(blocks.poses.axis, at.axis, atol=1e-12)
    # on the machine: the moved poses, by a machine whose part stands at its zero
    straight, _ = bare("mikron_ucp710")
    turn = turned([0, 8 * DEG, 30 * DEG])
    tips = np.asarray(at.tip) @ turn.T + np.array([30.0, 0, 0])
    ways = np.asarray(at.axis) @ turn.T
    want = jax.jit(jax.vmap(lambda t, u: inverse(t, u, straight)))(tips, ways)
    gap = blocks.poses.axes - np.asarray(want)
    gap[:, 4] -= 2 * math.pi * np.round(gap[:, 4] / (2 * math.pi))
    assert_close(gap, 0.0, atol=1e-8)
    # and what is read back is what was written
    table = DIALECTS["csv"].read(next(t for n, t in found.texts.items() if "csv" in n))
    assert table.tip is not None
    assert table.linear is not None
    assert_close(table.tip[1:-1], np.round(blocks.poses.tip, 4), atol=1e-9)
    assert_close(table.linear[1:-1], np.round(blocks.poses.axes[:, :3], 4), atol=1e-9)


def test_a_program_says_where_the_part_has_to_stand(made):
    config, one, path = made
    found = postprocess.programs(path, one.process, one.setup, config)
    assert len(found.texts) == len(DIALECTS)
    for text in found.texts.values():
        told = text.lower()
        assert "part offset: x 30.0000 y 0.0000 z 0.0000 mm" in told
        assert "offset counts: from the pivot of c, all axes at 0" in told
        assert "part wedge: x 0.0000 y 8.0000 z 30.0000 deg" in told
        assert "wedge turns: about x, then y, then z" in told
        assert "shift x: 20 mm" in told
        assert "shift y" not in told


def test_the_preflight_looks_at_the_moved_part(made):
    """A travel that holds the moved part does not hold it moved on by more than is left."""
    config, one, path = made
    asked = config.program.model_copy(update={"dialects": ()})
    left = 2.0
    room = np.full(5, np.inf)
    room[0] = np.abs(np.asarray(path.axes)[:, 0]).max() + left
    tight = eqx.tree_at(
        lambda s: (s.machine.lower, s.machine.upper),
        one.setup,
        (jnp.asarray(-room), jnp.asarray(room)),
    )
    seen = postprocess.seen(path, one.process, tight, asked)
    assert not any(finding.prevents for finding in seen.findings)
    further = dataclasses.replace(one.process, shift_x=one.process.shift_x + 10 * left)
    count = path.s.shape[0]
    off = eqx.filter_jit(run)(further, one.setup, count, jerk=False)
    (finding,) = postprocess.seen(off, further, tight, asked).findings
    assert finding.prevents
    assert finding.sentence.startswith("X would have to reach ")


BAD = {
    "process.wedge_y_deg=60": "process.wedge_y_deg is 60, must lie in [-45, 45] °",
    "process.shift_x_mm={start: 1, between: [-2e4, 0]}": (
        "process.shift_x_mm.between[0] is -20000, must lie in [-1e4, 1e4] mm"
    ),
    "process.wedge_x_deg={start: 5, between: [3, 1]}": (
        "process.wedge_x_deg.between is [3, 1], must have the lower end first"
    ),
    "process.shift_z_mm=1 cm": "process.shift_z_mm is '1 cm', must be a number",
    "process.wedge_y_rad=1": "unknown key 'wedge_y_rad'; use 'wedge_y_deg', in °",
}


@pytest.mark.parametrize(("typed", "sentence"), BAD.items())
def test_what_cannot_be_is_answered_in_a_sentence(typed, sentence):
    with pytest.raises(ConfigError) as error:
        load(CAP, [typed])
    assert sentence in str(error.value)


def test_units_and_bounds_are_those_of_the_keys():
    made = job(
        load(
            CAP,
            [
                "process.wedge_y_deg={start: 5, between: [-10, 20]}",
                "process.shift_z_mm={start: -4, between: [-60, 0]}",
            ],
        ).config
    )
    assert made.between["wedge_y"] == pytest.approx((-10 * DEG, 20 * DEG))
    assert made.between["shift_z"] == (-60, 0)
    assert_close(made.process.wedge_y, 5 * DEG)
    assert_close(made.process.shift_z, -4)
    assert made.process.shift_x is None


def test_each_step_of_a_plan_has_a_place_of_its_own(tmp_path):
    loaded = load(
        PLAN,
        [
            "steps.0.process={wedge_y_deg: {start: 4, between: [0, 9]}}",
            "steps.0.target={Ssk: -0.7, Sku: 3.7}",
            "steps.1.process={shift_x_mm: 7}",
        ],
    )
    made = plan_job(loaded.steps)
    first, second, third = made.processes[:3]
    assert_close(first.wedge_y, 4 * DEG)
    assert first.shift_x is None
    assert_close(second.shift_x, 7)
    assert second.wedge_y is None
    assert len(jax.tree.leaves(third)) == 7
    assert made.between["P120 wedge_y"] == pytest.approx((0, 9 * DEG))
    # an answer goes back to where it was asked for
    path = tmp_path / "optimum.yaml"
    path.write_text(optimum(loaded, {"P120 wedge_y_deg": 6.25}, tmp_path))
    again = plan_job(load(path).steps).processes
    assert_close(again[0].wedge_y, 6.25 * DEG)
    assert_close(again[1].shift_x, 7)


class Toy(NamedTuple):
    time: Scalar


def test_sensitivities_know_the_moves():
    """Around settings that do not touch them too; any others are left as they were."""
    process, setup = small(CAP)

    def toy(process, _):
        assert process.shift_y is None
        return Toy(process.feed * (3.0 * process.shift_x + jnp.sin(process.wedge_y)))

    settings = ("shift_x", "wedge_y")
    chain: Any = toy
    found = sensitivities(process, setup, ("time",), settings, chain)
    assert_close(found.derivatives[0], process.feed * np.array([3.0, 1.0]))
    assert [INNER_UNITS[name] for name in settings] == ["mm", "rad"]


@pytest.mark.slow
def test_a_free_wedge_is_worth_time(tmp_path):
    """Never more time than on a level table, which is among the wedges; here far less."""
    assert fit(load(WEDGED), tmp_path, quiet=True) == 0
    told = json.loads((tmp_path / "result.json").read_text())
    level = job(load(WEDGED, ["process.wedge_y_deg=0"]).config)
    best = tune(
        level.setup, level.process, level.between, level.target, level.limits, starts=4
    )
    assert int(best.verdict) == Verdict.SOLVED
    assert told["outcome"]["time"] < 0.95 * float(best.outcome.time)
    # what is saved keeps the wedge, and says nothing of moves that nobody asked for
    assert told["answers"].keys() == {
        "tilt_deg",
        "displacement_mm",
        "step_mm",
        "wedge_y_deg",
    }
    assert "wedge_y" in told["process"]
    assert "shift_x" not in told["process"]
    saved = job(load(tmp_path / "optimum.yaml").config).process.wedge_y
    assert_close(saved, told["process"]["wedge_y"], rtol=1e-5, atol=1e-12)
    table = (tmp_path / "sensitivity.csv").read_text()
    assert ",wedge_y," in table
    assert "shift" not in table
    program = (tmp_path / "program" / "polish.csv").read_text()
    assert f"# part wedge: X 0.0000 Y {told['answers']['wedge_y_deg']:.4f}" in program
