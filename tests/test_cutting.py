"""Milling tooth by tooth, against swept volumes, solved edges and the printed tables."""

from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close, assert_gradient
from polishopt.files.assemble import job
from polishopt.files.config import load
from polishopt.machine.feed import limiting_name
from polishopt.parts import Machine
from polishopt.path.surface import (
    HyperbolicParaboloid,
    Plane,
    SphereCap,
)
from polishopt.texture.areal import height_parameters
from polishopt.texture.cutter import (
    Cutter,
    arc_length,
    passing_count,
    passings,
    postures,
    several,
    true_feed,
)
from polishopt.texture.cutting import cut, removed_volume, topography
from polishopt.texture.marks import milled_marks
from polishopt.texture.milling import MilledSurface, cusp_heights, milled_map
from scipy.optimize import fsolve


jit_cut = eqx.filter_jit(cut)
jit_marks = eqx.filter_jit(milled_marks)
jit_volume = eqx.filter_jit(removed_volume)
parameters = jax.jit(height_parameters)


def row(low, high, count):
    return jnp.asarray(np.linspace(low, high, count))


def middles(low, high, count):
    return jnp.asarray(low + (high - low) * (np.arange(count) + 0.5) / count)


jit_postures = eqx.filter_jit(postures)
jit_passings = eqx.filter_jit(passings)


def straight(surface, cutter, x, y, samples=601, tilt=30.0, yaw=20.0, depth=0.0):
    """A pass along x at one y of the parameter plane."""
    xy = jnp.asarray(
        np.stack([np.linspace(x[0], x[1], samples), np.full(samples, y)], axis=1)
    )
    angles = (jnp.asarray(np.radians(tilt)), jnp.asarray(np.radians(yaw)))
    return jit_postures(surface, xy, jnp.zeros(samples), cutter, *angles, depth)


def steady(pass_, cutter, per_turn, turned: jax.Array | float = 0.0):
    """Passings at a constant feed."""
    time = arc_length(pass_) / 20.0
    spin = jnp.asarray(2 * np.pi * 20.0 / per_turn)
    count = passing_count(time[-1], spin, cutter)
    speed = jnp.full(time.size, 20.0)
    return jit_passings(pass_, time, speed, spin, cutter, count, turned)


BALL, DEPTH = 3.0, 0.05


def groove(surface, reach, half_width):
    """What one pass of a ball, set below the part, takes off in |x| < reach."""
    cutter, middle = Cutter(BALL, BALL), 10.0
    ends = (middle - reach - 0.3, middle + reach + 0.3)
    teeth = steady(straight(surface, cutter, ends, middle, depth=DEPTH), cutter, 0.01)
    x = middles(middle - reach, middle + reach, 24)
    y = middles(middle - half_width, middle + half_width, 400)
    return x, y, jit_cut(surface, x, y, cutter, teeth, 8, (40, 1), stock=0.0)


def lens_moment(R, c):
    """First moment about the origin of what a circle (radius R) shares with the ball.

    The ball's circle has its centre at c. The segments on either side of the common chord
    have equal and opposite moments about their own centres: c times one area is left.
    """
    chord = (c**2 + R**2 - BALL**2) / (2 * c)
    d = c - chord
    return c * (BALL**2 * np.arccos(d / BALL) - d * np.sqrt(BALL**2 - d**2))


@pytest.mark.parametrize("radius", [20.0, -20.0])
def test_groove_on_a_sphere_has_the_volume_of_a_turned_lens(radius):
    """Pappus: a great circle turns the lens about the middle of the sphere."""
    reach, R = 0.3, abs(radius)
    surface = SphereCap([20.0, 20.0], radius)
    x, y, h = groove(surface, reach, 0.8)
    assert float(jnp.min(h)) < -0.9 * DEPTH
    if radius > 0:
        moment = lens_moment(R, R + BALL - DEPTH)
    else:  # all of the ball but what lies inside the hollow sphere
        c = R - BALL + DEPTH
        moment = np.pi * BALL**2 * c - lens_moment(R, c)
    # a row at y spans a little more than the middle one, by (y/R)^2/2 < 5e-4 at its edge
    wedge = 2 * np.arcsin(reach / R)
    assert_close(jit_volume(surface, x, y, h), moment * wedge, rtol=3e-4)


def test_a_layer_on_a_sphere_is_a_shell():
    """Its volume is the solid angle times the difference of two cubes over three."""
    R, depth = 20.0, 1.5
    grid = middles(0.0, 16.0, 40)
    volume = jit_volume(SphereCap([16.0, 16.0], R), grid, grid, jnp.full((40, 40), -depth))
    x, w = np.polynomial.legendre.leggauss(40)
    x, y = np.meshgrid(8 * x, 8 * x)
    angle = 64 * w @ (1 / (R * np.sqrt(R**2 - x**2 - y**2))) @ w
    assert_close(volume, angle * (R**3 - (R - depth) ** 3) / 3, rtol=2e-4)


