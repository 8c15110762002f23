"""Batches: searches from many places, a few of them side by side, run from the host.

What an optimiser does between two evaluations is the same small program for all problems
of a size, while the slopes of a model of the process may take long to compile. So the two
are programs of their own, compiled at the same time, which take turns. Calling them from
the host takes as long for one search as for eight, so batches share that; and two of them
run at once, since one does not keep two cores busy.
"""

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from threading import Event
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, PyTree

from ..stored import seldom
from .auglag import as_float
from .box import slopes
from .certificate import Solution
from .kept import Kept
from .values import Values
from .walk import Rules, Walk, ended, over, problem_of, proposed, set_out, taken_in


# Batches that run at the same time.
AT_ONCE = 2

Places = Mapping[str, Float[Array | np.ndarray, " starts"]]


def looked_at(
    values: Callable[..., Values],
    x: PyTree,
    skipped: Bool[Array, " starts"],
    *given: PyTree,
) -> tuple[Any, Any]:
    """The parts of a problem at several places, and their slopes per unit.

    Args:
        values: Of one place, and of what is given with it.
        x: Places, a pytree with a leading axis.
        skipped: Places that nobody asks about: zeros are returned there.
        given: More that differs from place to place, likewise.

    Returns:
        Residuals, objectives, inequalities and equalities; and the derivatives of all of
        them in that order, flat, by the flat unknowns.
    """

    def look(x, *given):
        point, _ = ravel_pytree(x)

        def parts(x):
            found = jax.tree.map(as_float, values(x, *given).parts())
            return found, found

        _, columns, found = slopes(parts, x, jnp.ones_like(point))
        return found, columns

    once: Any = jax.jit(look)  # traced but once

    def one(skipped, *rest):
        shapes = once.eval_shape(*rest)

        def nothing(*_):
            return jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), shapes)

        return jax.lax.cond(skipped, nothing, once, *rest)

    return _each(one, skipped, x, *given)


def walked(
    look: Callable[[PyTree, Bool[Array | np.ndarray, " starts"]], tuple[Any, Any]],
    places: PyTree,
    lower: PyTree,
    upper: PyTree,
    rules: Rules,
    vacant: Bool[np.ndarray, " starts"] | None = None,
) -> Solution:
    """Where searches from several places end, run side by side.

    Args:
        look: As `looked_at`, of places and whether they are skipped.
        places: Where they start, within the bounds; a pytree with a leading axis.
        lower: Lower bounds, a pytree like `places`.
        upper: Upper bounds.
        rules: When a search is over.
        vacant: Places where nothing is searched, whose answers mean nothing; None for
            none of them.
    """
    if vacant is None:
        vacant = np.zeros(len(jax.tree.leaves(places)[0]), bool)
    parts, columns = look(places, vacant)
    walk = _set_out(parts, places, lower, upper)
    _ended.meanwhile(walk, parts, lower, upper, rules)
    while True:
        walk, done = _turn(walk, parts, columns, lower, upper, rules)
        done = np.asarray(done) | vacant
        if np.all(done):
            return _ended(walk, parts, lower, upper, rules)
        parts, columns = look(walk.trial.y, done)


def ahead(
    outline: tuple[Any, Any], places: PyTree, lower: PyTree, upper: PyTree, rules: Rules
) -> None:
    """Has the programs made in the background that `walked` begins with.

    Args:
        outline: What `look` will return, by its shapes.
        places: As in `walked`.
        lower: As in `walked`.
        upper: As in `walked`.
        rules: As in `walked`.
    """
    parts, columns = outline
    walk = _set_out.ahead(parts, places, lower, upper)
    _turn.ahead(walk, parts, columns, lower, upper, rules)


@seldom
def _set_out(parts, places, lower, upper) -> Walk:
    def one(parts, x, lower, upper):
        return _typed(set_out(problem_of(parts, x, lower, upper), x))

    return _each(one, parts, places, lower, upper)


@seldom
def _turn(
    walk: Walk, parts, columns, lower, upper, rules: Rules
) -> tuple[Walk, Bool[Array, " starts"]]:
    """All walks after their trial points, those that are over as they were."""

    def one(walk, parts, columns, lower, upper):
        def turned():
            width = walk.state.scale
            problem = problem_of(parts, walk.x, lower, upper, width=width)
            values = ravel_pytree(parts)[0].astype(width.dtype)
            new = taken_in(problem, rules, walk, values, columns * width[None, :])
            return _typed(proposed(problem, rules, new))

        new = jax.lax.cond(over(rules, walk), lambda: walk, turned)
        return new, over(rules, new)

    return _each(one, walk, parts, columns, lower, upper)


def _each(f: Callable[..., Any], *places: PyTree) -> Any:
    """What a function returns for every place.

    On a processor one place after another: what one of them needs stays in the cache then,
    and what is skipped costs nothing. On an accelerator all at once.
    """
    if jax.default_backend() == "cpu":
        return jax.lax.map(lambda place: f(*place), places)
    return jax.vmap(f)(*places)


def _typed(walk: Walk) -> Walk:
    """The same without weak types, so that the first turn is compiled like all others."""
    return jax.tree.map(lambda x: jnp.asarray(x, x.dtype), walk)


@seldom
def _ended(walk: Walk, parts, lower, upper, rules: Rules) -> Solution:
    def one(walk, parts, lower, upper):
        problem = problem_of(parts, walk.x, lower, upper, width=walk.state.scale)
        return ended(problem, rules, walk)

    return _each(one, walk, parts, lower, upper)


def in_batches(
    search: Callable[..., Solution],
    places: Places,
    size: int,
    kept: Kept | None = None,
    *what: Any,
    **more: np.ndarray,
) -> Solution:
    """Searches from all places, up to `size` of them at a time.

    Which places make up a batch depends on nothing but how many there are.

    Args:
        search: From `size` places, side by side, each an entry of `places` and of `what`;
            last it is told which of them are vacant.
        places: Where searches start, by setting.
        size: How many a batch has room for.
        kept: Finished batches, which are not run again; new ones are added.
        what: More that differs from search to search: pytrees with an axis of starts.
        more: What is kept with them, and part of what they are, one entry a search.
    """
    count = len(next(iter(places.values())))
    least = min(AT_ONCE, count) if jax.default_backend() == "cpu" else 1
    index = np.array_split(np.arange(count), max(-(-count // size), least))

    def given(chosen):
        return jax.tree.map(lambda x: x[chosen], (dict(places), *what))

    known = [{name: values[chosen] for name, values in more.items()} for chosen in index]
    names, parts = [], [None] * len(index)
    if kept:
        names = [kept.name(given(c), k, size) for c, k in zip(index, known, strict=True)]
        parts = [kept.get(name) for name in names]

    halted = Event()

    def run(i):
        if halted.is_set():
            return None
        try:
            # room that is left is filled with the last place, and vacant
            slots = np.arange(size)
            chosen = index[i][np.minimum(slots, len(index[i]) - 1)]
            found = jax.device_get(search(*given(chosen), slots >= len(index[i])))
            found = jax.tree.map(lambda x: x[: len(index[i])], found)
            if kept:
                kept.put(names[i], found, **known[i])
        except BaseException:
            halted.set()
            raise
        return found

    left = [i for i, part in enumerate(parts) if part is None]
    pool = ThreadPoolExecutor(AT_ONCE)
    try:
        for i, part in zip(left, pool.map(run, left), strict=True):
            parts[i] = part
    finally:
        # who interrupts this does not want to wait for searches under way
        halted.set()
        pool.shutdown(wait=False, cancel_futures=True)
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)
