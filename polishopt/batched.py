"""Batched: a function of one place at many places, a few at a time."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp


def in_batches(f: Callable[..., Any], places: Any, size: int) -> Any:
    """The function at every place, `size` of them at a time under `vmap`.

    As `jax.lax.map` with a batch size, but without a remainder, which it would compile once
    more: the last batch is filled up with the last place.

    Args:
        f: A function of one place.
        places: Pytree with a leading axis of places, one or more.
        size: Places in a batch.

    Returns:
        What the function returns, with a leading axis of places.
    """
    count = jax.tree.leaves(places)[0].shape[0]
    if count <= size:
        return jax.vmap(f)(places)
    more = -count % size

    def filled(x):
        return jnp.concatenate([x, jnp.broadcast_to(x[-1:], (more, *x.shape[1:]))])

    done = jax.lax.map(f, jax.tree.map(filled, places), batch_size=size)
    return jax.tree.map(lambda y: y[:count], done)
