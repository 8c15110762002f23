"""The disc against closed forms on the flat, and brute force on curved parts."""

import itertools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
from helpers import assert_close
from polishopt.contact import flat, limits, pressure
from polishopt.parts import Process, Tool


DEG = np.pi / 180
FLAT = jnp.zeros((2, 2))


patch = eqx.filter_jit(pressure.patch)
force_and_area = eqx.filter_jit(pressure.force_and_area)


def disc(diameter=18.0, foundation=0.3, **more):
    fields = {
        "body_radius": 5.0,
        "body_recess": 0.6,
        "unstick_tilts": [3 * DEG, 5 * DEG, 10 * DEG],
        "unstick_forces": [8.0, 12.0, 18.0],
    }
    return Tool(radius=diameter / 2, foundation=foundation, **(fields | more))


def process(tilt_deg, displacement, **more):
    fields = {"step": 1.0, "trochoid_radius": 6.0, "feed": 16.7, "spin": 209.4}
    return Process(tilt=tilt_deg * DEG, displacement=displacement, **(fields | more))


# F/k [mm^3] of a disc of 18 mm: integral of the depth over the touching segment
FORCE_TABLE = {
    0.15: (1.59, 0.75, 0.27, 0.14),
    0.30: (8.64, 4.14, 1.49, 0.81),
    0.40: (17.24, 8.36, 3.03, 1.65),
    0.60: (44.63, 22.31, 8.22, 4.50),
    0.90: (109.1, 58.2, 22.1, 12.2),
    1.20: (185.3, 112.2, 44.3, 24.7),
}


@pytest.mark.parametrize("displacement", FORCE_TABLE)
@pytest.mark.parametrize(("column", "tilt_deg"), enumerate((3, 5, 10, 15)))
def test_force_table(displacement, column, tilt_deg):
    force = flat.flat_force(
        jnp.asarray(9.0),
        jnp.asarray(1.0),
        jnp.asarray(tilt_deg * DEG),
        jnp.asarray(displacement),
    )
    # the table is printed to three figures, or to 0.005 mm^3
    assert_close(force, FORCE_TABLE[displacement][column], rtol=5e-3, atol=5e-3)
    nodes = patch(process(tilt_deg, displacement), disc(foundation=1.0), FLAT)
    assert_close(nodes.force, force, rtol=5e-4)


@pytest.mark.parametrize(
    ("tilt_deg", "displacement", "stiffening"),
    [(3, 0.4, 0.5), (10, 0.6, 2.0), (15, 0.9, -0.3), (3, 1.2, 0.7), (0, 0.3, 1.0)],
)
def test_a_bed_that_stiffens(tilt_deg, displacement, stiffening):
    """Closed form and patch against the integral of k (w + beta w^2) over the disc."""
    radius, tilt = 9.0, tilt_deg * DEG

    def slice_(x):
        depth = displacement - x * math.sin(tilt)
        chord = 2 * math.sqrt(max(x * (2 * radius - x), 0.0))
        return chord * depth * (1 + stiffening * depth)

    end = min(displacement / math.sin(tilt), 2 * radius) if tilt else 2 * radius
    want = 0.3 * math.cos(tilt) * scipy.integrate.quad(slice_, 0, end, epsabs=1e-12)[0]
    given = [radius, 0.3, tilt, displacement, stiffening]
    assert_close(flat.flat_force(*map(jnp.asarray, given)), want, rtol=1e-8)
    tool = disc(foundation=0.3, stiffening=stiffening)
    nodes = patch(process(tilt_deg, displacement), tool, FLAT, rows=24)
    assert_close(nodes.force, want, rtol=1e-4)


def brute_force(tilt_deg, displacement, curvature, diameter=18.0, lean=1.0, count=1500):
    """Force / k, area and width by summing a fine grid of springs."""
    radius, tilt = diameter / 2, tilt_deg * DEG
    line = (np.arange(count) + 0.5) / count * diameter - radius
    towards, y = np.meshgrid(line, line)
    x = radius - towards
    xi = -lean * x * np.cos(tilt)
    sag = curvature[0][0] * xi**2 + 2 * curvature[0][1] * xi * y + curvature[1][1] * y**2
    depth = displacement - x * np.sin(tilt) - sag / 2
    touching = (depth > 0) & (towards**2 + y**2 < radius**2)
    cell = (diameter / count) ** 2 * np.cos(tilt)
    return depth[touching].sum() * cell, touching.sum() * cell


