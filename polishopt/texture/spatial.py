"""Spatial: how far heights of a surface know of each other, and which way the lay runs.

The autocorrelation tells both how fast a texture changes and whether it does so alike in
all directions. It is not circular, since the two borders of a measured map are no
neighbours, and it is not biased towards zero at long lags: every lag is averaged over
the pairs of points it has. The lay comes from the spectrum.
"""

import math

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
# a map of a hundred points a side tells directions apart no better.
ANGLES = 360
HALF_WIDTH = math.radians(5.0)
# halvings of an interval that leave no digit of a double
HALVINGS = 52


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


def _cubic(v: Float[Array, "4 n"], t: Float[Array, " n"]) -> Float[Array, " n"]:
    """Cubic through four values at -1, 0, 1 and 2, seen at t."""
    a, b, c, d = v
    return (
        -t * (t - 1.0) * (t - 2.0) / 6.0 * a
        + (t + 1.0) * (t - 1.0) * (t - 2.0) / 2.0 * b
        - (t + 1.0) * t * (t - 2.0) / 2.0 * c
        + (t + 1.0) * t * (t - 1.0) / 6.0 * d
    )


def decay_lengths(
    correlation: Float[Array, "my mx"], spacing: Spacing, level: float = DECAYED
) -> tuple[Scalar, Scalar]:
    """Shortest and longest distance of decay of an autocorrelation to a level [mm].

    Rays leave lag zero in every direction that the border of the map tells apart, and
    cross one row of lags, or one column, at each step; in between the values are
    interpolated by cubics. Each ray ends where it first falls to the level.

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
            flat[row + stride_across * jnp.clip(low + i, -across, across)]
            for i in (-1, 0, 1, 2)
        ]
        on_it = place == below
        # a lag without pairs must not spoil a ray that passes beside it
        return jnp.where(on_it, around[1], _cubic(jnp.stack(around), place - below))

    def going(state):
        _, _, _, ended = state
        return ~jnp.all(ended)

    def step(state):
        k, last, kept, ended = state
        k = k + 1
        last = jnp.concatenate([last[1:], value(k)[None]])
        fallen = (last[1] > level) & (last[2] <= level) & inside(k - 1)
        new = fallen & ~ended
        start = (k - 2).astype(dtype)
        found = jnp.concatenate([last, jnp.broadcast_to(start, (1, 2 * rays))])
        kept = jnp.where(new[None], found, kept)
        return k, last, kept, ended | fallen | ~inside(k - 1)

    one = jnp.ones((), int)
    first = value(one)
    start = jnp.stack([first, jnp.ones_like(first), first])
    state = (
        one,
        jnp.concatenate([jnp.ones_like(first)[None], start]),
        jnp.full((5, 2 * rays), jnp.nan, dtype),
        jnp.zeros(2 * rays, bool),
    )
    _, _, kept, _ = jax.lax.while_loop(going, step, state)
    a, b, c, d = kept[:4]
    # beyond the border the last parabola goes on
    window = jnp.stack([a, b, c, jnp.where(jnp.isnan(d), 3.0 * (c - b) + a, d)])

    def halve(_, ends):
        low, high = ends
        mid = 0.5 * (low + high)
        above = _cubic(window, mid) > level
        return jnp.where(above, mid, low), jnp.where(above, high, mid)

    ends = (jnp.zeros(2 * rays, dtype), jnp.ones(2 * rays, dtype))
    low, high = jax.lax.fori_loop(0, HALVINGS, halve, ends)
    steps = kept[4] + 0.5 * (low + high)
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
    summed under a window of 5 degrees to either side.

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
    power = jnp.abs(jnp.fft.rfft2(fade * height)) ** 2 / (ny * nx * jnp.sum(fade**2))
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
