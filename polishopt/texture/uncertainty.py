"""Uncertainty: how far the height parameters of a map are from those of the whole surface.

A map is a sample: another place on the same surface would have given other numbers. How
other follows from the map itself. A parameter that is made of means is, to first order,
the mean of an influence that each point has on it (delta method), and the variance of a
mean is the sum of the autocovariances over all lags. The extremes are no means: they are
those of as many independent heights as the map holds.

The surface is taken for a random one without trend, much larger than its correlation
length. Form, waviness and noise of the instrument are not in these numbers.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import ndtr, ndtri
from jaxtyping import Array, Float

from ..parts import Scalar
from .areal import fill_gaps, height_parameters
from .functional import material_ratio_curve
from .spatial import DECAYED, lag_products


# Standard deviation of the lag window over the decay length of the heights. Longer
# windows let more noise in, shorter ones cut off correlation: three percent at two.
REACH = 2.0
# Share of the lags that the window may take in: with more the map is no sample any more.
MOST = 0.9
# Levels at which the tail of the heights is read, and the largest share of the points
# that is taken for tail.
LEVELS, TAIL = 60, 0.3
# Where in the tail the parabola is left for the exponential. With two thirds skewed and
# lognormal heights come out within a sixth on their long side.
BEYOND = 2.0 / 3.0
# midpoints of the probabilities over which the spread of an extreme is integrated
QUANTILES = 400


class StandardErrors(eqx.Module):
    """Standard errors of the height parameters of one map, from the map itself."""

    Sa: Scalar
    """Standard error of Sa [mm]."""
    Sq: Scalar
    """Standard error of Sq [mm]."""
    Ssk: Scalar
    """Standard error of Ssk [-]."""
    Sku: Scalar
    """Standard error of Sku [-]."""
    Sp: Scalar
    """Standard error of Sp [mm]."""
    Sv: Scalar
    """Standard error of Sv [mm]."""
    Sz: Scalar
    """Standard error of Sz [mm]."""
    independent_points: Scalar
    """Number of independent heights whose Sq would scatter as much [-]."""


def _lags(
    shape: tuple[int, int], dtype
) -> tuple[Float[Array, "my 1"], Float[Array, "1 mx"]]:
    """Lags along y and along x, in points, with zero in the middle."""
    y, x = (np.arange(1 - n, n) for n in shape)
    return jnp.asarray(y[:, None], dtype), jnp.asarray(x[None, :], dtype)


def lag_window(
    products: Float[Array, "my mx"], reach: float = REACH
) -> Float[Array, "my mx"]:
    r"""Weights of the lags in a sum of autocovariances, 1 at lag zero [-].

    $w = \exp(-\tfrac12\tau^T(4 r^2 C)^{-1}\tau)$, with C the covariance of the lags at
    which products of heights are over a fifth of their largest value: for an ellipse of
    such lags 4 C has its semi-axes, and the window reaches $r$ of them all round.

    Args:
        products: Sum of the products of heights at each lag, zero in the middle.
        reach: Standard deviation of the window, $r$, in decay lengths.

    Source: Own derivation.
    """
    my, mx = products.shape
    y, x = _lags(((my + 1) // 2, (mx + 1) // 2), products.dtype)
    near = (products > DECAYED * products[my // 2, mx // 2]).astype(products.dtype)
    count = jnp.maximum(jnp.sum(near), 1.0)
    # the twelfth is the spread within a point
    yy = jnp.sum(near * y**2) / count + 1.0 / 12.0
    xx = jnp.sum(near * x**2) / count + 1.0 / 12.0
    xy = jnp.sum(near * y * x) / count
    square = (xx * y**2 - 2.0 * xy * y * x + yy * x**2) / (xx * yy - xy**2)
    return jnp.exp(-square / (8.0 * reach**2))


def _largest(
    z: Float[Array, "ny nx"], known: Float[Array, "ny nx"], count: Scalar
) -> Float[Array, " nq"]:
    r"""How high the highest point of a Gaussian map is, in its standard deviations [-].

    The chance that nothing stands over x is $e^{-n(x)}$, with the number of hills
    $n = \sqrt{\det\Lambda}A(2\pi)^{-3/2}x e^{-x^2/2}
    + (\sqrt{\Lambda_{xx}}X + \sqrt{\Lambda_{yy}}Y)(2\pi)^{-1}e^{-x^2/2} + \Phi(-x)$
    on an area A of sides X and Y, where $\Lambda$ is the covariance of the slopes. There
    are no more than for independent points, $n = N\Phi(-x)$.

    Args:
        z: Heights less their mean; any number where not measured.
        known: 1 where measured, else 0.
        count: How many points are measured, N.

    Returns:
        Heights at equally spaced probabilities, ascending.

    Source: R. J. Adler, The Geometry of Random Fields (1981): the expected Euler
        characteristic of what stands over a level.
    """
    across, along = jnp.diff(z, axis=1), jnp.diff(z, axis=0)
    cell = known[1:, 1:] * known[:-1, 1:] * known[1:, :-1] * known[:-1, :-1]

    def mean(first, second):
        return jnp.sum(cell * first * second) / jnp.sum(cell)

    variance = jnp.sum(known * z**2) / count
    variance = jnp.where(variance > 0, variance, 1.0)
    slope_x, slope_y = (
        0.5 * (across[1:] + across[:-1]),
        0.5 * (along[:, 1:] + along[:, :-1]),
    )
    xx, yy = (
        0.5 * (mean(a, a) + mean(b, b)) / variance
        for a, b in ((across[1:], across[:-1]), (along[:, 1:], along[:, :-1]))
    )
    xy = mean(slope_x, slope_y) / variance
    area = count * jnp.sqrt(jnp.maximum(xx * yy - xy**2, 0.0)) / (2.0 * math.pi) ** 1.5
    ny, nx = z.shape
    sides = (jnp.sqrt(xx) * nx + jnp.sqrt(yy) * ny) / (2.0 * math.pi)
    probability = (jnp.arange(QUANTILES, dtype=z.dtype) + 0.5) / QUANTILES
    wanted = -jnp.log(probability)

    def halve(_, ends):
        low, high = ends
        x = 0.5 * (low + high)
        over = ndtr(-x)
        hills = (area * x + sides) * jnp.exp(-0.5 * x**2) + over
        more = jnp.minimum(hills, count * over) > wanted
        return jnp.where(more, x, low), jnp.where(more, high, x)

    ends = jnp.ones_like(wanted), jnp.full_like(wanted, 10.0)
    low, high = jax.lax.fori_loop(0, 40, halve, ends)
    return 0.5 * (low + high)


def _extreme_error(descending: Float[Array, " n"], largest: Float[Array, " nq"]) -> Scalar:
    r"""Standard deviation of the highest point of a map [mm].

    Heights are taken for a smooth function of Gaussian ones, $z = g(x)$. A parabola is
    fitted to it in the tail of the material ratio curve, each level with the weight that
    its scatter gives it; beyond, its slope goes on growing or falling at the same rate, so
    $g' = b\,e^{\kappa x}$ never changes sign.

    Args:
        descending: Material ratio curve from the tail in question inwards [mm].
        largest: What the highest point of a Gaussian map may be, see `_largest` [-].

    Source: Own derivation.
    """
    dtype = descending.dtype
    least = jnp.minimum(ndtr(-jnp.median(largest)), 0.5 * TAIL)
    share = least * (TAIL / least) ** jnp.linspace(0.0, 1.0, LEVELS, dtype=dtype)
    x = -ndtri(share)
    classes = jnp.linspace(0.0, 1.0, descending.size, dtype=dtype)
    z = jnp.interp(share, classes, descending)
    density = jnp.exp(-0.5 * x**2) / math.sqrt(2.0 * math.pi)
    weight = density / jnp.sqrt(share * (1.0 - share))
    middle = x[-1] + BEYOND * (x[0] - x[-1])
    scale = jnp.max(jnp.abs(z))
    scale = jnp.where(scale > 0, scale, jnp.ones_like(scale))
    off = x - middle
    matrix = weight[:, None] * jnp.stack([jnp.ones_like(x), off, off**2], axis=1)
    _, slope, bend = jnp.linalg.lstsq(matrix, weight * z / scale)[0]
    slope = jnp.maximum(slope, 0.0)
    rising = slope > 0
    rate = jnp.clip(
        jnp.where(rising, 2.0 * bend / jnp.where(rising, slope, 1.0), 0.0), -1.0, 1.0
    )
    straight = jnp.abs(rate) < 1e-4
    off = largest - middle
    grown = jnp.expm1(rate * off) / jnp.where(straight, 1.0, rate)
    return scale * slope * jnp.std(jnp.where(straight, off, grown))


def moment_errors(
    z: Float[Array, "ny nx"],
) -> tuple[Float[Array, "4"], Scalar]:
    """Standard errors of Sa and Sq [mm], Ssk and Sku [-], and how many points they rest on.

    The part of `standard_errors` that costs least.

    Args:
        z: Heights [mm]; NaN where not measured. Free of form and waviness.

    Returns:
        The four errors, and the number of independent points.

    Source: Own derivation.
    """
    height, mean, count = fill_gaps(z)
    known = (~jnp.isnan(z)).astype(z.dtype)
    height = height - mean
    p = height_parameters(z)
    flat = p.Sq == 0
    Sq = jnp.where(flat, 1.0, p.Sq)
    u = height / Sq
    square = u * u
    sign = jnp.sum(known * jnp.sign(u)) / count
    influences = jnp.stack(
        [
            jnp.abs(u) - p.Sa / Sq - sign * u,
            0.5 * (square - 1.0),
            u * square - p.Ssk - 3.0 * u - 1.5 * p.Ssk * (square - 1.0),
            square * square - p.Sku - 4.0 * p.Ssk * u - 2.0 * p.Sku * (square - 1.0),
        ]
    )
    window = lag_window(lag_products(u))
    # of all pairs of points, those that the window lets see each other
    seen = jnp.sum(window * lag_products(known)) / count**2
    raised = count**2 * (1.0 - jnp.minimum(seen, MOST))

    def variance(influence):
        return jnp.sum(window * lag_products(known * influence)) / raised

    error = jnp.sqrt(jnp.maximum(jax.lax.map(variance, influences), 0.0))
    error = jnp.where(flat, 0.0, error)
    ratio = jnp.where(error[1] > 0, error[1], 1.0)
    independent = jnp.clip((p.Sku - 1.0) / (4.0 * ratio**2), 1.0, count)
    return error * jnp.stack([Sq, Sq, jnp.ones_like(Sq), jnp.ones_like(Sq)]), independent


def standard_errors(z: Float[Array, "ny nx"]) -> StandardErrors:
    r"""Standard errors of the height parameters of a map.

    With $u = (z - \bar z)/S_q$ each point has the influences
    $S_q(|u| - s - u\langle\mathrm{sgn}\,u\rangle)$ on Sa = $s S_q$,
    $S_q(u^2 - 1)/2$ on Sq, $u^3 - S_{sk} - 3u - \tfrac32 S_{sk}(u^2 - 1)$ on Ssk and
    $u^4 - S_{ku} - 4 S_{sk}u - 2 S_{ku}(u^2 - 1)$ on Sku. The variance of their mean over
    N points is the sum of their products by lag, over $N^2$, under `lag_window`; it is
    raised by what the mean of the map has taken out under that window. Sp and Sv are those
    of `_extreme_error`; Sz takes both as independent.

    On average good to 15 % where the map has a thousand independent points or more; from
    map to map that of Sku and of the extremes scatters by a quarter and more. Where the
    heights end abruptly, as those of a ground plateau do at the top, the error of that
    extreme is small and no better than to a factor of two. With few independent points,
    and for textures that repeat themselves, all are no more than a hint. A flat map has
    no errors.

    Args:
        z: Heights [mm]; NaN where not measured. Free of form and waviness. Distances of
            points drop out.

    Returns:
        A standard error for each height parameter, and the number of independent points.

    Source: Own derivation.
    """
    error, independent = moment_errors(z)
    height, mean, count = fill_gaps(z)
    known = (~jnp.isnan(z)).astype(z.dtype)
    largest = _largest(height - mean, known, count)
    _, curve = material_ratio_curve(z)
    Sp, Sv = (
        _extreme_error(curve - mean, largest),
        _extreme_error(mean - curve[::-1], largest),
    )
    return StandardErrors(
        Sa=error[0],
        Sq=error[1],
        Ssk=error[2],
        Sku=error[3],
        Sp=Sp,
        Sv=Sv,
        Sz=jnp.hypot(Sp, Sv),
        independent_points=independent,
    )