@pytest.mark.parametrize(
    ("tilt_deg", "displacement", "diameter", "radius", "force_ratio"),
    [
        (3, 0.4, 18, 500, 0.80),
        (3, 0.4, 18, 200, 0.63),
        (3, 0.4, 18, 100, 0.47),
        (3, 0.4, 18, 50, 0.32),
        (3, 0.4, 18, -200, 3.42),
        (3, 0.4, 18, -100, 7.89),
        (3, 0.3, 6, 500, 0.92),
        (3, 0.3, 6, 100, 0.69),
        (3, 0.3, 6, -100, 1.47),
        (10, 0.6, 18, 200, 0.87),
        (10, 0.6, 18, 50, 0.64),
        (10, 0.6, 18, -100, 1.55),
    ],
)
def test_curvature_changes_the_force(tilt_deg, displacement, diameter, radius, force_ratio):
    tool, setting = disc(diameter), process(tilt_deg, displacement)
    curved = patch(setting, tool, jnp.eye(2) / radius, rows=8, columns=6, panels=2)
    plane = patch(setting, tool, FLAT, rows=8, columns=6)
    assert_close(curved.force / plane.force, force_ratio, rtol=0.02)
    force, area = brute_force(tilt_deg, displacement, np.eye(2) / radius, diameter)
    assert_close(curved.force, 0.3 * force, rtol=2e-3)
    assert_close(curved.contact_area, area, rtol=5e-3)


@pytest.mark.parametrize("lean", [1.0, -1.0])
def test_saddle_with_twist_matches_brute_force(lean):
    curvature = [[0.004, 0.003], [0.003, -0.002]]
    nodes = patch(
        process(6, 0.5), disc(), jnp.asarray(curvature), lean, rows=16, columns=12, panels=2
    )
    force, area = brute_force(6, 0.5, curvature, lean=lean)
    assert_close(nodes.force, 0.3 * force, rtol=3e-3)
    assert_close(nodes.contact_area, area, rtol=1e-2)


@pytest.mark.parametrize("tilt_deg", [0.5, 3, 10, 40])
@pytest.mark.parametrize("displacement", [0.05, 0.3, 0.9, 2.5])
@pytest.mark.parametrize("stiffening", [0.0, 0.7])
def test_force_and_area_on_a_plane_are_the_closed_forms(tilt_deg, displacement, stiffening):
    tool, setting = disc(stiffening=stiffening), process(tilt_deg, displacement)
    force, area = force_and_area(setting, tool, FLAT)
    pressed = setting.tilt, setting.displacement
    exact = flat.flat_force(tool.radius, tool.foundation, *pressed, tool.stiffening)
    assert_close(force, exact, rtol=1e-9)
    assert_close(area, flat.flat_area(tool.radius, *pressed), rtol=1e-11)


