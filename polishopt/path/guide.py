"""Guide: the plane curve along which the trochoid is rolled.

A guide is a polyline of straight edges and right-angled turns whose corners are rounded,
known by arc length in closed form. It is cut into cells, one around each vertex, from the
middle of one edge to the middle of the next. All cells are the same corner, scaled,
turned or straight, so a point costs one look-up and one polynomial. The look-up needs no
search: a table of equal buckets, none longer than the shortest cell, says which cell
holds the start of a bucket, and a bucket meets at most one more. The lattice is kept in
units of its pitch, so that only the pitch carries a length.

The circular fillet makes the curvature jump. A tool that leans along the guide then turns
about its normal at a speed that jumps too, which no machine can follow. The default
corner therefore turns by a quintic in arc length: its curvature and the derivative of its
curvature are continuous everywhere.
"""

import math
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, Int

from ..parts import Scalar, as_array, as_scalar
from .corner import LENGTH, unit_corner


MAX_ORDER = 7
Size = Float[Array, "2"] | Sequence[float | int]


class GuidePoint(eqx.Module):
    """A point of a plane curve that is known by its arc length."""

    position: Float[Array, "2"]
    """Where it is in the parameter plane, C [mm]."""
    heading: Scalar
    """Direction of travel from the x axis, continuous along the curve [rad]."""
    curvature: Scalar
    """Change of heading per length, positive to the left [1/mm]."""


class Bends(eqx.Module):
    """How much of a guide bends how much, for sums over it that ask nothing else."""

    curvature: Float[Array, " n"]
    """Size of the curvature [1/mm]."""
    aspect: Float[Array, " n"]
    """Heading, from the direction in which the tool axis leans [rad]."""
    share: Float[Array, " n"]
    """Share of the guide's length; they add up to one [-]."""


class Cells(eqx.Module):
    """What a guide knows about the surroundings of each vertex, in units of the pitch."""

    vertex: Float[Array, "*n 2"]
    """The corner before it is rounded [pitch]."""
    direction: Float[Array, "*n 2"]
    """Unit vector of the edge that enters [-]."""
    heading: Float[Array, "*n"]
    """Heading of that edge, without jumps of a full turn [rad]."""
    turn: Float[Array, "*n"]
    """1 for a turn to the left, -1 to the right, 0 for none [-]."""
    entry: Float[Array, "*n"]
    """Length of the entering edge that belongs to this cell [pitch]."""
    start: Float[Array, "*n"]
    """Arc length at which the cell begins [pitch]."""
    end: Float[Array, "*n"]
    """Arc length at which the cell ends [pitch]."""


