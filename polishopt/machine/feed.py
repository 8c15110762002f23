r"""Feed: how fast the contact point can really go along a sampled path.

`sweep` knows the fastest motion from the derivatives of the axes. Here these come from
the axis positions at the samples, and the motion becomes feed, time and the limit that
holds at each sample.
"""

import math
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
    code = _limiting(
        *jax.lax.stop_gradient((dq, ddq, length_rate, spacing, programmed, limits, b))
    )
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
            totals[r] = (
                totals[r] + (times * products[r + 1] / below)[:, None] * change[:, k]
            )
    return tuple(totals)


def increasing(sigma: Float[Array, " n"], real: int | Int[Array, ""]) -> Float[Array, " n"]:
    """The parameter with any increasing tail past its real samples, never weighted."""
    n = sigma.size
    mean = (sigma[-1] - sigma[0]) / (n - 1)
    beyond = jnp.maximum(jnp.arange(n) - (real - 1), 0)
    return sigma + jnp.where(mean > 0.0, mean, 1.0) * beyond.astype(sigma.dtype)


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


def _safe_sqrt(x: Float[Array, " n"]) -> Float[Array, " n"]:
    """Square root, with zero gradient at zero (a rest stays a rest)."""
    still = x <= 0.0
    return jnp.where(still, 0.0, jnp.sqrt(jnp.where(still, 1.0, x)))
