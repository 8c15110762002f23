"""Parts: the nouns of polishing, with their units, and no physics.

Every noun is a frozen pytree. Lengths are in mm, forces in N, times in s and angles in
rad, so pressures are in MPa. What is tuned is a `Process`; what is given is a `Setup`
(built from the chapters above this floor); the rest of this file is what a setup is made
of.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float


Scalar = Float[Array, ""]


def as_scalar(x) -> Scalar:
    """A number as a strongly typed float array without axes."""
    return jnp.asarray(x, dtype=float)


def as_array(x) -> Array:
    """Numbers as a strongly typed float array."""
    return jnp.asarray(x, dtype=float)


class Process(eqx.Module):
    """What the process engineer sets, and what the optimiser moves."""

    tilt: Scalar = eqx.field(converter=as_scalar)
    """Angle between tool axis and surface normal, theta [rad]."""
    displacement: Scalar = eqx.field(converter=as_scalar)
    """How far the disc is pressed in along the surface normal, e [mm]."""
    step: Scalar = eqx.field(converter=as_scalar)
    """Advance of the trochoid along its guide per loop, p [mm]."""
    trochoid_radius: Scalar = eqx.field(converter=as_scalar)
    """Radius of the trochoid's circle, D_tr of S0 Eq. 5 [mm]."""
    feed: Scalar = eqx.field(converter=as_scalar)
    """Programmed speed of the contact point along the trochoid, V_f [mm/s]."""
    spin: Scalar = eqx.field(converter=as_scalar)
    """Spindle speed, N [rad/s]."""
    passes: Scalar = eqx.field(converter=as_scalar, default=1.0)
    """How often the whole path is run [-]."""


class Tool(eqx.Module):
    """A compliant disc on a stiffer body (S0 section 2.1)."""

    radius: Scalar = eqx.field(converter=as_scalar)
    """Half the disc diameter, R = D/2 [mm]."""
    foundation: Scalar = eqx.field(converter=as_scalar)
    """Stiffness of the elastic bed per area, k [N/mm^3]."""
    body_radius: Scalar = eqx.field(converter=as_scalar)
    """Radius of the rigid body behind the disc, R_b [mm]."""
    body_recess: Scalar = eqx.field(converter=as_scalar)
    """Distance of that body behind the disc face, h_b [mm]."""
    unstick_tilts: Float[Array, " n"] = eqx.field(converter=as_array)
    """Tilts at which the unstick force was measured, ascending [rad]."""
    unstick_forces: Float[Array, " n"] = eqx.field(converter=as_array)
    """Force at which the disc comes unstuck at each of these tilts [N]."""
    friction: Scalar = eqx.field(converter=as_scalar, default=0.4)
    """Friction coefficient between abrasive and part, mu [-]."""
    shear_strength: Scalar = eqx.field(converter=as_scalar, default=jnp.inf)
    """Shear stress at which the adhesive fails, tau [MPa]; infinite if unknown."""
    stiffening: Scalar = eqx.field(converter=as_scalar, default=0.0)
    """Relative growth of `foundation` per depth pressed in, beta [1/mm]."""


class Abrasive(eqx.Module):
    """A grade of abrasive on a given work material."""

    preston: Scalar = eqx.field(converter=as_scalar)
    """Preston coefficient, K_P [1/MPa]."""
    grain: Scalar = eqx.field(converter=as_scalar)
    """Mean grain diameter, d [mm]."""
    active_fraction: Scalar = eqx.field(converter=as_scalar)
    """Active grains per d^2 of contact, c_a [-]."""
    half_angle: Scalar = eqx.field(converter=as_scalar)
    """Half-angle of a grain's tip, psi [rad]."""
    hardness: Scalar = eqx.field(converter=as_scalar)
    """Hardness of the work material, H [MPa]."""
    pad_modulus: Scalar = eqx.field(converter=as_scalar)
    """Effective elastic modulus of the pad at grain scale, E* [MPa]."""
    depth_variation: Scalar = eqx.field(converter=as_scalar)
    """Standard deviation of the groove depths over their mean [-]."""
    conformity: Scalar = eqx.field(converter=as_scalar)
    """Length above which the pad follows the surface, l_c [mm]."""
    asperity_stiffness: Scalar = eqx.field(converter=as_scalar, default=jnp.nan)
    """Calibrated K_a [N/mm^3]; NaN means take it from `pad_modulus`."""
    ripple_gain: Scalar = eqx.field(converter=as_scalar, default=1.0)
    """Amplitude of the ripple that is found, over the one that the path predicts [-]."""


AXES = ("X", "Y", "Z", "A", "C")


class Machine(eqx.Module):
    """A 5-axis milling centre whose table tilts about X (A) and turns about Z (C)."""

    max_speed: Float[Array, "5"] = eqx.field(converter=as_array)
    """Fastest speed of X, Y, Z [mm/s], A, C [rad/s]."""
    max_acceleration: Float[Array, "5"] = eqx.field(converter=as_array)
    """Largest acceleration of X, Y, Z [mm/s^2], A, C [rad/s^2]."""
    max_jerk: Float[Array, "5"] = eqx.field(converter=as_array)
    """Largest jerk of X, Y, Z [mm/s^3], A, C [rad/s^3]."""
    tilt_pivot: Float[Array, "3"] = eqx.field(
        converter=as_array, default_factory=lambda: jnp.zeros(3)
    )
    """A point of the A axis, in machine coordinates at A = C = 0, T_A [mm]."""
    turn_pivot: Float[Array, "3"] = eqx.field(
        converter=as_array, default_factory=lambda: jnp.zeros(3)
    )
    """From that point to the part's origin on the C axis, T_C [mm]."""
