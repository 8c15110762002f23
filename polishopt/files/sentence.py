"""Sentence: a failed check, said in the words of the config file.

pydantic reports what failed and under which key. Here that becomes the key as typed, the
value as typed, the allowed range with its unit, and a remedy where one is known.
"""

import math
import re
from collections.abc import Iterator
from difflib import get_close_matches
from functools import cache
from typing import Any

from ..units import UNITS, from_internal, label, suffix, to_internal
from .document import Keys
from .schema import json_schema


# units of one kind, between which a number may be converted
KINDS = (
    ("mm", "um", "nm"),
    ("deg", "rad"),
    ("s", "min"),
    ("mm_min", "mm_s", "m_min"),
    ("rpm", "deg_s"),
    ("MPa", "GPa"),
)


@cache
def root_schema() -> dict[str, Any]:
    """The JSON schema of a whole config."""
    return json_schema()


def shown(keys: Keys) -> str:
    """A path as people write it: `part.size_mm[0]`."""
    path = "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in keys)
    return path.removeprefix(".") or "the config"


def typed(value: Any) -> str:
    """A value as it stands in YAML, cut short if it is long."""
    if isinstance(value, bool):
        text = str(value).lower()
    elif isinstance(value, float) and not math.isfinite(value):
        text = {"inf": ".inf", "-inf": "-.inf"}.get(str(value), ".nan")
    elif isinstance(value, float):
        text = repr(value).removesuffix(".0")
    elif value is None:
        text = "null"
    elif isinstance(value, dict):
        text = "{" + ", ".join(f"{key}: {typed(part)}" for key, part in value.items()) + "}"
    elif isinstance(value, list | tuple):
        text = "[" + ", ".join(typed(part) for part in value) + "]"
    else:
        text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def unit_of(keys: Keys) -> str:
    """The unit of the innermost key that has one, or ''."""
    units = (suffix(key) for key in reversed(keys) if isinstance(key, str))
    return next((unit for unit in units if unit), "")


def either(words: Any) -> str:
    """`'a', 'b' or 'c'`."""
    words = [f"'{word}'" for word in words]
    return " or ".join(filter(None, [", ".join(words[:-1]), words[-1]]))


def near(word: Any, words: Any) -> str:
    """The word most like `word`, or ''."""
    by_lower = {known.lower(): known for known in words}
    close = get_close_matches(str(word).lower(), by_lower, n=1, cutoff=0.6)
    return by_lower[close[0]] if close else ""


def did_you_mean(word: Any, words: Any) -> str:
    """A suggestion to put behind a sentence, or ''."""
    close = near(word, words)
    return f"; did you mean '{close}'?" if close else ""


