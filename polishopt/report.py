"""Report: an answer in words and tables, for the person at the machine.

Numbers are shown in the units of the trade, with the symbols of the papers beside the
words.
"""

import math
import re
from collections.abc import Mapping
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from .chain import Outcome
from .files.assemble import NAMES, Job
from .files.config import Loaded
from .files.quantity import Tuned
from .files.schema import StepConfig
from .optimize.attribution import Attribution
from .optimize.certificate import Status
from .optimize.goals import Goal, Limits, band_names, reached
from .optimize.tune import Tuning, Verdict
from .optimize.uncertainty import Spread
from .parts import Process, Scalar
from .postprocess import Programs
from .preflight import Finding
from .units import from_internal, label, suffix


SYMBOLS = {
    "tilt": "θ",
    "displacement": "e",
    "step": "p",
    "trochoid_radius": "D_tr",
    "feed": "V_f",
    "spin": "N",
    "passes": "",
    **{f"shift_{way}": f"Δ{way}" for way in "xyz"},
    **{f"wedge_{way}": f"α_{way}" for way in "xyz"},
}
# name of a limit: unit in which it is shown
LIMIT_UNITS = {
    "time": "min",
    "force": "N",
    "least removal": "um",
    "most removal": "um",
    "removal over Sz before": "um",
    "spread": "percent",
    "unstick force": "N",
    "adhesive shear": "MPa",
    "rigid body": "mm",
}
# name of a limit: the outcome whose spread is that of what is left
LIMITED = {
    "time": "time",
    "force": "force_max",
    "least removal": "mean_removal",
    "most removal": "mean_removal",
    "unstick force": "unstick_margin",
    "adhesive shear": "shear_margin",
}
# outcome: unit in which it is shown, and what it is
OUTCOME_UNITS = {
    "Sa": ("nm", "mean height (estimate)"),
    "Sq": ("nm", "rms height"),
    "force": ("N", "force, mean over time"),
    "force_max": ("N", "force, largest"),
    "force_min": ("N", "force, smallest along the path"),
    "displacement_max": ("mm", "displacement, largest"),
    "pressure": ("MPa", "mean contact pressure"),
    "contact_area": ("mm2", "contact area"),
    "effective_diameter": ("mm", "width wiped, D_eff"),
    "envelope": ("mm", "width of the strip, E"),
    "time": ("min", "time"),
    "feed": ("mm_min", "feed reached, mean"),
    "path_length": ("mm", "contact path"),
    "mean_removal": ("um", "removal, mean"),
    "spread": ("percent", "removal, spread (coarse nodes)"),
    "ripple": ("percent", "removal, ripple"),
}
SPREAD_UNITS = {
    "Ssk": ("", "skewness"),
    "Sku": ("", "kurtosis"),
    "unstick_margin": ("N", "force left to unsticking"),
    "shear_margin": ("MPa", "shear stress left"),
    **OUTCOME_UNITS,
}
LEAST_SHARE = 0.1  # of the variance: constants with less are not named
INDEPENDENT = (
    "± constants is a standard deviation to first order, with the errors of the constants "
    "independent of each other."
)
CLOSE = 1e-6  # a limit or bound nearer than this share of its size counts as reached


def key_of(name: str) -> str:
    """The key in a config, without its unit, of a setting of `Process`."""
    return {inner: outer for outer, inner in NAMES.items()}.get(name, name)


def named(process: Process, config: StepConfig) -> dict[str, float]:
    """The tuned settings of a step by the keys, and in the units, of its config."""
    result = {}
    for key in config.tuned():
        unit = suffix(key)
        word = key.removesuffix("_" + unit) if unit else key
        value = getattr(process, NAMES.get(word, word))
        result[key] = from_internal(float(value), unit)
    return result


def answers(tuning: Tuning, loaded: Loaded) -> dict[str, float]:
    """The tuned settings by the keys, and in the units, of the config.

    In a plan each carries the name of its step: `P600 tilt_deg`.
    """
    if not loaded.steps:
        return named(tuning.process, loaded.config)
    return {
        f"{name} {key}": value
        for (name, config), process in zip(loaded.steps, tuning.process, strict=True)
        for key, value in named(process, config).items()
    }


