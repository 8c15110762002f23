"""Autocorrelation, decay lengths and lay against sums by hand and known fields."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close
from polishopt.texture.lay import texture_direction
from polishopt.texture.spatial import (
    autocorrelation,
    decay_lengths,
    spatial_parameters,
)
from scipy import ndimage


correlation_of = jax.jit(autocorrelation)
decay_of = jax.jit(decay_lengths)
parameters_of = jax.jit(spatial_parameters)
lay_of = jax.jit(texture_direction)


def by_hand(z):
    """Mean product of all measured pairs at each lag, one lag after the other."""
    z = z - np.nanmean(z)
    ny, nx = z.shape
    found = np.full((2 * ny - 1, 2 * nx - 1), np.nan)
    for i in range(ny):
        for j in range(1 - nx, nx):
            a = z[: ny - i, max(0, -j) : nx - max(0, j)]
            b = z[i:, max(0, j) : nx + min(0, j)]
            pairs = a * b
            if np.isfinite(pairs).any():
                value = np.nanmean(pairs)
                found[ny - 1 + i, nx - 1 + j] = found[ny - 1 - i, nx - 1 - j] = value
    return found / found[ny - 1, nx - 1]


def ideal(shape, correlation):
    """An autocorrelation given as a function of lags along y and x."""
    y, x = (np.arange(1 - n, n) for n in shape)
    return jnp.asarray(correlation(y[:, None], x[None, :]))


def grating(angle, shape=(100, 130), spacing=(1.0, 1.0), wavelength=9.0):
    """Wave whose crests, the lay, run at an angle from x towards y."""
    y, x = (d * np.arange(n) for d, n in zip(spacing, shape, strict=True))
    across = -np.sin(angle) * x[None, :] + np.cos(angle) * y[:, None]
    return jnp.asarray(np.cos(2 * np.pi * across / wavelength + 0.3))


@pytest.mark.parametrize("gaps", [False, True])
def test_autocorrelation_is_the_mean_over_pairs(gaps):
    z = np.random.default_rng(0).gamma(2.0, size=(9, 13))
    if gaps:
        z[np.random.default_rng(1).random(z.shape) < 0.3] = np.nan
        z[0, :] = z[0, 0]  # a row of one height, or of none
    want = by_hand(z)
    got = np.asarray(correlation_of(jnp.asarray(z)))
    assert (np.isnan(got) == np.isnan(want)).all()
    np.testing.assert_allclose(got, want, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("length", [2.0, 3.0, 6.0])
def test_decay_of_a_Gaussian(length):
    got = decay_of(ideal((60, 50), lambda y, x: np.exp(-(x**2 + y**2) / length**2)), 1.0)
    # polynomials of the fifth degree, which on diagonals have steps of 1.4 points
    assert_close(jnp.stack(got), length * np.sqrt(np.log(5)), rtol=0.6 / length**5)


@pytest.mark.parametrize("angle", [0.0, 0.4, np.pi / 4, 1.2, 2.0])
@pytest.mark.parametrize("spacing", [(1.0, 1.0), (0.7, 1.6)])
def test_decay_of_an_oblique_ellipse(angle, spacing):
    long, short = 20.0, 4.0
    dy, dx = spacing
    c, s = np.cos(angle), np.sin(angle)

    def correlation(y, x):
        along, across = c * x * dx + s * y * dy, c * y * dy - s * x * dx
        return np.exp(-((along / long) ** 2) - (across / short) ** 2)

    got = decay_of(ideal((60, 50), correlation), jnp.asarray(spacing))
    want = np.sqrt(np.log(5)) * np.array([short, long])
    assert_close(jnp.stack(got), want, rtol=2e-3)


def test_decay_is_the_first_along_a_ray():
    """A cosine comes back over the level, and the ray must not know."""
    waves = ideal((60, 50), lambda y, x: np.cos(0.3 * np.hypot(x, y)))
    assert_close(jnp.stack(decay_of(waves, 1.0)), np.arccos(0.2) / 0.3, rtol=1e-3)


def test_what_does_not_decay_has_no_aspect_ratio():
    stripes = ideal((60, 50), lambda y, x: np.cos(0.3 * x) + 0.0 * y)
    shortest, longest = decay_of(stripes, 1.0)
    assert_close(shortest, np.arccos(0.2) / 0.3, rtol=1e-3)
    assert np.isnan(longest)
    assert np.isnan(
        jnp.stack(decay_of(ideal((60, 50), lambda y, x: 1.0 + 0 * (x + y)), 1.0))
    ).all()
    flat = parameters_of(jnp.ones((100, 130)), 1.0)
    assert np.isnan(jnp.stack(jax.tree.leaves(flat))).all()


def test_Sal_and_Str_of_a_grating():
    p = parameters_of(grating(np.pi / 2), 1.0)
    # unbiased: the length of the map does not show
    assert_close(p.Sal, 9.0 * np.arccos(0.2) / (2 * np.pi), rtol=1e-2)
    assert np.isnan(p.Str)


@pytest.mark.parametrize("degrees", [0.0, 20.0, 45.0, 83.0, 90.0, 127.0, 179.0])
def test_lay_of_a_grating(degrees):
    for spacing in ((1.0, 1.0), (0.8, 1.3)):
        z = grating(np.radians(degrees), spacing=spacing)
        got = np.degrees(lay_of(z, jnp.asarray(spacing)))
        off = (got - degrees + 90) % 180 - 90
        assert abs(off) < 0.3
        assert 0 <= got < 180


def test_lay_is_seen_through_noise_and_gaps():
    rng = np.random.default_rng(3)
    z = np.array(grating(np.radians(30.0))) + rng.normal(size=(100, 130))
    z[rng.random(z.shape) < 0.1] = np.nan
    assert_close(np.degrees(lay_of(jnp.asarray(z), 1.0)), 30.0, atol=1.5, rtol=0)


def test_unmeasured_points_hardly_move_the_parameters():
    rng = np.random.default_rng(3)
    z = ndimage.gaussian_filter(rng.normal(size=(100, 130)), (3.0, 5.0))
    whole = parameters_of(jnp.asarray(z), 1.0)
    z[rng.random(z.shape) < 0.1] = np.nan
    holed = parameters_of(jnp.asarray(z), 1.0)
    assert_close(holed.Sal, whole.Sal, rtol=0.05)
    assert_close(holed.Str, whole.Str, rtol=0.1)


def test_single_precision_of_nanometres():
    rng = np.random.default_rng(4)
    z = ndimage.gaussian_filter(rng.normal(size=(100, 130)), (2.0, 4.0))
    z = jnp.asarray(1e-6 * z)
    got, want = parameters_of(z.astype(jnp.float32), 0.01), parameters_of(z, 0.01)
    for a, b in zip(jax.tree.leaves(got), jax.tree.leaves(want), strict=True):
        assert a.dtype == jnp.float32
        assert_close(a, b, rtol=1e-3)
