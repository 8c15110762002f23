"""Config: from a YAML file to a checked config, and back with the answer written in.

All mistakes of a file are reported at once, each with its line, the value as typed, what
is allowed and its unit. Neither JAX nor NumPy is imported.
"""

import copy
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from ruamel.yaml.comments import CommentedMap

from ..units import label, suffix
from .document import (
    ConfigError as ConfigError,
    Keys,
    Place,
    Problem,
    Survey,
    dump,
    parse,
    problem,
    read_text,
    survey,
    write_text as write_text,
)
from .given import Hilbert, Plane
from .library import SHELVES, filled, names
from .override import override
from .quantity import Tuned, internal as internal
from .schema import Config, json_schema as json_schema
from .sentence import did_you_mean, either, shown, typed, unknown_key, wrong_value


@dataclass(frozen=True)
class Loaded:
    """A config that passed every check."""

    config: Config
    """The values, presets filled in."""
    document: CommentedMap
    """The YAML document as typed, overrides written in, presets not filled in."""
    path: Path
    """The file it came from."""
    text: str
    """That file's text, without overrides."""
    measured: str = ""
    """What was measured as the start surface, and what is done to it."""


@dataclass(frozen=True)
class Located:
    """A document under check: turns a path of keys into a place for an error."""

    name: str
    text: str
    found: Survey
    origin: dict[Keys, str]

    def problem(self, keys: Keys, sentence: str, at_key: bool = False) -> Problem:
        """A mistake under `keys`, or at the innermost section of them that was typed."""
        ends = range(len(keys), 0, -1)
        for end in ends:
            if keys[:end] in self.origin:
                return Problem(self.origin[keys[:end]], sentence)
        for end in ends:
            inner = keys[:end]
            if inner not in self.found.values:
                continue
            first = self.found.keys if at_key and end == len(keys) else self.found.values
            place = first.get(inner, self.found.values[inner])
            if end < len(keys):
                # the rest came from a preset, or is missing
                place = self.found.values.get(
                    (*inner, "preset"), self.found.keys.get(inner, place)
                )
            return problem(self.name, self.text, place, sentence)
        return problem(self.name, self.text, Place(1, 1), sentence)


def really(loc: tuple[Any, ...], data: Any) -> Keys:
    """The keys of `loc` that exist in `data`: pydantic adds names of alternatives."""
    keys: list[str | int] = []
    for key in loc:
        held = range(len(data)) if isinstance(data, list) else data
        if isinstance(held, dict | range) and key in held:
            keys.append(key)
            data = data[key]
    return tuple(keys)


def problems_in(
    error: ValidationError, data: Any, place: Located, excused: Sequence[Keys]
) -> list[Problem]:
    """The mistakes that pydantic found, as sentences with places.

    Args:
        error: What pydantic raised.
        data: The values it checked, presets filled in.
        place: Where they were typed.
        excused: Sections whose missing keys are not worth a word.
    """
    result = []
    missing: dict[Keys, list[str]] = {}
    lacking_in: dict[Keys, dict[str, Any]] = {}
    for one in error.errors(include_url=False):
        keys = really(one["loc"], data)
        if any(keys[: len(empty)] == empty for empty in place.found.empty):
            continue  # said already: it has no value
        last = one["loc"][-1] if one["loc"] else ""
        if one["type"] == "missing" and isinstance(last, str):
            missing.setdefault(keys, []).append(last)
            lacking_in[keys] = one["input"]
        elif one["type"] == "missing":
            held = len(one["input"])
            sentence = f"{shown(keys)} holds too few values, only {held}"
            result.append(place.problem(keys, sentence))
        elif one["type"] == "extra_forbidden":
            sentence = unknown_key(one["loc"])
            result.append(place.problem(keys, sentence, at_key=True))
        elif one["type"] == "union_tag_invalid":
            tag = (*keys, one.get("ctx", {})["discriminator"].strip("'"))
            result.append(place.problem(tag, wrong_value(one, keys)))
        else:
            section = one["input"] is ... or one["type"] == "union_tag_not_found"
            result.append(place.problem(keys, wrong_value(one, keys), at_key=section))
    for keys, lacking in missing.items():
        if keys in excused:
            continue
        what = "the key" if len(lacking) == 1 else "the keys"
        listed = ", ".join(f"'{key}'" for key in lacking)
        sentence = f"{shown(keys)} lacks {what} {listed}"
        if keys in SHELVES and lacking_in[keys].get("preset") is None:
            sentence += f"; or name a preset, {either(names(SHELVES[keys]))}"
        result.append(place.problem(keys, sentence, at_key=True))
    return result


def load(path: str | Path, overrides: Sequence[str] = ()) -> Loaded:
    """A config file, read, overridden and checked.

    Args:
        path: The YAML file.
        overrides: Each as `key.key=value`, written into the document before the checks.

    Raises:
        ConfigError: with every mistake found, as lines to print.
    """
    path = Path(path)
    return check(read_text(path), path, overrides)


