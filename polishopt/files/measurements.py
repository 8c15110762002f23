"""Measurements: a table of what was measured at known settings, as a CSV file.

One row is one measurement: the settings it was made at, and what came out. Which columns
of it are filled says what was measured. A unit ends each name, as in a config; settings
that are not given are those of the config. Lines that begin with # are comments. Neither
JAX nor NumPy is imported.
"""

import csv
import io
import math
from dataclasses import dataclass
from pathlib import Path

from ..units import label, suffix, to_internal
from .document import ConfigError, Problem, read_text
from .quantity import Between
from .sentence import either, near


# column: where its numbers lie. Settings first, as in the section `process`.
SETTINGS = {
    "tilt_deg": "(0, 45]",
    "displacement_mm": "(0, 20]",
    "step_mm": "(0, 50]",
    "trochoid_radius_mm": "(0, 100]",
    "feed_mm_min": "(0, 1e5]",
    "spindle_rpm": "(0, 1e5]",
    "passes": "[1, 1000]",
}
# the texture before, where it was measured
BEFORE = {
    "start_Sq_nm": "(0, 1e6]",
    "start_Ssk": "[-20, 20]",
    "start_Sku": "[1, 1000]",
}
MEASURED = {
    "force_N": "(0, 1e4]",
    "removal_um": "(0, 1e4]",
    "Sa_nm": "(0, 1e6]",
    "Sq_nm": "(0, 1e6]",
    "Ssk": "[-20, 20]",
    "Sku": "[1, 1000]",
}
UNSTUCK = "unstuck"
TEXTURE = ("Sa_nm", "Sq_nm", "Ssk", "Sku")
# Fewest rows of a measurement: those whose errors are given, and others. Two numbers
# describe the springs, and a line through two points fits whatever was measured.
FEWEST = {"force_N": (3, 4), "removal_um": (1, 3), **dict.fromkeys(TEXTURE, (1, 4))}


def error_of(column: str) -> str:
    """The column with the standard error of another: `force_error_N` of `force_N`."""
    unit = suffix(column)
    return f"{column.removesuffix('_' + unit)}_error_{unit}" if unit else f"{column}_error"


ERRORS = {error_of(column): column for column in MEASURED}
COLUMNS = {
    **SETTINGS,
    **BEFORE,
    **MEASURED,
    **dict.fromkeys(ERRORS, "(0, inf)"),
    UNSTUCK: "[0, 1]",
}


@dataclass(frozen=True)
class Measurements:
    """A table that passed every check, in mm, N, s and rad; None where nothing stood."""

    rows: tuple[dict[str, float | None], ...]
    """Each by the names of columns without units: `tilt`, `force`, `force_error`."""
    lines: tuple[int, ...]
    """Where each row stands in the file, counted from 1."""

    def having(self, *names: str) -> list[dict[str, float | None]]:
        """The rows in which at least one of some columns is filled."""
        return [row for row in self.rows if any(row.get(n) is not None for n in names)]

    @property
    def forces(self) -> list[dict[str, float | None]]:
        """Rows of a force that the disc held."""
        return [row for row in self.having("force") if not row.get(UNSTUCK)]

    @property
    def unstuck(self) -> list[dict[str, float | None]]:
        """Rows of a force at which the disc came unstuck."""
        return [row for row in self.rows if row.get(UNSTUCK)]

    @property
    def runs(self) -> list[dict[str, float | None]]:
        """Rows of a polishing run: its removal, its texture, or both."""
        return self.having("removal", "Sa", "Sq", "Ssk", "Sku")


def plain(column: str) -> str:
    """The name of a column without its unit."""
    unit = suffix(column)
    return column.removesuffix("_" + unit) if unit else column


def measurements(path: str | Path) -> Measurements:
    """Reads and checks a table of measurements.

    Args:
        path: The CSV file: a header, then one row for each measurement, with commas
            between columns and points in decimals.

    Raises:
        ConfigError: with every mistake found, as lines to print.
    """
    path = Path(path)
    text = read_text(path)
    wrong: list[Problem] = []

    def say(sentence: str, line: int = 0) -> None:
        wrong.append(Problem(f"{path}:{line}" if line else str(path), sentence))

    reader = csv.reader(io.StringIO(text), skipinitialspace=True)
    table: list[tuple[int, list[str]]] = []
    try:
        for cells in reader:
            filled = [cell.strip() for cell in cells]
            if any(filled) and not filled[0].startswith("#"):
                table.append((reader.line_num, filled))
    except csv.Error as error:
        say(f"is not a table: {error}", reader.line_num)
        raise ConfigError(wrong) from None
    if not table:
        say("holds no table: the first line names the columns")
        raise ConfigError(wrong)
    (at, header), *body = table
    for sentence in wrong_header(header):
        say(sentence, at)
    if not body:
        say("holds no row of numbers")
    if wrong:
        raise ConfigError(wrong)

    rows: list[dict[str, float | None]] = []
    for line, cells in body:
        if len(cells) != len(header):
            say(
                f"the row has {len(cells)} cells, the header names {len(header)} columns "
                "(a comma separates cells, a point marks decimals)",
                line,
            )
            continue
        row: dict[str, float | None] = {}
        for column, cell in zip(header, cells, strict=True):
            value, sentence = number(column, cell)
            if sentence:
                say(sentence, line)
            row[column] = value
        rows.append(row)
    if not wrong:
        for row, (line, _) in zip(rows, body, strict=True):
            for sentence in wrong_row(row):
                say(sentence, line)
    for sentence in [] if wrong else too_few(rows):
        say(sentence)
    if wrong:
        raise ConfigError(wrong)
    internal = tuple(
        {
            plain(column): None if value is None else to_internal(value, suffix(column))
            for column, value in row.items()
        }
        for row in rows
    )
    return Measurements(internal, tuple(line for line, _ in body))


