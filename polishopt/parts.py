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


def scalar_or_none(x) -> Scalar | None:
    """A number as by `as_scalar`; None stays None."""
    return None if x is None else as_scalar(x)


class Process(eqx.Module):
    """What the process engineer sets, and what the optimiser moves.

    The last six say how the part is moved from where it stands by its machine; see
    `machine.kinematics.placed`. None is no move, and known before anything is compiled: a
    process that does not touch them costs what it would cost without them.
    """

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
    shift_x: Scalar | None = eqx.field(converter=scalar_or_none, default=None)
    """How far the part is moved on what carries it, added to `Machine.offset` [mm]."""
    shift_y: Scalar | None = eqx.field(converter=scalar_or_none, default=None)
    """The same along Y [mm]."""
    shift_z: Scalar | None = eqx.field(converter=scalar_or_none, default=None)
    """The same along Z [mm]."""
    wedge_x: Scalar | None = eqx.field(converter=scalar_or_none, default=None)
    """How the part is turned about X, added to the first of `Machine.wedge` [rad]."""
    wedge_y: Scalar | None = eqx.field(converter=scalar_or_none, default=None)
    """The same about Y, the second [rad]."""
    wedge_z: Scalar | None = eqx.field(converter=scalar_or_none, default=None)
    """The same about Z, the third [rad]."""

    @property
    def wedged(self) -> bool:
        """Whether a wedge is set, be it zero: then a plane may meet the pole as well."""
        angles = (self.wedge_x, self.wedge_y, self.wedge_z)
        return any(angle is not None for angle in angles)


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
    """A 5-axis machine: a chain of three linear and two rotary axes.

    `chain` is its structural code, from the part to the tool: `w C A b X Y Z t` is a
    table that C turns and A tilts (w is the work-piece, b the bed, t the tool), and a tool
    that X, Y and Z move. Arrays of five follow `names`. With all axes at zero the tool tip
    stands at the machine's origin and the spindle along its Z.

    A positive position of a linear axis moves the tool against the part along the axis's
    direction; a positive angle turns what the axis carries (the part, if it stands between
    w and b, or else the tool) about it.
    """

    max_speed: Float[Array, "5"] = eqx.field(converter=as_array)
    """Fastest speed of each axis [mm/s or rad/s]."""
    max_acceleration: Float[Array, "5"] = eqx.field(converter=as_array)
    """Largest acceleration of each axis [mm/s^2 or rad/s^2]."""
    max_jerk: Float[Array, "5"] = eqx.field(converter=as_array)
    """Largest jerk of each axis [mm/s^3 or rad/s^3]."""
    chain: str = eqx.field(static=True, default="w C A b X Y Z t")
    """Its axes from the part (w) to the tool (t), with the bed (b) where it stands."""
    directions: tuple[tuple[float, float, float], ...] = eqx.field(static=True, default=())
    """Direction of each axis at zero; empty where each is that of its letter."""
    pivots: Float[Array, "2 3"] = eqx.field(
        converter=as_array, default_factory=lambda: jnp.zeros((2, 3))
    )
    """A point of each rotary axis in machine coordinates, all axes at zero [mm]."""
    lower: Float[Array, "5"] = eqx.field(
        converter=as_array, default_factory=lambda: jnp.full(5, -jnp.inf)
    )
    """Where the travel of each axis ends below [mm or rad]."""
    upper: Float[Array, "5"] = eqx.field(
        converter=as_array, default_factory=lambda: jnp.full(5, jnp.inf)
    )
    """Where it ends above [mm or rad]."""
    offset: Float[Array, "3"] = eqx.field(
        converter=as_array, default_factory=lambda: jnp.zeros(3)
    )
    """Origin of the part, all axes at zero, from the pivot of the rotary axis next to it,
    or from the machine's origin where no table turns it [mm]."""
    wedge: tuple[Scalar | None, ...] = eqx.field(
        converter=lambda angles: tuple(scalar_or_none(angle) for angle in angles),
        default=(None, None, None),
    )
    """How the part is turned on what carries it: about X, then Y, then Z; None is not at
    all, and known before anything is compiled [rad]."""
    branch: int = eqx.field(static=True, default=0)
    """Which solution of the rotary axes is run: 0 for the one that has the rotary axis
    next to the tool at the larger angle, 1 for the other one."""

    @property
    def names(self) -> tuple[str, ...]:
        """What people call the axes: linear ones first, each kind by the alphabet."""
        axes = [name for name in self.chain.split() if name in "XYZABC"]
        return tuple(sorted(axes, key=lambda name: (name in "ABC", name)))
