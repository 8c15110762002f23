r"""Blocks: the straight moves into which a path is cut, so that a program can hold it.

Between two poses a control moves the tip along the chord, and the tool axis along a great
circle or with the rotary axes at constant rates; one that knows no tool centre moves all
five axes at constant rates. One cut serves all three: no point of the disc's face, tip and
rim alike, may stray from its true place by more than the tolerance in any of them.

The deviation of a short move grows with the square of its length. So it is measured on
the samples, moves of the lengths that this suggests are laid along the path, and those
that still stray are halved. Poses at their ends are those of the path itself, not
interpolated. Where the path jumps (at a sharp corner that the tool axis leans along) the
jump is a move of its own.
"""

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from .machine.kinematics import (
    forward,
    placed,
    pole_distance,
    positions,
    rotary,
    rotary_order,
    turns,
)
from .parts import Machine, Process
from .path.toolpath import resolved
from .resolved import Run
from .setup import Setup
from .stored import stored


# Poses worked out at a time: a number that is compiled once for all paths.
AT_ONCE = 4096
# Share of the tolerance that moves aim at; the rest is for rounding to printed digits.
AIM = 0.95
# Angle to the pole within which the path's rotary axis next to the part may hold still,
# and then does so between its samples too [rad].
HELD = 1e-5
# Guide length below which a move is no longer halved [mm].
SHORTEST = 1e-6
# A move as many times longer than its share of the path is one over a jump.
JUMP = 100.0
# Places in every move at which it is compared with the path, beside the samples in it.
LOOKED_AT = (0.25, 0.5, 0.75)


@dataclass(frozen=True)
class Poses:
    """Places and axes of the tool on the part, and axis positions, one a row."""

    tip: np.ndarray
    """Driven point [mm]."""
    axis: np.ndarray
    """Unit tool axis, from the tip into the spindle [-]."""
    axes: np.ndarray
    """Positions of the linear [mm] and rotary axes [rad]."""

    def __getitem__(self, rows) -> "Poses":
        return Poses(self.tip[rows], self.axis[rows], self.axes[rows])


@dataclass(frozen=True)
class Blocks:
    """Ends of the moves of one pass, in their order; the first is where it starts."""

    poses: Poses
    """Where the moves end."""
    s: np.ndarray
    """Arc length of the guide there [mm]."""
    time: np.ndarray
    """Time since the start of the pass [s]."""
    deviation: float
    """How far any point of the disc's face strays [mm]."""
    jumps: int
    """Moves over a place where the path jumps."""


def cut(path: Run, process: Process, setup: Setup, tolerance: float) -> Blocks:
    """Cuts a path into moves that stay within a tolerance; not for use under `jit`.

    Args:
        path: The path as it is run, from `resolved.run` at phase zero.
        process: Its settings.
        setup: Its job.
        tolerance: How far a point of the disc's face may stray [mm].

    Source: Own derivation.
    """
    known = Poses(
        *(np.asarray(x) for x in (path.posture.tip, path.posture.axis, path.axes))
    )
    s, radius = np.asarray(path.s), float(setup.tool.radius)
    machine = placed(setup.machine, process)
    given = (setup.surface, setup.guide, process, setup.tool.radius, path.held)
    lean = (setup.pulling, setup.lean)

    def at(where: np.ndarray) -> Poses:
        near = np.stack([np.interp(where, s, q) for q in known.axes.T], axis=1)
        tip, axis, axes = chunks(
            lambda s, near: _placed(s, near, machine, given, lean), where, near
        )
        return Poses(tip, axis, axes)

    def strays(start: Poses, end: Poses, between: Poses) -> np.ndarray:
        return deviation(start, end, between, radius, machine)

    middle = at(0.5 * (s[:-1] + s[1:]))
    density = np.sqrt(strays(known[:-1], known[1:], middle) / (AIM * tolerance))
    # a move may reach into the next interval, where more of them are needed
    padded = np.pad(density, 1, mode="edge")
    density = np.maximum(np.maximum(padded[:-2], padded[2:]), density)
    total = np.concatenate([[0.0], np.cumsum(density)])
    count = max(int(np.ceil(total[-1])), 1)
    knots = np.interp(np.linspace(0.0, total[-1], count + 1), total, s)
    knots[[0, -1]] = s[[0, -1]]
    knots = np.unique(knots)
    poses, worst = at(knots), np.full(knots.size - 1, np.nan)
    while True:
        new = np.flatnonzero(np.isnan(worst))
        worst[new] = _worst(knots, poses, new, s, known, at, strays)
        long = np.diff(knots) > SHORTEST
        over = np.flatnonzero((worst > AIM * tolerance) & long)
        if over.size == 0:
            break
        added = 0.5 * (knots[over] + knots[over + 1])
        extra = at(added)
        worst[over] = np.nan
        worst = np.insert(worst, over, np.nan)
        knots = np.insert(knots, over + 1, added)
        poses = Poses(
            *(
                np.insert(a, over + 1, b, axis=0)
                for a, b in zip(_rows(poses), _rows(extra), strict=True)
            )
        )
    moved = np.linalg.norm(np.diff(poses.tip, axis=0), axis=1)
    usual = moved.sum() / (knots[-1] - knots[0])
    jumps = (moved > tolerance) & (moved > JUMP * usual * np.diff(knots))
    # np.interp cannot know that a jump takes time: an axis's own speed says so
    time = np.diff(np.interp(knots, s, np.asarray(path.law.time)))
    speed = np.asarray(machine.max_speed)
    reached = np.abs(np.diff(poses.axes, axis=0)) / np.where(speed > 0, speed, np.inf)
    time = np.maximum(time, reached.max(axis=1))
    return Blocks(
        poses=poses,
        s=knots,
        time=np.concatenate([[0.0], np.cumsum(time)]),
        deviation=float(worst.max(initial=0.0)),
        jumps=int(jumps.sum()),
    )


