"""Calibrate: `python -m polishopt.calibrate config.yaml --data data.csv -o new.yaml`.

It estimates the constants of tool and abrasive from measured forces, removal and roughness,
says how well each is known and what the data cannot tell apart, and writes them into a
copy of the config. Exit codes: 0 calibrated, 2 bad input, 4 not converged.
"""

import argparse
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from .files.calibrated import Constant, calibrated, key_of
from .files.config import Loaded, write_text
from .files.document import ConfigError
from .files.measurements import COLUMNS, Measurements, measurements
from .session import BAD_INPUT, folder, own_values, perform, prepare, read
from .units import from_internal, label, suffix


if TYPE_CHECKING:
    from .optimize.calibrate import Calibration

NOT_CONVERGED = 4
WORDS = {
    "tool.foundation": ("foundation", "k"),
    "tool.stiffening": ("stiffening", "β"),
    "abrasive.preston": ("Preston", "K_P"),
    "abrasive.active_fraction": ("active grains", "c_a"),
    "abrasive.asperity_stiffness": ("asperities", "K_a"),
    "abrasive.conformity": ("conformity", "ℓ_c"),
    "abrasive.ripple_gain": ("ripple gain", ""),
    "abrasive.hardness": ("hardness", "H"),
    "abrasive.half_angle": ("half-angle", "ψ"),
    "abrasive.grain": ("grain size", "d"),
    "abrasive.depth_variation": ("depth variation", ""),
    "start.roughness.Sq": ("Sq before", ""),
    "start.roughness.Ssk": ("Ssk before", ""),
    "start.roughness.Sku": ("Sku before", ""),
}
RESTS = {"data": "data", "prior": "prior", "both": "data and prior"}