def summary(outcome: Outcome, job: Job) -> str:
    """What the target asks for, as it is in an outcome."""
    shown = []
    for name, goal in job.target.items():
        unit = OUTCOME_UNITS.get(name, ("", ""))[0]
        value = from_internal(float(reached(outcome, name, goal)), unit)
        there = " at the worst place" if goal.worst else ""
        shown.append(f"{name} = {value:.3f} {label(unit)}".rstrip() + there)
    return ", ".join(shown)


def ended(tuning: Tuning, programs: Programs | None) -> Verdict:
    """How it ended, once it is known whether the machine can run the path."""
    kind = Verdict(int(tuning.verdict))
    prevented = programs is not None and programs.prevented
    return Verdict.INFEASIBLE if kind is Verdict.SOLVED and prevented else kind


def verdict(tuning: Tuning, programs: Programs | None = None) -> str:
    """How it ended, in a sentence that says what to do."""
    kind = Verdict(int(tuning.verdict))
    if kind is Verdict.SOLVED and programs is not None and programs.prevented:
        return f"Infeasible: the machine cannot run the path. {programs.prevented[0]}"
    if kind is Verdict.SOLVED:
        return "Solved: the target is met and all limits hold."
    if kind is Verdict.NOT_CONVERGED:
        return (
            "Not converged: no search ended within its work. Try more starts "
            "(solver.starts) or narrower bounds."
        )
    if int(tuning.statuses[tuning.best]) == Status.INFEASIBLE:
        broken = [name for name, over in tuning.excesses.items() if float(over) > 0]
        return f"Infeasible: these limits cannot all hold: {', '.join(broken)}."
    ways = conflict(tuning)
    blame = f" In the way: {', '.join(ways)}." if ways else ""
    missed = ", ".join(
        f"{name} by {abs(float(miss)):.3g} tolerances"
        for name, miss in tuning.misses.items()
        if float(miss)
    )
    return (
        f"Infeasible: within the limits the target cannot be met. The nearest texture "
        f"misses {missed}.{blame}"
    )


def conflict(tuning: Tuning) -> list[str]:
    """Limits and bounds that hold the texture back from the target, the heaviest first."""
    weights = {f"the limit on {k}": float(v) for k, v in tuning.multipliers.items()}
    for name, multiplier in tuning.bound_multipliers.items():
        value = float(multiplier)
        side = "upper" if value > 0 else "lower"
        reach = abs(value) * max(abs(float(getattr(tuning.process, name))), 1e-12)
        weights[f"the {side} bound of {name.replace('_', ' ')}"] = reach
    found = [name for name, weight in weights.items() if abs(weight) > 1e-9]
    return sorted(found, key=lambda name: -abs(weights[name]))


class Scatter(NamedTuple):
    """How far the numbers of one measured patch scatter."""

    side: float
    """Side of the patch [mm]."""
    errors: dict[str, float]
    """Standard error of each texture parameter [mm or -]."""


def show(
    console: Console,
    tuning: Tuning,
    job: Job,
    loaded: Loaded,
    scatter: Scatter,
    spread: Spread | None = None,
    programs: Programs | None = None,
) -> None:
    """Prints the tables of an answer.

    Args:
        console: Where to, without rich's markup: names may hold brackets.
        tuning: The answer.
        job: What was asked, assembled.
        loaded: What was asked, as typed.
        scatter: How far a measurement of the texture would scatter.
        spread: What the errors of the constants do, where any is given.
        programs: What the machine will make of the path.
    """
    console.print(_settings(tuning, loaded))
    console.print(_texture(tuning, job, scatter, spread))
    patch = f"one standard error of a measured patch of {scatter.side:.2g} mm"
    if spread is None:
        console.print(f"± is {patch}.")
    else:
        console.print(f"± patch is {patch}, ± constants what their errors make of it.")
    console.print(_limits(tuning, spread))
    if held_back := chance(job.limits):
        console.print(held_back)
    console.print(_outcomes(tuning))
    if spread is not None:
        console.print(spread_table(spread, tuning.outcome))
        console.print(INDEPENDENT)
    if programs is not None:
        console.print(preflight_table({"": programs}))
    count = tuning.statuses.shape[0]
    ended = int((tuning.statuses == Status.SOLVED).sum())
    work = int(tuning.evaluations.sum())
    console.print(
        f"{ended} of {count} searches ended at a stationary point, the best from start "
        f"{int(tuning.best) + 1}; {work} evaluations in all.\n"
        f"Certificate: projected gradient {float(tuning.kkt):.1e}, violation "
        f"{float(tuning.violation):.1e}."
    )
    console.print(verdict(tuning, programs))


