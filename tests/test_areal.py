"""Areal parameters against closed forms, surfalize and scipy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close, assert_gradient
from polishopt.texture.areal import (
    Cumulants,
    Sa_estimate,
    cumulants,
    height_parameters,
    parameters_from_cumulants,
)
from polishopt.texture.filters import gaussian_filter, gaussian_transmission
from scipy import ndimage, special, stats


heights_of = jax.jit(height_parameters)
cumulants_of = jax.jit(cumulants)
filtered = jax.jit(gaussian_filter, static_argnames="periodic")


def sine(n=2000, periods=1, amplitude=1.0):
    x = (np.arange(n) + 0.5) / n
    return jnp.asarray(
        amplitude * np.sin(2 * np.pi * periods * x)[None, :] * np.ones((3, 1))
    )


def rough(seed=0, shape=(24, 31)):
    return jnp.asarray(np.random.default_rng(seed).gamma(2.0, size=shape))


def test_sine_over_a_whole_period():
    p = heights_of(sine())
    # the midpoint sum of |sin| is off by (pi/n)^2/6; the powers of sin are exact
    assert_close(p.Sa, 2 / np.pi, rtol=1e-6)
    assert_close(p.Sq, 1 / np.sqrt(2))
    assert_close(p.Ssk, 0.0, atol=1e-12)
    assert_close(p.Sku, 1.5)
    assert_close(jnp.stack([p.Sp, p.Sv, p.Sz]), [1.0, 1.0, 2.0], rtol=1e-5)


def test_square_wave_has_the_smallest_kurtosis():
    p = heights_of(jnp.asarray([[1.0, -1.0], [-1.0, 1.0]]))
    assert_close(jnp.stack([p.Sa, p.Sq, p.Ssk, p.Sku]), [1.0, 1.0, 0.0, 1.0])


@pytest.mark.parametrize("seed", range(3))
def test_agrees_with_surfalize(seed):
    surfalize = pytest.importorskip("surfalize", reason="surfalize is not installed")
    z = np.asarray(rough(seed, (50, 70)))
    got, want = heights_of(jnp.asarray(z)), surfalize.Surface(z, 1.0, 1.0)
    for name in ("Sa", "Sq", "Ssk", "Sku", "Sp", "Sv", "Sz"):
        assert_close(getattr(got, name), getattr(want, name)(), rtol=1e-9)


def test_scale_and_offset():
    z = rough()
    p, up, down = (heights_of(s * z + 7.0) for s in (1.0, 1e-6, -1e-6))
    for name in ("Sa", "Sq", "Sp", "Sv", "Sz"):
        assert_close(getattr(up, name), 1e-6 * getattr(p, name), rtol=1e-8)
    assert_close(jnp.stack([up.Ssk, up.Sku]), jnp.stack([p.Ssk, p.Sku]), rtol=1e-7)
    assert_close(jnp.stack([down.Ssk, down.Sku]), jnp.stack([-p.Ssk, p.Sku]), rtol=1e-7)
    assert_close(down.Sp, up.Sv, rtol=1e-8)


def test_flat_surface_has_finite_values_and_gradients():
    @jax.jit
    def four(z):
        p = height_parameters(z)
        return jnp.stack([p.Sa, p.Sq, p.Ssk, p.Sku])

    for flat in (jnp.zeros((4, 5)), jnp.full((4, 5), 3.0)):
        assert_close(four(flat), [0.0, 0.0, 0.0, 3.0])
        # the slope of |z| at 0 is 0, to rounding
        assert_close(jax.jit(jax.jacrev(four))(flat), 0.0, atol=1e-15)
        assert_close(jax.jit(jax.jacfwd(four))(flat), 0.0, atol=1e-15)
    spread = jax.jit(jax.grad(lambda z: height_parameters(z).Sz))(jnp.zeros((4, 5)))
    assert np.isfinite(spread).all()


def test_height_gradients():
    def all_seven(x):
        return jnp.stack(jax.tree.leaves(heights_of(x.reshape(3, 4))))

    assert_gradient(all_seven, rough(1, (3, 4)).ravel())


def test_nanometres_in_single_precision():
    z = rough(2, (100, 100))
    want = heights_of(z)
    got = heights_of((z * 1e-7).astype(jnp.float32))
    assert got.Sku.dtype == jnp.float32
    assert_close(got.Sq, 1e-7 * want.Sq, rtol=1e-5)
    assert_close(jnp.stack([got.Ssk, got.Sku]), jnp.stack([want.Ssk, want.Sku]), rtol=1e-5)
    grad = jax.grad(lambda z: parameters_from_cumulants(*cumulants_of(z))[2])
    assert np.isfinite(grad((z * 1e-7).astype(jnp.float32))).all()


def test_cumulants_of_independent_parts_add():
    # every pair of heights u(y) + v(x) occurs once, so u and v are exactly independent
    u, v = rough(3, (40, 1)), rough(4, (1, 30))
    together, apart = cumulants_of(u + v), [cumulants_of(u), cumulants_of(v)]
    for got, *want in zip(together, *apart, strict=True):
        assert_close(got, sum(want), rtol=1e-10)


def test_cumulants_give_back_the_parameters():
    z = rough(5)
    p = heights_of(z)
    Sq, Ssk, Sku = parameters_from_cumulants(*cumulants_of(z))
    assert_close(jnp.stack([Sq, Ssk, Sku]), jnp.stack([p.Sq, p.Ssk, p.Sku]))


def test_parameters_from_nothing():
    zero = jnp.zeros(3)

    def f(k):
        return jnp.stack(parameters_from_cumulants(k[0], k[1], k[2]))

    assert_close(f(zero), [0.0, 0.0, 3.0])
    assert_close(jax.jacrev(f)(zero), 0.0)
    assert_gradient(f, jnp.asarray([0.7, -0.3, 0.2]))


def test_Cumulants_default_to_nothing():
    assert_close(jnp.stack(list(Cumulants())), 0.0)


@pytest.mark.parametrize(
    ("ratio", "Ssk", "Sku", "error"),
    [
        pytest.param(np.sqrt(2 / np.pi), 0.0, 3.0, 1e-12, id="Gaussian"),
        pytest.param(2 / np.e, 2.0, 9.0, 2e-3, id="exponential"),
        pytest.param(1 / np.sqrt(2), 0.0, 6.0, 4e-3, id="Laplace"),
        pytest.param(2 * np.sqrt(2) / np.pi, 0.0, 1.5, 0.056, id="sine"),
        pytest.param(np.sqrt(3) / 2, 0.0, 1.8, 0.031, id="uniform"),
    ],
)
def test_Sa_estimate(ratio, Ssk, Sku, error):
    got = Sa_estimate(jnp.asarray(2.0), jnp.asarray(Ssk), jnp.asarray(Sku))
    assert_close(got, 2.0 * ratio, rtol=error)


def test_Sa_estimate_is_of_first_order():
    # gamma heights of shape k: Sa = 2 k^k e^-k / Gamma(k), Ssk = 2/sqrt(k), Sku = 3 + 6/k
    error = []
    for k in (20.0, 40.0):
        exact = 2 * np.exp(k * np.log(k) - k - special.gammaln(k)) / np.sqrt(k)
        got = Sa_estimate(jnp.asarray(1.0), jnp.asarray(2 / k**0.5), jnp.asarray(3 + 6 / k))
        error.append(abs(got - exact))
    assert error[1] < 0.3 * error[0]  # the first-order term itself would halve


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


def test_Gaussian_quantiles():
    n = 40000
    z = jnp.asarray(stats.norm.ppf((np.arange(n) + 0.5) / n).reshape(200, 200))
    p = heights_of(z)
    # the quantiles stop at 4.2 sigma, which costs the fourth moment most
    got = jnp.stack([p.Sa / p.Sq, p.Ssk, p.Sku])
    assert_close(got, [0.79788, 0.0, 3.0], rtol=2e-3, atol=1e-9)