class Guide(eqx.Module):
    """A polyline with rounded right-angled corners, by arc length.

    `guide(s)` is its `GuidePoint` at the arc length s [mm]. Before the start and past the
    end it goes straight on. It can be differentiated in s and in `pitch`, which moves the
    whole curve; at a sharp corner the side after the corner holds.
    """

    pitch: Scalar = eqx.field(converter=as_scalar)
    """Distance between neighbouring lines of the lattice, h [mm]."""
    cells: Cells
    """One cell per vertex, in the order of travel."""
    table: Int[Array, " buckets"]
    """Index of the cell that holds the start of each bucket [-]."""
    panels: Float[Array, " panels_and_1"]
    """Arc lengths between which the curve is analytic, at most a pitch apart [pitch]."""
    corner: str = eqx.field(static=True)
    """Shape of the corners: "smooth", "arc" or "sharp"."""
    fillet: float = eqx.field(static=True)
    """Length of the two legs that a rounded corner replaces, 0 if sharp [pitch]."""

    @property
    def length(self) -> Scalar:
        """Arc length of the whole guide [mm]."""
        return self.pitch * self.cells.end[-1]

    @property
    def vertices(self) -> Float[Array, "n 2"]:
        """Corners of the polyline before they are rounded [mm]."""
        return self.pitch * self.cells.vertex

    def __call__(self, s: Scalar) -> GuidePoint:
        """Point of the guide at the arc length `s` [mm]."""
        at = s / self.pitch
        total = self.cells.end[-1]
        last = self.table.size - 1
        bucket = jnp.floor(jax.lax.stop_gradient(at / total) * self.table.size)
        i = self.table[jnp.clip(bucket, 0, last).astype(self.table.dtype)]
        i = jnp.where(at >= self.cells.end[i], i + 1, i)
        cell = jax.tree.map(lambda x: x[jnp.minimum(i, x.shape[0] - 1)], self.cells)
        return self._within(cell, at - cell.start)

    def _within(self, cell: Cells, x: Scalar) -> GuidePoint:
        """Point of a cell at the distance `x` from where it begins [pitch]."""
        arc = self.fillet * LENGTH[self.corner]
        rest = x - (cell.entry - self.fillet)
        inside = (rest >= 0) & (rest < arc)
        # a sharp corner has neither leg nor arc, and nothing is ever inside it
        t = jnp.where(inside, rest / (arc or 1.0), jnp.where(rest < 0, 0.0, 1.0))
        along, across, heading, curvature = unit_corner(self.corner, t)
        curvature = jnp.where(inside, curvature / (self.fillet or 1.0), 0.0)
        along = jnp.where(rest < 0, rest, 0.0) + self.fillet * (along - 1)
        across = jnp.where(rest < arc, 0.0, rest - arc) + self.fillet * across
        turns = cell.turn != 0
        along = jnp.where(turns, along, x - cell.entry)
        across = jnp.where(turns, cell.turn * across, 0.0)
        side = jnp.stack([-cell.direction[1], cell.direction[0]])
        position = cell.vertex + along * cell.direction + across * side
        return GuidePoint(
            position=self.pitch * position,
            heading=cell.heading + cell.turn * heading,
            curvature=cell.turn * curvature / self.pitch,
        )

    def bends(self, per_corner: int = 5) -> Bends:
        """The straight part and the bends, for a tool axis that leans along the guide.

        Args:
            per_corner: Curvatures that stand for those of a half corner.
        """
        nodes, weights = np.polynomial.legendre.leggauss(per_corner)
        t = as_array((nodes + 1) / 4)  # a corner is its own mirror image
        arc = self.fillet * LENGTH[self.corner]
        curvature = jax.vmap(lambda t: unit_corner(self.corner, t)[3])(t)
        curvature = curvature / (self.fillet or 1.0) / self.pitch
        corners = jnp.sum(jnp.abs(self.cells.turn)) * arc / self.cells.end[-1]
        return Bends(
            curvature=jnp.pad(curvature, (1, 0)),
            aspect=jnp.zeros(per_corner + 1, dtype=t.dtype),
            share=jnp.concatenate([(1 - corners)[None], corners * as_array(weights / 2)]),
        )

    def compass(self) -> Bends:
        """The four directions, for a tool axis that always leans along x.

        The axis does not turn with the guide, so its corners count as straight: half to
        the edge that enters and half to the one that leaves.
        """
        cells = self.cells
        half = 0.5 * (cells.end - cells.start)
        quarter = jnp.round((cells.heading - cells.heading[0]) / (0.5 * jnp.pi))
        quarters = jnp.stack([quarter, quarter + cells.turn]) % 4
        directions = jnp.arange(4, dtype=half.dtype)
        same = quarters[:, :, None] == directions[None, None, :]
        share = jnp.sum(jnp.where(same, half[None, :, None], 0.0), axis=(0, 1))
        return Bends(
            curvature=jnp.zeros_like(share),
            aspect=cells.heading[0] + 0.5 * jnp.pi * directions,
            share=share / cells.end[-1],
        )

    def stations(self, per_panel: int) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
        """Nodes of a Gauss-Legendre quadrature along the guide.

        The panels end where the curve changes formula, and none is longer than a pitch,
        so that with rounded corners meeting each other a panel is a cell.

        Args:
            per_panel: Number of nodes in each panel.

        Returns:
            Arc lengths of the nodes, ascending [mm], and their weights [mm], which add up
            to the length of the guide.
        """
        nodes, weights = np.polynomial.legendre.leggauss(per_panel)
        width = jnp.diff(self.panels)
        s = self.panels[:-1, None] + width[:, None] * as_array((nodes + 1) / 2)[None, :]
        weight = width[:, None] * as_array(weights / 2)[None, :]
        return self.pitch * s.reshape(-1), self.pitch * weight.reshape(-1)


