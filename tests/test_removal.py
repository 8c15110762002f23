"""Superposition of a footprint against closed forms, and its conservation of volume."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close, assert_gradient, fast_jit
from polishopt.contact import pressure, removal
from polishopt.contact.ripple import ripple
from polishopt.parts import Process, Tool
from polishopt.path.guide import Bends
from scipy.interpolate import BSpline


superpose = fast_jit(removal.superpose)
patch_of = eqx.filter_jit(pressure.patch)
rates_of = eqx.filter_jit(removal.preston_rates)


@eqx.filter_jit
def moments_of(*given):
    """The waves, and their moments at a density of one."""
    waves = ripple(*given)
    return waves, waves.moments(jnp.ones(()))


def flat_disc(radius, force_pressure, preston, spin, rows=240, columns=24):
    """A disc pressed flat, as a footprint around its own centre."""
    setting = Process(0.0, force_pressure, 1.0, 1.0, 1.0, spin)
    tool = Tool(radius, 1.0, radius, 1.0, [0.0], [1.0])
    patch = patch_of(setting, tool, jnp.zeros((2, 2)), rows=rows, columns=columns)
    rates = rates_of(patch, jnp.asarray(preston), setting.tilt, setting.spin, jnp.zeros(2))
    return removal.Footprint(patch.arms.reshape(-1, 2), rates.reshape(-1))


def test_line_removal_of_a_flat_rotating_disc():
    """Lin et al. (2014), Robotics and Biomimetics 1:24, eq. (5), for v << omega R."""
    radius, pressure_, preston, spin, speed = 9.0, 0.05, 4e-7, 209.4, 16.7
    footprint = flat_disc(radius, pressure_, preston, spin)
    x = np.linspace(-13, 13, 261)
    points = jnp.asarray(np.stack([x, np.zeros_like(x)], axis=1))
    dwell = jnp.full(x.size, (x[1] - x[0]) / speed)
    grid = removal.Grid([-1.0, -12.0], [2.0, 24.0], (60, 5))
    depth = superpose(footprint, points, dwell, grid)[:, 2]

    scale = preston * pressure_ * spin / speed

    def line(y):
        y = np.abs(y)
        inside = y < radius
        chord = np.sqrt(np.where(inside, radius**2 - y**2, 0))
        log = np.log(radius + chord) - np.log(y)
        return np.where(inside, scale * (radius * chord + y**2 * log), 0)

    # a pixel holds the mean under a quadratic B-spline three pixels wide
    t = (np.arange(600) + 0.5) / 200 - 1.5
    weight = np.where(np.abs(t) < 0.5, 0.75 - t**2, 0.5 * (1.5 - np.abs(t)) ** 2)
    y = np.asarray(grid.y)
    exact = line(y[:, None] + 0.4 * t) @ weight / weight.sum()
    y = np.abs(y)
    away = y < 0.9 * radius
    assert_close(depth[away], exact[away], rtol=1e-3)
    assert y[np.argmax(depth)] == pytest.approx(0.55 * radius, abs=0.3)
    total = jnp.sum(depth) * grid.spacing[1]
    assert_close(total, scale * 2 * np.pi * radius**3 / 3, rtol=1e-3)


@pytest.mark.parametrize("seed", range(3))
def test_volume_is_conserved(seed):
    rng = np.random.default_rng(seed)
    footprint = removal.Footprint(
        jnp.asarray(rng.uniform(-3, 3, (200, 2))), jnp.asarray(rng.uniform(0, 1, 200))
    )
    points = jnp.asarray(rng.uniform(-10, 10, (317, 2)))
    dwell = jnp.asarray(rng.uniform(0, 1, 317))
    angle = rng.uniform(0, 6, 317)
    frames = np.stack([np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)], -1)
    frames = jnp.asarray(frames.reshape(-1, 2, 2))
    grid = removal.Grid([-16, -17], [33, 34], (61, 53))
    depth = superpose(footprint, points, dwell, grid, frames, block=5000)
    volume = jnp.sum(depth) * grid.pixel_area
    assert_close(volume, jnp.sum(footprint.rates) * jnp.sum(dwell), rtol=1e-10)
    assert_close(
        depth, superpose(footprint, points, dwell, grid, frames), rtol=1e-10, atol=1e-12
    )


def test_a_deposit_is_the_spline_on_every_pixel():
    """Against scipy's B-spline: within the grid, across its edges, between pixels, away."""
    spline = BSpline.basis_element([-1.5, -0.5, 0.5, 1.5], extrapolate=False)
    rng = np.random.default_rng(2)
    grid = removal.Grid([-1, 2], [12, 8], (7, 9))
    x, y, spacing = (np.asarray(line) for line in (grid.x, grid.y, grid.spacing))
    on = np.stack([x[2] + np.asarray([0.0, 0.5, 1.0]) * spacing[0], y[:3]])
    points = np.concatenate([rng.uniform(-4, 14, (60, 2)), on.T, [[1e9, 3], [3, -1e300]]])
    volumes = rng.uniform(1, 2, len(points))
    weights = [
        np.nan_to_num(spline((points[:, i, None] - line) / spacing[i]))
        for i, line in enumerate((x, y))
    ]
    want = np.einsum("n,ny,nx->yx", volumes, weights[1], weights[0])
    want /= float(grid.pixel_area)
    put = jax.jit(lambda points: removal.deposit(points, jnp.asarray(volumes), grid))
    assert_close(put(jnp.asarray(points)), want, rtol=1e-13, atol=1e-13)
    # no place on the grid tells what a point that is not a number has removed
    assert np.isnan(put(jnp.asarray(points).at[0, 0].set(jnp.nan))).any()