def wrong_header(header: list[str]) -> list[str]:
    """What is wrong with the names of the columns, in sentences."""
    if len(header) == 1 and any(mark in header[0] for mark in ";\t"):
        return ["the columns must be separated by commas"]
    said = []
    by_name = {plain(column): column for column in COLUMNS}
    for name in header:
        if name in COLUMNS:
            continue
        other = by_name.get(plain(name)) or near(name, COLUMNS)
        known = f"known are {', '.join(COLUMNS)}"
        unit = label(suffix(other)) if other else ""
        use = f"use '{other}'{f', in {unit}' if unit else ''}" if other else known
        said.append(f"unknown column '{name}'; {use}")
    twice = sorted({name for name in header if name and header.count(name) > 1})
    said += [f"the column '{name}' stands twice" for name in twice]
    if said:
        return said
    if not any(column in header for column in MEASURED):
        said.append(f"nothing is measured: there is no column {either(MEASURED)}")
    for error, column in ERRORS.items():
        if error in header and column not in header:
            said.append(f"the column '{error}' needs the column '{column}'")
    for needed in ("tilt_deg", "displacement_mm"):
        if "force_N" in header and needed not in header:
            said.append(f"the column 'force_N' needs the column '{needed}'")
    if UNSTUCK in header and "force_N" not in header:
        said.append(f"the column '{UNSTUCK}' needs the column 'force_N'")
    before = [column for column in BEFORE if column in header]
    if before and len(before) < len(BEFORE):
        lacking = next(column for column in BEFORE if column not in header)
        said.append(f"the column '{before[0]}' needs the column '{lacking}'")
    return said


def number(column: str, cell: str) -> tuple[float | None, str]:
    """The number in a cell, None for an empty one, and what is wrong with it or ''."""
    if not cell:
        return None, ""
    try:
        value = float(cell)
    except ValueError:
        return None, f"{column} is '{cell}', must be a number; the column says the unit"
    if not math.isfinite(value):
        return None, (
            f"{column} is {cell}, must be a finite number; leave the cell empty where "
            "nothing was measured"
        )
    if column == UNSTUCK and value not in (0, 1):
        return None, f"{column} is {cell}, must be 0 or 1"
    if not Between(COLUMNS[column]).holds(value):
        unit = label(suffix(column))
        return None, f"{column} is {cell}, must lie in {COLUMNS[column]} {unit}".rstrip()
    return value, ""


def wrong_row(row: dict[str, float | None]) -> list[str]:
    """What is wrong with a row of good numbers, in sentences."""
    given = {column for column, value in row.items() if value is not None}
    if not given & {*MEASURED}:
        return ["nothing is measured in this row"]
    said = []
    if row.get(UNSTUCK) and "force_N" not in given:
        said.append("unstuck is 1, but force_N is empty: at what force?")
    needs = {error: column for error, column in ERRORS.items() if error in given}
    if "force_N" in given:
        needs |= {"tilt_deg": "", "displacement_mm": ""}
    for column, other in needs.items():
        lacking = other or column
        if lacking not in given:
            said.append(f"{column if other else 'force_N'} needs {lacking} in its row")
    before = given & {*BEFORE}
    if before and len(before) < len(BEFORE):
        lacking = next(column for column in BEFORE if column not in given)
        said.append(f"{min(before)} needs {lacking} in its row")
    for first in ("", "start_"):
        skew, kurtosis = row.get(f"{first}Ssk"), row.get(f"{first}Sku")
        if skew is not None and kurtosis is not None and kurtosis < 1 + skew**2:
            least = f"1 + {first}Ssk^2 = {1 + skew**2:.4g}"
            said.append(
                f"{first}Sku is {kurtosis:g}, must be at least {least}: no surface goes "
                "below"
            )
    mean, square = row.get("Sa_nm"), row.get("Sq_nm")
    if mean is not None and square is not None and mean > square:
        said.append(
            f"Sa_nm is {mean:g}, must not exceed Sq_nm, {square:g}: no surface does"
        )
    return said


def too_few(rows: list[dict[str, float | None]]) -> list[str]:
    """Measurements with too few rows, or with errors for some of them, in sentences."""
    said = []
    for column, (given, estimated) in FEWEST.items():
        held = [row for row in rows if row.get(column) is not None]
        if column == "force_N":
            held = [row for row in held if not row.get(UNSTUCK)]
        known = [row for row in held if row.get(error_of(column)) is not None]
        if not held:
            continue
        if 0 < len(known) < len(held):
            sentence = (
                f"{column} has {error_of(column)} in {len(known)} of {len(held)} rows"
            )
            said.append(f"{sentence}; give it in all of them or in none")
            continue
        fewest = given if known else estimated
        if len(held) < fewest:
            count = f"{len(held)} {'row' if len(held) == 1 else 'rows'}"
            sentence = f"{column} is measured in {count}, must be in at least {fewest}"
            if not known and given < estimated:
                more = f"or in {given}" if given > 1 else "or"
                sentence += (
                    f", to see how far it scatters, {more} with {error_of(column)} given"
                )
            said.append(sentence)
    return said