def test_groove_on_a_saddle_has_the_volume_of_the_swept_tube():
    """Polar slices across the curve that the ball's centre runs on."""
    w, reach = 0.02, 2.0
    surface = HyperbolicParaboloid([20.0, 20.0], w)
    x, y, h = groove(surface, reach, 0.8)

    def centre(t):
        s = np.sqrt(1 + (w * t) ** 2)
        return np.array([t, -(BALL - DEPTH) * w * t / s, (BALL - DEPTH) / s])

    def section(t):
        """Volume per x: the part of the disc across the curve that is in the part."""
        d = 1e-4
        first = (centre(t + d) - centre(t - d)) / (2 * d)
        second = (centre(t + d) - 2 * centre(t) + centre(t - d)) / d**2
        speed = np.linalg.norm(first)
        tangent = first / speed
        bend = (second - (second @ tangent) * tangent) / speed**2
        # down is the direction of the part, and across is square to it
        up = np.array([0, -w * t, 1.0])
        up -= (up @ tangent) * tangent
        up /= np.linalg.norm(up)
        across = np.cross(tangent, up)
        beta = (np.arange(4000) + 0.5) / 4000 * 0.6 - 0.3
        ray = -np.cos(beta)[:, None] * up + np.sin(beta)[:, None] * across
        c = centre(t)
        # z - w x y = 0 along c + rho ray, a quadratic
        q2 = -w * ray[:, 0] * ray[:, 1]
        q1 = ray[:, 2] - w * (c[0] * ray[:, 1] + c[1] * ray[:, 0])
        q0 = c[2] - w * c[0] * c[1]
        rho = 2 * q0 / (-q1 + np.sqrt(q1**2 - 4 * q2 * q0))
        rho = np.minimum(rho, BALL)
        pull = ray @ bend  # the tube is denser inside the bend
        slices = (BALL**2 - rho**2) / 2 - pull * (BALL**3 - rho**3) / 3
        return speed * np.sum(slices) * 0.6 / 4000

    nodes, weights = np.polynomial.legendre.leggauss(8)
    want = reach * sum(k * section(reach * t) for t, k in zip(nodes, weights, strict=True))
    assert_close(jit_volume(surface, x, y, h), want, rtol=3e-4)


def test_heights_are_those_of_the_edges_themselves():
    """Three unknowns, moment, place on the edge and height, solved for each passing."""
    cutter = Cutter(5.0, 1.5, [0.0, 0.004, -0.003])
    plane = Plane([40.0, 40.0])
    spin, turned, feed = 200.0, 0.7, 30.0
    pass_ = straight(plane, cutter, (18.0, 22.0), 20.0, 5, tilt=12.0, yaw=35.0)
    arc = arc_length(pass_)
    count = passing_count(arc[-1] / feed, spin, cutter)
    speed = jnp.full(arc.size, feed)
    args = (arc / feed, speed, jnp.asarray(spin), cutter, count, turned)
    teeth = jit_passings(pass_, *args)
    x, y = row(-0.2, 0.25, count=4) + 20.0, row(-0.9, 0.8, count=5) + 20.0
    got = jit_cut(plane, x, y, cutter, teeth, 12, (5, 4), 4)

    u, d = np.asarray(pass_.axis[0]), np.asarray(pass_.towards[0])
    e, start = np.cross(u, d), np.asarray(pass_.centre[0])
    out = np.asarray(cutter.runout)

    def miss(unknown, foot, k):
        t, phi, h = unknown
        alpha = -(spin * t + turned) + 2 * np.pi * k / 3
        radial = np.cos(alpha) * d + np.sin(alpha) * e
        ring = start + [feed * t, 0, 0] + (3.5 + out[k % 3]) * radial
        return ring + 1.5 * (np.sin(phi) * radial - np.cos(phi) * u) - foot - [0, 0, h]

    want = np.empty(got.shape)
    for i, b in enumerate(y):
        for j, a in enumerate(x):
            foot = np.array([float(a) - 20.0, float(b) - 20.0, 0.0])
            lowest = np.inf
            for k in range(1, count - 1):
                guess = ((2 * np.pi * k / 3 - turned) / spin, 0.2, 0.0)
                found, _, ok, _ = fsolve(
                    miss, guess, (foot, k), full_output=True, xtol=1e-13
                )
                residual = np.abs(miss(found, foot, k)).max()
                if ok == 1 and residual < 1e-9 and abs(found[1]) < np.pi / 2:
                    lowest = min(lowest, found[2])
            want[i, j] = lowest
    assert_close(got, want, atol=2e-7)  # 0.2 nm: the iteration, and fsolve


