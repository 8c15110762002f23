"""Families: guide curves laid out on a rectangular part.

Lines one way or to and fro, lines that cross, Hilbert's curve on a square and on any
rectangle, Peano's curve, and spirals. All but the crossed lines never meet themselves
once their corners are rounded.
"""

import math
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from ..parts import as_array
from .involute import Involute, involute
from .polyline import SHARPEST, Polyline, polyline


MAX_ORDER, MAX_PEANO = 7, 4
# The most cells of a lattice: those of Hilbert's curve of the highest order.
MAX_CELLS = 4**MAX_ORDER
Size = Float[Array, "2"] | Sequence[float | int]


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


def hilbert(
    order: int, size: Size, corner: str = "smooth", fillet: float = 0.5
) -> Polyline:
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
        length, width = _sides(size)
        if abs(length - width) > 1e-6 * abs(length):
            raise ValueError(
                f"`size` is {length:g} x {width:g} mm, must be square for a Hilbert curve; "
                "use `hilbert_rectangle` on a rectangle."
            )
    count = 2**order
    points = (0.5 + hilbert_points(order)) * count
    return polyline(points, sides[0] / count, corner, fillet)


def hilbert_cells(columns: int, rows: int) -> np.ndarray:
    """Cells of any lattice in the order of a Hilbert-like curve, each step by one cell.

    A block is halved along its longer side if it is long, and else into a block, a
    double block and a block that the curve goes up, along and down. Seen along a side
    with an even number of cells, halves can always be chosen so that no step is diagonal;
    along an odd one they can unless the other side is even.

    Args:
        columns: Number of cells along x.
        rows: Number of cells along y.

    Returns:
        Column and row of each cell, one cell a row of the array; the first is (0, 0).

    Source: J. Cerveny, generalised Hilbert curve (2018); the choice of the side along
        which it runs, so that there is no diagonal step, is our own.
    """
    wide = columns >= rows
    long, short = (columns, rows) if wide else (rows, columns)
    if long % 2 == 1 and short % 2 == 0:
        wide = not wide
    cells = []
    # blocks still to visit, the next one last: a corner, the side along which it is
    # crossed, and the other side; sides point away from the corner
    x_side, y_side = (columns, 0), (0, rows)
    blocks = [(0, 0, *x_side, *y_side) if wide else (0, 0, *y_side, *x_side)]
    while blocks:
        x, y, ax, ay, bx, by = blocks.pop()
        w, h = abs(ax + ay), abs(bx + by)
        dax, day = (ax > 0) - (ax < 0), (ay > 0) - (ay < 0)
        dbx, dby = (bx > 0) - (bx < 0), (by > 0) - (by < 0)
        if h == 1:
            cells += [(x + i * dax, y + i * day) for i in range(w)]
        elif w == 1:
            cells += [(x + i * dbx, y + i * dby) for i in range(h)]
        elif 2 * w > 3 * h:
            half = w // 2 + (w // 2 % 2 if w > 2 else 0)
            cx, cy = half * dax, half * day
            blocks.append((x + cx, y + cy, ax - cx, ay - cy, bx, by))
            blocks.append((x, y, cx, cy, bx, by))
        else:
            half = h // 2 + (h // 2 % 2 if h > 2 else 0)
            cx, cy = half * dbx, half * dby
            ex, ey = w // 2 * dax, w // 2 * day
            far = (x + ax - dax + cx - dbx, y + ay - day + cy - dby)
            blocks.append((*far, -cx, -cy, ex - ax, ey - ay))
            blocks.append((x + cx, y + cy, ax, ay, bx - cx, by - cy))
            blocks.append((x, y, cx, cy, ex, ey))
    return np.array(cells)


