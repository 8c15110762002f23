"""Feature: the hills of a surface, counted after the small ones are merged into others.

A hill is all that drains from one peak; it is as high as its peak is over the highest
saddle to a higher hill. Wolf pruning merges the lowest hill across that saddle, and goes
on until all that are left are high enough. Which ones these are shows in one flood that
falls from the highest point: a hill is lost if it is too low where it first meets a hill
with a higher peak.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..parts import Scalar
from .filters import Spacing


# share of Sz below which a hill does not count (ISO 25178-3)
PRUNING = 0.05
# one of each pair of opposite neighbours, along y and along x
NEIGHBOURS = ((0, 1), (1, 0), (1, 1), (1, -1))


def _pairs(map: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Views of a map and of itself moved, so that each pair of neighbours meets once."""
    ny, nx = map.shape
    return [
        (
            map[: ny - dy, max(0, -dx) : nx - max(0, dx)],
            map[dy:, max(0, dx) : nx + min(0, dx)],
        )
        for dy, dx in NEIGHBOURS
    ]


def _drained(rank: np.ndarray) -> np.ndarray:
    """Index of the peak that each point drains from, along the steepest way up."""
    index = np.arange(rank.size).reshape(rank.shape)
    highest, uphill = rank.copy(), index.copy()
    of_rank, of_index = _pairs(rank), _pairs(index)
    for (a, b), (i, j), top, way in zip(
        of_rank, of_index, _pairs(highest), _pairs(uphill), strict=True
    ):
        for mine, other, place in ((0, b, j), (1, a, i)):
            better = other > top[mine]
            np.copyto(top[mine], other, where=better)
            np.copyto(way[mine], place, where=better)
    peak = uphill.ravel()
    while not np.array_equal(peak, onward := peak[peak]):
        peak = onward
    return peak


def _saddles(
    height: np.ndarray, peak: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pairs of neighbouring hills, by their peaks, and the saddles that matter, descending.

    Those that matter are a tree: every other saddle is lower than a way around it.
    """
    # imported here: half a second that nothing else of this package needs
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import minimum_spanning_tree

    flat = height.ravel()
    index = np.arange(flat.size).reshape(height.shape)
    i, j = (
        np.concatenate([pair[side].ravel() for pair in _pairs(index)]) for side in (0, 1)
    )
    apart = (peak[i] != peak[j]) & np.isfinite(flat[i]) & np.isfinite(flat[j])
    i, j = i[apart], j[apart]
    at = np.minimum(flat[i], flat[j])
    order = np.argsort(-at, kind="stable")
    peaks, hill = np.unique(peak, return_inverse=True)
    a, b = np.minimum(hill[i], hill[j])[order], np.maximum(hill[i], hill[j])[order]
    # of several saddles between two hills the first in descending order is the highest
    _, first = np.unique(a * peaks.size + b, return_index=True)
    graph = coo_array((first + 1.0, (a[first], b[first])), (peaks.size, peaks.size))
    chosen = np.sort(minimum_spanning_tree(graph.tocsr()).data).astype(int) - 1
    return peaks[a[chosen]], peaks[b[chosen]], at[order][chosen]


def significant_hills(z: np.ndarray, threshold: float) -> tuple[np.ndarray, np.ndarray]:
    """Peaks of the hills that Wolf pruning leaves, and which hills are whole.

    A host function: hills merge one after the other, in a number and an order that only
    the data know, which is no work for compiled array code.

    Args:
        z: Heights; NaN where not measured. Points are neighbours along diagonals too. Of
            equal heights the later in memory counts as higher, so a plateau is one hill.
        threshold: Least height of a hill, in the unit of `z`.

    Returns:
        Index of each peak in the flat map; and whether its hill, with all that merged into
        it, stays clear of the border of the map and of gaps.
    """
    gap = np.isnan(z)
    if gap.all():
        return np.zeros(0, int), np.zeros(0, bool)
    height = np.where(gap, -np.inf, z)
    flat = height.ravel()
    rank = np.empty(z.size, np.int64)
    rank[np.argsort(flat, kind="stable")] = np.arange(z.size)
    peak = _drained(rank.reshape(z.shape))

    edge = np.zeros(z.shape, bool)
    edge[[0, -1]] = edge[:, [0, -1]] = True
    for (a, b), (i, j) in zip(_pairs(edge), _pairs(gap), strict=True):
        a |= j
        b |= i
    cut = np.zeros(z.size, bool)
    cut[peak[edge.ravel()]] = True

    # `flooded` joins all that the flood has joined, `kept` only what pruning merges
    peaks = np.unique(peak[~gap.ravel()])
    flooded = {p: p for p in peaks.tolist()}
    kept = dict(flooded)

    def root(parent, p):
        while parent[p] != p:
            parent[p] = p = parent[parent[p]]
        return p

    for a, b, at in zip(*(x.tolist() for x in _saddles(height, peak)), strict=True):
        low, high = root(flooded, a), root(flooded, b)
        if rank[low] > rank[high]:
            low, high, a, b = high, low, b, a
        flooded[low] = high
        if flat[low] - at < threshold:
            into = root(kept, b)
            kept[low] = into
            cut[into] |= cut[low]
    left = np.array([p for p in kept if kept[p] == p])
    # the highest hill of all, or of an island of measured points, has met no higher one
    left = left[flat[left] - flat[~gap.ravel()].min() >= threshold]
    return left, ~cut[left]


def Spd(
    z: Float[Array, "ny nx"],
    spacing: Spacing,
    pruning: float = PRUNING,
    whole_only: bool = False,
) -> Scalar:
    """Density of peaks: hills left by Wolf pruning, per measured area [1/mm^2].

    A flat map has none. The count jumps, so all derivatives are zero. It runs on the host,
    see `significant_hills`; it may still be part of a jitted function.

    Args:
        z: Heights [mm]; NaN where not measured.
        spacing: Distance of neighbouring points, or (along y, along x) [mm].
        pruning: Least height of a hill, as a share of Sz [-].
        whole_only: Whether to leave out hills that the border of the map or a gap cuts, as
            some programs do. ISO 25178-2 counts all.

    Raises:
        ValueError: if the pruning is not a share between 0 and 1, or the map has fewer
            than 2 x 2 points.

    Source: ISO 25178-2; pruning of ISO 25178-3.
    """
    if not 0 <= pruning <= 1:
        raise ValueError(f"`Spd(pruning=...)` must lie in [0, 1], got {pruning}")
    if min(z.shape) < 2:
        raise ValueError(
            f"`Spd` needs a map of at least 2 x 2 points, got {z.shape[0]} x {z.shape[1]}"
        )

    def count(z):
        z = np.asarray(z)
        height = 0.0 if np.isnan(z).all() else np.nanmax(z) - np.nanmin(z)
        if height == 0:
            return np.zeros((), z.dtype)
        peaks, whole = significant_hills(z, float(pruning * height))
        return np.asarray(whole.sum() if whole_only else peaks.size, z.dtype)

    z = jax.lax.stop_gradient(z)
    dy, dx = jnp.broadcast_to(jnp.asarray(spacing, dtype=z.dtype), (2,))
    measured = jnp.mean((~jnp.isnan(z)).astype(z.dtype))
    area = (z.shape[0] - 1) * (z.shape[1] - 1) * dy * dx * measured
    shape = jax.ShapeDtypeStruct((), z.dtype)
    return jax.pure_callback(count, shape, z, vmap_method="sequential") / area
