"""Program: a path as programs that stay within a tolerance, or a sentence why not."""

import dataclasses
import os
import re
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from polishopt import postprocess
from polishopt.blocks import cut, poses_of
from polishopt.files.assemble import job
from polishopt.files.config import load
from polishopt.files.ncode import DIALECTS
from polishopt.fit import fit
from polishopt.path.toolpath import resolved
from polishopt.postprocess import Programs, deliver, moves, programs
from polishopt.preflight import Finding, obstacles, remarks
from polishopt.program import program
from polishopt.resolved import run, samples


CONFIGS = Path(__file__).parent.parent / "configs"
# a guide of one corner, few loops, and a pole in the middle of the part
SMALL = ["guide.order=1", "process.step_mm.start=3", "process.step_mm.between=[1, 4]"]
CONFIG = CONFIGS / "pessoles2009_convex.yaml"


@pytest.fixture(scope="module")
def made():
    """Config, job and path of a small convex part."""
    config = load(CONFIG, SMALL).config
    one = job(config, first=False)
    path = eqx.filter_jit(run)(one.process, one.setup, samples(one.process, one.setup))
    return config, one, path


@pytest.fixture(scope="module")
def blocks(made):
    _, one, path = made
    return cut(path, one.process, one.setup, 0.01)


@pytest.fixture(scope="module")
def read(made):
    """The programs of that path, read back, by language."""
    config, one, path = made
    found = programs(path, one.process, one.setup, config)
    texts = list(found.texts.values())
    assert [one.prevents for one in found.findings] == [False] * len(found.findings)
    return {n: d.read(t) for (n, d), t in zip(DIALECTS.items(), texts, strict=True)}


def strays(made, blocks, poses, joint):
    """How far each of many points of the true path lies from moves between given poses.

    Looks at every move in many places, with the whole disc: independent of `deviation`.
    """
    _, one, _ = made
    setup, process = one.setup, one.process
    radius = float(setup.tool.radius)
    dense = np.linspace(0, float(setup.guide.length), 6001)
    true = resolved(
        setup.surface, setup.guide, process, setup.tool.radius, jnp.asarray(dense)
    )
    tip, axis = np.asarray(true.tip), np.asarray(true.axis)
    k = np.clip(np.searchsorted(blocks.s, dense, side="right") - 1, 0, blocks.s.size - 2)
    least, best = np.full(dense.size, np.inf), np.full(dense.size, 0.5)
    for step in (0.05, 0.005, 0.0005):
        middle = best
        for i in range(-10, 11):
            share = np.clip(middle + i * step, 0, 1)[:, None]
            between = [a[k] + share * (a[k + 1] - a[k]) for a in poses]
            at, way = poses_of(between[0], setup.machine) if joint else between
            way = way / np.linalg.norm(way, axis=1)[:, None]
            off = np.linalg.norm(at - tip, axis=1)
            off += radius * np.linalg.norm(way - axis, axis=1)
            best = np.where(off < least, share[:, 0], best)
            least = np.minimum(off, least)
    return least


@pytest.mark.parametrize("name", ["siemens_vector", "linuxcnc"])
def test_the_true_path_stays_within_the_tolerance(name, made, blocks, read):
    """Of what was read back, tip and axis at once or all five axes at once."""
    found, joint = read[name], name == "linuxcnc"
    inner = slice(1, -1)  # the approach and the retreat are no path
    if joint:
        poses = [np.column_stack([found.linear, np.radians(found.rotary)])[inner]]
    else:
        poses = [found.tip[inner], found.axis[inner]]
    off = strays(made, blocks, poses, joint)
    assert off.max() <= 0.01 + 1e-5, "which is what the search for the nearest place leaves"
    # no line is wasted: nearly everywhere the tolerance is used
    assert off.max() > 0.005
    assert np.median(off) > 0.002


def test_lines_are_as_few_as_the_tolerance_allows(made, blocks):
    """A quarter of the tolerance takes twice the lines, as for any smooth curve."""
    _, one, path = made
    finer = cut(path, one.process, one.setup, 0.0025)
    assert finer.deviation <= 0.0025
    assert blocks.deviation <= 0.01
    assert finer.s.size / blocks.s.size == pytest.approx(2, rel=0.03)
    # on a circle of radius r a chord strays by l^2/8r; the turning axis takes the rest
    circle = float(path.arc[-1]) / np.sqrt(8 * 0.01 * 6)
    assert circle < blocks.s.size < 2.2 * circle


