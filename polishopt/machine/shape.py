r"""Shape: how the squared rate runs along the path when jerk is to stay bounded.

With bounded jerk, $b = \dot\sigma^2$ must have a bounded second derivative and leave a
rest as $x^{4/3}$, $x$ being the way from it: constant jerk $j$ from rest goes
$x = j t^3/6$, so $\dot x^2 = (j/2)^2 (6x/j)^{4/3}$. No spline leaves zero like that. So

$$b(\sigma) = \rho(\sigma)\, y(\sigma), \qquad
  \rho = \Big[\frac{x^2}{x^2 + \ell^2}\Big]^{2/3}$$

with one such factor for each rest ($\rho = 1$ far from rests), and $y > 0$ is a quadratic
spline with its knots at the samples: jerk is as good as constant in an interval and jumps
at samples, and acceleration is as good as linear, so that what holds at both ends of an
interval holds in between. In the interval next to a rest $y$ is constant, which is a
motion of constant jerk. A path of n samples has n + 1 coefficients, less two for a rest;
$y$ and $y'$ at a sample take two of them, and $y''$ in the interval that follows takes one
more. As y lies between its coefficients, bounds on y are bounds on these.

Source: Own derivation.
"""

import functools

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int


# Length of the reference shape's rise beside a rest, in mean steps of the parameter.
RISE = 16.0


class Shape(eqx.Module):
    r"""The reference shape $\rho$ at the samples, in products that stay finite at rests."""

    value: Float[Array, " n"]
    r"""$\rho$."""
    slope: Float[Array, " n"]
    r"""$\rho'$."""
    root: Float[Array, " n"]
    r"""$\sqrt\rho$."""
    root_bend: Float[Array, " n"]
    r"""$\sqrt\rho\,\rho''$."""


class Stencil(eqx.Module):
    """What three coefficients, from its own place on, give at each sample.

    There are n + 2 coefficients for n samples; the last is always spare.
    """

    value: Float[Array, "3 n"]
    slope: Float[Array, "3 n"]
    bend: Float[Array, "3 n"]
    """In the interval that follows."""
    unknown: Bool[Array, " c"]
    """Which coefficients are free; the others stand alone."""


def shape(
    sigma: Float[Array, "*k"],
    start: Float[Array, ""],
    end: Float[Array, ""],
    rise: Float[Array, ""],
    rest: tuple[bool, bool],
) -> Shape:
    """The reference shape at any place between start and end."""
    g, d, c = jnp.ones_like(sigma), jnp.zeros_like(sigma), jnp.zeros_like(sigma)
    for still, way, sign in zip(
        rest, (sigma - start, end - sigma), (1.0, -1.0), strict=True
    ):
        if still:
            x = jnp.maximum(way, 0.0)
            z = x / rise
            w = 1.0 / jnp.sqrt(1.0 + z**2)
            k, k1, k2 = z * w, sign * w**3 / rise, -3.0 * z * w**5 / rise**2
            g, d, c = g * k, d * k + g * k1, c * k + 2.0 * d * k1 + g * k2
    moving = g > 0.0
    third = jnp.where(moving, jnp.cbrt(jnp.where(moving, g, 1.0)), 0.0)
    return Shape(
        value=third**4,
        slope=4.0 / 3.0 * third * d,
        root=third**2,
        root_bend=4.0 / 9.0 * d**2 + 4.0 / 3.0 * g * c,
    )


