"""Trochoid and tool path: S0's numbers, and the geometry of a leant disc."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close, assert_gradient
from polishopt.parts import Process
from polishopt.path import (
    GuidePoint,
    HyperbolicParaboloid,
    Plane,
    SphereCap,
    hilbert,
    length_per_loop,
    lines,
    normal,
    posture,
    resolved,
    trochoid,
)
from scipy import integrate, special


SIZE = (50.0, 50.0)
SURFACES = {
    "plane": Plane(SIZE),
    "convex": SphereCap(SIZE, 100.0),
    "concave": SphereCap(SIZE, -100.0),
    "saddle": HyperbolicParaboloid(SIZE, 5e-3),
}
ON_EACH = pytest.mark.parametrize("surface", SURFACES.values(), ids=SURFACES.keys())
MODES = pytest.mark.parametrize("pulling", [True, False], ids=["pulling", "pushing"])
POINT = GuidePoint(jnp.asarray([12.0, 31.0]), jnp.asarray(0.8), jnp.asarray(0.0))
RADIUS = jnp.asarray(9.0)
place = eqx.filter_jit(posture)


@eqx.filter_jit
def run(surface, guide, settings, radius, samples, phase0=0.0):
    s = jnp.linspace(0.0, guide.length, samples)
    return resolved(surface, guide, settings, radius, s, phase0=phase0), s


PHASE = jnp.asarray(2.5)


def process(tilt=np.pi / 60, displacement=0.4, step=1.0, trochoid_radius=6.0):
    return Process(tilt, displacement, step, trochoid_radius, feed=1000 / 60, spin=209.4)


def straight(s):
    """A guide along x."""
    zero = jnp.zeros_like(s)
    return GuidePoint(jnp.stack([s, zero]), zero, zero)


def circle(s, radius):
    """A guide round the origin, anticlockwise."""
    angle = s / radius
    position = radius * jnp.stack([jnp.cos(angle), jnp.sin(angle)])
    return GuidePoint(position, angle + jnp.pi / 2, 1 / radius)


def test_trochoid_on_a_line_as_printed():
    """S0 Eq. 5 with C = (s, 0) and n = (0, 1)."""
    step, radius = 2.0, 3.0
    for s in np.linspace(0, 5, 11):
        phi = 2 * np.pi * s / step
        rotation = np.array([[np.cos(phi), np.sin(phi)], [-np.sin(phi), np.cos(phi)]])
        n = np.array([0.0, 1.0])
        want = np.array([s, 0.0]) + step / (2 * np.pi) * n + radius * rotation @ n
        at = [jnp.asarray(x) for x in (s, phi, step, radius)]
        assert_close(trochoid(straight(at[0]), *at[1:]), want, rtol=1e-13, atol=1e-13)


def test_trochoid_is_two_radii_wide():
    phase = jnp.linspace(0, 2 * jnp.pi, 4001)
    p = jax.vmap(lambda a: trochoid(POINT, a, jnp.asarray(1.0), jnp.asarray(6.0)))(phase)
    left = jnp.stack([-jnp.sin(POINT.heading), jnp.cos(POINT.heading)])
    assert_close(jnp.ptp(p @ left), 12.0, rtol=1e-6)


@pytest.mark.parametrize(("radius", "length"), [(6.0, 37.71), (3.0, 18.86)])
def test_length_per_loop_on_a_line(radius, length):
    """Printed roundings, and the complete elliptic integral of the second kind."""
    got = length_per_loop(jnp.asarray(1.0), jnp.asarray(radius), jnp.asarray(0.0))
    assert_close(got, length, atol=5e-3)
    swirl = 2 * np.pi * radius
    total = 1 + swirl
    assert_close(got, 2 / np.pi * total * special.ellipe(4 * swirl / total**2), rtol=1e-13)


@pytest.mark.parametrize("bend", [0.2, -0.2, 0.5])
@pytest.mark.parametrize(("step", "radius"), [(1.0, 6.0), (4.0, 3.0), (3.0, 0.2)])
def test_length_per_loop_on_a_circle(step, radius, bend):
    """Against the speed of the trochoid on a circle, differentiated and integrated."""
    curvature = jnp.asarray(bend)

    @jax.jit
    def speed(s):
        def at(s):
            phase = 2 * jnp.pi * s / step
            point = circle(s, 1 / curvature)
            return trochoid(point, phase, jnp.asarray(step), jnp.asarray(radius))

        return jnp.linalg.norm(jax.jvp(at, (s,), (jnp.ones_like(s),))[1])

    want, _ = integrate.quad(lambda s: speed(jnp.asarray(s)), 0, step, epsabs=1e-10)
    got = length_per_loop(jnp.asarray(step), jnp.asarray(radius), curvature)
    assert_close(got, want, rtol=1e-9)


@pytest.mark.parametrize(
    ("step", "radius", "curvature"),
    [(1.0, 0.0, 0.0), (2 * np.pi, 1.0, 0.0), (2 * np.pi, 3.0, 1.0), (1.0, 6.0, 0.3)],
    ids=["no loop", "cusps", "shrunk to a point", "usual"],
)
def test_length_per_loop_has_a_finite_gradient(step, radius, curvature):
    at = [jnp.asarray(x) for x in (step, radius, curvature)]
    assert np.isfinite(jax.grad(length_per_loop, (0, 1, 2))(*at)).all()
    if radius == 1.0:  # the cycloid, 8 radii long, is the slowest to converge
        assert_close(length_per_loop(*at), 8.0, rtol=1e-4)


@pytest.mark.parametrize(("order", "radius", "minutes"), [(3, 6.0, 14.85), (4, 3.0, 15.03)])
def test_time_of_table_1(order, radius, minutes):
    """S0 Table 1 gives 15 min at 1000 mm/min: two readings of the circle agree with it."""
    step = jnp.asarray(1.0)
    s, weight = hilbert(order, SIZE, "sharp").stations(2)
    loop = length_per_loop(step, jnp.asarray(radius), jnp.zeros(()))
    assert_close(jnp.sum(weight) * loop / step / 1000, minutes, atol=5e-3)


@pytest.mark.parametrize(("order", "radius", "minutes"), [(3, 6.0, 12.3), (4, 3.0, 12.5)])
def test_fillets_shorten_it(order, radius, minutes):
    guide, step = hilbert(order, SIZE, "arc"), jnp.asarray(1.0)
    s, weight = guide.stations(4)
    circle_radius = jnp.asarray(radius)

    @jax.jit
    @jax.vmap
    def loop_at(s):
        return length_per_loop(step, circle_radius, guide(s).curvature)

    total = weight @ loop_at(s) / step
    assert_close(total / 1000, minutes, atol=0.06)
    # and it is the length of the path itself, but for the loop cut off at its end
    postures, at = run(
        SURFACES["plane"], guide, process(step=1.0, trochoid_radius=radius), RADIUS, 40_000
    )
    chords = np.linalg.norm(np.diff(postures.contact, axis=0), axis=1)
    assert_close(chords.sum(), total, rtol=1e-3)


@ON_EACH
@MODES
@pytest.mark.parametrize("lean", ["guide", "fixed"])
def test_posture(surface, pulling, lean):
    tilt = np.radians(10)
    got = place(surface, POINT, PHASE, process(tilt), RADIUS, pulling, lean)
    n, f, b, u = got.normal, got.feed_direction, got.side, got.axis
    assert_close(jnp.stack([n, f, b]) @ jnp.stack([n, f, b]).T, np.eye(3), atol=1e-14)
    assert_close(jnp.linalg.det(jnp.stack([f, b, n])), 1.0, rtol=1e-13)
    assert_close(got.contact, surface(got.xy), rtol=1e-14)
    assert_close(n, normal(surface, got.xy), rtol=1e-14)
    sign = 1 if pulling else -1
    assert_close(
        jnp.stack([u @ n, u @ f, u @ b]),
        [np.cos(tilt), sign * np.sin(tilt), 0.0],
        atol=1e-14,
    )
    # before the displacement the disc touches the part with its edge ...
    centre = got.tip + 0.4 * n
    spoke = got.contact - centre
    assert_close(jnp.linalg.norm(spoke), RADIUS, rtol=1e-13)
    assert_close(spoke @ u, 0.0, atol=1e-13)
    # ... at its deepest point, so that the centre and every other edge point are above
    assert_close((centre - got.contact) @ n, RADIUS * np.sin(tilt), rtol=1e-12)
    angle = np.linspace(0, 2 * np.pi, 100)[:, None]
    across = np.cross(u, spoke)
    edge = np.asarray(centre) + np.cos(angle) * np.asarray(spoke) + np.sin(angle) * across
    assert ((edge - np.asarray(got.contact)) @ np.asarray(n)).min() > -1e-12


def test_displacement_is_along_the_normal():
    surface = SURFACES["convex"]
    a = place(surface, POINT, PHASE, process(displacement=0.0), RADIUS)
    b = place(surface, POINT, PHASE, process(displacement=0.7), RADIUS)
    assert_close(b.tip - a.tip, -0.7 * a.normal, atol=1e-13)
    assert_close(b.contact, a.contact)


@MODES
def test_the_papers_v_needs_no_further_sign(pulling):
    """S0 Eq. 13 by cross products; its v points up in both modes: Eq. 12's -1 must go."""
    tilt = np.radians(10)
    got = place(SURFACES["convex"], POINT, PHASE, process(tilt), RADIUS, pulling)
    u, n = np.asarray(got.axis), np.asarray(got.normal)
    turn = np.cross(u, n)
    v = np.cross(turn / np.linalg.norm(turn), u)
    assert_close(v @ n, np.sin(tilt), rtol=1e-12)
    assert_close(got.tip, got.contact + 9.0 * v - 0.4 * n, atol=1e-12)


