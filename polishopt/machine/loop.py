r"""Loop: the feed in one loop of the trochoid, taken as if it were run again and again.

The averaged process looks at one loop per station of the guide, with only a handful of
phases. An exact sweep (`sweep`) is no use there: between samples so far apart the
derivatives of the axes change more than a linear interpolation can follow. So the limits
are taken sample by sample, and the share of an axis's acceleration that the bend of the
path needs, $|q''|\dot s^2$, is set aside before the rest may serve to speed up or slow
down. That is on the safe side by at most a factor of sqrt(2) in the acceleration, and it
is smooth in the settings wherever the limiting axis stays the same. Of jerk, only what an
even feed needs is looked at, $|q'''|\dot s^3$, with differences around the loop for
$q'''$: where jerk limits most of a path, its time is within some 3 % of that with every
loop resolved.

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
    once = tuple(pace * rate for rate in first[1])
    twice = tuple(pace**2 * rate for rate in second[1])
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
    $\dot s^3 \le J/|q'''|$, and between neighbours
    $|\Delta(\dot s^2)| \le 2\,\Delta s\,(A - |q''|\dot s^2)/|q'|$. Where no axis moves, the
    programmed feed holds.

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
    slope, bend = jnp.abs(dq), jnp.abs(ddq)
    moves, bends = slope > 0, bend > 0
    safe_slope, safe_bend = jnp.where(moves, slope, 1.0), jnp.where(bends, bend, 1.0)
    by_speed = jnp.where(moves, (limits.speed[None, :] / safe_slope) ** 2, jnp.inf)
    by_bend = jnp.where(bends, limits.acceleration[None, :] / safe_bend, jnp.inf)
    cap = jnp.minimum(jnp.min(by_speed, axis=1), jnp.min(by_bend, axis=1))
    cap = jnp.minimum(cap, (programmed / length_rate) ** 2)
    if limits.jerk is not None:
        twist = jnp.abs(_around(ddq)) / spacing
        twists = (twist > 0) & jnp.isfinite(limits.jerk)[None, :]
        by_twist = jnp.cbrt(limits.jerk[None, :] / jnp.where(twists, twist, 1.0)) ** 2
        cap = jnp.minimum(cap, jnp.min(jnp.where(twists, by_twist, jnp.inf), axis=1))

    # gain of s_dot^2 over one step: start - fall * s_dot^2, for the tightest axis
    start = jnp.where(moves, 2 * spacing * limits.acceleration[None, :] / safe_slope, 1.0)
    start = jnp.where(moves, start, jnp.inf)
    fall = jnp.where(moves, 2 * spacing * bend / safe_slope, 0.0)

    def step(square, sample):
        start, fall, cap = sample
        gain = jnp.maximum(jnp.min(start - fall * square), 0.0)
        square = jnp.minimum(cap, square + gain)
        return square, square

    def lap(cap, reverse):
        # what may be gained on leaving a sample bounds the next one; two laps, because
        # the first does not know how fast the loop comes round
        shift = -1 if reverse else 1
        samples = (jnp.roll(start, shift, 0), jnp.roll(fall, shift, 0), cap)
        twice = jax.tree.map(lambda x: jnp.concatenate([x, x]), samples)
        _, squares = jax.lax.scan(step, jnp.min(cap), twice, reverse=reverse)
        return squares[: cap.size] if reverse else squares[cap.size :]

    return jnp.sqrt(lap(lap(cap, False), True))


def _around(values: Float[Array, "n m"]) -> Float[Array, "n m"]:
    """Change per sample around the loop, to fourth order."""

    def across(k):
        return jnp.roll(values, -k, axis=0) - jnp.roll(values, k, axis=0)

    return (8 * across(1) - across(2)) / 12
