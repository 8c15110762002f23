r"""Attribution: why two parts come out differently, in shares that add up.

Three things that a curved part changes can be left out one by one: how the disc touches it
(force and area), the stretch of its area over the parameter plane, and the feed that the
axes reach. An effect counts differently with the others there or not, so each is given the
mean of its contributions over all orders in which the three can be let in: the value of
Shapley, the only split that adds up, treats effects alike and gives nothing to an effect
that does nothing. What differs with all three left out is the path's own, and that of
whatever else the two jobs do not share.
"""

import dataclasses
import itertools
import math
from collections.abc import Callable, Mapping, Sequence

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..chain import polish
from ..mechanics import Mechanics
from ..parts import Machine, Process
from ..setup import Setup


EFFECTS = ("contact", "stretch", "feed")
OUTCOMES = (
    "Sa",
    "Sq",
    "Ssk",
    "Sku",
    "mean_removal",
    "time",
    "feed",
    "force",
    "contact_area",
    "pressure",
)

# From the effects that are let in to the outcomes with them.
Game = Mapping[frozenset[str], Float[Array, " n"]]


class Attribution(eqx.Module):
    """The difference of two jobs' outcomes (rows), by effect (columns)."""

    outcomes: tuple[str, ...] = eqx.field(static=True)
    """Names of the rows."""
    effects: tuple[str, ...] = eqx.field(static=True)
    """Names of the columns: contact, stretch, feed, and the path with all the rest."""
    first: Float[Array, " rows"]
    """Outcomes of the first job, in mm, N, s."""
    second: Float[Array, " rows"]
    """Outcomes of the second."""
    parts: Float[Array, "rows columns"]
    """Shares of the second less the first; a row's sum is that difference."""
    least: Float[Array, "rows columns"]
    """The smallest contribution of each effect over all orders."""
    most: Float[Array, "rows columns"]
    """The largest."""


def contributions(game: Game, effects: Sequence[str], effect: str) -> Float[Array, "k n"]:
    """What an effect adds in each of the orders in which effects can be let in.

    Args:
        game: Values by the effects that are let in, for all subsets.
        effects: All effects.
        effect: Which one.
    """
    added = []
    for order in itertools.permutations(effects):
        before = frozenset(order[: order.index(effect)])
        added.append(game[before | {effect}] - game[before])
    return jnp.stack(added)


def shapley(game: Game, effects: Sequence[str]) -> Float[Array, "effects n"]:
    """Shares of the effects; together, what all of them change.

    Args:
        game: Values by the effects that are let in, for all subsets.
        effects: All effects.

    Source: Shapley, A value for n-person games (1953).
    """
    total = math.factorial(len(effects))
    shares = [jnp.sum(contributions(game, effects, effect), axis=0) for effect in effects]
    return jnp.stack(shares) / total


def attribution(
    first: tuple[Process, Setup],
    second: tuple[Process, Setup],
    outcomes: Sequence[str] = OUTCOMES,
    chain: Callable[[Process, Setup], Mechanics] = polish,
) -> Attribution:
    """Why the second job comes out differently from the first.

    Args:
        first: The settings and the job.
        second: The other, say the same on a curved part.
        outcomes: Names of scalars of `Outcome`.
        chain: Another model of the process, of the same form as `polish`.

    Returns:
        The split. On a plane, contact and stretch change nothing; with the same job twice
        everything is exactly zero.
    """
    names = tuple(outcomes)
    one, two = (played(names, chain, *job) for job in (first, second))
    game = {let_in: two[let_in] - one[let_in] for let_in in two}
    none, everything = frozenset(), frozenset(EFFECTS)
    orders = [contributions(game, EFFECTS, effect) for effect in EFFECTS]
    rest = game[none]
    return Attribution(
        outcomes=names,
        effects=(*EFFECTS, "path"),
        first=one[everything],
        second=two[everything],
        parts=jnp.stack([*shapley(game, EFFECTS), rest], axis=1),
        least=jnp.stack([*(jnp.min(k, axis=0) for k in orders), rest], axis=1),
        most=jnp.stack([*(jnp.max(k, axis=0) for k in orders), rest], axis=1),
    )


@eqx.filter_jit
def _values(
    outcomes: tuple[str, ...],
    chain: Callable[[Process, Setup], Mechanics],
    process: Process,
    setup: Setup,
) -> Float[Array, " n"]:
    done = chain(process, setup)
    return jnp.stack([getattr(done, name) for name in outcomes])


def played(
    outcomes: tuple[str, ...],
    chain: Callable[[Process, Setup], Mechanics],
    process: Process,
    setup: Setup,
) -> dict[frozenset[str], Float[Array, " n"]]:
    """Outcomes of a job with each choice of effects let in, the others left out.

    Args:
        outcomes: Their names.
        chain: The model of the process.
        process: The settings.
        setup: The job; what it leaves out already stays out.
    """
    fast = dataclasses.replace(setup, machine=unlimited(setup.machine))
    found: dict[frozenset[str], Float[Array, " n"]] = {}
    shaped: dict[tuple[frozenset[str], bool], Float[Array, " n"]] = {}
    for flags in itertools.product((False, True), repeat=len(EFFECTS)):
        let_in = frozenset(e for e, flag in zip(EFFECTS, flags, strict=True) if flag)
        # a plane has neither curvature nor stretch to leave out
        out = {"contact", "stretch"} - let_in if not setup.flat else set()
        left_out = tuple(sorted({*setup.idealised, *out}))
        key = (frozenset(left_out), "feed" in let_in)
        if key not in shaped:
            # axes without limits are other numbers, not another program to compile
            job = setup if "feed" in let_in else fast
            job = dataclasses.replace(job, idealised=left_out)
            shaped[key] = _values(outcomes, chain, process, job)
        found[let_in] = shaped[key]
    return found


def unlimited(machine: Machine) -> Machine:
    """The same machine with axes that nothing holds back."""
    free = jnp.full_like(machine.max_speed, jnp.inf)
    return dataclasses.replace(
        machine, max_speed=free, max_acceleration=free, max_jerk=free
    )