def test_corner_radius():
    """A rounded edge of radius r: its centre line is r above the contact along n."""
    r = 1.5
    got = place(
        SURFACES["saddle"], POINT, PHASE, process(displacement=0.0), RADIUS, corner_radius=r
    )
    middle = got.tip + r * got.axis  # of the torus
    spoke = got.contact + r * got.normal - middle
    assert_close(jnp.linalg.norm(spoke), 9.0 - r, rtol=1e-13)
    assert_close(spoke @ got.axis, 0.0, atol=1e-13)


def test_negative_tilt_is_the_other_mode():
    surface = SURFACES["convex"]
    a = place(surface, POINT, PHASE, process(-0.1), RADIUS, True)
    b = place(surface, POINT, PHASE, process(0.1), RADIUS, False)
    assert_close(a.axis, b.axis, rtol=1e-14)
    assert_close(a.tip, b.tip, rtol=1e-14)


def test_pulling_by_sign():
    surface = SURFACES["plane"]
    for word, sign in ((True, 1), (False, -1)):
        a = place(surface, POINT, PHASE, process(), RADIUS, word)
        b = place(surface, POINT, PHASE, process(), RADIUS, sign)
        assert_close(a.tip, b.tip)


def test_fixed_lean_does_not_follow_the_guide():
    heading = jnp.asarray([0.0, 1.0, 4.0])
    at = jax.vmap(
        lambda h: (
            place(
                SURFACES["plane"],
                GuidePoint(POINT.position, h, POINT.curvature),
                PHASE,
                process(),
                RADIUS,
                lean="fixed",
            ).axis
        )
    )(heading)
    tilt = np.radians(3)
    assert_close(at, np.array([np.sin(tilt), 0, np.cos(tilt)]), atol=1e-15)
    with pytest.raises(ValueError, match="`lean` is 'free'"):
        place(SURFACES["plane"], POINT, PHASE, process(), RADIUS, lean="free")


