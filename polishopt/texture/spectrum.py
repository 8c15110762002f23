r"""Spectrum: how the power of a map is shared out among waves.

The areal power spectral density P is two-sided: its integral over all frequencies along x
and y, positive and negative, is the mean square of the map. So a wave of amplitude a is
two lines with $a^2/4$ each. For heights in mm and frequencies in 1/mm it is in mm^4; for
a map without unit, such as a removal over its mean, in mm^2.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..parts import Scalar
from .areal import fill_gaps
from .filters import Spacing


class Spectrum(eqx.Module):
    """Areal power spectral density of a map."""

    density: Float[Array, "ny nx"]
    """Power per area of the plane of frequencies [mm^4]; zero frequency in the middle."""
    fy: Float[Array, " ny"]
    """Frequencies of its rows, ascending [1/mm]."""
    fx: Float[Array, " nx"]
    """Frequencies of its columns, ascending [1/mm]."""

    @property
    def frequency(self) -> Float[Array, "ny nx"]:
        """Frequency of each wave, whatever its direction [1/mm]."""
        return jnp.hypot(self.fy[:, None], self.fx[None, :])

    @property
    def step(self) -> Scalar:
        """Distance of neighbouring frequencies, the larger of both axes [1/mm]."""
        return jnp.maximum(self.fy[1] - self.fy[0], self.fx[1] - self.fx[0])

    @property
    def highest(self) -> Scalar:
        """Highest frequency that both axes resolve [1/mm]."""
        return jnp.minimum(-self.fy[0], -self.fx[0])


def areal_spectrum(z: Float[Array, "ny nx"], spacing: Spacing) -> Spectrum:
    """Areal power spectral density of a map.

    The map is faded out towards its borders by a Hann window, or these would stand in the
    spectrum as a cross. A line of the spectrum is then three frequencies wide, and the
    integral is the mean square of the map under the square of the window.

    Args:
        z: Heights [mm]; NaN where not measured, and taken for the mean there. The mean is
            taken out.
        spacing: Distance of neighbouring points, or (along y, along x) [mm].

    Source: Parseval's theorem; window of the usual practice.
    """
    dy, dx = jnp.broadcast_to(jnp.asarray(spacing, dtype=z.dtype), (2,))
    height, mean, _ = fill_gaps(z)
    height = height - mean
    along_y, along_x = (
        jnp.asarray(np.sin(np.pi * (np.arange(n) + 0.5) / n) ** 2, z.dtype) for n in z.shape
    )
    fade = along_y[:, None] * along_x[None, :]
    height = height - jnp.sum(fade * height) / jnp.sum(fade)
    modes = jnp.fft.fftshift(jnp.fft.fft2(fade * height))
    ny, nx = z.shape
    return Spectrum(
        density=jnp.abs(modes) ** 2 * dy * dx / jnp.sum(fade**2),
        fy=jnp.fft.fftshift(jnp.fft.fftfreq(ny, dtype=z.dtype)) / dy,
        fx=jnp.fft.fftshift(jnp.fft.fftfreq(nx, dtype=z.dtype)) / dx,
    )


def band_power(
    spectrum: Spectrum, low: Scalar | float = 0.0, high: Scalar | float = jnp.inf
) -> Scalar:
    """Mean square of the waves in a band of frequencies [mm^2].

    Args:
        spectrum: From `areal_spectrum`.
        low: Lowest frequency that counts [1/mm].
        high: Highest frequency that counts [1/mm].
    """
    area = (spectrum.fy[1] - spectrum.fy[0]) * (spectrum.fx[1] - spectrum.fx[0])
    inside = (spectrum.frequency >= low) & (spectrum.frequency <= high)
    return area * jnp.sum(jnp.where(inside, spectrum.density, 0.0))


def _mean_in(
    spectrum: Spectrum, bins: Float[Array, "ny nx"], count: int
) -> Float[Array, " count"]:
    """Mean density of the waves whose bin is 0, 1, ...; NaN in a bin without any."""
    place = bins.reshape(-1).astype(int)
    inside = (place >= 0) & (place < count)
    place = jnp.where(inside, place, count)
    density = jax.ops.segment_sum(spectrum.density.reshape(-1), place, count + 1)
    many = jax.ops.segment_sum(
        jnp.ones_like(spectrum.density).reshape(-1), place, count + 1
    )
    return (density / many)[:count]


def radial_mean(spectrum: Spectrum) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    """Density over the frequency, as the mean over all directions.

    Args:
        spectrum: From `areal_spectrum`.

    Returns:
        Frequencies from the first above zero to the highest that both axes resolve, in
        rings as wide as the distance of neighbouring frequencies [1/mm], and the mean
        density in each ring [mm^4].
    """
    count = min(spectrum.density.shape) // 2 - 1
    ring = jnp.round(spectrum.frequency / spectrum.step) - 1
    frequency = spectrum.step * (1 + jnp.arange(count, dtype=spectrum.density.dtype))
    return frequency, _mean_in(spectrum, ring, count)


def directional_mean(
    spectrum: Spectrum,
    low: Scalar | float = 0.0,
    high: Scalar | float = jnp.inf,
    count: int = 36,
) -> tuple[Float[Array, " count"], Float[Array, " count"]]:
    """Density over the direction in which waves run, as the mean over a band.

    Args:
        spectrum: From `areal_spectrum`.
        low: Lowest frequency that counts, above zero [1/mm].
        high: Highest frequency that counts [1/mm].
        count: Number of sectors of the half turn.

    Returns:
        Directions from x towards y, in the middle of the sectors in [0, pi) [rad], and
        the mean density in each sector [mm^4]; NaN in one without any frequency.
    """
    angle = jnp.arctan2(spectrum.fy[:, None], spectrum.fx[None, :])
    sector = jnp.mod(jnp.round(angle / math.pi * count), count)
    counts = (spectrum.frequency >= low) & (spectrum.frequency <= high)
    sector = jnp.where(counts & (spectrum.frequency > 0), sector, -1)
    angles = jnp.arange(count, dtype=spectrum.density.dtype) * (math.pi / count)
    return angles, _mean_in(spectrum, sector, count)


def strongest_wave(
    spectrum: Spectrum, low: Scalar | float, high: Scalar | float
) -> Float[Array, "2"]:
    """Frequencies along x and y of the wave of highest density in a band [1/mm].

    Args:
        spectrum: From `areal_spectrum`.
        low: Lowest frequency that counts [1/mm].
        high: Highest frequency that counts [1/mm].
    """
    inside = (spectrum.frequency >= low) & (spectrum.frequency <= high)
    best = jnp.argmax(jnp.where(inside, spectrum.density, -1.0))
    row, column = jnp.divmod(best, spectrum.density.shape[1])
    return jnp.stack([spectrum.fx[column], spectrum.fy[row]])


def peak_to_median(spectrum: Spectrum, low: Scalar | float, high: Scalar | float) -> Scalar:
    """How far the strongest wave of a band stands out: peak over median density [-].

    Large where the power is in a few lines, as the marks of parallel passes are, and near
    one where it is spread: log2 N for N frequencies of noise, whose density is
    exponentially distributed.

    Args:
        spectrum: From `areal_spectrum`.
        low: Lowest frequency that counts [1/mm].
        high: Highest frequency that counts [1/mm].
    """
    inside = (spectrum.frequency >= low) & (spectrum.frequency <= high)
    peak = jnp.max(jnp.where(inside, spectrum.density, -1.0))
    return peak / jnp.nanmedian(jnp.where(inside, spectrum.density, jnp.nan))
