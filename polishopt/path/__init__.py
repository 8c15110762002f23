"""Path: from the shape of the part to the place and axis of the tool."""

from .asphere import Asphere as Asphere
from .even import Even as Even, even as even
from .families import (
    hatch as hatch,
    hilbert as hilbert,
    hilbert_rectangle as hilbert_rectangle,
    lines as lines,
    peano as peano,
    round_spiral as round_spiral,
    spiral as spiral,
)
from .guide import (
    Guide as Guide,
    GuidePoint as GuidePoint,
    Segments as Segments,
    segments as segments,
)
from .nurbs import Nurbs as Nurbs, fit_nurbs as fit_nurbs, nurbs as nurbs
from .polyline import polyline as polyline
from .revolution import peano_revolution as peano_revolution
from .soundness import check_surface as check_surface
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
