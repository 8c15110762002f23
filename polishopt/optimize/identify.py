"""Identify: what a set of measurements cannot tell apart.

Two constants that move every measurement alike are known only as a product or a quotient.
More generally the Fisher information has directions along which the data say less than the
prior: whatever lies along them is left as it was.
"""

from typing import NamedTuple

import numpy as np

from .calibrate import PRIORS, Calibration


# Cosine between the slopes of two constants from which they count as one.
ALIKE = 1 - 1e-6
# Information, in that of the prior, below which a direction is left to the prior.
SILENT = 1.0
# Share of a constant in such directions from which it is named.
NAMED = 0.1
# Correlation from which a pair is worth a word.
STRONG = 0.8


class Alike(NamedTuple):
    """Two constants of which only a product of powers is known."""

    first: str
    second: str
    power: float
    """The data know first * second^power only."""
    held: bool
    """Whether the second was not estimated, but taken from the config."""


class Open(NamedTuple):
    """Constants of which the data know fewer numbers than there are."""

    names: tuple[str, ...]
    known: int
    """How many combinations of them the data determine."""


class Pair(NamedTuple):
    """Two constants whose errors go together."""

    first: str
    second: str
    correlation: float


def alike(calibration: Calibration) -> list[Alike]:
    """Pairs that move all measurements alike, each with one that was estimated.

    Args:
        calibration: The answer.
    """
    names = (*calibration.names, *calibration.held)
    slopes = np.asarray(calibration.slopes)
    length = np.linalg.norm(slopes, axis=0)
    seen = length > 1e-6 * max(length.max(initial=0.0), 1e-300)
    linear = {name for name, prior in PRIORS.items() if prior.link == "plain"}
    result = []
    for i, first in enumerate(calibration.names):
        for j in range(i + 1, len(names)):
            if not (seen[i] and seen[j]) or {first, names[j]} & linear:
                continue
            together = slopes[:, i] @ slopes[:, j]
            if abs(together) >= ALIKE * length[i] * length[j]:
                power = together / length[i] ** 2
                held = j >= len(calibration.names)
                result.append(Alike(first, names[j], float(power), held))
    return result


def left_open(calibration: Calibration) -> list[Open]:
    """Groups of constants that the data do not determine one by one.

    A group is what directions without information connect. A group of one, of which
    nothing is known, is a constant that no measurement sees.

    Args:
        calibration: The answer.
    """
    size, axes = np.linalg.eigh(np.asarray(calibration.information))
    silent = axes[:, size < SILENT]
    shared = silent @ silent.T
    linked = np.abs(shared) > NAMED
    result, left = [], np.flatnonzero(linked.any(axis=1)).tolist()
    while left:
        group, edge = [], [left.pop(0)]
        while edge:
            group.append(edge.pop())
            reached = [j for j in left if linked[group[-1], j]]
            left = [j for j in left if j not in reached]
            edge += reached
        group.sort()
        unknown = float(np.trace(shared[np.ix_(group, group)]))
        names = tuple(calibration.names[i] for i in group)
        result.append(Open(names, max(0, len(group) - max(1, round(unknown)))))
    return result


def correlated(calibration: Calibration) -> list[Pair]:
    """Pairs of constants whose errors are strongly correlated, the strongest first.

    Args:
        calibration: The answer.
    """
    covariance = np.asarray(calibration.covariance)
    error = np.sqrt(np.diag(covariance))
    matrix = covariance / np.outer(error, error)
    pairs = [
        Pair(first, second, float(matrix[i, j]))
        for i, first in enumerate(calibration.names)
        for j, second in enumerate(calibration.names)
        if i < j and abs(matrix[i, j]) >= STRONG
    ]
    return sorted(pairs, key=lambda pair: -abs(pair.correlation))
