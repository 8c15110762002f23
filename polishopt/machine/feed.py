r"""Feed: how fast the contact point can really go along a sampled path.

`sweep` knows the fastest motion from the derivatives of the axes. Here these come from
the axis positions at the samples, and the motion becomes feed, time and the limit that
holds at each sample. `usage` checks a time law against the limits between the samples.
"""

import functools
import math
from collections.abc import Callable
from typing import SupportsInt

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..parts import AXES, Machine, Scalar
from .sweep import Limits as Limits, sweep as sweep


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
    if number > 3 * m:
        return ("path acceleration", "path jerk", "start or end")[number - 3 * m - 1]
    kind = ("speed", "acceleration", "jerk")[(number - 1) // m]
    return f"{names[(number - 1) % m]} {kind}"


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
    kept, index = distinct(parameter)
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
        limiting=jnp.where(imposed, 3 * limits.speed.size + 3, code),
        total=jnp.sum(dt),
    )


def derivatives(
    values: Float[Array, "n m"],
    sigma: Float[Array, " n"],
    count: Int[Array, ""] | None = None,
    order: int = 2,
) -> tuple[Float[Array, "n m"], ...]:
    r"""Derivatives of sampled values by the path parameter.

    Those of the polynomial through each sample and its two neighbours on either side, so
    the error is of order $h^4$ for even samples ($h^3$ in the second derivative for
    uneven ones and for the two samples at each end; $h^2$ in the third).

    Args:
        values: Values at the samples.
        sigma: Path parameter, strictly increasing.
        count: How many samples, from the first, are real; all if not given.
        order: How often to differentiate, at most.

    Returns:
        First, second, ... derivative at each sample.

    Source: Own derivation (Lagrange's polynomial).
    """
    n = sigma.size
    width = min(n, 5)
    real = n if count is None else count
    sigma = increasing(sigma, real)
    first = jnp.clip(jnp.arange(n) - width // 2, 0, jnp.maximum(real - width, 0))
    window = first[:, None] + jnp.arange(width)[None]
    node = sigma[window]  # (n, width)
    gap = sigma[:, None] - node
    change = values[window] - values[:, None, :]  # (n, width, m)
    totals = [jnp.zeros_like(values)] * order
    for k in range(width):
        others = [gap[:, l] for l in range(width) if l != k]
        below = 1.0
        for l in range(width):
            below = below * ((node[:, k] - node[:, l]) if l != k else 1.0)
        # the basis polynomial is (a product of the others) / below: its derivatives are
        # the sums of products that leave out one, or two, ... of the others
        products = [jnp.ones_like(below)] + [jnp.zeros_like(below)] * order
        for y in others:
            lower = [jnp.zeros_like(below), *products[:-1]]
            products = [p * y + q for p, q in zip(products, lower, strict=True)]
        for r in range(order):
            times = math.factorial(r + 1)
            totals[r] = totals[r] + (times * products[r + 1] / below)[:, None] * change[:, k]
    return tuple(totals)


def increasing(sigma: Float[Array, " n"], real: int | Int[Array, ""]) -> Float[Array, " n"]:
    """The parameter with any increasing tail past its real samples, never weighted."""
    n = sigma.size
    mean = (sigma[-1] - sigma[0]) / (n - 1)
    beyond = jnp.maximum(jnp.arange(n) - (real - 1), 0)
    return sigma + jnp.where(mean > 0.0, mean, 1.0) * beyond.astype(sigma.dtype)


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
    kept, index = distinct(parameter)
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


def distinct(sigma: Float[Array, " n"]) -> tuple[Int[Array, " n"], Int[Array, " n"]]:
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
