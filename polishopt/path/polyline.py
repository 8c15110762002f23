"""Polyline: a guide of straight edges and rounded corners, by arc length in closed form.

It is cut into cells, one around each vertex, from the middle of one edge to the middle of
the next. A cell is a corner, scaled and turned, or straight, so a point costs one look-up
and one polynomial. The look-up needs no search: a table of equal buckets, none longer
than the shortest cell, says which cell holds the start of a bucket, and a bucket meets at
most one more. Everything is kept in units of the pitch, so that only the pitch carries a
length.

The circular fillet makes the curvature jump. A tool that leans along the guide then turns
about its normal at a speed that jumps too, which no machine can follow. The default
corner therefore turns by a quintic in arc length: its curvature and the derivative of its
curvature are continuous everywhere.
"""

import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..parts import Scalar, as_array, as_scalar
from .corner import CORNERS, Shapes, shapes, unit_corner, unit_curvature
from .guide import Bends, Guide, GuidePoint, by_arc_length


# Turns from here on would reverse the way within next to no length [rad].
SHARPEST = math.radians(175.0)
# Curvatures that stand for those of half a corner; most kinds of bends, and directions,
# that are told apart.
PER_CORNER, MOST_BENDS, MOST_DIRECTIONS = 5, 30, 24


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
    kind: Int[Array, "*n"]
    """Which of the corner's shapes it is [-]."""
    leg: Float[Array, "*n"]
    """Length of each of the two legs that a rounded corner replaces [pitch]."""
    entry: Float[Array, "*n"]
    """Length of the entering edge that belongs to this cell [pitch]."""
    start: Float[Array, "*n"]
    """Arc length at which the cell begins [pitch]."""
    end: Float[Array, "*n"]
    """Arc length at which the cell ends [pitch]."""
    contact: Float[Array, "*n 2"]
    """1 where the tool touches along the edge that enters, and along the one that leaves;
    0 where it is lifted [-]."""


