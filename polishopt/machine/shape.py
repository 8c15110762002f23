r"""Shape: how the squared rate runs along the path when jerk is to stay bounded.

With bounded jerk, $b = \dot\sigma^2$ must have a bounded second derivative and leave a
rest as $x^{4/3}$, $x$ being the way from it: constant jerk $j$ from rest goes
$x = j t^3/6$, so $\dot x^2 = (j/2)^2 (6x/j)^{4/3}$. No spline leaves zero like that. So

$$b(\sigma) = \rho(\sigma)\, y(\sigma), \qquad
  \rho = \Big[\frac{x}{x + \ell}\Big]^{4/3}$$

with one such factor for each rest ($\rho = 1$ far from rests), and $y > 0$ is the cubic
spline with its knots at the samples. Next to a rest $y$ is constant up to the first
sample, which is a motion of constant jerk, and level where that ends. At a free end $y$
is quadratic in the last interval. So a path of n samples has n coefficients at most, and
$y$ and its two derivatives at a sample take three of them.

Source: Own derivation.
"""

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
    """What the three coefficients around each sample give there.

    Those of the first and of the last real sample are taken around their neighbours.
    """

    value: Float[Array, "3 n"]
    slope: Float[Array, "3 n"]
    bend: Float[Array, "3 n"]
    last: Int[Array, ""]
    """Place of the last real sample."""


def shape(
    sigma: Float[Array, "*k"],
    start: Float[Array, ""],
    end: Float[Array, ""],
    rise: Float[Array, ""],
    rest: tuple[bool, bool],
) -> Shape:
    """The reference shape at any place between start and end."""
    g, d, c = jnp.ones_like(sigma), jnp.zeros_like(sigma), jnp.zeros_like(sigma)
    for still, way, sign in zip(rest, (sigma - start, end - sigma), (1.0, -1.0), strict=True):
        if still:
            x = jnp.maximum(way, 0.0)
            k, k1 = x / (x + rise), sign * rise / (x + rise) ** 2
            k2 = -2.0 * rise / (x + rise) ** 3
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
    """Values, slopes and second derivatives of cubic B-splines at their knots.

    Args:
        sigma: Strictly increasing knots, at least four of them real.
        last: Place of the last real knot; beyond it, a coefficient is its own value.
        rest: Whether the path starts and ends at rest.
    """
    h = jnp.diff(sigma)
    # one interval more at either end, as long as its neighbour
    h = jnp.concatenate([h[:1], h[:1], h, h[-1:], h[-1:]])
    before, left, right, after = h[:-3], h[1:-2], h[2:-1], h[3:]
    both = left + right
    down, up = 1.0 / ((before + both) * both), 1.0 / ((both + after) * both)

    def row(first, third, total):
        return jnp.stack([first, total - first - third, third])

    value = row(right**2 * down, left**2 * up, 1.0)
    slope = row(-3.0 * right * down, 3.0 * left * up, 0.0)
    bend = row(6.0 * down, 6.0 * up, 0.0)
    index = jnp.arange(sigma.size)
    real = index <= last
    own = jnp.array([[0.0], [1.0], [0.0]], value.dtype)
    value = jnp.where(real[None], value, own)
    slope, bend = jnp.where(real[None], slope, 0.0), jnp.where(real[None], bend, 0.0)
    tables = [value, slope, bend]
    zero = jnp.zeros_like(last)
    for still, at, inward in zip(rest, (zero, last), (1, -1), strict=True):
        tables = _close(tables, still, at, inward)
    return Stencil(*tables, last=last)


def _close(tables, still: bool, end, inward: int):
    """Take the coefficient beyond an end (or, at a rest, the end's own) out of its rows."""
    value, slope, bend = tables
    beside = end + inward
    # columns in the order outermost, middle, innermost
    order = jnp.array([0, 1, 2] if inward > 0 else [2, 1, 0])
    if still:
        s = slope[order, beside]
        gone = jnp.stack([jnp.zeros_like(s[0]), -s[1] / s[0], -s[2] / s[0]])
        out = []
        for x in (value, slope, bend):
            y = x[order, beside]
            y = jnp.stack([jnp.zeros_like(y[0]), y[1], y[2]]) + y[0] * gone
            out.append(x.at[order, beside].set(y))
        level = jnp.zeros_like(s)
        return [
            out[0].at[order, end].set(out[0][order, beside]),
            out[1].at[order, end].set(level),
            out[2].at[order, end].set(level),
        ]
    e, i = bend[order, end], bend[order, beside]
    # equal second derivatives at the end and beside it
    beyond = jnp.stack([i[0] - e[1], i[1] - e[2], i[2]]) / e[0]
    out = []
    for x in (value, slope, bend):
        y = x[order, end]
        y = y[0] * beyond + jnp.stack([y[1], y[2], jnp.zeros_like(y[0])])
        out.append(x.at[order, end].set(y))
    return out


def apply(
    s: Stencil, c: Float[Array, " n"]
) -> tuple[Float[Array, " n"], Float[Array, " n"], Float[Array, " n"]]:
    """y, y' and y'' at the samples for the coefficients c."""
    around = _around(s, c)
    return (
        jnp.sum(s.value * around, axis=0),
        jnp.sum(s.slope * around, axis=0),
        jnp.sum(s.bend * around, axis=0),
    )


def _around(s: Stencil, c):
    """The three coefficients that each sample looks at."""
    n = c.size
    at = jnp.clip(jnp.arange(n), 1, n - 2)
    at = jnp.where(jnp.arange(n) == s.last, s.last - 1, at)
    return c[at[None] + jnp.array([[-1], [0], [1]])]


def gather(s: Stencil, parts):
    """The gradient by c of a function of (y, y', y''): the transpose of `apply`."""
    y, y1, y2 = parts
    each = s.value * y[None] + s.slope * y1[None] + s.bend * y2[None]
    return _collect(s, each)


def _inside(s: Stencil, x):
    """Move what the two end samples hold to the samples beside them (last axis)."""
    x = x.at[..., 1].add(x[..., 0]).at[..., 0].set(0.0)
    moved = x[..., s.last]
    return x.at[..., s.last - 1].add(moved).at[..., s.last].set(0.0)


def _collect(s: Stencil, each):
    """Sum over samples of what they give their three coefficients."""
    low, mid, high = _inside(s, each)
    return mid + jnp.pad(low[1:], (0, 1)) + jnp.pad(high[:-1], (1, 0))


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

    pairs = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))
    ll, mm, hh, lm, mh, lh = _inside(s, jnp.stack([entry(i, j) for i, j in pairs]))
    diagonal = mm + jnp.pad(ll[1:], (0, 1)) + jnp.pad(hh[:-1], (1, 0))
    first = mh + jnp.pad(lm[1:], (0, 1))
    second = jnp.pad(lh[1:], (0, 1))
    return diagonal, first, second


def inner(s: Stencil, rest: tuple[bool, bool]) -> Bool[Array, " n"]:
    """Which coefficients are unknowns: those of rests follow from the ones beside them."""
    index = jnp.arange(s.value.shape[1])
    free = index >= (1 if rest[0] else 0)
    return free & (index != s.last) if rest[1] else free
