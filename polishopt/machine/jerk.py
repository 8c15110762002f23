r"""Jerk: the fastest motion along a path whose axes honour speed, acceleration and jerk.

With $b = \dot\sigma^2$ and $a = \ddot\sigma = b'/2$, a third turn of the chain rule gives
$\dddot q = \sqrt b\,(q''' b + 3 q'' a + q' b''/2)$, and the same for the length of the
path, whose derivatives are feed, path acceleration and path jerk. `shape` says what b may
look like, `interior` finds the fastest one, and here it becomes feed, time, and the limit
that holds at each sample. Limits are enforced at the samples; b is known in between, so
that `usage` can look there too.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..parts import Machine, Scalar
from .feed import TimeLaw, derivatives, distinct, increasing
from .interior import Rows, polish, search
from .shape import RISE, Shape, apply, shape, stencil
from .sweep import Limits


# What may be wrong with a law, see `check`.
SOUND, NOT_FINITE, NO_SPEED, NO_FEED, NOT_FOUND = range(5)


class Fault(eqx.Module):
    """What is wrong with a law, and where."""

    kind: Int[Array, ""]
    """0 if nothing is."""
    sample: Int[Array, ""]
    """First sample that it concerns."""
    axis: Int[Array, ""]
    """Axis that it concerns most."""
    limit: Int[Array, ""]
    """0, 1, 2 for its speed, acceleration or jerk."""


class JerkLaw(TimeLaw):
    """When the tool is where on the path, with bounded jerk."""

    acceleration: Float[Array, " n"]
    """Change of the feed at each sample [mm/s^2]."""
    rate_change: Float[Array, " n"]
    """Second derivative of the path parameter by time at each sample [parameter/s^2]."""
    y: Float[Array, " n"]
    """Squared rate over the reference shape at each sample, see `shape`."""
    y_slope: Float[Array, " n"]
    """Its derivative by the path parameter."""
    y_bend: Float[Array, " n"]
    """Its second derivative by the path parameter, in the interval that follows."""
    steps: Int[Array, ""]
    """Newton steps it took."""
    fault: Fault
    """Why these numbers must not be used, if so: see `check`."""
    rest: tuple[bool, bool] = eqx.field(static=True)
    """Whether the path starts and ends at rest."""


def jerk_law(
    axes: Float[Array, "n m"],
    limits: Limits | Machine,
    arc: Float[Array, " n"],
    programmed: Scalar,
    sigma: Float[Array, " n"] | None = None,
    rest: tuple[bool, bool] = (True, True),
) -> JerkLaw:
    r"""The fastest motion along a sampled path, to some 0.1 %, that jerk allows too.

    As `time_law`, with the jerk limits of the axes and, if given, limits on acceleration
    and jerk along the path. The third derivatives that jerk needs come from `derivatives`:
    give the path smoothly (no corners), by 50 samples or more for each turn of a circle.

    Args:
        axes: Axis positions; angles must be continuous [mm or rad].
        limits: The limits of the axes, or the machine that has them.
        arc: Length of the contact path up to each sample, never decreasing [mm].
        programmed: Programmed feed of the contact point, finite [mm/s].
        sigma: Path parameter, never decreasing; the arc itself if not given.
        rest: Whether the path starts and ends at rest (and there without acceleration). A
            free end moves as fast as the limits and the path beside it allow.

    Returns:
        Feed, time and what limits them at each sample. Derivatives are those of the
        smoothed optimum of `interior`, by limits, programmed feed and path.

    Raises:
        ValueError: Fewer than six samples. What depends on numbers is in `fault`.

    Source: Own derivation.
    """
    parameter = arc if sigma is None else sigma
    kept, index = distinct(parameter)
    real = index[-1] + 1
    columns = jnp.column_stack([axes, arc])[kept]
    m = axes.shape[1]
    parts = derivatives(columns, parameter[kept], real, order=3)
    if sigma is None:
        one = jnp.ones_like(arc)
        parts = [
            p.at[:, m].set(k * one) for p, k in zip(parts, (1.0, 0.0, 0.0), strict=True)
        ]
    return law_of([p.T for p in parts], limits, parameter[kept], index, programmed, rest)


def jerk_law_from_derivatives(
    dq: Float[Array, "n m"],
    ddq: Float[Array, "n m"],
    dddq: Float[Array, "n m"],
    limits: Limits | Machine,
    length: Float[Array, "n 3"],
    sigma: Float[Array, " n"],
    programmed: Scalar,
    rest: tuple[bool, bool] = (True, True),
) -> JerkLaw:
    """The same along a path whose derivatives are known.

    Args:
        dq: Axis positions differentiated once by the path parameter.
        ddq: Axis positions differentiated twice.
        dddq: Axis positions differentiated three times.
        limits: The limits of the axes, or the machine that has them.
        length: Contact length differentiated once, twice and three times.
        sigma: Path parameter, never decreasing.
        programmed: Programmed feed of the contact point, finite [mm/s].
        rest: Whether the path starts and ends at rest.

    Returns:
        As `jerk_law`.

    Source: Own derivation.
    """
    kept, index = distinct(sigma)
    parts = [
        jnp.column_stack([x, length[:, k]])[kept].T for k, x in enumerate((dq, ddq, dddq))
    ]
    return law_of(parts, limits, sigma[kept], index, programmed, rest)


def law_of(
    parts, limits, sigma, index, programmed, rest, halves=None, found_by=None
) -> JerkLaw:
    """From the derivatives of axes and length (the last row) at distinct samples.

    Args:
        parts: First, second and third derivatives, `[axis, sample]`.
        limits: The limits of the axes, or the machine that has them.
        sigma: Path parameter of the samples.
        index: Which of them each sample of the answer is.
        programmed: Programmed feed [mm/s].
        rest: Whether the path starts and ends at rest.
        halves: First and second derivatives half-way, if known exactly.
        found_by: How the rows of limits are met, given (rows, stencil, start); returns the
            rows that were met in the end, and what was found. `search` if not given.
    """
    limits = limits if isinstance(limits, Limits) else Limits.of(limits)
    if sigma.size < 6:
        raise ValueError(
            f"a path of {sigma.size} samples has no third derivative; at least 6 are needed"
        )
    last = index[-1]
    real = jnp.arange(sigma.size) <= last
    sigma = increasing(sigma, last + 1)
    # what stands past the end is as the end; differences there would be wild guesses
    parts = [jnp.where(real[None], p, p[:, last][:, None]) for p in parts]
    fault = _fault(parts, limits, programmed, real)
    ends = sigma[0], sigma[last], rise(sigma, last), rest
    rho = _shaped(shape(sigma, *ends), real)
    mid = _shaped(shape(0.5 * (sigma[1:] + sigma[:-1]), *ends), real[1:])
    table = stencil(sigma, last, rest)
    cap = _cap(parts[0], limits, programmed)
    halves = _halves(parts, jnp.diff(sigma)) if halves is None else halves
    rows = _rows(parts, limits, programmed, cap, rho, mid, sigma, real, rest, halves)
    start = jax.lax.stop_gradient(_start(parts, limits, cap, rho, sigma, last, rest))
    if found_by is None:
        found = search(*jax.lax.stop_gradient((rows, table)), start)
    else:
        rows, found = found_by(rows, table, start)
    found = jax.lax.stop_gradient(found)
    y, y1, y2 = apply(table, polish(rows, table, found))
    if rest[1]:  # the last interval is level
        y, y1, y2 = (x.at[last].set(k * x[last - 1]) for x, k in ((y, 1), (y1, 0), (y2, 0)))
    rate = rho.root * jnp.sqrt(y)
    change = 0.5 * (rho.slope * y + rho.value * y1)
    dt = jnp.where(real[1:], _duration(jnp.diff(sigma), rate, change), 0.0)
    b = rho.value * y
    length = [p[-1] for p in parts]
    code, axis, limit = _limiting(rows, parts, limits, cap, b, y, y1, y2)
    still = jnp.zeros_like(real).at[0].set(rest[0]).at[last].set(rest[1])
    code = jnp.where(still, 3 * limits.speed.size + 3, code)
    worst = jnp.argmax(jnp.where(jnp.isfinite(found.excess), found.excess, jnp.inf))
    lost = ~found.converged & (fault.kind == SOUND)
    fault = Fault(
        kind=jnp.where(lost, NOT_FOUND, fault.kind),
        sample=jnp.where(lost, worst, fault.sample),
        axis=jnp.where(lost, axis[worst], fault.axis),
        limit=jnp.where(lost, limit[worst], fault.limit),
    )
    place = jnp.searchsorted(index, fault.sample)  # the first of repeated samples
    return JerkLaw(
        feed=(length[0] * rate)[index],
        rate=rate[index],
        time=jnp.pad(jnp.cumsum(dt), (1, 0))[index],
        limiting=code[index],
        total=jnp.sum(dt),
        acceleration=(length[1] * b + length[0] * change)[index],
        rate_change=change[index],
        y=y[index],
        y_slope=y1[index],
        y_bend=y2[index],
        steps=found.steps,
        fault=eqx.tree_at(lambda f: f.sample, fault, place),
        rest=rest,
    )


def rise(sigma, last):
    """Length of the reference shape's rise."""
    return RISE * (sigma[last] - sigma[0]) / jnp.maximum(last, 1).astype(sigma.dtype)


