"""Slopes and developed area of planes and waves."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close, assert_gradient
from polishopt.texture.hybrid import hybrid_parameters


hybrid_of = jax.jit(hybrid_parameters)
SPACING = jnp.asarray([0.5, 0.2])


def plane(along_x, along_y, shape=(30, 40)):
    y, x = (d * np.arange(n) for d, n in zip(np.asarray(SPACING), shape, strict=True))
    return jnp.asarray(along_x * x[None, :] + along_y * y[:, None])


@pytest.mark.parametrize(("a", "b"), [(1.0, 0.0), (0.0, 1.0), (0.3, -2.0), (1e-7, 0.0)])
def test_planes(a, b):
    p = hybrid_of(plane(a, b), SPACING)
    square = a**2 + b**2
    assert_close(p.Sdq, np.sqrt(square), rtol=1e-9)
    # written so that nanometres keep their digits
    assert_close(p.Sdr, square / (1 + np.sqrt(1 + square)), rtol=1e-8)


def test_slope_of_a_sine():
    n, periods = 1000, 5
    z = np.sin(2 * np.pi * periods * np.arange(n + 1) / n)
    map = jnp.asarray(np.broadcast_to(z, (30, n + 1)))
    wavelength, step = 1.0 / periods, 1.0 / n
    p = hybrid_of(map, jnp.asarray([1.0, step]))
    sampled = np.sinc(step / wavelength)
    assert_close(p.Sdq, np.sqrt(2) * np.pi / wavelength * sampled, rtol=1e-9)
    # the same over many directions of the wave's slope, by quadrature
    slope = 2 * np.pi / wavelength * np.cos(2 * np.pi * (np.arange(4096) + 0.5) / 4096)
    assert_close(p.Sdr, np.mean(np.sqrt(1 + slope**2) - 1), rtol=1e-3)


def test_unmeasured_points_take_their_cells_along():
    z = plane(0.3, -2.0)
    hole = z.at[3:9, 4:20].set(jnp.nan).at[0, 0].set(jnp.nan)
    whole, holed = hybrid_of(z, SPACING), hybrid_of(hole, SPACING)
    assert_close(jnp.stack(jax.tree.leaves(holed)), jnp.stack(jax.tree.leaves(whole)))
    rng = np.random.default_rng(0)
    z = rng.normal(size=(30, 40))
    gap = rng.random(z.shape) < 0.2
    z[gap] = np.nan
    got = hybrid_of(jnp.asarray(z), SPACING)
    dy, dx = np.asarray(SPACING)
    x, y = np.diff(z, axis=1) / dx, np.diff(z, axis=0) / dy
    assert_close(got.Sdq, np.sqrt(np.nanmean(x**2) + np.nanmean(y**2)), rtol=1e-12)
    corners = [
        np.sqrt(1 + u**2 + v**2) for u in (x[1:], x[:-1]) for v in (y[:, 1:], y[:, :-1])
    ]
    assert_close(got.Sdr, np.nanmean(np.mean(corners, axis=0)) - 1, rtol=1e-12)


def test_flat_map_has_zero_gradient():
    def both(z):
        p = hybrid_parameters(z, SPACING)
        return jnp.stack([p.Sdq, p.Sdr])

    flat = jnp.full((4, 5), 2.0)
    assert_close(both(flat), 0.0)
    assert_close(jax.jit(jax.jacrev(both))(flat), 0.0)
    z = jnp.asarray(np.random.default_rng(0).normal(size=12))
    assert_gradient(lambda z: both(z.reshape(3, 4)), z)


def test_single_precision_of_nanometres():
    z = jnp.asarray(1e-6 * np.random.default_rng(0).normal(size=(30, 40)))
    got, want = hybrid_of(z.astype(jnp.float32), 0.001), hybrid_of(z, 0.001)
    assert got.Sdr.dtype == jnp.float32
    assert_close(jnp.stack([got.Sdq, got.Sdr]), jnp.stack([want.Sdq, want.Sdr]), rtol=1e-5)


def test_a_line_is_no_map():
    with pytest.raises(ValueError, match="at least 2 x 2 points, got 1 x 5"):
        hybrid_parameters(jnp.ones((1, 5)), 0.1)
