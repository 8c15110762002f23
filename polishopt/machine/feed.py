r"""Feed: how fast the contact point can really go along the path.

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

import functools
from collections.abc import Callable
from typing import SupportsInt

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..parts import AXES, Machine, Scalar, as_array


class Limits(eqx.Module):
    """What each axis can do, for any number of axes."""

    speed: Float[Array, " m"] = eqx.field(converter=as_array)
    """Fastest speed of each axis [mm/s or rad/s]; infinite for no limit."""
    acceleration: Float[Array, " m"] = eqx.field(converter=as_array)
    """Largest acceleration of each axis [mm/s^2 or rad/s^2]; infinite for no limit."""
    names: tuple[str, ...] = eqx.field(static=True, default=AXES)
    """What people call the axes."""

    @classmethod
    def of(cls, machine: Machine) -> "Limits":
        """The limits of a machine's own axes."""
        return cls(speed=machine.max_speed, acceleration=machine.max_acceleration)


class TimeLaw(eqx.Module):
    """When the tool is where on the path."""

    feed: Float[Array, " n"]
    """Speed of the contact point at each sample [mm/s]."""
    rate: Float[Array, " n"]
    """Speed of the path parameter at each sample [parameter/s]."""
    time: Float[Array, " n"]
    """Time since the start of the path at each sample [s]."""
    limiting: Int[Array, " n"]
    """What keeps the feed from being higher at each sample, see `limiting_name`."""
    total: Scalar
    """Time for the whole path [s]: the last of `time`, but cheaper to differentiate."""


class Usage(eqx.Module):
    """The largest share of each limit that a time law uses; 1 is all of it."""

    programmed: Scalar
    """Of the programmed feed [-]."""
    speed: Float[Array, " m"]
    """Of each axis's speed [-]."""
    acceleration: Float[Array, " m"]
    """Of each axis's acceleration [-]."""


def limiting_name(code: SupportsInt, names: tuple[str, ...] = AXES) -> str:
    """What a code of `TimeLaw.limiting` stands for, in words."""
    number, m = int(code), len(names)
    if number == 0:
        return "programmed feed"
    if number > 2 * m:
        return "start or end"
    return f"{names[(number - 1) % m]} {'speed' if number <= m else 'acceleration'}"


def time_law(
    axes: Float[Array, "n m"],
    limits: Limits | Machine,
    arc: Float[Array, " n"],
    programmed: Scalar,
    sigma: Float[Array, " n"] | None = None,
    rest: tuple[bool, bool] = (True, True),
) -> TimeLaw:
    r"""The fastest motion along a sampled path that the axes allow.

    Derivatives along the path come from `derivatives`, so curvature is right to fourth
    order in the spacing of even samples. A sample that repeats the one before it (such as
    the tail that pads a path to a fixed length) costs no time. From a rest the feed needs
    at least one interval to build up, which therefore takes twice its time at that feed.
    Between two rests there must be a sample, or the time is infinite.

    Args:
        axes: Axis positions; angles must be continuous [mm or rad].
        limits: The limits of the axes, or the machine that has them.
        arc: Length of the contact path up to each sample, never decreasing [mm].
        programmed: Programmed feed of the contact point, finite [mm/s].
        sigma: Path parameter, never decreasing; the arc itself if not given.
        rest: Whether the path starts and ends at rest. A free end moves as fast as the
            limits and the path beside it allow.

    Returns:
        Feed, time and what limits them at each sample.

    Source: Own derivation.
    """
    parameter = arc if sigma is None else sigma
    kept, index = _distinct(parameter)
    columns = axes if sigma is None else jnp.column_stack([axes, arc])
    first, second = derivatives(columns[kept], parameter[kept], index[-1] + 1)
    first, second = first[index], second[index]
    m = axes.shape[1]
    rate = jnp.ones_like(arc) if sigma is None else jnp.abs(first[:, m])
    return time_law_from_derivatives(
        first[:, :m], second[:, :m], limits, rate, parameter, programmed, rest
    )