def options(node: dict[str, Any], root: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """A node of the JSON schema and all its alternatives, references followed."""
    if "$ref" in node:
        node = root["$defs"][node["$ref"].rpartition("/")[2]]
    yield node
    for choice in (*node.get("anyOf", ()), *node.get("oneOf", ())):
        yield from options(choice, root)


def schemas_at(loc: Keys, root: dict[str, Any]) -> list[dict[str, Any]]:
    """What the JSON schema allows at a place that pydantic names.

    pydantic puts the name of a union's alternative into the place. Where the schema
    knows that name the alternative is taken, else the name is passed over.
    """
    nodes = list(options(root, root))
    for key in loc:
        tags = [
            node["discriminator"]["mapping"] for node in nodes if "discriminator" in node
        ]
        chosen = [{"$ref": tag[key]} for tag in tags if key in tag]
        below = [
            node["properties"][key] for node in nodes if key in node.get("properties", ())
        ]
        if chosen or below:
            nodes = [option for node in chosen or below for option in options(node, root)]
    return nodes


def known_keys(loc: Keys, root: dict[str, Any]) -> list[str]:
    """The keys that may stand in the section at `loc`."""
    return [key for node in schemas_at(loc, root) for key in node.get("properties", ())]


def unknown_key(loc: Keys) -> str:
    """What to do about a key that the schema does not know."""
    root = root_schema()
    key = str(loc[-1])
    known = known_keys(loc[:-1], root)
    stem = key.removesuffix("_" + suffix(key)) if suffix(key) else key
    for other in known:
        unit = suffix(other)
        if unit and stem == other.removesuffix("_" + unit):
            return f"unknown key '{key}'; use '{other}', in {label(unit)}"
    others = [name for name in root["properties"] if name != loc[0]]
    homes = [name for name in others if key in known_keys((name,), root)]
    if homes:
        return f"unknown key '{key}'; it belongs in the section {either(homes)}"
    if near(key, known):
        return f"unknown key '{key}'{did_you_mean(key, known)}"
    return f"unknown key '{key}'; known here: {', '.join(known)}"


def not_a_number(value: Any, unit: str, noun: str) -> str:
    """Why a value is no number, with a remedy where the intention is clear."""
    sentence = f"must be a {noun}"
    if not isinstance(value, str):
        return sentence
    text = value.strip()
    if re.fullmatch(r"[+-]?\d+,\d+", text):
        return f"{sentence}; use a decimal point, not a comma"
    parts = re.fullmatch(r"([+-]?[\d.]+(?:e[+-]?\d+)?)\s*(\D.*)?", text, re.IGNORECASE)
    try:
        number = float(parts[1]) if parts else math.nan
    except ValueError:
        return sentence
    if parts is None:
        return sentence
    if parts[2] is None:
        return f"{sentence}; remove the quotes"
    written = {label(name): name for name in UNITS} | {name: name for name in UNITS}
    written["\u03bcm"] = "um"  # the Greek letter looks like the micro sign
    given = written.get(parts[2].strip(), "")
    if given == unit or any(given in kind and unit in kind for kind in KINDS):
        number = from_internal(to_internal(number, given), unit)
        return f"{sentence}; the key says the unit, write {number:.6g}"
    return sentence


def wrong_value(error: Any, keys: Keys) -> str:
    """The sentence for an error of pydantic about a value that is there.

    Args:
        error: One entry of `ValidationError.errors()`.
        keys: The place of the value in the file.
    """
    kind, value, about = error["type"], error["input"], error.get("ctx", {})
    name, unit = shown(keys), unit_of(keys)
    is_what = f"{name} is {typed(value)}, "
    if kind == "interval":
        return f"{is_what}must lie in {about['interval']} {label(unit)}".rstrip()
    if kind == "sentence":
        return f"{name} {error['msg']}" if value is ... else is_what + error["msg"]
    if kind == "finite_number":
        return f"{is_what}must be a finite number"
    if kind in ("float_type", "int_type", "int_from_float"):
        noun = "number" if kind == "float_type" else "whole number"
        return is_what + not_a_number(value, unit, noun)
    if kind == "bool_type":
        return f"{is_what}must be true or false"
    if kind == "string_type":
        return f"{is_what}must be text; put it in quotes"
    if kind == "literal_error":
        words = re.findall(r"'(.*?)'", about["expected"]) or [about["expected"]]
        must = either(words) if "'" in about["expected"] else about["expected"]
        return f"{is_what}must be {must}{did_you_mean(value, words)}"
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        key = about["discriminator"].strip("'")
        words = [
            word
            for node in schemas_at(error["loc"], root_schema())
            for word in node.get("discriminator", {}).get("mapping", ())
        ]
        if kind == "union_tag_not_found":
            return f"{name} lacks the key '{key}', which must be {either(words)}"
        must = f"must be {either(words)}{did_you_mean(about['tag'], words)}"
        return f"{name}.{key} is {typed(value[key])}, {must}"
    if kind in ("tuple_type", "list_type"):
        return f"{is_what}must be a list such as [1, 2]"
    if kind == "too_long":
        return (
            f"{name} holds {len(value)} values, must hold {about['max_length']} "
            "(a comma separates values, a point marks decimals)"
        )
    if kind in ("model_type", "model_attributes_type", "dict_type"):
        return f"{is_what}must be a section with keys of its own"
    return f"{is_what}{error['msg'][0].lower()}{error['msg'][1:]}"