def deviation(
    start: Poses, end: Poses, between: Poses, radius: float, machine: Machine
) -> np.ndarray:
    """How far poses lie from straight moves, the worst of the ways a control may go [mm].

    Args:
        start: Where each move starts.
        end: Where it ends.
        between: A pose of the path in between, for each move.
        radius: Radius of the disc, over which an error of the axis shows [mm].
        machine: The machine.
    """
    tip, way = end.tip - start.tip, radius * (end.axis - start.axis)
    length = np.sum(tip**2, axis=1) + np.sum(way**2, axis=1)
    done = np.sum(tip * (between.tip - start.tip), axis=1)
    done += np.sum(way * radius * (between.axis - start.axis), axis=1)
    share = np.clip(done / np.where(length > 0, length, 1.0), 0.0, 1.0)[:, None]
    chord = start.tip + share * tip
    arc = start.axis + share * (end.axis - start.axis)
    arc = arc / np.linalg.norm(arc, axis=1, keepdims=True)
    turned = start.axes + share * (end.axes - start.axes)
    run, leant = poses_of(turned, machine)

    def off(a, b):
        return np.linalg.norm(a - b, axis=1)

    lean = radius * off(leant, between.axis)
    centred = off(chord, between.tip) + np.maximum(radius * off(arc, between.axis), lean)
    return np.maximum(centred, off(run, between.tip) + lean)


def poses_of(axes: np.ndarray, machine: Machine) -> tuple[np.ndarray, np.ndarray]:
    """Tips [mm] and tool axes [-] of axis positions, one a row."""
    tip, axis = chunks(lambda axes: _poses(axes, machine), axes)
    return tip, axis


def _worst(knots, poses, moves, s, known, at, strays) -> np.ndarray:
    """Largest deviation of some of the moves."""
    found = np.zeros(moves.size)
    start, end = poses[moves], poses[moves + 1]
    low, high = knots[moves], knots[moves + 1]
    for share in LOOKED_AT:
        found = np.maximum(found, strays(start, end, at(low + share * (high - low))))
    # samples in each move
    owner = np.searchsorted(knots, s, side="right") - 1
    place = np.searchsorted(moves, owner)
    inside = (place < moves.size) & (moves[np.minimum(place, moves.size - 1)] == owner)
    row, sample = place[inside], np.flatnonzero(inside)
    if sample.size:
        np.maximum.at(found, row, strays(start[row], end[row], known[sample]))
    return found


def _rows(poses: Poses) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return poses.tip, poses.axis, poses.axes


def chunks(function: Callable, *columns: np.ndarray) -> list[np.ndarray]:
    """A function of many rows, called with the same number of rows every time."""
    count = columns[0].shape[0]
    parts = []
    for begin in range(0, count, AT_ONCE):
        some = [x[begin : begin + AT_ONCE] for x in columns]
        tail = ((0, AT_ONCE - some[0].shape[0]),)
        full = [np.pad(x, tail + ((0, 0),) * (x.ndim - 1), mode="edge") for x in some]
        parts.append(function(*full))
    columns_of = zip(*parts, strict=True)
    return [np.concatenate([np.asarray(p) for p in part])[:count] for part in columns_of]


@stored
def _placed(s, near, machine, given, lean):
    """Tips, tool axes and axis positions at places of the guide, on the branch nearby."""
    surface, guide, process, radius, held = given
    posture = resolved(surface, guide, process, radius, s, *lean, displacement=held)

    one, two = rotary_order(machine)

    def axes_at(tip, axis, near):
        """As `route` has them at the samples: on its branch, and held at the pole."""
        pole = pole_distance(axis, machine) <= HELD
        both = []
        for branch in (0, 1):
            (first, second), _ = rotary(axis, machine, branch)
            first = jnp.where(pole, near[one], first)
            both.append(
                jnp.stack(
                    [
                        angle - 2 * jnp.pi * turns(angle - near[number])
                        for angle, number in ((first, one), (second, two))
                    ]
                )
            )
        off = [jnp.sum((angles - near[jnp.array([one, two])]) ** 2) for angles in both]
        first, second = jnp.where(off[0] <= off[1], *both)
        return positions(tip, (first, second), machine)

    return posture.tip, posture.axis, jax.vmap(axes_at)(posture.tip, posture.axis, near)


@stored
def _poses(axes, machine):
    return jax.vmap(lambda q: forward(q, machine))(axes)