def arguments() -> argparse.ArgumentParser:
    """The parser of the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m polishopt.calibrate",
        description="Estimates the constants of tool and abrasive from measurements, and "
        "writes them with their errors into a copy of the config. Exit codes: "
        "0 calibrated, 2 bad input, 4 not converged.",
        epilog=f"Columns of the table: {', '.join(COLUMNS)}. A row holds the settings of "
        "one measurement (those left out are the config's) and what came out; empty cells "
        "were not measured. Lines that begin with # are comments.",
    )
    parser.add_argument("config", type=Path, help="the YAML file of the job")
    parser.add_argument(
        "--data",
        type=Path,
        required=True,
        metavar="CSV",
        help="the table of measurements",
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="YAML",
        help="where to write the config with the constants; "
        "default: runs/<config>/calibrated.yaml",
    )
    parser.add_argument(
        "--free-start",
        action="store_true",
        help="the texture before the run is unknown too: estimate its Sq, Ssk and Sku",
    )
    parser.add_argument(
        "--set",
        dest="overrides",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        help="replace a value of the config; may be repeated",
    )
    parser.add_argument("--quiet", action="store_true", help="say nothing but errors")
    parser.add_argument(
        "--no-cache", action="store_true", help="do not keep what JAX has compiled"
    )
    return parser


def main(argv: list[str] | None = None) -> int:
    """Runs the command and returns its exit code."""
    given = arguments().parse_args(argv)
    loaded = read(given.config, given.overrides)
    if loaded is None:
        return BAD_INPUT
    if not given.quiet:
        own_values(loaded)
    try:
        table = measurements(given.data)
    except ConfigError as error:
        print(error, file=sys.stderr)
        return BAD_INPUT
    if given.free_start and (sentence := fixed_start(loaded, table)):
        print(f"--free-start: {sentence}", file=sys.stderr)
        return BAD_INPUT
    target = given.output or Path("runs") / given.config.stem / "calibrated.yaml"
    if target.is_dir():
        print(f"{target}: is a folder; name the file to write", file=sys.stderr)
        return BAD_INPUT
    if not folder(target.parent):
        return BAD_INPUT
    prepare(not given.no_cache)
    try:
        return calibrate(loaded, table, target, given.free_start, given.quiet)
    except KeyboardInterrupt:
        print("Interrupted: nothing is written.", file=sys.stderr)
        return 130


def fixed_start(loaded: Loaded, table: Measurements) -> str:
    """Why the texture before the run cannot be estimated, or ''."""
    start = loaded.config.start
    if not table.having("Sa", "Sq", "Ssk", "Sku"):
        return "needs a measured texture, none of Sa_nm, Sq_nm, Ssk and Sku is there"
    if table.having("start_Sq"):
        return "must be left out, the table says what the texture was before (start_Sq_nm)"
    if start.roughness is None and start.scratches is None:
        return "needs start.roughness or start.scratches in the config, as a first guess"
    return ""


def calibrate(
    loaded: Loaded,
    table: Measurements,
    target: Path,
    free_start: bool = False,
    quiet: bool = False,
) -> int:
    """Estimates, prints and writes everything; the exit code says how it ended.

    Args:
        loaded: The config.
        table: The measurements.
        target: The YAML file to write; its folder exists.
        free_start: Whether the texture before is estimated too.
        quiet: Whether to print nothing.
    """
    import numpy as np
    from rich.console import Console

    from .files import assemble
    from .optimize import calibrate as estimation

    console = Console(quiet=quiet, markup=False)
    constants: list[Constant] = []
    with Console(stderr=True, quiet=quiet).status("calibrating"):
        job = assemble.job(loaded.config)
        data = assemble.data(table, job)
        names = estimation.unknowns(data, job.setup, free_start)
        found = estimation.calibrate(data, job.setup, names) if names else None
    if found is not None:
        if not bool(found.converged):
            sentence = "not converged: the constants that fit best were not found"
            print(f"{loaded.path}: {sentence}", file=sys.stderr)
            return NOT_CONVERGED
        constants += written(found)
        show(console, found, data)
    unstick = None
    if table.unstuck:
        tilts, forces, errors = estimation.unstick_table(
            *(
                np.asarray([math.nan if x is None else x for x in column], float)
                for column in (
                    [row.get(name) for row in table.unstuck]
                    for name in ("tilt", "force", "force_error")
                )
            )
        )
        unstick = {
            "tilt_deg": [from_internal(float(tilt), "deg") for tilt in tilts],
            "force_N": [float(force) for force in forces],
        }
        constants += [
            Constant(f"tool.unstick.force_N[{i}]", float(force), float(error), "data")
            for i, (force, error) in enumerate(zip(forces, errors, strict=True))
        ]
        show_unstick(console, unstick, errors, table)
    text = calibrated(loaded, constants, unstick, target.parent)
    if sentence := refused(text, target):
        print(sentence, file=sys.stderr)
        return NOT_CONVERGED
    write_text(target, text)
    console.print(f"The constants are in {target}.")
    return 0


def refused(text: str, target: Path) -> str:
    """Why a config with constants written in is none that polishopt would read, or ''."""
    from .files.config import check

    try:
        check(text, target)
    except ConfigError as error:
        return f"A constant leaves the range of its key, nothing is written: {error}"
    return ""


def written(found: "Calibration") -> Iterator[Constant]:
    """The constants to write: all that some measurement sees."""
    from .optimize.calibrate import rests_on

    seen = found.information.diagonal() > 1e-6
    for i, (name, rests) in enumerate(zip(found.names, rests_on(found), strict=True)):
        if seen[i]:
            key = key_of(name)
            value, error = (
                from_internal(float(x[i]), suffix(key))
                for x in (found.values, found.errors)
            )
            yield Constant(key, value, error, f"rests on {RESTS[rests]}")


def word(name: str) -> str:
    """A constant in words."""
    return WORDS[name][0]


def listed(words: list[str]) -> str:
    """`a, b and c`."""
    return " and ".join(filter(None, [", ".join(words[:-1]), words[-1]]))


def show(console, found: "Calibration", data) -> None:
    """Prints the constants, how well the model fits, and what the data leave open."""
    import numpy as np

    from . import report
    from .optimize.calibrate import intervals, rests_on

    head = ("", "", "unit", "before", "estimate", "±", "95 %", "rests on")
    table = report.empty_table("Constants", *head)
    ends, rests = intervals(found), rests_on(found)
    for i, name in enumerate(found.names):
        unit = suffix(key_of(name))
        before, value, error, low, high = (
            from_internal(float(x), unit)
            for x in (found.before[i], found.values[i], found.errors[i], *ends[i])
        )
        table.add_row(
            word(name),
            WORDS[name][1],
            label(unit),
            f"{before:.4g}",
            f"{value:.4g}",
            f"{error:.2g}",
            f"{low:.3g} … {high:.3g}",
            rests[i],
        )
    console.print(table)
    freedom = np.asarray(found.freedom)
    known = float(np.trace(np.eye(freedom.size) - np.asarray(found.covariance)))
    sentence = (
        "± is one standard error, 95 % an interval. The data determine "
        f"{known:.1f} of these {freedom.size} numbers, the priors the rest. "
    )
    if np.isinf(freedom).all():
        sentence += "All errors of measurement are given: intervals are normal."
    else:
        sentence += (
            "Scatter is estimated where no errors are given: intervals are those of "
            f"Student's t with {freedom.min():.3g} or more degrees of freedom."
        )
    console.print(sentence)
    console.print(_fit(found, data))
    for sentence in remarks(found, data):
        console.print(f"- {sentence}")


def _fit(found: "Calibration", data):
    from . import report

    table = report.empty_table("Measurements", "", "rows", "scatter", "", "")
    for name, measured in data.measured.items():
        count = int((measured == measured).sum())
        scatter, freedom = float(found.scatter[name]), float(found.scatter_freedom[name])
        if name in data.errors:
            shown = f"{scatter:.2f}" if freedom >= 1 else "–"
            what = "times the errors given"
        else:
            shown = f"{100 * scatter:.2g} %"
            what = "estimated"
        degrees = f"{freedom:.3g} degrees of freedom" if freedom >= 1 else ""
        table.add_row(name, f"{count}", shown, what, degrees)
    for column in table.columns[3:]:
        column.justify = "left"
    return table


def remarks(found: "Calibration", data) -> Iterator[str]:
    """What the data cannot tell apart, which errors go together, and what does not fit."""
    import numpy as np
    from scipy.special import chdtrc

    from .optimize.identify import alike, correlated, left_open

    for pair in alike(found):
        first, second = word(pair.first), word(pair.second)
        power = 0.5 * round(2 * pair.power)
        if not np.isclose(power, pair.power, atol=1e-2):
            ways = "only together"
        elif abs(power) == 1:
            ways = "only as their product" if power == 1 else "only as their quotient"
        else:
            ways = f"only as {first} {'x' if power > 0 else '/'} {second}^{abs(power):g}"
        fixed = f"; {second} is the config's" if pair.held else ""
        yield f"The data know {first} and {second} {ways}{fixed}."
    for group in left_open(found):
        words = [word(name) for name in group.names]
        if len(words) == 1:
            yield f"The data say next to nothing of {words[0]}: it keeps its prior."
        else:
            ways = "combination" if group.known == 1 else "combinations"
            yield (
                f"Of {listed(words)} the data determine only {group.known or 'no'} {ways}; "
                "the prior decides the rest."
            )
    for pair in correlated(found):
        first, second = word(pair.first), word(pair.second)
        yield f"Errors of {first} and {second} are correlated: {pair.correlation:+.2f}."
    for name in data.errors:
        ratio, freedom = float(found.scatter[name]), float(found.scatter_freedom[name])
        if freedom >= 1 and chdtrc(freedom, freedom * ratio**2) < 0.01:
            yield (
                f"{name} lies {ratio:.1f} times further from the model than its errors "
                "allow: the model lacks something, or the errors are too small."
            )


def show_unstick(console, unstick, errors, table: Measurements) -> None:
    """Prints the forces at which the disc came unstuck."""
    from . import report

    shown = report.empty_table("Unstick force", "tilt [°]", "N", "±")
    for tilt, force, error in zip(*unstick.values(), errors, strict=True):
        spread = "–" if math.isnan(error) else f"{error:.2g}"
        shown.add_row(f"{tilt:g}", f"{force:.4g}", spread)
    console.print(shown)
    tilts = dict(zip(unstick["tilt_deg"], unstick["force_N"], strict=True))
    for row in table.forces:
        tilt, force = row["tilt"] or 0.0, row["force"] or 0.0
        near = [f for t, f in tilts.items() if abs(t - from_internal(tilt, "deg")) < 1e-6]
        if near and force > near[0]:
            console.print(
                f"- At {from_internal(tilt, 'deg'):g}° the disc held {force:.4g} N, more "
                f"than the {near[0]:.4g} N at which it came unstuck."
            )


if __name__ == "__main__":
    perform(main)