def empty_table(title: str, *columns: str) -> Table:
    """A table without rows: the first column to the left, all others to the right."""
    table = Table(title=title, title_justify="left", title_style="bold", box=None)
    for i, column in enumerate(columns):
        table.add_column(column, justify="left" if i == 0 else "right", no_wrap=True)
    return table


def preflight_table(made: Mapping[str, Programs]) -> Table:
    """What the machine will make of each path, a sentence a row."""
    table = Table(title="Pre-flight", title_justify="left", title_style="bold", box=None)
    steps = any(made)
    for heading in ("step", "") if steps else ("",):
        table.add_column(heading)
    alike: dict[tuple[Finding, ...], list[str]] = {}
    for name, one in made.items():
        alike.setdefault(one.findings, []).append(name)
    for findings, names in alike.items():
        for i, finding in enumerate(findings):
            first = "\n".join(names) if i == 0 else ""
            table.add_row(*((first,) if steps else ()), finding.sentence)
    return table


def attribution_table(split: Attribution, first: str, second: str) -> Table:
    """The difference of two jobs by effect, in the units of the trade.

    Args:
        split: The shares.
        first: What the first job is called.
        second: What the second is.
    """
    table = empty_table(
        f"From {first} (first)\nto {second} (second)",
        *("", "first", "second", "change", *split.effects),
    )
    table.collapse_padding, table.pad_edge = True, False
    for i, name in enumerate(split.outcomes):
        unit = OUTCOME_UNITS.get(name, ("", ""))[0]
        ends = [from_internal(float(end[i]), unit) for end in (split.first, split.second)]
        shares = [from_internal(float(part), unit) for part in split.parts[i]]
        # as many decimals for all, so that the shares are seen to add up
        size = max(map(abs, ends))
        digits = max(3 - math.floor(math.log10(size)), 0) if size > 0 else 0
        table.add_row(
            f"{name.replace('_', ' ')} [{label(unit)}]" if unit else name,
            *(f"{value:.{digits}f}" for value in ends),
            *(f"{value:+.{digits}f}" for value in (ends[1] - ends[0], *shares)),
        )
    return table


def _settings(tuning: Tuning, loaded: Loaded) -> Table:
    table = empty_table("Settings", "", "symbol", "unit", "start", "answer", "bounds", "")
    found = answers(tuning, loaded)
    for key, value in loaded.config.process.given().items():
        unit = suffix(key)
        word = key.removesuffix("_" + unit) if unit else key
        symbol = SYMBOLS[NAMES.get(word, word)]
        name = word.replace("_", " ")
        if not isinstance(value, Tuned):
            shown = f"{value:g}"
            table.add_row(name, symbol, label(unit), shown, shown, "fixed", "")
            continue
        low, high = value.between
        answer = found[key]
        near = CLOSE * (high - low)
        note = "at lower" if answer - low <= near else ""
        note = "at upper" if high - answer <= near else note
        bounds = f"{low:g} … {high:g}"
        table.add_row(
            name, symbol, label(unit), f"{value.start:g}", f"{answer:.5g}", bounds, note
        )
    return table


def _texture(tuning: Tuning, job: Job, scatter: Scatter, spread: Spread | None) -> Table:
    errors = ("±",) if spread is None else ("± patch", "± constants")
    head = ("", "unit", "target", "reached", *errors, "miss in tolerances")
    table = empty_table("Texture", *head)
    induced = deviations(spread)
    for name, goal in job.target.items():
        unit = OUTCOME_UNITS.get(name, ("", ""))[0]
        aim = from_internal(float(goal.value), unit)
        found = from_internal(float(reached(tuning.outcome, name, goal)), unit)
        known = [e[name] for e in (scatter.errors, induced) if name in e]
        table.add_row(
            f"{name}, worst place" if goal.worst else name,
            label(unit),
            f"{aim:.4f}",
            f"{found:.4f}",
            *(f"{from_internal(error, unit):.2g}" for error in known),
            f"{missed(tuning.misses, name, goal):+.2g}",
        )
    return table