def tip_and_axis(x, surface, pulling=True):
    """Place and axis as a function of tilt, displacement, step, circle and phase."""
    got = place(surface, POINT, x[4], process(*x[:4]), RADIUS, pulling)
    return jnp.concatenate([got.tip, got.axis])


def test_gradient():
    x = jnp.asarray([0.1, 0.4, 1.0, 6.0, 2.5])
    assert_gradient(lambda x: tip_and_axis(x, SURFACES["convex"], False), x)


@ON_EACH
def test_gradient_at_zero_tilt(surface):
    """Finite, and the one of positive tilts."""
    x = jnp.asarray([0.0, 0.4, 1.0, 6.0, 2.5])
    at = jax.jit(jax.jacrev(lambda x: tip_and_axis(x, surface)))
    assert_close(at(x), at(x.at[0].set(1e-9)), atol=1e-7)
    got = place(surface, POINT, x[4], process(0.0), RADIUS)
    edge = got.contact - 9.0 * got.feed_direction - 0.4 * got.normal
    assert_close(got.tip, edge, atol=1e-13)


def test_resolved_samples_do_not_depend_on_the_step():
    guide = hilbert(2, SIZE)
    surface = SURFACES["convex"]
    postures, s = run(surface, guide, process(step=1.0), RADIUS, 500, phase0=0.3)
    assert postures.contact.shape == postures.tip.shape == (500, 3)
    assert postures.xy.shape == (500, 2)
    other, s_other = run(surface, guide, process(step=2.7), RADIUS, 500, phase0=0.3)
    assert_close(s_other, s)
    one = place(
        surface, guide(s[77]), 2 * jnp.pi * s[77] / 2.7 + 0.3, process(step=2.7), RADIUS
    )
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        assert_close(b[77], a, atol=1e-11)


