r"""Loop: the feed in one loop of the trochoid, taken as if it were run again and again.

The averaged process looks at one loop per station of the guide, with only a handful of
phases. An exact sweep (`sweep`) is no use there: between samples so far apart the
derivatives of the axes change more than a linear interpolation can follow. So the limits
are taken sample by sample, and the share of an axis's acceleration that the bend of the
path needs, $|q''|\dot s^2$, is set aside before the rest may serve to speed up or slow
down. That is on the safe side by at most a factor of sqrt(2) in the acceleration. Of jerk,
only what an even feed needs is looked at, $|q'''|\dot s^3$, with differences around the
loop for $q'''$: where jerk limits most of a path, its time is within some 3 % of that with
every loop resolved.

Which limit binds changes from sample to sample, and with the settings. A hard minimum would
give the time a kink at each change, and a search that follows a valley of the time would
crawl from kink to kink. So the limits are joined smoothly (`largest`).

Near the pole the rotary axis next to the part turns at a rate that grows as one over the
distance $\sigma$ from it. Averaged over phases and loops that is harmless, because the area
within $\sigma$ of the pole falls as its square; but a sample that happens to fall onto the
pole would stand for its whole cell, and the time would jump with every setting that shifts
the samples. So each sample's pole is blurred over its cell, by a kernel that leaves the
integral as it was.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..parts import Machine, Scalar
from .kinematics import beside_pole, motion
from .sweep import Limits


# Width of the blurred pole, in cells of the sampling: wide enough that the time no longer
# follows the samples, narrow beside the region where the pole slows the machine down.
BLUR = 0.4
# The smooth maximum is the norm of order 16, two to this power. With order 8 the time would
# be up to 3 % longer where axes limit most of a path; higher orders turn more sharply.
DOUBLINGS = 4
# How bluntly an axis turns round or stops bending, as a share of what binds there: over the
# same range as limits take turns.
BLUNT = 1 / 16

Angles = tuple[Scalar, Scalar]


def pole_pace(
    axis: Float[Array, "3"], cell: Float[Array, "c 3"], machine: Machine
) -> Scalar:
    r"""Rate of the rotary axes near the pole, averaged over a cell, over that at its node.

    A rate $g(\alpha)/\sigma$ at the distance $\sigma$ and in the direction $\alpha$ from
    the pole becomes $g(\alpha)\,\sigma(\sigma^2 + 3\delta^2)/(\sigma^2 + \delta^2)^2$,
    which is smooth, vanishes at the pole, and has the same integral over the plane for
    every direction, if $\delta$ stays the same. The width $\delta$ is the cell's extent
    towards the pole; within the cell, its whole extent.

    Args:
        axis: Unit tool axis at the node [-].
        cell: How far the axis turns from the node to the next one, along each of the
            directions in which nodes follow each other [-].
        machine: The machine.

    Source: own derivation; kernels of this kind are the blobs of vortex methods.
    """
    across = beside_pole(axis, machine)
    square = jnp.sum(across**2)
    edges = jax.vmap(lambda edge: beside_pole(edge, machine))(cell)
    size = jnp.sum(edges**2)
    whole = square + size
    some = whole > 0
    near, whole = size / jnp.where(some, whole, 1.0), jnp.where(some, whole, 1.0)
    towards = jnp.sum((edges @ across) ** 2) / whole
    blur = BLUR**2 * (towards + near**2 * size)
    wide = jnp.where(some, square + blur, 1.0)
    return jnp.where(some, square * (square + 3 * blur) / wide**2, 1.0)


def axis_slopes(
    at: tuple[Float[Array, "3"], Angles],
    first: tuple[Float[Array, "3"], Angles],
    second: tuple[Float[Array, "3"], Angles],
    pace: Scalar,
    machine: Machine,
) -> tuple[Float[Array, "5"], Float[Array, "5"]]:
    """First and second derivatives of all axes by the path parameter.

    Args:
        at: Tool tip on the part [mm] and angles of the rotary axes, next to the part
            first [rad].
        first: Their first derivatives by the path parameter.
        second: Their second derivatives.
        pace: By how much faster the rotary axes turn than that.
        machine: The machine.
    """
    once = pace * first[1][0], pace * first[1][1]
    twice = pace**2 * second[1][0], pace**2 * second[1][1]
    tips = [at[0], first[0], second[0]]
    _, dq, ddq = motion(tips, [at[1], once, twice], machine)
    return dq, ddq


def loop_rate(
    dq: Float[Array, "n m"],
    ddq: Float[Array, "n m"],
    length_rate: Float[Array, " n"],
    spacing: Scalar,
    programmed: Scalar,
    limits: Limits,
) -> Float[Array, " n"]:
    r"""Speed of the path parameter at each sample of a closed loop [parameter/s].

    $\dot s \le V_f/|X'|$, $\dot s \le V/|q'|$, $\dot s^2 \le A/|q''|$,
    $\dot s^3 \le J/|q'''|$, and on the way to the faster one of two neighbours
    $|q'|\,\Delta(\dot s^2)/2\Delta s + |q''|\dot s^2 \le A$, with the axes as they move at
    that one. All are lower bounds of $1/\dot s^2$; the last one, with
    $w = |q'|/(2A\Delta s)$, is $(w + |q''|/A)/(1 + w\,\dot s_0^2)$, $\dot s_0$ being the
    neighbour's. Of them the smooth maximum is taken, not the largest: a few percent slower
    where two bind together, nowhere faster, since no bound falls as a neighbour slows down.

    An axis that rests, or has no limit, bounds nothing: its terms are zero, with a gradient
    of zero. Where no axis moves, the programmed feed holds.

    Args:
        dq: Axis positions differentiated once by the path parameter.
        ddq: Axis positions differentiated twice.
        length_rate: Contact length per path parameter, $|X'|$ [mm/parameter].
        spacing: Step of the path parameter between samples, and from the last one back
            to the first.
        programmed: Programmed feed of the contact point, $V_f$ [mm/s].
        limits: Speeds $V$, accelerations $A$ and jerks $J$ of the axes.

    Source: own derivation; limits in path length as in Quinsat et al. (2011), section 2.
    """
    most = limits.acceleration[None]
    bend, inertia = ddq / most, dq / (2 * spacing) / most
    bounds = [((length_rate / programmed) ** 2)[:, None], (dq / limits.speed[None]) ** 2]
    bounds.append(bend)
    if limits.jerk is not None:
        twist = jnp.abs(_around(ddq)) / spacing / limits.jerk[None]
        twists = twist > 0
        cube = jnp.cbrt(jnp.where(twists, twist, 1.0))
        bounds.append(jnp.where(twists, cube**2, 0.0))
    bounds = jnp.concatenate(bounds, axis=1)
    alone = largest(bounds)
    # sizes, without the corner that an absolute value has; never zero
    least = (BLUNT * alone[:, None]) ** 2 + jnp.finfo(alone.dtype).tiny
    bend, inertia = jnp.sqrt(bend**2 + least), jnp.sqrt(inertia**2 + least)

    def step(before, sample):
        inertia, bend, alone = sample
        before = before[:, None]
        reached = (inertia + bend) * before / (before + inertia)
        return largest(jnp.concatenate([alone[:, None], reached], axis=1)), reached

    def laps(x):
        # both ways round at once, and two laps, because the first does not know how fast
        # the loop comes round
        ways = jnp.stack([x, x[::-1]], axis=1)
        return jnp.concatenate([ways, ways])

    slowest = jnp.broadcast_to(jnp.max(alone), (2,))
    _, reached = jax.lax.scan(step, slowest, jax.tree.map(laps, (inertia, bend, alone)))
    onward, back = reached[alone.size :, 0], reached[: alone.size - 1 : -1, 1]
    return 1 / jnp.sqrt(largest(jnp.concatenate([alone[:, None], onward, back], axis=1)))


@jax.custom_jvp
def largest(values: Float[Array, "*n m"]) -> Float[Array, "*n"]:
    r"""Smooth maximum of the sizes of values along the last axis, $(\sum|v|^p)^{1/p}$.

    At least the largest one, and at most $m^{1/p}$ times that. Between two values it turns
    over a range of some $1/p$ of their size. Where all are zero it is zero, with a gradient
    of zero.

    Args:
        values: What to take the maximum of.

    Source: the p-norm.
    """
    most, _, norm = _over_most(values)
    return most * norm


@largest.defjvp
def _largest_jvp(primals, tangents):
    # each value counts by its share of the norm, to the power p - 1: written out, since
    # powers and roots that are differentiated one by one make several times the code
    (values,), (changes,) = primals, tangents
    most, parts, norm = _over_most(values)
    share = parts / norm[..., None]
    weight, power = share, share
    for _ in range(DOUBLINGS - 1):
        power = power * power
        weight = weight * power
    return most * norm, jnp.sum(weight * changes, axis=-1)


def _over_most(
    values: Float[Array, "*n m"],
) -> tuple[Float[Array, "*n"], Float[Array, "*n m"], Float[Array, "*n"]]:
    """Size of the largest value, all values over it, and the norm of these."""
    least = jnp.finfo(values.dtype).tiny  # nothing beside any other number, but no zero
    most = jax.lax.stop_gradient(jnp.max(jnp.abs(values), axis=-1)) + least
    # over the largest one, which cancels, powers neither overflow nor all vanish
    parts = values / most[..., None]
    total = parts
    for _ in range(DOUBLINGS):
        total = total * total
    total = jnp.sum(total, axis=-1) + least
    for _ in range(DOUBLINGS):
        total = jnp.sqrt(total)
    return most, parts, total


def _around(values: Float[Array, "n m"]) -> Float[Array, "n m"]:
    """Change per sample around the loop, to fourth order."""

    def across(k):
        return jnp.roll(values, -k, axis=0) - jnp.roll(values, k, axis=0)

    return (8 * across(1) - across(2)) / 12