def missed(misses: Mapping[str, Scalar], name: str, goal: Goal) -> float:
    """How far a goal is missed, in tolerances; at the worst place, on its worse side."""
    sides = band_names(name) if goal.worst else (name,)
    return max((float(misses[side]) for side in sides), key=abs)


def deviations(spread: Spread | None) -> dict[str, float]:
    """Standard deviation of each outcome, by the errors of constants [mm, N, s, MPa]."""
    if spread is None:
        return {}
    return dict(zip(spread.outcomes, spread.deviations.tolist(), strict=True))


def short(constant: str) -> str:
    """A constant in a few words: `foundation`, `unstick forces[0]`, `Sq before`."""
    name = re.sub(r"start\.roughness\.(\w+)", r"\1 before", constant)
    return re.sub(r"(tool|abrasive)\.", "", name).replace("_", " ")


def spread_table(
    spread: Spread, outcome: Outcome, title: str = "Spread from constants"
) -> Table:
    """How far outcomes scatter with the errors of constants, and with which most."""
    table = empty_table(title, "", "unit", "value", "±", "share of the variance")
    table.columns[-1].justify, table.columns[-1].no_wrap = "left", False
    errors, shares = spread.deviations.tolist(), np.asarray(spread.shares)
    for name, error, row in zip(spread.outcomes, errors, shares, strict=True):
        unit, meaning = SPREAD_UNITS[name]
        value = from_internal(float(getattr(outcome, name)), unit)
        if not error or math.isinf(value):
            continue  # depends on no uncertain constant, or there is no such limit
        largest = [i for i in np.argsort(-row, kind="stable") if row[i] >= LEAST_SHARE]
        names = [f"{short(spread.constants[i])} {100 * row[i]:.0f} %" for i in largest]
        shown = f"{from_internal(error, unit):.2g}"
        table.add_row(meaning, label(unit), f"{value:.4g}", shown, ", ".join(names))
    return table


def chance(limits: Limits) -> str:
    """What is held back for a chance to come unstuck, in a sentence; '' for nothing."""
    if limits.unstick_quantile is None:
        return ""
    quantile = float(limits.unstick_quantile)
    return (
        f"Unstick force: left after {quantile:.3g} standard deviations, for a chance of "
        f"{100 * NormalDist().cdf(-quantile):.3g} % to come unstuck."
    )


def _limits(tuning: Tuning, spread: Spread | None) -> Table:
    errors = () if spread is None else ("± constants",)
    table = empty_table("Limits", "", "unit", "left", *errors, "", "one unit more is worth")
    induced = deviations(spread)
    solved = int(tuning.verdict) == Verdict.SOLVED
    for name, excess in tuning.excesses.items():
        unit = LIMIT_UNITS[name]
        left = from_internal(-float(excess), unit)
        multiplier = float(tuning.multipliers[name])
        active = multiplier > 1e-9
        gain = multiplier / from_internal(1.0, unit)
        worth = f"{gain:.3g} s" if solved else f"{gain:.3g} of the miss"
        error = induced.get(LIMITED.get(name, ""), 0.0)
        table.add_row(
            name,
            label(unit),
            f"{left:.4g}",
            *(f"{from_internal(error, unit):.2g}" if error else "" for _ in errors),
            "active" if active else "exceeded" if left < -CLOSE else "",
            worth if active else "",
        )
    return table


def _outcomes(tuning: Tuning) -> Table:
    table = empty_table("Outcome", "", "unit", "value")
    for name, (unit, meaning) in OUTCOME_UNITS.items():
        value = from_internal(float(getattr(tuning.outcome, name)), unit)
        table.add_row(meaning, label(unit), f"{value:.4g}")
    unstick = float(tuning.outcome.unstick_margin + tuning.outcome.force_max)
    if unstick < float("inf"):
        table.add_row("force that unsticks the disc here", "N", f"{unstick:.4g}")
    return table