def _shaped(rho: Shape, real) -> Shape:
    """The reference shape, level where there is no path."""
    level = Shape(*(jnp.full_like(rho.value, x) for x in (1.0, 0.0, 1.0, 0.0)))
    return jax.tree.map(lambda x, y: jnp.where(real, x, y), rho, level)


def _duration(h, rate, change):
    r"""Time between samples, exact for constant jerk.

    Then $h = \frac{\tau}{2}(v_0 + v_1) - \frac{\tau^2}{12}(a_1 - a_0)$, a quadratic in
    $\tau$. From a rest ($a_1 = 2 v_1^2 / 3 h$) it gives $3 h / v_1$.
    """
    mean, rise = 0.5 * (rate[1:] + rate[:-1]), jnp.diff(change)
    safe = jnp.where(mean > 0.0, mean, 1.0)
    # a quarter of the term under the root at a rest: only a path hardly sampled is below
    inside = jnp.maximum(1.0 - rise * h / (3.0 * safe**2), 0.025)
    return jnp.where(mean > 0.0, 2.0 * h / (safe * (1.0 + jnp.sqrt(inside))), jnp.inf)


def _share(values, limit):
    """Values over a limit; an axis that does not move has no need of one."""
    limit = jnp.where(limit > 0.0, limit, 1.0)[:, None]
    limit = limit.reshape((1,) * (values.ndim - 2) + limit.shape)
    return jnp.where(values == 0.0, 0.0, values / limit)


