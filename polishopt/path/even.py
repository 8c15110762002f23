r"""Even: a surface over a sheet on which equal areas are equal areas of the part.

A guide covers the parameter plane evenly, so it covers the part evenly only if the area
of the part per area of that plane is the same everywhere. Any surface S can be put that
way by moving its parameters first: $x = X(a)$ so that the strip up to x holds the share
$a/L_x$ of the area, and $y = Y(a, b)$ so that the share $b/L_y$ of the area across that
strip lies below y. The Jacobian of $S \circ (X, Y)$ is then constant.

X and Y are kept as Chebyshev polynomials, because the machine's axes need derivatives of
the surface up to the third.
"""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..parts import Scalar, as_array
from .surface import Surface, area_stretch


# Newton steps that find a place of given share; an area that varies tenfold needs eight.
NEWTON = 16
# Variation of the area's Jacobian that `even` lets pass [-].
UNEVEN = 1e-3


class Even(eqx.Module):
    """A surface whose parameters are moved so that it stretches all areas alike."""

    surface: Surface
    """The part as given."""
    size: Float[Array, "2"]
    """Sides of the parameter plane, old and new [mm]."""
    x: Float[Array, " n"]
    """Chebyshev coefficients of X over the sheet, in half sides [-]."""
    y: Float[Array, "n n"]
    """Those of Y, along a and b [-]."""

    def __call__(self, ab: Float[Array, "2"]) -> Float[Array, "3"]:
        """Point of the part at `ab` of the even sheet [mm]."""
        return self.surface(self.moved(ab))

    def moved(self, ab: Float[Array, "2"]) -> Float[Array, "2"]:
        """Where a point of the even sheet lies on the sheet as given [mm]."""
        share = 2 * ab / self.size - 1
        u, v = (_polynomials(share[i], self.x.size) for i in (0, 1))
        return (jnp.stack([self.x @ u, u @ self.y @ v]) + 1) * self.size / 2


def reparametrised(surface: Surface, size: Float[Array, "2"], degree: int = 12) -> Even:
    """A surface over an even sheet; differentiable in whatever the surface holds.

    Args:
        surface: The part.
        size: Sides of the parameter plane [mm].
        degree: Degree of the polynomials, static.

    Source: Own derivation (Knothe's and Rosenblatt's rearrangement).
    """
    count = degree + 1
    nodes = np.polynomial.chebyshev.chebpts1(count)
    values = np.polynomial.chebyshev.chebvander(nodes, degree)
    fit = as_array(np.linalg.inv(values))
    # coefficients of the integral from -1
    sums = np.zeros((count + 1, count))
    for k, unit in enumerate(np.eye(count)):
        whole = np.polynomial.chebyshev.chebint(unit, lbnd=-1)
        sums[: len(whole), k] = whole
    integral = as_array(sums)
    places = as_array(nodes)

    def stretch(x, y):
        return area_stretch(surface, (jnp.stack([x, y]) + 1) * size / 2)

    across = jax.vmap(jax.vmap(stretch, (None, 0)), (0, None))

    def share_of(density):
        """Coefficients of the share of a density below a place, and of its rate."""
        coefficients = fit @ density
        below = integral @ coefficients
        return below / jnp.sum(below), coefficients / jnp.sum(below)

    # a sum of all coefficients is the value at the upper end
    strips = across(places, places) @ fit.T @ jnp.sum(integral, axis=0)
    x = jax.vmap(_place, (0, None, None))((places + 1) / 2, *share_of(strips))
    rows = across(x, places)

    def column(density):
        return jax.vmap(_place, (0, None, None))((places + 1) / 2, *share_of(density))

    y = jax.vmap(column)(rows)
    return Even(surface=surface, size=size, x=fit @ x, y=fit @ y @ fit.T)


def _place(share: Scalar, below: Float[Array, " m"], rate: Float[Array, " n"]) -> Scalar:
    """Where a share is reached, in [-1, 1]."""

    def closer(_, at):
        miss = _polynomials(at, below.size) @ below - share
        return jnp.clip(at - miss / (_polynomials(at, rate.size) @ rate), -1.0, 1.0)

    near = jax.lax.fori_loop(0, NEWTON, closer, 2 * share - 1)
    near = jax.lax.stop_gradient(near)
    # one more step carries the derivative
    miss = _polynomials(near, below.size) @ below - share
    return near - miss / jax.lax.stop_gradient(_polynomials(near, rate.size) @ rate)


@functools.partial(jax.custom_jvp, nondiff_argnums=(1,))
def _polynomials(x: Scalar, count: int) -> Float[Array, " count"]:
    """Chebyshev's polynomials up to the degree `count` - 1."""
    values = [jnp.ones_like(x), x]
    for _ in range(count - 2):
        values.append(2 * x * values[-1] - values[-2])
    return jnp.stack(values[:count])


@_polynomials.defjvp
def _polynomials_jvp(count, at, way):
    """Their derivatives, which are sums of themselves."""
    # differentiating the recurrence, up to three times as the axes need, would make most
    # of a compiled program of it
    values = _polynomials(*at, count)
    slopes = np.zeros((count, count))
    for k, unit in enumerate(np.eye(count)[1:], start=1):
        slopes[k, :k] = np.polynomial.chebyshev.chebder(unit)[:k]
    return values, (as_array(slopes).astype(values.dtype) @ values) * way[0]


def unevenness(surface: Surface, size: Float[Array, "2"], places: int = 41) -> Scalar:
    """Largest deviation of the area's stretch from its mean, over the mean [-].

    Args:
        surface: The part.
        size: Sides of the parameter plane [mm].
        places: At how many places along each side, borders included, it is looked at.
    """
    share = as_array(np.linspace(0.0, 1.0, places))
    points = jnp.stack(jnp.meshgrid(share * size[0], share * size[1]), axis=-1)
    stretch = jax.vmap(lambda xy: area_stretch(surface, xy))(points.reshape(-1, 2))
    return jnp.max(jnp.abs(stretch / jnp.mean(stretch) - 1))


def even(surface: Surface, size: Float[Array, "2"], degree: int = 12) -> Even:
    """A surface over an even sheet, checked; not for use under `jit`.

    Args:
        surface: The part.
        size: Sides of the parameter plane [mm].
        degree: Degree of the polynomials.

    Raises:
        ValueError: if the surface is too uneven for polynomials of this degree.
    """

    @eqx.filter_jit
    def made(surface, size):
        sheet = reparametrised(surface, size, degree)
        return sheet, unevenness(sheet, size)

    sheet, left = made(surface, size)
    if not float(left) < UNEVEN:
        raise ValueError(
            f"the area of the surface varies too fast over its sheet to be evened out: "
            f"{float(left):.1%} are left, and {UNEVEN:.1%} allowed; split the part or take "
            "parameters that follow its shape."
        )
    return sheet
