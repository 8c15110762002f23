r"""Sweep: the fastest motion along a path whose derivatives are known at samples.

The programmed feed is a wish. What limits it are the axes: with a path parameter $\sigma$
(any length along the path) the chain rule gives $\dot q = q' \dot\sigma$ and
$\ddot q = q' \ddot\sigma + q'' \dot\sigma^2$, so with $b = \dot\sigma^2$ and
$a = \ddot\sigma = b'/2$ every speed limit is a bound on $b$ and every acceleration limit
a strip in the plane of $(a, b)$. The fastest motion then takes one sweep backward along
the path, for the largest $b$ from which the rest can still be run, and one forward.

One decision: $a$ is constant between two samples ($b$ is linear), and the limits are
enforced at both samples and half-way between them, so that they also hold in between: a
trochoid of 64 samples a loop stays within 0.1 % of them. Jerk and the control's block
rules are not looked at, and a sharp corner is as sharp as the samples around it make it.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..parts import AXES, Machine, Scalar, as_array


def _or_none(x):
    """Numbers as a float array, or None."""
    return None if x is None else as_array(x)


class Limits(eqx.Module):
    """What each axis can do, for any number of axes, and what the path may ask of them."""

    speed: Float[Array, " m"] = eqx.field(converter=as_array)
    """Fastest speed of each axis [mm/s or rad/s]; infinite for no limit."""
    acceleration: Float[Array, " m"] = eqx.field(converter=as_array)
    """Largest acceleration of each axis [mm/s^2 or rad/s^2]; infinite for no limit."""
    names: tuple[str, ...] = eqx.field(static=True, default=AXES)
    """What people call the axes."""
    jerk: Float[Array, " m"] | None = eqx.field(converter=_or_none, default=None)
    """Largest jerk of each axis [mm/s^3 or rad/s^3], for `jerk_law`; None for no limit."""
    path_acceleration: Scalar | None = eqx.field(converter=_or_none, default=None)
    """Largest change of the feed, for `jerk_law` [mm/s^2]; None for no limit."""
    path_jerk: Scalar | None = eqx.field(converter=_or_none, default=None)
    """Largest jerk along the path, for `jerk_law` [mm/s^3]; None for no limit."""

    @classmethod
    def of(cls, machine: Machine) -> "Limits":
        """The limits of a machine's own axes."""
        return cls(
            machine.max_speed, machine.max_acceleration, machine.names, machine.max_jerk
        )


def sweep(
    dq: Float[Array, "n m"],
    ddq: Float[Array, "n m"],
    length_rate: Float[Array, " n"],
    spacing: Float[Array, " n-1"],
    programmed: Scalar,
    limits: Limits,
    start_speed: Scalar | None = None,
    end_speed: Scalar | None = None,
) -> Float[Array, " n"]:
    r"""Largest admissible $b = \dot\sigma^2$ along a path [parameter^2/s^2].

    Standing still is always allowed, so what can still be stopped from sample $i$ is an
    interval $[0, K_i]$, and $K_i$ the least of a constant and of straight lines in
    $K_{i+1}$, one for each acceleration limit; forward, $b_{i+1}$ is the least of
    $K_{i+1}$ and of straight lines in $b_i$. The result is the fastest one for this
    discretisation and costs time in proportion to $n$. Gradients are those of the limits
    that are active; where two tie, one of them counts.

    Args:
        dq: $q'$, axis positions differentiated once by the path parameter.
        ddq: $q''$, the same twice.
        length_rate: Contact length per path parameter, $|dX/d\sigma|$ [mm/parameter].
        spacing: Steps of the path parameter, zero where a sample is repeated.
        programmed: Programmed feed of the contact point, finite [mm/s].
        limits: The limits of the axes.
        start_speed: Contact speed at the first sample, if it may not be higher [mm/s].
        end_speed: Contact speed at the last sample, if it may not be higher [mm/s].

    Returns:
        $b$ at each sample; zero at a rest.

    Source: Own derivation, after the reachability analysis of Pham & Pham (2018).
    """
    c, d = _strips(dq, ddq, spacing, limits.acceleration)
    cap = _caps(c, d, dq, ddq, length_rate, spacing, programmed, limits.speed)
    if end_speed is not None:
        end = jnp.minimum(cap[-1], (end_speed / length_rate[-1]) ** 2)
        cap = jnp.concatenate([cap[:-1], end[None]])
    stoppable = _follow(_backward_lines, c, d, spacing, cap, backward=True)
    if start_speed is not None:
        start = jnp.minimum(stoppable[0], (start_speed / length_rate[0]) ** 2)
        stoppable = jnp.concatenate([start[None], stoppable[1:]])
    b = _follow(_forward_lines, c, d, spacing, stoppable, backward=False)
    return jnp.maximum(b, 0.0)


