"""Spatial: how far the heights of a surface know of each other.

The autocorrelation tells both how fast a texture changes and whether it does so alike in
all directions. It is not circular, since the two borders of a measured map are no
neighbours, and it is not biased towards zero at long lags: every lag is averaged over
the pairs of points it has.
"""

import functools
import operator

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..parts import Scalar
from .areal import fill_gaps
from .filters import Spacing
from .lay import fast_size, texture_direction


# value of the autocorrelation at which heights count as independent (ISO 25178-3)
DECAYED = 0.2
# halvings of an interval that leave no digit of a double
HALVINGS = 52
# places of the six values around an interval, which a polynomial joins
TAPS = (-2, -1, 0, 1, 2, 3)


class SpatialParameters(eqx.Module):
    """Spatial parameters of ISO 25178-2."""

    Sal: Scalar
    """Autocorrelation length: shortest distance of decay to 0.2 [mm]."""
    Str: Scalar
    """Texture aspect ratio: shortest over longest decay [-]; 1 if alike all round."""
    Std: Scalar
    """Direction of the lay, from x towards y, in [0, pi) [rad]."""


def lag_products(z: Float[Array, "ny nx"]) -> Float[Array, "my mx"]:
    """Sum of the products of all pairs of values, by lag; lag zero is in the middle.

    Zeros are added before the transform, so that no pair reaches around the border.

    Args:
        z: Any map.
    """
    ny, nx = z.shape
    padded = [fast_size(2 * n - 1) for n in z.shape]
    power = jnp.abs(jnp.fft.rfft2(z, s=padded)) ** 2
    product = jnp.fft.irfft2(power, s=padded)
    product = jnp.roll(product, (ny - 1, nx - 1), (0, 1))
    return product[: 2 * ny - 1, : 2 * nx - 1]


def autocorrelation(z: Float[Array, "ny nx"]) -> Float[Array, "my mx"]:
    """Autocorrelation of the heights of a map, 1 at lag zero [-].

    Unbiased but for the mean, which is that of the map: the mean product of all the pairs
    of measured points at each lag. Long lags have few pairs and scatter widely.

    Args:
        z: Heights [mm]; NaN where not measured. Its mean is taken out.

    Returns:
        Values at lags from -(n - 1) to n - 1 along y and along x: lag zero is in the
        middle. NaN at lags that no pair of measured points has, and for a flat map.
    """
    height, mean, _ = fill_gaps(z)
    height = height - mean
    # nanometres squared twice are too small for float32
    height = height / jnp.max(jnp.abs(height))
    ny, nx = z.shape
    whole = (ny - np.abs(np.arange(1 - ny, ny)))[:, None] * (
        nx - np.abs(np.arange(1 - nx, nx))
    )[None, :]
    gap = jnp.isnan(z)
    pairs = jax.lax.cond(
        jnp.any(gap),
        lambda: jnp.round(lag_products(jnp.where(gap, 0.0, jnp.ones_like(z)))),
        lambda: jnp.asarray(whole, z.dtype),
    )
    found = pairs > 0
    product = lag_products(height) / jnp.where(found, pairs, 1.0)
    return jnp.where(found, product / product[ny - 1, nx - 1], jnp.nan)


def _between(v: Float[Array, "6 n"], t: Float[Array, " n"]) -> Float[Array, " n"]:
    """Polynomial through values at -2 to 3, seen at t from 0 to 1."""
    total = jnp.zeros_like(t)
    for i in TAPS:
        others = [j for j in TAPS if j != i]
        weight = functools.reduce(operator.mul, [(t - j) / (i - j) for j in others])
        total = total + weight * v[i + 2]
    return total


