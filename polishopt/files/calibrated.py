"""Calibrated: a config with constants written in, each with its error, comments kept."""

import copy
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from pydantic import BaseModel
from ruamel.yaml.comments import CommentedMap, CommentedSeq

from .answered import seen_from
from .asked import Roughness
from .config import Loaded
from .document import dump
from .measurements import plain
from .override import place_in
from .shop import Abrasive, Tool


SECTIONS: dict[str, type[BaseModel]] = {
    "tool": Tool,
    "abrasive": Abrasive,
    "start.roughness": Roughness,
}
UNSTICK = "tool.unstick"


class Constant(NamedTuple):
    """A number to write, in the unit of its key."""

    key: str
    """With its sections: `tool.foundation_N_mm3`."""
    value: float
    error: float
    """One standard error; none is written where it is NaN."""
    note: str
    """What the number rests on, for a comment."""


def key_of(name: str) -> str:
    """The key in a config of a constant such as `tool.foundation`."""
    section, _, word = name.rpartition(".")
    keys = SECTIONS[section].model_fields
    return f"{section}.{next(key for key in keys if plain(key) == word)}"


def digits(value: float, count: int = 6) -> float:
    """A number rounded to significant digits."""
    return float(f"{value:.{count}g}")


def calibrated(
    loaded: Loaded,
    constants: Sequence[Constant],
    unstick: Mapping[str, Sequence[float]] | None,
    folder: str | Path,
) -> str:
    """The config with constants written in, and their errors in its section `errors`.

    A preset that is named alone becomes `{preset: name, key: value}`.

    Args:
        loaded: The config that was calibrated.
        constants: What to write.
        unstick: `tilt_deg` and `force_N` of a table to put in place of the tool's own.
        folder: Where the text will lie; the path of a start surface is written from there.
    """
    document = copy.deepcopy(loaded.document)
    for section in ("tool", "abrasive"):
        if isinstance(document[section], str):
            room = CommentedMap({"preset": document[section]})
            # in one line, so that a comment behind it stays behind it
            room.fa.set_flow_style()
            document[section] = room
    if any(one.key.startswith("start.roughness") for one in constants):
        document["start"].pop("scratches", None)
    for one in constants:
        if "[" not in one.key:
            place_in(document, one.key.split("."), digits(one.value))
    if unstick is not None:
        table = CommentedMap()
        for key, numbers in unstick.items():
            table[key] = CommentedSeq(digits(number) for number in numbers)
            table[key].fa.set_flow_style()
        document["tool"]["unstick"] = table
    for section in ("tool", "abrasive"):
        if list(document[section]) == ["preset"]:
            document[section] = document[section]["preset"]

    errors = document.get("errors")
    if errors is None:
        errors = CommentedMap()
        document["errors"] = errors
        before = "Standard errors of constants, from polishopt.calibrate"
        document.yaml_set_comment_before_after_key("errors", before=f"\n{before}")
    if unstick is not None:
        for key in [key for key in errors if re.match(re.escape(UNSTICK), key)]:
            del errors[key]
    for one in constants:
        errors.pop(one.key, None)
        if one.error == one.error:  # else unknown
            errors[one.key] = digits(one.error, 3)
            errors.yaml_add_eol_comment(one.note, one.key)
    if not errors:
        del document["errors"]
    surface = loaded.config.start.file
    if surface is not None:
        document["start"]["file"] = seen_from(surface, folder)
    return dump(document)
