"""Spatial: how far heights of a surface know of each other, and which way the lay runs.

The autocorrelation tells both how fast a texture changes and whether it does so alike in
all directions. It is not circular, since the two borders of a measured map are no
neighbours, and it is not biased towards zero at long lags: every lag is averaged over
the pairs of points it has. The lay comes from the spectrum.
"""

import functools
import math
import operator

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.fft import next_fast_len

from ..parts import Scalar
from .areal import fill_gaps
from .filters import Spacing


# value of the autocorrelation at which heights count as independent (ISO 25178-3)
DECAYED = 0.2
# The angular spectrum is sampled this finely, and seen through a window of this half-width:
# a map that holds ten waves tells directions apart no better.
ANGLES = 360
HALF_WIDTH = math.radians(10.0)
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
    padded = [int(next_fast_len(2 * n - 1, real=True) or 0) for n in z.shape]
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


def angular_spectrum(
    z: Float[Array, "ny nx"], spacing: Spacing
) -> tuple[Float[Array, " na"], Float[Array, " na"]]:
    """Angles of waves [rad], and the power of the waves around each of them [mm^2].

    The map is faded out towards its border by a Hann window, or a cross would stand in
    the spectrum. Power counts up to the highest frequency that both axes resolve, and is
    summed under a window of 10 degrees to either side.

    Args:
        z: Heights [mm]; NaN where not measured.
        spacing: Distance of neighbouring points, or (along y, along x) [mm].

    Returns:
        Directions in which waves run, from x towards y in [0, pi), and their power. The
        lay is at right angles.
    """
    dy, dx = jnp.broadcast_to(jnp.asarray(spacing, dtype=z.dtype), (2,))
    height, mean, _ = fill_gaps(z)
    height = height - mean
    ny, nx = z.shape
    fade = np.sin(np.pi * (np.arange(ny) + 0.5) / ny)[:, None] ** 2 * (
        np.sin(np.pi * (np.arange(nx) + 0.5) / nx)[None, :] ** 2
    )
    fade = jnp.asarray(fade, z.dtype)
    height = height - jnp.sum(fade * height) / jnp.sum(fade)
    # with as many zeros added, no wave falls between two modes
    ny, nx = (int(next_fast_len(2 * n, real=True) or 0) for n in z.shape)
    modes = jnp.fft.rfft2(fade * height, s=[ny, nx])
    power = jnp.abs(modes) ** 2 / (ny * nx * jnp.sum(fade**2))
    # modes between zero and the highest frequency stand for their mirror images too
    twice = np.full(nx // 2 + 1, 2.0)
    twice[0] = 1.0
    twice[nx // 2] = 2.0 if nx % 2 else 1.0
    fy = jnp.fft.fftfreq(ny, dtype=z.dtype)[:, None] / dy
    fx = jnp.fft.rfftfreq(nx, dtype=z.dtype)[None, :] / dx
    resolved = fx**2 + fy**2 <= (0.5 / jnp.maximum(dx, dy)) ** 2
    power = jnp.where(resolved, power * jnp.asarray(twice, z.dtype)[None, :], 0.0)

    place = jnp.mod(jnp.arctan2(fy, fx) / math.pi, 1.0) * ANGLES
    below = jnp.floor(place)
    part = place - below
    index = jnp.mod(below.astype(int), ANGLES)
    spectrum = jnp.zeros(ANGLES, z.dtype).at[index].add(power * (1.0 - part))
    spectrum = spectrum.at[jnp.mod(index + 1, ANGLES)].add(power * part)
    reach = round(HALF_WIDTH / math.pi * ANGLES)
    kernel = np.cos(0.5 * np.pi * np.arange(1 - reach, reach) / reach) ** 2
    around = jnp.concatenate([spectrum[1 - reach :], spectrum, spectrum[: reach - 1]])
    smooth = jnp.convolve(around, jnp.asarray(kernel, z.dtype), mode="valid")
    return jnp.arange(ANGLES, dtype=z.dtype) * (math.pi / ANGLES), smooth


def texture_direction(z: Float[Array, "ny nx"], spacing: Spacing) -> Scalar:
    """Direction of the lay of a map, Std: from x towards y, in [0, pi) [rad].

    At right angles to the waves that carry most power, see `angular_spectrum`. Any
    direction may come out for a texture that has none (Str near 1); NaN for a flat map.

    Args:
        z: Heights [mm]; NaN where not measured.
        spacing: Distance of neighbouring points, or (along y, along x) [mm].

    Source: ISO 25178-2.
    """
    angles, power = angular_spectrum(z, spacing)
    best = jnp.argmax(power)
    before, top, after = (power[jnp.mod(best + i, ANGLES)] for i in (-1, 0, 1))
    bend = before - 2.0 * top + after
    shift = jnp.where(
        bend < 0, 0.5 * (before - after) / jnp.where(bend < 0, bend, 1.0), 0.0
    )
    wave = angles[best] + shift * (math.pi / ANGLES)
    return jnp.where(top > 0, jnp.mod(wave + 0.5 * math.pi, math.pi), jnp.nan)


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