def test_programs_of_all_languages_hold_the_same_moves(made, blocks, read):
    table = read["csv"]
    for found in read.values():
        for field in ("tip", "axis", "linear", "rotary", "feed"):
            if getattr(found, field) is not None:
                np.testing.assert_array_equal(getattr(found, field), getattr(table, field))
        # nothing is said of a part that nobody moved
        assert not any(re.search("part offset|wedge|shift", n, re.I) for n in found.notes)
    timed = 60 / np.round(60 / table.seconds, 4)
    seconds = read["linuxcnc"].seconds
    assert seconds is not None
    np.testing.assert_allclose(seconds, timed, rtol=1e-12)
    # axis positions are those of the poses, to the digits printed
    axes = np.column_stack([table.linear, np.radians(table.rotary)])
    tip, axis = poses_of(axes, made[1].setup.machine)
    np.testing.assert_allclose(tip, table.tip, rtol=0, atol=3e-4)
    np.testing.assert_allclose(axis, table.axis, rtol=0, atol=3e-6)
    np.testing.assert_array_equal(table.tip[1:-1], np.round(blocks.poses.tip, 4))


def test_a_program_takes_the_time_of_the_path(made, read):
    _, _, path = made
    table = read["csv"]
    assert table.rapid.tolist() == [True] + [False] * (table.rapid.size - 1)
    slow = 20 / (500 / 60)
    total = np.nansum(table.seconds) - 2 * slow
    assert total == pytest.approx(float(path.law.total), rel=2e-3)
    way = np.linalg.norm(np.diff(table.tip, axis=0), axis=1)
    # of moves long enough for the digits of both
    long = way > 0.05
    assert long.sum() > 0.9 * long.size
    np.testing.assert_allclose(
        60 * way[long] / table.seconds[1:][long], table.feed[1:][long], rtol=4e-3
    )


def test_the_tool_comes_and_goes_along_its_axis(read):
    for found in read.values():
        if found.tip is None or found.axis is None:
            continue
        for off, on in ((0, 1), (-1, -2)):
            np.testing.assert_array_equal(found.axis[off], found.axis[on])
            way = found.tip[off] - found.tip[on]
            np.testing.assert_allclose(way, 20 * found.axis[on], rtol=0, atol=2e-4)
        assert found.feed[1] == found.feed[-1] == 500


def test_passes_are_run_whole_and_slower(made, blocks):
    _, one, _ = made
    asked = {"clearance": 20.0, "approach_feed": 500 / 60}
    machine = one.setup.machine
    once, blocked = moves(blocks, one.process, machine, asked)
    assert not blocked
    process = dataclasses.replace(one.process, passes=2.5)
    twice, _ = moves(blocks, process, machine, asked)
    n = once.rapid.size
    assert twice.rapid.size == 2 * n
    assert np.flatnonzero(twice.rapid).tolist() == [0, n]
    np.testing.assert_allclose(twice.seconds[2 : n - 1], 1.25 * once.seconds[2:-1])
    np.testing.assert_array_equal(twice.tip[n:], once.tip)
    # C goes on from where it is, by less than half a turn
    assert abs(twice.rotary[n, 1] - twice.rotary[n - 1, 1]) <= 180
    turned = np.unique(np.round((twice.rotary[n:, 1] - once.rotary[:, 1]) / 360, 9))
    assert turned.size == 1
    assert turned[0] == round(turned[0])


@pytest.mark.slow
def test_a_sharp_corner_is_a_move_of_its_own(made):
    """The axis leans along the guide, so it jumps where the guide turns on the spot."""
    config = load(CONFIG, [*SMALL, "guide.corner=sharp"]).config
    one = job(config, first=False)
    path = eqx.filter_jit(run)(one.process, one.setup, samples(one.process, one.setup))
    found = cut(path, one.process, one.setup, 0.01)
    assert found.jumps == 2
    assert found.deviation <= 0.01
    speed = np.asarray(one.setup.machine.max_speed)
    step = np.abs(np.diff(found.poses.axes, axis=0)) / np.diff(found.time)[:, None]
    assert (step <= speed * (1 + 1e-9)).all()


def limited(one, **changes):
    return dataclasses.replace(one.setup.machine, **changes)


def test_a_position_beyond_its_travel_is_named(made):
    _, one, path = made
    axes, names = np.asarray(path.axes), one.setup.machine.names
    for i, name in enumerate(names):
        low, high = np.full(5, -np.inf), np.full(5, np.inf)
        low[i], high[i] = axes[:, i].min(), axes[:, i].max() - 0.01
        machine = limited(one, lower=low, upper=high)
        (finding,) = obstacles(path, machine)
        assert finding.prevents
        worst = int(np.argmax(axes[:, i])) + 1
        assert finding.sentence.startswith(f"{name} would have to reach ")
        assert f"at sample {worst} of {len(axes)}" in finding.sentence
    low = np.minimum(axes.min(axis=0), -np.inf)
    assert obstacles(path, limited(one, lower=low, upper=axes.max(axis=0))) == []