def test_tool_stands_where_the_feed_has_taken_it():
    """Between two samples the feed is linear in time, so the way is quadratic."""
    cutter = Cutter(5.0, 1.5, [0.0, 0.0])
    plane = Plane([40.0, 40.0])
    pass_ = straight(plane, cutter, (0.0, 12.0), 20.0, 3, tilt=10.0, yaw=0.0)
    # from rest to 40 mm/s over 6 mm, then down to 20 mm/s over 6 mm
    feed = jnp.asarray([0.0, 40.0, 20.0])
    time = jnp.asarray([0.0, 0.3, 0.5])
    teeth = jit_passings(
        pass_, time, feed, jnp.asarray(100.0), cutter, 17, jnp.asarray(0.5)
    )
    t = (np.pi * np.arange(17) - 0.5) / 100.0

    def way(t):
        late = np.clip(t, 0.3, 0.5) - 0.3
        return 0.5 * 40 / 0.3 * np.clip(t, 0, 0.3) ** 2 + 40 * late - 50 * late**2

    x = np.asarray(teeth.centre)[:, 0] - float(pass_.centre[0, 0])
    assert_close(x, way(t), atol=1e-12)
    quarter = np.pi / 200
    slope = -(way(t + quarter) - way(t - quarter)) / np.pi  # clockwise
    assert_close(teeth.slope[:, 0], slope, atol=1e-12)
    bend = (way(t + quarter) - 2 * way(t) + way(t - quarter)) * (2 / np.pi) ** 2
    assert_close(teeth.bend[:, 0], bend, atol=1e-12)
    assert_close(teeth.tooth, np.arange(17) % 2)
    assert_close(teeth.axis, np.broadcast_to(pass_.axis[0], (17, 3)), rtol=1e-12)


def test_fine_teeth_leave_the_envelope():
    """Many small bites leave the groove of the swept tool."""
    cutter, plane = Cutter(5.0, 1.5), Plane([40.0, 40.0])
    pass_ = straight(plane, cutter, (19.5, 20.5), 20.0, 201, tilt=10.0, yaw=20.0)
    teeth = steady(pass_, cutter, 0.004)
    y = jnp.asarray([20.0 - 0.06, 20.0, 20.0 + 0.06])
    h = jit_cut(plane, middles(19.99, 20.01, 20), y, cutter, teeth, 24, (1, 20))
    h = np.asarray(jnp.mean(h, axis=1))
    # the tooth itself goes on while it turns, by a share feed / (2 pi R_c) of its way
    milled = MilledSurface(5.0, 1.5, np.radians(10), np.radians(20), 0.12, 0.004)
    between_passes, _ = cusp_heights(milled)
    assert_close((h[0] + h[2]) / 2 - h[1], between_passes, rtol=3e-3)


def test_an_untilted_ball_over_a_line():
    """Its tip is on the axis, where the tooth has no direction."""
    cutter, plane = Cutter(2.0, 2.0), Plane([4.0, 4.0])
    x, y = jnp.asarray([2.0, 2.1]), jnp.asarray([2.0, 2.05])

    def heights(tilt):
        xy = jnp.asarray([[1.0, 2.0], [2.0, 2.0], [3.0, 2.0]])
        pass_ = postures(plane, xy, jnp.zeros(3), cutter, tilt, tilt)
        time, speed = jnp.asarray([0.0, 0.05, 0.1]), jnp.full(3, 20.0)
        spin = jnp.asarray(80 * np.pi)  # 0.5 mm a turn
        teeth = passings(pass_, time, speed, spin, cutter, 5)
        return cut(plane, x, y, cutter, teeth, 4, (2, 2))

    tilt = jnp.asarray(0.0)
    got, slope = jax.jit(lambda t: jax.jvp(heights, (t,), (jnp.ones_like(t),)))(tilt)
    # the second passing finds the axis exactly on the first line
    assert_close(got[0, 0], 0.0, atol=1e-12)
    # one tooth leaves more than the ball would
    assert 2 - np.sqrt(4 - 0.05**2) < got[1, 0] < 2e-3
    assert np.isfinite(slope).all()