def _strips(dq, ddq, h, acceleration):
    r"""Acceleration limits as strips $|c\,a + d\,b_i| \le 1$ with $c \ge 0$.

    One row for each axis and each place in the interval where it is enforced: the start,
    half-way and the end, where $b = b_i + 2 \Delta a$.
    """
    s1, e1, s2, e2 = _ends(dq, ddq, acceleration)
    m1, m2 = _middle(s1, e1, s2, e2, h)
    c = jnp.concatenate([s1, m1 + h[None] * m2, e1 + 2.0 * h[None] * e2])
    d = jnp.concatenate([s2, m2, e2])
    # many small loops read these; XLA would otherwise work them out again in each
    return jax.lax.optimization_barrier((jnp.abs(c), jnp.where(c < 0.0, -d, d)))


def _ends(dq, ddq, scale):
    """Both derivatives at the start and the end of every interval, one row an axis."""
    first, second = (dq / scale[None]).T, (ddq / scale[None]).T
    return first[:, :-1], first[:, 1:], second[:, :-1], second[:, 1:]


def _middle(s1, e1, s2, e2, h):
    """Both derivatives half-way, from the cubic through those at both ends."""
    h_safe = jnp.where(h > 0.0, h, 1.0)[None]
    first = 0.5 * (s1 + e1) + 0.125 * h[None] * (s2 - e2)
    return first, 1.5 * (e1 - s1) / h_safe - 0.25 * (s2 + e2)


def _caps(c, d, dq, ddq, length_rate, h, programmed, speed):
    """Largest b at each sample, whatever the samples around it allow.

    The programmed feed and the axis speeds bound it at the sample; where an axis is
    faster half-way than a chord between two samples allows, both are lowered in
    proportion. The accelerations bound it through the interval that follows.
    """
    floor = jnp.sqrt(jnp.finfo(h.dtype).tiny)
    asked = jnp.maximum((length_rate / programmed) ** 2, floor)
    cap = 1.0 / jnp.maximum(_largest((dq / speed[None]).T ** 2), asked)
    half_way = _largest(_middle(*_ends(dq, ddq, speed), h)[0] ** 2)
    wish = 0.5 * (1.0 / asked[:-1] + 1.0 / asked[1:])
    chord = 0.5 * (cap[:-1] + cap[1:])
    fit = jnp.minimum(jnp.minimum(wish, 1.0 / jnp.maximum(half_way, floor)) / chord, 1.0)
    fit = jnp.pad(fit, 1, constant_values=1.0)
    closing = jnp.where(h > 0.0, jnp.maximum(_crossing(c, d), _stopping(c, d, h)), 0.0)
    shut = closing > 0.0
    bound = jnp.where(shut, 1.0 / jnp.where(shut, closing, 1.0), jnp.inf)
    bound = jnp.pad(bound, (0, 1), constant_values=jnp.inf)
    return jnp.minimum(cap * jnp.minimum(fit[:-1], fit[1:]), bound)