def polyline(
    vertices: np.ndarray, pitch: Scalar | float, corner: str = "smooth", fillet: float = 0.5
) -> Guide:
    """Guide along a polyline of straight edges and right-angled turns.

    Args:
        vertices: Its corners, one a row, the unit being the pitch [pitch].
        pitch: Size of that unit; may be traced [mm].
        corner: "smooth", "arc" or "sharp".
        fillet: Length of the two legs that a rounded corner replaces [pitch].

    Raises:
        ValueError: if the corners have no such shape, are longer than half an edge, or do
            not turn by a right angle.
    """
    if corner not in LENGTH:
        names = ", ".join(repr(name) for name in LENGTH)
        raise ValueError(f"`corner` is {corner!r}, must be one of {names}.")
    if not 0 < fillet <= 0.5:
        raise ValueError(f"`fillet` is {fillet}, must lie in (0, 0.5] pitches.")
    vertices = np.asarray(vertices, dtype=float)
    edges = np.diff(vertices, axis=0)
    lengths = np.hypot(edges[:, 0], edges[:, 1])
    if len(edges) == 0 or np.any(lengths <= 0):
        raise ValueError("`vertices` needs two or more points, no two in a row the same.")
    direction = edges / lengths[:, None]
    cross = direction[:-1, 0] * direction[1:, 1] - direction[:-1, 1] * direction[1:, 0]
    dot = np.sum(direction[:-1] * direction[1:], axis=1)
    turn = np.round(cross)
    # a turn of 45 degrees or more rounds to a turn; a reversal to none
    if np.any(np.abs(cross - turn) > 1e-9) or np.any((turn == 0) & (dot < 0)):
        raise ValueError("`vertices` may turn by a right angle to either side or go on.")
    legs = 0.0 if corner == "sharp" else fillet
    turning = np.concatenate([[0.0], np.abs(turn), [0.0]])
    rounded = lengths[(turning[:-1] > 0) | (turning[1:] > 0)]
    # a corner stays within its cell, which ends in the middle of the edge
    if np.any(legs > rounded / 2 + 1e-9):
        raise ValueError(
            f"`fillet` is {fillet} pitches, must be at most {rounded.min() / 2:.4g}: half "
            f"of the shortest edge, which is {rounded.min():.4g} pitches long."
        )

    turn = np.concatenate([[0.0], turn, [0.0]])
    entry = np.concatenate([[0.0], lengths / 2])
    leave = np.concatenate([lengths / 2, [0.0]])
    arc = legs * LENGTH[corner]
    ends = np.cumsum(entry + leave - turning * (2 * legs - arc))
    starts = np.concatenate([[0.0], ends[:-1]])
    first = math.atan2(direction[0, 1], direction[0, 0])
    heading = first + np.pi / 2 * np.concatenate([[0.0], np.cumsum(turn[:-1])])
    cells = Cells(
        vertex=as_array(vertices),
        direction=as_array(np.concatenate([direction[:1], direction])),
        heading=as_array(heading),
        turn=as_array(turn),
        entry=as_array(entry),
        start=as_array(starts),
        end=as_array(ends),
    )
    buckets = math.ceil(ends[-1] / np.min(ends - starts))
    table = np.searchsorted(starts, ends[-1] * np.arange(buckets) / buckets, "right") - 1
    corners = (starts + entry - legs)[turning > 0]
    return Guide(
        pitch=pitch,
        cells=cells,
        table=jnp.asarray(table, dtype=jnp.int32),
        panels=as_array(_panels(corners, arc, ends[-1])),
        corner=corner,
        fillet=float(legs),
    )


