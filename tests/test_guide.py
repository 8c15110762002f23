"""Guides: lattices, lengths, smoothness and quadrature, against independent counts."""

import itertools
import math
import time

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close
from polishopt.path import (
    hatch,
    hilbert,
    hilbert_rectangle,
    lines,
    peano,
    polyline,
    round_spiral,
    segments,
    spiral,
)
from polishopt.path.corner import shapes, unit_corner, unit_curvature
from polishopt.path.families import hilbert_cells
from polishopt.path.polyline import Polyline


SQUARE = (50.0, 50.0)
STAIRS = np.array([[0, 0], [2, 0], [3, 0], [3, 1.5], [1, 1.5], [1, 5], [4, 5.0]])
ZIGZAG = np.array([[0, 0], [2, 0], [3, 2], [5, 2], [4.5, 1], [7, 1], [7, 4], [5, 3.9]])
WIDE, SLENDER = (50.0, 300.0), (60.0, 15.0)
GUIDES = {
    "hilbert-smooth": hilbert(3, SQUARE),
    "hilbert-arc": hilbert(3, SQUARE, "arc"),
    "hilbert-sharp": hilbert(3, SQUARE, "sharp"),
    "lines-smooth-tight": lines(5, (50.0, 30.0), fillet=0.2),
    "lines-narrow": lines(9, WIDE, fillet=0.25),
    "stairs-smooth": polyline(STAIRS, 4.0),
    "stairs-arc-tight": polyline(STAIRS, 4.0, "arc", 0.3),
    "line": lines(1, (50.0, 20.0)),
    "zigzag-smooth": polyline(ZIGZAG, 4.0, relative=True),
    "zigzag-arc": polyline(ZIGZAG, 4.0, "arc", 0.4, relative=True),
    "rectangle": hilbert_rectangle(3, SLENDER),
    "peano": peano(2, SQUARE),
    "peano-slender-sharp": peano(1, SLENDER, "sharp"),
    "one-way": lines(3, SLENDER, one_way=True),
    "hatch": hatch(5, (40.0, 30.0), 3, np.pi / 3),
    "spiral": spiral(2, SLENDER),
    "round": round_spiral(4, SQUARE),
}
POLYLINES = {name: g for name, g in GUIDES.items() if isinstance(g, Polyline)}
EACH = pytest.mark.parametrize("guide", GUIDES.values(), ids=GUIDES.keys())
EACH_POLYLINE = pytest.mark.parametrize("guide", POLYLINES.values(), ids=POLYLINES.keys())
SMOOTH_ONES = {name: g for name, g in POLYLINES.items() if g.corner == "smooth"}
SMOOTH = pytest.mark.parametrize("guide", SMOOTH_ONES.values(), ids=SMOOTH_ONES.keys())


def padded(function):
    """The function of (guide, s), compiled once per guide for up to 4096 points."""
    compiled = eqx.filter_jit(function)

    def call(guide, s):
        out = compiled(guide, jnp.pad(s, (0, 4096 - s.size), mode="edge"))
        return jax.tree.map(lambda x: x[: s.size], out)

    return call


statistics = eqx.filter_jit(segments)


@padded
def both(guide, s):
    """Points and their derivatives: one compilation for all tests of a guide."""

    def at(s):
        def twice(s):
            point = guide(s)
            return point, point

        _, rate, point = jax.jvp(twice, (s,), (jnp.ones_like(s),), has_aux=True)
        return point, rate

    return jax.vmap(at)(s)


def points(guide, s):
    return both(guide, s)[0]


def derivative(guide, s):
    return both(guide, s)[1]


