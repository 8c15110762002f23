"""Lay: which way the texture of a surface runs.

Waves run across the lay, so the lay is at right angles to the direction from which most
of the power in the spectrum comes.
"""

import math

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..parts import Scalar
from .areal import fill_gaps
from .filters import Spacing


# The angular spectrum is sampled this finely, and seen through a window of this half-width:
# a map that holds ten waves tells directions apart no better.
ANGLES = 360
HALF_WIDTH = math.radians(10.0)


def fast_size(n: int) -> int:
    """The next larger size of which Fourier transforms are fast.

    Args:
        n: Least size.
    """
    from scipy.fft import next_fast_len  # half a second that most runs do not need

    return next_fast_len(n, real=True) or n


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
    ny, nx = (fast_size(2 * n) for n in z.shape)
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
