"""Choice_report: what became of each combination of choices, on the screen and as CSV."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table
from rich.text import Text

from .files.assemble import NAMES
from .files.choices import title
from .files.config import Loaded
from .files.results import write_table
from .optimize.choices import distance
from .optimize.tune import Tuning, Verdict
from .report import SYMBOLS, answers, empty_table
from .units import from_internal, label, suffix


TABLE = "choices.csv"
SAME = 1e-3  # of a cost: no more than this is no reason to prefer one


class Row(NamedTuple):
    """What became of one combination."""

    number: int
    """As the combinations were listed, from 1."""
    rank: int
    """From 1, the best; 0 where it was not tuned."""
    chosen: Mapping[str, str]
    """Its alternatives, by key."""
    verdict: str
    """How it ended."""
    distance: float
    """From the target, root of the sum of squared misses [tolerances]; NaN if not tuned."""
    time: float
    """[s]"""
    force: float
    """The largest [N]."""
    settings: Mapping[str, float]
    """What was tuned, by its key and in the unit of that."""
    why: str
    """What is wrong with it, in a sentence or two; '' for nothing."""


def rows(
    alternatives: Sequence[Loaded],
    tunings: Mapping[str, Tuning],
    order: Sequence[str],
    said: Mapping[str, str],
    cannot: Mapping[str, str],
) -> list[Row]:
    """One row for each combination, as they were listed.

    Args:
        alternatives: All combinations.
        tunings: Those that were tuned, by name.
        order: Their names, the best first.
        said: How each of them ended, in a sentence.
        cannot: Why the machine cannot run a combination, by name.
    """
    found = []
    for i, one in enumerate(alternatives):
        name, tuning = one.name, tunings.get(one.name)
        why = cannot.get(name, "")
        if tuning is None:
            verdict = "infeasible" if why else "not tuned"
            nan = float("nan")
            row = Row(i + 1, 0, one.chosen, verdict, nan, nan, nan, {}, why)
            found.append(row)
            continue
        verdict = "infeasible" if why else word(tuning)
        if not why and verdict != "solved":
            why = said[name]
        outcome = tuning.outcome
        row = Row(
            i + 1,
            order.index(name) + 1,
            one.chosen,
            verdict,
            distance(tuning),
            float(outcome.time),
            float(outcome.force_max),
            answers(tuning, one),
            why,
        )
        found.append(row)
    return found


def word(tuning: Tuning) -> str:
    """How a tuning ended, in a word or two."""
    return Verdict(int(tuning.verdict)).name.lower().replace("_", " ")


def brief(tuning: Tuning, secondary: str) -> str:
    """What became of a tuning, in half a sentence.

    Args:
        tuning: The answer.
        secondary: What was made small.
    """
    force, minutes = float(tuning.outcome.force_max), float(tuning.outcome.time) / 60
    cost = f"{force:.4g} N" if secondary == "force" else f"{minutes:.4g} min"
    return f"{word(tuning)}, {distance(tuning):.3g} tolerances from the target, {cost}"


def show(console: Console, found: Sequence[Row], secondary: str) -> None:
    """Prints what became of the combinations, and which is the best.

    Args:
        console: Where to.
        found: From `rows`.
        secondary: What was made small.
    """
    made, lines = table(found, secondary, console.width), notes(found)
    if not set(found[0].chosen) <= {c.header for c in made.columns}:
        lines = [*listed(found), *lines]
    best = next(row for row in found if row.rank == 1)
    alike = [
        str(row.number)
        for row in found
        if secondary != "none"
        and row.verdict == best.verdict == "solved"
        and row is not best
        and cost(row, secondary) <= (1 + SAME) * cost(best, secondary)
    ]
    also = f" As good to {100 * SAME:g} %: {', '.join(alike)}." if alike else ""
    lines.append(f"Best: {title(best.chosen)}.{also} All settings are in {TABLE}.\n")
    console.print(made)
    console.print(Text("\n".join(lines)))


def table(found: Sequence[Row], secondary: str, width: int) -> Table:
    """The combinations for the screen, the best first; those that were not tuned last.

    Their settings, and then their alternatives, are left out where there is no room.

    Args:
        found: From `rows`.
        secondary: What was made small.
        width: Letters in a line.
    """
    order = sorted(found, key=lambda row: row.rank or len(found) + row.number)
    force = secondary == "force"
    numbers = {"": [str(row.number) for row in order]}
    keys = {key: [row.chosen[key] for row in order] for key in found[0].chosen}
    ends = {
        "ended": [row.verdict for row in order],
        "distance\ntolerances": [_number(shown(row)) for row in order],
        "force\nN" if force else "time\nmin": [
            _number(cost(row, secondary)) for row in order
        ],
    }
    settings = {
        _symbol(key): [_number(row.settings.get(key, np.nan)) for row in order]
        for key in _settings(found)
    }
    columns = numbers | keys | ends | settings
    for fewer in (numbers | keys | ends, numbers | ends | settings, numbers | ends):
        if sum(map(_wide, columns.items())) > width:
            columns = fewer
    made = empty_table("Choices", *columns)
    for column, head in zip(made.columns, columns, strict=True):
        column.justify = "left" if head in (*keys, "ended") else "right"
    for row, cells in zip(order, zip(*columns.values(), strict=True), strict=True):
        made.add_row(*cells, style="bold" if row.rank == 1 else "")
    return made


def _symbol(key: str) -> str:
    """A setting over a column: its symbol and unit, in a plan below the step."""
    step, _, word = key.rpartition(" ")
    unit = suffix(word)
    plain = word.removesuffix(f"_{unit}") if unit else word
    symbol = SYMBOLS[NAMES.get(plain, plain)] or plain
    return "\n".join(filter(None, (step, symbol, label(unit))))


def _wide(column: tuple[str, Sequence[str]]) -> int:
    """Letters that a column of a table takes."""
    head, cells = column
    return 2 + max(map(len, (*head.splitlines(), *cells)))


def _number(value: float) -> str:
    """A number for the screen; nothing where there is none."""
    return "" if np.isnan(value) else f"{value:.4g}"


def listed(found: Sequence[Row]) -> list[str]:
    """The numbers of the combinations, and what they stand for."""
    return [f"{row.number}: {title(row.chosen)}" for row in found]


def notes(found: Sequence[Row]) -> list[str]:
    """What is wrong with combinations, a sentence for those of which the same is true."""
    alike: dict[str, list[str]] = {}
    for row in found:
        if row.why:
            alike.setdefault(row.why, []).append(str(row.number))
    return [f"{', '.join(numbers)}: {why}" for why, numbers in alike.items()]


def write(found: Sequence[Row], path: Path) -> None:
    """The combinations as a CSV table, in their order.

    Args:
        found: From `rows`.
        path: Where to.
    """
    settings = _settings(found)

    def cell(value: float):
        return "" if np.isnan(value) else value

    heads = ["choice", *found[0].chosen, "rank", "verdict", "distance [tolerances]"]
    heads += ["time [min]", "force [N]", *settings, "why"]
    write_table(
        path,
        heads,
        [
            [
                row.number,
                *row.chosen.values(),
                row.rank or "",
                row.verdict,
                cell(row.distance),
                cell(from_internal(row.time, "min")),
                cell(row.force),
                *(row.settings.get(key, "") for key in settings),
                row.why,
            ]
            for row in found
        ],
    )


def shown(row: Row) -> float:
    """The distance, zero where it is below what a search resolves."""
    return 0.0 if row.verdict == "solved" else row.distance


def cost(row: Row, secondary: str) -> float:
    """Largest force [N], or time [min]."""
    return row.force if secondary == "force" else from_internal(row.time, "min")


def _settings(found: Sequence[Row]) -> list[str]:
    """All settings that were tuned in any combination."""
    return list(dict.fromkeys(key for row in found for key in row.settings))
