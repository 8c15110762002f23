r"""Jerk_exact: the fastest motion with bounded jerk along a path known as a function.

`jerk` takes its derivatives from the samples and enforces the limits there. Here first
derivatives are those of the path itself, at several places in each interval, and the others
are differences of these: exact ones would take minutes to compile. The limits are looked at
between the samples too: where more than a limit is used, it is made as much tighter there
and the search is run again.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..batched import in_batches
from ..parts import Machine, Scalar
from .feed import derivatives
from .interior import Rows, search
from .jerk import JerkLaw, law_of, rise
from .shape import apply, shape
from .sweep import Limits


# Places in each interval where limits are looked at, its ends included; the use of a speed
# or an acceleration, and of a jerk, that will do; how often limits are made tighter; and
# points differentiated at a time.
PLACES, ENOUGH, ENOUGH_JERK, ROUNDS, AT_ONCE = 9, 1.0003, 1.01, 12, 1024


def slopes(
    path: Callable[[Scalar], tuple[Float[Array, " m"], Float[Array, "3"]]],
    sigma: Float[Array, " n"],
) -> Float[Array, "n k"]:
    """First derivatives by the path parameter, of the axes and of the contact's way.

    Args:
        path: Axes [mm or rad] and contact point [mm] as a function of the parameter.
        sigma: The places.
    """

    def at(s):
        first, along = jax.jvp(path, (s,), (jnp.ones_like(s),))[1]
        square = jnp.sum(along**2)
        moves = square > 0
        rate = jnp.where(moves, jnp.sqrt(jnp.where(moves, square, 1.0)), 0.0)
        return jnp.append(first, rate)

    return in_batches(at, sigma, AT_ONCE)


def exact_jerk_law(
    path: Callable[[Scalar], tuple[Float[Array, " m"], Float[Array, "3"]]],
    sigma: Float[Array, " n"],
    limits: Limits | Machine,
    programmed: Scalar,
    rest: tuple[bool, bool] = (True, True),
) -> JerkLaw:
    """The fastest motion that jerk allows too, held to limits between the samples.

    As `jerk_law`, for paths whose axes whip round between samples. By how much limits are
    tighter is held fixed when the law is differentiated.

    Args:
        path: Axes [mm or rad] and contact point [mm] as a function of the parameter.
        sigma: Path parameter of the samples, strictly increasing, even or not.
        limits: The limits of the axes, or the machine that has them.
        programmed: Programmed feed of the contact point, finite [mm/s].
        rest: Whether the path starts and ends at rest.

    Source: Own derivation.
    """
    limits = limits if isinstance(limits, Limits) else Limits.of(limits)
    n, spacing = sigma.size, jnp.diff(sigma)
    shares = jnp.arange(PLACES - 1, dtype=sigma.dtype) / (PLACES - 1)
    places = sigma[:-1, None] + shares[None] * spacing[:, None]
    places = jnp.append(places.reshape(-1), sigma[-1])
    first = slopes(path, places)
    everywhere = (first, *derivatives(first, places))
    samples = [x[:: PLACES - 1].T for x in everywhere]
    # `[share, axis, interval]`
    between = [
        jnp.moveaxis(x[:-1].reshape(n - 1, PLACES - 1, -1)[:, 1:], 0, 2) for x in everywhere
    ]
    shares = shares[1:]
    middle = (PLACES - 3) // 2
    halves = between[0][middle], between[1][middle]
    held = jax.lax.stop_gradient((samples, between, limits, programmed))

    def found_by(rows, table, start):
        uses_of = _uses(*held, sigma, shares, rest)
        fixed, table = jax.lax.stop_gradient((rows, table))

        def again(state):
            scale, found, uses, turn = state
            scale = scale * jnp.maximum(uses, 1.0)
            begin = jnp.where(turn == 0, start, found.c)
            found = search(_tighter(fixed, scale), table, begin)
            return scale, found, uses_of(apply(table, found.c)), turn + 1

        def over(state):
            _, found, uses, turn = state
            enough = jnp.asarray([ENOUGH, ENOUGH, ENOUGH_JERK], uses.dtype)
            wrong = jnp.any(uses > enough[:, None]) & found.converged
            return (turn == 0) | (wrong & (turn < ROUNDS))

        # one loop for the first search too: to compile it once is long enough
        none = jax.eval_shape(search, fixed, table, start)
        none = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), none)
        uses = jnp.zeros_like(spacing, shape=(3, n - 1))
        state = (jnp.ones_like(uses), none, uses, jnp.zeros((), jnp.int32))
        scale, found, _, _ = jax.lax.while_loop(over, again, state)
        return _tighter(rows, scale), found

    return law_of(samples, limits, sigma, jnp.arange(n), programmed, rest, halves, found_by)


def _tighter(rows: Rows, scale: Float[Array, "3 k"]) -> Rows:
    """Limits as many times tighter around each interval, by speed, acceleration, jerk."""
    speed, force, jerk = scale
    here = [jnp.maximum(jnp.pad(x, (1, 0)), jnp.pad(x, (0, 1))) for x in scale]
    # interval k lies between coefficients k, k + 1 and k + 2
    wide = [jnp.pad(speed, side) for side in ((0, 3), (1, 2), (2, 1))]
    slow = jnp.maximum(jnp.maximum(jnp.maximum(*wide[:2]), wide[2]), 1.0)
    return eqx.tree_at(
        lambda r: (r.slow, r.force, r.half, r.jerk),
        rows,
        (
            rows.slow * slow**2,
            rows.force * here[1][None, None],
            rows.half * jnp.pad(force, (0, 1), constant_values=1.0)[None, None],
            rows.jerk * here[2][None, None],
        ),
    )


def _uses(samples, between, limits: Limits, programmed, sigma, shares, rest):
    """The largest use of speeds, accelerations and jerks in each interval, given y."""
    spacing, last = jnp.diff(sigma), sigma.size - 1
    inf = jnp.full_like(limits.speed, jnp.inf)
    most = [
        (limits.speed, programmed),
        (limits.acceleration, limits.path_acceleration),
        (inf if limits.jerk is None else limits.jerk, limits.path_jerk),
    ]
    most = [jnp.append(x, jnp.inf if p is None else p)[:, None] for x, p in most]
    length = rise(sigma, jnp.asarray(last))

    def uses(parts):
        y, y1, y2 = (x[:-1] for x in parts)

        def within(share, at):
            way = share * spacing
            slope = y1 + way * y2
            value = y + way * (y1 + 0.5 * way * y2)
            rho = shape(sigma[:-1] + way, sigma[0], sigma[last], length, rest)
            root = jnp.sqrt(value)
            rate = rho.root * root
            change = 0.5 * (rho.slope * value + rho.value * slope)
            jolt = rho.root_bend * value
            jolt = (
                0.5 * root * (jolt + rho.root * (2.0 * rho.slope * slope + rho.value * y2))
            )
            first, second, third = at
            made = (
                first * rate[None],
                first * change[None] + second * rate[None] ** 2,
                first * jolt[None]
                + 3.0 * second * (rate * change)[None]
                + third * rate[None] ** 3,
            )
            shares = [jnp.abs(x) / k for x, k in zip(made, most, strict=True)]
            return jnp.stack([jnp.max(x, axis=0) for x in shares])

        ends = [
            within(share, [x[:, place] for x in samples])
            for share, place in ((0.0, slice(0, -1)), (1.0, slice(1, None)))
        ]
        inside = jnp.max(jax.vmap(within)(shares, between), axis=0)
        return jnp.maximum(jnp.maximum(*ends), inside)

    return uses
