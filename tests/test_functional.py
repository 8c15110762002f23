"""Functional parameters against the closed forms of Gaussian and sine, and gaps."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close, assert_gradient
from polishopt.texture.functional import functional_parameters, material_ratio_curve
from scipy import stats


functions_of = jax.jit(functional_parameters, static_argnames="classes")
SIDE = 1000
# quantiles of a million heights: each of them once, in no order
MIDDLE = (np.arange(SIDE**2) + 0.5) / SIDE**2


def shuffled(heights):
    heights = np.random.default_rng(0).permutation(heights)
    return jnp.asarray(heights.reshape(SIDE, SIDE))


def test_Gaussian_table():
    """All digits of the table of Gaussian heights with Sq = 1."""
    p = functions_of(shuffled(stats.norm.ppf(MIDDLE)))
    table = {"Sk": 2.574, "Spk": 0.945, "Svk": 0.945, "Smr1": 0.0991, "Smr2": 0.9009}
    table |= {"Vmp": 0.0473, "Vmc": 0.9059, "Vvv": 0.1116, "Vvc": 1.2172, "Sxp": 1.960}
    for name, value in table.items():
        digits = len(str(value).split(".")[1])
        # the table cuts off or rounds, so it is good to one in its last digit
        assert_close(getattr(p, name), value, atol=1.0 * 10.0**-digits, rtol=0.0)


def test_Gaussian_in_closed_form():
    p = functions_of(shuffled(stats.norm.ppf(MIDDLE)))
    # material over the height c: density(c) - c P(over c)
    over = {q: stats.norm.isf(q) for q in (0.1, 0.8, 0.025)}
    material = {q: stats.norm.pdf(c) - c * q for q, c in over.items()}
    want = {
        "Vmp": material[0.1],
        "Vmc": material[0.8] - material[0.1],
        "Vvv": material[0.8] + over[0.8],
        "Vvc": material[0.1] + over[0.1] - material[0.8] - over[0.8],
        "Sxp": over[0.025],
    }
    for name, value in want.items():
        assert_close(getattr(p, name), value, rtol=2e-5)
    # The least squares line through the quantiles of the middle 40 %, and what is above.
    t = np.linspace(-0.2, 0.2, 100_001)
    slope = np.sum(t * stats.norm.isf(0.5 + t)) / np.sum(t * t)
    upper = -0.5 * slope
    outside = stats.norm.sf(upper)
    Spk = 2 * (stats.norm.pdf(upper) - upper * outside) / outside
    assert_close(p.Sk, -slope, rtol=2e-4)
    assert_close(jnp.stack([p.Smr1, 1 - p.Smr2]), outside, rtol=4e-4)
    assert_close(jnp.stack([p.Spk, p.Svk]), Spk, rtol=4e-4)


def test_sine_table():
    """The curve of a sine is cos(pi r): least steep at its ends, not in its middle.

    So the core is fitted to the first 40 % and overshoots the top: Spk = 0. The dales do
    stand out of a line fitted there, against the note beside the table, which takes the
    window for the middle of the curve.
    """
    p = functions_of(shuffled(np.cos(np.pi * MIDDLE)))
    table = {"Vmp": 0.00326, "Vmc": 0.8311, "Vvv": 0.0253, "Vvc": 0.9290}
    for name, value in table.items():
        digits = len(str(f"{value:.5f}" if name == "Vmp" else f"{value:.4f}")) - 2
        assert_close(getattr(p, name), value, atol=0.51 * 10.0**-digits, rtol=0.0)
    r = np.linspace(0, 0.4, 100_001)
    slope, upper = np.polyfit(r, np.cos(np.pi * r), 1)
    assert upper > 1
    lower = upper + slope
    Smr2 = np.arccos(lower) / np.pi
    # the area under lower, over the curve, from Smr2 to 1
    area = lower * (1 - Smr2) + np.sin(np.pi * Smr2) / np.pi
    assert_close(jnp.stack([p.Smr1, p.Spk]), 0.0)
    assert_close(p.Sk, -slope, rtol=1e-3)
    assert_close(p.Smr2, Smr2, rtol=1e-3)
    assert_close(p.Svk, 2 * area / (1 - Smr2), rtol=2e-3)


def test_curve_is_the_quantiles():
    z = np.random.default_rng(1).gamma(2.0, size=(23, 31))
    for classes in (100, 3000):
        ratio, height = material_ratio_curve(jnp.asarray(z), classes)
        assert_close(height, np.quantile(z, 1 - np.asarray(ratio)), rtol=1e-12)


def test_unmeasured_points_do_not_count():
    z = np.random.default_rng(2).gamma(2.0, size=(40, 50))
    gap = np.random.default_rng(3).random(z.shape) < 0.3
    got = functions_of(jnp.asarray(np.where(gap, np.nan, z)))
    want = functions_of(jnp.asarray(z[~gap][None, :]))
    assert_close(jnp.stack(jax.tree.leaves(got)), jnp.stack(jax.tree.leaves(want)))


def test_scale_offset_and_mirror():
    z = np.random.default_rng(2).gamma(2.0, size=(40, 50))
    p, up, down = (functions_of(jnp.asarray(s * z + 3.0)) for s in (1.0, 1e-5, -1.0))
    for name in ("Sk", "Spk", "Svk", "Sxp", "Vmp", "Vmc", "Vvv", "Vvc"):
        assert_close(getattr(up, name), 1e-5 * getattr(p, name), rtol=1e-7)
    assert_close(jnp.stack([up.Smr1, up.Smr2]), jnp.stack([p.Smr1, p.Smr2]), rtol=1e-7)
    # the window of the mirrored curve lies on the class next to the old one
    assert_close(jnp.stack([down.Spk, down.Svk]), jnp.stack([p.Svk, p.Spk]), rtol=1e-2)


def test_flat_map():
    p = functions_of(jnp.full((40, 50), 2.0))
    for name in ("Sk", "Spk", "Svk", "Smr1", "Sxp", "Vmp", "Vmc", "Vvv", "Vvc"):
        assert_close(getattr(p, name), 0.0)
    assert_close(p.Smr2, 1.0)


def test_single_precision():
    z = jnp.asarray(np.random.default_rng(2).gamma(2.0, size=(40, 50)))
    got, want = functions_of(1e-4 * z.astype(jnp.float32)), functions_of(1e-4 * z)
    for a, b in zip(jax.tree.leaves(got), jax.tree.leaves(want), strict=True):
        assert a.dtype == jnp.float32
        assert_close(a, b, rtol=1e-3)


def test_gradients():
    z = jnp.asarray(np.random.default_rng(4).gamma(2.0, size=20))

    def some(z):
        p = functional_parameters(z.reshape(4, 5), classes=100)
        return jnp.stack(jax.tree.leaves(p))

    assert_gradient(some, z, step=1e-7, rtol=1e-4, atol=1e-6)


def test_too_few_classes_are_refused():
    with pytest.raises(ValueError, match="`classes` must be at least 100, got 10"):
        functional_parameters(jnp.ones((4, 4)), classes=10)
