"""Spectrum: lines of known power, noise of known density, and the marks of paths."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close
from polishopt.contact.removal import Grid, deposit
from polishopt.path import hilbert_rectangle, lines, peano, trochoid
from polishopt.texture.filters import gaussian_filter
from polishopt.texture.spectrum import (
    areal_spectrum,
    band_power,
    directional_mean,
    peak_to_median,
    radial_mean,
    strongest_wave,
)


SHAPE, SPACING = (60, 80), np.array([0.05, 0.03])  # along y, along x


@eqx.filter_jit
def everything(z, spacing, low, high):
    found = areal_spectrum(z, spacing)
    return {
        "spectrum": found,
        "power": band_power(found),
        "band": band_power(found, low, high),
        "radial": radial_mean(found),
        "directions": directional_mean(found, low, high, 18),
        "wave": strongest_wave(found, low, high),
        "ratio": peak_to_median(found, low, high),
    }


def look(z, low=0.0, high=1e9, spacing=SPACING):
    found = everything(*(jnp.asarray(x, float) for x in (z, spacing, low, high)))
    return {
        k: v if k == "spectrum" else jax.tree.map(np.asarray, v) for k, v in found.items()
    }


def wave(kx, ky, amplitude=2e-3, phase=0.4):
    """A wave with a whole number of periods, and its frequencies."""
    y, x = (np.arange(n) / n for n in SHAPE)
    z = amplitude * np.cos(2 * np.pi * (kx * x + ky * y[:, None]) + phase)
    return z, np.array([kx, ky]) / (SPACING * SHAPE)[::-1]


@pytest.mark.parametrize(("kx", "ky"), [(7, 0), (0, 11), (9, 14), (12, -8)])
def test_a_wave_is_a_line(kx, ky):
    """Its power is a^2/2, all of it within one frequency beside its own."""
    z, (fx, fy) = wave(kx, ky)
    f, step = np.hypot(fx, fy), np.max(1 / (SPACING * SHAPE))
    found = look(z + 5.0, f - 1.5 * step, f + 1.5 * step)
    assert_close(found["power"], 2e-3**2 / 2, rtol=1e-12)
    assert_close(found["band"], 2e-3**2 / 2, rtol=1e-12)
    assert_close(np.abs(found["wave"]), np.abs([fx, fy]), rtol=1e-12)
    frequency, density = found["radial"]
    assert abs(frequency[np.argmax(density)] - f) <= step / 2 + 1e-12
    angle, density = found["directions"]
    away = np.mod(angle[np.nanargmax(density)] - np.arctan2(fy, fx) + 0.2, np.pi) - 0.2
    assert abs(away) <= np.pi / 36 + 1e-9


def test_noise_is_flat():
    """Its density is its variance times the area of a pixel, whichever way it is averaged;
    densities are distributed exponentially, with a median of ln 2 of the mean."""
    z = np.random.default_rng(0).normal(0.0, 3e-3, SHAPE)
    want = 3e-3**2 * np.prod(SPACING)
    found = look(z, 2.0, 10.0)
    spectrum = found["spectrum"]
    assert_close(np.mean(spectrum.density), want, rtol=0.1)
    inside = (spectrum.frequency >= 2) & (spectrum.frequency <= 10)
    density = np.asarray(spectrum.density)[np.asarray(inside)]
    assert_close(np.median(density) / want, np.log(2), rtol=0.15)
    assert_close(found["ratio"], density.max() / np.median(density), rtol=1e-12)
    assert np.log2(density.size / 8) - 3 < found["ratio"] < np.log2(density.size) + 8
    _, ring = found["radial"]
    assert_close(np.mean(ring[5:]), want, rtol=0.15)
    _, sector = found["directions"]
    assert_close(np.mean(sector), want, rtol=0.15)
    # Parseval, under the window
    fade = np.outer(*(np.sin(np.pi * (np.arange(n) + 0.5) / n) ** 2 for n in SHAPE))
    level = z - np.sum(fade * z) / np.sum(fade)
    assert_close(found["power"], np.sum((fade * level) ** 2) / np.sum(fade**2), rtol=1e-12)


def test_units_and_gaps():
    """In metres the density is 1e-12 of that in mm^4; a gap counts as the mean."""
    z, (fx, _) = wave(7, 0)
    there = look(z)["spectrum"]
    metres = look(z * 1e-3, spacing=SPACING * 1e-3)["spectrum"]
    assert_close(metres.density, 1e-12 * there.density, rtol=1e-9, atol=1e-40)
    assert_close(metres.fx, 1e3 * there.fx, rtol=1e-12)
    holes = z.copy()
    holes[3:9, 20:30] = np.nan
    filled = np.where(np.isnan(holes), np.nanmean(holes), holes)
    assert_close(look(holes)["power"], look(filled)["power"], rtol=1e-9)
    assert fx > 0


# a part, a spot of Gaussian shape half as wide as the step, and pixels inside its borders
SIDE, COUNT = 60.0, 15
STEP = SIDE / COUNT
SPOT = 0.5 * STEP / 2.354820045  # standard deviation
PIXELS = 120
GRID = Grid(jnp.zeros(2), jnp.full(2, SIDE), (PIXELS, PIXELS))
INNER = slice(12, 108)  # twelve steps, three from each border


@eqx.filter_jit
def removed(points):
    """Depth over its mean inside the part, by the spot at a constant feed."""
    chords = jnp.diff(points, axis=0)
    volume = jnp.sqrt(jnp.sum(chords**2, axis=1))
    depth = deposit((points[1:] + points[:-1]) / 2, volume, GRID)
    cutoff = jnp.asarray(SPOT / 0.187390623)
    inner = gaussian_filter(depth, jnp.asarray(SIDE / PIXELS), cutoff)[INNER, INNER]
    return inner / jnp.mean(inner)


def marks(guide, radius=0.0, step=1.0):
    """What the spectrum says of what a path leaves; a circle of no radius moves it only."""

    @eqx.filter_jit
    def along(guide, s):
        def at(s):
            turn = 2 * jnp.pi * s / step
            return trochoid(guide(s), turn, jnp.asarray(step), jnp.asarray(radius))

        return jax.vmap(at)(s)

    s = guide.length * jnp.asarray(np.linspace(0.0, 1.0, 40001))
    depth = np.asarray(removed(along(guide, s)))
    ends = (0.3 / STEP, 2.5 / STEP)  # a Peano path of this coverage has lines twice as far
    return look(depth, *ends, spacing=np.full(2, SIDE / PIXELS))


SQUARE = (SIDE, SIDE)


@pytest.fixture(scope="module")
def raster():
    return marks(lines(COUNT, SQUARE, "sharp"))


def peak(found, low=0.0, high=np.inf):
    """Highest density of a band around 1/step."""
    f = np.asarray(found["spectrum"].frequency) * STEP
    return np.asarray(found["spectrum"].density)[(f >= low) & (f <= high)].max()


def test_a_raster_has_a_line_at_its_step(raster):
    """With the power that the ripple of Gaussian grooves has in closed form.

    PV/d = 4 exp(-2 pi^2 sigma^2/p^2) of the first harmonic; others are n^2 as far in the
    exponent. The pixels' B-spline takes its share, and leaves aliases of a hundredth.
    """
    assert_close(np.abs(raster["wave"]), [0.0, 1 / STEP], atol=1e-12)
    n = np.arange(1, 3)
    pixel = np.sinc(n * SIDE / PIXELS / STEP) ** 3
    amplitude = 2 * np.exp(-2 * (np.pi * n * SPOT / STEP) ** 2) * pixel
    assert_close(raster["band"], np.sum(amplitude**2) / 2, rtol=0.02)


PATHS = {
    "peano": (peano(2, SQUARE), {}),
    "hilbert": (hilbert_rectangle(COUNT, SQUARE), {}),
    "trochoid": (hilbert_rectangle(COUNT, SQUARE), {"radius": STEP / 2}),
}


@pytest.mark.parametrize(("guide", "loops"), PATHS.values(), ids=PATHS.keys())
def test_other_paths_spread_it(guide, loops, raster):
    """Lines of all waves are weaker than that of the raster, those near 1/step by far."""
    found = marks(guide, **loops)
    assert found["ratio"] < 1e-3 * raster["ratio"]
    assert peak(found) < 0.6 * peak(raster)
    assert peak(found, 0.8, 1.25) < 0.25 * peak(raster)