def _halves(parts, h):
    """First and second derivatives half-way, from the cubic through those at both ends."""
    (a, b), (a1, b1) = ((x[:, :-1], x[:, 1:]) for x in parts[:2])
    h = h[None]
    return 0.5 * (a + b) + 0.125 * h * (a1 - b1), 1.5 * (b - a) / h - 0.25 * (a1 + b1)


def _cap(first, limits: Limits, programmed, other=None):
    """One over the largest b that the speeds allow."""
    asked = (first[-1] / programmed) ** 2
    slow = jnp.maximum(asked, jnp.max(_share(first[:-1], limits.speed) ** 2, axis=0))
    # where nothing moves, the parameter may run fast, but not at any rate; beside the pole
    # C asks for some 1000 times less than elsewhere
    return jnp.maximum(slow, 1e-12 * jnp.max(slow if other is None else other))


def _limited(limits: Limits, path, each):
    """Which rows a limit has: those of the axes, and the length's if the path has one."""
    m = limits.speed.size
    each = jnp.full(m, jnp.inf, limits.speed.dtype) if each is None else each
    if path is None:
        return slice(0, m), each
    return slice(0, m + 1), jnp.append(each, path)


def _rows(parts, limits, programmed, cap, rho, mid, sigma, real, rest, between) -> Rows:
    """The limits at the samples as rows of y, y' and y''."""
    h = jnp.diff(sigma)
    weight = jnp.where(real[1:], _duration(h, rho.root, 0.5 * rho.slope), 0.0)
    weight = 0.5 * (jnp.pad(weight, (1, 0)) + jnp.pad(weight, (0, 1)))
    # a sample that is none is weighed and limited as if it stood alone, and so is a rest
    last = jnp.sum(real) - 1
    alone = ~real | ((jnp.arange(sigma.size) == last) & rest[1])
    weight = weight.at[last - 1].add(jnp.where(alone[last], weight[last], 0.0))
    weight = jnp.where(alone, jnp.mean(h), weight)
    v, s, root, bend = rho.value[None], rho.slope[None], rho.root[None], rho.root_bend[None]
    use, hold = _limited(limits, limits.path_acceleration, limits.acceleration)
    d1, d2 = parts[0][use], parts[1][use]
    force = jnp.stack([d2 * v + 0.5 * d1 * s, 0.5 * d1 * v])
    d1, d2 = (p[use] for p in between)
    value, slope = mid.value[None], mid.slope[None]
    half = jnp.stack([d2 * value + 0.5 * d1 * slope, 0.5 * d1 * value])
    half = jnp.pad(half, ((0, 0), (0, 0), (0, 1)))
    use, hard = _limited(limits, limits.path_jerk, limits.jerk)
    d1, d2, d3 = (p[use] for p in parts)
    jerk = jnp.stack(
        [
            root * (d3 * v + 1.5 * d2 * s) + 0.5 * d1 * bend,
            root * (1.5 * d2 * v + d1 * s),
            0.5 * root * d1 * v,
        ]
    )
    # in the first intervals after a rest, acceleration rises as the third root of the way,
    # which the two places where it is enforced see a few hundredths of
    ways = [sigma - sigma[0]] * rest[0] + [sigma[last] - sigma] * rest[1]
    tight = jnp.ones_like(sigma) + sum(0.06 / (1.0 + (x / jnp.mean(h)) ** 2) for x in ways)
    force, half = force * tight[None, None], half * tight[None, None]
    keep = real[None, None]
    # A coefficient stands half-way between samples. What lies between bounds on them is
    # off by an eighth of the bound's second difference, which counts where the bound is
    # bent: beside a rest, and where an axis whips round.
    top = 1.0 / (cap * jnp.maximum(rho.value, jnp.min(mid.value)))
    most = 1.0 / (_cap(between[0], limits, programmed, cap) * mid.value)
    bent = jnp.maximum(2.0 * most - 0.5 * (top[1:] + top[:-1]), 0.5 * most)
    low = jnp.minimum(top[1:], top[:-1])
    most = jnp.where(real[1:], jnp.maximum(jnp.minimum(most, bent), 0.25 * low), top[1:])
    slow = 1.0 / jnp.concatenate([top[:1], most, top[-1:], top[-1:]])
    slow = slow.at[last + 1].set(1.0 / top[last])
    return Rows(
        weight=weight,
        slow=slow,
        force=jnp.where(keep, _share(force, hold), 0.0),
        half=jnp.where(
            keep & (jnp.arange(sigma.size) < last)[None, None], _share(half, hold), 0.0
        ),
        jerk=jnp.where(keep, _share(jerk, hard), 0.0),
        step=jnp.where(jnp.arange(sigma.size) < last, jnp.pad(h, (0, 1)), 0.0),
    )


