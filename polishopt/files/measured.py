"""Measured: a measured surface made ready as the start map of a polishing step.

The process model wants a periodic map without holes, small enough to be polished a
thousand times in a search. What is done to get there leaves the distribution of the
heights alone: of a large map every n-th point is taken (averages would flatten it, and a
detail would lose the long waves), and the map continues beyond its border as its mirror
image, which has the same heights and no jump.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .topography import Topography, TopographyError, read


# Fewer points along a side say little about a distribution of heights.
FEWEST_POINTS = 16
# More holes than this, and what fills them would be the surface.
MOST_UNMEASURED = 0.1


@dataclass(frozen=True, eq=False)
class StartMap:
    """A periodic height map from a measurement."""

    heights: NDArray[np.float64]
    """Heights, `[y, x]`, the map and its mirror images [mm]."""
    spacing: tuple[float, float]
    """Distance of neighbouring points along y and along x [mm]."""


def start_map(path: str, most: int) -> StartMap:
    """The surface in a file as a start map.

    A least-squares plane is taken out. Holes, at most a tenth of the points, are filled
    with the smoothest surface through their rims.

    Args:
        path: The surface file.
        most: Most points to take along each side, before the map is mirrored.

    Raises:
        TopographyError: if the file cannot be read, or is too small or too full of holes.
    """
    thin, spacing, _ = sample(path, most)
    half = filled(thin)
    whole = np.block([[half, half[:, ::-1]], [half[::-1], half[::-1, ::-1]]])
    return StartMap(whole, spacing)


def sample(path: str, most: int) -> tuple[NDArray[np.float64], tuple[float, float], str]:
    """Points of a measured surface, holes included: a start map before it is filled.

    Args:
        path: The surface file.
        most: Most points to take along each side.

    Returns:
        Heights above the plane [mm], spacing along y and x [mm], and a sentence about what
        was measured and what becomes of it.

    Raises:
        TopographyError: if the file cannot be read, or is too small or too full of holes.
    """
    measured = read(path)
    rows, columns = measured.heights.shape
    if min(rows, columns) < FEWEST_POINTS:
        sentence = (
            f"holds {columns} x {rows} points, a start surface must have at least "
            f"{FEWEST_POINTS} along each side"
        )
        raise TopographyError(path, sentence)
    level = without_plane(measured.heights)
    strides = [-(-count // most) for count in (rows, columns)]
    thin = level[tuple(slice((n - 1) // 2, None, n) for n in strides)]
    share = max(measured.unmeasured, float(np.mean(np.isnan(thin))))
    if share > MOST_UNMEASURED:
        sentence = (
            f"has no height at {share:.1%} of its points, a start surface may lack at most "
            f"{MOST_UNMEASURED:.0%}; crop it or fill it first"
        )
        raise TopographyError(path, sentence)
    dy, dx = (step * n for step, n in zip(measured.spacing, strides, strict=True))
    return thin, (dy, dx), _sentence(measured, thin)


def _sentence(measured: Topography, thin: NDArray[np.float64]) -> str:
    (rows, columns), (tall, wide) = measured.heights.shape, measured.extent
    done = [f"{columns} x {rows} points on {wide:.4g} x {tall:.4g} mm", "plane taken out"]
    if thin.shape != measured.heights.shape:
        done.append(f"thinned to {thin.shape[1]} x {thin.shape[0]} points")
    holes = int(np.isnan(thin).sum())
    if holes:
        done.append(f"{holes} of them filled")
    return ", ".join([*done, "mirrored"])


def without_plane(heights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Heights above their least-squares plane, which NaN points do not bend [mm].

    Args:
        heights: Heights, NaN where nothing was measured [mm].
    """
    rows, columns = heights.shape
    y, x = np.linspace(-1, 1, rows)[:, None], np.linspace(-1, 1, columns)[None, :]
    known = ~np.isnan(heights)
    values = np.where(known, heights, 0.0)
    basis = (np.ones((1, 1)), y, x)
    normal = [[np.sum(known * a * b) for b in basis] for a in basis]
    right = [np.sum(values * a) for a in basis]
    offset, along_y, along_x = np.linalg.lstsq(normal, right)[0]
    return heights - (offset + along_y * y + along_x * x)


def filled(heights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Heights with holes filled by the smoothest surface through what is around them.

    Every filled point is the mean of its neighbours: the surface of least slope.

    Args:
        heights: Heights, NaN in the holes, not everywhere [mm].
    """
    holes = np.isnan(heights)
    if not holes.any():
        return heights
    from scipy.sparse import coo_array  # half a second that a check does not need
    from scipy.sparse.linalg import spsolve

    number = np.cumsum(holes.ravel()).reshape(holes.shape) - 1
    count = int(number.max()) + 1
    degree, right = np.zeros(count), np.zeros(count)
    ones, others = [], []
    for axis in (0, 1):
        for near, far in ((0, 1), (1, 0)):
            cut = [slice(None), slice(None)]
            cut[axis] = slice(near, holes.shape[axis] - far)
            here = tuple(cut)
            cut[axis] = slice(far, holes.shape[axis] - near)
            there = tuple(cut)
            hole = holes[here]
            at = number[here][hole]
            beside = heights[there][hole]
            np.add.at(degree, at, 1.0)
            known = ~np.isnan(beside)
            np.add.at(right, at[known], beside[known])
            ones.append(at[~known])
            others.append(number[there][hole][~known])
    every = np.arange(count)
    i, j = np.concatenate([every, *ones]), np.concatenate([every, *others])
    weights = np.concatenate([degree, -np.ones(i.size - count)])
    matrix = coo_array((weights, (i, j)), shape=(count, count)).tocsc()
    result = heights.copy()
    result[holes] = np.asarray(spsolve(matrix, right))
    return result
