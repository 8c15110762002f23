"""Hybrid: how steep a surface is, and how much larger than its projection.

Slopes are first differences of neighbouring points, and the area is that of the triangles
between them. So both parameters see the texture at the scale of the grid: they grow as it
gets finer, unless an S-filter sets the scale.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..parts import Scalar
from .filters import Spacing


class HybridParameters(eqx.Module):
    """Hybrid parameters of ISO 25178-2."""

    Sdq: Scalar
    """Root mean square slope [-]; 1 for a plane at 45 degrees."""
    Sdr: Scalar
    """Developed area over projected area, less one [-]; 0.02 is 2 %."""


def hybrid_parameters(z: Float[Array, "ny nx"], spacing: Spacing) -> HybridParameters:
    r"""Root mean square slope and developed interfacial area ratio of a map.

    $S_{dq} = \langle z_x^2 + z_y^2\rangle^{1/2}$ with each slope averaged over its own
    differences; $S_{dr} = \langle\sqrt{1 + z_x^2 + z_y^2} - 1\rangle$ over the triangles
    that each cell is cut into along either of its diagonals. A difference or a cell with
    a point that was not measured does not count. A flat map has zero for both, with zero
    gradient.

    A sine of wavelength $\lambda$ has its slope reduced by $\sin(t)/t$,
    $t = \pi\Delta/\lambda$, by the spacing $\Delta$: 0.4 % at twenty points per wave.

    Args:
        z: Heights, in the unit of the spacing [mm]; NaN where not measured.
        spacing: Distance of neighbouring points, or (along y, along x) [mm].

    Raises:
        ValueError: if the map has fewer than 2 x 2 points.

    Source: ISO 25178-2; triangles of ISO 25178-2:2021, annex D.3.
    """
    if min(z.shape) < 2:
        raise ValueError(
            f"`hybrid_parameters` needs a map of at least 2 x 2 points, "
            f"got {z.shape[0]} x {z.shape[1]}"
        )
    dy, dx = jnp.broadcast_to(jnp.asarray(spacing, dtype=z.dtype), (2,))
    gap = jnp.isnan(z)
    z = jnp.where(gap, 0.0, z)
    slope_x, slope_y = jnp.diff(z, axis=1) / dx, jnp.diff(z, axis=0) / dy
    known_x = ~(gap[:, 1:] | gap[:, :-1])
    known_y = ~(gap[1:, :] | gap[:-1, :])
    square_x = jnp.where(known_x, slope_x, 0.0) ** 2
    square_y = jnp.where(known_y, slope_y, 0.0) ** 2
    square = _mean(square_x, known_x) + _mean(square_y, known_y)
    flat = square == 0
    root = jnp.sqrt(jnp.where(flat, jnp.ones_like(square), square))

    known = known_x[1:] & known_x[:-1]
    area = jnp.zeros_like(known, z.dtype)
    for across in (square_x[1:], square_x[:-1]):
        for along in (square_y[:, 1:], square_y[:, :-1]):
            steep = across + along
            # sqrt(1 + s) - 1 without the cancellation at small slopes
            area = area + 0.25 * steep / (1.0 + jnp.sqrt(1.0 + steep))
    return HybridParameters(
        Sdq=jnp.where(flat, 0.0, root),
        Sdr=_mean(jnp.where(known, area, 0.0), known),
    )


def _mean(value: Float[Array, "n m"], known) -> Scalar:
    """Mean of the known values, the others being zero; NaN if none is known."""
    return jnp.sum(value) / jnp.sum(known.astype(value.dtype))
