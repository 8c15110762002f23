"""Relax: why a target cannot be met, and what would bring the texture nearer to it.

The multipliers of the nearest texture say by how much half its squared distance falls per
unit that a limit or a bound gives way. A tenth of a limit, or of the width of the bounds,
is what people can picture; further than that the prediction is not to be trusted.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.table import Table

from .files.assemble import Job
from .files.config import Loaded
from .front_plot import aims, region_figure
from .interruption import keys
from .optimize.certificate import Status
from .optimize.choices import distance
from .optimize.explore import Explorer
from .optimize.tune import Tuning, Verdict
from .plots import save
from .report import LIMIT_UNITS, empty_table
from .units import from_internal, label, suffix


SHARE = 0.1
DRAWN = 128  # settings for the picture
SHAPE = ("Ssk", "Sku")
# name of a limit: where its number stands, and which way it gives way
NUMBERS = {
    "time": ("time", "more"),
    "force": ("force", "more"),
    "least removal": ("least_removal", "less"),
    "most removal": ("most_removal", "more"),
    "spread": ("spread", "more"),
}


class Relaxation(NamedTuple):
    """One limit or bound that holds the texture back."""

    what: str
    """What gives way."""
    by: str
    """By how much, with its unit."""
    distance: float
    """How far from the target the texture then is, to first order [tolerances]."""


def missed(tuning: Tuning) -> bool:
    """Whether the limits hold, and the target is out of reach."""
    status = int(tuning.statuses[tuning.best])
    return int(tuning.verdict) == Verdict.INFEASIBLE and status != Status.INFEASIBLE


def relaxations(tuning: Tuning, job: Job, loaded: Loaded) -> list[Relaxation]:
    """What would bring the texture nearer to the target, the most helpful first.

    Args:
        tuning: An answer that misses its target.
        job: What was asked, assembled; its goals are at the mean place.
        loaded: What was asked, as typed; of one step.
    """
    now, found, named = distance(tuning), [], keys(loaded)

    def then(gain: float) -> float:
        return float(np.sqrt(max(now**2 - 2 * gain, 0.0)))

    for name, multiplier in tuning.multipliers.items():
        number, way = NUMBERS.get(name, (None, ""))
        if number is None or float(multiplier) <= 0:
            continue
        size, unit = SHARE * float(getattr(job.limits, number)), LIMIT_UNITS[name]
        by = f"{from_internal(size, unit):.3g} {label(unit)} {way}"
        found.append(Relaxation(f"limit on {name}", by, then(float(multiplier) * size)))
    for name, multiplier in tuning.bound_multipliers.items():
        value, (low, high) = float(multiplier), job.between[name]
        key, size = named[name], SHARE * (high - low)
        unit, side, way = (
            suffix(key),
            *(("upper", "more") if value > 0 else ("lower", "less")),
        )
        if value:
            by = f"{from_internal(size, unit):.3g} {label(unit)} {way}"
            what = f"{side} bound of {name.replace('_', ' ')}"
            found.append(Relaxation(what, by, then(abs(value) * size)))
    near = (one for one in found if now - one.distance > 1e-3 * now)
    return sorted(near, key=lambda one: one.distance)


def relax_table(tuning: Tuning, job: Job, loaded: Loaded) -> Table | None:
    """What to relax, as a table; None where there is nothing to say.

    Args:
        tuning: The answer.
        job: What was asked, assembled.
        loaded: What was asked, as typed; of one step.
    """
    if not missed(tuning) or any(goal.worst for goal in job.target.values()):
        return None
    found = relaxations(tuning, job, loaded)
    if not found:
        return None
    head = f"distance, now {distance(tuning):.3g} tolerances"
    table = empty_table("What to relax", "", "by", head)
    for one in found:
        table.add_row(one.what, one.by, f"{one.distance:.3g}")
    return table


def draw_reach(tuning: Tuning, job: Job, target: Path) -> None:
    """`region.png`: settings drawn at random, the target, and the nearest texture.

    Args:
        tuning: The answer.
        job: What was asked.
        target: The folder; exists.
    """
    both = [name for name in SHAPE if name in job.target]
    rest = [name for name in (*job.target, *SHAPE) if name not in both]
    x, y, *_ = [*both, *rest]
    explorer = Explorer(job.setup, job.process, job.between, job.target, job.limits, (x, y))
    drawn = np.stack([explorer.shown(i) for i in range(2)], axis=1)[explorer.over <= 0]
    answer = [float(getattr(tuning.outcome, name)) for name in (x, y)]
    goals = aims(job.target, (x, y))
    save(region_figure((x, y), drawn, goals, answer), target / "region.png")


def pointer(loaded: Loaded, target: Path, drawn: bool = True) -> str:
    """Where the pictures are that show why, in a sentence.

    Args:
        loaded: The config.
        target: The folder.
        drawn: Whether `region.png` is there.
    """
    path = target / "optimum.yaml" if loaded.chosen else loaded.path
    seen = f"{target / 'region.png'} shows what can be reached. " if drawn else ""
    return (
        f"{seen}The edge of what can be reached, and what each step nearer to the target "
        f"costs: python -m polishopt.front {path} -o {target}"
    )
