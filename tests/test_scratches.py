"""Scratches: populations and their width, against drawn grooves and drawn patches."""

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from helpers import abrasive, assert_close, assert_gradient
from polishopt.texture.areal import Cumulants, cumulants, parameters_from_cumulants
from polishopt.texture.evolution import combine, draw_patch
from polishopt.texture.planarisation import asperity_stiffness, planarised
from polishopt.texture.scratches import (
    Population,
    compression,
    decay,
    decay_rate,
    followed_share,
    groove_cumulants,
    groove_depth,
    groove_population,
    groove_width,
    survival,
)
from scipy import stats


S = jnp.asarray
PRESSURE = S(0.05)


def parameters(part):
    return np.array([float(p) for p in parameters_from_cumulants(*part)])


@jax.jit
def patch_moments(keys, variation, removal):
    """Moments of drawn patches about the expected mean, in groove depths."""
    part = abrasive(depth_variation=variation)
    depth = groove_depth(part, PRESSURE)
    removed = removal * compression(part, PRESSURE)

    def draw(key):
        extent = jnp.stack([60.0, 80.0]) * depth
        z = draw_patch(key, part, PRESSURE, removed, (12, 16), extent, 640) / depth
        return jnp.stack([jnp.mean(z), jnp.mean(z**2), jnp.mean(z**3), jnp.mean(z**4)])

    want = groove_cumulants(part, PRESSURE, removed)
    want = jnp.stack([k / depth**n for n, k in zip((2, 3, 4), want, strict=True)])
    return jax.lax.map(draw, keys, batch_size=100), want


def of_moments(m):
    return np.stack([m[1] ** 0.5, m[2] / m[1] ** 1.5, m[3] / m[1] ** 2])


@pytest.mark.parametrize("variation", [0.0, 1.0], ids=["one depth", "exponential"])
@pytest.mark.parametrize("removal", [0.3, 4.5], ids=["building up", "stationary"])
def test_patches_agree_with_the_cumulants(variation, removal):
    n = 600
    patches, want = patch_moments(jr.split(jr.key(3), n), S(variation), S(removal))
    # about the expected mean the moments of patches are unbiased, however small they are
    patches = np.asarray(patches).T
    total = patches.sum(axis=1)
    got = of_moments(total / n)
    without_one = of_moments((total[:, None] - patches) / (n - 1))
    error = np.sqrt((n - 1) * without_one.var(axis=1))
    want = parameters(want)
    assert (error < [0.03 * want[0], 0.1 * abs(want[1]), 0.12 * want[2]]).all()
    assert (abs(got - want) < 3 * error).all(), (got, want, error)


@pytest.mark.parametrize("variation", [0.0, 1.0], ids=["one depth", "exponential"])
def test_skewness_falls_with_the_root_of_coverage(variation):
    """Undecayed grooves over two decades of grooves per point, drawn and in closed form."""
    coverage = np.geomspace(0.2, 20.0, 6)
    part = abrasive(asperity_stiffness=1e-6, depth_variation=variation)
    depth = float(groove_depth(part, PRESSURE))
    spread = 1 + variation**2
    rng, points, drawn, closed = np.random.default_rng(4), 300_000, [], []
    for c in coverage:
        owner = np.repeat(np.arange(points), rng.poisson(c, points))
        place = rng.uniform(-1, 1, owner.size)
        cut = 1 - place**2
        if variation:  # a point meets wide grooves, which are deep, more often
            cut = cut * rng.gamma(2.0, 1.0, owner.size)
        drawn.append(stats.skew(-np.bincount(owner, cut, minlength=points)))
        # a removal of 4/3 E[wD] for each groove, of which 2 E[w] lie over a point
        removal = S(c * 2 / 3 * spread * depth)
        closed.append(parameters(groove_cumulants(part, PRESSURE, removal))[1])
    for skewness in (drawn, closed):
        slope = np.polyfit(np.log(coverage), np.log(-np.array(skewness)), 1)[0]
        assert_close(slope, -0.5, atol=0.03)
    assert_close(drawn, closed, rtol=0.06)


def test_a_long_polish_from_a_rough_start():
    """Plateaus with valleys first, then the grade's own texture."""
    part = abrasive()
    worn = float(compression(part, PRESSURE))
    rough = 5 * worn * np.random.default_rng(0).standard_normal((64, 64))
    removals = S(worn * np.concatenate([[0.0], np.geomspace(0.3, 120.0, 60)]))
    seen = jax.jit(
        lambda z, h: planarised(z, h, PRESSURE, asperity_stiffness(part), cumulants)
    )
    rest = seen(S(rough), removals)
    own = jax.vmap(lambda h: groove_population(part, PRESSURE, h))(removals)
    texture = jax.vmap(combine)(rest, own)
    Sq, Ssk, Sku = (np.asarray(a) for a in (texture.Sq, texture.Ssk, texture.Sku))
    assert (np.diff(Sq) < 1e-3 * Sq[0]).all()
    assert abs(Ssk[0]) < 0.1
    assert abs(Sku[0] - 3) < 0.2
    steady = parameters(groove_population(part, PRESSURE, S(1.0)))
    deepest, highest = Ssk.argmin(), Sku.argmax()
    assert Ssk[deepest] < min(-1.5, 2.5 * steady[1])
    assert Sku[highest] > 6
    # down to there and back, each at one go
    assert (np.diff(Ssk[: deepest + 1]) < 0).all()
    assert (np.diff(Ssk[deepest:]) > -1e-3).all()
    assert (np.diff(Sku[highest:]) < 1e-3).all()
    assert_close([Sq[-1], Ssk[-1], Sku[-1]], steady, rtol=1e-3)