# S2 Table 2: yaw, tilt [deg], feed [mm/min], step [mm]; Sz, Sa as simulated there [um]
TABLE_2 = [
    (0, 1, 2000, 2.76, 5.58, 1.21),
    (0, 1, 4000, 2.71, 9.24, 1.66),
    (0, 10, 4000, 1.21, 15.7, 2.56),
    (20, 10, 4000, 0.46, 5.63, 1.05),
]
REACH = (3, 40)  # passes, teeth; the finest feed needs 5 mm / 0.133 mm


def milled(case):
    yaw, tilt, feed, step, *_ = case
    return MilledSurface(5.0, 1.5, np.radians(tilt), np.radians(yaw), step, feed / 15000)


@pytest.mark.parametrize("case", TABLE_2)
def test_table_2(case):
    """With one tooth at 15 000 rpm; the paper does not say how its passes are shifted."""
    z, _ = jit_marks(milled(case), (140, 40), 7, REACH)
    p = parameters(z)
    assert_close(1e3 * p.Sa, case[-1], rtol=0.1)
    assert_close(1e3 * p.Sz, case[-2], rtol=0.2)
    assert 0.2 < p.Ssk < 0.65
    assert 2.1 < p.Sku < 2.5


def test_table_2_has_converged():
    """A finer grid, more candidates and more rounds change nothing that matters."""
    case = milled(TABLE_2[3])
    z, spacing = jit_marks(case, (140, 40), 7, REACH)
    coarse = parameters(z)
    fine = parameters(jit_marks(case, (280, 80), 7, REACH)[0])
    for name in ("Sa", "Sq", "Ssk", "Sku"):
        assert_close(getattr(coarse, name), getattr(fine, name), rtol=0.01)
    more, _ = jit_marks(case, (140, 40), 7, (6, 60), candidates=60)
    assert_close(more, z, atol=1e-12)
    assert_close(spacing, [7 * 0.46 / 140, 4000 / 15000 / 40])


def test_a_config_can_start_from_the_marks_of_the_teeth():
    """The config of this paper starts from the fourth case."""
    config = load(Path(__file__).parent.parent / "configs" / "quinsat2011.yaml").config
    start = job(config).setup.start
    assert start.heights is not None
    assert_close(1e3 * parameters(start.heights).Sa, TABLE_2[3][-1], rtol=0.1)
    sides = np.asarray(start.spacing) * np.shape(start.heights)
    assert_close(sides, [5 * 0.46, 0.2667])


def test_marks_of_narrow_passes_are_the_crossed_cusps():
    """Nearly in step and without yaw, the analytic map is the limit of short feeds."""
    short = MilledSurface(5.0, 1.5, np.radians(10), 0.0, 0.3, 0.03)
    z, _ = jit_marks(short, (40, 20), 1, (8, 170))
    want, _ = milled_map(short, (40, 20))
    got, want = parameters(z), parameters(want)
    assert_close(got.Sa, want.Sa, rtol=2e-3)
    assert_close(got.Sz, want.Sz, rtol=0.02)


def test_marks_repeat_and_scale():
    case = milled(TABLE_2[3])
    z, spacing = jit_marks(case, (30, 12), 3, REACH)
    lengths = ("outer_radius", "corner_radius", "step", "feed_per_tooth")

    def at(m):
        return [getattr(m, name) for name in lengths]

    metres = eqx.tree_at(at, case, [1e-3 * x for x in at(case)])
    z_m, spacing_m = jit_marks(metres, (30, 12), 3, REACH)
    assert_close(z_m, 1e-3 * z, atol=1e-15)
    assert_close(spacing_m, 1e-3 * spacing)
    # no jump across the seams that is larger than those inside
    for axis in (0, 1):
        inside = jnp.max(jnp.abs(jnp.diff(z, axis=axis)))
        seam = jnp.abs(jnp.take(z, 0, axis) - jnp.take(z, -1, axis))
        assert float(jnp.max(seam)) < 1.05 * float(inside)
    with pytest.raises(ValueError, match="`passes` is 4, must be odd"):
        milled_marks(case, (8, 4), 4)


def test_single_precision():
    case = milled(TABLE_2[1])
    z, _ = jit_marks(case, (30, 12), 3, REACH)
    half = jax.tree.map(lambda x: x.astype(jnp.float32), case)
    cutter = Cutter(5.0, 1.5)
    cutter = jax.tree.map(lambda x: x.astype(jnp.float32), cutter)
    z32, _ = jit_marks(half, (30, 12), 3, REACH, cutter)
    assert z32.dtype == jnp.float32
    assert_close(z32, z, atol=1e-6)  # 1 nm of marks of 9 um


