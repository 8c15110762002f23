r"""Exact: the fastest motion along a path that is known as a function.

`feed` takes its derivatives from the samples, which is right where the axes turn slowly.
Past the pole C turns round within hundredths of a degree: there derivatives must be those
of the path itself, and limits must be looked at between the samples too. Where more than
a limit is used in between, the samples on either side are held to as much less.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..batched import in_batches
from ..parts import Machine, Scalar
from .feed import TimeLaw, time_law_from_derivatives
from .sweep import Limits


# Places in each interval where limits are looked at, its ends included; the use of a limit
# that will do, and how often the motion is slowed down to get there; and points
# differentiated at a time.
PLACES, ENOUGH, ROUNDS, AT_ONCE = 9, 1.0003, 40, 1024


class Motion(eqx.Module):
    """A path at one place: how axes and contact point move with its parameter."""

    first: Float[Array, "*n m"]
    """First derivative of the axes."""
    second: Float[Array, "*n m"]
    """Second derivative."""
    rate: Float[Array, "*n"]
    """Contact length per path parameter [mm/parameter]."""


def motion(
    path: Callable[[Scalar], tuple[Float[Array, " m"], Float[Array, "3"]]],
    sigma: Float[Array, " n"],
) -> Motion:
    """Derivatives of a path at many places.

    Args:
        path: Axes [mm or rad] and contact point [mm] as a function of the parameter.
        sigma: The places.
    """

    def slope(s):
        return jax.jvp(path, (s,), (jnp.ones_like(s),))[1]

    def at(s):
        (first, along), (second, _) = jax.jvp(slope, (s,), (jnp.ones_like(s),))
        return Motion(first, second, jnp.sqrt(jnp.sum(along**2)))

    return in_batches(at, sigma, AT_ONCE)


def exact_time_law(
    path: Callable[[Scalar], tuple[Float[Array, " m"], Float[Array, "3"]]],
    sigma: Float[Array, " n"],
    limits: Limits | Machine,
    programmed: Scalar,
    rest: tuple[bool, bool] = (True, True),
) -> TimeLaw:
    r"""The fastest motion along a path, held to the limits between the samples too.

    Between samples the squared rate is linear, so what is used of a limit there is known.
    Dividing the limits on either side of an interval by it is the same as scaling the
    derivatives there; then comes another sweep. A few rounds are enough but for places
    within hundredths of a degree of the pole. The scales are held fixed when the law is
    differentiated.

    Args:
        path: Axes [mm or rad] and contact point [mm] as a function of the parameter.
        sigma: Path parameter of the samples, never decreasing, even or not.
        limits: The limits of the axes, or the machine that has them.
        programmed: Programmed feed of the contact point, finite [mm/s].
        rest: Whether the path starts and ends at rest.

    Source: Own derivation.
    """
    limits = limits if isinstance(limits, Limits) else Limits.of(limits)
    spacing = jnp.diff(sigma)
    shares = jnp.arange(PLACES - 1, dtype=sigma.dtype) / (PLACES - 1)
    # at the samples, and behind them at each share of every interval but the first
    inner = jax.vmap(lambda share: sigma[:-1] + share * spacing)(shares[1:])
    everywhere = motion(path, jnp.concatenate([sigma, inner.reshape(-1)]))
    samples = jax.tree.map(lambda leaf: leaf[: sigma.size], everywhere)
    between = jax.tree.map(
        lambda leaf: leaf[sigma.size :].reshape(*inner.shape, *leaf.shape[1:]), everywhere
    )

    def law(samples, limits, programmed, scale):
        return time_law_from_derivatives(
            samples.first * scale[:, None],
            samples.second * scale[:, None],
            limits,
            samples.rate * scale,
            sigma,
            programmed,
            rest,
        )

    given = jax.lax.stop_gradient((samples, limits, programmed))
    scale = _scales(
        lambda scale: law(*given, scale).rate,
        jax.lax.stop_gradient(between),
        shares[1:],
        spacing,
        *given[1:],
    )
    found = law(samples, limits, programmed, scale)
    return eqx.tree_at(lambda one: one.feed, found, found.rate * samples.rate)


def _scales(rate_at, between: Motion, shares, spacing, limits: Limits, programmed):
    """By how much to scale the derivatives at each sample so that limits hold between.

    Args:
        rate_at: Rate at the samples, as a function of the scales.
        between: The path `[share, interval]`.
        shares: Where in the intervals.
        spacing: Lengths of the intervals.
        limits: The limits of the axes.
        programmed: Programmed feed.
    """
    moving = spacing > 0.0

    def used(scale):
        b = rate_at(scale) ** 2
        a = jnp.where(moving, jnp.diff(b) / (2.0 * jnp.where(moving, spacing, 1.0)), 0.0)

        def within(share, at: Motion):
            here = jnp.maximum(b[:-1] + share * jnp.diff(b), 0.0)
            speed = jnp.sqrt(here)
            force = at.first * a[:, None] + at.second * here[:, None]
            uses = [
                jnp.max(jnp.abs(at.first) / limits.speed[None], axis=1) * speed,
                jnp.max(jnp.abs(force) / limits.acceleration[None], axis=1),
                at.rate * speed / programmed,
            ]
            return jnp.max(jnp.stack(uses), axis=0)

        most = jnp.max(jax.vmap(within)(shares, between), axis=0)
        return jnp.where(moving, most, 0.0)

    def slower(state):
        turn, scale, uses = state
        more = jnp.maximum(uses, 1.0)
        scale = scale * jnp.maximum(jnp.pad(more, (1, 0)), jnp.pad(more, (0, 1)))
        return turn + 1, scale, used(scale)

    def too_fast(state):
        turn, _, uses = state
        return (jnp.max(uses) > ENOUGH) & (turn < ROUNDS)

    scale = jnp.ones_like(spacing, shape=spacing.size + 1)
    return jax.lax.while_loop(too_fast, slower, (0, scale, used(scale)))[1]
