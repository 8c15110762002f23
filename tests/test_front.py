"""Fronts and regions: on a stand-in whose fronts and regions are known in closed form."""

import csv
import dataclasses
import itertools
import threading
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close
from polishopt import Goal, Limits, Outcome, Process, Setup, Start, relax, tune
from polishopt.files.assemble import Job, job
from polishopt.files.config import load
from polishopt.front import main, write
from polishopt.front_plot import Aim, front_figure, region_figure, shown
from polishopt.optimize import explore
from polishopt.optimize.explore import Explorer, value
from polishopt.optimize.front import Front, Point, Region, front, region
from polishopt.optimize.goals import PlanLimits
from polishopt.plan import Plan, PlanOutcome
from polishopt.texture.scratches import Population


CONFIGS = Path(__file__).parent.parent / "configs"
SETUP = job(load(CONFIGS / "pessoles2009_plane.yaml").config).setup
START = Process(0.3, 0.2, 0.7, 6.0, 16.7, 209.0)
BETWEEN = {"tilt": (-1.0, 1.0), "displacement": (-1.0, 1.0), "step": (0.0, 2.0)}
NAMES = ("time", "force", "spread", "mean_removal", "Ssk", "Sku", "miss")
TARGET = {"Ssk": Goal(2.0, 0.5)}
MOST = 1.5
MIDDLE = 0.5**0.5


def known(process: Process, setup: Setup) -> Outcome:
    """Outcomes whose fronts and regions can be written down."""
    del setup
    a, c, b = process.tilt, process.displacement, process.step
    given = {
        "Ssk": a,
        "Sku": 3 - a**2 + b,
        "time": (a + 1) ** 2 + 1 + c**2,
        # Fonseca and Fleming (1995): a front that bends inwards
        "force_max": 1 - jnp.exp(-((a - MIDDLE) ** 2) - (c - MIDDLE) ** 2),
        "spread": 1 - jnp.exp(-((a + MIDDLE) ** 2) - (c + MIDDLE) ** 2),
        "mean_removal": a + b,
        "unstick_margin": jnp.ones(()),
        "removal": jnp.zeros((1, 1)),
        "load": jnp.zeros((1, 1)),
        "waves": Population(),
        "parts": (),
        "left": Start(),
        "maps": None,
    }
    fields: dict[str, Any] = {f.name: jnp.zeros(()) for f in dataclasses.fields(Outcome)}
    return Outcome(**(fields | given))


def explorer(most=MOST, **more):
    limits = Limits(most_removal=jnp.asarray(most, dtype=float))
    return Explorer(
        SETUP, START, BETWEEN, TARGET, limits, NAMES, drawn=64, chain=known, **more
    )


class Killed(BaseException):
    """Like `KeyboardInterrupt`, nothing that anyone would catch on the way."""


@pytest.fixture(scope="module")
def explored():
    return explorer()


def columns(found: Front):
    return np.asarray([point.values for point in found.points]).T


def test_a_front_that_bends_inwards_is_found_as_a_whole(explored):
    found = front(explored, ("force", "spread"), 9)
    force, spread = columns(found)
    # on the front both settings are one
    x = np.sqrt(-np.log(1 - spread) / 2) - MIDDLE
    assert_close(force, 1 - np.exp(-2 * (x - MIDDLE) ** 2), rtol=0, atol=1e-5)
    assert len(found.points) >= 8
    assert spread[0] < 1e-5
    assert force[-1] < 1e-5
    # a weighted sum would give but the two ends of it; here no gap is wide
    assert np.hypot(np.diff(force), np.diff(spread)).max() < 0.35
    assert (np.diff(spread) > 0).all()
    assert (np.diff(force) < 0).all()


def test_a_front_against_the_target_and_its_price(explored):
    found = front(explored, ("miss", "time"), 7)
    assert found.names == ("time", "miss")
    time, miss = columns(found)
    # Ssk = a is (2 - a)/0.5 tolerances from its goal
    assert_close(miss[[0, -1]], [2.0, 6.0], rtol=0, atol=2e-3)
    assert_close(time, (3 - 0.5 * miss) ** 2 + 1, rtol=1e-5)
    slopes = [point.slope for point in found.points]
    assert_close(slopes[1:-1], 3 - 0.5 * miss[1:-1], rtol=1e-3)


def test_of_removal_more_is_better(explored):
    found = front(explored, ("time", "mean_removal"), 6)
    time, removal = columns(found)
    assert_close(removal[[0, -1]], [MOST, 1.0], rtol=0, atol=2e-3)
    assert_close(time, (removal - 1) ** 2 + 1, rtol=1e-5)
    assert (np.diff(removal) < 0).all()


@pytest.fixture(scope="module")
def reached(explored):
    return region(explored, ("Ssk", "Sku"), 9)


