"""Functional: what the material ratio curve says of a surface that bears and seals.

The curve is the height above which a given share of the surface lies: the sorted heights,
from the highest to the lowest. It is sampled at classes equally spaced in material ratio,
which gives the core and the limits. The volumes above and below a limit are summed over
all points, so they know nothing of classes. Ratios are shares between 0 and 1.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..parts import Scalar


# share of the curve that the equivalent line of the core is fitted to (ISO 25178-2)
WINDOW = 0.4
# ratios that bound the core volumes, and those whose heights Sxp tells apart (ISO 25178-3)
PEAK, VALLEY = 0.1, 0.8
EXTREME, MIDDLE = 0.025, 0.5
# Ten thousand classes: commercial programs agree to four figures with them. They must
# be many enough that the window holds a thousand of them.
CLASSES = 10_000


class FunctionalParameters(eqx.Module):
    """Functional and volume parameters of ISO 25178-2."""

    Sk: Scalar
    """Height of the core, from its upper to its lower limit [mm]."""
    Spk: Scalar
    """Reduced peak height, above the core [mm]."""
    Svk: Scalar
    """Reduced dale depth, below the core [mm]."""
    Smr1: Scalar
    """Material ratio at the upper limit of the core [-]."""
    Smr2: Scalar
    """Material ratio at the lower limit of the core [-]."""
    Sxp: Scalar
    """Height between the material ratios 2.5 % and 50 % [mm]."""
    Vmp: Scalar
    """Material of the peaks, above the ratio 10 %, per area [mm]."""
    Vmc: Scalar
    """Material of the core, between the ratios 10 % and 80 %, per area [mm]."""
    Vvv: Scalar
    """Void of the dales, below the ratio 80 %, per area [mm]."""
    Vvc: Scalar
    """Void of the core, between the ratios 10 % and 80 %, per area [mm]."""


@jax.custom_jvp
def _sorted(v: Float[Array, " n"]) -> Float[Array, " n"]:
    """Sorted, NaN last: by the bits, read as integers, in a third of the time."""
    whole = jnp.int64 if v.dtype == jnp.float64 else jnp.int32
    largest = jnp.iinfo(whole).max

    def turned(bits):
        # negative floats grow downwards with their bits
        return jnp.where(bits < 0, bits ^ largest, bits)

    v = jnp.where(jnp.isnan(v), jnp.nan, v)
    bits = turned(jax.lax.bitcast_convert_type(v, whole))
    return jax.lax.bitcast_convert_type(turned(jnp.sort(bits, stable=False)), v.dtype)


@_sorted.defjvp
def _sorted_jvp(primals, tangents):
    return jax.jvp(jnp.sort, primals, tangents)


def material_ratio_curve(
    z: Float[Array, "ny nx"], classes: int = CLASSES
) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    """Material ratios [-], and the height above which each share of the surface lies [mm].

    Args:
        z: Heights [mm]; points that are NaN were not measured and do not count.
        classes: Number of equally spaced ratios, from 0 (the highest point) to 1.

    Returns:
        Ratios from 0 to 1, and heights from the highest point to the lowest.

    Source: ISO 25178-2.
    """
    ratio = jnp.linspace(0.0, 1.0, classes, dtype=z.dtype)
    ascending = _sorted(z.ravel())
    count = jnp.sum(~jnp.isnan(ascending))
    last = jnp.maximum(count - 1, 0)
    place = (1.0 - ratio) * last.astype(z.dtype)
    below = jnp.clip(jnp.floor(place).astype(count.dtype), 0, jnp.maximum(last - 1, 0))
    above = jnp.minimum(below + 1, last)
    part = place - below.astype(z.dtype)
    low, high = ascending[below], ascending[above]
    return ratio, low + part * (high - low)


def functional_parameters(
    z: Float[Array, "ny nx"], classes: int = CLASSES
) -> FunctionalParameters:
    r"""Core, peaks and dales of a map by its material ratio curve.

    The central 40 % of the curve are where its secant is least steep, the first such
    place if there are several. The equivalent line is fitted there by least squares; at
    the ratios 0 and 1 it gives the limits of the core. Spk and Svk are the heights of the
    right-angled triangles that have the areas of curve and core limit above Smr1 and below
    Smr2. Where a limit lies beyond the curve, as for a sine, nothing stands out and they
    are zero.

    $V_{mp} = V_m(0.1)$, $V_{mc} = V_m(0.8) - V_m(0.1)$, $V_{vv} = V_v(0.8)$ and
    $V_{vc} = V_v(0.1) - V_v(0.8)$, where $V_m(p)$ is the material above the height at the
    ratio p, and $V_v(p)$ the void below it. All are zero for a flat map but Smr1 and
    Smr2, which are then 0 and 1.

    Derivatives hold as long as no two heights change places, and the window stays.

    Args:
        z: Heights [mm]; points that are NaN were not measured and do not count.
        classes: Number of points of the curve; at least 100.

    Raises:
        ValueError: if there are fewer than 100 classes.

    Source: ISO 25178-2, annex B; limits of the volumes from ISO 25178-3.
    """
    if classes < 100:
        raise ValueError(f"`classes` must be at least 100, got {classes}")
    ratio, height = material_ratio_curve(z, classes)
    # counted from the median, an offset costs no digits
    middle = jax.lax.stop_gradient(height[classes // 2])
    height = height - middle
    upper, lower = _core(ratio, height)
    Smr1 = _ratio_at(height, upper, height > upper)
    Smr2 = _ratio_at(height, lower, height >= lower)

    gap = jnp.isnan(z)
    count = jnp.sum((~gap).astype(z.dtype))
    z = jnp.where(gap, 0.0, z - middle)

    def material(level):
        stands = ~gap & (z > level)
        return jnp.sum(jnp.where(stands, z - level, 0.0)) / count

    def void(level):
        lacks = ~gap & (z < level)
        return jnp.sum(jnp.where(lacks, level - z, 0.0)) / count

    peak, valley = _height_at(height, PEAK), _height_at(height, VALLEY)
    Vmp, Vvv = material(peak), void(valley)
    return FunctionalParameters(
        Sk=upper - lower,
        Spk=_triangle(material(upper), Smr1),
        Svk=_triangle(void(lower), 1.0 - Smr2),
        Smr1=Smr1,
        Smr2=Smr2,
        Sxp=_height_at(height, EXTREME) - _height_at(height, MIDDLE),
        Vmp=Vmp,
        Vmc=material(valley) - Vmp,
        Vvv=Vvv,
        Vvc=void(peak) - Vvv,
    )


def _core(ratio: Float[Array, " n"], height: Float[Array, " n"]) -> tuple[Scalar, Scalar]:
    """Heights of the equivalent line at the ratios 0 and 1 [mm]."""
    classes = height.size
    width = WINDOW * (classes - 1)
    whole, part = math.floor(width), width - math.floor(width)
    start = np.arange(classes - math.ceil(width))
    end = start + whole
    ends = (1.0 - part) * height[end] + part * height[np.minimum(end + 1, classes - 1)]
    first = jnp.argmax(ends - height[start])
    inside = jax.lax.dynamic_slice(height, (first,), (whole + 1,))
    # ratios from the middle of the window
    t = (jnp.arange(whole + 1, dtype=height.dtype) - 0.5 * whole) / (classes - 1)
    slope = jnp.sum(t * inside) / jnp.sum(t * t)
    upper = jnp.mean(inside) - slope * (ratio[first] + 0.5 * whole / (classes - 1))
    return upper, upper + slope


def _ratio_at(
    height: Float[Array, " n"], level: Scalar, beyond: Bool[Array, " n"]
) -> Scalar:
    """Share of the curve that is beyond a level: 0 where none is, 1 where all are."""
    classes = height.size
    count = jnp.sum(beyond)
    above = height[jnp.clip(count - 1, 0, classes - 2)]
    drop = above - height[jnp.clip(count, 1, classes - 1)]
    between = (count > 0) & (count < classes) & (drop > 0)
    part = jnp.where(between, (above - level) / jnp.where(between, drop, 1.0), 0.0)
    whole = jnp.maximum(count - 1, 0).astype(height.dtype)
    return (whole + part) / (classes - 1)


def _height_at(height: Float[Array, " n"], ratio: float) -> Scalar:
    """Height of the curve at a ratio, Smc [mm]."""
    place = ratio * (height.size - 1)
    below = min(math.floor(place), height.size - 2)
    return height[below] + (place - below) * (height[below + 1] - height[below])


def _triangle(area: Scalar, base: Scalar) -> Scalar:
    """Height of a right-angled triangle [mm]; zero if it has no base."""
    stands = base > 0
    return jnp.where(stands, 2.0 * area / jnp.where(stands, base, 1.0), 0.0)
