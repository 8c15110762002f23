"""Guides: lattices, lengths, smoothness and quadrature, against independent counts."""

import time

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close
from polishopt.path import hilbert, lines, polyline
from polishopt.path.corner import LENGTH, unit_corner


SQUARE = (50.0, 50.0)
STAIRS = np.array([[0, 0], [2, 0], [3, 0], [3, 1.5], [1, 1.5], [1, 5], [4, 5.0]])
WIDE = (50.0, 300.0)
GUIDES = {
    "hilbert-smooth": hilbert(3, SQUARE),
    "hilbert-arc": hilbert(3, SQUARE, "arc"),
    "hilbert-sharp": hilbert(3, SQUARE, "sharp"),
    "lines-smooth-tight": lines(5, (50.0, 30.0), fillet=0.2),
    "lines-narrow": lines(9, WIDE, fillet=0.25),
    "stairs-smooth": polyline(STAIRS, 4.0),
    "stairs-arc-tight": polyline(STAIRS, 4.0, "arc", 0.3),
    "line": lines(1, (50.0, 20.0)),
}
EACH = pytest.mark.parametrize("guide", GUIDES.values(), ids=GUIDES.keys())
SMOOTH = pytest.mark.parametrize(
    "guide",
    [g for g in GUIDES.values() if g.corner == "smooth"],
    ids=[name for name, g in GUIDES.items() if g.corner == "smooth"],
)


def padded(function):
    """The function of (guide, s), compiled once per guide for up to 4096 points."""
    compiled = eqx.filter_jit(function)

    def call(guide, s):
        out = compiled(guide, jnp.pad(s, (0, 4096 - s.size), mode="edge"))
        return jax.tree.map(lambda x: x[: s.size], out)

    return call


@padded
def points(guide, s):
    return jax.vmap(guide)(s)


@padded
def derivative(guide, s):
    return jax.vmap(lambda s: jax.jvp(guide, (s,), (jnp.ones_like(s),))[1])(s)


def everywhere(guide, per_cell=23):
    """Points within every cell, and none on its ends."""
    cells = guide.cells
    t = (np.arange(per_cell) + 0.37) / per_cell
    start, end = np.asarray(cells.start), np.asarray(cells.end)
    s = (start[:, None] + (end - start)[:, None] * t).ravel()
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
    """The polynomial against 60-point Gauss-Legendre from the start, at 1e-14."""
    x, w = np.polynomial.legendre.leggauss(60)
    length = LENGTH["smooth"]
    for t in np.linspace(0, 1, 41):
        tau = t * (x + 1) / 2
        h = np.pi / 2 * (6 * tau**5 - 15 * tau**4 + 10 * tau**3)
        along, across, heading, _ = unit_corner("smooth", jnp.asarray(t))
        assert_close(along, length * t / 2 * (w @ np.cos(h)), atol=2e-14)
        assert_close(across, length * t / 2 * (w @ np.sin(h)), atol=2e-14)
        end = np.pi / 2 * (6 * t**5 - 15 * t**4 + 10 * t**3)
        assert_close(heading, end, atol=1e-15)
    along, across, _, _ = unit_corner("smooth", jnp.asarray(1.0))
    assert_close(jnp.stack([along, across]), 1.0, rtol=1e-14)


@EACH
def test_the_parameter_is_arc_length(guide):
    """|dC/ds| = 1 in every cell, and dC/ds points along the heading."""
    s = everywhere(guide)
    rate, point = derivative(guide, s), points(guide, s)
    assert_close(jnp.sum(rate.position**2, axis=1), 1.0, atol=1e-11)
    tangent = jnp.stack([jnp.cos(point.heading), jnp.sin(point.heading)], axis=1)
    assert_close(rate.position, tangent, atol=1e-11)
    assert_close(rate.heading, point.curvature, atol=1e-12)


