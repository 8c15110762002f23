"""Filters: what is form, what is waviness, and what is left as texture.

Three operations make a scale-limited surface of a measured one: the S-filter takes out
what is too short to be trusted, the F-operation takes out the form, and the L-filter
takes out the waviness. The filters are Gaussian (ISO 16610-61), the form is a polynomial.
Points that were not measured are NaN: they have no weight, and stay NaN.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.polynomial.legendre import legvander

from ..parts import Scalar


# distance of neighbouring points: one number, or (along y, along x)
Spacing = Float[Array, "2"] | Scalar | float

ALPHA = math.sqrt(math.log(2.0) / math.pi)

# Beyond this ratio of cutoff to wavelength the Gaussian is zero in double precision.
OPAQUE = 40.0


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
    border neither lifts nor sinks. Likewise around points that were not measured: those
    are NaN, have no weight, and are NaN in the answer. Roughness is what is left,
    `z - gaussian_filter(z)`.

    Args:
        z: Heights [mm]; NaN where not measured.
        spacing: Distance of neighbouring points, or (along y, along x) [mm].
        cutoff: Wavelength at half transmission, $\lambda_c$ [mm].
        periodic: Whether the map repeats itself beyond its border.

    Source: ISO 16610-61.
    """
    smooth = _periodic if periodic else _bounded
    gap = jnp.isnan(z)
    whole = jnp.ones_like(z)
    # the weights that are left sum to one already where nothing is missing
    weight = jax.lax.cond(
        jnp.any(gap),
        lambda: smooth(jnp.where(gap, 0.0, whole), spacing, cutoff),
        lambda: whole,
    )
    low = smooth(jnp.where(gap, 0.0, z), spacing, cutoff) / jnp.where(gap, 1.0, weight)
    return jnp.where(gap, jnp.nan, low)


def _periodic(
    z: Float[Array, "ny nx"], spacing: Spacing, cutoff: Scalar | float
) -> Float[Array, "ny nx"]:
    """Gaussian lowpass of a map that repeats itself."""
    return transmit(z, gaussian_transmission(wavelengths(z, spacing), cutoff))


def _bounded(
    z: Float[Array, "ny nx"], spacing: Spacing, cutoff: Scalar | float
) -> Float[Array, "ny nx"]:
    """Gaussian lowpass of a map that ends at its border."""
    dy, dx = jnp.broadcast_to(jnp.asarray(spacing, dtype=z.dtype), (2,))
    return _weights(z.shape[0], dy / cutoff) @ z @ _weights(z.shape[1], dx / cutoff).T


def _weights(n: int, spacing: Scalar) -> Float[Array, "{n} {n}"]:
    """Gaussian weights between n points in a row, scaled to sum to one in each row."""
    place = jnp.arange(n, dtype=spacing.dtype) * spacing
    weight = jnp.exp(-math.pi * ((place[:, None] - place[None, :]) / ALPHA) ** 2)
    return weight / jnp.sum(weight, axis=1, keepdims=True)


def S_filter(
    z: Float[Array, "ny nx"],
    spacing: Spacing,
    nesting: Scalar | float,
    periodic: bool = False,
) -> Float[Array, "ny nx"]:
    """A map without its shortest waves, which are noise: the Gaussian lowpass [mm].

    Args:
        z: Heights [mm]; NaN where not measured, and then NaN in the answer.
        spacing: Distance of neighbouring points, or (along y, along x) [mm].
        nesting: Nesting index, the wavelength at half transmission [mm].
        periodic: Whether the map repeats itself beyond its border.

    Source: ISO 25178-2, ISO 16610-61.
    """
    return gaussian_filter(z, spacing, nesting, periodic)


def L_filter(
    z: Float[Array, "ny nx"],
    spacing: Spacing,
    nesting: Scalar | float,
    periodic: bool = False,
) -> Float[Array, "ny nx"]:
    """A map without its longest waves: what the Gaussian lowpass leaves out [mm].

    Args:
        z: Heights [mm]; NaN where not measured, and then NaN in the answer.
        spacing: Distance of neighbouring points, or (along y, along x) [mm].
        nesting: Nesting index, the wavelength at half transmission [mm].
        periodic: Whether the map repeats itself beyond its border.

    Source: ISO 25178-2, ISO 16610-61.
    """
    return z - gaussian_filter(z, spacing, nesting, periodic)


def form(z: Float[Array, "ny nx"], degree: int = 1) -> Float[Array, "ny nx"]:
    """Form of a map: its least-squares polynomial in x and y [mm].

    Only measured points count, but the form is known everywhere. The form itself has no
    form left: `form(z - form(z))` is zero.

    Args:
        z: Heights [mm]; NaN where not measured.
        degree: Largest sum of the powers of x and y: 0 is the mean, 1 the plane, 2 takes
            in spheres and cylinders of small slope.

    Raises:
        ValueError: if the degree is negative, or the map has too few points for it.

    Source: F-operation of ISO 25178-2.
    """
    if not 0 <= degree < min(z.shape):
        raise ValueError(
            f"`form(degree=...)` must lie in [0, {min(z.shape) - 1}] for a map of "
            f"{z.shape[0]} x {z.shape[1]} points, got {degree}"
        )
    gap = jnp.isnan(z)
    weight = jnp.where(gap, 0.0, jnp.ones_like(z))
    # products of Legendre polynomials are nearly orthogonal, so the equations are benign
    along_y, along_x = (
        jnp.asarray(legvander(np.linspace(-1.0, 1.0, n), degree), z.dtype) for n in z.shape
    )
    powers = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
    i, j = np.array(powers).T
    pairs_y = along_y[:, i[:, None]] * along_y[:, i[None, :]]
    pairs_x = along_x[:, j[:, None]] * along_x[:, j[None, :]]
    matrix = jnp.einsum("yab,yx,xab->ab", pairs_y, weight, pairs_x)
    right = (along_y.T @ jnp.where(gap, 0.0, z) @ along_x)[i, j]
    factor = jnp.zeros((degree + 1, degree + 1), z.dtype)
    factor = factor.at[i, j].set(jnp.linalg.solve(matrix, right))
    return along_y @ factor @ along_x.T


def scale_limited(
    z: Float[Array, "ny nx"],
    spacing: Spacing,
    short: Scalar | float | None = None,
    degree: int | None = 1,
    long: Scalar | float | None = None,
    periodic: bool = False,
) -> Float[Array, "ny nx"]:
    """Scale-limited surface: S-filter, then form removal, then L-filter [mm].

    Without an L-filter it is the S-F surface of ISO 25178-2, with it the S-L surface.

    Args:
        z: Heights [mm]; NaN where not measured, and then NaN in the answer.
        spacing: Distance of neighbouring points, or (along y, along x) [mm].
        short: Nesting index of the S-filter [mm]; None for no such filter.
        degree: Degree of the form that is taken out, see `form`; None for no such form.
        long: Nesting index of the L-filter [mm]; None for no such filter.
        periodic: Whether the map repeats itself beyond its border, for the filters.

    Source: ISO 25178-2, ISO 25178-3.
    """
    if short is not None:
        z = S_filter(z, spacing, short, periodic)
    if degree is not None:
        z = z - form(z, degree)
    if long is not None:
        z = L_filter(z, spacing, long, periodic)
    return z
