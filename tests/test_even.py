"""Even sheets: the same area everywhere, by derivatives that agree with differences."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close, assert_gradient
from polishopt.path import Asphere, SphereCap, area_stretch, even, fit_nurbs
from polishopt.path.even import reparametrised, unevenness


SIZE = jnp.asarray([50.0, 40.0])
X, Y = np.meshgrid(np.linspace(-30, 30, 15), np.linspace(-7.5, 7.5, 9), indexing="ij")
CROWN = fit_nurbs(np.stack([X * (1 + X / 200), Y, -(X**2) / 300 - Y**2 / 60], -1), (7, 5))
SURFACES = {
    "cap": SphereCap(SIZE, 100.0),
    "asphere": Asphere(SIZE, -60.0, -1.0, [1e-6]),
    "crown": CROWN,
}


@eqx.filter_jit
def looked_at(surface, size, places):
    sheet = reparametrised(surface, size)
    stretch = jax.vmap(lambda ab: area_stretch(sheet, ab))(places)
    corners = jnp.stack([0 * size, size])
    return stretch, jax.vmap(sheet.moved)(corners), unevenness(surface, size)


@pytest.mark.parametrize("surface", SURFACES.values(), ids=SURFACES.keys())
def test_the_area_jacobian_is_constant(surface):
    """To 1e-3 where it varied by more; the sheet keeps its borders, and the area is
    that of a quadrature."""
    sides = np.asarray(surface.size)
    places = jnp.asarray(np.random.default_rng(0).uniform(size=(500, 2)) * sides)
    stretch, corners, before = looked_at(surface, surface.size, places)
    stretch = np.asarray(stretch)
    assert np.abs(stretch / stretch.mean() - 1).max() < 1e-3
    assert before > 2e-3
    assert_close(corners, jnp.stack([0 * surface.size, surface.size]), atol=2e-3)
    x, w = np.polynomial.legendre.leggauss(30)
    grid = np.stack(np.meshgrid(x, x), -1).reshape(-1, 2) / 2 + 0.5
    grid = jnp.asarray(grid * sides)
    area = jax.jit(jax.vmap(lambda xy: area_stretch(surface, xy)))(grid)
    assert_close(stretch.mean(), np.outer(w, w).ravel() / 4 @ np.asarray(area), rtol=1e-5)


def test_gradients_reach_the_surface():
    """Of a point of the even sheet, in the radius and in the place."""

    def point(x):
        return reparametrised(SphereCap(SIZE, x[0]), SIZE, 8)(x[1:])

    assert_gradient(point, jnp.asarray([60.0, 9.0, 33.0]))


def test_a_surface_too_uneven_is_refused():
    with pytest.raises(ValueError, match="varies too fast"):
        even(SphereCap(SIZE, 32.05), SIZE, 4)