def decay_lengths(
    correlation: Float[Array, "my mx"], spacing: Spacing, level: float = DECAYED
) -> tuple[Scalar, Scalar]:
    """Shortest and longest distance of decay of an autocorrelation to a level [mm].

    Rays leave lag zero in every direction that the border of the map tells apart, and
    cross one row of lags, or one column, at each step; in between values are interpolated
    by polynomials through six. Each ray ends where it first falls to the level, with an
    error of up to 2 % if that is 2.5 points away, and 0.2 % at four.

    Args:
        correlation: Autocorrelation, lag zero in the middle [-].
        spacing: Distance of neighbouring points, or (along y, along x) [mm].
        level: Value that counts as decayed [-].

    Returns:
        Both distances. The longest is NaN if some ray leaves the map before it has
        decayed, the shortest only if all do.

    Source: Sets R and Q of the definitions of Sal and Str in ISO 25178-2.
    """
    my, mx = correlation.shape
    Y, X = my // 2, mx // 2
    finest = max(Y, X, 1)
    dtype = correlation.dtype
    dy, dx = jnp.broadcast_to(jnp.asarray(spacing, dtype=dtype), (2,))
    slope = np.linspace(-1.0, 1.0, 2 * finest + 1)
    rays = slope.size
    # the first half of the rays step along x, the others along y
    slope = jnp.asarray(np.concatenate([slope, slope]), dtype)
    along, across = np.repeat([X, Y], rays), np.repeat([Y, X], rays)
    stride_along, stride_across = np.repeat([1, mx], rays), np.repeat([mx, 1], rays)
    flat, middle = correlation.ravel(), Y * mx + X

    def inside(k):
        return (k <= along) & (jnp.abs(slope) * k.astype(dtype) <= across.astype(dtype))

    def value(k):
        place = slope * k.astype(dtype)
        below = jnp.floor(place)
        row = middle + stride_along * jnp.minimum(k, along)
        low = below.astype(k.dtype)
        around = [
            flat[row + stride_across * jnp.clip(low + i, -across, across)] for i in TAPS
        ]
        # a lag without pairs must not spoil a ray that passes beside it
        between = _between(jnp.stack(around), place - below)
        return jnp.where(place == below, around[2], between)

    def going(state):
        _, _, _, ended = state
        return ~jnp.all(ended)

    def step(state):
        k, last, kept, ended = state
        k = k + 1
        last = jnp.concatenate([last[1:], value(k)[None]])
        fallen = (last[2] > level) & (last[3] <= level) & inside(k - 2)
        new = fallen & ~ended
        start = (k - 3).astype(dtype)
        found = jnp.concatenate([last, jnp.broadcast_to(start, (1, 2 * rays))])
        kept = jnp.where(new[None], found, kept)
        return k, last, kept, ended | fallen | ~inside(k - 2) | jnp.isnan(last[3])

    # the autocorrelation is the same at opposite lags; the first entry is moved out
    first, second = value(jnp.ones((), int)), value(jnp.full((), 2))
    one = jnp.ones_like(first)
    state = (
        jnp.full((), 2),
        jnp.stack([one, second, first, one, first, second]),
        jnp.full((7, 2 * rays), jnp.nan, dtype),
        jnp.zeros(2 * rays, bool),
    )
    _, _, kept, _ = jax.lax.while_loop(going, step, state)
    window, before = kept[:6], kept[6]
    # without all six values, a straight line
    whole = jnp.all(jnp.isfinite(window), axis=0)

    def halve(_, ends):
        low, high = ends
        mid = 0.5 * (low + high)
        line = window[2] + mid * (window[3] - window[2])
        above = jnp.where(whole, _between(window, mid), line) > level
        return jnp.where(above, mid, low), jnp.where(above, high, mid)

    ends = (jnp.zeros(2 * rays, dtype), jnp.ones(2 * rays, dtype))
    low, high = jax.lax.fori_loop(0, HALVINGS, halve, ends)
    steps = before + 0.5 * (low + high)
    first_half = jnp.arange(2 * rays) < rays
    length = jnp.where(first_half, jnp.hypot(dx, slope * dy), jnp.hypot(dy, slope * dx))
    distance = steps * length
    return jnp.nanmin(distance), jnp.max(distance)


def spatial_parameters(z: Float[Array, "ny nx"], spacing: Spacing) -> SpatialParameters:
    """Autocorrelation length, aspect ratio and direction of the texture of a map.

    The map should be free of form and waviness, which else are what correlates.

    Args:
        z: Heights [mm]; NaN where not measured: only pairs of measured points count in
            the autocorrelation, and gaps are filled with the mean for the direction.
        spacing: Distance of neighbouring points, or (along y, along x) [mm].

    Returns:
        All three. Str is NaN if the autocorrelation does not fall to 0.2 within the map in
        some direction, as along unbroken scratches; Sal if it does in none.

    Source: ISO 25178-2, with s = 0.2 of ISO 25178-3.
    """
    shortest, longest = decay_lengths(autocorrelation(z), spacing)
    return SpatialParameters(
        Sal=shortest, Str=shortest / longest, Std=texture_direction(z, spacing)
    )
