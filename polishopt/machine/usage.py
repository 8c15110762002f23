"""Usage: how much of each limit a time law uses, between the samples too."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..parts import Machine, Scalar
from .feed import TimeLaw, derivatives, distinct
from .jerk import JerkLaw
from .shape import RISE, shape
from .sweep import Limits


class Usage(eqx.Module):
    """The largest share of each limit that a time law uses; 1 is all of it."""

    programmed: Scalar
    """Of the programmed feed [-]."""
    speed: Float[Array, " m"]
    """Of each axis's speed [-]."""
    acceleration: Float[Array, " m"]
    """Of each axis's acceleration [-]."""
    jerk: Float[Array, " m"] | None
    """Of each axis's jerk [-]; None for a law that does not bound it."""
    path_acceleration: Scalar
    """Of the acceleration along the path, zero without a limit [-]."""
    path_jerk: Scalar | None
    """Of the jerk along the path, zero without a limit [-]."""


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

    Between samples the squared rate is what the law takes it to be (linear for `time_law`,
    see `shape` for `jerk_law`), and the path is `path` or, without one, the quintic
    through the positions and two derivatives at the samples. For checks: it holds `finer`
    values of everything for each sample.

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
    columns = jnp.column_stack([axes, arc])
    at = derivatives(columns[kept], parameter[kept], index[-1] + 1)
    at = [columns, *(x[index] for x in at)]
    h = jnp.diff(parameter)
    moving = h > 0.0
    h = jnp.where(moving, h, 1.0)
    m = axes.shape[1]
    bounded = isinstance(law, JerkLaw)
    motion = _smooth if bounded else _linear
    inf = jnp.full_like(limits.speed, jnp.inf)
    most = [
        (limits.speed, programmed),
        (limits.acceleration, limits.path_acceleration),
        (inf if limits.jerk is None else limits.jerk, limits.path_jerk),
    ]
    most = [jnp.append(x, jnp.inf if p is None else p) for x, p in most]

    def within(t: Scalar) -> Float[Array, "3 k"]:
        """Uses at the fraction t of every interval."""
        first, second, third = _quintic(t, h[:, None], at)
        if path is not None:
            exact = jax.vmap(lambda s: _three(path, s))(parameter[:-1] + t * h)
            parts = zip((first, second, third), exact, strict=True)
            first, second, third = (x.at[:, :m].set(y) for x, y in parts)
        rate, change, jolt = (x[:, None] for x in motion(law, parameter, h, t))
        made = (
            first * rate,
            first * change + second * rate**2,
            first * jolt + 3.0 * second * rate * change + third * rate**3,
        )
        shares = [jnp.abs(x) / y[None] for x, y in zip(made, most, strict=True)]
        return jnp.stack([jnp.where(moving[:, None], x, 0.0).max(0) for x in shares])

    speed, force, jerk = jax.lax.map(within, jnp.linspace(0.0, 1.0, finer + 1)).max(0)
    return Usage(
        programmed=jnp.maximum(speed[m], jnp.max(law.feed) / programmed)
        if bounded
        else jnp.max(law.feed) / programmed,
        speed=speed[:m],
        acceleration=force[:m],
        jerk=jerk[:m] if bounded else None,
        path_acceleration=force[m],
        path_jerk=jerk[m] if bounded else None,
    )


def _linear(law: TimeLaw, parameter, h, t):
    """Rate and its two derivatives by time if b is linear; the last is not known."""
    b = law.rate**2
    here = b[:-1] + t * (b[1:] - b[:-1])
    return jnp.sqrt(jnp.maximum(here, 0.0)), 0.5 * jnp.diff(b) / h, jnp.zeros_like(h)


def _smooth(law, parameter, h, t):
    """Rate and its two derivatives by time as `shape` has them."""
    start, end, n = parameter[0], parameter[-1], jnp.sum(jnp.diff(parameter) > 0.0)
    rise = RISE * (end - start) / jnp.maximum(n, 1).astype(h.dtype)
    left, way, y2 = parameter[:-1], t * h, law.y_bend[:-1]
    y1 = law.y_slope[:-1] + way * y2
    y = law.y[:-1] + way * (law.y_slope[:-1] + 0.5 * way * y2)
    rho = shape(left + way, start, end, rise, law.rest)
    root = jnp.sqrt(y)
    jolt = rho.root_bend * y + rho.root * (2.0 * rho.slope * y1 + rho.value * y2)
    return rho.root * root, 0.5 * (rho.slope * y + rho.value * y1), 0.5 * root * jolt


def _three(path, s: Scalar):
    """First, second and third derivative of a path by its parameter."""

    def by(f):
        return lambda s: jax.jvp(f, (s,), (jnp.ones_like(s),))[1]

    return by(path)(s), by(by(path))(s), by(by(by(path)))(s)


def _quintic(t, h, at):
    """Derivatives of the quintic with given values, slopes and second derivatives."""
    (q0, q1), (d0, d1), (s0, s1) = ((x[:-1], x[1:]) for x in at)
    u, w = d0 * h, d1 * h
    p, r = s0 * h**2, s1 * h**2
    rise = q1 - q0
    c3 = 10.0 * rise - 6.0 * u - 4.0 * w - 1.5 * p + 0.5 * r
    c4 = -15.0 * rise + 8.0 * u + 7.0 * w + 1.5 * p - r
    c5 = 6.0 * rise - 3.0 * (u + w) - 0.5 * (p - r)
    first = u + t * (p + t * (3.0 * c3 + t * (4.0 * c4 + t * 5.0 * c5)))
    second = p + t * (6.0 * c3 + t * (12.0 * c4 + t * 20.0 * c5))
    third = 6.0 * c3 + t * (24.0 * c4 + t * 60.0 * c5)
    return first / h, second / h**2, third / h**3
