"""Point grid: measured points of a part, from a text file.

Neither JAX nor NumPy is imported, so that a mistake is told at once.
"""

import math
from pathlib import Path


class PointGridError(Exception):
    """A sentence about a file of points."""


def read_points(path: str | Path, columns: int) -> list[list[list[float]]]:
    """The points of a file, row by row.

    Args:
        path: A text file with `x, y, z` in mm in each line; empty lines, and lines that
            begin with #, do not count.
        columns: Number of points in a row.

    Raises:
        PointGridError: with the line of the first mistake.
    """
    try:
        lines = Path(path).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise PointGridError(f"{path} cannot be read: {error}") from None
    points = []
    for number, line in enumerate(lines, start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        cells = [cell.strip() for cell in line.split(",")]
        try:
            point = [float(cell) for cell in cells]
        except ValueError:
            raise PointGridError(
                f"{path}, line {number}, is {line.strip()!r}, must be three numbers "
                "x, y, z in mm"
            ) from None
        if len(point) != 3:
            raise PointGridError(
                f"{path}, line {number}, holds {len(point)} numbers, must hold three: "
                "x, y, z in mm"
            )
        if not all(math.isfinite(value) for value in point):
            row, column = divmod(len(points), columns)
            raise PointGridError(
                f"{path}, line {number} (row {row + 1}, column {column + 1}), has no value "
                "for each of x, y, z; fill the gaps of a grid before it is fitted"
            )
        points.append(point)
    rows, rest = divmod(len(points), columns)
    if rest or rows < 2:
        raise PointGridError(
            f"{path} holds {len(points)} points, must hold two or more whole rows of "
            f"{columns}"
        )
    return [points[i * columns : (i + 1) * columns] for i in range(rows)]