@EACH
def test_the_curve_stays_near_its_polyline(guide):
    """Every point is within the fillet's reach of some vertex or edge."""
    s = everywhere(guide)
    p, v = np.asarray(points(guide, s).position), np.asarray(guide.vertices)
    a, d = v[:-1], np.diff(v, axis=0)
    t = np.einsum("pek,ek->pe", p[:, None] - a, d) / np.sum(d**2, axis=1)
    nearest = a + np.clip(t, 0, 1)[..., None] * d
    distance = np.linalg.norm(p[:, None] - nearest, axis=-1).min(axis=1)
    # an arc passes its vertex at (sqrt 2 - 1) legs, and lies (1 - 1/sqrt 2) inside
    reach = (1 - 1 / np.sqrt(2)) * guide.fillet * float(guide.pitch)
    assert distance.max() <= reach + 1e-9


@EACH
def test_ends(guide):
    ends = points(guide, jnp.stack([jnp.zeros(()), guide.length])).position
    assert_close(ends, guide.vertices[jnp.asarray([0, -1])], atol=1e-11)
    # past its ends it goes straight on
    beyond = points(guide, jnp.stack([-jnp.ones(()), guide.length + 1]))
    assert_close(jnp.linalg.norm(beyond.position - ends, axis=1), 1.0, rtol=1e-9)
    assert_close(beyond.curvature, 0.0, atol=0)


def joints(guide):
    """Arc lengths at which the formula changes: ends of cells, of corners, of panels."""
    ends = np.concatenate([guide.cells.end[:-1], guide.panels[1:-1]])
    return jnp.asarray(ends) * guide.pitch


@EACH
def test_position_is_continuous(guide):
    s, tiny = joints(guide), 1e-9
    a, b = points(guide, s - tiny), points(guide, s + tiny)
    assert_close(a.position, b.position, atol=2.1e-9)
    if guide.corner != "sharp":
        assert_close(a.heading, b.heading, atol=1e-8)


@SMOOTH
def test_curvature_and_its_derivative_are_continuous(guide):
    """Both vanish with t^2 and t at the ends of a corner; 1e-6 away they are tiny."""
    s, tiny = joints(guide), 1e-6
    a, b = points(guide, s - tiny), points(guide, s + tiny)
    peak = float(jnp.max(jnp.abs(points(guide, everywhere(guide)).curvature)))
    slope = peak / float(guide.pitch)
    assert_close(a.curvature, b.curvature, atol=1e-9 * (1 + peak))
    da, db = derivative(guide, s - tiny), derivative(guide, s + tiny)
    assert_close(da.curvature, db.curvature, atol=1e-3 * slope)


@pytest.mark.parametrize(
    "name", ["stairs-smooth", "stairs-arc-tight", "lines-smooth-tight", "hilbert-sharp"]
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
    if guide.corner == "smooth":
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
    way = guide.vertices[-1] - guide.vertices[0]
    assert_close(weight @ tangent, way, atol=1e-9)
    if guide.corner != "sharp":
        turned = guide.cells.heading[-1] - guide.cells.heading[0]
        assert_close(weight @ p.curvature, turned, atol=1e-12)


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
        (lambda: hilbert(3, SQUARE, fillet=0.6), "`fillet` is 0.6"),
        (lambda: hilbert(3, SQUARE, fillet=0.0), "`fillet` is 0.0"),
        (lambda: hilbert(3, SQUARE, corner="round"), "`corner` is 'round'"),
        (lambda: lines(0, SQUARE), "`count` is 0"),
        (lambda: lines(1, (10.0, 50.0)), "`count` is 1"),
        (lambda: lines(6, (10.0, 50.0)), "`fillet` is 0.5"),
        (lambda: polyline(np.array([[0, 0], [1, 0], [0, 0.0]]), 1.0), "right angle"),
        (lambda: polyline(np.array([[0, 0], [1, 0], [2, 1.0]]), 1.0), "right angle"),
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
