"""Surface: the part, as a map from a flat sheet of the part's size into space.

A path is planned on the parameter plane, the rectangle [0, Lx] x [0, Ly] in mm, which is
the (u, v) square of the papers scaled to the part. A surface is anything that takes one
point of this rectangle to a point of the part frame, whose origin is the middle of the
part and whose z axis points out of the material. Everything else that the process needs
(normal, area, curvature) follows by automatic differentiation, so that a new surface is
one formula. The functions below take one point; `jax.vmap` takes many.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..parts import Scalar, as_array, as_scalar


Surface = Callable[[Float[Array, "2"]], Float[Array, "3"]]


class Plane(eqx.Module):
    """A flat part."""

    size: Float[Array, "2"] = eqx.field(converter=as_array)
    """Lengths of the sides along x and y [mm]."""

    def __call__(self, xy: Float[Array, "2"]) -> Float[Array, "3"]:
        """Point of the part at `xy` of the parameter plane [mm]."""
        return jnp.concatenate([xy - self.size / 2, jnp.zeros_like(self.size[:1])])


class SphereCap(eqx.Module):
    """A patch of a sphere, highest (convex) or lowest (concave) in its middle."""

    size: Float[Array, "2"] = eqx.field(converter=as_array)
    """Lengths of the sides of its shadow along x and y [mm]."""
    radius: Scalar = eqx.field(converter=as_scalar)
    """Radius of the sphere, positive where convex and negative where concave [mm]."""

    def __call__(self, xy: Float[Array, "2"]) -> Float[Array, "3"]:
        r"""Point of the part at `xy` of the parameter plane [mm].

        $z = \mathrm{sign}(R)\,(\sqrt{R^2 - r^2} - |R|)$ at the distance $r$ from the
        middle, written without the difference of large numbers. Holds for $r < |R|$.
        """
        centred = xy - self.size / 2
        bend = jnp.sum(centred**2) / self.radius
        z = -bend / (1 + jnp.sqrt(1 - bend / self.radius))
        return jnp.append(centred, z)


class HyperbolicParaboloid(eqx.Module):
    """A saddle that is straight along x and y and bends along the diagonals."""

    size: Float[Array, "2"] = eqx.field(converter=as_array)
    """Lengths of the sides of its shadow along x and y [mm]."""
    twist: Scalar = eqx.field(converter=as_scalar)
    """Twist, w in z = w x y [1/mm]."""

    def __call__(self, xy: Float[Array, "2"]) -> Float[Array, "3"]:
        """Point of the part at `xy` of the parameter plane [mm]."""
        centred = xy - self.size / 2
        return jnp.append(centred, self.twist * centred[0] * centred[1])


def jacobian(surface: Surface, xy: Float[Array, "2"]) -> Float[Array, "3 2"]:
    r"""Tangents $\partial S/\partial(x, y)$ as columns [-].

    Args:
        surface: The part.
        xy: Point of the parameter plane [mm].
    """
    return jax.jacfwd(surface)(xy)


def tangent_plane(
    surface: Surface, xy: Float[Array, "2"]
) -> tuple[Float[Array, "3"], Float[Array, "3 2"]]:
    """Point of the part, and its `jacobian` there, from one evaluation [mm], [-].

    Args:
        surface: The part.
        xy: Point of the parameter plane [mm].
    """

    def twice(xy):
        point = surface(xy)
        return point, point

    columns, point = jax.jacfwd(twice, has_aux=True)(xy)
    return point, columns


def metric(surface: Surface, xy: Float[Array, "2"]) -> Float[Array, "2 2"]:
    r"""First fundamental form $g = J^T J$ [-]: the identity where nothing stretches.

    Args:
        surface: The part.
        xy: Point of the parameter plane [mm].
    """
    columns = jacobian(surface, xy)
    return columns.T @ columns


def normal(surface: Surface, xy: Float[Array, "2"]) -> Float[Array, "3"]:
    r"""Unit normal $S_x \wedge S_y / |S_x \wedge S_y|$, out of the material [-].

    Args:
        surface: The part.
        xy: Point of the parameter plane [mm].
    """
    return upright(jacobian(surface, xy))


def upright(columns: Float[Array, "3 2"]) -> Float[Array, "3"]:
    """Unit normal to the two columns of a `jacobian`, out of the material [-]."""
    outward = jnp.cross(columns[:, 0], columns[:, 1])
    return outward / jnp.sqrt(jnp.sum(outward**2))


def area_stretch(surface: Surface, xy: Float[Array, "2"]) -> Scalar:
    r"""Area of the part per area of the parameter plane, $\sqrt{\det g}$ [-].

    Args:
        surface: The part.
        xy: Point of the parameter plane [mm].
    """
    columns = jacobian(surface, xy)
    return jnp.sqrt(jnp.sum(jnp.cross(columns[:, 0], columns[:, 1]) ** 2))


def tangent_to_parameter(
    surface: Surface, xy: Float[Array, "2"], f: Float[Array, "3"], b: Float[Array, "3"]
) -> Float[Array, "2 2"]:
    r"""Matrix from offsets in the tangent plane to offsets in the parameter plane [-].

    $M = g^{-1} J^T [f\; b]$: to first order the point $\xi f + \eta b$ of the tangent
    plane lies above `xy + M @ (xi, eta)`.

    Args:
        surface: The part.
        xy: Point of the parameter plane [mm].
        f: Unit tangent of the part, the first axis [-].
        b: Unit tangent across it, the second axis [-].
    """
    return _to_parameter(jacobian(surface, xy), f, b)


def _to_parameter(columns, f, b) -> Float[Array, "2 2"]:
    g = columns.T @ columns
    # a 2 x 2 inverse by hand, many times faster in a batch than a general solver
    adjugate = jnp.stack([jnp.stack([g[1, 1], -g[0, 1]]), jnp.stack([-g[1, 0], g[0, 0]])])
    det = g[0, 0] * g[1, 1] - g[0, 1] * g[1, 0]
    return adjugate @ (columns.T @ jnp.stack([f, b], axis=1)) / det


def curvature(
    surface: Surface, xy: Float[Array, "2"], f: Float[Array, "3"], b: Float[Array, "3"]
) -> Float[Array, "2 2"]:
    r"""Normal curvature in the tangent frame $(f, b)$, positive where convex [1/mm].

    $K = -M^T (n \cdot \partial^2 S) M$, so that the part lies $d^T K d / 2$ below its
    tangent plane at the tangent offset $d = (\xi, \eta)$. A convex sphere of radius R
    has $K = I/R$.

    Args:
        surface: The part.
        xy: Point of the parameter plane [mm].
        f: Unit tangent of the part, the first axis [-].
        b: Unit tangent across it, the second axis [-].
    """

    def twice(xy):
        columns = jacobian(surface, xy)
        return columns, columns

    second, columns = jax.jacfwd(twice, has_aux=True)(xy)
    bending = jnp.tensordot(upright(columns), second, axes=1)
    to_parameter = _to_parameter(columns, f, b)
    return -to_parameter.T @ bending @ to_parameter