class Polyline(Guide):
    """A polyline with rounded corners, by arc length; see `Guide`.

    At a sharp corner the side after the corner holds.
    """

    pitch: Scalar = eqx.field(converter=as_scalar)
    """Distance between neighbouring lines of the lattice, h [mm]."""
    cells: Cells
    """One cell per vertex, in the order of travel."""
    shapes: Shapes
    """The different corners."""
    table: Int[Array, " buckets"]
    """Index of the cell that holds the start of each bucket [-]."""
    panels: Float[Array, " panels_and_1"]
    """Arc lengths between which the curve is analytic, at most a pitch apart [pitch]."""
    bent: Bends
    """What `bends` answers, in units of the pitch."""
    directed: Bends
    """What `compass` answers."""
    touching: Scalar = eqx.field(converter=as_scalar)
    """Share of the length along which the tool touches [-]."""
    corner: str = eqx.field(static=True)
    """Shape of the corners: "smooth", "arc" or "sharp"."""

    @property
    def length(self) -> Scalar:
        """Arc length of the whole guide [mm]."""
        return self.pitch * self.cells.end[-1]

    @property
    def contact_length(self) -> Scalar:
        """Arc length without the ways back that the tool is lifted on [mm]."""
        return self.touching * self.length

    @property
    def vertices(self) -> Float[Array, "n 2"]:
        """Corners of the polyline before they are rounded [mm]."""
        return self.pitch * self.cells.vertex

    @property
    def edges(self) -> Float[Array, " n"]:
        """Length of each straight piece before its corners are rounded [mm]."""
        steps = jnp.diff(self.cells.vertex, axis=0)
        return self.pitch * jnp.sqrt(jnp.sum(steps**2, axis=1))

    def __call__(self, s: Scalar) -> GuidePoint:
        """Point of the guide at the arc length `s` [mm]."""
        at = s / self.pitch
        total = self.cells.end[-1]
        last = self.table.size - 1
        bucket = jnp.floor(jax.lax.stop_gradient(at / total) * self.table.size)
        i = self.table[jnp.clip(bucket, 0, last).astype(self.table.dtype)]
        i = jnp.where(at >= self.cells.end[i], i + 1, i)
        i = jnp.minimum(i, self.cells.end.size - 1)

        def of(x):
            return x.at[i].get(mode="promise_in_bounds", wrap_negative_indices=False)

        cell = jax.tree.map(of, self.cells)
        return self._within(cell, at - cell.start)

    def _within(self, cell: Cells, x: Scalar) -> GuidePoint:
        """Point of a cell at the distance `x` from where it begins [pitch]."""
        one = self.shapes.angle.size == 1
        shape = jax.tree.map(lambda x: x[0 if one else cell.kind], self.shapes)
        arc = cell.leg * shape.length
        rest = x - (cell.entry - cell.leg)
        inside = (rest >= 0) & (rest < arc)
        # a sharp corner has neither leg nor arc, and nothing is ever inside it; elsewhere
        # a joint is the same from both sides, should rounding tell them apart differently
        rounded = arc > 0
        t = rest / jnp.where(rounded, arc, 1.0)
        t = jnp.where(inside, t, jnp.where(rest < 0, 0.0, 1.0))
        bend = unit_curvature(self.corner, shape, t) / jnp.where(rounded, cell.leg, 1.0)
        curvature = cell.turn * jnp.where(inside, bend, 0.0)
        lifting = t**3 * (10 - 15 * t + 6 * t * t)
        still = jax.lax.stop_gradient((x, rest, t))
        place = self._place(cell, shape, *still)
        position, heading = by_arc_length(x, *place, curvature)
        return GuidePoint(
            position=self.pitch * position,
            heading=heading,
            curvature=curvature / self.pitch,
            contact=cell.contact[0] + (cell.contact[1] - cell.contact[0]) * lifting,
        )

    def _place(
        self, cell: Cells, shape: Shapes, x: Scalar, rest: Scalar, t: Scalar
    ) -> tuple[Float[Array, "2"], Scalar]:
        """Position [pitch] and heading at `x` in a cell, `rest` past its corner's start."""
        along, across, heading = unit_corner(self.corner, shape, t)
        after = jnp.maximum(rest - cell.leg * shape.length, 0.0)
        along = jnp.minimum(rest, 0.0) + cell.leg * (along - 1)
        along = along + after * jnp.cos(shape.angle)
        across = after * jnp.sin(shape.angle) + cell.leg * across
        turns = cell.turn != 0
        along = jnp.where(turns, along, x - cell.entry)
        across = jnp.where(turns, cell.turn * across, 0.0)
        side = jnp.stack([-cell.direction[1], cell.direction[0]])
        position = cell.vertex + along * cell.direction + across * side
        return position, cell.heading + cell.turn * heading

    def bends(self) -> Bends:
        """The straight part and the bends, for a tool axis that leans along the guide."""
        bent = self.bent
        return Bends(bent.curvature / self.pitch, bent.aspect, bent.share)

    def compass(self) -> Bends:
        """The directions of its lines, for a tool axis that always leans along x.

        The axis does not turn with the guide, so its corners count as straight: half to
        the edge that enters and half to the one that leaves.
        """
        return self.directed


class Turns(NamedTuple):
    """Corners as NumPy arrays, for what is worked out once [pitch, rad]."""

    turn: np.ndarray
    kind: np.ndarray
    leg: np.ndarray
    arc: np.ndarray
    heading: np.ndarray
    contact: np.ndarray


