"""Tool path: where the disc's driven point is and how its axis leans.

The trochoid gives the contact point, the surface its normal, and the guide the direction
in which the axis leans. The guide's tangent serves for the lean rather than the
trochoid's, because the axis would otherwise sweep a cone in every loop.
"""

import dataclasses
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..parts import Process, Scalar
from .guide import Guide, GuidePoint
from .surface import Surface, tangent_plane, upright
from .trochoid import trochoid


class Posture(eqx.Module):
    """Place and axis of the tool at one point of the path, in the part frame."""

    contact: Float[Array, "3"]
    """Contact point on the undeformed part, C_C [mm]."""
    normal: Float[Array, "3"]
    """Normal of the part there, out of the material, n [-]."""
    feed_direction: Float[Array, "3"]
    """Unit tangent of the part in which the axis leans, f [-]."""
    axis: Float[Array, "3"]
    """Tool axis, from the disc to the spindle, u [-]."""
    tip: Float[Array, "3"]
    """Driven point, the centre of the disc's face, C_E [mm]."""
    xy: Float[Array, "2"]
    """Contact point in the parameter plane [mm]."""

    @property
    def side(self) -> Float[Array, "*n 3"]:
        """Unit tangent to the left of `feed_direction`, b = n x f [-]."""
        return jnp.cross(self.normal, self.feed_direction)


def posture(
    surface: Surface,
    point: GuidePoint,
    phase: Scalar,
    process: Process,
    tool_radius: Scalar,
    pulling: bool | int = True,
    lean: str = "guide",
    corner_radius: Scalar | float = 0.0,
) -> Posture:
    r"""Place and axis of the tool at one phase of the trochoid.

    The axis is $u = \cos\theta\, n + m \sin\theta\, f$ with $m = 1$ when pulling (it
    leans towards the feed) and $m = -1$ when pushing. The disc then touches the part
    with the deepest point of its edge. The way from there to its centre climbs along
    the face, $v = \sin\theta\, n - m \cos\theta\, f$, and the driven point is
    $C_E = C_C + r n + (R - r) v - r u - e\, n$.

    The paper writes the pushing lean as $\theta < 0$ and puts its $\delta = -1$ before
    $v$. But its $v = (u \wedge n)/|u \wedge n| \wedge u$ already turns round with the
    sign of $\theta$ ($v \cdot n = |\sin\theta|$), so that the further sign would put the
    centre below the surface; it is left out here. A negative tilt is accepted and means
    the other mode. At $\theta = 0$ the formula for $v$ goes on smoothly from positive
    tilts: $v = -m f$. The displacement acts along $-n$, as it must on a free form; on a
    plane this is the paper's $-z$.

    Args:
        surface: The part.
        point: Point of the guide.
        phase: Angle of the trochoid's circle [rad].
        process: Tilt, displacement, step and trochoid radius are read.
        tool_radius: Radius of the disc, $R$ [mm].
        pulling: True or 1 if the axis leans towards the feed, False or -1 if away.
        lean: "guide" to lean along the guide as it lies on the part, "fixed" to lean
            along the x axis of the part frame, projected on the part.
        corner_radius: Radius of the disc's rounded edge, $r$ [mm].

    Source: S0 (Pessoles & Tournier 2009), eqs. (1), (5) and (11) to (13), corrected.
    """
    if lean not in ("guide", "fixed"):
        raise ValueError(f"`lean` is {lean!r}, must be 'guide' or 'fixed'.")
    xy = trochoid(point, phase, process.step, process.trochoid_radius)
    contact, columns = tangent_plane(surface, xy)
    n = upright(columns)
    if lean == "guide":
        tangent = jnp.stack([jnp.cos(point.heading), jnp.sin(point.heading)])
        along = columns @ tangent
    else:
        along = jnp.zeros_like(n).at[0].set(1) - n[0] * n
    f = along / jnp.sqrt(jnp.sum(along**2))

    mode = 1.0 if pulling > 0 else -1.0
    cosine, sine = jnp.cos(process.tilt), mode * jnp.sin(process.tilt)
    axis = cosine * n + sine * f
    climbing = jnp.where(process.tilt < 0, -mode, mode)
    v = climbing * (sine * n - cosine * f)
    r = corner_radius
    tip = contact + r * n + (tool_radius - r) * v - r * axis - process.displacement * n
    return Posture(
        contact=contact,
        normal=n,
        feed_direction=f,
        axis=axis,
        tip=tip,
        xy=xy,
    )


def resolved(
    surface: Surface,
    guide: Guide,
    process: Process,
    tool_radius: Scalar,
    s: Float[Array, " n"],
    pulling: bool | int = True,
    lean: str = "guide",
    phase0: Scalar | float = 0.0,
    corner_radius: Scalar | float = 0.0,
    displacement: Callable[[Scalar], Scalar] | None = None,
) -> Posture:
    r"""The tool path with every loop of the trochoid.

    The number of samples does not depend on the step: a finer step turns the phase
    $\varphi = 2 \pi s/p + \varphi_0$ faster.

    Args:
        surface: The part.
        guide: The curve along which the trochoid is rolled.
        process: Tilt, displacement, step and trochoid radius are read.
        tool_radius: Radius of the disc [mm].
        s: Arc lengths of the guide, one a sample [mm].
        pulling: True or 1 if the axis leans towards the feed, False or -1 if away.
        lean: "guide" or "fixed", as in `posture`.
        phase0: Phase at the start, $\varphi_0$ [rad].
        corner_radius: Radius of the disc's rounded edge [mm].
        displacement: Displacement [mm] as a function of the guide's arc length [mm]; that
            of the process if not given.

    Returns:
        The postures, one a row.

    Source: S0 (Pessoles & Tournier 2009), section 2.2.3.
    """

    def at(s: Scalar) -> Posture:
        phase = 2 * jnp.pi * s / process.step + phase0
        pressed = process
        if displacement is not None:
            pressed = dataclasses.replace(process, displacement=displacement(s))
        return posture(
            surface,
            guide(s),
            phase,
            pressed,
            tool_radius,
            pulling,
            lean,
            corner_radius,
        )

    return jax.vmap(at)(s)