def hilbert_rectangle(
    count: int, size: Size, corner: str = "smooth", fillet: float = 0.5
) -> Polyline:
    """Guide along a Hilbert-like curve that visits every cell of any rectangle once.

    Every step leads to a neighbouring cell. The cells are as nearly square as a whole
    number of them along either side allows.

    Args:
        count: Number of cells along the shorter side.
        size: Lengths of the sides of the part; not traced, since they decide the number
            of cells [mm].
        corner: "smooth", "arc" or "sharp".
        fillet: Length of the two legs that a rounded corner replaces, as a share of the
            shorter side of a cell [-].

    Raises:
        ValueError: if an argument is out of its range.
    """
    length, width = _sides(size)
    cells = np.maximum(np.round(count * np.array([length, width]) / min(length, width)), 1)
    if count < 1 or not 2 <= np.prod(cells) <= MAX_CELLS:
        raise ValueError(
            f"`count` is {count}, must be such that there are 2 to {MAX_CELLS} cells on "
            f"{length:g} x {width:g} mm, not {np.prod(cells):.0f}."
        )
    sides = np.array([length, width]) / cells
    pitch = sides.min()
    points = (hilbert_cells(int(cells[0]), int(cells[1])) + 0.5) * sides / pitch
    return polyline(points, pitch, corner, fillet)


def peano_points(order: int) -> np.ndarray:
    """Corners of cells that Peano's curve runs through, on a lattice of 3^n cells a side.

    Every cell is crossed along a diagonal, and the next one along the other diagonal, so
    the way turns by a right angle at every corner.

    Args:
        order: How often the square is divided into nine, n.

    Returns:
        Whole numbers from 0 to 3^n, from one corner of the square to the opposite one.
    """
    x, y = np.array([0, 1]), np.array([0, 1])
    for n in range(order):
        side = 3**n
        way = []
        for column in range(3):
            for row in range(3) if column % 2 == 0 else (2, 1, 0):
                # neighbouring squares are mirror images in the edge they share
                u = side - x if row % 2 else x
                v = side - y if column % 2 else y
                piece = np.stack([u + column * side, v + row * side], axis=1)
                way.append(piece if not way else piece[1:])
        x, y = np.concatenate(way).T
    return np.stack([x, y], axis=1)


def peano(order: int, size: Size, corner: str = "smooth", fillet: float = 0.5) -> Polyline:
    r"""Guide along Peano's curve: equal segments, each at a right angle to the last.

    The cells, $3^n$ along the shorter side, are crossed along their diagonals. These are
    the segments, of length p, and as a cell has the area $p^2/2$ there are $2/p$ of path
    on an area before the corners are rounded. A part may be a whole number of squares
    long; they follow each other as mirror images. The pitch is p, since parallel segments
    lie p apart.

    Args:
        order: How often a square is divided into nine, n, from 1 to 4.
        size: Lengths of the sides of the part [mm].
        corner: "smooth", "arc" or "sharp", where the path touches itself.
        fillet: Length of the two legs that a rounded corner replaces [segment].

    Raises:
        ValueError: if the longer side is no whole number of the shorter one, or an
            argument is out of its range.

    Source: S4 (Tam, Cheng et al. 2013), Figs. 1 to 3 and eq. (5).
    """
    if not 1 <= order <= MAX_PEANO:
        raise ValueError(f"`order` is {order}, must lie in 1..{MAX_PEANO}.")
    length, width = _sides(size)
    squares = round(max(length, width) / min(length, width))
    if abs(squares * min(length, width) - max(length, width)) > 1e-6 * length:
        raise ValueError(
            f"`size` is {length:g} x {width:g} mm, must have a whole number as the ratio "
            "of its sides for a Peano curve."
        )
    side = 3**order
    if squares * side**2 > MAX_CELLS:
        raise ValueError(
            f"`order` is {order}, must be lower: a Peano curve on this part then has "
            f"{squares * side**2} cells, and {MAX_CELLS} are the most."
        )
    one, way = peano_points(order), []
    for i in range(squares):
        across = side - one[:, 1] if i % 2 else one[:, 1]
        piece = np.stack([one[:, 0] + i * side, across], axis=1)
        way.append(piece if i == 0 else piece[1:])
    points = np.concatenate(way)
    points = points if length >= width else points[:, ::-1]
    cell = min(length, width) / side
    return polyline(points / math.sqrt(2), math.sqrt(2) * cell, corner, fillet)