def test_an_approach_beyond_its_travel_is_named(made, blocks):
    _, one, path = made
    high = np.full(5, np.inf)
    high[2] = np.asarray(path.axes)[:, 2].max() + 5
    machine = limited(one, upper=high)
    assert obstacles(path, machine) == []
    asked = {"clearance": 20.0, "approach_feed": 8.0}
    _, blocked = moves(blocks, one.process, machine, asked)
    assert blocked
    assert all(re.match(r"Z would have to reach .* on the (app|ret)", b) for b in blocked)


def test_an_axis_that_cannot_move_is_named(made):
    _, one, path = made
    speed = np.asarray(one.setup.machine.max_speed).copy()
    speed[4] = 0.0
    (finding,) = obstacles(path, limited(one, max_speed=speed))
    assert re.match(r"Axis C has to move at sample \d+, .*speed is 0", finding.sentence)


def test_an_orientation_out_of_reach_is_named(made):
    _, one, path = made
    axis = path.posture.axis.at[100].set(jnp.array([0.6, 0.0, 0.8]))
    wrong = eqx.tree_at(lambda p: p.posture.axis, path, axis)
    (finding,) = obstacles(wrong, one.setup.machine)
    assert finding.prevents
    assert finding.sentence.startswith("A and C cannot point the tool along (0.60000,")
    assert f"at sample 101 of {len(axis)}" in finding.sentence


def test_remarks_say_what_the_path_is_like(made):
    _, one, path = made
    duration, a, c, pole = (
        f.sentence for f in remarks(path, one.process, one.setup.machine)
    )
    minutes = float(path.law.total) / 60
    assert f"One pass takes {minutes:.2f} min at 1000 mm/min" in duration
    tilts = np.degrees(np.asarray(path.axes)[:, 3])
    assert f"A moves between {tilts.min():.4g}° and {tilts.max():.4g}°" in a
    share = re.search(r"(\d+) % of its speed limit; it limits the feed for", c)
    assert share is not None
    assert 90 < int(share[1]) <= 100
    # the table turns under a tool that stands A from the pole
    assert f"as near as {tilts.min():.3g}°" in pole
    gentle = dataclasses.replace(one.process, feed=0.01)
    slow = eqx.tree_at(lambda p: p.law.feed, path, jnp.full_like(path.law.feed, 0.01))
    *_, calm = (f.sentence for f in remarks(slow, gentle, one.setup.machine))
    assert (
        calm
        == f"The tool axis comes no nearer to the direction of C than {tilts.min():.3g}°."
    )


def files(folder):
    return sorted(path.name for path in folder.iterdir())


def test_all_programs_are_delivered_or_none(tmp_path, monkeypatch):
    fine = Programs((), {"a.mpf": "one\n", "b.nc": "two\n"}, ("a.mpf", "b.nc", "c.ngc"))
    stuck = Programs((Finding("X is short.", True),), {}, ("d.mpf", "e.nc"))
    target = tmp_path / "program"
    assert deliver([fine], target) == [target / "a.mpf", target / "b.nc"]
    assert files(target) == ["a.mpf", "b.nc"]
    # what an earlier run left under these names goes, everything else stays
    (target / "c.ngc").write_text("old")
    (target / "mine.txt").write_text("kept")
    deliver([fine], target)
    assert files(target) == ["a.mpf", "b.nc", "mine.txt"]
    (target / "d.mpf").write_text("old")
    assert deliver([fine, stuck], target) == []
    assert files(target) == ["mine.txt"]

    def fail(*_):
        raise OSError("disk full")

    monkeypatch.setattr(postprocess.os, "replace", fail)
    with pytest.raises(OSError, match="disk full"):
        deliver([fine], target)
    assert files(target) == ["mine.txt"]


def test_a_path_that_cannot_be_run_leaves_no_program(tmp_path, capsys):
    target = tmp_path / "new"
    travel = "machine.axes.X.travel_mm=[-1, 1]"
    assert program(load(CONFIG, [*SMALL, travel]), target, quiet=True) == 3
    told = capsys.readouterr()
    assert told.out == ""
    assert re.match(r"X would have to reach .* at sample \d+ of \d+, ", told.err)
    assert not target.exists() or files(target) == []


@pytest.mark.slow
def test_fit_does_not_search_where_a_clamped_axis_has_to_move(tmp_path, capsys):
    target = tmp_path / "new"
    clamped = load(CONFIG, [*SMALL, "machine.axes.C.speed_rpm=0"])
    assert fit(clamped, target, quiet=True) == 3
    told = capsys.readouterr()
    assert told.out == ""
    assert re.match(r"Axis C has to move at sample \d+, .*speed is 0", told.err)
    assert not target.exists()


