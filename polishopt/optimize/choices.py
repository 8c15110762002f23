"""Choices: alternatives between which there is nothing, each tuned, and the best of them.

A guide curve of another family or order, pulling or pushing, another grade of abrasive:
no derivative leads from one to the other, so all of them are tuned in turn. What is
compared is what tuning makes of each, not what they do at some setting in common.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ..parts import Process
from ..plan import Plan
from ..setup import Setup
from .certificate import Status
from .goals import Goal, Limits, PlanLimits
from .kept import Store, outdated
from .tune import TOLERANCE, Tuning, Verdict, tune


class Alternative(NamedTuple):
    """A job to tune: the arguments of `tune` in which alternatives may differ."""

    setup: Setup | Plan
    """What is given, of a step or of a plan."""
    start: Process | Sequence[Process]
    """The process to start from [mm, s, rad]."""
    between: Mapping[str, tuple[float, float]]
    """Bounds of the settings that are tuned [mm, s, rad]."""
    target: Mapping[str, Goal]
    """What to reach [mm or -]."""
    limits: Limits | PlanLimits | None = None
    """What to keep."""


class Choice(NamedTuple):
    """What became of the alternatives."""

    winner: str
    """The best of them."""
    ranking: tuple[str, ...]
    """All of them, the best first."""
    tunings: dict[str, Tuning]
    """What tuning made of each, in the order given."""


class _Part:
    """A store in which what belongs to other alternatives is not seen."""

    def __init__(self, store: Store):
        self.store = store

    def get(self, name: str, /) -> Mapping[str, np.ndarray] | None:
        return self.store.get(name)

    def __setitem__(self, name: str, arrays: Mapping[str, np.ndarray], /) -> None:
        self.store[name] = arrays

    def __iter__(self) -> Iterator[str]:
        return iter(())


def choose(
    alternatives: Mapping[str, Alternative],
    secondary: str = "time",
    starts: int = 16,
    seed: int = 0,
    tolerance: float = TOLERANCE,
    chain: Callable[..., Any] | None = None,
    progress: Callable[[str], None] | None = None,
    store: Store | None = None,
    ended: Callable[[str, Tuning], None] | None = None,
) -> Choice:
    """Tunes each alternative and ranks them.

    They are tuned one after another on the host, as their structures may differ: a guide
    of another order has other shapes. Those of one structure share what is compiled.

    Args:
        alternatives: The jobs by name. Goals should be the same in all of them, or else
            distances from the target, in tolerances, say little side by side.
        secondary: What to make small where the target is met: "time", "force", "none".
        starts: How many searches for each alternative.
        seed: Seed of all but the first start of each.
        tolerance: Projected gradient at which a search ends, in tolerances of the goals.
        chain: Another model of the process, as in `tune`.
        progress: Called with a sentence as alternatives and their stages go by.
        store: Finished searches of any alternative, as in `tune`: none is run again.
        ended: Called with the name and the tuning of each alternative when it is done.

    Returns:
        The best alternative, the order of all, and the tuning of each.

    Raises:
        ValueError: if there is no alternative, or `tune` makes no sense of one.
    """
    if not alternatives:
        raise ValueError("`alternatives` is empty, must hold at least one job.")
    say = progress or (lambda _: None)
    # its signatures are those of one step and of a plan: here it may be either
    search: Callable[..., Tuning] = tune
    if store is not None and (old := outdated(store)):
        say(old)
    tunings: dict[str, Tuning] = {}
    for i, (name, job) in enumerate(alternatives.items()):
        say(f"choice {i + 1} of {len(alternatives)}: {name}")
        tunings[name] = search(
            *job,
            secondary,
            starts,
            seed,
            tolerance,
            chain=chain,
            progress=progress,
            store=None if store is None else _Part(store),
        )
        if ended is not None:
            ended(name, tunings[name])
    order = ranking(tunings, secondary)
    return Choice(order[0], order, tunings)


def ranking(tunings: Mapping[str, Tuning], secondary: str = "time") -> tuple[str, ...]:
    """The names of tunings, the best first, as `tune` ranks its starts.

    First those that are solved, by the secondary objective to six digits, or by the
    distance from the target where there is none; then those that keep the limits, by that
    distance; then the rest, by how far they exceed the limits. Of equals the one given
    first is the better.

    Args:
        tunings: Answers by name.
        secondary: What was made small: "time", "force" or "none".
    """
    over: dict[str, float] = {}
    for one in tunings.values():  # limits have different units: each counts by its largest
        for limit, excess in one.excesses.items():
            over[limit] = max(over.get(limit, 0.0), float(excess))

    def rank(name: str) -> tuple[int, float, float]:
        one, far = tunings[name], distance(tunings[name])
        if int(one.verdict) == Verdict.SOLVED:
            best = {"time": one.outcome.time, "force": one.outcome.force_max}
            # beyond this a search does not tell two costs apart: then the first given
            place = 0, float(f"{float(best.get(secondary, far)):.6g}"), 0.0
        elif int(one.statuses[one.best]) == Status.SOLVED:
            place = 1, far, 0.0
        else:
            shares = (float(e) / over[k] for k, e in one.excesses.items() if over[k] > 0)
            place = 2, max(shares, default=0.0), far
        # what is not a number is worse than all that is
        return place if np.isfinite(place).all() else (3, 0.0, 0.0)

    return tuple(sorted(tunings, key=rank))


def distance(tuning: Tuning) -> float:
    """Root of the sum of squared misses [tolerances]."""
    return float(np.sqrt(sum(float(miss) ** 2 for miss in tuning.misses.values())))