def time_law_from_derivatives(
    dq: Float[Array, "n m"],
    ddq: Float[Array, "n m"],
    limits: Limits | Machine,
    length_rate: Float[Array, " n"],
    sigma: Float[Array, " n"],
    programmed: Scalar,
    rest: tuple[bool, bool] = (True, True),
) -> TimeLaw:
    r"""The fastest motion along a path whose derivatives are known.

    Time adds up as $\Delta t = 2 \Delta\sigma / (\dot\sigma_i + \dot\sigma_{i+1})$, exact
    for constant acceleration.

    Args:
        dq: Axis positions differentiated once by the path parameter.
        ddq: Axis positions differentiated twice by the path parameter.
        limits: The limits of the axes, or the machine that has them.
        length_rate: Contact length per path parameter, $|dX/d\sigma|$ [mm/parameter].
        sigma: Path parameter, never decreasing.
        programmed: Programmed feed of the contact point, finite [mm/s].
        rest: Whether the path starts and ends at rest.

    Returns:
        Feed, time and what limits them at each sample.

    Source: S2 eq. (2), with the sign between its two speeds corrected.
    """
    limits = limits if isinstance(limits, Limits) else Limits.of(limits)
    spacing = jnp.diff(sigma)
    zero = jnp.zeros_like(programmed)
    start, end = (zero if still else None for still in rest)
    b = sweep(dq, ddq, length_rate, spacing, programmed, limits, start, end)
    rate = _safe_sqrt(b)
    twice_mean = rate[:-1] + rate[1:]
    moving = spacing > 0.0
    dt = jnp.where(moving, 2.0 * spacing / jnp.where(moving, twice_mean, 1.0), 0.0)
    code = _limiting(dq, ddq, length_rate, spacing, programmed, limits, b)
    imposed = jnp.zeros_like(moving, shape=b.shape)
    imposed = imposed.at[0].set(rest[0]).at[-1].set(rest[1])
    return TimeLaw(
        feed=length_rate * rate,
        rate=rate,
        time=jnp.pad(jnp.cumsum(dt), (1, 0)),
        limiting=jnp.where(imposed, 2 * limits.speed.size + 1, code),
        total=jnp.sum(dt),
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


def sweep_periodic(
    dq: Float[Array, "n m"],
    ddq: Float[Array, "n m"],
    length_rate: Float[Array, " n"],
    spacing: Float[Array, " n"],
    programmed: Scalar,
    limits: Limits,
) -> Float[Array, " n"]:
    r"""Largest admissible $b = \dot\sigma^2$ on a closed loop run again and again.

    As `sweep`, run twice around in each direction: the second lap no longer knows how the
    first began, wherever one point of the loop is limited on its own.

    Args:
        dq: $q'$ at each sample of the loop, the first one not repeated at the end.
        ddq: $q''$ at each sample.
        length_rate: Contact length per path parameter, $|dX/d\sigma|$ [mm/parameter].
        spacing: Steps of the path parameter, the last one back to the first sample.
        programmed: Programmed feed of the contact point, finite [mm/s].
        limits: The limits of the axes.

    Returns:
        $b$ at each sample [parameter^2/s^2].

    Source: Own derivation.
    """
    n = spacing.size
    dq, ddq, length_rate = (jnp.concatenate([x, x[:1]]) for x in (dq, ddq, length_rate))
    c, d = _strips(dq, ddq, spacing, limits.acceleration)
    cap = _caps(c, d, dq, ddq, length_rate, spacing, programmed, limits.speed)
    first = jnp.minimum(cap[0], cap[n])
    lap = jnp.concatenate([first[None], cap[1:n]])
    c, d, h = (jnp.concatenate([x, x], axis=-1) for x in (c, d, spacing))
    cap = jnp.concatenate([lap, lap, first[None]])
    stoppable = _follow(_backward_lines, c, d, h, cap, backward=True)[:n]
    cap = jnp.concatenate([stoppable, stoppable, stoppable[:1]])
    b = _follow(_forward_lines, c, d, h, cap, backward=False)
    return jnp.maximum(b[n : 2 * n], 0.0)


def derivatives(
    values: Float[Array, "n m"],
    sigma: Float[Array, " n"],
    count: Int[Array, ""] | None = None,
) -> tuple[Float[Array, "n m"], Float[Array, "n m"]]:
    r"""First and second derivatives of sampled values by the path parameter.

    Those of the polynomial through each sample and its two neighbours on either side, so
    the error is of order $h^4$ for even samples ($h^3$ in the second derivative for
    uneven ones and for the two samples at each end).

    Args:
        values: Values at the samples.
        sigma: Path parameter, strictly increasing.
        count: How many samples, from the first, are real; all if not given.

    Returns:
        First and second derivative at each sample.

    Source: Own derivation (Lagrange's polynomial).
    """
    n = sigma.size
    width = min(n, 5)
    real = n if count is None else count
    # past the last real sample, any increasing abscissa will do: it is never weighted
    mean = (sigma[-1] - sigma[0]) / (n - 1)
    beyond = jnp.maximum(jnp.arange(n) - (real - 1), 0)
    sigma = sigma + jnp.where(mean > 0.0, mean, 1.0) * beyond.astype(sigma.dtype)
    first = jnp.clip(jnp.arange(n) - width // 2, 0, jnp.maximum(real - width, 0))
    window = first[:, None] + jnp.arange(width)[None]
    node = sigma[window]  # (n, width)
    gap = sigma[:, None] - node
    change = values[window] - values[:, None, :]  # (n, width, m)
    d1, d2 = jnp.zeros_like(values), jnp.zeros_like(values)
    for k in range(width):
        others = [gap[:, l] for l in range(width) if l != k]
        below = 1.0
        for l in range(width):
            below = below * ((node[:, k] - node[:, l]) if l != k else 1.0)
        # the basis polynomial is (a product of the others) / below: its derivatives are
        # the sums of products that leave out one, or two, of the others
        products = [jnp.ones_like(below), jnp.zeros_like(below), jnp.zeros_like(below)]
        for y in others:
            products = [
                products[0] * y,
                products[1] * y + products[0],
                products[2] * y + products[1],
            ]
        d1 = d1 + (products[1] / below)[:, None] * change[:, k]
        d2 = d2 + (2.0 * products[2] / below)[:, None] * change[:, k]
    return d1, d2


def usage(
    axes: Float[Array, "n m"],
    law: TimeLaw,
    limits: Limits | Machine,
    arc: Float[Array, " n"],
    programmed: Scalar,
    sigma: Float[Array, " n"] | None = None,
    path: Callable[[Scalar], Float[Array, " m"]] | None = None,
    finer: int = 10,
) -> Usage:
    """How much of each limit a time law uses, looked at between the samples too.

    Between samples the squared rate is linear, as `sweep` takes it, and the path is
    `path` or, without one, the quintic through the positions and derivatives at the
    samples. For checks: it holds `finer` values of everything for each sample.

    Args:
        axes: Axis positions at the samples [mm or rad].
        law: The time law to check.
        limits: The limits of the axes, or the machine that has them.
        arc: Length of the contact path up to each sample [mm].
        programmed: Programmed feed of the contact point [mm/s].
        sigma: Path parameter; the arc itself if not given.
        path: Axis positions as a function of the path parameter, if known exactly.
        finer: Points to look at in each interval.

    Returns:
        The largest use of each limit [-].

    Source: Own derivation.
    """
    limits = limits if isinstance(limits, Limits) else Limits.of(limits)
    parameter = arc if sigma is None else sigma
    kept, index = _distinct(parameter)
    d1, d2 = (x[index] for x in derivatives(axes[kept], parameter[kept], index[-1] + 1))
    spacing = jnp.diff(parameter)
    moving = spacing > 0.0
    h = jnp.where(moving, spacing, 1.0)
    b = law.rate**2
    a = jnp.where(moving, jnp.diff(b) / (2.0 * h), 0.0)

    def within(t: Scalar) -> tuple[Float[Array, " m"], Float[Array, " m"]]:
        """Uses of speed and acceleration at the fraction t of every interval."""
        if path is not None:
            here = parameter[:-1] + t * spacing
            first, second = jax.vmap(functools.partial(_slope_and_bend, path))(here)
        else:
            pieces = (axes[:-1], axes[1:], d1[:-1], d1[1:], d2[:-1], d2[1:])
            first, second = _quintic(t, h[:, None], *pieces)
        b_here = (b[:-1] + t * (b[1:] - b[:-1]))[:, None]
        speed = jnp.abs(first) * jnp.sqrt(jnp.maximum(b_here, 0.0)) / limits.speed[None]
        force = jnp.abs(first * a[:, None] + second * b_here) / limits.acceleration[None]
        speed = jnp.where(moving[:, None], speed, 0.0)
        return speed.max(0), jnp.where(moving[:, None], force, 0.0).max(0)

    speed, force = jax.lax.map(within, jnp.linspace(0.0, 1.0, finer + 1))
    return Usage(
        programmed=jnp.max(law.feed) / programmed,
        speed=speed.max(0),
        acceleration=force.max(0),
    )


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
    cap = 1.0 / jnp.maximum(jnp.max((dq / speed[None]) ** 2, axis=1), asked)
    half_way = jnp.max(_middle(*_ends(dq, ddq, speed), h)[0] ** 2, axis=0)
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


def _pick(table, row: Int[Array, " n"]):
    """One entry from each column, by its row."""
    return jnp.take_along_axis(table, row[None], axis=0)[0]


def _limiting(dq, ddq, length_rate, spacing, programmed, limits, b):
    """Code of the limit that is used most at each sample."""
    moving = spacing > 0.0
    a = jnp.where(moving, jnp.diff(b) / (2.0 * jnp.where(moving, spacing, 1.0)), 0.0)
    rate = jnp.sqrt(b)[:, None]
    before, after = jnp.pad(a, (1, 0))[:, None], jnp.pad(a, (0, 1))[:, None]
    bend = ddq * b[:, None]
    force = jnp.maximum(jnp.abs(dq * before + bend), jnp.abs(dq * after + bend))
    shares = [
        length_rate[:, None] * rate / programmed,
        jnp.abs(dq) * rate / limits.speed[None],
        force / limits.acceleration[None],
    ]
    return jnp.argmax(jnp.concatenate(shares, axis=1), axis=1)


def _distinct(sigma: Float[Array, " n"]) -> tuple[Int[Array, " n"], Int[Array, " n"]]:
    """Samples that move on, in order (padded with the last), and each sample's place."""
    n = sigma.size
    mean = (sigma[-1] - sigma[0]) / (n - 1)
    on: Bool[Array, " n"] = jnp.pad(jnp.diff(sigma) > 1e-6 * mean, (1, 0))
    on = on.at[0].set(True)
    kept = jnp.nonzero(on, size=n, fill_value=n - 1)[0]
    return kept, jnp.cumsum(on) - 1


def _slope_and_bend(
    path: Callable[[Scalar], Float[Array, " m"]], s: Scalar
) -> tuple[Float[Array, " m"], Float[Array, " m"]]:
    """First and second derivative of a path by its parameter."""

    def slope(s: Scalar) -> Float[Array, " m"]:
        return jax.jvp(path, (s,), (jnp.ones_like(s),))[1]

    return jax.jvp(slope, (s,), (jnp.ones_like(s),))


def _quintic(t, h, q0, q1, d0, d1, s0, s1):
    """Derivatives of the quintic with given values, slopes and second derivatives."""
    u, w = d0 * h, d1 * h
    p, r = s0 * h**2, s1 * h**2
    rise = q1 - q0
    c3 = 10.0 * rise - 6.0 * u - 4.0 * w - 1.5 * p + 0.5 * r
    c4 = -15.0 * rise + 8.0 * u + 7.0 * w + 1.5 * p - r
    c5 = 6.0 * rise - 3.0 * (u + w) - 0.5 * (p - r)
    first = u + t * (p + t * (3.0 * c3 + t * (4.0 * c4 + t * 5.0 * c5)))
    second = p + t * (6.0 * c3 + t * (12.0 * c4 + t * 20.0 * c5))
    return first / h, second / h**2


def _safe_sqrt(x: Float[Array, " n"]) -> Float[Array, " n"]:
    """Square root, with zero gradient at zero (a rest stays a rest)."""
    still = x <= 0.0
    return jnp.where(still, 0.0, jnp.sqrt(jnp.where(still, 1.0, x)))