def test_fraction_inside_is_what_the_map_holds():
    rng = np.random.default_rng(0)
    grid = removal.Grid([0, 0], [10, 8], (7, 9))
    points = jnp.asarray(rng.uniform(-4, 14, (400, 2)))

    @jax.jit
    def both(points):
        one = jax.vmap(lambda p: jnp.sum(removal.deposit(p[None], jnp.ones(1), grid)))
        return removal.fraction_inside(points, grid), one(points)

    inside, one = both(points)
    assert_close(inside, one * grid.pixel_area, atol=1e-12)


def test_measured_and_sampled_footprints_agree():
    def rate(xy):
        return jnp.exp(-jnp.sum(xy**2, axis=1) / 2)

    sampled = removal.Footprint.sampled(rate, 6.0, 60)
    line = (np.arange(60) + 0.5) * 0.2 - 6
    x, y = np.meshgrid(line, line)
    measured = removal.Footprint.measured(jnp.exp(-jnp.asarray(x**2 + y**2) / 2), 0.2)
    assert_close(measured.offsets, sampled.offsets, atol=1e-12)
    assert_close(measured.rates, sampled.rates)
    assert_close(jnp.sum(sampled.rates), 2 * np.pi, rtol=1e-6)


def test_gaussian_footprint_on_a_raster_leaves_the_known_ripple():
    """PV / mean depth = 4 exp(-2 pi^2 sigma^2 / p^2) for lines of pitch p."""
    sigma, pitch = 1.0, 2.5

    def rate(xy):
        return jnp.exp(-jnp.sum(xy**2, axis=1) / (2 * sigma**2))

    footprint = removal.Footprint.sampled(rate, 6.0, 96)
    lines = np.arange(-6, 7) * pitch
    x = np.arange(-8, 8, 0.25)
    points = jnp.asarray(np.stack(np.meshgrid(x, lines), axis=-1).reshape(-1, 2))
    grid = removal.Grid([-0.25, -2.5625], [0.5, 5.0], (40, 1))
    depth = np.asarray(superpose(footprint, points, jnp.ones(points.shape[0]), grid))
    spread = np.ptp(depth) / depth.mean()
    blur = np.sinc(0.125 / pitch) ** 3  # of the B-spline, pixels of 0.125 mm
    assert_close(spread, 4 * np.exp(-2 * np.pi**2 * sigma**2 / pitch**2) * blur, rtol=5e-3)