def test_gradients_through_the_smooth_minimum():
    def marks(x):
        case = MilledSurface(5.0, 1.5, x[0], x[1], x[2], x[3])
        z, _ = milled_marks(case, (2, 8), 1, (2, 3), width=2e-4, candidates=8)
        return z.ravel() * 1e3

    x = jnp.asarray([0.17, 0.35, 0.46, 0.27])
    assert_gradient(marks, x, rtol=1e-5, atol=1e-6)
    # it lies below the least, by no more than the number of teeth can bring it
    case = MilledSurface(5.0, 1.5, *x)
    soft = 1e-3 * jax.jit(marks)(x).reshape(2, 8)
    hard, _ = jit_marks(case, (2, 8), 1, (2, 3), candidates=8)
    below = np.asarray(hard - soft)
    assert (below > -1e-15).all()
    assert (below < 2e-4 * np.log(8)).all()
    assert below.max() > 1e-7


def test_bands_give_the_same_map_and_say_how_far_they_are():
    surface, cutter = SphereCap([20.0, 20.0], 60.0), Cutter(5.0, 1.5)
    stacked = [
        steady(straight(surface, cutter, (8.0, 12.0), y, 41), cutter, 0.2, jnp.asarray(y))
        for y in (9.6, 10.0, 10.4)
    ]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *stacked)
    teeth = several(stacked)
    assert teeth.centre.shape == (3 * stacked.tooth.shape[1], 3)
    x, y = middles(9.7, 10.3, 30), middles(9.7, 10.3, 21)
    whole = jit_cut(surface, x, y, cutter, teeth, 12, (8, 8))
    said = []
    bands = topography(
        surface, x, y, cutter, teeth, lambda *n: said.append(n), (8, 8), candidates=12
    )
    assert_close(bands, whole, atol=1e-9)
    assert said == [(8 * 30, 630), (16 * 30, 630), (630, 630)]
    # a tile that would have to guess does not
    with pytest.raises(ValueError, match="smaller `tile` or more `candidates`"):
        topography(surface, x, y, cutter, teeth, tile=(8, 8), candidates=2)


def test_feed_on_the_saddle_halves_in_the_middle():
    """S2 figs. 2 and 7, on a saddle of a size that the paper does not print.

    The tilted axis passes the pole of the machine in the middle of the rule, where C turns
    by twist / tilt a length: its speed limit makes the feed C_max tan(tilt) / twist.
    """
    limits = ([500.0] * 3 + [np.pi / 2, 2 * np.pi / 3], [2500.0, 3000.0, 2100.0, 5.2, 5.2])
    machine = Machine(*limits, max_jerk=[5e3, 5e3, 5e4, 30.0, 300.0])
    side, twist, programmed = 50.0, 8.8e-4, 5000 / 60
    surface, cutter = HyperbolicParaboloid([side, side], twist), Cutter(5.0, 1.5)
    pass_ = straight(surface, cutter, (0.0, side), side / 2, 1001, tilt=1.0, yaw=0.0)
    law = jax.jit(true_feed)(pass_, cutter, machine, jnp.asarray(programmed))
    feed = np.asarray(law.feed)
    assert_close(feed[[0, -1]], programmed, rtol=1e-6)
    slowest = 2 * np.pi / 3 * np.tan(np.radians(1)) / twist
    assert_close(feed.min(), slowest, rtol=2e-3)
    assert np.argmin(feed) == pytest.approx(500, abs=2)
    assert_close(slowest, programmed / 2, rtol=0.01)
    assert limiting_name(law.limiting[500]) == "C speed"
    # the programmed feed holds only near the ends
    assert np.mean(feed > 0.99 * programmed) < 0.15
    assert (feed[200:801] < 0.99 * programmed).all()

    spin = jnp.asarray(2 * np.pi * 250.0)
    count = passing_count(law.total, spin, cutter)
    teeth = jit_passings(pass_, law.time, law.feed, spin, cutter, count)

    def spacing(middle):
        """Distance of the cusps in a window along the pass."""
        x = middles(middle - 2.0, middle + 2.0, 800)
        y = jnp.asarray([side / 2])
        h = np.asarray(jit_cut(surface, x, y, cutter, teeth, 16, (1, 200)))[0]
        peak = np.flatnonzero((h[1:-1] > h[:-2]) & (h[1:-1] >= h[2:]))
        # a cusp may have two tips, so the mean distance says nothing
        return np.median(np.diff(np.asarray(x)[1 + peak]))

    def at(x):
        return float(np.interp(x, np.linspace(0, side, 1001), feed)) / 250

    slow, fast = spacing(side / 2), spacing(3.0)
    assert_close(slow, at(side / 2), rtol=0.02)
    assert_close(fast, at(3.0), rtol=0.02)
    assert fast > 1.8 * slow
