"""Constants: the numbers of tool, abrasive and start texture, by their names.

A name is that of the noun and of its field, `tool.foundation`; a number of a table carries
its place, `tool.unstick_forces[0]`. The start has the texture that earlier steps left,
`start.roughness.Sq`.
"""

import dataclasses
import re
from collections.abc import Mapping

from .parts import Abrasive, Scalar, Tool
from .setup import Setup
from .texture.areal import parameters_from_cumulants
from .texture.planarisation import asperity_stiffness
from .texture.scratches import Population


START = ("start.roughness.Sq", "start.roughness.Ssk", "start.roughness.Sku")


def roughness_cumulants(Sq: Scalar, Ssk: Scalar, Sku: Scalar) -> Population:
    """The cumulants of a roughness of which Sq [mm], Ssk and Sku are known."""
    return Population(Sq**2, Ssk * Sq**3, (Sku - 3.0) * Sq**4)


def _place(name: str) -> tuple[str, int | None]:
    """A field, and which of its numbers."""
    found = re.fullmatch(r"(.+)\[(\d+)\]", name)
    return (name, None) if found is None else (found[1], int(found[2]))


def part(setup: Setup, name: str) -> Scalar:
    """The constant of a setup that a name such as `tool.foundation` stands for."""
    owner, _, field = name.rpartition(".")
    if name in START:
        Sq, Ssk, Sku = parameters_from_cumulants(*setup.start.total)
        return {"Sq": Sq, "Ssk": Ssk, "Sku": Sku}[field]
    if field == "asperity_stiffness":
        return asperity_stiffness(setup.abrasive)
    field, index = _place(field)
    value = getattr(getattr(setup, owner), field)
    return value if index is None else value[index]


def _replaced(noun: Tool | Abrasive, values: Mapping[str, Scalar]) -> Tool | Abrasive:
    """A noun with some of its numbers replaced."""
    new = {}
    for name, value in values.items():
        field, index = _place(name)
        table = new.get(field, getattr(noun, field))
        new[field] = value if index is None else table.at[index].set(value)
    return dataclasses.replace(noun, **new)


def with_constants(setup: Setup, values: Mapping[str, Scalar]) -> Setup:
    """A setup with some of its constants replaced.

    Args:
        setup: The job.
        values: Constants by name [mm, N, s, rad]. Of the start, what is not given stays.
    """
    for owner in ("tool", "abrasive"):
        mine = {
            name.removeprefix(f"{owner}."): value
            for name, value in values.items()
            if name.startswith(f"{owner}.")
        }
        new = _replaced(getattr(setup, owner), mine)
        setup = dataclasses.replace(setup, **{owner: new})
    if any(name in values for name in START):
        known = (values[n] if n in values else part(setup, n) for n in START)
        start = dataclasses.replace(setup.start, scratches=(roughness_cumulants(*known),))
        setup = dataclasses.replace(setup, start=start)
    return setup