def stencil(
    sigma: Float[Array, " n"], last: Int[Array, ""], rest: tuple[bool, bool]
) -> Stencil:
    """Values, slopes and second derivatives of quadratic B-splines at their knots.

    Args:
        sigma: Strictly increasing knots.
        last: Place of the last real knot. Those beyond, and the last one if it is a rest,
            are given a coefficient of their own, and none of the real ones.
        rest: Whether the path starts and ends at rest.
    """
    h = jnp.diff(sigma)
    h = jnp.concatenate([h[:1], h, h[-1:], h[-1:]])
    before, here, after = h[:-2], h[1:-1], h[2:]  # of each sample
    near, far = before + here, here + after
    zero, one = jnp.zeros_like(near), jnp.ones_like(near)
    value = jnp.stack([here / near, before / near, zero])
    slope = jnp.stack([-2.0 / near, 2.0 / near, zero])
    left, right = 2.0 / (near * here), 2.0 / (far * here)
    bend = jnp.stack([left, -left - right, right])
    index = jnp.arange(sigma.size)
    own = jnp.stack([zero, zero, one])
    tables = [value, slope, bend.at[:, last].set(0.0)]
    place = jnp.arange(sigma.size + 2)
    unknown = place != last + 2
    if rest[0]:  # the first three coefficients are one
        tables = [
            x.at[:, 1].set(jnp.stack([0.0 * x[0, 1], x[0, 1] + x[1, 1], x[2, 1]]))
            for x in tables
        ]
        tables = [
            x.at[:, 0].set(k * own[:, 0]) for x, k in zip(tables, (1, 0, 0), strict=True)
        ]
        unknown = unknown & (place > 1)
    if rest[1]:  # and so are the last three
        k = last - 2
        tables = [
            x.at[:, k].set(jnp.stack([x[0, k], x[1, k] + x[2, k], 0.0 * x[0, k]]))
            for x in tables
        ]
        k, first = last - 1, own[::-1, 0]
        tables = [x.at[:, k].set(f * first) for x, f in zip(tables, (1, 0, 0), strict=True)]
        unknown = (place != last) & (place != last + 1) & ((place > 1) | (not rest[0]))
    alone = (index > last) | ((index == last) & rest[1])
    value, slope, bend = (
        jnp.where(alone[None], k * own, x) for x, k in zip(tables, (1, 0, 0), strict=True)
    )
    return Stencil(value, slope, bend, unknown)


def apply(
    s: Stencil, c: Float[Array, " c"]
) -> tuple[Float[Array, " n"], Float[Array, " n"], Float[Array, " n"]]:
    """Values, slopes and, after each sample, second derivatives of y for c."""
    around = (c[:-2], c[1:-1], c[2:])
    rows = (s.value, s.slope, s.bend)
    value, slope, bend = (
        total([w * x for w, x in zip(r, around, strict=True)]) for r in rows
    )
    return value, slope, bend


def total(terms):
    """Sum along the first axis, term by term: XLA is slow to reduce a short axis."""
    return functools.reduce(jnp.add, list(terms))


def gather(s: Stencil, parts) -> Float[Array, " c"]:
    """The gradient by c of a function of (y, y', y''): the transpose of `apply`."""
    y, y1, y2 = parts
    low, mid, high = s.value * y[None] + s.slope * y1[None] + s.bend * y2[None]
    return jnp.pad(low, (0, 2)) + jnp.pad(mid, (1, 1)) + jnp.pad(high, (2, 0))


def assemble(s: Stencil, hessian):
    """The three diagonals of the sum of the samples' 3 x 3 Hessians by (y, y', y'').

    `hessian` lists 00, 01, 02, 11, 12, 22.
    """
    h00, h01, h02, h11, h12, h22 = hessian
    v, d, e = s.value, s.slope, s.bend
    hv = h00[None] * v + h01[None] * d + h02[None] * e
    hd = h01[None] * v + h11[None] * d + h12[None] * e
    he = h02[None] * v + h12[None] * d + h22[None] * e

    def entry(i, j):
        return v[i] * hv[j] + d[i] * hd[j] + e[i] * he[j]

    diagonal = jnp.pad(entry(0, 0), (0, 2)) + jnp.pad(entry(1, 1), (1, 1))
    diagonal = diagonal + jnp.pad(entry(2, 2), (2, 0))
    first = jnp.pad(entry(0, 1), (0, 2)) + jnp.pad(entry(1, 2), (1, 1))
    return diagonal, first, jnp.pad(entry(0, 2), (0, 2))