def everywhere(guide, per_cell=23):
    """Points within every panel, and none on its ends."""
    per_cell = min(per_cell, 4096 // (guide.panels.size - 1))
    t = (np.arange(per_cell) + 0.37) / per_cell
    start = np.asarray(guide.panels)
    s = (start[:-1, None] + np.diff(start)[:, None] * t).ravel()
    return jnp.asarray(s) * guide.pitch


def hilbert_by_bits(order):
    """The curve's lattice cells from the bits of the distance along it."""
    n = 2**order
    path = []
    for d in range(n * n):
        x = y = 0
        t, side = d, 1
        while side < n:
            rx = 1 & (t // 2)
            ry = 1 & (t ^ rx)
            if ry == 0:
                if rx == 1:
                    x, y = side - 1 - x, side - 1 - y
                x, y = y, x
            x, y = x + side * rx, y + side * ry
            t //= 4
            side *= 2
        path.append((x, y))
    return np.array(path)


@pytest.mark.parametrize("order", range(1, 7))
def test_hilbert_against_the_bit_algorithm(order):
    """The same curve as the well-known one, up to a symmetry of the square."""
    ours = np.asarray(hilbert(order, SQUARE).vertices)
    n = 2**order
    lattice = ours * n / 50 - 0.5
    assert_close(lattice, np.round(lattice), atol=1e-12)
    assert_close(np.abs(np.diff(lattice, axis=0)).sum(axis=1), 1.0)
    assert len(np.unique(np.round(lattice), axis=0)) == n * n
    theirs = hilbert_by_bits(order)
    symmetries = []
    for path in (theirs, theirs[:, ::-1]):
        for way in (path, path[::-1]):
            for fx in (False, True):
                for fy in (False, True):
                    flipped = np.where([fx, fy], n - 1 - way, way)
                    symmetries.append(np.abs(flipped - lattice).max())
    assert min(symmetries) < 1e-9


def hilbert_by_recursion(order):
    """S0 Eqs. 3 and 4, one point at a time."""
    if order == 0:
        return [(0.0, 0.0)]
    last = hilbert_by_recursion(order - 1)
    return (
        [(0.5 * (-0.5 + y), 0.5 * (-0.5 + x)) for x, y in last]
        + [(0.5 * (-0.5 + x), 0.5 * (0.5 + y)) for x, y in last]
        + [(0.5 * (0.5 + x), 0.5 * (0.5 + y)) for x, y in last]
        + [(0.5 * (0.5 - y), 0.5 * (-0.5 - x)) for x, y in last]
    )


@pytest.mark.parametrize("order", range(1, 7))
def test_hilbert_against_the_recursion(order):
    guide = hilbert(order, SQUARE, corner="sharp")
    want = (0.5 + np.array(hilbert_by_recursion(order))) * 50
    assert_close(guide.vertices, want, atol=1e-13)
    # and the curve itself passes through them
    s = jnp.arange(4**order, dtype=float) * guide.pitch
    assert_close(points(guide, s).position, want, atol=1e-12)


@pytest.mark.parametrize(
    ("order", "length"), [(1, 75.0), (2, 187.5), (3, 393.75), (4, 796.875), (5, 1598.4375)]
)
def test_sharp_lengths(order, length):
    """L (2^n - 2^-n)."""
    assert_close(hilbert(order, SQUARE, corner="sharp").length, length, rtol=1e-13)


@pytest.mark.parametrize(("order", "turns"), [(3, 50), (4, 204)])
def test_arcs_cut_the_corners(order, turns):
    """Each full fillet saves (2 - pi/2) h/2."""
    arcs, sharp = hilbert(order, SQUARE, "arc"), hilbert(order, SQUARE, "sharp")
    assert np.sum(np.asarray(arcs.cells.turn) != 0) == turns
    saved = turns * (2 - np.pi / 2) * 50 / 2**order / 2
    assert_close(sharp.length - arcs.length, saved, rtol=1e-12)


def test_smooth_corner_against_quadrature():
    """The polynomial against 60-point Gauss-Legendre from the start, at 1e-14.

    Up to 1e-13 for turns sharper than a right angle; both legs end where they should.
    """
    x, w = np.polynomial.legendre.leggauss(60)
    angles = np.array([0.2, np.pi / 2, 2.0, 2.9])
    made = shapes("smooth", angles)
    t = np.linspace(0, 1, 41)

    def corners(t):
        return jax.vmap(lambda shape: unit_corner("smooth", shape, t))(made)

    along, across, heading = jax.jit(jax.vmap(corners))(jnp.asarray(t))
    for i, (angle, length) in enumerate(zip(angles, made.length, strict=True)):
        tau = t[:, None] * (x + 1) / 2
        h = angle * (6 * tau**5 - 15 * tau**4 + 10 * tau**3)
        near = 2e-14 if angle < 1.6 else 2e-13
        assert_close(along[:, i], length * t / 2 * (np.cos(h) @ w), atol=near)
        assert_close(across[:, i], length * t / 2 * (np.sin(h) @ w), atol=near)
        end = angle * (6 * t**5 - 15 * t**4 + 10 * t**3)
        assert_close(heading[:, i], end, atol=1e-15)
        want = [1 + np.cos(angle), np.sin(angle)]
        assert_close(jnp.stack([along[-1, i], across[-1, i]]), want, atol=near)


def derivatives(function, at, order):
    """A function of a number and its derivatives up to an order, forwards."""

    def up_to(order):
        if order == 0:
            return lambda x: (function(x),)

        def more(x):
            known, slopes = jax.jvp(up_to(order - 1), (x,), (jnp.ones_like(x),))
            return *known, slopes[-1]

        return more

    return jnp.stack(up_to(order)(at))


@pytest.mark.parametrize("corner", ["smooth", "arc"])
def test_derivatives_within_a_corner_are_those_of_its_formula(corner):
    """By arc length up to the third, and these by the pitch, forwards and in reverse."""
    guide = polyline(np.array([[0, 0], [1, 0], [1.5, 1.0]]), 4.0, corner, 0.4)
    cell = jax.tree.map(lambda x: x[1], guide.cells)
    shape = jax.tree.map(lambda x: x[0], guide.shapes)
    begin, arc = cell.start + cell.entry - cell.leg, cell.leg * shape.length

    def known(s, pitch):
        at = eqx.tree_at(lambda g: g.pitch, guide, pitch)(s)
        return jnp.stack([*at.position, at.heading, at.curvature])

    def plain(s, pitch):
        t = (s / pitch - begin) / arc
        along, across, heading = unit_corner(corner, shape, t)
        bend = unit_curvature(corner, shape, t) / (cell.leg * pitch)
        x, y = 1 + cell.leg * (along - 1), cell.leg * across
        return jnp.stack([pitch * x, pitch * y, heading, bend])

    def orders(function, *modes):
        def all_orders(s, pitch):
            return derivatives(lambda s: function(s, pitch), s, 3)

        found = (all_orders, *(mode(all_orders, 1) for mode in modes))
        return [jax.jit(jax.vmap(f, (0, None)))(s, guide.pitch) for f in found]

    s = guide.pitch * (begin + arc * jnp.linspace(0.03, 0.97, 20))
    values, by_pitch = orders(plain, jax.jacfwd)
    for got, want in zip(
        orders(known, jax.jacfwd, jax.jacrev), (values, by_pitch, by_pitch), strict=True
    ):
        assert_close(got, want, rtol=1e-8, atol=1e-8)


@EACH
def test_the_parameter_is_arc_length(guide):
    """|dC/ds| = 1 in every cell, and dC/ds points along the heading."""
    s = everywhere(guide)
    rate, point = derivative(guide, s), points(guide, s)
    assert_close(jnp.sum(rate.position**2, axis=1), 1.0, atol=1e-11)
    tangent = jnp.stack([jnp.cos(point.heading), jnp.sin(point.heading)], axis=1)
    assert_close(rate.position, tangent, atol=1e-11)
    assert_close(rate.heading, point.curvature, atol=1e-11)


@EACH_POLYLINE
def test_the_curve_stays_near_its_polyline(guide):
    """Every point is within the fillet's reach of some vertex or edge."""
    s = everywhere(guide)
    p, v = np.asarray(points(guide, s).position), np.asarray(guide.vertices)
    a, d = v[:-1], np.diff(v, axis=0)
    t = np.einsum("pek,ek->pe", p[:, None] - a, d) / np.sum(d**2, axis=1)
    nearest = a + np.clip(t, 0, 1)[..., None] * d
    distance = np.linalg.norm(p[:, None] - nearest, axis=-1).min(axis=1)
    # no farther than the middle of the chord across the legs is from an edge
    reach = 0.5 * float(jnp.max(guide.cells.leg)) * float(guide.pitch)
    assert distance.max() <= reach + 1e-9


@EACH
def test_ends(guide):
    ends = points(guide, jnp.stack([jnp.zeros(()), guide.length])).position
    if isinstance(guide, Polyline):
        assert_close(ends, guide.vertices[jnp.asarray([0, -1])], atol=1e-11)
    # past its ends it goes straight on
    beyond = points(guide, jnp.stack([-jnp.ones(()), guide.length + 1]))
    assert_close(jnp.linalg.norm(beyond.position - ends, axis=1), 1.0, rtol=1e-9)
    assert_close(beyond.curvature, 0.0, atol=0)


def joints(guide):
    """Arc lengths at which the formula changes: ends of cells, of corners, of panels."""
    cells = guide.cells.end[:-1] if isinstance(guide, Polyline) else []
    ends = np.concatenate([cells, guide.panels[1:-1]])
    return jnp.asarray(ends) * guide.pitch


@EACH
def test_position_is_continuous(guide):
    s, tiny = joints(guide), 1e-9
    a, b = points(guide, s - tiny), points(guide, s + tiny)
    assert_close(a.position, b.position, atol=2.1e-9)
    if getattr(guide, "corner", "smooth") != "sharp":
        assert_close(a.heading, b.heading, atol=1e-8)


@SMOOTH
def test_curvature_and_its_derivative_are_continuous(guide):
    """Within 2e-6 of each other they change no more than a quintic's turn can."""
    s, tiny = joints(guide), 1e-6
    a, b = points(guide, s - tiny), points(guide, s + tiny)
    peak = float(jnp.max(jnp.abs(points(guide, everywhere(guide)).curvature)))
    # over the shortest corner
    arcs = guide.cells.leg * guide.shapes.length[guide.cells.kind]
    shortest = float(jnp.min(jnp.where(arcs > 0, arcs, 1.0)) * guide.pitch)
    slope = peak / shortest
    assert_close(a.curvature, b.curvature, atol=1e-9 + 1.2e-5 * slope)
    da, db = derivative(guide, s - tiny), derivative(guide, s + tiny)
    assert_close(da.curvature, db.curvature, atol=1e-3 * slope)


@pytest.mark.parametrize(
    "name",
    ["stairs-smooth", "zigzag-arc", "lines-smooth-tight", "hilbert-sharp", "round"],
)
def test_second_derivatives_are_finite_everywhere(name):
    """Forward over forward, also exactly at the joints, the ends and beyond."""
    guide = GUIDES[name]
    s = jnp.concatenate(
        [joints(guide), everywhere(guide, 5), jnp.asarray([0.0, -1.0]), guide.length[None]]
    )

    def slope(s):
        return jax.jvp(guide, (s,), (jnp.ones_like(s),))[1]

    second = jax.jit(jax.vmap(lambda s: jax.jvp(slope, (s,), (jnp.ones_like(s),))[1]))(s)
    first = derivative(guide, s)
    for leaf in jax.tree.leaves((first, second)):
        assert np.isfinite(leaf).all()
    # the side that holds at a joint is a whole one
    assert_close(jnp.sum(first.position**2, axis=1), 1.0, atol=1e-10)
    point = points(guide, s)
    normal = jnp.stack([-jnp.sin(point.heading), jnp.cos(point.heading)], axis=1)
    scale = 1 + float(jnp.max(jnp.abs(point.curvature)))
    bend = point.curvature[:, None] * normal
    if getattr(guide, "corner", "") == "smooth":
        assert_close(second.position, bend, atol=1e-9 * scale)


@EACH
@pytest.mark.parametrize("nodes", [1, 4])
def test_stations_sum_to_the_length(guide, nodes):
    s, weight = guide.stations(nodes)
    assert s.shape == weight.shape
    assert_close(jnp.sum(weight), guide.length, rtol=1e-13)
    assert (np.diff(s) > 0).all()
    assert (np.asarray(weight) > 0).all()
    assert weight.max() <= guide.pitch * (1 + 1e-12)


@EACH
def test_one_cell_stands_for_others(guide):
    """Any group length, the last group short; each node in the group that it stands for."""
    count = guide.panels.size - 1
    for one_in in (2, 5, count + 3):
        s, weight = guide.stations(2, one_in)
        groups = -(-count // one_in)
        assert s.size == 2 * groups
        ends = guide.pitch * guide.panels[np.minimum(one_in * np.arange(groups + 1), count)]
        assert_close(weight.reshape(-1, 2).sum(axis=1), jnp.diff(ends), rtol=1e-12)
        assert (s.reshape(-1, 2) > ends[:-1, None]).all()
        assert (s.reshape(-1, 2) < ends[1:, None]).all()


def test_cells_that_stand_for_others_are_a_fair_sample():
    """Means over a long curve of corners and straights, of what changes with the cell."""
    guide = hilbert(4, SQUARE, "smooth", 0.2)
    wanted = []
    for one_in in (1, 4):
        s, weight = guide.stations(4, one_in)
        p = points(guide, s)
        seen = jnp.stack([jnp.abs(p.curvature), jnp.cos(p.heading) ** 2, p.position[:, 0]])
        wanted.append(seen @ weight / jnp.sum(weight))
    assert_close(wanted[1], wanted[0], rtol=1 / math.sqrt(guide.panels.size / 4))


def test_stations_are_one_panel_a_cell():
    """Where full corners meet, the 64 cells of order 3 are the panels."""
    s, _ = hilbert(3, SQUARE).stations(1)
    # the first and last cells are half a straight edge
    assert s.size == 64


@EACH
def test_stations_integrate_to_gauss_accuracy(guide):
    """The integral of the tangent is the way from start to end; of curvature, the turn.

    The smooth corner is entire in s: 16 nodes reach rounding.
    """
    s, weight = guide.stations(16)
    p = points(guide, s)
    tangent = jnp.stack([jnp.cos(p.heading), jnp.sin(p.heading)], axis=1)
    ends = points(guide, jnp.stack([jnp.zeros(()), guide.length]))
    assert_close(weight @ tangent, ends.position[1] - ends.position[0], atol=1e-9)
    if getattr(guide, "corner", "") != "sharp":
        turned = ends.heading[1] - ends.heading[0]
        assert_close(weight @ p.curvature, turned, atol=1e-10)


@EACH
def test_bends_and_directions_are_those_of_the_curve(guide):
    """Means of powers of the curvature, and of the heading, against dense quadrature."""
    s, weight = guide.stations(16)
    p = points(guide, s)
    weight = weight * p.contact / (weight @ p.contact)
    assert_close(jnp.sum(guide.bends().share), 1.0, rtol=1e-12)
    assert_close(jnp.sum(guide.compass().share), 1.0, rtol=1e-12)
    bends = guide.bends()
    size = jnp.abs(p.curvature)
    for power, near in ((1, 3e-4), (2, 2e-2)):
        # where kinds of bends are merged, their mean is kept
        near = near if guide.bends().share.size < 30 else 0.1
        assert_close(bends.share @ bends.curvature**power, weight @ size**power, rtol=near)
    if guide is GUIDES["round"] or guide is GUIDES["hilbert-sharp"]:
        heading = jnp.cos(2 * p.heading) if guide is GUIDES["hilbert-sharp"] else 0.0 * s
        ways = guide.compass()
        assert_close(ways.share @ jnp.cos(2 * ways.aspect), weight @ heading, atol=1e-12)


def test_one_way_lifts_the_tool_on_its_way_back():
    """Three lines of 55 mm, two ways back; the tool goes up and down in the corners."""
    guide = lines(3, SLENDER, "sharp", one_way=True)
    p = points(guide, everywhere(guide))
    touching = np.asarray(p.contact) > 0.5
    assert_close(np.cos(p.heading)[touching], 1.0)
    assert (np.cos(p.heading)[~touching] < 0.5).all()
    assert_close(guide.contact_length, 3 * 55.0, rtol=1e-12)
    assert_close(guide.length, 5 * 55.0 + 4 * 2.5, rtol=1e-12)
    smooth = GUIDES["one-way"]
    s, weight = smooth.stations(16)
    assert_close(weight @ points(smooth, s).contact, smooth.contact_length, rtol=1e-9)
    step = derivative(smooth, joints(smooth)).contact
    assert_close(step, 0.0, atol=1e-9)


def test_hilbert_on_any_lattice():
    """Every cell of w x h lattices up to 40 x 40 once, by unit steps, none diagonal."""
    for columns, rows in itertools.product(range(1, 41), repeat=2):
        cells = hilbert_cells(columns, rows)
        visits = np.bincount(cells[:, 0] * rows + cells[:, 1])
        assert visits.tolist() == [1] * (columns * rows)
        assert cells[0].tolist() == [0, 0]
        assert (np.abs(np.diff(cells, axis=0)).sum(axis=1) == 1).all()


def test_hilbert_on_a_rectangle_is_laid_out_in_its_cells():
    guide = hilbert_rectangle(4, (50.0, 15.0))
    assert_close(guide.pitch, 15 / 4)
    vertices = np.round(np.asarray(guide.vertices), 9)
    assert_close(np.unique(vertices[:, 0]), (np.arange(13) + 0.5) * 50 / 13, atol=1e-8)
    assert_close(np.unique(vertices[:, 1]), (np.arange(4) + 0.5) * 15 / 4, atol=1e-8)


def turns_of(guide):
    edges = jnp.diff(guide.vertices, axis=0)
    return edges, jnp.sum(edges[1:] * edges[:-1], axis=1)


@pytest.mark.parametrize(("order", "size"), [(1, SQUARE), (2, SQUARE), (3, (15.0, 60.0))])
def test_peano(order, size):
    """Equal segments, each at a right angle to the last, and 2/p of them on an area."""
    guide = peano(order, size, "sharp")
    edges, dots = turns_of(guide)
    lengths = np.linalg.norm(edges, axis=1)
    assert_close(lengths, guide.pitch, rtol=1e-12)
    assert_close(dots / lengths[0] ** 2, 0.0, atol=1e-12)
    assert_close(guide.length / (size[0] * size[1]), 2 / guide.pitch, rtol=1e-12)
    # every cell is crossed once: the middles of the segments are all the cells
    side = min(size) / 3**order
    middles = np.asarray(guide.vertices[1:] + guide.vertices[:-1]) / 2 / side
    cells = np.floor(middles).astype(int)
    count = round(size[0] * size[1] / side**2)
    assert len({(x, y) for x, y in cells.tolist()}) == len(cells) == count
    assert_close(middles - cells, 0.5, atol=1e-9)


@pytest.mark.parametrize(
    "name", ["hilbert-smooth", "rectangle", "peano", "spiral", "round", "lines-narrow"]
)
def test_a_curve_does_not_meet_itself(name):
    """Points a pitch or more apart along the curve keep a distance in the plane."""
    guide = GUIDES[name]
    s = jnp.linspace(0.0, 1.0, 4096) * guide.length
    p = np.asarray(points(guide, s).position)
    far = np.abs(np.subtract.outer(s, s)) > 1.5 * float(guide.pitch)
    distance = np.linalg.norm(p[:, None] - p[None], axis=-1)
    # Peano's segments bend away from the corners that they share by 0.5 - 0.35 segments
    least = 0.25 if name == "peano" else 0.9
    assert distance[far].min() > least * float(guide.pitch)


def test_spirals_keep_their_distance():
    """A turn further out is a pitch away along the normal, everywhere on the round one."""
    guide = GUIDES["round"]
    s = jnp.linspace(0.0, 0.45, 200) * guide.length
    p = points(guide, s)
    a = guide.pitch / (2 * np.pi)
    turn = ((p.heading + 2 * np.pi) ** 2 - np.pi**2) * a / 2
    q = points(guide, turn)
    assert_close(jnp.linalg.norm(q.position - p.position, axis=1), guide.pitch, rtol=1e-12)
    # and it ends half a pitch from the border
    end = points(guide, guide.length[None]).position[0]
    assert_close(jnp.linalg.norm(end - 25.0), 25 - guide.pitch / 2, rtol=1e-12)
    square = spiral(2, SLENDER, "sharp")
    want = [60 - 3.75, 15 - 3.75, 60 - 3.75, 15 - 7.5, 60 - 7.5, 15 - 11.25, 60 - 11.25]
    assert_close(square.edges, want, rtol=1e-12)


def test_hatch_covers_the_part_at_each_angle():
    """Half of the way at 0 degrees and half at 90; at 60 degrees lines a pitch apart."""
    guide = hatch(8, SQUARE, 2, np.pi / 2, "sharp")
    found = statistics(guide)
    assert_close(found.directions[jnp.asarray([0, 18])], 0.5, atol=0.02)
    third = hatch(6, (40.0, 30.0), 2, np.pi / 3, "sharp")
    edges = np.diff(np.asarray(third.vertices), axis=0)
    along = np.abs(edges @ [np.cos(np.pi / 3), np.sin(np.pi / 3)])
    slanted = np.isclose(along, np.linalg.norm(edges, axis=1))
    offsets = np.asarray(third.vertices[:-1])[slanted] @ [-np.sin(np.pi / 3), 0.5]
    assert_close(np.diff(np.sort(offsets)), 5.0, rtol=1e-9)
    assert (np.asarray(third.vertices) > 2.499).all()
    assert (np.asarray(third.vertices) < np.array([37.501, 27.501])).all()


def test_segments_tell_peano_from_lines():
    """Peano's segments: one length, two directions in equal parts, a turn at each end."""
    found = statistics(peano(2, SQUARE))
    assert_close(found.lengths, 50 / 9 * np.sqrt(2), rtol=1e-12)
    assert_close(found.directions[jnp.asarray([9, 27])], np.full(2, 0.15), atol=0.05)
    straight = statistics(lines(9, SQUARE))
    assert straight.directions[0] > 0.8
    # 80 right angles on the way
    length = peano(2, SQUARE).length
    assert_close(found.turned, 80 * np.pi / 2 / length, rtol=1e-9)
    assert straight.turned < 0.3 * found.turned


def test_lines_layout():
    guide = lines(4, (50.0, 20.0), "sharp")
    assert_close(guide.pitch, 5.0)
    x0, x1 = 2.5, 47.5
    want = [
        [x0, 2.5],
        [x1, 2.5],
        [x1, 7.5],
        [x0, 7.5],
        [x0, 12.5],
        [x1, 12.5],
        [x1, 17.5],
        [x0, 17.5],
    ]
    assert_close(guide.vertices, want, rtol=1e-13)
    assert_close(guide.length, 4 * 45 + 3 * 5, rtol=1e-13)


def test_gradient_with_respect_to_the_pitch_and_the_size():
    """A uniform scale s moves C(s L) by C itself: dC/dpitch = (C - s C')/pitch."""
    guide = GUIDES["lines-smooth-tight"]
    s = everywhere(guide, 3)

    def at(pitch):
        return points(eqx.tree_at(lambda g: g.pitch, guide, pitch), s).position

    got = jax.jacfwd(at)(guide.pitch)
    rate = derivative(guide, s).position
    want = (at(guide.pitch) - s[:, None] * rate) / guide.pitch
    assert_close(got, want, atol=1e-10)

    def length(size):
        return hilbert(3, size).length

    got = jax.jit(jax.grad(length))(jnp.asarray(SQUARE))
    assert_close(jnp.sum(got), hilbert(3, SQUARE).length / 50, rtol=1e-12)


@pytest.mark.parametrize("make", [lambda a: hilbert(4, a), lambda a: lines(7, a)])
def test_no_hidden_units(make):
    """In metres, every length is a thousandth and every curvature a thousandfold."""
    mm, m = make((50.0, 50.0)), make((0.05, 0.05))
    s, _ = mm.stations(3)
    s_m, _ = m.stations(3)
    assert_close(s_m, 1e-3 * s, rtol=1e-12)
    a, b = points(mm, s), points(m, s * 1e-3)
    assert_close(b.position, 1e-3 * a.position, rtol=1e-11)
    assert_close(b.heading, a.heading, atol=1e-10)
    assert_close(b.curvature, 1e3 * a.curvature, atol=1e-6)


def test_single_precision():
    guide = hilbert(4, SQUARE)
    single = jax.tree.map(
        lambda x: x.astype(jnp.float32) if eqx.is_inexact_array(x) else x, guide
    )
    s, _ = guide.stations(4)
    got = points(single, s.astype(jnp.float32)).position
    assert got.dtype == jnp.float32
    # s itself is rounded by 5e-5 of a mm at 700 mm
    assert_close(got, points(guide, s).position, atol=3e-4)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: hilbert(0, SQUARE), "`order` is 0"),
        (lambda: hilbert(8, SQUARE), "`order` is 8"),
        (lambda: hilbert(3, (50.0, 40.0)), "must be square"),
        (lambda: hilbert(3, (0.0, 0.0)), "two sides above 0 mm"),
        (lambda: lines(3, (50.0, 0.0)), "two sides above 0 mm"),
        (lambda: hilbert_rectangle(0, SLENDER), "`count` is 0"),
        (lambda: hilbert_rectangle(200, SLENDER), "2 to 16384 cells"),
        (lambda: peano(12, SQUARE), "`order` is 12, must lie in 1..4"),
        (lambda: peano(1, (50.0, 40.0)), "whole number as the ratio"),
        (lambda: peano(4, (240.0, 60.0)), "must be lower"),
        (lambda: hatch(5, SQUARE, 0), "`repeats` is 0"),
        (lambda: hatch(1, SQUARE), "`count` is 1"),
        (lambda: spiral(0, SQUARE), "`turns` is 0"),
        (lambda: round_spiral(1, SQUARE), "`turns` is 1"),
        (lambda: hilbert(3, SQUARE, fillet=0.6), "`fillet` is 0.6"),
        (lambda: hilbert(3, SQUARE, fillet=0.0), "`fillet` is 0.0"),
        (lambda: hilbert(3, SQUARE, corner="round"), "`corner` is 'round'"),
        (lambda: lines(0, SQUARE), "`count` is 0"),
        (lambda: lines(1, (10.0, 50.0)), "`count` is 1"),
        (lambda: lines(6, (10.0, 50.0)), "`fillet` is 0.5"),
        (lambda: polyline(np.array([[0, 0], [1, 0], [0, 0.0]]), 1.0), "turn back"),
        (lambda: polyline(np.array([[0, 0], [9, 0], [0, 0.2]]), 1.0), "turn back"),
        (lambda: polyline(np.zeros((3, 2)), 1.0), "no two in a row"),
    ],
)
def test_errors_are_sentences(make, says):
    with pytest.raises(ValueError, match=says):
        make()


def test_speed():
    """1e5 points of an order-7 curve; 1 s leaves two orders for a busy machine."""
    guide = hilbert(7, SQUARE)
    s = jnp.linspace(0.0, 1.0, 100_000) * guide.length
    run = eqx.filter_jit(lambda guide, s: jax.vmap(guide)(s).position)
    run(guide, s).block_until_ready()
    begin = time.perf_counter()
    run(guide, s).block_until_ready()
    assert time.perf_counter() - begin < 1.0
