"""Attribution: shares that add up, and what the model says about S0's convex part."""

import functools
import io
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close
from polishopt.attribution import main
from polishopt.files.assemble import job
from polishopt.files.config import load
from polishopt.files.results import write_attribution
from polishopt.mechanics import mechanics
from polishopt.optimize.attribution import EFFECTS, attribution, contributions, shapley
from polishopt.report import attribution_table
from rich.console import Console


CONFIGS = Path(__file__).parent.parent / "configs"
PLANE, CONVEX = (CONFIGS / f"pessoles2009_{part}.yaml" for part in ("plane", "convex"))
WATCHED = ("force", "contact_area", "pressure", "mean_removal", "time", "feed")


def game(value):
    """A value for each subset of the effects, from how many flags are up."""
    sets = {}
    for i in range(8):
        flags = [i >> k & 1 for k in range(3)]
        let_in = frozenset(e for e, f in zip(EFFECTS, flags, strict=True) if f)
        sets[let_in] = jnp.asarray([float(value(*flags))])
    return sets


def test_shares_of_games_that_are_known():
    # alone: each its own; a product of two: half to each; of three: a third to each
    alone = shapley(game(lambda a, b, c: 5 * a - 2 * b), EFFECTS)
    assert_close(alone[:, 0], [5.0, -2.0, 0.0])
    pair = shapley(game(lambda a, b, c: 4 * a * c), EFFECTS)
    assert_close(pair[:, 0], [2.0, 0.0, 2.0])
    three = shapley(game(lambda a, b, c: 6 * a * b * c + 7), EFFECTS)
    assert_close(three[:, 0], [2.0, 2.0, 2.0])
    orders = contributions(game(lambda a, b, c: 6 * a * b * c), EFFECTS, "feed")
    assert sorted(np.asarray(orders)[:, 0]) == [0, 0, 0, 0, 6, 6]


@functools.cache
def jobs():
    small = ["guide.order=2", "sampling.phases=8"]
    made = [job(load(path, small).config) for path in (PLANE, CONVEX)]
    return [(one.process, one.setup) for one in made]


@pytest.fixture(scope="module")
def split():
    """From the plane to the convex part; the texture would only take longer."""
    return attribution(*jobs(), outcomes=WATCHED, chain=mechanics)


def row(split, name):
    return dict(
        zip(split.effects, map(float, split.parts[WATCHED.index(name)]), strict=True)
    )


def test_the_parts_add_up(split):
    assert split.effects == ("contact", "stretch", "feed", "path")
    change = np.asarray(split.second - split.first)
    scale = np.abs(np.asarray(split.first))
    assert_close(np.asarray(split.parts).sum(axis=1) / scale, change / scale, atol=1e-12)
    assert (split.least <= split.parts + 1e-12 * scale[:, None]).all()
    assert (split.parts <= split.most + 1e-12 * scale[:, None]).all()


def test_what_curvature_does_to_the_convex_part(split):
    """Science 1.6: 0.47 of the force and 0.45 of the area on a radius of 100 mm."""
    ratio = dict(zip(WATCHED, np.asarray(split.second / split.first), strict=True))
    assert_close(ratio["force"], 0.47, rtol=0.02)
    assert_close(ratio["contact_area"], 0.45, rtol=0.02)
    for name in ("force", "contact_area", "pressure"):
        shares = row(split, name)
        whole = sum(shares.values())
        assert_close(shares["contact"], whole, rtol=1e-9)
    # what is removed falls with the contact; slower axes dwell longer and remove more
    removal, time = row(split, "mean_removal"), row(split, "time")
    assert removal["contact"] < 0 < removal["feed"]
    others = sum(abs(v) for k, v in removal.items() if k != "contact")
    assert abs(removal["contact"]) > 3 * others
    assert time["feed"] > 0
    assert time["contact"] == 0
    # a sphere cap of 50 mm has 2.2 % more area than its shadow (science 0.17), the way
    # over it is longer by about half of that
    plane = float(split.first[WATCHED.index("time")])
    assert 0.005 < time["stretch"] / plane < 0.022


def test_the_same_job_twice_has_nothing_to_split():
    plane, _ = jobs()
    twice = attribution(plane, plane, outcomes=WATCHED, chain=mechanics)
    assert not np.any(twice.parts)
    assert not np.any(twice.least)
    assert not np.any(twice.most)


def test_table_and_file(split, tmp_path):
    printed = io.StringIO()
    console = Console(width=80, file=printed, markup=False)
    console.print(attribution_table(split, "plane [old]", "convex"))
    shown = printed.getvalue()
    assert "…" not in shown, "it fits a terminal"
    # what stands in brackets is no markup
    assert "plane [old]" in shown
    for quantity in ("mean removal [µm]", "time [min]", "contact area [mm²]"):
        assert quantity in shown
    write_attribution(tmp_path / "a.csv", split, {"force": "N"})
    lines = (tmp_path / "a.csv").read_text().splitlines()
    assert lines[0] == "outcome,unit,effect,first,second,share,least,most"
    assert len(lines) == 1 + 4 * len(WATCHED)
    assert lines[1].startswith("force,N,contact,")


def test_bad_input_is_a_sentence(capsys, tmp_path):
    plan = CONFIGS / "pessoles2009_plan.yaml"
    assert main([str(PLANE), str(plan), "-o", str(tmp_path)]) == 2
    assert "must have one" in capsys.readouterr().err
    assert main([str(PLANE), str(tmp_path / "none.yaml")]) == 2
    assert "none.yaml" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