@pytest.mark.parametrize("tilt_deg", [0.0, 0.5, 3, 10, 40])
@pytest.mark.parametrize("displacement", [1e-3, 0.05, 0.3, 0.9, 2.5])
@pytest.mark.parametrize("lean", [1.0, -1.0])
def test_the_patch_on_a_plane_is_that_without_curvature(tilt_deg, displacement, lean):
    tool, setting = disc(stiffening=0.7), process(tilt_deg, displacement)
    one, other = flat.flat_patch(setting, tool, lean), patch(setting, tool, FLAT, lean)
    for got, want in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        assert_close(got, want, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("tilt_deg", [0.0, 3])
@pytest.mark.parametrize("displacement", [-0.1, 0.0])
def test_nothing_presses_on_a_plane_without_displacement(tilt_deg, displacement):
    nodes = flat.flat_patch(process(tilt_deg, displacement), disc())
    assert_close(nodes.pressure, np.zeros((12, 4)), atol=0)


@pytest.mark.parametrize("x", [(3 * DEG, 0.4), (10 * DEG, 0.4), (3 * DEG, 0.946)])
def test_slopes_of_the_patch_on_a_plane_are_those_without_curvature(x):
    def spread(laid):
        def of(x):
            nodes = laid(Process(x[0], x[1], 1.0, 6.0, 16.7, 209.4), disc(stiffening=0.7))
            return jnp.stack([jnp.sum(leaf**2) for leaf in jax.tree.leaves(nodes)])

        return of

    one = spread(flat.flat_patch)
    other = spread(lambda setting, tool: pressure.patch(setting, tool, FLAT))
    got = jax.jacfwd(one)(jnp.asarray(x))
    assert_close(got, jax.jacfwd(other)(jnp.asarray(x)), rtol=1e-8, atol=1e-9)
    assert_close(got, jax.jacrev(one)(jnp.asarray(x)), rtol=1e-9, atol=1e-12)


def by_rays(tilt_deg, displacement, curvature, lean, radius=9.0, count=200_000):
    """Force over the bed's stiffness, and area: along rays from the disc's centre."""
    tilt, ((k, t), (_, m)) = tilt_deg * DEG, np.asarray(curvature)
    ray = 2 * np.pi * (np.arange(count) + 0.5) / count
    cos, sin, k, t = (
        np.cos(ray),
        np.sin(ray),
        np.cos(tilt) ** 2 * k,
        lean * np.cos(tilt) * t,
    )
    # x = radius - rho cos and eta = rho sin make the depth a quadratic in rho
    depth = [
        (displacement - np.sin(tilt) * radius - 0.5 * k * radius**2) * np.ones(count),
        np.sin(tilt) * cos + t * radius * sin + k * radius * cos,
        -t * cos * sin - 0.5 * k * cos**2 - 0.5 * m * sin**2,
    ]
    root = np.sqrt(np.maximum(depth[1] ** 2 - 4 * depth[0] * depth[2], 0.0))
    ends = [np.zeros(count), (-depth[1] - root) / (2 * depth[2])]
    ends += [(-depth[1] + root) / (2 * depth[2]), np.full(count, radius)]
    ends = np.sort(np.clip(ends, 0.0, radius), axis=0)
    force = area = 0.0
    for begin, end in itertools.pairwise(ends):
        middle = 0.5 * (begin + end)
        pressed = sum(d * middle**n for n, d in enumerate(depth)) > 0
        parts = [
            d * (end ** (n + 2) - begin ** (n + 2)) / (n + 2) for n, d in enumerate(depth)
        ]
        force += np.sum(pressed * sum(parts))
        area += np.sum(pressed * (end**2 - begin**2)) / 2
    share = 2 * np.pi / count * np.cos(tilt)
    return share * force, share * area


@pytest.mark.parametrize("lean", [1.0, -1.0])
@pytest.mark.parametrize(
    ("tilt_deg", "displacement", "curvature"),
    [
        (3, 0.3, [[1 / 600, 0], [0, 1 / 150]]),
        (3, 0.9, [[1 / 600, 0], [0, 1 / 150]]),  # past the disc's middle
        (3, 2.0, [[1 / 600, 0], [0, 1 / 150]]),  # the whole disc
        (5, 1.5, [[1 / 100, 1 / 300], [1 / 300, 1 / 150]]),
        (13, 0.2, [[1 / 110, -1 / 260], [-1 / 260, 1 / 85]]),
        (4, 0.9, [[1 / 200, 1 / 250], [1 / 250, -1 / 400]]),  # a saddle
        (4, 0.9, [[-1 / 300, 0], [0, -1 / 300]]),
    ],
)
def test_force_and_area_on_a_curved_part(tilt_deg, displacement, curvature, lean):
    panels = 2 if np.linalg.eigvalsh(curvature).min() < 0 else 1
    setting, bend = process(tilt_deg, displacement), jnp.asarray(curvature)
    got = force_and_area(setting, disc(), bend, lean, panels)
    force, area = by_rays(tilt_deg, displacement, curvature, lean)
    assert_close(got[0], 0.3 * force, rtol=1e-6)
    assert_close(got[1], area, rtol=1e-6)


def test_the_area_has_no_corners_where_rows_come_to_reach_across():
    bend = jnp.asarray([[1 / 600, 1 / 900], [1 / 900, 1 / 150]])

    @jax.jit
    @jax.vmap
    def slopes(displacement):
        def areas(e):
            setting = process(3.0, e)
            _, area = pressure.force_and_area(setting, disc(), bend)
            return jnp.stack([area, pressure.patch(setting, disc(), bend).contact_area])

        return jax.jacfwd(areas)(displacement)

    found = slopes(jnp.linspace(0.3, 1.2, 901))
    jumps = np.max(np.abs(np.diff(found, axis=0)), axis=0) / np.mean(found, axis=0)
    # what the rows of the patch do shows that this can tell
    assert jumps[0] < 0.01 < 0.1 < jumps[1]


def test_full_contact_on_constant_curvature():
    """Winkler: F = k (pi R^2 d - pi R^4 (k_x + k_y) / 8), d the depth at the middle."""
    radius, kx, ky = 9.0, -0.004, -0.002
    nodes = patch(
        process(1e-9, 0.8),
        disc(),
        jnp.diag(jnp.asarray([kx, ky])),
        rows=12,
        columns=8,
        panels=2,
    )
    # e is set at the rim, a radius away from the middle along the feed; the sag of a part
    # with k_x along the feed is measured from there
    total = np.pi * radius**2 * 0.8
    along = np.pi * radius**4 * (1 / 4 + 1) * kx / 2
    across = np.pi * radius**4 / 4 * ky / 2
    assert_close(nodes.force, 0.3 * (total - along - across), rtol=1e-6)


def test_flat_disc_presses_as_a_whole():
    nodes = patch(process(0, 0.2), disc(), FLAT)
    assert_close(nodes.force, 0.3 * 0.2 * np.pi * 81, rtol=1e-3)


def test_patch_geometry():
    setting, tool = process(5, 0.6), disc()
    pulling = patch(setting, tool, FLAT)
    pushing = patch(setting, tool, FLAT, lean=-1.0)
    assert (pulling.offsets[..., 0] <= 0).all(), (
        "a pulled disc touches behind its rim point"
    )
    assert_close(pushing.offsets[..., 0], -pulling.offsets[..., 0])
    assert_close(pulling.pressure, pushing.pressure)
    width = 2 * jnp.abs(pulling.offsets[..., 1]).max()
    d_eff = flat.effective_diameter(tool.radius, setting.tilt, setting.displacement)
    assert 0.9 * d_eff < width < d_eff
    area = flat.flat_area(tool.radius, setting.tilt, setting.displacement)
    assert_close(pulling.contact_area, area, rtol=1e-3)


def test_effective_diameter():
    r9, tilt = jnp.asarray(9.0), jnp.asarray(3 * DEG)
    l = 9.0 - 0.4 / np.sin(3 * DEG)
    assert_close(
        flat.effective_diameter(r9, tilt, jnp.asarray(0.4)), 2 * np.sqrt(81 - l**2)
    )
    # past the middle of the disc the width is the diameter, where S0 eq. (6) has 2.48 mm
    r3 = jnp.asarray(3.0)
    assert_close(flat.effective_diameter(r3, tilt, jnp.asarray(0.3)), 6.0)
    assert_close(flat.envelope(r3, process(3, 0.3)), 18.0)


def test_unstick_limits():
    tool = disc(shear_strength=0.1)
    for tilt_deg in (5, 10, 15):
        critical = 0.6 * np.cos(tilt_deg * DEG) + 4 * np.sin(tilt_deg * DEG)
        assert_close(limits.body_clearance(process(tilt_deg, 1.2), tool), critical - 1.2)
        # S0 Fig. 4: at 1.2 mm only the 5 degree curve has come unstuck
        assert (critical < 1.2) == (tilt_deg == 5)
    assert_close(limits.unstick_force(jnp.asarray(4 * DEG), tool), 10.0)
    assert_close(limits.unstick_force(jnp.asarray(20 * DEG), tool), 18.0)
    assert_close(limits.shear_margin(process(5, 0.5), tool), 0.1 - 0.4 * 0.3 * 0.5)


def test_no_hidden_units():
    """Restated in metres (and pascals), every length, area and force follows."""
    tool = disc()
    metres = Tool(
        radius=9e-3,
        foundation=0.3e9,
        body_radius=5e-3,
        body_recess=0.6e-3,
        unstick_tilts=tool.unstick_tilts,
        unstick_forces=tool.unstick_forces,
    )
    here = patch(process(5, 0.4), tool, jnp.eye(2) / 100)
    there = patch(process(5, 0.4e-3), metres, jnp.eye(2) / 0.1)
    assert_close(there.force, here.force, rtol=1e-9)
    assert_close(there.contact_area, 1e-6 * here.contact_area, rtol=1e-9)
    assert_close(there.pressure, 1e6 * here.pressure, rtol=1e-7, atol=1e-3)
    assert_close(
        flat.flat_force(metres.radius, metres.foundation, *map(jnp.asarray, (0.1, 4e-4))),
        flat.flat_force(tool.radius, tool.foundation, *map(jnp.asarray, (0.1, 0.4))),
    )


@jax.jit
def outcomes(x):
    """What depends on (tilt, displacement, curvature), for the gradient tests."""
    tool, setting = disc(), Process(x[0], x[1], 1.0, 6.0, 16.7, 209.4)
    nodes = pressure.patch(setting, tool, x[2] * jnp.eye(2), panels=2)
    return jnp.stack(
        [
            nodes.force,
            jnp.sum(nodes.pressure * nodes.area**2),
            flat.flat_force(tool.radius, tool.foundation, x[0], x[1]),
            flat.flat_area(tool.radius, x[0], x[1]),
            *pressure.force_and_area(setting, tool, x[2] * jnp.eye(2), panels=2),
            nodes.contact_area,
            jnp.sum(nodes.offsets**2),
            flat.effective_diameter(tool.radius, x[0], x[1]),
        ]
    )


forward, reverse = jax.jit(jax.jacfwd(outcomes)), jax.jit(jax.jacrev(outcomes))


@pytest.mark.parametrize(
    ("tilt_deg", "displacement"),
    # on both sides of full contact (0.942 mm) and of contact past the middle (0.471 mm)
    [(3, 0.4), (10, 0.4), (3, 0.938), (3, 0.946), (3, 0.4705), (15, 1e-3)],
)
@pytest.mark.parametrize("bend", [1e-9, 0.01, -0.005])
def test_gradients(tilt_deg, displacement, bend):
    x = np.array([tilt_deg * DEG, displacement, bend])
    got = forward(x)
    assert_close(reverse(x), got, rtol=1e-8, atol=1e-9)
    for i in range(2):
        h = np.eye(3)[i] * 1e-6 * x[i]
        slope = (outcomes(x + h) - outcomes(x - h)) / (2 * h[i])
        assert_close(got[:6, i], slope[:6], rtol=2e-5, atol=1e-6)


@pytest.mark.parametrize("tilt", [0.0, 0.1])
@pytest.mark.parametrize("displacement", [0.0, -0.1, 0.5, 18 * np.sin(0.1), 0.9])
@pytest.mark.parametrize("bend", [0.0, 0.01, -0.01])
def test_gradients_are_finite_at_every_corner(tilt, displacement, bend):
    x = np.array([tilt, displacement, bend])
    for values in (outcomes(x), forward(x), reverse(x)):
        assert np.isfinite(values).all()


@pytest.mark.parametrize("tilt", [0.0, 1e-9, 0.1])
@pytest.mark.parametrize("displacement", [0.0, -0.1, 0.5])
def test_gradients_are_finite_in_single_precision_too(tilt, displacement):
    with jax.enable_x64(False):
        got = reverse(jnp.asarray([tilt, displacement, 0.0], dtype=jnp.float32))
        assert got.dtype == jnp.float32
        assert np.isfinite(got).all()
