"""Measure: `python -m polishopt.texture surface.x3p` tells the texture of a surface.

The surface is filtered as asked, its ISO 25178-2 parameters are printed with their
standard errors, and map and numbers are written beside each other.
Exit codes: 0 measured, 2 bad input.
"""

import argparse
import csv
import dataclasses
import io
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .files.document import write_text
from .files.topography import Topography, TopographyError, read
from .session import BAD_INPUT, folder, perform, prepare
from .units import from_internal, label


# parameter: unit in which it is shown (heights choose between nm and µm), and what it is
HEIGHT = "height"
PARAMETERS = {
    "Sa": (HEIGHT, "mean height"),
    "Sq": (HEIGHT, "root mean square height"),
    "Ssk": ("", "skewness of the heights"),
    "Sku": ("", "kurtosis of the heights"),
    "Sp": (HEIGHT, "highest peak over the mean"),
    "Sv": (HEIGHT, "deepest pit below the mean"),
    "Sz": (HEIGHT, "peak to pit"),
    "Sdq": ("", "root mean square slope"),
    "Sdr": ("percent", "developed area over projected area less one"),
    "Sal": ("um", "autocorrelation length"),
    "Str": ("", "texture aspect ratio"),
    "Std": ("deg", "direction of the lay from x towards y"),
    "Sk": (HEIGHT, "height of the core"),
    "Spk": (HEIGHT, "reduced peak height"),
    "Svk": (HEIGHT, "reduced dale depth"),
    "Smr1": ("percent", "material ratio at the top of the core"),
    "Smr2": ("percent", "material ratio at the bottom of the core"),
    "Sxp": (HEIGHT, "height between the ratios 2.5 % and 50 %"),
    "Vmp": (HEIGHT, "material of the peaks per area"),
    "Vmc": (HEIGHT, "material of the core per area"),
    "Vvc": (HEIGHT, "void of the core per area"),
    "Vvv": (HEIGHT, "void of the dales per area"),
    "Spd": ("1_mm2", "significant hills per area"),
}
FORMS = {"none": None, "plane": 1, "quadratic": 2}
# Fewer points along a side hold no texture.
FEWEST_POINTS = 8
LONGEST = 1e3  # of a cut-off [mm]


def cutoff(typed: str) -> float:
    """The wavelength of a filter [mm], for argparse."""
    try:
        value = float(typed)
    except ValueError:
        value = math.nan
    if not 0 < value <= LONGEST:
        raise argparse.ArgumentTypeError(f"is {typed}, must lie in (0, {LONGEST:g}] mm")
    return value