def _start(parts, limits: Limits, cap, rho: Shape, sigma, last, rest):
    r"""A guess of y: half of what each sample allows by itself, joined at bounded jerk.

    At constant jerk from rest $b^{3/4}$ is straight, so it is what is joined.
    """
    m = limits.speed.size
    slow = jnp.max(jnp.abs(_share(parts[1][:m], limits.acceleration)), axis=0)
    slow = jnp.maximum(slow, cap)
    climb = jnp.full_like(cap, jnp.inf)
    if limits.jerk is not None:
        sharp = jnp.max(jnp.abs(_share(parts[2][:m], limits.jerk)), axis=0)
        slow = jnp.maximum(slow, sharp ** (2.0 / 3.0))
        stiff = jnp.max(jnp.abs(_share(parts[0][:m], limits.jerk)), axis=0)
        climb = jnp.where(
            stiff > 0.0, 0.6 / jnp.sqrt(jnp.where(stiff > 0, stiff, 1.0)), climb
        )
    level = (0.5 / slow) ** 0.75
    index = jnp.arange(sigma.size)
    still = jnp.zeros_like(level, bool).at[0].set(rest[0]).at[last].set(rest[1])
    level = jnp.where(still, 0.0, level)
    gain = climb[1:] * jnp.diff(sigma)

    def join(z, row):
        most, gain = row
        z = jnp.minimum(most, z + gain)
        return z, z

    _, up = jax.lax.scan(join, level[0], (level[1:], gain))
    up = jnp.concatenate([level[:1], up])
    # samples past the end stand for themselves
    gain = jnp.where(index[1:] <= last, gain, jnp.inf)
    _, down = jax.lax.scan(join, up[-1], (up[:-1], gain), reverse=True)
    z = jnp.concatenate([down, up[-1:]])
    z = jnp.where(index <= last, z, level)
    moving = z > 0.0
    y = jnp.where(moving, z, 1.0) ** (4.0 / 3.0) / jnp.where(moving, rho.value, 1.0)
    y = jnp.where(index <= last, y, 0.5 / cap)
    inward = jnp.where(index == last, last - 1, jnp.maximum(index, 1))
    y = jnp.pad(jnp.where(moving, y, y[inward]), (1, 2), mode="edge")
    return 0.5 * (y[1:] + y[:-1])


