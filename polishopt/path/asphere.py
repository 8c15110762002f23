"""Asphere: the conic sections of optics, with even powers of the radius on top."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..parts import Scalar, as_array, as_scalar


class Asphere(eqx.Module):
    r"""A surface of revolution whose vertex is the middle of the part.

    $z = -\frac{r^2}{R (1 + \sqrt{1 - (1 + k) r^2/R^2})} - \sum_i A_{2i} r^{2i}$ with
    $i = 2, 3, \dots$: the sag of optics, downwards, so that a convex part has a positive
    radius. Holds where the root does.
    """

    size: Float[Array, "2"] = eqx.field(converter=as_array)
    """Lengths of the sides of its shadow along x and y [mm]."""
    radius: Scalar = eqx.field(converter=as_scalar)
    """Radius at the vertex, R, positive where convex and negative where concave [mm]."""
    conic: Scalar = eqx.field(converter=as_scalar, default=0.0)
    """Conic constant, k: 0 a sphere, -1 a paraboloid [-]."""
    terms: Float[Array, " n"] = eqx.field(
        converter=as_array, default_factory=lambda: jnp.zeros(0)
    )
    """Coefficients of the even powers from the fourth on, A_4, A_6, ... [1/mm^3, ...]."""

    def __call__(self, xy: Float[Array, "2"]) -> Float[Array, "3"]:
        """Point of the part at `xy` of the parameter plane [mm]."""
        centred = xy - self.size / 2
        return jnp.append(centred, self.height(jnp.sum(centred**2)))

    def height(self, square: Scalar) -> Scalar:
        """Height over the vertex at a squared distance from the axis [mm], from [mm^2]."""
        bend = square / self.radius
        root = jnp.sqrt(1 - (1 + self.conic) * bend / self.radius)
        polynomial = jnp.zeros_like(square)
        for term in self.terms[::-1]:
            polynomial = (polynomial + term) * square
        return -bend / (1 + root) - polynomial * square

    def slope(self, r: Scalar) -> Scalar:
        """Change of the height with the distance from the axis, z_r [-].

        Args:
            r: Distance from the axis [mm].
        """
        return jax.jvp(lambda r: self.height(r**2), (r,), (jnp.ones_like(r),))[1]