def arguments() -> argparse.ArgumentParser:
    """The parser of the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m polishopt.texture",
        description="Tells the ISO 25178-2 parameters of a measured surface, with their "
        "standard errors. Exit codes: 0 measured, 2 bad input.",
    )
    parser.add_argument("surface", type=Path, help="the surface file, .x3p or .sdf")
    parser.add_argument(
        "--form",
        choices=list(FORMS),
        default="plane",
        help="what is taken out as form, by least squares; default: plane",
    )
    parser.add_argument(
        "--s-filter-mm",
        type=cutoff,
        metavar="MM",
        help="take out waves shorter than this, with a Gaussian filter; default: none",
    )
    parser.add_argument(
        "--l-filter-mm",
        type=cutoff,
        metavar="MM",
        help="take out waves longer than this, with a Gaussian filter; default: none",
    )
    parser.add_argument(
        "-o", "--output", type=Path, metavar="DIR", help="folder for the results"
    )
    parser.add_argument("--quiet", action="store_true", help="say nothing but errors")
    return parser


def main(argv: list[str] | None = None) -> int:
    """Runs the command and returns its exit code."""
    given = arguments().parse_args(argv)
    try:
        surface = read(given.surface)
        if sentence := too_few(surface):
            raise TopographyError(given.surface, sentence)
    except TopographyError as error:
        print(error, file=sys.stderr)
        return BAD_INPUT
    short, long = given.s_filter_mm, given.l_filter_mm
    if short and long and short >= long:
        sentence = f"--s-filter-mm is {short:g}, must lie below --l-filter-mm, {long:g} mm"
        print(sentence, file=sys.stderr)
        return BAD_INPUT
    if sentence := takes_all(short, long, surface):
        print(sentence, file=sys.stderr)
        return BAD_INPUT
    target = given.output or Path("runs") / given.surface.stem
    if not folder(target):
        return BAD_INPUT
    prepare()
    try:
        measure(surface, given, target)
    except KeyboardInterrupt:
        print("Interrupted: nothing more is written.", file=sys.stderr)
        return 130
    return 0


def too_few(surface: Topography) -> str:
    """Why a surface has too few points for texture, or ''."""
    rows, columns = surface.heights.shape
    if min(rows, columns) < FEWEST_POINTS:
        held = f"holds {columns} x {rows} points"
        return f"{held}, must hold at least {FEWEST_POINTS} along each side"
    measured = ~np.isnan(surface.heights)
    across, along = measured.any(axis=0).sum(), measured.any(axis=1).sum()
    if min(across, along) < FEWEST_POINTS or measured.sum() < FEWEST_POINTS**2:
        return (
            f"has heights at {measured.sum()} of its {columns} x {rows} points, must have "
            f"{FEWEST_POINTS**2} or more, in {FEWEST_POINTS} rows and columns at least"
        )
    return ""


def takes_all(short: float | None, long: float | None, surface: Topography) -> str:
    """Which filter would leave nothing of a surface, and why, or ''.

    Args:
        short: Cut-off of the S-filter [mm]; None for none.
        long: Cut-off of the L-filter [mm]; None for none.
        surface: What is to be filtered.
    """
    side, step = max(surface.extent), 2 * min(surface.spacing)
    if short and short >= side:
        return f"--s-filter-mm is {short:g}, must lie below the longer side, {side:g} mm"
    if long and long <= step:
        return f"--l-filter-mm is {long:g}, must lie above two spacings, {step:g} mm"
    return ""


class Row(NamedTuple):
    """A parameter as people read it."""

    parameter: str
    value: float
    """NaN where the map does not hold it, as the aspect ratio of an endless lay."""
    unit: str
    standard_error: float
    """NaN where none is known."""
    meaning: str


def measure(surface: Topography, given: argparse.Namespace, target: Path) -> None:
    """Filters a surface, tells its parameters, and writes them and its map.

    Args:
        surface: The surface.
        given: The arguments of the command line.
        target: Folder for the results; exists.
    """
    import equinox as eqx
    import jax.numpy as jnp
    from rich.console import Console

    from . import plots, report
    from .files.results import write_json
    from .texture import areal_parameters, scale_limited, standard_errors

    console = Console(quiet=given.quiet, markup=False)
    spacing = jnp.asarray(surface.spacing)
    heights = scale_limited(
        jnp.asarray(surface.heights),
        spacing,
        given.s_filter_mm,
        FORMS[given.form],
        given.l_filter_mm,
    )
    with Console(stderr=True, quiet=given.quiet).status("measuring"):
        values = dict(scalars(eqx.filter_jit(areal_parameters)(heights, spacing)))
        errors = dict(scalars(eqx.filter_jit(standard_errors)(heights)))
    rows = list(table(values, errors))
    asked = filters(given)
    sides = " x ".join(f"{side:.4g}" for side in reversed(surface.extent))
    count = " x ".join(f"{count}" for count in reversed(surface.heights.shape))
    write_json(
        target / "parameters.json",
        {
            "surface": str(given.surface),
            "title": surface.title,
            "instrument": surface.instrument,
            "points_y_x": surface.heights.shape,
            "spacing_y_x_mm": surface.spacing,
            "unmeasured_percent": 100 * surface.unmeasured,
            "s_filter_mm": given.s_filter_mm,
            "form": given.form,
            "l_filter_mm": given.l_filter_mm,
            "independent_points": errors["independent_points"],
            "parameters": {row.parameter: row._asdict() for row in rows},
        },
    )
    write_csv(target / "parameters.csv", rows)
    title = f"{given.surface.name}: {asked}"
    figure = plots.topography(np.asarray(heights), np.asarray(surface.extent), title)
    plots.save(figure, target / "surface.png")

    console.print(
        f"{given.surface}: {count} points on {sides} mm, "
        f"{100 * surface.unmeasured:.3g} % of them not measured. {asked}."
    )
    shown = report.empty_table("Texture", "", "unit", "value", "±", "meaning")
    shown.columns[-1].justify = "left"
    for row in rows:
        value, error = known(row.value, ".5g") or "–", known(row.standard_error, ".2g")
        shown.add_row(row.parameter, label(row.unit), value, error, row.meaning)
    console.print(shown)
    console.print(
        "± is one standard error: so much another place on a random texture would differ, "
        f"here with about {errors['independent_points']:.3g} independent points. Where a "
        f"texture repeats itself it is only a hint. Results are in {target}."
    )


def filters(given: argparse.Namespace) -> str:
    """What was taken out, in words."""
    short, long = given.s_filter_mm, given.l_filter_mm
    return (
        f"S-filter {f'{short:g} mm' if short else 'none'}, form {given.form}, "
        f"L-filter {f'{long:g} mm' if long else 'none'}"
    )


def scalars(tree: Any) -> Iterator[tuple[str, float]]:
    """Names and values of all numbers in a module of modules, in order."""
    for field in dataclasses.fields(tree):
        value = getattr(tree, field.name)
        if dataclasses.is_dataclass(value):
            yield from scalars(value)
        else:
            yield field.name, float(value)


def table(values: dict[str, float], errors: dict[str, float]) -> Iterator[Row]:
    """The rows of the table of parameters.

    Args:
        values: Parameters by name [mm, rad].
        errors: Standard errors by name, of some of them [mm, rad].
    """
    tall = "um" if values["Sq"] >= 1e-3 else "nm"
    for name, (unit, meaning) in PARAMETERS.items():
        if name not in values:
            continue
        unit = tall if unit == HEIGHT else unit
        error = errors.get(name, math.nan)
        yield Row(
            name,
            from_internal(values[name], unit),
            unit,
            from_internal(error, unit),
            meaning,
        )


def known(value: float, digits: str) -> str:
    """A number as text; nothing for NaN."""
    return "" if math.isnan(value) else format(value, digits)


def write_csv(path: Path, rows: list[Row]) -> None:
    """The table as a CSV file, units as people write them."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(Row._fields)
    for row in rows:
        value, error = known(row.value, ".9g"), known(row.standard_error, ".9g")
        writer.writerow((row.parameter, value, label(row.unit), error, row.meaning))
    write_text(path, stream.getvalue())


def run() -> None:
    """What `python -m polishopt.texture` calls."""
    perform(main)
