r"""Cutter: a filleted end mill on its path, and where each tooth stands when.

The cutting edge of a tooth is a circle arc of the corner radius, in a plane through the
tool axis; its centre runs on a circle of radius $R_c = R - r$ round the axis. Between two
turns the tool hardly moves, so that what matters is where it stands whenever a tooth
points towards the contact, and how fast it moves on from there. These moments come from
the true time along the path, whether programmed or from `machine.feed`. The angle of the
spindle is counted from the direction in which the tool leans, which turns hundreds of
times more slowly; deflection is left out.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..machine.feed import TimeLaw, time_law
from ..machine.kinematics import inverse_path
from ..parts import Machine, Scalar, as_array, as_scalar
from ..path.surface import Surface, jacobian, normal as surface_normal


class Cutter(eqx.Module):
    """A filleted end mill; a ball-end mill where both radii are equal."""

    outer_radius: Scalar = eqx.field(converter=as_scalar)
    """Outer radius, R [mm]."""
    corner_radius: Scalar = eqx.field(converter=as_scalar)
    """Radius of the rounded corner, r [mm]."""
    runout: Float[Array, " teeth"] = eqx.field(
        converter=as_array, default_factory=lambda: jnp.zeros(1)
    )
    """How far each tooth stands out beyond R [mm]; one number a tooth."""
    flat: bool = eqx.field(static=True, default=False)
    """Whether the flat end has an edge too; usually it is ground hollow and has none."""

    @property
    def ring(self) -> Scalar:
        """Radius of the circle on which the centres of the edges run, R_c [mm]."""
        return self.outer_radius - self.corner_radius

    @property
    def teeth(self) -> int:
        """How many teeth it has."""
        return self.runout.size


class Postures(eqx.Module):
    """The tool along one pass, sample by sample, in the part frame."""

    contact: Float[Array, "*n 3"]
    """Contact point on the part as drawn [mm]."""
    centre: Float[Array, "*n 3"]
    """Centre of the circle on which the centres of the edges run [mm]."""
    axis: Float[Array, "*n 3"]
    """Tool axis, into the spindle, u [-]."""
    towards: Float[Array, "*n 3"]
    """Unit vector across the axis, from it towards the contact, d [-]."""


class Passings(eqx.Module):
    """Where the tool stands whenever a tooth points towards the contact.

    What changes while that tooth goes on turning is given per radian of its turn, counted
    counter-clockwise as seen from the spindle.
    """

    centre: Float[Array, "*m 3"]
    """Centre of the circle on which the centres of the edges run [mm]."""
    slope: Float[Array, "*m 3"]
    """Its change [mm/rad]."""
    bend: Float[Array, "*m 3"]
    """The change of that [mm/rad^2]."""
    axis: Float[Array, "*m 3"]
    """Tool axis [-]."""
    axis_slope: Float[Array, "*m 3"]
    """Its change [1/rad]."""
    towards: Float[Array, "*m 3"]
    """Direction of the tooth [-]."""
    towards_slope: Float[Array, "*m 3"]
    """Its change with the lean of the tool, not with the turn of the spindle [1/rad]."""
    tooth: Int[Array, "*m"]
    """Which tooth it is."""


def postures(
    surface: Surface,
    xy: Float[Array, "n 2"],
    heading: Float[Array, " n"],
    cutter: Cutter,
    tilt: Scalar,
    yaw: Scalar,
    depth: Scalar | float = 0.0,
) -> Postures:
    r"""The tool on a row of contact points of a part.

    With the feed along $f$, $b = n \wedge f$ and $m = \cos\theta_n f + \sin\theta_n b$,
    the axis is $u = \cos\theta_t\, n + \sin\theta_t\, m$, so that the front edge cuts and
    the heel is clear. The contact lies in the direction
    $d = \cos\theta_t\, m - \sin\theta_t\, n$ from the axis, and the centre is
    $C_C + (r - e) n - R_c d$.

    Args:
        surface: The part.
        xy: Contact points in the parameter plane [mm].
        heading: Direction of the feed in the parameter plane, from x towards y [rad].
        cutter: The tool.
        tilt: Angle between its axis and the normal, $\theta_t$ [rad].
        yaw: Turn of the tilt plane from the feed about the normal, $\theta_n$ [rad].
        depth: How far the tool is set below the part as drawn, $e$ [mm].

    Source: S2 fig. 4.
    """

    def at(xy: Float[Array, "2"], heading: Scalar) -> Postures:
        contact, n = surface(xy), surface_normal(surface, xy)
        along = jacobian(surface, xy) @ jnp.stack([jnp.cos(heading), jnp.sin(heading)])
        f = along / jnp.sqrt(jnp.sum(along**2))
        m = jnp.cos(yaw) * f + jnp.sin(yaw) * jnp.cross(n, f)
        axis = jnp.cos(tilt) * n + jnp.sin(tilt) * m
        towards = jnp.cos(tilt) * m - jnp.sin(tilt) * n
        centre = contact + (cutter.corner_radius - depth) * n - cutter.ring * towards
        return Postures(contact, centre, axis, towards)

    return jax.vmap(at)(xy, heading)


def arc_length(pass_: Postures) -> Float[Array, " n"]:
    """Length of the contact path up to each sample, by chords [mm].

    Source: S2 eq. (1), for the contact rather than the tip.
    """
    chords = jnp.sqrt(jnp.sum(jnp.diff(pass_.contact, axis=0) ** 2, axis=1))
    return jnp.pad(jnp.cumsum(chords), (1, 0))


def true_feed(
    pass_: Postures,
    cutter: Cutter,
    machine: Machine,
    programmed: Scalar,
    rest: tuple[bool, bool] = (False, False),
) -> TimeLaw:
    """The fastest motion along a pass that the axes of a machine allow.

    Args:
        pass_: The pass.
        cutter: The tool, for the place of its tip.
        machine: The machine.
        programmed: Programmed feed of the contact point [mm/s].
        rest: Whether the pass starts and ends at rest.

    Source: S2 section 2; see `machine.feed` for the limits.
    """
    tips = pass_.centre - cutter.corner_radius * pass_.axis
    axes = inverse_path(tips, pass_.axis, machine)
    return time_law(axes, machine, arc_length(pass_), programmed, rest=rest)


def passings(
    pass_: Postures,
    time: Float[Array, " n"],
    feed: Float[Array, " n"],
    spin: Scalar,
    cutter: Cutter,
    count: int,
    turned: Scalar | float = 0.0,
) -> Passings:
    r"""Where the tool stands whenever a tooth points towards the contact.

    Tooth after tooth points there at the spindle angles $\alpha = 2\pi m/Z$. Between
    samples the feed is linear in time, $V^* = V_i + (V_{i+1} - V_i)\tau/\Delta t$, the
    way $(V_i + V^*)\tau/2$ is laid along the chord, and the axis turns in proportion.
    The spindle turns clockwise as seen from above (M3). After its last sample the tool
    stands still.

    Args:
        pass_: The pass, with samples so close that their chords follow the part.
        time: Time at each sample, as in `TimeLaw` [s].
        feed: Speed at each sample, as in `TimeLaw` [mm/s].
        spin: Speed of the spindle, $\Omega$ [rad/s].
        cutter: The tool, for its number of teeth, $Z$.
        count: Number of passings, static: see `passing_count`.
        turned: Spindle angle at the start of the pass, from the first tooth's pointing
            towards the contact [rad].

    Source: S2 eqs. (3) to (7).
    """
    at = _interpolate(pass_, time, feed)
    number = jnp.arange(count, dtype=time.dtype)
    quarter = 0.5 * jnp.pi / spin
    moments = (2.0 * jnp.pi / cutter.teeth * number - turned) / spin
    before, here, after = (at(moments + k * quarter) for k in (-1.0, 0.0, 1.0))

    def slope(name: str) -> Float[Array, "m 3"]:
        # time runs against the angle: the spindle turns clockwise
        return (getattr(before, name) - getattr(after, name)) / jnp.pi

    bend = before.centre - 2.0 * here.centre + after.centre
    return Passings(
        centre=here.centre,
        slope=slope("centre"),
        bend=bend * (2.0 / jnp.pi) ** 2,
        axis=here.axis,
        axis_slope=slope("axis"),
        towards=here.towards,
        towards_slope=slope("towards"),
        tooth=jnp.arange(count) % cutter.teeth,
    )


def passing_count(total: Scalar | float, spin: Scalar | float, cutter: Cutter) -> int:
    """How many passings a pass of a given time holds; not for use under `jit`.

    Args:
        total: Time for the pass [s].
        spin: Speed of the spindle [rad/s].
        cutter: The tool.
    """
    return int(float(total) * float(spin) / (2.0 * jnp.pi) * cutter.teeth) + 2


def several(passes: Passings) -> Passings:
    """The passings of several passes, one after the other, from stacked ones.

    Args:
        passes: Passings with one more axis in front, such as `jax.vmap` returns.
    """
    return jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), passes)


def _interpolate(
    pass_: Postures, time: Float[Array, " n"], feed: Float[Array, " n"]
) -> Callable[[Float[Array, " m"]], Postures]:
    """The tool at any moments of a pass."""

    def at(moments: Float[Array, " m"]) -> Postures:
        left = jnp.clip(jnp.searchsorted(time, moments, side="right") - 1, 0, time.size - 2)
        span = time[left + 1] - time[left]
        moving = span > 0
        part = jnp.where(moving, moments - time[left], 0.0) / jnp.where(moving, span, 1.0)
        part = jnp.clip(part, 0.0, 1.0)
        slow, fast = feed[left], feed[left + 1]
        both = slow + fast
        runs = both > 0
        way = part * (2.0 * slow + (fast - slow) * part) / jnp.where(runs, both, 1.0)
        way = jnp.where(runs, way, part)[:, None]

        def between(x: Float[Array, "n 3"]) -> Float[Array, "m 3"]:
            return x[left] + way * (x[left + 1] - x[left])

        def unit(x: Float[Array, "m 3"]) -> Float[Array, "m 3"]:
            return x / jnp.sqrt(jnp.sum(x**2, axis=1, keepdims=True))

        axis, towards = unit(between(pass_.axis)), between(pass_.towards)
        across = towards - jnp.sum(towards * axis, axis=1, keepdims=True) * axis
        return Postures(between(pass_.contact), between(pass_.centre), axis, unit(across))

    return at
