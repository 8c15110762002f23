"""Filters and form removal against closed forms, scipy and numpy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close, assert_gradient
from polishopt.texture.filters import (
    L_filter,
    S_filter,
    form,
    gaussian_filter,
    gaussian_transmission,
    scale_limited,
)
from scipy import ndimage


filtered = jax.jit(gaussian_filter, static_argnames="periodic")
form_of = jax.jit(form, static_argnames="degree")


def rough(seed=0, shape=(24, 31)):
    return jnp.asarray(np.random.default_rng(seed).gamma(2.0, size=shape))


def with_gaps(z, share=0.2, seed=0):
    gap = np.random.default_rng(seed).random(z.shape) < share
    return jnp.where(jnp.asarray(gap), jnp.nan, z), gap


def test_transmission():
    wavelength = jnp.asarray([0.08, 0.8, 8.0, jnp.inf])
    got = gaussian_transmission(wavelength, 0.8)
    assert_close(got, [2.0**-100, 0.5, 2.0**-0.01, 1.0])
    assert_close(gaussian_transmission(wavelength, jnp.inf), [0.0, 0.0, 0.0, 1.0])
    assert_close(gaussian_transmission(jnp.zeros(2), 0.8), 0.0)


def test_transmission_gradients_are_finite():
    slope = jax.jit(jax.grad(gaussian_transmission, (0, 1)))
    for cutoff in (0.3, jnp.inf):
        for wavelength in (0.0, 0.2, jnp.inf):
            grads = slope(jnp.asarray(wavelength), jnp.asarray(cutoff))
            assert np.isfinite(grads).all()
    assert_gradient(lambda x: gaussian_transmission(x[:1], x[1]), jnp.asarray([0.3, 0.4]))


def test_periodic_filter_halves_a_wave_at_the_cutoff():
    wave = np.sin(2 * np.pi * 3 * np.arange(60) / 60)
    z = jnp.asarray(wave[:, None] * np.ones((1, 16)) + 5.0)
    got = filtered(z, jnp.asarray([0.01, 0.5]), jnp.asarray(0.2), periodic=True)
    assert_close(got, 0.5 * (z - 5.0) + 5.0, rtol=1e-12)


def test_filter_agrees_with_scipy():
    z, cutoff, spacing = rough(6, (64, 48)), 0.09, 0.01
    sigma = 0.18739 * cutoff / spacing
    want = ndimage.gaussian_filter(np.asarray(z), sigma, mode="wrap", truncate=8)
    # sampling the kernel instead of its spectrum costs exp(-2 (pi sigma)^2)
    assert_close(filtered(z, spacing, cutoff, periodic=True), want, rtol=1e-5)
    weight = ndimage.gaussian_filter(np.ones(z.shape), sigma, mode="constant", truncate=8)
    want = ndimage.gaussian_filter(np.asarray(z), sigma, mode="constant", truncate=8)
    assert_close(filtered(z, spacing, cutoff), want / weight, rtol=1e-5)


@pytest.mark.parametrize("periodic", [True, False])
def test_filter_keeps_a_constant_and_flattens_at_infinite_cutoff(periodic):
    z = rough(7)
    flat = filtered(jnp.full((9, 8), 2.5), 0.1, 0.4, periodic)
    assert_close(flat, 2.5, rtol=1e-12)
    assert_close(filtered(z, 0.1, jnp.inf, periodic), jnp.mean(z), rtol=1e-12)
    assert_gradient(lambda c: filtered(z, 0.1, c[0], periodic)[::5, 3], jnp.asarray([0.5]))


def test_filter_in_single_precision():
    z = rough(8).astype(jnp.float32)
    for periodic in (True, False):
        got = filtered(z, 0.1, jnp.asarray(0.4, jnp.float32), periodic)
        assert got.dtype == jnp.float32
        want = filtered(z.astype(jnp.float64), 0.1, 0.4, periodic)
        assert_close(got, want, rtol=1e-5)


@pytest.mark.parametrize("periodic", [True, False])
def test_filter_leaves_unmeasured_points_out(periodic):
    z, gap = with_gaps(rough(9))
    got = np.asarray(filtered(z, 0.1, 0.9, periodic))
    assert (np.isnan(got) == gap).all()
    mode, sigma = ("wrap" if periodic else "constant"), 0.187391 * 0.9 / 0.1
    blur = [
        ndimage.gaussian_filter(np.where(gap, 0.0, part), sigma, mode=mode, truncate=8)
        for part in (np.asarray(z), np.ones(z.shape))
    ]
    assert_close(got[~gap], (blur[0] / blur[1])[~gap], rtol=1e-5)
    flat, _ = with_gaps(jnp.full(z.shape, 2.5))
    assert_close(np.asarray(filtered(flat, 0.1, 0.9, periodic))[~gap], 2.5, rtol=1e-12)


def test_S_and_L_filter_share_a_map():
    z, cutoff = rough(1), jnp.asarray(0.4)
    for periodic in (False, True):
        short = S_filter(z, 0.1, cutoff, periodic)
        assert_close(short + L_filter(z, 0.1, cutoff, periodic), z, rtol=1e-12)


def test_L_filter_passes_waves_by_their_length():
    """A cosine of a whole number of half-waves meets its own mirror image at the border."""
    n, cutoff = 200, 0.8
    x = (np.arange(n) + 0.5) * 0.01
    for wavelength in (0.2, 0.8, 2.0):
        z = np.cos(2 * np.pi * x / wavelength)[None, :] * np.ones((n, 1))
        passed = 1 - np.exp(-np.log(2) * (cutoff / wavelength) ** 2)
        got = L_filter(jnp.asarray(z), 0.01, cutoff, periodic=wavelength == 0.2)
        middle = slice(80, 120)
        assert_close(got[:, middle], passed * z[:, middle], rtol=0.0, atol=0.03)


@pytest.mark.parametrize("degree", [0, 1, 2, 5])
@pytest.mark.parametrize("gaps", [False, True])
def test_form_is_the_least_squares_polynomial(degree, gaps):
    z = rough(2, (12, 17)) * 1e-3 + 4.0
    if gaps:
        z, _ = with_gaps(z)
    got = form_of(z, degree=degree)
    y, x = (
        v.ravel()
        for v in np.meshgrid(*(np.linspace(-1, 1, n) for n in z.shape), indexing="ij")
    )
    columns = np.stack(
        [y**i * x**j for i in range(degree + 1) for j in range(degree + 1 - i)], 1
    )
    flat = np.asarray(z).ravel()
    known = np.isfinite(flat)
    factor = np.linalg.lstsq(columns[known], flat[known], rcond=None)[0]
    assert_close(got.ravel(), columns @ factor, rtol=1e-10)


def test_form_takes_out_a_polynomial_and_nothing_twice():
    y, x = np.meshgrid(np.linspace(0, 3, 20), np.linspace(-1, 4, 30), indexing="ij")
    shape = jnp.asarray(1.0 + 2 * x - y + 0.3 * x * y - 0.7 * y**2)
    assert_close(shape - form_of(shape, degree=2), 0.0, atol=1e-12)
    z = rough(3, (20, 30))
    rest = z - form_of(z, degree=2)
    assert_close(form_of(rest, degree=2), 0.0, atol=1e-13)
    got = form_of(z.astype(jnp.float32), degree=2)
    assert got.dtype == jnp.float32
    assert_close(got, form_of(z, degree=2), rtol=1e-4)


@pytest.mark.parametrize("degree", [-1, 12])
def test_form_of_a_degree_out_of_range_is_refused(degree):
    with pytest.raises(ValueError, match=r"must lie in \[0, 11\] for a map of 12 x 17"):
        form(rough(2, (12, 17)), degree)


def test_scale_limited_surface():
    z = rough(4, (24, 31))
    step = S_filter(z, 0.1, 0.3)
    step = step - form(step, 2)
    got = scale_limited(z, 0.1, short=0.3, degree=2, long=0.9)
    assert_close(got, L_filter(step, 0.1, 0.9), rtol=1e-12)
    assert_close(scale_limited(z, 0.1, degree=None), z)
    assert_close(scale_limited(z, 0.1), z - form(z), rtol=1e-12)
