"""Areal: the ISO 25178-2 height parameters of a surface, and the filters before them.

A height map is an array [y, x] of heights in mm. Its height parameters are moments, and
moments of independent causes do not add, but cumulants do: so the chapter carries
textures as `Cumulants` and turns them into Sq, Ssk and Sku at the very end. Waviness is
taken out by the Gaussian filter of ISO 16610-61.
"""

import math
from collections.abc import Iterator

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..parts import Scalar, as_scalar


# distance of neighbouring points: one number, or (along y, along x)
Spacing = Float[Array, "2"] | Scalar | float

ALPHA = math.sqrt(math.log(2.0) / math.pi)

# Beyond this ratio of cutoff to wavelength the Gaussian is zero in double precision.
OPAQUE = 40.0


class HeightParameters(eqx.Module):
    """Height parameters of ISO 25178-2."""

    Sa: Scalar
    """Mean absolute height [mm]."""
    Sq: Scalar
    """Root mean square height [mm]."""
    Ssk: Scalar
    """Skewness [-]; negative for plateaus with valleys."""
    Sku: Scalar
    """Kurtosis [-]; 3 for Gaussian heights, more with isolated scratches or peaks."""
    Sp: Scalar
    """Height of the highest peak above the mean [mm]."""
    Sv: Scalar
    """Depth of the deepest pit below the mean [mm]."""
    Sz: Scalar
    """Peak to pit, Sp + Sv [mm]."""


class Cumulants(eqx.Module):
    """Cumulants of a height distribution; those of independent parts add."""

    k2: Scalar = eqx.field(converter=as_scalar, default=0.0)
    """Variance [mm^2]."""
    k3: Scalar = eqx.field(converter=as_scalar, default=0.0)
    """Third central moment [mm^3]."""
    k4: Scalar = eqx.field(converter=as_scalar, default=0.0)
    """Fourth central moment less 3 k2^2 [mm^4]."""

    def __iter__(self) -> Iterator[Scalar]:
        return iter((self.k2, self.k3, self.k4))


def _moments(
    z: Float[Array, "ny nx"],
) -> tuple[Scalar, Scalar, Scalar, Scalar, Scalar, Scalar, Scalar]:
    """Mean, largest deviation s, and means of |u|, u^2, u^3, u^4, u = (z - mean)/s.

    The scale s keeps fourth powers of nanometres inside the range of float32.
    """
    mean = jnp.mean(z)
    high, low = jnp.max(z), jnp.min(z)
    scale = jax.lax.stop_gradient(jnp.maximum(high - mean, mean - low))
    scale = jnp.where(scale > 0, scale, jnp.ones_like(scale))
    u = (z - mean) / scale
    square = u * u
    return (
        mean,
        scale,
        jnp.mean(jnp.abs(u)),
        jnp.mean(square),
        jnp.mean(square * u),
        jnp.mean(square * square),
        high - low,
    )


def height_parameters(z: Float[Array, "ny nx"]) -> HeightParameters:
    r"""Height parameters of a map; its mean is taken out here.

    $S_a = \langle|z|\rangle$, $S_q = \langle z^2\rangle^{1/2}$,
    $S_{sk} = \langle z^3\rangle/S_q^3$, $S_{ku} = \langle z^4\rangle/S_q^4$. The paper
    prints $S_a$ without the absolute value. A flat map has Ssk = 0 and Sku = 3, the
    values of a vanishing Gaussian, and zero gradient in Sa, Sq, Ssk and Sku.

    Args:
        z: Heights [mm], or any unit: Sa, Sq, Sp, Sv and Sz come back in it.

    Returns:
        All seven parameters.

    Source: S0 eqs. (14)-(17), ISO 25178-2.
    """
    mean, scale, absolute, m2, m3, m4, Sz = _moments(z)
    rough = m2 > 0
    m2 = jnp.where(rough, m2, jnp.ones_like(m2))
    Sp = jnp.max(z) - mean
    return HeightParameters(
        Sa=scale * absolute,
        Sq=jnp.where(rough, scale * jnp.sqrt(m2), 0.0),
        Ssk=jnp.where(rough, m3 / (m2 * jnp.sqrt(m2)), 0.0),
        Sku=jnp.where(rough, m4 / (m2 * m2), 3.0),
        Sp=Sp,
        Sv=Sz - Sp,
        Sz=Sz,
    )


def cumulants(z: Float[Array, "ny nx"]) -> Cumulants:
    r"""Cumulants of the heights of a map [mm^2, mm^3, mm^4].

    $\kappa_2 = m_2$, $\kappa_3 = m_3$, $\kappa_4 = m_4 - 3 m_2^2$ of the central moments.

    Args:
        z: Heights [mm].
    """
    _, scale, _, m2, m3, m4, _ = _moments(z)
    return Cumulants(scale**2 * m2, scale**3 * m3, scale**4 * (m4 - 3.0 * m2 * m2))


def parameters_from_cumulants(
    k2: Scalar, k3: Scalar, k4: Scalar
) -> tuple[Scalar, Scalar, Scalar]:
    r"""Sq [mm], Ssk [-] and Sku [-] of a height distribution.

    $S_q = \kappa_2^{1/2}$, $S_{sk} = \kappa_3/\kappa_2^{3/2}$,
    $S_{ku} = 3 + \kappa_4/\kappa_2^2$. For $\kappa_2 = 0$ they are 0, 0 and 3 with zero
    gradient.

    Args:
        k2: Variance, $\kappa_2$ [mm^2].
        k3: Third cumulant, $\kappa_3$ [mm^3].
        k4: Fourth cumulant, $\kappa_4$ [mm^4].
    """
    rough = k2 > 0
    Sq = jnp.sqrt(jnp.where(rough, k2, jnp.ones_like(k2)))
    # one division after the other: the fourth power of nanometres in mm is too small
    # for the derivatives in float32
    Ssk = k3 / Sq / Sq / Sq
    excess = k4 / Sq / Sq / Sq / Sq
    return (
        jnp.where(rough, Sq, 0.0),
        jnp.where(rough, Ssk, 0.0),
        3.0 + jnp.where(rough, excess, 0.0),
    )


