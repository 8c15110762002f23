"""Coverage: closed forms on planes and caps, and what even sheets do to it."""

import dataclasses
import re
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close
from polishopt.contact.removal import Grid
from polishopt.coverage import coverage, path_lengths, uneven_coverage
from polishopt.evenness import remarks
from polishopt.files.assemble import job
from polishopt.files.config import load
from polishopt.mechanics import mechanics
from polishopt.path import Asphere, Plane, SphereCap, lines, peano
from polishopt.path.even import reparametrised
from polishopt.setup import FINE


CONFIGS = Path(__file__).parent.parent / "configs"
SIZE = (60.0, 60.0)
GRID = Grid(jnp.zeros(2), jnp.asarray(SIZE), (60, 60))
INNER = slice(12, 48)
covered = eqx.filter_jit(coverage)
pieces = eqx.filter_jit(path_lengths)
PLANE = Plane(jnp.asarray(SIZE))


def test_peano_on_the_plane():
    """2/p: exactly with sharp corners, all over and, to a thousandth, about each place."""
    guide = peano(3, SIZE, "sharp")
    p = float(guide.pitch)
    _, lengths = pieces(PLANE, guide)
    assert_close(jnp.sum(lengths) / 60**2, 2 / p, rtol=1e-12)
    found = np.asarray(covered(PLANE, guide, GRID, jnp.asarray(8 * p)))[INNER, INNER]
    assert_close(found.mean(), 2 / p, rtol=1e-3)
    assert_close(found, 2 / p, rtol=5e-3)


@pytest.mark.parametrize("one_way", [False, True])
def test_lines_on_a_cap(one_way):
    """|S_x| over the area's stretch and the step, lifted ways back left out."""
    radius, step = 60.0, 60 / 30
    cap = SphereCap(jnp.asarray(SIZE), radius)
    guide = lines(30, SIZE, "sharp", one_way=one_way)
    found = covered(cap, guide, GRID, jnp.asarray(4 * step))
    x, y = np.meshgrid(np.asarray(GRID.x) - 30, np.asarray(GRID.y) - 30)
    z = np.sqrt(radius**2 - x**2 - y**2)
    want = np.hypot(1, x / z) * z / radius / step
    assert_close(found[INNER, INNER], want[INNER, INNER], rtol=4e-3)


def test_an_even_sheet_is_covered_evenly():
    """A mirror as steep as 46 degrees, by a curve laid out on its shadow and by area."""
    mirror = Asphere(jnp.asarray(SIZE), -40.0, -1.0)
    guide = peano(3, SIZE, "sharp")
    sheet = eqx.filter_jit(reparametrised)(mirror, jnp.asarray(SIZE), 8)
    varies = []
    for surface in (mirror, sheet):
        found = np.asarray(covered(surface, guide, GRID, jnp.asarray(20.0)))[INNER, INNER]
        varies.append(found.std() / found.mean())
    assert varies[0] > 0.015
    assert varies[1] < 0.2 * varies[0], varies


def test_unevenness_on_a_cap_and_on_a_plane():
    """The closed form for lines, weighed alike all over; borders of the guide count out."""
    radius, size = 60.0, jnp.asarray(SIZE)
    guide = lines(30, SIZE, "sharp")
    uneven = eqx.filter_jit(uneven_coverage)
    found = uneven(SphereCap(size, radius), guide, size)
    x, y = np.meshgrid(*(2 * (0.5 + np.arange(200)) * 60 / 400 - 30 for _ in "xy"))
    z = np.sqrt(radius**2 - x**2 - y**2)
    want = np.hypot(1, x / z) * z / radius
    assert_close(found, want.std() / want.mean(), rtol=0.03)
    assert float(uneven(PLANE, guide, size)) < 1e-12


def said(path, *changes):
    given = job(load(path, changes).config)
    return [one.sentence for one in remarks(given.process, given.setup)]


@pytest.mark.slow
def test_a_report_tells_what_an_even_sheet_does():
    """On a steep cap; and nothing of a plane."""
    convex = CONFIGS / "pessoles2009_convex.yaml"
    covers = said(convex, "part.radius_mm=45", "guide.even=true")[0]
    used, given = map(float, re.findall(r"([\d.]+) %", covers))
    assert used < 0.5 * given
    covers = said(convex, "part.radius_mm=45")[0]
    assert [float(x) for x in re.findall(r"([\d.]+) %", covers)] == [given]
    assert "guide.even: true" in covers
    assert said(CONFIGS / "pessoles2009_plane.yaml") == []


@pytest.mark.slow
def test_a_report_tells_what_following_the_curvature_does():
    path = CONFIGS / "slender_insert.yaml"
    presses = said(path, "guide.hold=force")[-1]
    held, least, most = map(float, re.findall(r"([\d.]+)(?= to| N)", presses))
    assert most / least > 1.05
    assert least < held < most
    presses = said(path)[-1]
    assert f"{least:.4g} to {most:.4g} N" in presses
    assert "guide.hold: force" in presses


@pytest.mark.slow
def test_removal_on_an_even_cap_varies_no_more_than_on_the_plane():
    """Coefficient of variation of the removal map, S0's settings: with axes that keep up,
    on a B-C table, and on the Mikron with the pole off the part. Its C does not keep up
    there, and dwells."""
    plane = removal_varies("plane", "guide.corner=smooth")
    even = "guide.even=true"
    assert removal_varies("convex", even, ideal=("feed",)) < 1.1 * plane
    assert removal_varies("convex", even, "machine=table_table_bc") < 1.1 * plane
    assert removal_varies("convex", even, "process.wedge_y_deg=22") < 1.1 * plane
    assert removal_varies("convex", even) > 1.2 * plane


@eqx.filter_jit
def spread_of(process, setup):
    return mechanics(process, setup).spread


def removal_varies(name, *changes, ideal=()):
    made = job(load(CONFIGS / f"pessoles2009_{name}.yaml", changes).config)
    setup = dataclasses.replace(made.setup, sampling=FINE, idealised=ideal)
    return float(spread_of(made.process, setup))