@pytest.mark.slow
def test_the_command_writes_every_language_and_check_none(tmp_path):
    def command(*more):
        given = [sys.executable, "-m", "polishopt.program", CONFIG, "-o", tmp_path / "out"]
        return subprocess.run(
            [*map(str, given), *(f"--set={one}" for one in SMALL), *more],
            capture_output=True,
            text=True,
            env={**os.environ, "POLISHOPT_CACHE": str(tmp_path / "cache")},
            check=False,
        )

    checked = command("--check")
    assert checked.returncode == 0, checked.stderr
    assert "passes the pole" in checked.stdout
    assert not (tmp_path / "out").exists()
    ran = command("--set=program.name=disc")
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout.startswith(checked.stdout)
    names = sorted(f"disc{one.ending}" for one in DIALECTS.values())
    assert files(tmp_path / "out") == names
    text = (tmp_path / "out" / "disc_angles.mpf").read_text()
    for word in ("tilt: 3 deg", "S0, convex part", "feed: 1000 mm/min", "disc_18mm"):
        assert word in text


@pytest.mark.skipif(not shutil.which("rs274"), reason="needs rs274 of linuxcnc-uspace")
@pytest.mark.parametrize("config", sorted(CONFIGS.glob("*.yaml")), ids=lambda c: c.stem)
def test_linuxcnc_takes_the_programs_of_all_examples(config, tmp_path):
    sys.path.insert(0, str(Path(__file__).parent))
    from test_ncode import canonical

    loaded = load(config, ["program.dialects=[linuxcnc]"])
    assert program(loaded, tmp_path, True) == 0
    turning = ["XYZABC".index(name) for name in loaded.configs[0].machine.names()[3:]]
    for path in tmp_path.glob("*.ngc"):
        told = DIALECTS["linuxcnc"].read(path.read_text())
        found = canonical(path, tmp_path)
        assert told.linear is not None
        assert told.rotary is not None
        np.testing.assert_allclose(found[:, :3], told.linear, rtol=0, atol=1e-4)
        np.testing.assert_allclose(found[:, turning], told.rotary, rtol=0, atol=1e-4)


@pytest.mark.slow
def test_paths_of_a_plan_are_run_once_where_they_are_the_same(monkeypatch):
    """Four abrasives on one way; then felt discs on another."""
    loaded = load(
        CONFIGS / "pessoles2009_plan.yaml",
        ["guide.count=2", "process.step_mm=4", "program.dialects=[csv]"],
    )
    jobs = [(job(c, first=False), c) for _, c in loaded.steps[:4]]
    seen = []
    real = postprocess.seen

    def counted(*given):
        seen.append(given)
        return real(*given)

    monkeypatch.setattr(postprocess, "seen", counted)
    made = postprocess.paths([(one.process, one.setup, c) for one, c in jobs])
    assert len(seen) == 1
    assert [list(one.texts) for one in made] == [[f"polish_{i}.csv"] for i in (1, 2, 3, 4)]
    first, second = (next(iter(one.texts.values())) for one in made[:2])
    assert "# abrasive: P120, " in first
    assert "# abrasive: P240, " in second
    assert "# tool number: 2" in second
    assert first.splitlines()[-1] == second.splitlines()[-1]
    jax.block_until_ready(seen[0][0].axes)


@pytest.mark.slow
def test_steps_of_a_plan_are_told_their_own_force(tmp_path):
    """Discs of one size on a saddle, one of them three times as soft."""
    text = """
    schema: 1
    part: {surface: hyperbolic_paraboloid, size_mm: [50, 50], twist_1_mm: 0.003}
    machine: mikron_ucp710
    abrasive: P1200
    guide: {family: lines, count: 2}
    start: {scratches: {abrasive: P600, pressure_MPa: 0.05}}
    process:
      {tilt_deg: 9, displacement_mm: 0.4, step_mm: 6, trochoid_radius_mm: 6,
       feed_mm_min: 1000, spindle_rpm: 2000, passes: 1}
    program: {dialects: []}
    steps:
      - {name: hard, tool: {preset: disc_18mm, foundation_N_mm3: 0.3}}
      - {name: soft, tool: {preset: disc_18mm, foundation_N_mm3: 0.1}}
    """
    config = tmp_path / "plan.yaml"
    config.write_text(textwrap.dedent(text), encoding="utf-8")
    jobs = [(job(c, first=False), c) for _, c in load(config).steps]
    made = postprocess.paths([(one.process, one.setup, c) for one, c in jobs])
    hard, soft = (
        next(f.sentence for f in one.findings if f.sentence.startswith("The force"))
        for one in made
    )
    hard, soft = (float(re.findall(r"[\d.]+", sentence)[1]) for sentence in (hard, soft))
    assert hard == pytest.approx(3 * soft, rel=1e-3)
