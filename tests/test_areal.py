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
from scipy import special, stats


heights_of = jax.jit(height_parameters)
cumulants_of = jax.jit(cumulants)


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


def test_Gaussian_quantiles():
    n = 40000
    z = jnp.asarray(stats.norm.ppf((np.arange(n) + 0.5) / n).reshape(200, 200))
    p = heights_of(z)
    # the quantiles stop at 4.2 sigma, which costs the fourth moment most
    got = jnp.stack([p.Sa / p.Sq, p.Ssk, p.Sku])
    assert_close(got, [0.79788, 0.0, 3.0], rtol=2e-3, atol=1e-9)


def test_unmeasured_points_do_not_count():
    z = np.asarray(rough(9))
    gap = np.random.default_rng(1).random(z.shape) < 0.3
    got = heights_of(jnp.asarray(np.where(gap, np.nan, z)))
    want = heights_of(jnp.asarray(z[~gap][None, :]))
    assert_close(jnp.stack(jax.tree.leaves(got)), jnp.stack(jax.tree.leaves(want)))


def test_a_map_without_a_measured_point_has_no_parameters():
    p = heights_of(jnp.full((24, 31), jnp.nan))
    assert np.isnan(jnp.stack(jax.tree.leaves(p))).all()


def test_gradients_pass_by_unmeasured_points():
    z = np.asarray(rough(9))
    gap = np.random.default_rng(1).random(z.shape) < 0.3
    for values, some in ((z, 1.0), (np.full(z.shape, 2.0), 0.0)):
        map = jnp.asarray(np.where(gap, np.nan, values))
        slope = jax.jit(jax.jacrev(lambda z: heights_of(z).Sq + heights_of(z).Sku))(map)
        assert_close(np.asarray(slope)[gap], 0.0)
        assert np.isfinite(slope).all()
        assert bool(np.abs(np.asarray(slope)).max() > 0) == bool(some)


def test_Gaussian_sample():
    z = jnp.asarray(np.random.default_rng(0).normal(size=(1000, 1000)))
    p = heights_of(z)
    # standard errors of a million independent heights
    errors = np.sqrt([(1 - 2 / np.pi), 0.5, 6.0, 24.0]) / 1000
    got = np.asarray([p.Sa, p.Sq, p.Ssk, p.Sku])
    assert (np.abs(got - [np.sqrt(2 / np.pi), 1.0, 0.0, 3.0]) < 4 * errors).all()


def scallop_map(a, b, n=600):
    cusp = (2.0 * (np.arange(n) + 0.5) / n - 1.0) ** 2
    return jnp.asarray(a * cusp[:, None] + b * cusp[None, :])


def test_scallops():
    p = heights_of(scallop_map(2.0, 0.0))
    want = [4 * np.sqrt(3) / 27, 2 * np.sqrt(5) / 15, 2 * np.sqrt(5) / 7, 15 / 7]
    # midpoint sums of smooth powers are off by the square of the spacing
    rtol = 30 / 600**2
    got = jnp.stack([p.Sa / 2.0, p.Sq / 2.0, p.Ssk, p.Sku])
    assert_close(got, want, rtol=rtol)
    a, b = 1.0, 0.7
    p = heights_of(scallop_map(a, b))
    m2, m3 = 4 * (a**2 + b**2) / 45, 16 * (a**3 + b**3) / 945
    m4 = 16 * (5 * a**4 + 14 * a**2 * b**2 + 5 * b**4) / 4725
    got = jnp.stack([p.Sq**2, p.Ssk * p.Sq**3, p.Sku * p.Sq**4])
    assert_close(got, [m2, m3, m4], rtol=rtol)


# Fourier polynomials: reference surfaces whose moments are rational.
FOURIER = {
    "one wave": "cos(X)",
    "crossed waves": "cos(X)*cos(Y)",
    "skewed": "cos(X) + cos(2*X)/2",
    "oblique": "cos(X + 2*Y) + sin(3*X - Y)/3 + cos(2*X + 4*Y)/4",
    "powers": "cos(X)**3 + cos(X)*sin(Y)**2 + sin(Y)**4/2",
    "milled": "cos(X)**4 + cos(Y)**4/5 - cos(X)**2*cos(Y)/3",
}


def exact_moments(text):
    """A Fourier polynomial in SymPy, and its central moments 2 to 4 over a period."""
    sympy = pytest.importorskip("sympy", reason="sympy is not installed")
    X, Y, a, b = sympy.symbols("X Y a b", real=True)
    z = sympy.sympify(text, locals={"X": X, "Y": Y})
    # with a = exp(iX) and b = exp(iY) it is a polynomial over a power of both
    waves = sympy.expand(z.rewrite(sympy.exp), power_exp=True)
    waves = waves.subs({sympy.exp(sympy.I * X): a, sympy.exp(sympy.I * Y): b})
    top = sympy.Poly(sympy.expand(sympy.powsimp(waves * (a * b) ** 8)), a, b)

    def mean(polynomial, power):
        # the integral of exp(i(mX + nY)) over a period vanishes unless m = n = 0
        return (polynomial**power).coeff_monomial((a * b) ** (8 * power))

    level = top - sympy.Poly(mean(top, 1) * (a * b) ** 8, a, b)
    return sympy.lambdify((X, Y), z, "numpy"), [float(mean(level, n)) for n in (2, 3, 4)]


def test_moments_agree_with_integration():
    """The way above, against an integral that SymPy does step by step."""
    sympy = pytest.importorskip("sympy", reason="sympy is not installed")
    X = sympy.symbols("X")
    z = sympy.cos(X) + sympy.cos(2 * X) / 2
    want = [sympy.integrate(z**n, (X, 0, 2 * sympy.pi)) / (2 * sympy.pi) for n in (2, 3, 4)]
    assert_close(exact_moments(FOURIER["skewed"])[1], [float(m) for m in want], rtol=1e-15)


@pytest.mark.parametrize("name", FOURIER)
def test_Fourier_polynomials_to_ten_figures(name):
    surface, (m2, m3, m4) = exact_moments(FOURIER[name])
    # sums over equally spaced points integrate what is below 1024 waves exactly
    t = 2 * np.pi * np.arange(1024) / 1024
    z = np.broadcast_to(surface(t[None, :], t[:, None]), (1024, 1024))
    p = heights_of(jnp.asarray(z))
    assert_close(p.Sq, np.sqrt(m2), rtol=1e-11)
    assert_close(p.Ssk, m3 / m2**1.5, rtol=1e-11, atol=1e-11)
    assert_close(p.Sku, m4 / m2**2, rtol=1e-11)


def test_Sa_of_waves():
    """|z| has corners, so the sum is not the integral; but it is known as well."""
    n = 1024
    t = 2 * np.pi * (np.arange(n) + 0.5) / n
    # mean of |cos| at n midpoints: 2/pi (1 + (pi/n)^2/6 + ...)
    mean = 2.0 / (n * np.sin(np.pi / n))
    wave = np.broadcast_to(np.cos(t)[None, :], (n, n))
    assert_close(heights_of(jnp.asarray(wave)).Sa, mean, rtol=1e-12)
    assert_close(mean, 2 / np.pi, rtol=2e-6)
    crossed = np.cos(t)[:, None] * np.cos(t)[None, :]
    assert_close(heights_of(jnp.asarray(crossed)).Sa, mean**2, rtol=1e-12)
