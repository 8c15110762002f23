"""Parts and guides of a config: what they become, and sentences for those that cannot."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close
from polishopt.files.answered import optimum
from polishopt.files.assemble import geometry, guide, surface
from polishopt.files.config import ConfigError, check, load
from polishopt.files.summary import describe
from polishopt.fit import main
from polishopt.path import Nurbs
from polishopt.path.even import Even


CONFIGS = Path(__file__).parent.parent / "configs"
SLENDER = (CONFIGS / "slender_insert.yaml").read_text()
MIRROR = (CONFIGS / "parabolic_mirror.yaml").read_text()
GUIDE = "  family: hilbert_rectangle\n  count: 4"
NET = SLENDER[SLENDER.index("  surface: nurbs") : SLENDER.index("\ntool:")]


def loaded(text, folder=CONFIGS):
    return check(text, folder / "bad.yaml")


def with_guide(text, lines):
    head, _, tail = text.partition("guide:\n")
    return f"{head}guide:\n{lines}\n{tail[tail.index('process:') :]}"


GUIDES = {
    "rectangle": ("  family: hilbert_rectangle\n  count: 2", 8 * 2),
    "peano": ("  family: peano\n  order: 1", 4 * 9 + 1),
    "lines": ("  family: lines\n  count: 3", 6),
    "one-way": ("  family: lines\n  count: 3\n  one_way: true", 10),
    "hatch": ("  family: hatch\n  count: 4\n  angle_deg: 60\n  corner: arc", None),
    "spiral": ("  family: spiral\n  turns: 2", 8),
    "round": ("  family: spiral\n  turns: 4\n  shape: round", None),
}


@pytest.mark.parametrize(("lines", "vertices"), GUIDES.values(), ids=GUIDES.keys())
def test_guides_of_a_config(lines, vertices):
    config = loaded(with_guide(SLENDER, lines)).config
    made = guide(config, None)
    assert np.isfinite(float(made.length))
    if vertices is not None:
        assert len(made.edges) == vertices - 1


def test_the_slender_insert_is_a_crown():
    config = load(CONFIGS / "slender_insert.yaml").config
    made = surface(config, jnp.asarray([60.0, 15.0]))
    assert isinstance(made, Even)
    assert isinstance(made.surface, Nurbs)
    x, y = 7.0, -3.0
    got = made.surface(jnp.asarray([30 + x, 7.5 + y]))
    # the parabolas through 0.75 and 0.1875 mm at the ends
    want = [x, y, -0.75 * (x / 30) ** 2 - 0.1875 * (y / 7.5) ** 2]
    assert_close(got, want, atol=1e-12)
    assert "nurbs, 3 x 3 control points" in describe(load(CONFIGS / "slender_insert.yaml"))


GRID = "\n".join(
    f"{x}, {y}, {-(x**2) / 600 - y**2 / 60}"
    for x in np.linspace(-30, 30, 9)
    for y in np.linspace(-7.5, 7.5, 6)
)


def grid_config(keys="  columns: 6\n  control_points: [5, 4]"):
    points = f"  surface: point_grid\n  size_mm: [60, 15]\n  file: points.csv\n{keys}\n"
    return SLENDER.replace(NET, points)


def test_a_measured_grid_becomes_a_surface(tmp_path):
    """The file is found beside the config, and from where an answer is written."""
    (tmp_path / "points.csv").write_text(GRID)
    text = grid_config().replace("  even: true\n", "")
    found = loaded(text, tmp_path)
    made = surface(found.config, jnp.asarray([60.0, 15.0]))
    assert_close(made(jnp.asarray([0.0, 0.0])), [-30, -7.5, -2.4375], atol=2e-3)
    (tmp_path / "elsewhere").mkdir()
    assert "file: ../points.csv" in optimum(found, {}, tmp_path / "elsewhere")


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (GRID.replace("0.0, -7.5, -0.9375", "0.0, -7.5, nan"), "line 25 (row 5, column 1)"),
        (GRID + "\n1, 2", "holds 2 numbers, must hold three"),
        (GRID + "\n1, 2, 3", "two or more whole rows of 6"),
        ("1, 2, x", "must be three numbers"),
        (None, "cannot be read"),
        ("\n".join(GRID.splitlines()[:18]), "must not exceed the points, 3 rows of 6"),
    ],
)
def test_point_grids_with_mistakes(content, says, tmp_path):
    if content is not None:
        (tmp_path / "points.csv").write_text(content)
    with pytest.raises(ConfigError) as caught:
        loaded(grid_config(), tmp_path)
    assert says in str(caught.value)


BAD = {
    "side_of_no_length": (SLENDER.replace("[60, 15]", "[60, 0]"), "must lie in (0, 2000]"),
    "order_0": (MIRROR.replace("order: 2", "order: 0"), "order is 0, must lie in [1, 4]"),
    "order_12": (MIRROR.replace("order: 2", "order: 12"), "must lie in [1, 4]"),
    "ratio": (MIRROR.replace("[50, 50]", "[50, 40]"), "a whole number as the ratio"),
    "too_many_cells": (SLENDER.replace("count: 4", "count: 100"), "over 16384 cells"),
    "fillet": (SLENDER.replace("count: 4", "count: 4\n  fillet: 0.7"), "(0, 0.5]"),
    "knots": (
        SLENDER.replace("  degrees: [2, 2]", "  degrees: [2, 2]\n  u_knots: [0, 1]"),
        "holds 2 knots, must hold 6",
    ),
    "ragged": (SLENDER.replace(", [-30, 7.5, -0.9375]]", "]"), "rows of equal length"),
    "degree": (
        SLENDER.replace("degrees: [2, 2]", "degrees: [3, 2]"), "below the 3 control",
    ),
    "nan": (SLENDER.replace("[0, 0, 0.9375]", "[0, 0, .nan]"), "must be a finite number"),
    "conic_ends": (
        MIRROR.replace("conic: -1", "conic: 90"), "the conic ends before the corners",
    ),
    "no_revolution": (
        with_guide(SLENDER, "  family: peano_round\n  segment_mm: 2"),
        "needs a surface of revolution",
    ),
    "segment": (
        with_guide(MIRROR, "  family: peano_round\n  segment_mm: 20"), "at most a sixth",
    ),
    "lines": (with_guide(SLENDER.replace("[60, 15]", "[5, 60]"),
                         "  family: hatch\n  count: 3"), "lines of 5 mm cannot turn"),
}  # fmt: skip


@pytest.mark.parametrize(("text", "says"), BAD.values(), ids=BAD.keys())
def test_mistakes_are_sentences(text, says):
    with pytest.raises(ConfigError) as caught:
        loaded(text)
    assert says in str(caught.value)


FOLDED = SLENDER.replace("[0, -7.5, 0.5625], [0, 0, 0.9375], [0, 7.5, 0.5625]",
                         "[90, -7.5, 0], [90, 0, 0], [90, 7.5, 0]")  # fmt: skip
FLAT = SLENDER.replace("7.5, ", "0, ")


@pytest.mark.parametrize(("text", "says"), [(FOLDED, "folds over"), (FLAT, "no area")])
def test_parts_that_only_show_when_made(text, says):
    assert says in geometry(loaded(text).config)


def test_the_command_answers_with_a_sentence(tmp_path, capsys):
    path = tmp_path / "folded.yaml"
    path.write_text(FOLDED)
    assert main([str(path), "-o", str(tmp_path / "out"), "--no-cache"]) == 2
    said = capsys.readouterr().err
    assert "folded.yaml: the surface folds over" in said
    assert list(tmp_path.iterdir()) == [path]


def test_a_fillet_larger_than_the_lines_allow_is_a_sentence(tmp_path, capsys):
    path = tmp_path / "narrow.yaml"
    lines = with_guide(
        SLENDER.replace("[60, 15]", "[10, 50]"), "  family: lines\n  count: 6"
    )
    path.write_text(lines)
    assert main([str(path), "-o", str(tmp_path / "out"), "--no-cache"]) == 2
    assert "`fillet` is 0.5 pitches, must be at most 0.1" in capsys.readouterr().err


@pytest.mark.parametrize("closed", ["true", "false"])
def test_peano_round_on_the_mirror(closed):
    lines = f"  family: peano_round\n  segment_mm: 4\n  closed: {closed}"
    config = loaded(with_guide(MIRROR, lines)).config
    made = guide(config, surface(config, jnp.asarray([50.0, 50.0])))
    # 2/p on the disc, less what the corners and the vertex save
    assert 0.75 * 2 / 4 < float(made.length) / (np.pi * 625) < 2 / 4