def test_speed_includes_the_feed():
    """At the disc's centre only the feed moves the abrasive."""
    setting = Process(0.0, 0.1, 1.0, 1.0, 1.0, 100.0)
    tool = Tool(9.0, 1.0, 9.0, 1.0, [0.0], [1.0])
    patch = patch_of(setting, tool, jnp.zeros((2, 2)), rows=1, columns=1)
    patch = eqx.tree_at(lambda p: p.arms, patch, jnp.asarray([[[0.0, 0.0]], [[0.0, 2.0]]]))
    rates = rates_of(
        patch, jnp.asarray(1.0), setting.tilt, setting.spin, jnp.asarray([3.0, 4.0])
    )
    weight = patch.pressure * patch.area
    speed = [[5.0], [np.hypot(-200.0 + 3.0, 4.0)]]
    assert_close(rates, np.asarray(weight) * np.asarray(speed))


def test_ripple_of_a_straight_trochoid_matches_the_resolved_removal():
    """Against direct superposition along 40 loops of a straight guide."""
    radius, circle, step, speed = 3.0, 2.0, 2.0, 16.7
    setting = Process(0.05, 0.15, step, circle, speed, 209.4)
    tool = Tool(radius, 0.3, 2.0, 0.5, [0.0], [9.0])
    phase = np.arange(256) / 256 * 2 * np.pi
    turn = 2 * np.pi * circle / step
    pace = np.hypot(1 + turn * np.cos(phase), turn * np.sin(phase)) / speed

    # one period of the map, from every loop that reaches it
    fine = patch_of(setting, tool, jnp.zeros((2, 2)), rows=40, columns=96)
    fine_rates = rates_of(fine, jnp.asarray(4e-7), setting.tilt, setting.spin, jnp.zeros(2))
    footprint = removal.Footprint(fine.offsets.reshape(-1, 2), fine_rates.reshape(-1))
    s = np.arange(-8, 8, step / 64)
    phi = 2 * np.pi * s / step
    points = np.stack([s + circle * np.sin(phi), circle * np.cos(phi)], axis=1)
    dwell = np.hypot(1 + turn * np.cos(phi), turn * np.sin(phi)) / speed * step / 64
    nx, ny = 20, 120
    grid = removal.Grid([-step / 2, -6.0], [step, 12.0], (ny, nx))
    depth = superpose(footprint, jnp.asarray(points), jnp.asarray(dwell), grid)
    wave = np.abs(np.fft.rfft(np.asarray(depth), axis=1))[:, 1:4] / nx
    wave = wave / np.sinc(np.arange(1, 4) / nx) ** 3  # the B-spline's blur along x
    waves, (second, fourth) = moments_of(
        setting,
        tool,
        jnp.asarray(4e-7),
        Bends(jnp.zeros(1), jnp.zeros(1), jnp.ones(1)),
        jnp.zeros((2, 2)),
        jnp.asarray(np.sqrt(np.mean(pace**2))),
        jnp.sum(fine_rates),
    )
    squares = 2 * np.sum(wave**2, axis=0) * 12 / ny
    rms = jnp.sqrt(jnp.sum(waves.variances, axis=(0, 2)))
    assert_close(rms[:2], np.sqrt(squares[:2]), rtol=0.07)
    assert_close(second, np.sum(squares), rtol=0.1)
    # more than the evenly spread ripple has, which is weaker where it is strongest
    assert 1 < -6 * np.sum(wave**4) * 12 / ny / fourth < 4


def test_gradients():
    grid = removal.Grid([0, 0], [10, 8], (7, 9))
    rng = np.random.default_rng(0)
    points = rng.uniform(1, 7, (20, 2))
    points[0] = grid.origin + 2 * grid.spacing  # from three pixels to the next three
    points = jnp.asarray(points)

    def outcomes(x):
        depth = removal.deposit(points * x[0], jnp.arange(20.0) * x[1], grid)
        inside = removal.fraction_inside(points * x[0] * 1.5, grid)
        return jnp.stack([jnp.sum(depth**2), jnp.sum(inside), depth[3, 3]])

    assert_gradient(outcomes, jnp.asarray([1.0, 2.0]), rtol=1e-6)