def _panels(corners: np.ndarray, arc: float, total: float) -> np.ndarray:
    """Ends of the corners, and between them ends of panels at most a pitch long [pitch]."""
    ends = np.concatenate([[0.0], np.sort(np.append(corners, corners + arc)), [total]])
    # two corners that meet share an end, up to rounding
    ends = ends[np.append(np.diff(ends) > 1e-9, True)]
    pieces = np.ceil(np.diff(ends) - 1e-9).astype(int)
    split = [
        np.linspace(a, b, count, endpoint=False)
        for a, b, count in zip(ends[:-1], ends[1:], pieces, strict=True)
    ]
    split = np.concatenate([*split, ends[-1:]])
    split[0] = 0.0
    return split


def hilbert_points(order: int) -> np.ndarray:
    """Vertices of Hilbert's curve in the unit square about the origin [-].

    Source: S0 (Pessoles & Tournier 2009), eqs. (3) and (4).

    Args:
        order: How often the square is quartered, n.
    """
    x, y = np.zeros(1), np.zeros(1)
    for _ in range(order):
        x, y = (
            np.concatenate([-0.5 + y, -0.5 + x, 0.5 + x, 0.5 - y]) / 2,
            np.concatenate([-0.5 + x, 0.5 + y, 0.5 + y, -0.5 - x]) / 2,
        )
    return np.stack([x, y], axis=1)


def hilbert(order: int, size: Size, corner: str = "smooth", fillet: float = 0.5) -> Guide:
    r"""Guide along Hilbert's curve, which visits a square part without a main direction.

    The pitch is $L/2^n$, and the polyline is $L (2^n - 2^{-n})$ long before its corners
    are rounded.

    Args:
        order: How often the square is quartered, n, from 1 to 7.
        size: Lengths of the sides of the part; may be traced [mm].
        corner: "smooth", "arc" or "sharp".
        fillet: Length of the two legs that a rounded corner replaces [pitch].

    Raises:
        ValueError: if the part is not square, or an argument is out of its range.

    Source: S0 (Pessoles & Tournier 2009), eqs. (3) and (4).
    """
    if not 1 <= order <= MAX_ORDER:
        raise ValueError(f"`order` is {order}, must lie in 1..{MAX_ORDER}.")
    sides = as_array(size)
    if not any(isinstance(side, Tracer) for side in size):
        length, width = (float(side) for side in size)
        if abs(length - width) > 1e-6 * abs(length):
            raise ValueError(
                f"`size` is {length:g} x {width:g} mm, must be square for a Hilbert curve; "
                "use `lines` on a rectangle."
            )
    count = 2**order
    points = (0.5 + hilbert_points(order)) * count
    return polyline(points, sides[0] / count, corner, fillet)


def lines(count: int, size: Size, corner: str = "smooth", fillet: float = 0.5) -> Guide:
    """Guide to and fro along lines parallel to x, on any rectangle.

    The pitch is the width of the part over the number of lines, and the lines keep half a
    pitch away from every border.

    Args:
        count: Number of lines.
        size: Lengths of the sides of the part; not traced, since how many pitches fit
            into a line decides the layout [mm].
        corner: "smooth", "arc" or "sharp".
        fillet: Length of the two legs that a rounded corner replaces [pitch].

    Raises:
        ValueError: if a line would be shorter than its corners, or an argument is out of
            its range.
    """
    if count < 1:
        raise ValueError(f"`count` is {count}, must be 1 or more.")
    length, width = (float(side) for side in size)
    along = count * length / width  # pitches in the length of the part
    if along <= 1:
        raise ValueError(
            f"`count` is {count}, must be above {width / length:.4g} for lines along the "
            f"{length:g} mm of this part."
        )
    j = np.repeat(np.arange(count), 2)
    right = (np.arange(2 * count) + 1) // 2 % 2
    points = np.stack([np.where(right, along - 0.5, 0.5), j + 0.5], axis=1)
    return polyline(points, width / count, corner, fillet)
