"""Topography: a height map with its spacing, read from and written to surface files.

x3p (ISO 25178-72) and SDF (ISO 25178-71) are read and written; formats of instrument
makers are read where the optional package SurfaceTopography is installed. A file from
elsewhere is not trusted: what it claims is checked before memory is spent on it.
"""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray


# Longest sides of what is still a surface texture [mm]. Numbers beyond come from bytes
# that mean something else, in another order or in other units.
WIDEST = 1e4
TALLEST = 1e3
# A map of this size fills 400 MB; the largest of a microscope have a tenth of it.
MOST_POINTS = 50_000_000
MILLIMETRES = 1e3
"""A metre, the unit of files, in the unit of this package."""


class TopographyError(ValueError):
    """What is wrong with a surface file, and which file."""

    def __init__(self, path: str | os.PathLike[str], sentence: str):
        self.path, self.sentence = Path(path), sentence
        super().__init__(f"{path}: {sentence}")


class NoSurface(ValueError):
    """What is wrong with heights or spacing, as the end of a sentence."""


@dataclass(frozen=True, eq=False)
class Topography:
    """Heights on a regular grid.

    Files hold metres, and two in a hundred doubles in mm are no double in metres times
    1000. Heights and spacing are moved to one that is, by their last digit at most, so
    that writing and reading changes no bit.

    Raises:
        NoSurface: if this is none; the sentence says why.
    """

    heights: NDArray[np.float64]
    """Heights, one row per y, y and x ascending; NaN where nothing was measured [mm]."""
    spacing: tuple[float, float]
    """Distance of neighbouring points along y and along x [mm]."""
    title: str = ""
    """What the file says it is."""
    instrument: str = ""
    """What measured it."""

    def __post_init__(self):
        heights = np.asarray(self.heights, dtype=np.float64)
        if heights.ndim != 2:
            raise NoSurface(
                f"holds an array of shape {heights.shape}, must hold rows and columns"
            )
        if heights.size == 0:
            rows, columns = heights.shape
            raise NoSurface(f"holds {columns} x {rows} points, must hold at least one")
        for name, step in zip(("y", "x"), self.spacing, strict=True):
            if not 0 < step <= WIDEST:
                raise NoSurface(
                    f"has points {step:g} mm apart along {name}, must lie in "
                    f"(0, {WIDEST:g}] mm"
                )
        measured = np.isfinite(heights)
        if not measured.any():
            raise NoSurface(
                f"has no measured point among {heights.size}, must have at least one"
            )
        with np.errstate(over="ignore"):
            span = heights.max(where=measured, initial=-np.inf) - heights.min(
                where=measured, initial=np.inf
            )
        if not span <= TALLEST:
            raise NoSurface(
                f"has heights that span {span:.3g} mm, must span at most {TALLEST:g} mm; "
                "are unit and byte order right?"
            )
        # once there and back, the way is exact: fl(1000 fl(x/1000)) stays as it is
        heights = np.where(measured, heights / MILLIMETRES * MILLIMETRES, np.nan)
        heights.setflags(write=False)
        dy, dx = (float(step) / MILLIMETRES * MILLIMETRES for step in self.spacing)
        object.__setattr__(self, "heights", heights)
        object.__setattr__(self, "spacing", (dy, dx))

    @property
    def extent(self) -> tuple[float, float]:
        """Sides along y and x, each point standing for one spacing [mm]."""
        rows, columns = self.heights.shape
        return rows * self.spacing[0], columns * self.spacing[1]

    @property
    def unmeasured(self) -> float:
        """Share of the points that were not measured [-]."""
        return float(np.mean(np.isnan(self.heights)))


def read(path: str | os.PathLike[str]) -> Topography:
    """The topography in a file; its suffix says in which format.

    Args:
        path: `.x3p` or `.sdf`; anything else goes to SurfaceTopography, if installed.

    Raises:
        TopographyError: if it cannot be read or is no surface, with a sentence.
    """
    from . import surface_formats  # its packages are only needed where there is a file

    path = Path(path)
    known = {".x3p": surface_formats.read_x3p, ".sdf": surface_formats.read_sdf}
    reader = known.get(path.suffix.lower(), surface_formats.read_other)
    try:
        if path.is_dir():
            raise TopographyError(path, "is a folder; name the surface file itself")
        return reader(path)
    except TopographyError:
        raise
    except FileNotFoundError:
        raise TopographyError(path, "there is no such file") from None
    except OSError as error:
        sentence = f"cannot be read: {error.strerror or error}"
        raise TopographyError(path, sentence) from None
    except NoSurface as error:
        raise TopographyError(path, str(error)) from None
    except Exception as error:
        # strange bytes make parsers raise anything; all of it means the same to the user
        reason = str(error).partition("\n")[0].rstrip(".") or type(error).__name__
        kind = path.suffix.lower().removeprefix(".")
        sentence = f"cannot be read as {kind}: {reason}; is the file whole?"
        raise TopographyError(path, sentence) from None


def write(path: str | os.PathLike[str], topography: Topography) -> None:
    """Writes a topography at once: a reader sees the old file or the new, never a half.

    Heights are stored as doubles in metres, x3p in the revision that the most programs
    read, ISO 25178-72:2017.

    Args:
        path: `.x3p` or `.sdf`; its folder must exist.
        topography: What to write.

    Raises:
        TopographyError: if the suffix is none of these, or the format cannot hold it.
    """
    from . import surface_formats

    path = Path(path)
    known = {".x3p": surface_formats.x3p_bytes, ".sdf": surface_formats.sdf_bytes}
    suffix = path.suffix.lower()
    if suffix not in known:
        raise TopographyError(path, f"ends in '{suffix}', must end in '.x3p' or '.sdf'")
    try:
        content = known[suffix](topography)
    except ValueError as error:
        raise TopographyError(path, f"cannot be written: {error}") from None
    beside = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        beside.write_bytes(content)
        os.replace(beside, path)
    except OSError as error:
        sentence = f"cannot be written: {error.strerror or error}"
        raise TopographyError(path, sentence) from None
    finally:
        beside.unlink(missing_ok=True)