def test_a_region_that_bends_inwards_is_found_as_a_whole(reached):
    low, high = (
        np.asarray([point.values for point in side]).T
        for side in (reached.low, reached.high)
    )
    assert min(low.shape[1], high.shape[1]) >= 11
    assert_close(low[0, [0, -1]], [-1.0, 1.0], rtol=0, atol=1e-6)
    for skewness, _ in (low, high):
        assert (np.diff(skewness) > 0).all()
    inner = slice(1, -1)
    assert_close(low[1, inner], 3 - low[0, inner] ** 2, rtol=0, atol=1e-5)
    upper = 3 - high[0] ** 2 + np.minimum(2, MOST - high[0])
    assert_close(high[1, inner], upper[inner], rtol=0, atol=1e-5)


def test_nothing_drawn_lies_outside(reached):
    skewness, kurtosis = reached.drawn.T
    assert (kurtosis >= 3 - skewness**2 - 1e-12).all()
    assert (kurtosis - 3 + skewness**2 + skewness <= MOST + 1e-12).all()


def test_what_was_drawn_is_in_the_region_even_where_no_search_ends(explored, monkeypatch):
    """Searches from outside all fail: what was drawn there stands for itself."""
    real = Explorer.ask

    def lame(self, asked):
        answers = real(self, asked)
        outside = [len(places) == 1 and places[0] in self.drawn for _, places in asked]
        return [None if o else a for o, a in zip(outside, answers, strict=True)]

    monkeypatch.setattr(Explorer, "ask", lame)
    found = region(explored, ("Ssk", "Sku"), 2)
    # the upper end is bent outwards: with two slices and both ends it would cut off a lot
    high = np.asarray([point.values for point in found.high]).T
    skewness, kurtosis = found.drawn.T
    inside = (skewness > high[0, 1]) & (skewness < high[0, -2])
    assert high.shape[1] > 4
    over = (kurtosis - np.interp(skewness, *high))[inside]
    assert over.max() < 0.04 * np.std(explored.shown(explored.names.index("Sku")))


def test_settings_give_the_outcomes_that_are_claimed(reached):
    for point in (*reached.low, *reached.high):
        process = dataclasses.replace(START, **point.settings)
        outcome = known(process, SETUP)
        assert_close(point.values, [outcome.Ssk, outcome.Sku])
        for name, (least, most) in BETWEEN.items():
            assert least <= point.settings[name] <= most


def test_limits_that_nothing_keeps_leave_nothing():
    strict = explorer(-10.0)
    assert not (strict.over <= 0).any()
    assert front(strict, ("force", "spread"), 4).points == ()
    assert region(strict, ("Ssk", "Sku"), 4).low == ()


def test_a_front_goes_on_where_it_was(explored, monkeypatch):
    runs, real, store, order = [], explore._search, {}, itertools.count()

    def counted(*given):
        runs.append(given)
        if next(order) == 4:
            raise Killed
        return real(*given)

    monkeypatch.setattr(explore, "_search", counted)
    with pytest.raises(Killed):
        front(explorer(store=store), ("force", "spread"), 5)
    for other in threading.enumerate():  # with a batch under way, which is kept
        if other.name.startswith("ThreadPool"):
            other.join()
    done, before = len(store), len(runs)
    assert 3 <= done <= 6
    again = front(explorer(store=store), ("force", "spread"), 5)
    total = len(runs) - before + done
    runs.clear()
    assert front(explorer(store=store), ("force", "spread"), 5).points == again.points
    assert not runs
    assert total == len(store)
    fresh = front(explored, ("force", "spread"), 5)
    assert fresh.points == again.points


@pytest.mark.parametrize(
    ("change", "fragment"),
    [
        ({"between": {}}, "`between` is empty"),
        ({"target": {}}, "`target` is empty"),
        ({"names": ("beauty", "time")}, "'beauty' is no outcome"),
        ({"names": ("removal", "time")}, "'removal' is no outcome with one value"),
    ],
)
def test_senseless_questions_are_refused(change, fragment):
    given = {"between": BETWEEN, "target": TARGET, "names": NAMES} | change
    with pytest.raises(ValueError, match=fragment):
        Explorer(
            SETUP,
            START,
            given["between"],
            given["target"],
            None,
            given["names"],
            drawn=2,
            chain=known,
        )


def test_senseless_pairs_are_refused(explored):
    with pytest.raises(ValueError, match="two outcomes"):
        front(explored, ("time", "time"))
    with pytest.raises(ValueError, match="none of the explorer's"):
        region(explored, ("Sq", "Ssk"))


def twice(processes, plan: Plan) -> PlanOutcome:
    """Two steps that know nothing of each other."""
    steps = tuple(map(known, processes, plan.setups))
    return PlanOutcome(plan.names, steps)


def test_of_a_plan_any_step_can_be_asked_about():
    plan = Plan(("first", "last"), (SETUP, SETUP))
    outcome = twice((dataclasses.replace(START, tilt=0.1), START), plan)
    assert_close(value(outcome, "Ssk"), START.tilt)
    assert_close(value(outcome, "first Ssk"), 0.1)
    assert_close(value(outcome, "time"), outcome.time)
    with pytest.raises(ValueError, match="'middle Ssk' is no outcome"):
        value(outcome, "middle Ssk")
    limits = PlanLimits((Limits(), Limits(most_removal=jnp.asarray(MOST))))
    between = {"last tilt": (-1.0, 1.0), "last step": (0.0, 2.0)}
    asked = Explorer(
        plan,
        (START, START),
        between,
        {},
        limits,
        ("last Ssk", "Sku"),
        drawn=32,
        chain=twice,
    )
    found = region(asked, ("last Ssk", "Sku"), 4)
    for point in found.low[1:-1]:
        assert_close(point.values[1], 3 - point.values[0] ** 2, rtol=0, atol=1e-5)
        assert set(point.settings) == set(between)


