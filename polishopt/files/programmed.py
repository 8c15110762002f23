"""Programmed: the section of a config that says how programs for controls are written."""

import re
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from .quantity import Between, sentence
from .section import Section


NAME = "^[A-Za-z][A-Za-z0-9_]{0,15}$"


Language = Literal[
    "apt",
    "csv",
    "siemens_vector",
    "siemens_angles",
    "heidenhain_tcpm",
    "heidenhain_m128",
    "fanuc_g43_4",
    "fanuc_g43_5",
    "linuxcnc",
]
ALL: tuple[Language, ...] = (
    "apt",
    "csv",
    "siemens_vector",
    "siemens_angles",
    "heidenhain_tcpm",
    "heidenhain_m128",
    "fanuc_g43_4",
    "fanuc_g43_5",
    "linuxcnc",
)


def named(typed: str) -> str:
    """The name itself, if all controls take it."""
    if not re.fullmatch(NAME, typed):
        raise sentence("must be a letter, then up to 15 letters, digits or underscores")
    return typed


Name = Annotated[str, AfterValidator(named), Field(json_schema_extra={"pattern": NAME})]


class Program(Section):
    """How the answer is written as programs for controls."""

    dialects: tuple[Language, ...] = ALL
    """The languages to write; an empty list for no program at all."""
    name: Name = "polish"
    """What the program and its files are called: a letter, then up to fifteen letters,
    digits and underscores."""
    chord_tolerance_mm: Annotated[float, Between("[1e-4, 1]")] = 0.01
    """How far any point of the disc's face may stray between two programmed poses."""
    decimals: Annotated[int, Between("[3, 8]")] = 4
    """Printed decimals of lengths in mm and angles in degrees."""
    clearance_mm: Annotated[float, Between("(0, 1000]")] = 20.0
    """How far from the part, along the tool axis, the tool approaches and retreats."""
    approach_feed_mm_min: Annotated[float, Between("(0, 1e5]")] = 500.0
    """Feed on that way."""
    work_offset: Annotated[int, Between("[1, 6]")] = 1
    """Which work offset holds the origin: 1 for G54, up to 6."""
    tool_number: Annotated[int, Between("[1, 9999]")] | None = None
    """Number of the tool in the control; left out, 1, or the number of the step."""
    spindle_direction: Literal["clockwise", "counter-clockwise"] = "clockwise"
    """Which way the spindle turns, seen from the spindle."""