def polyline(
    vertices: np.ndarray,
    pitch: Scalar | float,
    corner: str = "smooth",
    fillet: float = 0.5,
    *,
    relative: bool = False,
    touches: np.ndarray | None = None,
) -> Polyline:
    """Guide along a polyline of straight edges.

    Args:
        vertices: Its corners, one a row, the unit being the pitch [pitch].
        pitch: Size of that unit; may be traced [mm].
        corner: "smooth", "arc" or "sharp".
        fillet: Length of the two legs that a rounded corner replaces [pitch].
        relative: Whether `fillet` is a share of the shorter edge at each corner instead.
        touches: For each edge, whether the tool touches along it; None if it always does.

    Raises:
        ValueError: if the corners have no such shape, are longer than half an edge, or
            turn back.
    """
    if corner not in CORNERS:
        names = ", ".join(repr(name) for name in CORNERS)
        raise ValueError(f"`corner` is {corner!r}, must be one of {names}.")
    if not 0 < fillet <= 0.5:
        what = "edges" if relative else "pitches"
        raise ValueError(f"`fillet` is {fillet}, must lie in (0, 0.5] {what}.")
    vertices = np.asarray(vertices, dtype=float)
    edges = np.diff(vertices, axis=0)
    lengths = np.hypot(edges[:, 0], edges[:, 1])
    if len(edges) == 0 or not np.all(lengths > 0):
        raise ValueError("`vertices` needs two or more points, no two in a row the same.")
    direction = edges / lengths[:, None]
    cross = direction[:-1, 0] * direction[1:, 1] - direction[:-1, 1] * direction[1:, 0]
    dot = np.sum(direction[:-1] * direction[1:], axis=1)
    angle = np.pad(np.arctan2(cross, dot), 1)
    angle[np.abs(angle) < 1e-9] = 0.0
    if np.any(np.abs(angle) > SHARPEST):
        raise ValueError("`vertices` turn back on themselves, must turn by less than 175°.")
    turn = np.sign(angle)
    shorter = np.minimum(np.append(lengths[0], lengths), np.append(lengths, lengths[-1]))
    legs = fillet * (shorter if relative else np.ones_like(shorter)) * np.abs(turn)
    if corner == "sharp":
        legs = np.zeros_like(legs)
    # a corner stays within its cell, which ends in the middle of the edge
    if np.any(legs > shorter / 2 + 1e-9):
        least = shorter[turn != 0].min()
        raise ValueError(
            f"`fillet` is {fillet} pitches, must be at most {least / 2:.4g}: half "
            f"of the shortest edge, which is {least:.4g} pitches long."
        )

    different, kind = np.unique(np.round(np.abs(angle), 9), return_inverse=True)
    if len(different) > 1 and different[0] == 0:
        different, kind = different[1:], np.maximum(kind - 1, 0)
    # the exact angle, not the rounded one, and a right one where there is no corner at all
    exact = np.array([np.abs(angle)[kind == k].max() for k in range(len(different))])
    # plain numbers, even while something else is traced
    with jax.ensure_compile_time_eval():
        made = shapes(corner, np.where(exact > 0, exact, np.pi / 2))
    arcs = legs * np.asarray(made.length)[kind]
    entry = np.append(0.0, lengths / 2)
    leave = np.append(lengths / 2, 0.0)
    ends = np.cumsum(entry + leave - 2 * legs + arcs)
    starts = np.append(0.0, ends[:-1])
    first = math.atan2(direction[0, 1], direction[0, 0])
    heading = first + np.append(0.0, np.cumsum(angle[:-1]))
    touch = np.ones(len(edges)) if touches is None else np.asarray(touches, dtype=float)
    contact = np.stack([np.append(touch[:1], touch), np.append(touch, touch[-1:])], axis=1)
    buckets = math.ceil(ends[-1] / np.min(ends - starts))
    table = np.searchsorted(starts, ends[-1] * np.arange(buckets) / buckets, "right") - 1
    turns = Turns(turn, kind, legs, arcs, heading, contact)
    straight = np.stack([entry - legs, leave - legs], axis=1)
    # the lifting of the tool is symmetric along a corner
    held = np.sum(contact * (straight + arcs[:, None] / 2))
    return Polyline(
        pitch=pitch,
        cells=Cells(
            vertex=as_array(vertices),
            direction=as_array(np.concatenate([direction[:1], direction])),
            heading=as_array(heading),
            turn=as_array(turn),
            kind=jnp.asarray(kind, dtype=jnp.int32),
            leg=as_array(legs),
            entry=as_array(entry),
            start=as_array(starts),
            end=as_array(ends),
            contact=as_array(contact),
        ),
        shapes=made,
        table=jnp.asarray(table, dtype=jnp.int32),
        panels=as_array(_panels((starts + entry - legs)[turn != 0], arcs[turn != 0], ends)),
        bent=_bent(turns, made, corner, held),
        directed=_directed(turns, straight, angle),
        touching=held / ends[-1],
        corner=corner,
    )