def test_width_of_a_population():
    part = abrasive(depth_variation=0.7)
    depth = np.random.default_rng(0).gamma(1 / 0.49, 0.49, 1_000_000)
    want = np.sum(depth**4) / np.sum(depth**3) * np.tan(np.radians(60))
    got = groove_width(part, PRESSURE) / groove_depth(part, PRESSURE)
    assert_close(got, want, rtol=0.02)
    population = groove_population(part, PRESSURE, S(1e-5))
    assert_close(population.width, groove_width(part, PRESSURE))
    assert_close(S([*population]), S([*groove_cumulants(part, PRESSURE, S(1e-5))]))


def groove_decay(conformity, removed):
    """Variance left of a parabola of half-width one, mode by mode, in numpy."""
    n, length = 1 << 15, 400.0
    u = (np.arange(n) - n // 2) * length / n
    groove = np.maximum(1 - u**2, 0)
    wave = np.fft.rfftfreq(n, length / n) * conformity
    lifted = 1 - 0.5 ** (wave**2)
    left = np.fft.irfft(np.fft.rfft(groove) * np.exp(-removed * lifted), n)
    return np.sum(left**2) / np.sum(groove**2)


@pytest.mark.parametrize("conformity", [0.3, 1.0, 4.0, 12.0, 40.0, 200.0])
def test_grooves_start_to_decay_by_their_own_width(conformity):
    share = float(followed_share(S(1.0), S(conformity)))
    rate = -np.log(groove_decay(conformity, 1e-4)) / 2e-4
    assert_close(1 - share, rate, rtol=0.11)
    # and the pad follows all of a wide one, little of a narrow one
    assert_close(followed_share(S(1.0), S(1e-3)), 1.0, atol=1e-6)
    assert followed_share(S(1.0), S(1e3)) < 0.005


@pytest.mark.parametrize("removed", [0.3, 1.0])
@pytest.mark.parametrize("conformity", [0.4, 1.0])
def test_wide_grooves_after_a_while(conformity, removed):
    got = decay(Population(1.0, width=1.0), S(removed), S(1.0), S(conformity)).k2
    assert_close(got, groove_decay(conformity, removed), rtol=0.02)


def test_scratches_of_no_known_width_go_first():
    before = (1e-10, -1e-16, 1e-20)
    h, rate, conformity = S(3e-3), S(200.0), S(0.08)
    full = decay(Cumulants(*before), h, rate)
    assert isinstance(full, Cumulants)
    left = np.exp(-0.6 * np.arange(2, 5))
    assert_close(S([*full]), before * left)
    unknown = decay(Population(*before), h, rate, conformity)
    assert_close(S([*unknown]), S([*full]))
    flat = decay(Population(*before, width=0.01), h, rate)
    assert_close(S([*flat]), S([*full]))
    k2 = [
        float(decay(Population(*before, width=w), h, rate, conformity).k2)
        for w in (0.0, 1e-4, 1e-3, 1e-2, 0.1, 10.0)
    ]
    assert (np.diff(k2) > 0).all()
    assert_close(k2[-1], 1e-10, rtol=1e-3)
    once = decay(Population(*before, width=0.02), h, rate, conformity)
    half = decay(Population(*before, width=0.02), h / 2, rate, conformity)
    twice = decay(half, h / 2, rate, conformity)
    assert_close(S([*twice]), S([*once]))
    assert_close(twice.width, 0.02)
    assert_close(once.k2, 1e-10 * survival(h, rate, S(0.02), conformity) ** 2)
    both = combine(once, full)
    assert_close(both.Sq**2, once.k2 + full.k2)
    assert_close(S([*once.cumulants]), S([*once]))


def test_gradients_of_decay():
    def f(x):
        left = decay(Population(1.0, -1.0, 2.0, x[2]), x[0], x[1], x[3])
        return jnp.stack([*left])

    assert_gradient(f, S([0.3, 2.0, 0.02, 0.08]))
    slope = jax.jit(jax.jacrev(f))
    for width in (0.0, 0.02):
        for conformity in (0.0, 0.08, jnp.inf):
            for removal, rate in ((0.0, 2.0), (0.3, 0.0), (1e4, 1e4)):
                assert np.isfinite(slope(S([removal, rate, width, conformity]))).all()

    def whole(part, pressure, removal):
        before = groove_population(part, pressure, removal)
        left = decay(before, removal, decay_rate(part, pressure), part.conformity)
        return left.k2 + left.width

    slope = eqx.filter_jit(eqx.filter_grad(lambda x: whole(abrasive(), *x)))
    for corner in ((0.0, 0.0), (0.05, 0.0), (0.0, 1e-4), (0.05, 1e-4)):
        got = slope((S(corner[0]), S(corner[1])))
        assert np.isfinite(jax.tree.leaves(got)).all(), corner
