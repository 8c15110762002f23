"""Local: maps of texture, against the pad law at each place and against scipy."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close
from polishopt.parts import Abrasive
from polishopt.texture.areal import Cumulants, cumulants
from polishopt.texture.evolution import combine
from polishopt.texture.filters import gaussian_transmission, transmit, wavelengths
from polishopt.texture.local import (
    between,
    extremes,
    rest_maps,
    scratch_maps,
    slopes,
    texture_maps,
)
from polishopt.texture.planarisation import planarise
from polishopt.texture.scratches import (
    Population,
    decay,
    decay_rate,
    groove_population,
)
from scipy.interpolate import PchipInterpolator


S = jnp.asarray
# a pad of stiffness 1000 N/mm^3, and a map of 0.1 um in points of 1 um
ABRASIVE = Abrasive(
    1e-8, 1e-3, 0.05, np.radians(60), 5490.0, 5.0, 0.3, 0.012, asperity_stiffness=1000.0
)
SPACING, CUTOFF = S([1e-3, 1.2e-3]), 0.02


def start_map(n=24, scale=1e-4):
    modes = np.fft.rfft2(np.random.default_rng(0).standard_normal((n, n)))
    wave = np.hypot(np.fft.fftfreq(n)[:, None], np.fft.rfftfreq(n)[None, :])
    z = np.fft.irfft2(modes * np.exp(-((2 * np.pi * wave) ** 2)), s=(n, n))
    return S(scale * (z - z.mean()) / z.std())


maps_of = jax.jit(rest_maps, static_argnames=("steps", "pressures"))


def standardised(k):
    Sq = np.sqrt(np.asarray(k.k2))
    return Sq, np.asarray(k.k3) / Sq**3, 3 + np.asarray(k.k4) / Sq**4


@pytest.mark.parametrize("thin", [0.5, 0.02], ids=["partial contact", "full contact"])
def test_maps_agree_with_the_pad_law_at_each_place(thin):
    """Removals over two decades and pressures over a factor of four, to one percent."""
    z = start_map()
    removal = np.array([0.0, 5e-7, 3e-6, 1e-5, 3e-5, 6e-5])
    pressure = np.array([0.02, 0.035, 0.05, 0.08]) / thin**2 * 0.5
    h, p = (S(a) for a in np.meshgrid(removal, pressure, indexing="ij"))
    got = maps_of(z, SPACING, ABRASIVE, h, p, CUTOFF, steps=48, pressures=4)

    @jax.jit
    def direct(h, p):
        left = planarise(z, h, p, S(1000.0), ABRASIVE.conformity, SPACING, 96)
        rough = 1 - gaussian_transmission(wavelengths(left, SPACING), CUTOFF)
        return cumulants(transmit(left, rough))

    want = jax.lax.map(lambda a: direct(*a), (h.ravel(), p.ravel()))
    want = jax.tree.map(lambda k: k.reshape(h.shape), want)
    for a, b in zip(standardised(got), standardised(want), strict=True):
        assert_close(a, b, rtol=0.01, atol=0.01)
    assert_close(
        got.k2[0],
        cumulants(
            transmit(z, 1 - gaussian_transmission(wavelengths(z, SPACING), CUTOFF))
        ).k2,
    )


def test_cubics_agree_with_scipy():
    rng = np.random.default_rng(0)
    x = np.sort(rng.uniform(0, 3, 12))
    y = np.stack([rng.standard_normal(12), np.sort(rng.standard_normal(12))], axis=1)
    want = PchipInterpolator(x, y)
    slope = jax.jit(slopes)(S(x), S(y))
    read = jax.jit(jax.vmap(between, (None, None, None, 0)))
    assert_close(slope, want.derivative()(x), rtol=1e-9, atol=1e-12)
    at = np.linspace(x[0], x[-1], 200)
    got = read(S(x), S(y), slope, S(at))
    assert_close(got, want(at), rtol=1e-9, atol=1e-12)
    assert (np.diff(np.asarray(got)[:, 1]) >= 0).all()
    outside = read(S(x), S(y), slope, S(np.where(at < 1.5, -1.0, 9.0)))
    assert_close(outside, np.where(at[:, None] < 1.5, y[:1], y[-1:]))


WEIGHTS = np.random.default_rng(1).uniform(0.5, 1.5, (3, 2, 3))


def weighed(h, p, z, stiffness):
    """All cumulants at all places, some more than others."""
    part = eqx.tree_at(lambda a: a.asperity_stiffness, ABRASIVE, stiffness)
    k = rest_maps(z, SPACING, part, h, p, CUTOFF, 6, 3)
    total = jnp.stack([1e8 * k.k2, 1e12 * k.k3, 1e16 * k.k4])
    return jnp.sum(S(WEIGHTS) * total)


reverse = jax.jit(jax.value_and_grad(weighed, (0, 1, 2, 3)))
forward = jax.jit(lambda at, way: jax.jvp(weighed, at, way)[1])


def test_gradients_of_maps():
    h = 1e-4 * S([[0.1, 0.35, 0.2], [0.5, 0.05, 0.42]])
    p = S([[0.03, 0.05, 0.04], [0.055, 0.07, 0.061]])
    at = (h, p, start_map(8), S(1000.0))
    _, slope = reverse(*at)
    rng = np.random.default_rng(2)
    for only in (0, 1, 2, 3, None):
        way = tuple(
            jnp.abs(x) * S(rng.uniform(-1, 1, x.shape)) * float(only in (i, None))
            for i, x in enumerate(at)
        )
        got = forward(at, way)
        assert_close(got, sum(jnp.sum(a * b) for a, b in zip(slope, way, strict=True)))
        ends = [
            reverse(*(x + sign * 1e-6 * d for x, d in zip(at, way, strict=True)))[0]
            for sign in (1, -1)
        ]
        assert_close(got, (ends[0] - ends[1]) / 2e-6, rtol=1e-5, atol=1e-8)


def test_gradients_of_maps_are_finite_in_every_corner():
    none, some = jnp.zeros((2, 3)), S([[1e-5, 0.0, 2e-5], [3e-5, 1e-5, 1e-9]])
    pressed = S([[0.05, 0.0, 0.02], [0.04, 1e-12, 0.05]])
    for h in (none, some, 1e4 * some):
        for p in (none, pressed, jnp.full((2, 3), 0.05)):
            for z in (start_map(8), jnp.zeros((8, 8))):
                got = reverse(h, p, z, S(1000.0))
                assert all(np.isfinite(a).all() for a in jax.tree.leaves(got))


@pytest.mark.slow
def test_maps_in_single_precision():
    h, p = S([[0.0, 1e-5, 3e-5]]), S([[0.05, 0.04, 0.05]])
    given = start_map(8), SPACING, ABRASIVE, h, p
    single = jax.tree.map(lambda a: a.astype(jnp.float32), given)
    got = maps_of(*single, CUTOFF, steps=6, pressures=3)
    want = maps_of(*given, CUTOFF, steps=6, pressures=3)
    for a, b in zip(standardised(got), standardised(want), strict=True):
        assert_close(a, b, rtol=1e-3, atol=1e-3)


def test_scratches_place_by_place():
    h, p = S([[1e-5, 0.0, 3e-5]]), S([[0.05, 0.0, 0.02]])
    coarse = Population(1e-9, -1e-14, 1e-18, 4e-3)
    widths = jnp.asarray([[0.0, 1e-4, 1e-3]])
    fine = eqx.tree_at(lambda s: s.width, Population(1e-11, -1e-17, 1e-22), widths)
    *left, own = eqx.filter_jit(scratch_maps)((coarse, fine), ABRASIVE, h, p)
    for j in range(3):
        rate = decay_rate(ABRASIVE, p[0, j])
        one = Population(1e-11, -1e-17, 1e-22, widths[0, j])
        for got, want in (
            (left[0], decay(coarse, h[0, j], rate, ABRASIVE.conformity)),
            (left[1], decay(one, h[0, j], rate, ABRASIVE.conformity)),
            (own, groove_population(ABRASIVE, p[0, j], h[0, j])),
        ):
            there = jax.tree.map(lambda a, j=j: a[0, j], got)
            assert_close(S(jax.tree.leaves(there)), S(jax.tree.leaves(want)))
    assert_close(left[0].k2[0, 1], 1e-9)
    assert own.k2[0, 1] == 0

    ripple = Cumulants(2e-10, 0.0, -1e-20)
    texture = jax.jit(texture_maps, static_argnums=0)((1, 3), *left, own, ripple)
    assert texture.Sku.shape == (1, 3)
    last = [jax.tree.map(lambda a: a[0, 2], part) for part in (*left, own)]
    want = combine(*last, ripple)
    got = jax.tree.map(lambda a: a[0, 2], texture)
    assert_close(S(jax.tree.leaves(got)), S(jax.tree.leaves(want)))


def test_extremes_of_the_places_that_count():
    values, some = S([[-0.5, -0.2], [0.3, -0.45]]), S([[True, True], [False, True]])
    assert_close(extremes(values, some), [-0.5, -0.2])
    slope = jax.grad(lambda v: jnp.dot(S([1.0, 10.0]), jnp.stack(extremes(v, some))))
    assert_close(slope(values), [[1.0, 10.0], [0.0, 0.0]])
