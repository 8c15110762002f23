"""Hills: counted on surfaces whose hills are known, and against brute-force pruning."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close
from polishopt.texture.feature import Spd, significant_hills
from scipy import ndimage


def waves(ny=4, nx=6, points=20):
    """Egg box with ny x nx hills."""
    y, x = (2 * np.pi * (np.arange(n * points) + 0.5) / points for n in (ny, nx))
    return -np.cos(y)[:, None] - np.cos(x)[None, :]


def smooth_noise(seed, shape=(40, 50), sigma=1.5):
    noise = np.random.default_rng(seed).normal(size=shape)
    return ndimage.gaussian_filter(noise, sigma)


def hills_by_flooding(z, threshold):
    """How many peaks stand out by a threshold: lowers a level through all heights."""
    square = np.ones((3, 3))
    born, dead = {}, []
    for level in np.sort(z.ravel())[::-1]:
        label = np.zeros(z.shape, int)
        ndimage.label(z >= level, structure=square, output=label)
        islands = range(1, label.max() + 1)
        tops = {int(np.argmax(np.where(label == k, z, -np.inf))) for k in islands}
        dead += [born.pop(p) - level for p in set(born) - tops]
        born |= {p: z.ravel()[p] for p in tops}
    return sum(d >= threshold for d in dead) + len(born)


def test_an_egg_box_has_a_hill_in_each_cell():
    z = waves()
    peaks, whole = significant_hills(z, 0.05 * np.ptp(z))
    assert peaks.size == 24
    assert whole.sum() == 8
    area = (z.shape[0] - 1) * (z.shape[1] - 1) * 0.1 * 0.2
    spacing = jnp.asarray([0.1, 0.2])
    assert_close(jax.jit(Spd)(jnp.asarray(z), spacing), 24 / area)
    assert_close(Spd(jnp.asarray(z), spacing, whole_only=True), 8 / area)


def test_small_hills_merge():
    z = waves()
    z = z + 0.1 * np.random.default_rng(0).uniform(-1, 1, z.shape)
    # two heights of noise apart, no hill of it is left
    assert significant_hills(z, 0.2)[0].size == 24
    assert significant_hills(z, 0.0)[0].size > 24


@pytest.mark.parametrize("seed", range(3))
def test_pruning_agrees_with_flooding_level_by_level(seed):
    z = smooth_noise(seed, (16, 18), 1.0)
    for share in (0.0, 0.05, 0.2):
        threshold = share * np.ptp(z)
        assert significant_hills(z, threshold)[0].size == hills_by_flooding(z, threshold)


def test_plateaus_are_one_hill():
    z = np.zeros((9, 11))
    z[2:4, 2:5] = z[6:8, 7:10] = 1.0
    assert significant_hills(z, 0.05)[0].size == 2


def test_gaps_cut_hills():
    z = waves()
    hole = z.copy()
    hole[28:33, 28:33] = np.nan  # the peak of one of the eight inner hills
    peaks, whole = significant_hills(hole, 0.05 * np.ptp(z))
    assert whole.sum() == 7
    assert peaks.size >= 24
    # islands count for themselves
    hole = z.copy()
    hole[:, 59:61] = np.nan
    assert significant_hills(hole, 0.05 * np.ptp(z))[0].size == 24
    assert significant_hills(np.full((3, 3), np.nan), 0.0)[0].size == 0


def test_flat_maps_have_no_hills_and_no_slope():
    assert_close(Spd(jnp.ones((4, 5)), 1.0), 0.0)
    z = jnp.asarray(smooth_noise(0, (8, 9)))
    assert_close(jax.jit(jax.grad(lambda z: Spd(z, 1.0)))(z), 0.0)
    both = jax.vmap(lambda z: Spd(z, 1.0))(jnp.stack([z, -z]))
    assert_close(both, [Spd(z, 1.0), Spd(-z, 1.0)])


def test_bad_arguments_are_refused():
    with pytest.raises(ValueError, match=r"must lie in \[0, 1\], got 5.0"):
        Spd(jnp.ones((4, 5)), 1.0, pruning=5.0)
    with pytest.raises(ValueError, match="at least 2 x 2 points, got 1 x 5"):
        Spd(jnp.ones((1, 5)), 1.0)
