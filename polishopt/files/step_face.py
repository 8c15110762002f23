"""Step_face: one face of a STEP file as a NURBS surface.

The file is read by a CAD kernel, the optional extra `cad` (see `occt`). It takes most of a
second to load, so that is only done when there is a face to read.
"""

from pathlib import Path
from typing import Any, Literal, NamedTuple


# The most faces that are listed.
LISTED = 24


class StepFaceError(Exception):
    """A sentence about a face of a STEP file."""

    def __init__(self, sentence: str, key: Literal["file", "face"] = "file"):
        self.key: Literal["file", "face"] = key
        super().__init__(sentence)


class Face(NamedTuple):
    """A face as it stands in a file."""

    shape: Any
    """The kernel's own."""
    kind: str
    """What its surface is, in words."""
    area: float
    """Its area [mm^2]."""
    middle: tuple[float, float, float]
    """Centre of its area [mm]."""


class Patch(NamedTuple):
    """A B-spline surface; where v lies to the left of u, the normal leaves the material."""

    net: list[list[list[float]]]
    """Control points, `[u, v, xyz]` [mm]."""
    weights: list[list[float]]
    """Their weights [-]."""
    knots: tuple[list[float], list[float]]
    """Knots along u and v [-]."""
    degrees: tuple[int, int]
    """Degrees along u and v."""
    lengths: tuple[float, float]
    """Mean lengths of its lines along u and along v [mm]."""


def read_face(path: str | Path, index: int | None = None) -> Patch:
    """A face of a STEP file as one B-spline surface, exactly, in mm.

    A face whose own normal points into the material has its v turned round.

    Args:
        path: The file.
        index: Which of its faces, from 0; None for the only one.

    Raises:
        StepFaceError: if the CAD kernel is not installed, the file or the face is not
            there, or the face is no whole patch of a surface.
    """
    path = Path(path)
    try:
        path.open("rb").close()
    except OSError as error:
        raise StepFaceError(f"{path} cannot be read: {error}") from None
    try:
        from .occt import faces, patch
    except ImportError as error:
        raise StepFaceError(
            f"{path} takes a CAD kernel to be read; install it with "
            f"`pip install 'polishopt[cad]'` ({error})"
        ) from None
    found = faces(str(path))
    if not found:
        raise StepFaceError(f"{path} holds no face, must hold a surface or a solid")
    if index is None and len(found) > 1:
        raise StepFaceError(
            f"{path} holds {len(found)} faces, and `face` must say which: {listed(found)}"
        )
    if index is not None and index >= len(found):
        raise StepFaceError(
            f"part.face is {index}, must be one of the faces of {path}: {listed(found)}",
            "face",
        )
    try:
        return patch(found[index or 0].shape)
    except StepFaceError as error:
        raise StepFaceError(f"face {index or 0} of {path} {error}", error.key) from None


def listed(found: list[Face]) -> str:
    """Faces by what a person can tell them apart.

    Args:
        found: All faces of a file.
    """
    rows = [
        f"{i} ({face.kind}, {face.area:.4g} mm² about "
        f"({', '.join(f'{round(x, 9) + 0:.4g}' for x in face.middle)}) mm)"
        for i, face in enumerate(found[:LISTED])
    ]
    more = len(found) - len(rows)
    return "; ".join(rows) + (f"; and {more} more" if more else "")
