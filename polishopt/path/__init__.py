"""Path: from the shape of the part to the place and axis of the tool."""

from .guide import (
    Guide as Guide,
    GuidePoint as GuidePoint,
    hilbert as hilbert,
    lines as lines,
    polyline as polyline,
)
from .surface import (
    HyperbolicParaboloid as HyperbolicParaboloid,
    Plane as Plane,
    SphereCap as SphereCap,
    Surface as Surface,
    area_stretch as area_stretch,
    curvature as curvature,
    jacobian as jacobian,
    metric as metric,
    normal as normal,
    tangent_to_parameter as tangent_to_parameter,
)
from .toolpath import Posture as Posture, posture as posture, resolved as resolved
from .trochoid import length_per_loop as length_per_loop, trochoid as trochoid