@pytest.mark.parametrize(
    ("corner", "tilt"), [("smooth", 0.0), ("smooth", 0.05), ("arc", 0.05), ("sharp", 0.0)]
)
def test_second_derivatives_along_the_path(corner, tilt):
    """What the axis limits need: finite also at joints and ends, and true in between."""
    guide, surface = hilbert(2, SIZE, corner), SURFACES["saddle"]
    ends = jnp.concatenate([guide.panels, guide.cells.end]) * guide.pitch
    between = jnp.asarray((np.arange(50) + 0.41) / 50) * guide.length
    h = 1e-5
    s = jnp.concatenate([between, between - h, between + h, ends])

    def at(s):
        phase = 2 * jnp.pi * s
        got = posture(surface, guide(s), phase, process(tilt), RADIUS)
        return jnp.concatenate([got.tip, got.axis, got.contact])

    def slope(s):
        return jax.jvp(at, (s,), (jnp.ones_like(s),))[1]

    @jax.jit
    @jax.vmap
    def both(s):
        return jax.jvp(slope, (s,), (jnp.ones_like(s),))

    first, second = both(s)
    assert np.isfinite(first).all()
    assert np.isfinite(second).all()
    # the loops turn by 2 pi/mm on radii of 6 mm, so second derivatives are about 240/mm
    difference = (first[100:150] - first[50:100]) / (2 * h)
    assert_close(second[:50], difference, atol=1e-5)


def test_no_hidden_units():
    """In metres, points are a thousandth and directions the same."""
    mm, _ = run(SURFACES["convex"], lines(3, SIZE), process(), RADIUS, 200)
    small = process(np.radians(3), 0.4e-3, 1e-3, 6e-3)
    surface = SphereCap((0.05, 0.05), 0.1)
    m, _ = run(surface, lines(3, (0.05, 0.05)), small, RADIUS * 1e-3, 200)
    for name in ("contact", "tip", "xy"):
        assert_close(1e3 * getattr(m, name), getattr(mm, name), rtol=1e-10, atol=1e-11)
    for name in ("normal", "feed_direction", "side", "axis"):
        assert_close(getattr(m, name), getattr(mm, name), atol=1e-12)


def test_single_precision():
    def cast(tree):
        return jax.tree.map(
            lambda x: x.astype(jnp.float32) if eqx.is_inexact_array(x) else x, tree
        )

    at = cast((SURFACES["convex"], POINT, PHASE, process(), RADIUS))
    got = place(*at)
    for leaf in jax.tree.leaves(got):
        assert leaf.dtype == jnp.float32
    want = place(SURFACES["convex"], POINT, PHASE, process(), RADIUS)
    assert_close(got.tip, want.tip, atol=1e-4)
