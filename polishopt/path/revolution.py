r"""Revolution: Peano-like paths on surfaces of revolution, with one coverage everywhere.

The part is cut into rings, two at a time, and the rings into cells of the area $p^2/2$,
each crossed along its diagonal by a segment of a length next to p: $2/p$ of path on an
area. Out along the outer ring and back along the inner one the path makes a zigzag, as
Peano's curve does. Where the rings become too small for that, the vertex cap is covered by
rings of squares whose sides are the path.

As printed, the steps of the source are $\Delta u = p/|S_u|$ and $\Delta w = p/|S_w|$. A
cell of these sides has a diagonal of $\sqrt 2\, p$ and a coverage of $\sqrt 2/p$; for the
coverage $2/p$ that is printed with them, p has to be the segment and $p/\sqrt 2$ the side.
The sides here are that on average; cells of a ring all have exactly the same area, which
neither choice of steps gives.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..parts import as_array
from .polyline import Polyline, polyline
from .surface import Surface


# Rings of fewer cells than this belong to the vertex cap.
FEWEST = 9
# The most squares of a ring of the cap, and points along a meridian.
MOST_SQUARES, ALONG = 64, 4097


class Meridian(NamedTuple):
    """Area of a surface of revolution inside a distance from its axis."""

    radius: np.ndarray
    area: np.ndarray

    def within(self, radius: float) -> float:
        """Area inside a radius [mm^2]."""
        return float(np.interp(radius, self.radius, self.area))

    def reach(self, area: float) -> float:
        """Radius that holds an area [mm]."""
        return float(np.interp(area, self.area, self.radius))


def meridian(surface: Surface, size: Float[Array, "2"], outer: float) -> Meridian:
    """The area of a surface of revolution about the middle of its sheet.

    Args:
        surface: The part, which has the sheet's x and y as Cartesian coordinates.
        size: Sides of the sheet [mm].
        outer: Largest distance from the axis [mm].
    """
    with jax.ensure_compile_time_eval():
        radius = np.linspace(0.0, outer, ALONG)
        places = np.asarray(size)[None, :] / 2 + np.stack([radius, 0 * radius], axis=1)
        points = np.asarray(jax.jit(jax.vmap(surface))(as_array(places)))
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    # frustums of cones
    area = np.cumsum(np.pi * (radius[1:] + radius[:-1]) * steps)
    return Meridian(radius, np.append(0.0, area))


class Ring(NamedTuple):
    """Two rings of cells, run out and back: radii from outside in, and angles [mm, rad]."""

    radii: tuple[float, float, float]
    angles: np.ndarray


def rings(
    line: Meridian, segment: float, outer: float, inner: float, sweep: float, closed: bool
) -> list[Ring]:
    """Rings of cells of one area, from outside in, two at a time.

    Args:
        line: The surface.
        segment: Length of the segments, p [mm].
        outer: Radius at which they begin [mm].
        inner: Radius before which they end [mm].
        sweep: Angle that they cover, up to a full turn [rad].
        closed: Whether to leave one column of cells for a way back.
    """
    cell, share = segment**2 / 2, sweep / (2 * math.pi)
    side = segment / math.sqrt(2)
    found = []
    while outer > inner + side:
        # cells in a ring of the width that is due, counted where it is half as wide
        count = sweep * (outer - side) / side
        # the zigzag ends where it can turn into the next ring
        odd = 2 * round((count - 1) / 2) + 1
        count = 2 * round(count / 2) if closed else odd
        if count < FEWEST * share:
            break
        whole = line.within(outer)
        left = [whole - k * count * cell / share for k in (1, 2)]
        if left[1] < line.within(inner) - 1e-9 * whole:
            break
        middle, last = (line.reach(area) for area in left)
        angles = sweep * np.arange(count + 1) / count
        found.append(Ring((outer, middle, last), angles))
        outer = last
    return found


def _polar(radius, angle) -> np.ndarray:
    radius, angle = np.broadcast_arrays(radius, angle)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)


def cap_points(segment: float, outer: float) -> np.ndarray:
    r"""A closed way along the sides of rings of squares in a circle, from angle 0 on.

    A ring of n squares, whose neighbours share a corner, lies between l and
    $l + \sqrt 2 r$ with the side $r = l \sin\theta/\sin(45° - \theta)$ and
    $\theta = 180°/n$. Each n is the one whose sides come nearest to $2/p$ on the area.
    The innermost part, too small for five squares, stays free.

    Args:
        segment: Length of the segments, p [mm].
        outer: Radius of the circle [mm].

    Source: S4 (Tam, Cheng et al. 2013), eqs. (12) to (14), where the text that we hold has
        lost the root signs before the 2.
    """
    n = np.arange(5, MOST_SQUARES)
    half = np.pi / n
    grows = np.sin(half) / np.sin(np.pi / 4 - half)
    squares = []
    while outer > segment:
        low = outer / (1 + math.sqrt(2) * grows)
        coverage = 4 * n * low * grows / (np.pi * (outer**2 - low**2))
        best = int(np.argmin(np.abs(np.log(coverage * segment / 2))))
        squares.append((int(n[best]), float(low[best]), outer))
        outer = float(low[best])
    way = np.zeros((0, 2))
    for count, low, high in reversed(squares):
        angle = 2 * np.pi * np.arange(count) / count
        side = np.hypot((low + high) / 2, (high - low) / 2)
        corners = _polar(side, angle + np.pi / count)
        outside, inside = _polar(high, angle), _polar(low, angle)
        out = np.stack([outside, corners], axis=1).reshape(-1, 2)
        back = np.stack([inside, corners], axis=1).reshape(-1, 2)
        # round outside, then all that lies further in, then round inside and out again
        core = way if len(way) else back[:1]
        way = np.concatenate([out, core, back[1:], outside[:1]])
    return way


def revolution_points(
    surface: Surface,
    size: Float[Array, "2"],
    segment: float,
    outer: float,
    inner: float = 0.0,
    sweep: tuple[float, float] | None = None,
    closed: bool = False,
) -> np.ndarray:
    """Vertices of a Peano-like path on a surface of revolution, from its axis [mm].

    See `peano_revolution`.
    """
    begin, end = (0.0, 2 * math.pi) if sweep is None else sweep
    line = meridian(surface, size, outer)
    found = rings(line, segment, outer, inner, end - begin, closed)
    if not found:
        raise ValueError(
            f"`segment` is {segment:g} mm, must be shorter: no ring of {FEWEST} cells fits "
            f"between the radii {inner:g} and {outer:g} mm."
        )
    pieces = []
    for ring in found:
        angles = ring.angles[1:] if closed else ring.angles
        j = np.arange(len(angles))
        out = _polar(np.where(j % 2 == 0, ring.radii[0], ring.radii[1]), angles)
        back = _polar(np.where(j % 2 == 0, ring.radii[2], ring.radii[1]), angles)[::-1]
        piece = np.concatenate([out, back[1:]])
        # the next pair begins where this one ends, up to a column's width
        gap = np.linalg.norm(pieces[-1][-1] - piece[0]) if pieces else math.inf
        same = gap < 0.4 * segment
        pieces.append(piece[1:] if same else piece)
    if sweep is None and inner == 0 and not closed:
        cap = cap_points(segment, found[-1].radii[2])
        if len(cap):
            pieces.append(cap[1:])
    if closed:
        # along the column that was left free, from ring to ring outwards
        back = []
        for ring in reversed(found):
            back += [_polar(ring.radii[1], 0.0), _polar(ring.radii[0], ring.angles[1])]
        pieces.append(np.stack(back))
    points = np.concatenate(pieces)
    cosine, sine = math.cos(begin), math.sin(begin)
    return points @ np.array([[cosine, sine], [-sine, cosine]])


def peano_revolution(
    surface: Surface,
    size: Float[Array, "2"],
    segment: float,
    outer: float,
    inner: float = 0.0,
    sweep: tuple[float, float] | None = None,
    closed: bool = False,
    corner: str = "smooth",
    fillet: float = 0.5,
) -> Polyline:
    """Guide along a Peano-like path on a surface of revolution.

    Args:
        surface: The part; its sheet must be its shadow, with the axis in the middle, as
            `Plane`, `SphereCap` and `Asphere` have it.
        size: Sides of the sheet [mm].
        segment: Length of the segments, p [mm].
        outer: Radius of the region that is covered [mm].
        inner: Radius of its hole; 0 for none, then the vertex cap is covered as well [mm].
        sweep: Angles between which an off-axis segment lies; None for all round [rad].
        closed: Whether a way back leads to the start; the vertex cap then stays free.
        corner: "smooth", "arc" or "sharp", where the path touches itself.
        fillet: Length of the two legs that a rounded corner replaces, as a share of the
            shorter segment [-].

    Raises:
        ValueError: if no ring fits.

    Source: S4 (Tam, Cheng et al. 2013), eqs. (1) to (14); the cells of one area are ours.
    """
    points = revolution_points(surface, size, segment, outer, inner, sweep, closed)
    middle = np.asarray(jnp.asarray(size)) / 2
    return polyline((points + middle) / segment, segment, corner, fillet, relative=True)
