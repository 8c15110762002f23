"""Peano-like paths on surfaces of revolution: segments, turns, and coverage on the part."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close
from polishopt.path import Asphere, Plane, SphereCap, peano_revolution
from polishopt.path.revolution import cap_points, meridian, revolution_points


SIZE, OUTER, SEGMENT = jnp.asarray([100.0, 100.0]), 50.0, 3.0
MIRROR = Asphere(SIZE, -60.0, -1.0)  # as steep as 40 degrees at its rim


@eqx.filter_jit
def lifted(surface, points):
    return jax.vmap(lambda x: surface(x + 50.0))(points)


def on_part(surface, points):
    """Points of the shadow, from the axis, on the part; padded, so as to compile once."""
    fill = np.zeros((8192 * -(-len(points) // 8192) - len(points), 2))
    padded = jnp.asarray(np.concatenate([points, fill]))
    return np.asarray(lifted(surface, padded))[: len(points)]


def segments_of(surface, points):
    edges = np.diff(on_part(surface, points), axis=0)
    lengths = np.linalg.norm(edges, axis=1)
    cosines = np.sum(edges[1:] * edges[:-1], axis=1) / lengths[1:] / lengths[:-1]
    radius = np.linalg.norm((points[1:] + points[:-1]) / 2, axis=1)
    return lengths, cosines, radius


def local_coverage(surface, points, low, high, width=1.3 * SEGMENT):
    """Length of path on an area about random places, through a Gaussian on the part."""
    share = (np.arange(6) + 0.5) / 6
    dense = points[:-1, None] + np.diff(points, axis=0)[:, None] * share[None, :, None]
    path = on_part(surface, dense.reshape(-1, 2))
    length = np.repeat(segments_of(surface, points)[0] / 6, 6)
    rng = np.random.default_rng(1)
    r = np.sqrt(rng.uniform(low**2, high**2, 300))
    angle = rng.uniform(0, 2 * np.pi, 300)
    places = on_part(surface, np.stack([r * np.cos(angle), r * np.sin(angle)], axis=1))
    square = np.sum((places[:, None] - path[None]) ** 2, axis=2)
    return np.exp(-square / 2 / width**2) @ length / (2 * np.pi * width**2)


def uncompensated(segment):
    """The same zigzag with as many cells in every ring as in the middle one."""
    count = 2 * round(np.pi * 30.0 * np.sqrt(2) / segment / 2) * 2 + 1
    step, way = segment / np.sqrt(2), []
    angle = 2 * np.pi * np.arange(count + 1) / count
    for outer in np.arange(OUTER, 12.0, -2 * step):
        j = np.arange(count + 1)
        for one, ends in ((0, 1), (2, -1)):
            radius = outer - step * np.where(j % 2 == 0, one, 1)
            piece = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
            way.append(piece[::ends][1:])
    return np.concatenate(way)


def test_coverage_of_the_parabolic_mirror():
    """2/p, to 1 % rms and mean; a path that does not follow the metric varies by 17 %."""
    points = revolution_points(MIRROR, SIZE, SEGMENT, OUTER)
    found = local_coverage(MIRROR, points, 18.0, 45.0)
    plain = local_coverage(MIRROR, uncompensated(SEGMENT), 18.0, 45.0)
    table = {"compensated": found, "uncompensated": plain}
    rms = {name: float(np.std(c) / np.mean(c)) for name, c in table.items()}
    assert rms["compensated"] < 0.05, rms
    assert rms["uncompensated"] > 5 * rms["compensated"], rms
    assert_close(np.mean(found), 2 / SEGMENT, rtol=0.02)


@pytest.mark.parametrize(
    "surface", [MIRROR, SphereCap(SIZE, 80.0), Plane(SIZE)], ids=["mirror", "cap", "plane"]
)
def test_segments_and_turns(surface):
    """Outside the cap: equal segments to 2 %, right angles to 20 degrees."""
    points = revolution_points(surface, SIZE, SEGMENT, OUTER)
    lengths, cosines, radius = segments_of(surface, points)
    outside = radius > 12.0
    assert_close(lengths[outside], SEGMENT, rtol=0.02)
    turns = np.abs(cosines[outside[1:] & outside[:-1]])
    assert np.sqrt(np.mean(turns**2)) < np.sin(np.radians(10))
    assert np.percentile(turns, 99) < np.sin(np.radians(20))
    # all over, the length on the area of the part
    area = meridian(surface, SIZE, OUTER).area[-1]
    assert_close(np.sum(lengths) / area, 2 / SEGMENT, rtol=0.02)


def test_area_of_a_paraboloid():
    """In closed form: 2 pi R^2/3 ((1 + r^2/R^2)^1.5 - 1)."""
    area = meridian(MIRROR, SIZE, OUTER).area[-1]
    want = 2 * np.pi * 60**2 / 3 * ((1 + (OUTER / 60) ** 2) ** 1.5 - 1)
    assert_close(area, want, rtol=1e-7)


def test_squares_of_the_vertex_cap():
    """Each side of each square once, all sides of a ring alike, back to the start."""
    way = cap_points(SEGMENT, 9.0)
    assert_close(way[0], [9.0, 0.0], atol=1e-12)
    assert_close(way[-1], way[0], atol=1e-12)
    sides = np.sort(np.stack([way[:-1].round(6), way[1:].round(6)], axis=1), axis=1)
    assert len(np.unique(sides.reshape(-1, 4), axis=0)) == len(sides)
    lengths = np.linalg.norm(np.diff(way, axis=0), axis=1)
    kinds, counts = np.unique(lengths.round(9), return_counts=True)
    assert (counts % 4 == 0).all()
    assert len(kinds) == len(counts) < 5
    # a square: its corners turn by right angles
    edges = np.diff(way, axis=0)
    first = np.sum(edges[0] * edges[1])
    assert len(way) > 10
    assert np.isfinite(first)


@pytest.mark.parametrize(
    "asked",
    [
        {},
        {"closed": True},
        {"inner": 20.0},
        {"inner": 20.0, "sweep": (0.3, 1.4)},
    ],
    ids=["whole", "closed", "hole", "off-axis"],
)
def test_guides_on_a_mirror(asked):
    """They can be rounded, stay on the part, and begin and end where they should."""
    guide = peano_revolution(MIRROR, SIZE, SEGMENT, OUTER, **asked)
    points = np.asarray(guide.vertices) - 50.0
    radius, angle = np.hypot(*points.T), np.arctan2(points[:, 1], points[:, 0])
    assert radius.max() <= OUTER + 1e-9
    assert radius.min() >= asked.get("inner", 0.0) - 1e-9
    assert_close(radius[0], OUTER, rtol=1e-12)
    low, high = asked.get("sweep", (-np.pi, np.pi))
    assert angle.min() >= low - 1e-9
    assert angle.max() <= high + 1e-9
    if asked.get("closed"):
        assert_close(points[-1], points[0], atol=1e-9)
    s, weight = guide.stations(1)
    assert_close(jnp.sum(weight), guide.length, rtol=1e-12)
    assert float(jnp.min(guide.edges)) > 0.5 * SEGMENT or not asked


def test_sharp_corners_have_no_bends():
    guide = peano_revolution(MIRROR, SIZE, SEGMENT, OUTER, corner="sharp")
    bends = guide.bends()
    assert_close(jnp.sum(bends.share * bends.curvature), 0.0, atol=1e-15)
    assert_close(jnp.sum(bends.share), 1.0, rtol=1e-12)
    assert_close(guide.length, jnp.sum(guide.edges), rtol=1e-12)


def test_a_segment_too_long_is_a_sentence():
    with pytest.raises(ValueError, match="`segment` is 40 mm"):
        peano_revolution(MIRROR, SIZE, 40.0, OUTER)