def _crossing(c, d):
    r"""One over the largest b at which all strips of an interval still share an a.

    Two strips stop sharing one at $1/b = |c_k d_j - c_j d_k| / (c_j + c_k)$, and the
    strips as a whole where the first two do. That pair is found first and differentiated
    alone.
    """

    def closing(c_j, d_j, c_k, d_k):
        width = c_j + c_k
        enters = width > 0.0
        apart = jnp.abs(c_k * d_j - c_j * d_k)
        return jnp.where(enters, apart / jnp.where(enters, width, 1.0), 0.0)

    m = c.shape[0]
    twice = jax.lax.stop_gradient((jnp.concatenate([c, c]), jnp.concatenate([d, d])))
    c_twice, d_twice = jax.lax.optimization_barrier(twice)
    worst, shift = jnp.zeros_like(c), jnp.zeros(c.shape, int)
    for r in range(1, m // 2 + 1):  # every pair (j, j + r) comes up
        other = slice(r, r + m)
        found = closing(c_twice[:m], d_twice[:m], c_twice[other], d_twice[other])
        shift = jnp.where(found > worst, r, shift)
        worst = jnp.maximum(worst, found)
    worst, shift = jax.lax.optimization_barrier((worst, shift))
    j = jnp.argmax(worst, axis=0)
    k = (j + _pick(shift, j)) % m
    return closing(_pick(c, j), _pick(d, j), _pick(c, k), _pick(d, k))


def _stopping(c, d, h):
    """One over the largest b from which every strip still lets the tool stop."""
    fixed_c, fixed_d, fixed_h = jax.lax.stop_gradient((c, d, h))
    j = jnp.argmin(fixed_c - 2.0 * fixed_h[None] * fixed_d, axis=0)
    moving = h > 0.0
    return jnp.where(
        moving, _pick(d, j) - _pick(c, j) / jnp.where(moving, 2.0 * h, 1.0), 0.0
    )


def _backward_lines(c, d, h):
    """Slope and offset of the lines K_i <= slope K_{i+1} + offset.

    They are where a >= -(1 + d b)/c meets b + 2 h a <= K_{i+1}.
    """
    still, eps = h <= 0.0, 4.0 * jnp.finfo(h.dtype).eps
    turn = c - 2.0 * h * d
    meet = (turn > eps * (c + 2.0 * h * jnp.abs(d))) & ~still
    safe = jnp.where(meet, turn, 1.0)
    slope = jnp.where(meet, c / safe, jnp.where(still, 1.0, 0.0))
    return slope, jnp.where(meet, 2.0 * h / safe, jnp.where(still, 0.0, jnp.inf))


def _forward_lines(c, d, h):
    """Slope and offset of the lines b_{i+1} <= slope b_i + offset.

    They are a <= (1 - d b)/c. A strip that a hardly enters says nothing about a, and a
    slack of some rounding errors keeps it from closing altogether.
    """
    still, eps = h <= 0.0, 4.0 * jnp.finfo(h.dtype).eps
    enters = (c > eps * h * jnp.abs(d)) & ~still
    safe = jnp.where(enters, c, 1.0)
    slope = jnp.where(enters, 1.0 - 2.0 * h * d / safe, jnp.where(still, 1.0, 0.0))
    offset = 2.0 * h * (1.0 + 16.0 * eps) / safe
    return slope, jnp.where(enters, offset, jnp.where(still, 0.0, jnp.inf))


def _follow(lines, c, d, h, cap, backward: bool):
    """The x with x_0 = cap_0 and x_{i+1} = min(cap_{i+1}, every line at x_i).

    (Numbered the other way round if `backward`.) What is the least is found first,
    without derivatives; then the recursion is linear and is run again through the active
    lines alone, so that a gradient costs no more than they do.
    """
    before, into, first = slice(None, -1), slice(1, None), 0
    if backward:
        before, into, first = into, before, -1

    def run(step, rows, start):
        _, x = jax.lax.scan(step, start, rows, reverse=backward)
        parts = [x, start[None]] if backward else [start[None], x]
        return jnp.concatenate(parts)

    def lowest(x, row):
        slope, offset, cap = row
        x = jnp.minimum(cap, jnp.min(slope * x + offset))
        return x, x

    def linear(x, row):
        gain, push = row
        x = gain * x + push
        return x, x

    fixed_c, fixed_d, fixed_h, fixed_cap = jax.lax.stop_gradient((c, d, h, cap))
    slope, offset = jax.lax.optimization_barrier(
        lines(fixed_c, fixed_d, jnp.broadcast_to(fixed_h[None], c.shape))
    )
    x = run(lowest, (slope.T, offset.T, fixed_cap[into]), fixed_cap[first])
    line = slope * x[before][None] + offset
    j = jnp.argmin(line, axis=0)
    free = _pick(line, j) < fixed_cap[into]
    slope, offset = lines(_pick(c, j), _pick(d, j), h)
    gain, push = jnp.where(free, slope, 0.0), jnp.where(free, offset, cap[into])
    return run(linear, (gain, push), cap[first])


def _largest(table):
    """The largest entry of each column, found first and differentiated alone.

    The derivative of `jnp.max` looks for the entry that equals it. Compiled once more,
    with other roundings, there may be none, and then it is not a number.
    """
    return _pick(table, jnp.argmax(jax.lax.stop_gradient(table), axis=0))


def _pick(table, row: Int[Array, " n"]):
    """One entry from each column, by its row."""
    return jnp.take_along_axis(table, row[None], axis=0)[0]