def lines(
    count: int,
    size: Size,
    corner: str = "smooth",
    fillet: float = 0.5,
    one_way: bool = False,
) -> Polyline:
    """Guide along lines parallel to x, on any rectangle.

    The pitch is the width of the part over the number of lines, and the lines keep half a
    pitch away from every border. Run to and fro, each line leads back. Run one way, the
    tool is lifted at the end of each line and goes back half-way to the next; its pitch
    is then the distance from a line to the way back.

    Args:
        count: Number of lines.
        size: Lengths of the sides of the part; not traced, since how many pitches fit
            into a line decides the layout [mm].
        corner: "smooth", "arc" or "sharp".
        fillet: Length of the two legs that a rounded corner replaces [pitch].
        one_way: Whether all lines run in the direction of x.

    Raises:
        ValueError: if a line would be shorter than its corners, or an argument is out of
            its range.
    """
    if count < 1:
        raise ValueError(f"`count` is {count}, must be 1 or more.")
    length, width = _sides(size)
    along = count * length / width  # widths of a strip in the length of the part
    if along <= 1:
        raise ValueError(
            f"`count` is {count}, must be above {width / length:.4g} for lines along the "
            f"{length:g} mm of this part."
        )
    ways = 2 * count - 1 if one_way else count
    strips = 0.5 + np.arange(ways) / (2 if one_way else 1)
    right = (np.arange(2 * ways) + 1) // 2 % 2
    points = np.stack([np.where(right, along - 0.5, 0.5), np.repeat(strips, 2)], axis=1)
    if not one_way:
        return polyline(points, width / count, corner, fillet)
    touches = np.arange(2 * ways - 1) % 4 == 0
    return polyline(points * 2, width / count / 2, corner, fillet, touches=touches)


def hatch(
    count: int,
    size: Size,
    repeats: int = 2,
    angle: float = math.pi / 2,
    corner: str = "smooth",
    fillet: float = 0.5,
) -> Polyline:
    """Guide to and fro along lines that are turned by an angle from repeat to repeat.

    Each repeat covers the part with lines a pitch apart, which end half a pitch inside
    its borders and are joined along these. The next repeat begins at whichever of its
    ends is nearest.

    Args:
        count: Number of lines of the first repeat, which run along x.
        size: Lengths of the sides of the part; not traced [mm].
        repeats: How often the part is covered.
        angle: By how much each repeat is turned from the last [rad].
        corner: "smooth", "arc" or "sharp".
        fillet: Length of the two legs that a rounded corner replaces, as a share of the
            shorter edge at each corner [-].

    Raises:
        ValueError: if an argument is out of its range, or the part too narrow.
    """
    if repeats < 1:
        raise ValueError(f"`repeats` is {repeats}, must be 1 or more.")
    length, width = _sides(size)
    inner = np.array([length, width]) * count / width - 1
    if count < 2 or inner.min() <= 0:
        raise ValueError(
            f"`count` is {count}, must be above {max(1.0, width / length):.4g} for lines "
            f"across {length:g} x {width:g} mm."
        )
    way = np.zeros((0, 2))
    for k in range(repeats):
        one = _turned_lines(inner, k * angle)
        choices = [one, one[::-1], _other_way(one), _other_way(one)[::-1]]
        best = min(choices, key=lambda c: _join(way, c))
        same = len(way) > 0 and np.linalg.norm(best[0] - way[-1]) < 1e-9
        way = np.concatenate([way, best[1:] if same else best])
    return polyline(way + 0.5, width / count, corner, fillet, relative=True)


