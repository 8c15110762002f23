"""Front_plot: a front between two outcomes, and the region that two of them can reach."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon, Rectangle

from .optimize.explore import MISS
from .optimize.front import Front, Region
from .optimize.goals import Goal
from .plots import BLUE, GREY, ORANGE, PINK, SKY
from .report import SPREAD_UNITS
from .units import from_internal, label


class Aim(NamedTuple):
    """A goal as it is drawn."""

    value: float
    """Where it is, in the unit of its outcome."""
    tolerance: float
    """How far off it may be."""


def aims(
    goals: Mapping[str, Goal], names: tuple[str, str], last: str = ""
) -> dict[str, Aim]:
    """The goals for two outcomes as they are drawn.

    Args:
        goals: The target.
        names: The outcomes.
        last: In a plan, how the names of the goals of its last step begin.
    """
    found = {name: goals.get(name) or goals.get(last + name) for name in names}
    return {
        name: Aim(float(goal.value), float(goal.tolerance))
        for name, goal in found.items()
        if goal is not None
    }


def unit(name: str) -> str:
    """The unit in which an outcome is shown, as a suffix; '' for none."""
    word = name.rpartition(" ")[2]
    return {"force": "N"}.get(word) or SPREAD_UNITS.get(word, ("",))[0]


def title(name: str) -> str:
    """What an outcome is called on an axis, with its unit."""
    if name == MISS:
        return "largest miss of a goal [tolerances]"
    return f"{name.replace('_', ' ')} [{label(unit(name)) or '-'}]"


def bare(name: str) -> str:
    """The unit in which an outcome is shown, to be divided or divided by."""
    return "tolerance" if name == MISS else label(unit(name)) or "1"


def shown(name: str, values):
    """Values of an outcome in the unit in which it is shown."""
    return np.asarray(values, float) * from_internal(1.0, unit(name))


def front_figure(found: Front) -> Figure:
    """A front: what a level of the second outcome costs of the first.

    Args:
        found: The front.
    """
    first, second = found.names
    figure = Figure((7.2, 4.8), layout="constrained")
    axes = figure.subplots()
    points = np.asarray([point.values for point in found.points], float).reshape(-1, 2)
    y, x = shown(first, points[:, 0]), shown(second, points[:, 1])
    axes.plot(x, y, "o-", color=BLUE, label="the best there is")
    drawn = shown(second, found.drawn[:, 1]), shown(first, found.drawn[:, 0])
    axes.plot(*drawn, ".", color=GREY, markersize=3, zorder=0, label="drawn at random")
    _around(axes, x, y, drawn)
    _named(axes, second, first)
    axes.set_title(f"What {_word(second)} costs of {_word(first)}, within the limits")
    axes.legend(frameon=False)
    return figure


def region_figure(
    names: tuple[str, str],
    drawn: Float[np.ndarray, "m 2"],
    aims: Mapping[str, Aim],
    answer: Sequence[float] | None = None,
    found: Region | None = None,
) -> Figure:
    """What two outcomes can be together, with the target and the answer.

    Args:
        names: The outcomes.
        drawn: What settings at random do within the limits.
        aims: The goals, by the names of the outcomes; one, both or none.
        answer: Both outcomes of the answer.
        found: The region; None if only the drawn settings are known.
    """
    figure = Figure((7.2, 5.2), layout="constrained")
    axes = figure.subplots()
    dots = [shown(name, drawn[:, i]) for i, name in enumerate(names)]
    marked = [dots]
    axes.plot(*dots, ".", color=GREY, markersize=4, label=f"{len(drawn)} drawn at random")
    if found is not None and len(found.outline):
        edge = [shown(name, found.outline[:, i]) for i, name in enumerate(names)]
        patch = Polygon(
            np.stack(edge, axis=1), facecolor=SKY, edgecolor=BLUE, alpha=0.5, zorder=0
        )
        patch.set_label("within reach")
        axes.add_patch(patch)
        marked.append(edge)
    box = [aims.get(name) for name in names]
    marked.append(_target(axes, names, box))
    if answer is not None:
        at = [shown(name, value) for name, value in zip(names, answer, strict=True)]
        axes.plot(*at, "D", color=PINK, markersize=7, label="answer")
        marked.append([np.atleast_1d(part) for part in at])
    both = (np.concatenate([part[i] for part in marked]) for i in range(2))
    _limits(axes, *both)
    _named(axes, *names)
    axes.set_title("What can be reached within the limits")
    axes.legend(frameon=False)
    return figure


def _target(axes: Axes, names: tuple[str, str], box: Sequence[Aim | None]):
    """Draws the target and its tolerances; of one outcome alone, as a band."""
    ends = [
        shown(name, [aim.value - aim.tolerance, aim.value + aim.tolerance]) if aim else None
        for name, aim in zip(names, box, strict=True)
    ]
    x, y = ends
    if x is not None and y is not None:
        corner, sides = (x[0], y[0]), (np.ptp(x), np.ptp(y))
        axes.add_patch(Rectangle(corner, *sides, fill=False, edgecolor=ORANGE))
        axes.plot(x.mean(), y.mean(), "+", color=ORANGE, markersize=12, label="target")
        return [x, y]
    none = np.empty(0)
    if x is not None:
        axes.axvspan(*x, color=ORANGE, alpha=0.25, label="target")
        return [x, none]
    if y is not None:
        axes.axhspan(*y, color=ORANGE, alpha=0.25, label="target")
        return [none, y]
    return [none, none]


def _around(axes: Axes, x: np.ndarray, y: np.ndarray, drawn) -> None:
    """Shows the front, and of what was drawn as much as lies about it."""
    if not x.size:
        return
    wide = [max(np.ptp(part), 1e-9 + 0.05 * np.max(np.abs(part))) for part in (x, y)]
    near = np.ones(len(drawn[0]), bool)
    for part, has, w in zip((x, y), drawn, wide, strict=True):
        near &= (has > part.min() - 0.2 * w) & (has < part.max() + w)
    both = zip((x, y), drawn, strict=True)
    _limits(axes, *(np.concatenate([part, has[near]]) for part, has in both))


def _limits(axes: Axes, x: np.ndarray, y: np.ndarray) -> None:
    for values, put in ((x, axes.set_xlim), (y, axes.set_ylim)):
        values = values[np.isfinite(values)]
        if values.size:
            low, high = values.min(), values.max()
            room = 0.06 * (high - low) or 0.05 * abs(high) or 1.0
            put(low - room, high + room)


def _named(axes: Axes, x: str, y: str) -> None:
    axes.set_xlabel(title(x))
    axes.set_ylabel(title(y))
    axes.spines[["top", "right"]].set_visible(False)


def _word(name: str) -> str:
    return "a nearer target" if name == MISS else name.replace("_", " ")