def check(text: str, path: Path, overrides: Sequence[str] = ()) -> Loaded:
    """The text of a config, overridden and checked.

    Args:
        text: What the file holds, or is about to.
        path: The file; a relative path of a start surface starts at its folder.
        overrides: As in `load`.

    Raises:
        ConfigError: with every mistake found, as lines to print.
    """
    document = parse(text, str(path))
    origin = override(document, overrides)
    place = Located(str(path), text, survey(document, str(path)), origin)
    data, unknown = filled(place.found.data)
    name = root_start_file(data, path.parent)

    problems = [
        place.problem(keys, f"{shown(keys)} has no value", at_key=True)
        for keys in place.found.empty
    ]
    for at, name in unknown:
        known = names(SHELVES[at])
        sentence = f"{shown(at)}: there is no preset {typed(name)}"
        sentence += f"{did_you_mean(name, known) or ';'} there are {', '.join(known)}"
        spelt = (*at, "preset")
        problems.append(
            place.problem(spelt if spelt in place.found.values else at, sentence)
        )
    try:
        config = Config.model_validate(data)
    except ValidationError as error:
        # a section whose preset is unknown lacks its keys for that reason alone
        problems += problems_in(error, data, place, excused=[at for at, _ in unknown])
        raise ConfigError(problems) from None
    measured = ""
    if config.start.file is not None:
        from .measured import TopographyError, sample  # brings NumPy along

        try:
            *_, sentence = sample(config.start.file, config.sampling.start_points)
            measured = f"{name}: {sentence}"
        except TopographyError as error:
            problems.append(place.problem(("start", "file"), f"start.file: {error}"))
    if problems:
        raise ConfigError(problems)
    return Loaded(config, document, path, text, measured)


def root_start_file(data: Any, folder: Path) -> str:
    """Makes the path of a start surface one that starts at a folder; returns it as typed.

    Args:
        data: The plain values of a config, changed in place.
        folder: Where a relative path starts.
    """
    start = data.get("start")
    name = start.get("file") if isinstance(start, dict) else None
    if not isinstance(name, str):
        return ""
    start["file"] = str(folder / name)
    return name


def optimum(
    loaded: Loaded, answers: Mapping[str, float], folder: str | Path | None = None
) -> str:
    """The config with an answer written in as the new `start` of each tuned value.

    Comments and layout are kept. Values are rounded to six digits, and rounding never
    leaves the range given in `between`.

    Args:
        loaded: The config that was solved.
        answers: The answer by key and in the unit of the key: `{"tilt_deg": 7.5}`.
        folder: Where the text will lie, if elsewhere: then the path of a start surface is
            written as seen from there.

    Raises:
        ValueError: if a key is not tuned in this config.
    """
    tuned = loaded.config.tuned()
    document = copy.deepcopy(loaded.document)
    for key, value in answers.items():
        if key not in tuned:
            raise ValueError(f"`process.{key}` is not tuned in {loaded.path}.")
        low, high = tuned[key].between
        document["process"][key]["start"] = min(max(float(f"{value:.6g}"), low), high)
    surface = loaded.config.start.file
    if folder is not None and surface is not None:
        document["start"]["file"] = seen_from(surface, folder)
    return dump(document)


def seen_from(path: str, folder: str | Path) -> str:
    """A path relative to a folder, or whole where there is no way between their drives."""
    try:
        return Path(os.path.relpath(path, folder)).as_posix()
    except ValueError:
        return str(Path(path).absolute())


def describe(config: Config, measured: str = "") -> str:
    """A summary of a config for people: what is given, tuned, wanted and limited.

    Args:
        config: A checked config.
        measured: What is known of a measured start surface.
    """

    def quantity(key: str, value: Any) -> str:
        unit = label(suffix(key))
        if isinstance(value, Tuned):
            low, high = value.between
            return f"tuned in [{low:g}, {high:g}] {unit}, from {value.start:g}".replace(
                " ,", ","
            )
        return f"{value:g} {unit}".rstrip()

    def word(key: str) -> str:
        unit = suffix(key)
        return (key.removesuffix("_" + unit) if unit else key).replace("_", " ")

    part, tool, guide = config.part, config.tool, config.guide
    sides = " x ".join(f"{side:g}" for side in part.size_mm)
    kind = part.surface.replace("_", " ")
    if not isinstance(part, Plane):
        shape, value = list(part)[-1]
        kind += f", {word(shape)} {quantity(shape, value)}"
    density = (
        f"order {guide.order}" if isinstance(guide, Hilbert) else f"{guide.count} lines"
    )
    start = [key for key, value in config.start if value is not None]
    goals = [
        f"{word(key)} {goal.value:g} ± {goal.tolerance:g} {label(suffix(key))}".rstrip()
        for key, goal in config.target
        if goal is not None
    ]
    holds = {"unstick": tool.unstick or tool.shear_strength_MPa}
    limits = [
        word(key) + ("" if holds.get(key, True) else " (this tool has no table)")
        if value is True
        else f"{word(key)} {quantity(key, value)}"
        for key, value in config.limits
        if value is not None and value is not False
    ]
    grain = quantity("grain_um", config.abrasive.grain_um)
    rows = [
        ("title", config.title),
        ("part", f"{kind}, {sides} mm"),
        (
            "tool",
            f"{tool.preset or 'own'}, diameter {quantity('diameter_mm', tool.diameter_mm)}",
        ),
        ("abrasive", f"{config.abrasive.preset or 'own'}, grain {grain}"),
        ("machine", config.machine.preset or "own"),
        ("guide", f"{guide.family}, {density}, {guide.corner} corners, {guide.mode}"),
        *((word(key), quantity(key, value)) for key, value in config.process),
        ("start", measured or ", ".join(start)),
        ("target", ", ".join(goals)),
        ("limits", ", ".join(limits) or "none"),
        ("secondary", config.secondary),
    ]
    width = max(len(name) for name, _ in rows)
    return "\n".join(f"{name:<{width}}  {text}" for name, text in rows if text)
