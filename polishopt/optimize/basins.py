"""Basins: the distinct answers that a tuning found, and from how many starts each.

One answer found from most starts is likely the best there is. Several of about the same
cost leave a choice, and one found from a single start says that more starts may pay.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from .certificate import Status
from .tune import Tuning


SAME = 1e-3  # widths of the bounds within which two answers are one


class Basin(NamedTuple):
    """One of the answers."""

    answer: dict[str, float]
    """The settings of its best member [mm, s, rad]."""
    cost: float
    """Secondary objective there [s or N]; 0 where the target is out of reach."""
    distance: float
    """Largest miss of a goal there, in tolerances."""
    starts: tuple[int, ...]
    """Numbers of the starts that led there, counted from 0."""


def basins(tuning: Tuning, between: Mapping[str, tuple[float, float]]) -> list[Basin]:
    """The answer and all others at stationary points that differ from it, the best first.

    Where the target was reached, only searches that went on to the least cost have an
    answer of their own: all others stopped somewhere in the family that meets the target.

    Args:
        tuning: The answer, with what became of all searches.
        between: Bounds of the settings, as they were tuned.
    """
    statuses, followed = np.asarray(tuning.statuses), np.asarray(tuning.followed)
    distances, costs = np.asarray(tuning.distances), np.asarray(tuning.costs)
    # the answer itself is one even where its search ran out of work
    ended = (statuses == Status.SOLVED) | (np.arange(statuses.size) == int(tuning.best))
    if followed.any():
        ended, rank = ended & followed, costs
    else:
        rank = distances
    names = list(between)
    width = np.asarray([high - low if high > low else 1 for low, high in between.values()])
    places = np.stack([np.asarray(tuning.answers[name]) for name in names], axis=1) / width
    found: list[list[int]] = []
    for i in (int(i) for i in np.argsort(rank, kind="stable") if ended[i]):
        near = (b for b in found if np.max(np.abs(places[b[0]] - places[i])) <= SAME)
        basin = next(near, None)
        if basin is None:
            found.append([i])
        else:
            basin.append(i)
    return [
        Basin(
            {name: float(tuning.answers[name][b[0]]) for name in names},
            float(costs[b[0]]),
            float(distances[b[0]]),
            tuple(sorted(b)),
        )
        for b in found
    ]
