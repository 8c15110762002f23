"""Plan report: what the steps of a plan do, as tables, as files and as a picture."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from .files.answered import optimum
from .files.assemble import PlanJob
from .files.config import Loaded
from .files.document import write_text
from .files.results import write_json, write_table
from .optimize.goals import all_excesses, all_misses, reached
from .optimize.tune import Tuning, Verdict
from .optimize.uncertainty import Spread
from .plan import PlanOutcome
from .plots import save
from .postprocess import Programs
from .report import (
    CLOSE,
    INDEPENDENT,
    LIMIT_UNITS,
    SPREAD_UNITS,
    answers,
    deviations,
    empty_table,
    missed,
    preflight_table,
    spread_table,
)
from .results import spread_numbers, versions
from .units import from_internal, label, suffix


LAST = "Spread from constants, last step"
# outcome of a step: unit in which it is shown, and what it is
COLUMNS = {
    "time": ("min", "time"),
    "force": ("N", "force"),
    "mean_removal": ("um", "removal"),
    "Sz_before": ("um", "Sz before"),
    "Sa": ("nm", "Sa"),
    "Sq": ("nm", "Sq"),
    "Ssk": ("", "Ssk"),
    "Sku": ("", "Sku"),
}


def numbers(outcome: PlanOutcome) -> list[list[float]]:
    """One row for each step, in the units of `COLUMNS`."""
    return [
        [
            from_internal(float(getattr(step, name)), unit)
            for name, (unit, _) in COLUMNS.items()
        ]
        for step in outcome.steps
    ]


def exceeded(job: PlanJob, outcome: PlanOutcome) -> dict[str, str]:
    """The limits that do not hold, and by how much, in words."""
    found = {}
    for name, excess in all_excesses(outcome, job.limits).items():
        limit = next(known for known in LIMIT_UNITS if name.endswith(f" {known}"))
        unit = LIMIT_UNITS[limit]
        over = from_internal(float(excess), unit)
        if over > CLOSE:
            found[name] = f"{over:.3g} {label(unit)}"
    return found


def verdict(
    job: PlanJob,
    outcome: PlanOutcome,
    tuning: Tuning | None,
    made: Sequence[Programs] = (),
) -> tuple[int, str]:
    """Exit code, and how it ended in a sentence.

    Args:
        job: What was asked.
        outcome: What the steps do.
        tuning: The answer, if anything was tuned.
        made: What the machine will make of the paths of the steps.
    """
    broken = exceeded(job, outcome)
    if tuning is not None and int(tuning.verdict) == Verdict.NOT_CONVERGED:
        return 4, "Not converged: no search ended within its work. Try more starts."
    if broken:
        listed = ", ".join(f"{name} by {over}" for name, over in broken.items())
        return 3, f"Infeasible: these limits are exceeded: {listed}."
    off = {
        name: float(miss)
        for name, miss in all_misses(outcome, job.target).items()
        if abs(float(miss)) > 1e-3
    }
    if tuning is not None and off:
        listed = ", ".join(f"{name} by {abs(m):.3g} tolerances" for name, m in off.items())
        return (
            3,
            f"Infeasible: within the limits the target cannot be met. Missed: {listed}.",
        )
    for name, one in zip(outcome.names, made, strict=False):
        if one.prevented:
            reason = f"the machine cannot run the path of {name}. {one.prevented[0]}"
            return 3, f"Infeasible: {reason}"
    if tuning is not None:
        return 0, "Solved: the targets are met and all limits hold."
    return 0, "Nothing is tuned: the plan was run as it stands, and all limits hold."


def show(
    console: Console,
    job: PlanJob,
    outcome: PlanOutcome,
    loaded: Loaded,
    tuning: Tuning | None,
    spreads: Sequence[Spread] = (),
    made: Sequence[Programs] = (),
) -> None:
    """Prints the tables of a plan.

    Args:
        console: Where to.
        job: What was asked, assembled.
        outcome: What the steps do.
        loaded: What was asked, as typed.
        tuning: The answer, if anything was tuned.
        spreads: What the errors of the constants do to each step, if any is given.
        made: What the machine will make of the paths of the steps.
    """
    console.print(steps_table(outcome))
    console.print(f"All steps take {float(outcome.time) / 60:.1f} min.")
    if spreads:
        console.print(spreads_table(outcome, spreads))
        console.print(INDEPENDENT)
        console.print(spread_table(spreads[-1], outcome.last, LAST))
    if tuning is not None:
        table = empty_table("Tuned", "", "unit", "answer", "bounds")
        bounds = {
            f"{step} {key}": value.between
            for step, config in loaded.steps
            for key, value in config.tuned().items()
        }
        for name, value in answers(tuning, loaded).items():
            (low, high), unit = bounds[name], suffix(name)
            word = name.removesuffix("_" + unit).replace("_", " ")
            table.add_row(word, label(unit), f"{value:.5g}", f"{low:g} … {high:g}")
        console.print(table)
        goals = empty_table(
            "Targets", "", "unit", "target", "reached", "miss in tolerances"
        )
        for name, goal in job.target.items():
            step, parameter = name.rsplit(" ", 1)
            unit = COLUMNS[parameter][0]
            at = outcome.steps[outcome.names.index(step)]
            found = float(reached(at, parameter, goal))
            goals.add_row(
                f"{name}, worst place" if goal.worst else name,
                label(unit),
                f"{from_internal(float(goal.value), unit):.4f}",
                f"{from_internal(found, unit):.4f}",
                f"{missed(tuning.misses, name, goal):+.2g}",
            )
        console.print(goals)
    if made:
        console.print(preflight_table(dict(zip(outcome.names, made, strict=True))))
    console.print(verdict(job, outcome, tuning, made)[1])


def steps_table(outcome: PlanOutcome) -> Table:
    """What each step does, one row a step."""
    heads = [f"{title}\n{label(unit)}" for unit, title in COLUMNS.values()]
    table = empty_table("Steps", "", *heads)
    for name, row in zip(outcome.names, numbers(outcome), strict=True):
        table.add_row(name, *(f"{value:.4g}" for value in row))
    return table


def spreads_table(outcome: PlanOutcome, spreads: Sequence[Spread]) -> Table:
    """What the errors of constants do to each step, one row a step."""
    shown = ("force_max", "unstick_margin", "mean_removal", "Sa", "Sq", "Ssk", "Sku")
    words = {"force_max": "force", "unstick_margin": "unstick", "mean_removal": "removal"}
    units = {name: SPREAD_UNITS[name][0] for name in shown}
    heads = [f"{words.get(name, name)}\n{label(units[name])}" for name in shown]
    table = empty_table("Steps, ± constants", "", *heads)
    for name, spread in zip(outcome.names, spreads, strict=True):
        row = deviations(spread)
        cells = (from_internal(row[key], units[key]) for key in shown)
        table.add_row(name, *(f"{cell:.2g}" for cell in cells))
    return table


def write(
    target: Path,
    job: PlanJob,
    outcome: PlanOutcome,
    loaded: Loaded,
    tuning: Tuning | None,
    spreads: Sequence[Spread] = (),
    made: Sequence[Programs] = (),
) -> None:
    """Writes the folder of a plan: numbers, the answer as a config, and a picture.

    Args:
        target: The folder; exists.
        job: What was asked, assembled.
        outcome: What the steps do.
        loaded: What was asked, as typed.
        tuning: The answer, if anything was tuned.
        spreads: What the errors of the constants do to each step, if any is given.
        made: What the machine will make of the paths of the steps.
    """
    scattered = dict(zip(outcome.names, spreads, strict=False))
    heads = ["step", *(f"{name} [{unit or '1'}]" for name, (unit, _) in COLUMNS.items())]
    rows = [[n, *r] for n, r in zip(outcome.names, numbers(outcome), strict=True)]
    write_table(target / "steps.csv", heads, rows)
    code, sentence = verdict(job, outcome, tuning, made)
    sentences = [[finding.sentence for finding in one.findings] for one in made]
    found = {} if tuning is None else answers(tuning, loaded)
    names = ("start map", "earlier scratches", "scratches", "ripple")
    search = {}
    if tuning is not None:
        search = {
            "misses_in_tolerances": tuning.misses,
            "limit_multipliers": tuning.multipliers,
            "goal_multipliers": tuning.goal_multipliers,
            "bound_multipliers": tuning.bound_multipliers,
            "kkt": tuning.kkt,
            "violation": tuning.violation,
            "end_distances_in_tolerances": tuning.distances,
            "end_statuses": tuning.statuses,
        }
    write_json(
        target / "result.json",
        {
            "verdict": Verdict(code).name.lower(),
            "sentence": sentence,
            "units": "mm, N, s, rad, MPa",
            **({"choice": loaded.chosen} if loaded.chosen else {}),
            "answers": found,
            "steps": {
                name: {
                    **{key: getattr(step, key) for key in (*COLUMNS, "Sz", "pressure")},
                    "texture_parts": {
                        part: {"k2_mm2": k.k2, "k3_mm3": k.k3, "k4_mm4": k.k4}
                        for part, k in zip(names, step.parts, strict=True)
                    },
                    **spread_numbers(scattered.get(name)),
                }
                for name, step in zip(outcome.names, outcome.steps, strict=True)
            },
            "preflight": dict(zip(outcome.names, sentences, strict=False)),
            "limit_excesses": all_excesses(outcome, job.limits),
            **search,
            "versions": versions(),
            "config": loaded.text,
        },
    )
    write_text(target / "optimum.yaml", optimum(loaded, found, target))
    save(picture(outcome), target / "steps.png")


def picture(outcome: PlanOutcome) -> Figure:
    """Roughness, shape of the heights, and removal after each step."""
    rows = dict(zip(COLUMNS, np.asarray(numbers(outcome)).T, strict=True))
    place = np.arange(len(outcome.names))
    figure, axes = plt.subplots(1, 3, figsize=(12, 3.6), layout="constrained")
    for name, marker in (("Sq", "o-"), ("Sa", "s--")):
        axes[0].plot(place, rows[name], marker, label=name)
    axes[0].set(yscale="log", ylabel="roughness after the step [nm]")
    axes[1].plot(place, rows["Ssk"], "o-", label="Ssk")
    axes[1].plot(place, rows["Sku"] - 3, "s--", label="Sku − 3")
    axes[1].axhline(0, color="0.7", linewidth=0.8, zorder=0)
    axes[1].set(ylabel="shape of the heights [-]")
    axes[2].plot(place, rows["mean_removal"], "o-", label="removed")
    axes[2].plot(place, rows["Sz_before"], "s--", label="Sz before the step")
    axes[2].set(yscale="log", ylabel="depth [µm]")
    for axis in axes:
        axis.set_xticks(place, outcome.names, rotation=45, ha="right")
        axis.legend()
    return figure
