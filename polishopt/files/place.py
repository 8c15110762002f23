"""Place: what is wrong with a config, and where in the file it was typed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from pydantic import ValidationError

from .document import Keys, Place, Problem, Survey, problem
from .library import SHELVES, names
from .sentence import either, shown, unknown_key, wrong_value


@dataclass(frozen=True)
class Located:
    """A document under check: turns a path of keys into a place for an error."""

    name: str
    text: str
    found: Survey
    origin: dict[Keys, str]
    chosen: Mapping[Keys, Keys] = field(default_factory=dict)
    """Where the alternatives were typed that stand in place of the values under keys."""

    def problem(self, keys: Keys, sentence: str, at_key: bool = False) -> Problem:
        """A mistake under `keys`, or at the innermost section of them that was typed."""
        ends = range(len(keys), 0, -1)
        held = next((end for end in ends if keys[:end] in self.chosen), 0)
        if held:
            alternative = self.chosen[keys[:held]]
            # a key that is wrong is so for all its alternatives
            whole = at_key and held == len(keys)
            keys = alternative[:-1] if whole else (*alternative, *keys[held:])
        elif keys and keys not in self.found.values:
            # a section that is there for an alternative alone
            within = (to for at, to in self.chosen.items() if at[: len(keys)] == keys)
            keys = next(within, (*keys, ...))[:-1]
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
