"""Texture: what the surface looks like before, during and after polishing."""

from .areal import (
    Cumulants as Cumulants,
    HeightParameters as HeightParameters,
    Sa_estimate as Sa_estimate,
    cumulants as cumulants,
    height_parameters as height_parameters,
    parameters_from_cumulants as parameters_from_cumulants,
)
from .cutter import (
    Cutter as Cutter,
    Passings as Passings,
    Postures as Postures,
    passing_count as passing_count,
    passings as passings,
    postures as postures,
    several as several,
    true_feed as true_feed,
)
from .cutting import (
    cut as cut,
    removed_volume as removed_volume,
    topography as topography,
)
from .direction import slid_directions as slid_directions
from .evolution import (
    Texture as Texture,
    combine as combine,
    draw_patch as draw_patch,
    ripple_cumulants as ripple_cumulants,
)
from .feature import Spd as Spd
from .filters import (
    L_filter as L_filter,
    S_filter as S_filter,
    form as form,
    gaussian_filter as gaussian_filter,
    gaussian_transmission as gaussian_transmission,
    scale_limited as scale_limited,
)
from .functional import (
    FunctionalParameters as FunctionalParameters,
    functional_parameters as functional_parameters,
    material_ratio_curve as material_ratio_curve,
)
from .hybrid import (
    HybridParameters as HybridParameters,
    hybrid_parameters as hybrid_parameters,
)
from .lay import (
    angular_spectrum as angular_spectrum,
    texture_direction as texture_direction,
)
from .local import (
    TextureMaps as TextureMaps,
    extremes as extremes,
    rest_maps as rest_maps,
    scratch_maps as scratch_maps,
    texture_maps as texture_maps,
)
from .marks import milled_marks as milled_marks
from .milling import (
    MilledSurface as MilledSurface,
    Sz_analytic as Sz_analytic,
    Sz_as_printed as Sz_as_printed,
    cusp_heights as cusp_heights,
    envelope_radius as envelope_radius,
    equivalent_radius as equivalent_radius,
    feed_radius as feed_radius,
    milled_cumulants as milled_cumulants,
    milled_map as milled_map,
    scallop_cumulants as scallop_cumulants,
    scallops as scallops,
)
from .parameters import (
    ArealParameters as ArealParameters,
    areal_parameters as areal_parameters,
)
from .planarisation import (
    asperity_stiffness as asperity_stiffness,
    pad_pressure as pad_pressure,
    planarise as planarise,
    planarised as planarised,
)
from .scratches import (
    Population as Population,
    Scratches as Scratches,
    compression as compression,
    decay as decay,
    decay_rate as decay_rate,
    groove_cumulants as groove_cumulants,
    groove_depth as groove_depth,
    groove_population as groove_population,
    groove_width as groove_width,
    survival as survival,
)
from .spatial import (
    SpatialParameters as SpatialParameters,
    autocorrelation as autocorrelation,
    spatial_parameters as spatial_parameters,
)
from .spectrum import (
    Spectrum as Spectrum,
    areal_spectrum as areal_spectrum,
    band_power as band_power,
    directional_mean as directional_mean,
    peak_to_median as peak_to_median,
    radial_mean as radial_mean,
    strongest_wave as strongest_wave,
)
from .uncertainty import (
    StandardErrors as StandardErrors,
    moment_errors as moment_errors,
    standard_errors as standard_errors,
)
