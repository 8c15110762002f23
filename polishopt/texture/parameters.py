"""Parameters: all the areal parameters of ISO 25178-2 that this package knows, at once.

They are those of the map as it is: form, noise and waviness are to be taken out before,
see `filters.scale_limited`. How sure the height parameters are is told by
`uncertainty.standard_errors`.
"""

import equinox as eqx
from jaxtyping import Array, Float

from ..parts import Scalar
from .areal import HeightParameters, height_parameters
from .feature import Spd
from .filters import Spacing
from .functional import FunctionalParameters, functional_parameters
from .hybrid import HybridParameters, hybrid_parameters
from .spatial import SpatialParameters, spatial_parameters


class ArealParameters(eqx.Module):
    """Areal parameters of ISO 25178-2, by family; their fields tell their units."""

    height: HeightParameters
    """Sa, Sq, Ssk, Sku, Sp, Sv and Sz."""
    spatial: SpatialParameters
    """Sal, Str and Std."""
    hybrid: HybridParameters
    """Sdq and Sdr."""
    functional: FunctionalParameters
    """Sk, Spk, Svk, Smr1, Smr2 and Sxp; the volumes Vmp, Vmc, Vvv and Vvc."""
    Spd: Scalar
    """Density of peaks [1/mm^2]."""


def areal_parameters(z: Float[Array, "ny nx"], spacing: Spacing) -> ArealParameters:
    """All areal parameters of a map.

    Heights and spacing must be in the same unit, for the slopes. Points that were not
    measured are NaN and left out: alone in height and functional parameters, with their
    differences and cells in hybrid ones, with their pairs in the autocorrelation, and as
    gaps that cut hills; Std sees the mean in their place.

    Height and hybrid parameters have finite derivatives everywhere, those of `Spd` are
    zero; the others' hold where no point changes its rank or its role.

    Args:
        z: Heights [mm]; NaN where not measured.
        spacing: Distance of neighbouring points, or (along y, along x) [mm].

    Raises:
        ValueError: if the map has fewer than 2 x 2 points.

    Source: ISO 25178-2.
    """
    return ArealParameters(
        height=height_parameters(z),
        spatial=spatial_parameters(z, spacing),
        hybrid=hybrid_parameters(z, spacing),
        functional=functional_parameters(z),
        Spd=Spd(z, spacing),
    )
