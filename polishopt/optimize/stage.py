"""Stage: what one search of a tuning is asked for, and the programs that carry it out.

First for the target under the limits, as a least-squares problem; then, from what reached
it, for the least cost on the target, which is a narrow band to either side of every goal.
Were goals held exactly, two that all but say the same could only be met at a great cost, or
hardly at all. Both stages are one problem with other numbers in it, so they share what is
compiled.
"""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from ..chain import Outcome
from ..parts import Process, Scalar
from ..plan import Plan, PlanOutcome
from ..setup import Setup
from ..stored import stored
from .batches import Places, ahead, looked_at, walked
from .certificate import Solution
from .goals import (
    Goal,
    Limits,
    PlanLimits,
    all_excesses,
    all_local_bands,
    all_misses,
    applied,
    band_names,
)
from .values import Values
from .walk import Rules


# Rounds of multipliers, and trial points in each; half as many as there are settings, if
# that is more, since curvature is learned along one direction at a point, and the outer
# rounds learn on. All starts wait for the last one, and the few that have not ended by then
# are lost in a corner that others avoid.
ROUNDS, TRIALS = 10, 10


class Stage(eqx.Module):
    """What the search needs to know beside the settings it moves."""

    setup: Setup | Plan
    """The job, or the plan of several steps."""
    start: Process | tuple[Process, ...]
    """Where what does not move is taken from."""
    target: dict[str, Goal]
    """What to reach [mm or -]."""
    limits: Limits | PlanLimits
    """What to keep."""
    weight: Scalar
    """0 while reaching for the target, 1 while holding it at the least cost."""
    unit: Scalar
    """Cost of the given start, so that the residual is of size one [s or N]."""
    slack: Scalar
    """Misses up to this count as none, in tolerances."""
    secondary: str = eqx.field(static=True)
    """Which cost: "time", "force" or "none"."""
    chain: Callable[..., Any] = eqx.field(static=True)
    """The model of the process, of the same form as `polish` or `plan.follow`."""

    @property
    def steps(self) -> tuple[str, ...]:
        """What the steps of a plan are called; nothing for a step alone."""
        return steps_of(self.setup)


def steps_of(setup: Setup | Plan) -> tuple[str, ...]:
    """What the steps of a plan are called; nothing for a step alone.

    Args:
        setup: The job, or the plan.
    """
    return setup.names if isinstance(setup, Plan) else ()


@stored
def _looked_at(x, skipped, stage: Stage) -> tuple[Any, Any]:
    """What the search needs to know of several places; both stages share the program."""

    def values(x):
        outcome = stage.chain(applied(stage.start, stage.steps, x), stage.setup)
        # the worst place is no smooth function of the settings: each place is asked for
        left = all_local_bands(outcome, stage.target)
        missed = {
            name: miss
            for name, miss in all_misses(outcome, stage.target).items()
            if name not in left
        }
        holds = jnp.where(stage.weight > 0, 1.0, 0.0)
        off = [jnp.maximum(band, 0.0).reshape(-1) for band in left.values()]
        off = jnp.concatenate([*(miss[None] for miss in missed.values()), *off])
        off = off - jnp.clip(off, -stage.slack, stage.slack)
        held = {
            end: holds * (side - stage.slack)
            for name, miss in missed.items()
            for end, side in zip(band_names(name), (-miss, miss), strict=True)
        }
        held |= {end: holds * band for end, band in left.items()}
        return Values(
            residual=(
                off * (1 - holds),
                stage.weight * _cost(outcome, stage.secondary) / stage.unit,
            ),
            inequality={**all_excesses(outcome, stage.limits), **held},
        )

    return looked_at(values, x, skipped)


def searched(
    places: Places,
    lower: Places,
    upper: Places,
    stage: Stage,
    tolerance: float,
    vacant: Bool[np.ndarray, " starts"] | None = None,
) -> Solution:
    """Where searches from several places end, run side by side.

    Args:
        places: Where they start, by setting.
        lower: Lower bounds, likewise.
        upper: Upper bounds.
        stage: What they look for.
        tolerance: Projected gradient at which a search ends, in tolerances of the goals.
        vacant: Places where nothing is searched; None for none of them.
    """

    def look(x, skipped):
        return _looked_at(x, skipped, stage)

    rules = _rules(tolerance, len(places))
    return walked(look, places, lower, upper, rules, vacant)


def prepare(lower: Places, upper: Places, stage: Stage, tolerance: float) -> None:
    """Has the programs of `searched` and `seen` made in the background.

    The model's slopes take longest to compile: the rest is done meanwhile.

    Args:
        lower: As in `searched`.
        upper: As in `searched`.
        stage: As in `searched`.
        tolerance: As in `searched`.
    """
    count = len(next(iter(lower.values())))
    outline = _looked_at.ahead(lower, np.zeros(count, bool), stage)
    ahead(outline, lower, lower, upper, _rules(tolerance, len(lower)))


def seen(
    x: Places, stage: Stage, together: int
) -> tuple[Float[np.ndarray, " starts"], Float[np.ndarray, " starts"]]:
    """Costs [s or N] and largest misses [tolerances] at several places.

    Args:
        x: The places, by setting.
        stage: What is looked for; whether for the target or the least cost is the same.
        together: How many places the program looks at; it is that of `searched`.
    """
    one = jnp.ones_like(stage.weight)
    bare = dataclasses.replace(stage, weight=one, unit=one)
    count, found = len(next(iter(x.values()))), []
    for i in range(0, count, together):
        # the last of these is filled up with the last place, which is looked at but once
        chosen = np.arange(i, i + together)
        part = {
            name: jnp.asarray(column[np.minimum(chosen, count - 1)])
            for name, column in x.items()
        }
        (_, cost), _, over, _ = _looked_at(part, chosen >= count, bare)[0]
        found.append((np.asarray(cost), _far(over, stage)))
    costs, misses = (np.concatenate(parts)[:count] for parts in zip(*found, strict=True))
    return costs, misses


def _cost(outcome: Outcome | PlanOutcome, secondary: str) -> Scalar:
    return outcome.force_max if secondary == "force" else outcome.time


def _rules(tolerance: float, count: int) -> Rules:
    """When a search for some settings is over."""
    return Rules(tolerance, ROUNDS, max(TRIALS, count // 2))


def _far(over: Mapping[str, Any], stage: Stage) -> Float[np.ndarray, " starts"]:
    """Largest miss of a goal in the second stage, at several places [tolerances]."""
    rows = []
    for name, goal in stage.target.items():
        for end in band_names(name):
            side = np.asarray(over[end])
            if goal.worst:
                rows.append(np.max(np.maximum(side, 0.0), axis=(1, 2)))
            else:
                rows.append(side + float(stage.slack))
    return np.max(rows, axis=0)
