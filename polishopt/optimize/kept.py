"""Kept: finished searches, so that an interrupted run goes on where it stopped.

A long search falls into batches that depend on nothing but what they are given, so each
finished one is kept under a fingerprint of just that: all numbers, the settings of the
search, the source of the package and the versions beneath it. What was found by anything
else has another name and cannot be taken for it. A batch is the same program on the same
numbers whenever it runs, so an answer put together of kept and new ones is the one that an
undisturbed run gives, bit for bit.
"""

import json
from collections.abc import Iterator, Mapping
from contextlib import suppress
from typing import Any, Protocol, runtime_checkable

import jax
import numpy as np

from ..stored import fingerprint, surroundings
from .certificate import Solution


LETTERS = 12  # of each part of a name
OUTDATED = (
    "the finished searches are of another version of polishopt or of what it stands on, or "
    "of another processor: all starts are searched again"
)


@runtime_checkable
class Store(Protocol):
    """Where batches are: a plain dictionary, or `files.searches.Searches` in a folder."""

    def get(self, name: str, /) -> Mapping[str, np.ndarray] | None:
        """The arrays of a batch by name; None where there is no such batch."""
        ...

    def __setitem__(self, name: str, arrays: Mapping[str, np.ndarray], /) -> None: ...

    def __iter__(self) -> Iterator[str]: ...


class Kept:
    """The finished batches of one search."""

    def __init__(self, store: Store, *job: Any):
        """What is kept, and what it must belong to.

        Args:
            store: Where batches are, by name; others may be among them.
            job: All that every batch of the search depends on.

        Raises:
            ValueError: if a part of the job, such as a chain, has no name of its own.
        """
        self.store = store
        self.job = fingerprint(*job)[:LETTERS]
        self.about = about()

    def name(self, *batch: Any) -> str:
        """What a batch is called.

        Args:
            batch: All that it depends on beside the job.
        """
        return f"{self.job}-{self.about}-{fingerprint(*batch)[:LETTERS]}"

    def get(self, name: str) -> Solution | None:
        """A finished batch; None where there is none, or none that can be understood."""
        arrays = self.store.get(name)
        with suppress(KeyError, ValueError):
            return None if arrays is None else whole(arrays)
        return None

    def put(self, name: str, solution: Solution, **more: np.ndarray) -> None:
        """Keeps a finished batch.

        Args:
            name: From `name`.
            solution: Where its searches ended.
            more: What readers want to know of them.
        """
        self.store[name] = flat(solution) | more

    def strange(self) -> str:
        """Why nothing that is kept can be used, in a sentence; '' if some of it can be."""
        found = [name.split("-")[:2] for name in self.store]
        if not found or [self.job, self.about] in found:
            return ""
        if any(job == self.job for job, *_ in found):
            return OUTDATED
        return "the finished searches are of another config: all starts are searched again"


def about() -> str:
    """What searches of this version of the package are called, whatever their job."""
    return surroundings().hex()[:LETTERS]


def outdated(store: Store) -> str:
    """Why nothing that is kept can be used, whatever the job; '' if some of it may be.

    Args:
        store: Where batches are, of several jobs.
    """
    found = {part for name in store for part in name.split("-")[1:2]}
    return OUTDATED if found and about() not in found else ""


def flat(solution: Solution) -> dict[str, np.ndarray]:
    """The arrays of a solution by name, `x tilt`, and as `shape` how they hang together."""
    arrays: dict[str, np.ndarray] = {}

    def shape(node, place):
        if isinstance(node, Mapping):
            return {key: shape(value, f"{place} {key}") for key, value in node.items()}
        if isinstance(node, tuple):
            return [shape(value, f"{place} {i}") for i, value in enumerate(node)]
        if node is None:
            return None
        if isinstance(node, list):
            raise TypeError(f"{place.strip()} is a list; what is kept has tuples.")
        arrays[place.strip()] = np.asarray(node)
        return place.strip()

    made = shape(vars(jax.device_get(solution)), "")
    return arrays | {"shape": np.asarray(json.dumps(made))}


def whole(arrays: Mapping[str, np.ndarray]) -> Solution:
    """The solution that `flat` took apart.

    Args:
        arrays: What it made, and perhaps more.
    """

    def put(node):
        if isinstance(node, dict):
            return {key: put(value) for key, value in node.items()}
        if isinstance(node, list):
            return tuple(map(put, node))
        return None if node is None else arrays[node]

    # made as JAX makes it: those of a batch have an axis more than their types say
    solution = object.__new__(Solution)
    for field, value in put(json.loads(str(arrays["shape"]))).items():
        object.__setattr__(solution, field, value)
    return solution