def _panels(begins: np.ndarray, arcs: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Ends of the corners, and between them ends of panels at most a pitch long [pitch]."""
    ends = np.concatenate([[0.0], np.sort(np.append(begins, begins + arcs)), ends[-1:]])
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


def _bent(turns: Turns, made: Shapes, corner: str, held: float) -> Bends:
    """The straight part and the bends, curvature in units of the pitch."""
    nodes, weights = np.polynomial.legendre.leggauss(PER_CORNER)
    with jax.ensure_compile_time_eval():
        t = as_array((nodes + 1) / 4)  # a corner is its own mirror image
        unit = jax.vmap(lambda shape: unit_curvature(corner, shape, t))(made)
    some = (turns.turn != 0) & (turns.arc > 0)  # a sharp corner has no length
    bends = np.zeros((0, PER_CORNER))
    share = np.zeros(0)
    if some.any():
        kinds = np.stack([turns.kind[some], np.round(turns.leg[some], 9)], axis=1)
        touch = turns.contact[some].mean(axis=1)
        groups, which = np.unique(kinds, axis=0, return_inverse=True)
        share = np.bincount(which.ravel(), turns.arc[some] * touch) / held
        legs = np.where(groups[:, 1] > 0, groups[:, 1], 1.0)
        bends = np.asarray(unit)[groups[:, 0].astype(int)] / legs[:, None]
    shares = np.outer(share, weights / 2).ravel()
    values, shares = _merged(bends.ravel(), shares, MOST_BENDS)
    return Bends(
        curvature=as_array(np.append(0.0, values)),
        aspect=as_array(np.zeros(len(values) + 1)),
        share=as_array(np.append(1 - shares.sum(), shares)),
    )


def _directed(turns: Turns, straight: np.ndarray, angle: np.ndarray) -> Bends:
    """Headings of the edges, each with the halves of the corners at its ends."""
    half = (straight + turns.arc[:, None] / 2) * turns.contact
    headings = np.stack([turns.heading, turns.heading + angle], axis=1) % (2 * np.pi)
    # a hair below a full turn is none at all
    headings = np.where(2 * np.pi - headings < 1e-6, 0.0, headings).ravel()
    known, which = np.unique(np.round(headings, 6), return_inverse=True)
    exact = np.zeros(len(known))
    exact[which] = headings
    share = np.bincount(which, half.ravel()) / half.sum()
    values, shares = _merged(exact, share, MOST_DIRECTIONS)
    return Bends(
        curvature=as_array(np.zeros(len(values))),
        aspect=as_array(values),
        share=as_array(shares),
    )


def _merged(
    values: np.ndarray, shares: np.ndarray, most: int
) -> tuple[np.ndarray, np.ndarray]:
    """The values themselves, or if there are too many, means of groups of like size."""
    if len(values) <= most:
        return values, shares
    order = np.argsort(values)
    values, shares = values[order], shares[order]
    below = np.cumsum(shares) - shares / 2
    group = np.minimum((below / shares.sum() * most).astype(int), most - 1)
    weight = np.bincount(group, shares, most)
    some = weight > 0
    return np.bincount(group, shares * values, most)[some] / weight[some], weight[some]
