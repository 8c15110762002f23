"""Library: the named tools, abrasives and machines that come with polishopt.

A preset is a YAML file in `presets/`. Naming one in a config (`tool: disc_18mm`, or
`tool: {preset: disc_18mm, friction: 0.3}`) puts its keys under the ones that are typed:
a typed key always wins.
"""

from functools import cache
from importlib.resources import files
from typing import Any

from ruamel.yaml import YAML


# where in a config a preset may be named, and the shelf it comes from
SHELVES: dict[tuple[str | int, ...], str] = {
    ("tool",): "tools",
    ("abrasive",): "abrasives",
    ("machine",): "machines",
    ("start", "scratches", "abrasive"): "abrasives",
}


@cache
def names(shelf: str) -> tuple[str, ...]:
    """The presets of a shelf (`tools`, `abrasives` or `machines`), sorted."""
    folder = files("polishopt.files").joinpath("presets", shelf)
    return tuple(
        sorted(
            file.name.removesuffix(".yaml") for file in folder.iterdir() if file.is_file()
        )
    )


@cache
def text(shelf: str, name: str) -> str:
    """A preset as it is written, comments and sources included."""
    file = files("polishopt.files").joinpath("presets", shelf, f"{name}.yaml")
    return file.read_text(encoding="utf-8")


def preset(shelf: str, name: str) -> dict[str, Any]:
    """The keys of a preset, a fresh copy at each call."""
    return YAML(typ="safe", pure=True).load(text(shelf, name))


def over(typed: dict[str, Any], given: dict[str, Any]) -> dict[str, Any]:
    """`given` with the keys of `typed` laid over it, section by section."""
    merged = dict(given)
    for key, value in typed.items():
        below = given.get(key)
        both = isinstance(value, dict) and isinstance(below, dict)
        merged[key] = over(value, below) if both else value  # pyright: ignore[reportArgumentType]
    return merged


def filled(
    data: dict[str, Any],
) -> tuple[dict[str, Any], list[tuple[tuple[str, ...], Any]]]:
    """A config with its presets laid under what was typed.

    Args:
        data: The config as typed; it is not changed.

    Returns:
        The filled config, and (place, name typed) of each preset that does not exist.
    """
    unknown = []

    def fill(node: Any, at: tuple[str, ...]) -> Any:
        if at in SHELVES:
            # a name alone stands for {preset: name}
            section = {"preset": node} if isinstance(node, str) else node
            if not isinstance(section, dict) or "preset" not in section:
                return node
            name = section["preset"]
            if name not in names(SHELVES[at]):
                unknown.append((at, name))
                return section
            return over(section, preset(SHELVES[at], name))
        if isinstance(node, dict):
            inward = [place for place in SHELVES if place[: len(at)] == at]
            below = {place[len(at)] for place in inward}
            return {k: fill(v, (*at, k)) if k in below else v for k, v in node.items()}
        return node

    return fill(data, ()), unknown
