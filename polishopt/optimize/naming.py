"""Naming: what holds an answer where it is, by name, for reports and not for `jit`.

A constraint is called after its place in the structure that its function returns: `force`
for an entry of a dictionary or a field, `force[2]` in an array, `inequality[0]` where there
is no other name. Bounds are called after the unknown.
"""

import jax
import numpy as np
from jaxtyping import PyTree

from .certificate import Solution


def conflict(solution: Solution) -> dict[str, float]:
    """The constraints and bounds that cannot hold together, the worst violated first.

    Args:
        solution: Where one solve ended; not a batch of them.

    Returns:
        By how much each is violated [its unit]: negative for an equality that is too
        small, 0 for a bound, which is in the way and holds. Empty unless infeasible.
    """
    inequality, equality, bound = (_named(part) for part in solution.conflict)
    sides = _named(solution.bound_multipliers)
    values = [
        *_marked(inequality, _named(solution.inequality), "inequality"),
        *_marked(equality, _named(solution.equality), "equality"),
    ]
    values.sort(key=lambda item: -abs(item[1]))
    walls = [(_bound(name, sides[name]), 0.0) for name, mark in bound.items() if mark]
    return dict(values + walls)


def active(solution: Solution) -> dict[str, float]:
    """Limits and bounds that push, by name: what one unit more of each is worth.

    Args:
        solution: Where one solve ended; not a batch of them.

    Returns:
        Fall of the objective per unit that the limit is relaxed [1/its unit], for the
        inequalities and bounds with a multiplier.
    """
    limits = _named(solution.inequality_multipliers)
    marked = {name: value > 0 for name, value in limits.items()}
    found = dict(_marked(marked, limits, "inequality"))
    for name, value in _named(solution.bound_multipliers).items():
        if value:
            found[_bound(name, value)] = abs(value)
    return found


def _named(tree: PyTree) -> dict[str, float]:
    """The numbers of a pytree, by name."""
    found = {}
    for path, leaf in jax.tree_util.tree_flatten_with_path(tree)[0]:
        name = jax.tree_util.keystr(path, simple=True, separator=".")
        array = np.asarray(leaf)
        for index in np.ndindex(array.shape):
            place = f"[{', '.join(map(str, index))}]" if index else ""
            found[name + place] = float(array[index])
    return found


def _marked(marks, values, role: str) -> list[tuple[str, float]]:
    """Those values that are marked; without a name of their own they have their role's."""
    return [
        (role + name if name.startswith("[") or not name else name, values[name])
        for name, mark in marks.items()
        if mark
    ]


def _bound(name: str, multiplier: float) -> str:
    """What the bound of an unknown is called."""
    name = "x" + name if name.startswith("[") or not name else name
    return f"{'upper' if multiplier > 0 else 'lower'} bound of {name}"
