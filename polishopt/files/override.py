"""Override: `--set process.tilt_deg=7.5`, written into a document before it is checked.

An override edits the document itself, so that errors, the answer file and the results
all speak of the same config.
"""

import re
from collections.abc import Sequence
from typing import Any

from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.error import YAMLError

from .document import ConfigError, Keys, Problem, yaml
from .library import SHELVES


# section whose keys are paths themselves: `guide.order`
CHOICES = "choices"


def path_of(typed: str) -> list[str]:
    """The keys in `part.size_mm[0]`; `part.size_mm.0` means the same."""
    return re.sub(r"\[(\d+)\]", r".\1", typed).split(".")


def place_in(document: CommentedMap, path: Sequence[str], value: Any) -> tuple[Keys, str]:
    """Sets one value in a document, making sections on the way.

    Args:
        document: Changed in place.
        path: The keys, the number of a value in a list as digits.
        value: What to put there.

    Returns:
        The keys, numbers as such, and what is wrong, or '' if the value is set.
    """
    node: Any = document
    keys: list[str | int] = []
    for depth, key in enumerate(path):
        typed = ".".join(path[:depth]) or "the config"
        if isinstance(node, CommentedSeq):
            if not key.isdecimal() or int(key) >= len(node):
                return tuple(keys), f"{typed} is a list of {len(node)}; count from 0"
            keys.append(int(key))
        elif isinstance(node, CommentedMap):
            keys.append(key)
        else:
            return tuple(keys), f"{typed} is {node}, it holds no keys"
        if depth == len(path) - 1:
            node[keys[-1]] = value
        elif isinstance(node, CommentedMap):
            below = node.get(key)
            if below is None:
                node[key] = CommentedMap()
            elif isinstance(below, str) and shelved(keys):
                # a preset by its name alone makes room for keys beside it
                node[key] = CommentedMap({"preset": below})
        node = node[keys[-1]]
    return tuple(keys), ""


def chooses(document: CommentedMap, typed: str) -> list[str]:
    """The key of the choices that a path means, as it stands there, if it does.

    Args:
        document: The whole config.
        typed: `guide.order`; '' for all choices.
    """
    section = document.get(CHOICES)
    known = section if isinstance(section, CommentedMap) else ()
    same = [str(key) for key in known if path_of(str(key)) == path_of(typed)]
    return [*same, typed][:1] if typed else []


def shelved(keys: Sequence[str | int]) -> bool:
    """Whether a preset may be named here, at the top or in a step of a plan."""
    inner = keys[2:] if keys[0] == "steps" else keys
    return tuple(inner) in SHELVES


def override(document: CommentedMap, typed: Sequence[str]) -> dict[Keys, str]:
    """Writes overrides into a document.

    Args:
        document: As `parse` returns it; changed in place.
        typed: Each as `key.key=value`; the value is read as YAML.

    Returns:
        For each path that was set, the override that set it, for errors.
    """
    origin: dict[Keys, str] = {}
    problems = []
    for one in typed:
        name, equals, text = one.partition("=")
        path = path_of(name.strip())
        shown = f"--set {one}"
        if not equals or "" in path:
            sentence = "write an override as key=value, such as process.tilt_deg=7.5"
            problems.append(Problem(shown, sentence))
            continue
        try:
            value = yaml().load(text)
        except (YAMLError, ValueError, RecursionError) as error:
            reason = str(getattr(error, "problem", None) or error).partition("\n")[0]
            problems.append(Problem(shown, f"the value is not valid YAML: {reason}"))
            continue
        if path[0] == CHOICES:
            path = [CHOICES, *chooses(document, name.strip().removeprefix(CHOICES)[1:])]
        keys, wrong = place_in(document, path, value)
        if wrong:
            problems.append(Problem(shown, wrong))
        origin[keys] = shown
    if problems:
        raise ConfigError(problems)
    return origin
