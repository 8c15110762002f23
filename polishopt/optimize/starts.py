"""Starts: where searches begin, spread evenly over what they may move."""

from collections.abc import Mapping
from importlib.metadata import version

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..parts import Scalar
from ..stored import remembered


def spread_starts(
    first: Mapping[str, float | Scalar],
    between: Mapping[str, tuple[float, float]],
    count: int,
    seed: int = 0,
) -> dict[str, Float[Array, " count"]]:
    """The given start, then a scrambled Sobol sequence over the bounds.

    Args:
        first: The given start, by setting.
        between: Lower and upper bound of each setting.
        count: How many starts in all.
        seed: Seed of the scrambling.
    """
    cloud = _cloud(len(between), count - 1, seed)
    starts = {}
    for column, (name, (low, high)) in zip(cloud.T, between.items(), strict=True):
        column = np.concatenate([[float(first[name])], low + (high - low) * column])
        starts[name] = jnp.asarray(column)
    return starts


def _cloud(settings: int, count: int, seed: int) -> Float[np.ndarray, "count settings"]:
    """Points of a scrambled Sobol sequence in the unit cube."""

    def drawn():
        from scipy.stats import qmc  # takes longer to import than all of JAX

        with np.errstate(all="ignore"):
            sequence = qmc.Sobol(settings, rng=np.random.default_rng(seed))
            return sequence.random_base2(count.bit_length())

    sources = version("scipy"), version("numpy")
    return remembered(f"sobol-{settings}-{count.bit_length()}-{seed}", sources, drawn)[
        :count
    ]
