"""Steps: a config that lists several polishing steps, as one config for each of them.

What stands at the top of the file holds for every step. A step names itself and what is
different: of `process` and `limits` single keys, of all other sections the whole. `start`
belongs to the first step and `target` at the top to the last.
"""

from dataclasses import dataclass
from typing import Any

from .document import Keys, Problem
from .library import filled
from .place import Located
from .schema import MERGED, REPLACED
from .sentence import did_you_mean, typed


@dataclass(frozen=True)
class StepPlace(Located):
    """Where the keys of one step were typed: under it, or at the top of the file."""

    step: int = 0

    def problem(self, keys: Keys, sentence: str, at_key: bool = False) -> Problem:
        """A mistake under `keys` of this step."""
        own = ("steps", self.step, *keys)
        deep = 2 if keys[:1] and keys[0] in MERGED else 1
        known = (*self.found.values, *self.found.keys, *self.origin, *self.chosen)
        under = any(at[: 2 + deep] == own[: 2 + deep] for at in known)
        above = any(at[:deep] == keys[:deep] for at in known)
        # what a merged section as a whole lacks is lacking at the top already
        whole = len(keys) == 1 and keys[0] in MERGED
        inside = not above or (under and not whole)
        return super().problem(own if inside else keys, sentence, at_key)


@dataclass(frozen=True)
class Typed:
    """One step as it was typed."""

    name: str
    data: dict[str, Any]
    """All sections of the step, those from the top included."""
    place: StepPlace
    unknown: list[tuple[tuple[str, ...], Any]]
    """Presets that do not exist: where, and the name typed."""


def split(data: dict[str, Any], place: Located) -> tuple[list[Typed], list[Problem]]:
    """The steps of a plan, each as a config of its own.

    Args:
        data: The plain values of the whole file, with `steps`.
        place: Where they were typed.

    Returns:
        The steps that can be read, and what is wrong with the list.
    """
    listed = data["steps"]
    top = {key: value for key, value in data.items() if key != "steps"}
    if not isinstance(listed, list) or not listed:
        sentence = "steps must be a list of at least one step"
        return [], [place.problem(("steps",), sentence, at_key=True)]
    steps, problems, names = [], [], []
    for i, step in enumerate(listed):
        at: Keys = ("steps", i)
        if not isinstance(step, dict):
            sentence = f"steps[{i}] must be a section with a name"
            problems.append(place.problem(at, sentence))
            continue
        name = step.get("name")
        if not isinstance(name, str) or not name.strip():
            sentence = f"steps[{i}].name must be a word, such as P600"
            problems.append(place.problem((*at, "name"), sentence))
            name = f"step {i + 1}"
        elif name in names:
            sentence = f"steps[{i}].name: there is a step {name!r} already"
            problems.append(place.problem((*at, "name"), sentence))
        names.append(name)
        allowed = ("name", *MERGED, *REPLACED)
        for key in step:
            if key not in allowed:
                sentence = f"steps[{i}]: unknown key {typed(key)}"
                sentence += (
                    did_you_mean(key, allowed) or f"; a step may hold {', '.join(allowed)}"
                )
                problems.append(place.problem((*at, key), sentence, at_key=True))
        sections, unknown = filled({k: v for k, v in step.items() if k in allowed[1:]})
        merged = {k: v for k, v in top.items() if k != "target"}
        if i == len(listed) - 1 and "target" in top:
            merged["target"] = top["target"]
        for key, value in sections.items():
            below = merged.get(key)
            both = key in MERGED and isinstance(value, dict) and isinstance(below, dict)
            merged[key] = {**below, **value} if both else value  # pyright: ignore[reportGeneralTypeIssues]
        where = StepPlace(**vars(place), step=i)
        steps.append(Typed(name, merged, where, unknown))
    return steps, problems