def _turned_lines(inner: np.ndarray, angle: float) -> np.ndarray:
    """Ends of lines across a rectangle, one apart, to and fro."""
    direction = np.array([math.cos(angle), math.sin(angle)])
    side = np.array([-direction[1], direction[0]])
    middle = inner / 2
    reach = np.abs(side) @ middle
    places = np.arange(math.floor(2 * reach + 1e-9) + 1) - math.floor(2 * reach + 1e-9) / 2
    ends = []
    for place in places:
        base = place * side
        with np.errstate(divide="ignore", invalid="ignore"):
            cuts = np.stack([(-middle - base) / direction, (middle - base) / direction])
        # a direction along a border is not cut by it
        cuts[:, np.abs(direction) < 1e-12] = [[-np.inf], [np.inf]]
        start, end = cuts.min(axis=0).max(), cuts.max(axis=0).min()
        if end - start > 0.5:
            ends.append((base + start * direction, base + end * direction))
    if not ends:
        raise ValueError(f"no line at {math.degrees(angle):g}° fits into this part.")
    way = [pair if i % 2 == 0 else pair[::-1] for i, pair in enumerate(ends)]
    return np.concatenate(way) + middle


def _other_way(points: np.ndarray) -> np.ndarray:
    """The same lines, each run in the other direction."""
    return points.reshape(-1, 2, 2)[:, ::-1].reshape(-1, 2)


def _join(before: np.ndarray, after: np.ndarray) -> float:
    """Length of the way from one repeat to the next; infinite if it has to turn back."""
    if len(before) == 0:
        return 0.0
    edges = np.diff(np.concatenate([before[-2:], after[:2]]), axis=0)
    length = np.linalg.norm(edges[1])
    if length < 1e-9:
        edges = edges[[0, 2]]
    elif length < 0.25:
        return math.inf
    unit = edges / np.linalg.norm(edges, axis=1)[:, None]
    turned = np.sum(unit[1:] * unit[:-1], axis=1)
    return math.inf if turned.min() < math.cos(SHARPEST) else float(length)


def spiral(turns: int, size: Size, corner: str = "smooth", fillet: float = 0.5) -> Polyline:
    """Guide along a spiral of straight edges, from a corner of any rectangle inwards.

    The pitch is the shorter side over twice the number of turns, and the spiral begins
    half a pitch inside the borders.

    Args:
        turns: How often it runs round the part.
        size: Lengths of the sides of the part; not traced [mm].
        corner: "smooth", "arc" or "sharp".
        fillet: Length of the two legs that a rounded corner replaces [pitch].

    Raises:
        ValueError: if an argument is out of its range.
    """
    if turns < 1:
        raise ValueError(f"`turns` is {turns}, must be 1 or more.")
    length, width = _sides(size)
    pitch = min(length, width) / (2 * turns)
    x, y = length / pitch, width / pitch
    # along x, y, x, y, ...: the first edge is one shorter than the side, then they shrink
    count = 4 * turns - 1
    k = np.arange(count)
    edges = np.where(k % 2 == 0, x, y) - np.where(k == 0, 1, (k + 1) // 2)
    steps = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])[k % 4] * edges[:, None]
    keep = edges > 0.5
    points = np.concatenate([np.zeros((1, 2)), np.cumsum(steps[keep], axis=0)]) + 0.5
    return polyline(points, pitch, corner, fillet)


def round_spiral(turns: int, size: Size) -> Involute:
    """Guide along a round spiral, from the middle of the part to the nearest borders.

    It covers the circle that fits into the part, whose corners stay as they are.

    Args:
        turns: How many pitches make the radius of that circle, 2 or more.
        size: Lengths of the sides of the part; may be traced [mm].

    Raises:
        ValueError: if an argument is out of its range.
    """
    sides = as_array(size)
    return involute(turns, sides / 2, jnp.min(sides) / 2)


def _sides(size: Size) -> tuple[float, float]:
    """The sides as numbers, which must have a length."""
    length, width = (float(side) for side in size)
    if not (math.isfinite(length) and math.isfinite(width) and min(length, width) > 0):
        raise ValueError(
            f"`size` is {length:g} x {width:g} mm, must have two sides above 0 mm."
        )
    return length, width
