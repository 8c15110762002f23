"""Choices: alternatives for values of a config, and the config of each combination.

    choices:
      guide.order: [2, 3]
      abrasive: [P600, P1200]

stands for four configs: each with other values put into the document. So each is checked
like any other config, and what is wrong with it is said of the alternative as typed.
"""

import copy
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from ruamel.yaml.comments import CommentedMap

from .document import Keys, Problem, survey
from .override import CHOICES, path_of, place_in
from .place import Located
from .sentence import shown, typed


MOST = 64  # combinations
LONGEST = 60  # letters of an alternative in tables
# what combinations are compared by, and what is no part of a job
COMMON = ("schema", "title", "target", "secondary", "solver", "errors", "name", CHOICES)


@dataclass(frozen=True)
class Combination:
    """The config with one alternative of each choice."""

    chosen: dict[str, str]
    """The alternatives by key, as tables show them."""
    document: CommentedMap
    """The document, without choices."""
    place: Located
    """Where everything was typed."""


def combinations(
    document: CommentedMap, place: Located
) -> tuple[list[Combination], list[Problem]]:
    """All combinations of alternatives, the last key changing fastest.

    Args:
        document: The whole config; it is not changed.
        place: Where it was typed.

    Returns:
        The combinations, none where there is no choice or any is not one; and what is
        wrong with the section.
    """
    section = document.get(CHOICES)
    if section is None:
        return [], []
    if not isinstance(section, CommentedMap):
        sentence = f"{CHOICES} must be a section with lists, such as guide.order: [2, 3]"
        return [], [place.problem((CHOICES,), sentence)]
    plain = place.found.data[CHOICES]
    problems = malformed(plain, place)
    count = 1
    for values in plain.values():
        count *= len(values) if isinstance(values, list) else 1
    if count > MOST and not problems:
        sentence = f"{CHOICES} make {count} combinations, must make at most {MOST}"
        problems.append(place.problem((CHOICES,), sentence, at_key=True))
    if problems or not plain or None in plain.values():
        return [], problems
    words = {key: called(values) for key, values in plain.items()}
    made = []
    for numbers in itertools.product(*(range(len(values)) for values in plain.values())):
        typed_keys = dict(zip(plain, numbers, strict=True))
        one, wrong = combined(document, place, typed_keys)
        problems += wrong
        chosen = {key: words[key][i] for key, i in typed_keys.items()}
        made.append(Combination(chosen, *one))
    unique = list(dict.fromkeys(problems))
    return ([], unique) if unique else (made, [])


def malformed(plain: Mapping[str, Any], place: Located) -> list[Problem]:
    """What is wrong with keys and lists, whatever stands in the lists."""
    problems = []
    before: dict[str, list[str]] = {}
    for key, values in plain.items():
        at: Keys = (CHOICES, key)
        path = path_of(key)
        within = path[2:] if path[0] == "steps" else path
        if not within or within[0] in COMMON:
            what = "it is what all of them have in common"
            if not within:
                what = "name a key of a step, such as steps[0].guide.order"
            sentence = f"{shown(at)}: there can be no alternatives; {what}"
            problems.append(place.problem(at, sentence, at_key=True))
        for other, earlier in before.items():
            if earlier[: len(path)] == path:
                sentence = f"is the same key as {other}"
                if len(earlier) > len(path):
                    sentence = f"must stand above {other}, which is a part of it"
                sentence = f"{shown(at)} {sentence}"
                problems.append(place.problem(at, sentence, at_key=True))
        before[key] = path
        if not isinstance(values, list) or not values:
            sentence = f"{shown(at)} is {typed(values)}, must be a list of alternatives"
            if values is not None:  # who checks the config says that it has no value
                problems.append(place.problem(at, f"{sentence}, such as [2, 3]"))
            continue
        for i, value in enumerate(values):
            if value in values[:i]:
                sentence = f"{shown(at)} has {typed(value)} twice"
                problems.append(place.problem((*at, i), sentence))
    return problems


def combined(
    document: CommentedMap, place: Located, numbers: Mapping[str, int]
) -> tuple[tuple[CommentedMap, Located], list[Problem]]:
    """The document with alternatives in place, where all was typed, and what is wrong.

    Args:
        document: The whole config; it is not changed.
        place: Where it was typed.
        numbers: Which alternative of each key.
    """
    changed = copy.deepcopy(document)
    chosen: dict[Keys, Keys] = {}
    problems = []
    for key, values in document[CHOICES].items():
        i = numbers[str(key)]
        # a copy, so that a choice within an alternative does not change it for others
        value = copy.deepcopy(values[i])
        keys, wrong = place_in(changed, path_of(str(key)), value)
        if wrong:
            at = (CHOICES, str(key))
            problems.append(place.problem(at, f"{shown(at)}: {wrong}", at_key=True))
        chosen[keys] = (CHOICES, str(key), i)
    found = survey(changed, place.name)
    del changed[CHOICES]
    return (changed, replace(place, found=found, chosen=chosen)), problems


def called(values: Sequence[Any]) -> list[str]:
    """What tables call alternatives, each something else."""
    words = [word(value) for value in values]
    cut = [one if len(one) <= LONGEST else one[: LONGEST - 3] + "..." for one in words]
    return [f"{one} ({i + 1})" if cut.count(one) > 1 else one for i, one in enumerate(cut)]


def word(value: Any) -> str:
    """A value as people write it, without quotes."""
    if isinstance(value, str):
        return value
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {word(part)}" for key, part in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(word, value)) + "]"
    return typed(value)


def title(chosen: Mapping[str, str]) -> str:
    """What a combination is called: `guide.order 2, abrasive P600`."""
    return ", ".join(f"{key} {word}" for key, word in chosen.items())


def named(problems: Mapping[str, Sequence[Problem]]) -> list[Problem]:
    """Each mistake once, with the combination it is made in.

    Args:
        problems: Of each combination, by what it is called.
    """
    held: dict[Problem, list[str]] = {}
    for name, found in problems.items():
        for one in dict.fromkeys(found):
            held.setdefault(one, []).append(name)
    return [
        replace(one, sentence=f"{one.sentence}; with {names[0]}{also(len(names) - 1)}")
        for one, names in held.items()
    ]


def also(count: int) -> str:
    """Of how many more combinations the same is true."""
    if not count:
        return ""
    return f" and {count} more combination{'s' if count > 1 else ''}"