def Sa_estimate(Sq: Scalar, Ssk: Scalar, Sku: Scalar) -> Scalar:
    r"""Sa of a nearly Gaussian height distribution [mm].

    $S_a = S_q\sqrt{2/\pi}\,/\,(1 + u)$ with $u = (S_{ku} - 3 - S_{sk}^2)/24$. The
    Edgeworth series gives $1 - u$; the quotient agrees with it to first order and stays
    positive and below Sq for every possible pair of Ssk and Sku. Within 1 % from Gaussian
    to exponential and Laplace heights; 5.5 % low for a sine, whose two humps no such
    series sees.

    Args:
        Sq: Root mean square height [mm].
        Ssk: Skewness [-].
        Sku: Kurtosis [-].

    Source: Own derivation: $\langle|x| He_4\rangle = -\sqrt{2/\pi}$ and
        $\langle|x| He_6\rangle = 3\sqrt{2/\pi}$ in the Edgeworth series.
    """
    return Sq * math.sqrt(2.0 / math.pi) / (1.0 + (Sku - 3.0 - Ssk**2) / 24.0)


def gaussian_transmission(
    wavelength: Float[Array, " *n"], cutoff: Scalar | float
) -> Float[Array, " *n"]:
    r"""Share of a wave's amplitude that the Gaussian lowpass lets through [-].

    $T = \exp(-\pi(\alpha\lambda_c/\lambda)^2)$ with $\alpha = \sqrt{\ln 2/\pi}$, so that
    $T(\lambda_c) = 1/2$. An infinite wavelength passes whole; beneath an infinite cutoff
    nothing finite passes, with zero gradient.

    Args:
        wavelength: Wavelength, $\lambda$ [mm].
        cutoff: Wavelength at half transmission, $\lambda_c$ [mm].

    Source: ISO 16610-61.
    """
    clear = jnp.isinf(wavelength) | (cutoff < OPAQUE * wavelength)
    finite = jnp.isfinite(wavelength) & clear
    ratio = jnp.where(finite, cutoff, 0.0) / jnp.where(finite, wavelength, 1.0)
    return jnp.where(clear, jnp.exp(-math.pi * (ALPHA * ratio) ** 2), 0.0)


def wavelengths(z: Float[Array, "ny nx"], spacing: Spacing) -> Float[Array, "ny nf"]:
    """Wavelengths of the modes that `jnp.fft.rfft2` finds [mm]; infinite for the mean.

    Args:
        z: A periodic map, for its shape.
        spacing: Distance of neighbouring points, or (along y, along x) [mm].
    """
    dy, dx = jnp.broadcast_to(jnp.asarray(spacing, dtype=z.dtype), (2,))
    fy = jnp.fft.fftfreq(z.shape[0], dtype=z.dtype)[:, None] / dy
    fx = jnp.fft.rfftfreq(z.shape[1], dtype=z.dtype)[None, :] / dx
    square = fy**2 + fx**2
    moving = square > 0
    return jnp.where(moving, 1.0 / jnp.sqrt(jnp.where(moving, square, 1.0)), jnp.inf)


def transmit(
    z: Float[Array, "ny nx"], transmission: Float[Array, "ny nf"]
) -> Float[Array, "ny nx"]:
    """A periodic map with each of its waves reduced [mm].

    Args:
        z: Heights [mm].
        transmission: Share of each mode of `jnp.fft.rfft2` that passes [-].
    """
    modes = jnp.fft.rfft2(z)
    return jnp.fft.irfft2(transmission.astype(modes.dtype) * modes, s=z.shape)


def gaussian_filter(
    z: Float[Array, "ny nx"],
    spacing: Spacing,
    cutoff: Scalar | float,
    periodic: bool = False,
) -> Float[Array, "ny nx"]:
    r"""Waviness of a map: its Gaussian lowpass [mm].

    The weight is a Gaussian of standard deviation $0.187391\lambda_c$. A periodic map is
    filtered by its exact transmission in Fourier space. Any other map is filtered along y
    and along x with weights that are scaled to sum to one at every point, so that the
    border neither lifts nor sinks. Roughness is what is left, `z - gaussian_filter(z)`.

    Args:
        z: Heights [mm].
        spacing: Distance of neighbouring points, or (along y, along x) [mm].
        cutoff: Wavelength at half transmission, $\lambda_c$ [mm].
        periodic: Whether the map repeats itself beyond its border.

    Source: ISO 16610-61.
    """
    if periodic:
        return transmit(z, gaussian_transmission(wavelengths(z, spacing), cutoff))
    dy, dx = jnp.broadcast_to(jnp.asarray(spacing, dtype=z.dtype), (2,))
    return _weights(z.shape[0], dy / cutoff) @ z @ _weights(z.shape[1], dx / cutoff).T


def _weights(n: int, spacing: Scalar) -> Float[Array, "{n} {n}"]:
    """Gaussian weights between n points in a row, scaled to sum to one in each row."""
    place = jnp.arange(n, dtype=spacing.dtype) * spacing
    weight = jnp.exp(-math.pi * ((place[:, None] - place[None, :]) / ALPHA) ** 2)
    return weight / jnp.sum(weight, axis=1, keepdims=True)
