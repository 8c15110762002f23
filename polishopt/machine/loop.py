r"""Loop: the feed in one loop of the trochoid, taken as if it were run again and again.

The averaged process looks at one loop per station of the guide, with only a handful of
phases. An exact sweep (`sweep`) is no use there: between samples so far apart the
derivatives of the axes change more than a linear interpolation can follow. So the limits
are taken sample by sample, and the share of an axis's acceleration that the bend of the
path needs, $|q''|\dot s^2$, is set aside before the rest may serve to speed up or slow
down. That is on the safe side by at most a factor of sqrt(2) in the acceleration, and it
is smooth in the settings wherever the limiting axis stays the same.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..parts import Scalar
from .sweep import Limits


def loop_rate(
    dq: Float[Array, "n m"],
    ddq: Float[Array, "n m"],
    length_rate: Float[Array, " n"],
    spacing: Scalar,
    programmed: Scalar,
    limits: Limits,
) -> Float[Array, " n"]:
    r"""Speed of the path parameter at each sample of a closed loop [parameter/s].

    $\dot s \le V_f/|X'|$, $\dot s \le V/|q'|$, $\dot s^2 \le A/|q''|$, and between
    neighbours $|\Delta(\dot s^2)| \le 2\,\Delta s\,(A - |q''|\dot s^2)/|q'|$. Where no
    axis moves, the programmed feed holds.

    Args:
        dq: Axis positions differentiated once by the path parameter.
        ddq: Axis positions differentiated twice.
        length_rate: Contact length per path parameter, $|X'|$ [mm/parameter].
        spacing: Step of the path parameter between samples, and from the last one back
            to the first.
        programmed: Programmed feed of the contact point, $V_f$ [mm/s].
        limits: Speeds $V$ and accelerations $A$ of the axes.

    Source: own derivation; limits in path length as in Quinsat et al. (2011), section 2.
    """
    slope, bend = jnp.abs(dq), jnp.abs(ddq)
    moves, bends = slope > 0, bend > 0
    safe_slope, safe_bend = jnp.where(moves, slope, 1.0), jnp.where(bends, bend, 1.0)
    by_speed = jnp.where(moves, (limits.speed[None, :] / safe_slope) ** 2, jnp.inf)
    by_bend = jnp.where(bends, limits.acceleration[None, :] / safe_bend, jnp.inf)
    cap = jnp.minimum(jnp.min(by_speed, axis=1), jnp.min(by_bend, axis=1))
    cap = jnp.minimum(cap, (programmed / length_rate) ** 2)

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