def _limiting(rows: Rows, parts, limits: Limits, cap, b, y, y1, y2):
    """Code of the limit that is used most, and its axis and order."""
    m = limits.speed.size
    root = jnp.sqrt(b)[None]
    none = jnp.zeros_like(b)[None]
    y, y1, y2 = y[None], y1[None], y2[None]
    force = jnp.abs(rows.force[0] * y + rows.force[1] * y1)
    jerk = jnp.abs(rows.jerk[0] * y + rows.jerk[1] * y1 + rows.jerk[2] * y2) * jnp.sqrt(y)
    path_force = force[m:] if force.shape[0] > m else none
    path_jerk = jerk[m:] if jerk.shape[0] > m else none
    speed = jnp.abs(_share(parts[0][:m], limits.speed)) * root
    asked = jnp.sqrt(jnp.maximum(cap * b, 0.0))[None]
    # the programme counts where no axis is as near its own speed
    asked = jnp.where(asked > jnp.max(speed, axis=0, keepdims=True), asked, 0.0)
    shares = [asked, speed, force[:m], jerk[:m], path_force, path_jerk]
    code = jnp.argmax(jnp.concatenate(shares), axis=0)
    each = jnp.clip(code - 1, 0, 3 * m - 1)
    return code, each % m, each // m


def _fault(parts, limits: Limits, programmed, real) -> Fault:
    """The first thing wrong with the input."""
    m = limits.speed.size
    bad = jnp.zeros_like(real)
    for p in parts:
        bad = bad | jnp.any(~jnp.isfinite(p), axis=0)
    culprit = jnp.stack([jnp.any(~jnp.isfinite(jnp.stack(parts)), axis=0)])[0]
    most = [limits.speed, limits.acceleration]
    most += [
        jnp.full(m, jnp.inf, limits.speed.dtype) if limits.jerk is None else limits.jerk
    ]
    none = jnp.stack(most) <= 0.0
    none = none | jnp.isnan(jnp.stack(most))  # (3, m)
    moves = (parts[0][:m] != 0.0) & real[None]
    stuck = jnp.any(none, axis=0)[:, None] & moves
    flat = jnp.any(stuck, axis=0)
    not_finite, no_speed = jnp.any(bad & real), jnp.any(flat)
    no_feed = ~((programmed > 0.0) & jnp.isfinite(programmed))
    kinds = jnp.array([NO_FEED, NOT_FINITE, NO_SPEED, SOUND])
    which = jnp.argmax(jnp.stack([no_feed, not_finite, no_speed, jnp.array(True)]))
    kind = kinds[which]
    places = jnp.stack([jnp.argmax(bad & real), jnp.argmax(flat)])
    finite = kind == NOT_FINITE
    sample = jnp.where(finite, places[0], places[1])
    axis = jnp.where(
        finite, jnp.argmax(culprit[:, sample]), jnp.argmax(stuck[:, sample].astype(int))
    )
    return Fault(kind, sample, axis, jnp.argmax(none[:, jnp.minimum(axis, m - 1)]))


def check(law: JerkLaw, limits: Limits | Machine) -> None:
    """Raise if the law must not be used; not for use under `jit`.

    Raises:
        ValueError: Says in a sentence which axis, sample and limit stand in the way.
    """
    limits = limits if isinstance(limits, Limits) else Limits.of(limits)
    kind, sample, axis = (
        int(x) for x in (law.fault.kind, law.fault.sample, law.fault.axis)
    )
    order = int(law.fault.limit)
    if kind == SOUND:
        return
    names = (*limits.names, "length")
    what = ("speed", "acceleration", "jerk")[order]
    if kind == NO_FEED:
        raise ValueError("the programmed feed must be a positive, finite number of mm/s")
    if kind == NOT_FINITE:
        raise ValueError(
            f"the path is not finite at sample {sample}: axis {names[axis]} or the samples"
            " beside it have no number"
        )
    if kind == NO_SPEED:
        given = (limits.speed, limits.acceleration, limits.jerk)[order]
        value = float("nan") if given is None else float(given[axis])
        raise ValueError(
            f"axis {names[axis]} has to move at sample {sample}, but its largest {what} is"
            f" {value:g}; it must be positive"
        )
    raise ValueError(
        f"no feed within all limits was found in {int(law.steps)} steps: at sample {sample}"
        f" the {what} of axis {names[axis]} stands in the way"
    )
