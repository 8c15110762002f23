r"""Hold: the displacement that keeps the contact alike where the part's curvature changes.

A disc pressed in by the same displacement everywhere presses the less the more the part
bends away from it. Here the displacement follows the guide instead, so that the force, or
the mean pressure, is that of the nominal displacement on a plane. It goes no further than
the rigid body and the adhesive allow; where it ends there, less is held, and the outcome's
smallest force says how much less.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .batched import in_batches
from .contact.limits import most_displacement
from .contact.pressure import force_and_area
from .parts import Process, Scalar, Tool
from .path.surface import curvature
from .path.toolpath import posture
from .setup import Setup


# Newton steps; and knots of a schedule in each cell of the guide, where a corner may turn
# the disc from along one curvature to along the other.
STEPS, KNOTS, AT_ONCE = 8, 16, 64
# On a plane the force grows as displacement^2.5, so this power of it is nearly straight.
STRAIGHT = 0.4


class Schedule(eqx.Module):
    """The displacement as a function of the guide's arc length, twice differentiable."""

    spacing: Scalar
    """Distance of its knots along the guide [mm]."""
    coefficients: Float[Array, " knots"]
    """Of cubic B-splines [mm]."""

    def __call__(self, s: Scalar) -> Scalar:
        """Displacement at the arc length s of the guide [mm]."""
        place = s / self.spacing
        below = jnp.clip(jnp.floor(place), 0.0, self.coefficients.size - 4.0)
        t, first = place - below, below.astype(int)
        weights = jnp.stack(
            [(1 - t) ** 3, 4 + t**2 * (3 * t - 6), 1 + 3 * t * (1 + t - t**2), t**3]
        )
        return weights @ self.coefficients[first + jnp.arange(4)] / 6


def loop_bend(process: Process, setup: Setup, s: Scalar) -> Float[Array, "2 2"]:
    """Normal curvature along (feed, left), averaged over the loop at a place [1/mm].

    Args:
        process: Step and trochoid radius are read.
        setup: The job.
        s: Arc length of the guide [mm].
    """
    point, count = setup.guide(s), setup.sampling.phases

    def at(phase):
        place = posture(
            setup.surface,
            point,
            phase,
            process,
            setup.tool.radius,
            setup.pulling,
            setup.lean,
        )
        return curvature(setup.surface, place.xy, place.feed_direction, place.side)

    phases = jnp.asarray(2 * np.pi * np.arange(count) / count, dtype=s.dtype)
    return jnp.mean(jax.vmap(at)(phases), axis=0)


def held_displacement(process: Process, setup: Setup, bend: Float[Array, "2 2"]) -> Scalar:
    """The displacement that gives the nominal force or pressure on a part that bends [mm].

    Newton's method; the last two steps are differentiated, which makes first and second
    derivatives those of the solution. At the limit of the displacement they are the
    limit's. Without a nominal displacement it is that.

    Args:
        process: Tilt and the nominal displacement are read.
        setup: Tool, and what to hold are read.
        bend: Normal curvature of the part along (feed, left) [1/mm].

    Source: own derivation.
    """

    def held(displacement, given: tuple[Process, Tool, Float[Array, "2 2"]]):
        process, tool, bend = given
        pressed = dataclasses.replace(process, displacement=displacement)
        force, area = force_and_area(pressed, tool, bend, setup.side, setup.panels)
        some = force > 0
        force = jnp.where(some, force, 1.0)
        if setup.hold == "pressure":
            return jnp.where(some, force / jnp.where(some, area, 1.0), 0.0)
        return jnp.where(some, force**STRAIGHT, 0.0)

    def closer(displacement, given, aim):
        value, slope = jax.jvp(
            lambda e: held(e, given), (displacement,), (jnp.ones_like(displacement),)
        )
        some = slope > 0
        step = jnp.where(some, (aim - value) / jnp.where(some, slope, 1.0), 0.0)
        return jnp.clip(displacement + step, displacement / 3, 3 * displacement)

    nominal = process.displacement
    pressed = nominal > 0
    begin = jnp.where(pressed, nominal, 1.0)
    given = (process, setup.tool, bend)
    aim = held(begin, (process, setup.tool, jnp.zeros_like(bend)))
    fixed, fixed_aim = jax.lax.stop_gradient((given, aim))
    found = jax.lax.fori_loop(
        0,
        STEPS,
        lambda _, e: closer(e, fixed, fixed_aim),
        jax.lax.stop_gradient(begin),
    )
    for _ in range(2):
        found = closer(found, given, aim)
    most = most_displacement(process, setup.tool)
    return jnp.where(pressed, jnp.minimum(found, most), nominal)


def schedule(process: Process, setup: Setup) -> Schedule | None:
    """The displacement along the guide; None where nothing but the nominal one is asked.

    Args:
        process: The settings.
        setup: The job.
    """
    if not setup.holds:
        return None
    guide = setup.guide
    count = KNOTS * (guide.panels.size - 1)
    spacing = guide.length / count
    s = spacing * jnp.arange(count + 1, dtype=setup.size.dtype)
    e = in_batches(
        lambda s: held_displacement(process, setup, loop_bend(process, setup, s)),
        s,
        AT_ONCE,
    )
    # coefficients whose spline meets the values to fourth order in the spacing
    wide = jnp.pad(e, 2, mode="edge")
    return Schedule(spacing, wide[1:-1] - (wide[2:] - 2 * wide[1:-1] + wide[:-2]) / 6)
