"""Evenness: what laying the guide out by area, and following the curvature, are worth.

A job may have its guide laid out on an even sheet (`path.even`) and its displacement follow
the part (`hold`). Here a part is looked at with these as they are, and without them.
"""

import dataclasses

from .coverage import uneven_coverage
from .mechanics import mechanics
from .parts import Process, Scalar
from .path.even import Even
from .preflight import Finding
from .setup import Setup
from .stored import seldom


# Variations below this are not worth a word [-].
NOTABLE = 1e-3
# A variation from here on is worth a switch [-].
WORTHWHILE = 1e-2


@seldom
def forces(process: Process, setup: Setup) -> tuple[Scalar, Scalar]:
    """Smallest and largest force along the path [N]."""
    done = mechanics(process, setup)
    return done.force_min, done.force_max


def remarks(process: Process, setup: Setup) -> list[Finding]:
    """How evenly a path covers and presses a part, in sentences; none of a plane.

    Args:
        process: The settings.
        setup: Their job.
    """
    if setup.flat:
        return []
    return _coverage(setup) + _force(process, setup)


def _coverage(setup: Setup) -> list[Finding]:
    uneven, sheet = seldom(uneven_coverage), setup.surface
    used = float(uneven(sheet, setup.guide, setup.size))
    sentence = f"The path covers the part evenly to {100 * used:.2g} % rms"
    if isinstance(sheet, Even):
        given = float(uneven(sheet.surface, setup.guide, setup.size))
        return [
            Finding(f"{sentence}; without `guide.even` it would be {100 * given:.2g} %.")
        ]
    if used < NOTABLE:
        return []
    hint = "; `guide.even: true` lays it out by area" if used > WORTHWHILE else ""
    return [Finding(f"{sentence}{hint}.")]


def _force(process: Process, setup: Setup) -> list[Finding]:
    low, high = map(float, forces(process, setup))
    same = high - low <= NOTABLE * high
    said = (
        f"The force is {high:.4g} N" if same else f"The force is {low:.4g} to {high:.4g} N"
    )
    if setup.holds:
        low, high = map(
            float, forces(process, dataclasses.replace(setup, hold="displacement"))
        )
        other = f"with `guide.hold: displacement` it would be {low:.4g} to {high:.4g} N"
        return [Finding(f"{said} along the path; {other}.")]
    if same:
        return []
    hint = "; `guide.hold: force` keeps it" if high - low > WORTHWHILE * high else ""
    return [Finding(f"{said} along the path{hint}.")]