def test_pictures_show_what_is_known(reached):
    figure = region_figure(
        ("Ssk", "Sku"), reached.drawn, {"Ssk": Aim(1.2, 0.1)}, (0.9, 2.5), reached
    )
    (axes,) = figure.axes
    assert axes.get_xlabel() == "Ssk [-]"
    legend = axes.get_legend()
    assert legend is not None
    named = {text.get_text() for text in legend.get_texts()}
    assert {"within reach", "target", "answer"} <= named
    low, high = axes.get_xlim()
    assert low < -1
    assert high > 1.3
    drawn = np.array([[60.0, 1.0], [600.0, 2.0]])
    empty = Front(("time", "miss"), (), drawn, 0)
    (axes,) = front_figure(empty).axes
    assert axes.get_ylabel() == "time [min]"
    assert_close(shown("time", 90.0), 1.5)
    nothing = Region(("Ssk", "Sku"), (), (), np.zeros((0, 2)), 0)
    box = {"Ssk": Aim(0.0, 0.1), "Sku": Aim(3.0, 0.1)}
    assert region_figure(nothing.names, nothing.drawn, box, None, nothing).axes


def test_what_to_relax_is_the_bound_in_the_way(tmp_path):
    """Ssk can be 1, and 2 is asked for: a fifth more would leave 0.8 of the distance."""
    loaded = load(CONFIGS / "pessoles2009_plane.yaml")
    limits = Limits(most_removal=jnp.asarray(MOST))
    asked = Job(SETUP, START, BETWEEN, {"Ssk": TARGET["Ssk"]}, limits)
    tuning = tune(SETUP, START, BETWEEN, asked.target, limits, starts=4, chain=known)
    assert relax.missed(tuning)
    assert_close(relax.distance(tuning), 2.0, rtol=1e-6)
    (one,) = relax.relaxations(tuning, asked, loaded)
    assert one.what == "upper bound of tilt"
    assert one.by == f"{np.degrees(0.2):.3g} ° more"
    # half the squared distance falls by 4 per radian
    assert_close(one.distance, np.sqrt(4 - 2 * 4 * 0.2), rtol=1e-6)
    table = relax.relax_table(tuning, asked, loaded)
    assert table is not None
    assert table.row_count == 1
    assert "polishopt.front" in relax.pointer(loaded, tmp_path)


@pytest.mark.parametrize(
    ("more", "fragment"),
    [
        (["--points=1"], "--points is 1, must be 2 or more"),
        (["--trade", "time", "beauty"], "'beauty' is no outcome"),
        (["--region", "Ssk", "Ssk"], "'Ssk' is there twice"),
    ],
)
def test_the_command_refuses_what_makes_no_sense(tmp_path, more, fragment, capsys):
    config = str(CONFIGS / "pessoles2009_plane.yaml")
    assert main([config, "-o", str(tmp_path), "--no-cache", *more]) == 2
    said = capsys.readouterr().err
    assert fragment in said
    assert "Traceback" not in said


@pytest.mark.slow
def test_the_command_draws_front_and_region(tmp_path):
    given = [str(CONFIGS / "pessoles2009_diamond.yaml"), "-o", str(tmp_path), "--points=4"]
    small = ["--set=guide.order=1", "--set=sampling.grid=12", "--quiet"]
    assert main([*given, *small, "--no-cache"]) == 0
    names = {path.name for path in tmp_path.iterdir()}
    kinds = ("csv", "png", "svg")
    assert names == {"front_searches"} | {
        f"{n}.{k}" for n in ("front", "region") for k in kinds
    }
    rows = list(csv.DictReader((tmp_path / "front.csv").read_text().splitlines()))
    times = [float(row["time [min]"]) for row in rows]
    assert times == sorted(times, reverse=True)


def test_the_table_tells_the_unit_of_a_price(tmp_path):
    """Half a minute saved per tolerance, and per cent of spread."""
    loaded = load(CONFIGS / "pessoles2009_plane.yaml")
    settings = {"tilt": 0.1, "displacement": 0.4, "step": 1.0, "trochoid_radius": 6.0}
    drawn = np.ones((1, 2))
    area = Region(("Ssk", "Sku"), (), (), drawn, 1)
    for second, unit, slope in (("miss", "tolerance", 30.0), ("spread", "%", 3000.0)):
        points = tuple(
            Point((t, v), settings, slope) for t, v in ((60.0, 0.1), (30.0, 1.1))
        )
        write(tmp_path, loaded, {}, Front(("time", second), points, drawn, 1), area)
        (first, _) = csv.DictReader((tmp_path / "front.csv").read_text().splitlines())
        assert float(first[f"time saved per unit of {second} [min/{unit}]"]) == 0.5
