"""Motion: what a program for a control holds, whatever language it is written in."""

from dataclasses import dataclass, fields, replace

import numpy as np


@dataclass(frozen=True)
class Motion:
    """Moves in their order, one a row; each starts where the one before it ended.

    The pose is there twice: for controls that know the tool centre, and as axis positions
    for those that do not.
    """

    rapid: np.ndarray
    """Whether the control goes there as fast as it can."""
    tip: np.ndarray
    """Driven point of the tool on the part [mm]."""
    axis: np.ndarray
    """Unit tool axis on the part, from the tip into the spindle [-]."""
    linear: np.ndarray
    """Positions of X, Y and Z [mm]."""
    rotary: np.ndarray
    """Positions of the two rotary axes [deg]."""
    feed: np.ndarray
    """Speed of the driven point [mm/min]; NaN for a rapid move."""
    seconds: np.ndarray
    """Duration [s]; NaN for a rapid move."""

    def rounded(self, decimals: int) -> "Motion":
        """The same, rounded as `decimals` places of lengths and angles print it.

        Directions have two places more, feeds one, and durations six, as a table has it.
        """
        places = {"axis": decimals + 2, "feed": 1, "seconds": 6}
        values = {
            f.name: np.round(getattr(self, f.name), places.get(f.name, decimals)) + 0.0
            for f in fields(self)
            if f.name != "rapid"
        }
        # a feed of nothing would never arrive, and nothing takes no time
        values["feed"] = np.maximum(values["feed"], 0.1)
        values["seconds"] = np.maximum(values["seconds"], 1e-6)
        return replace(self, **values)


@dataclass(frozen=True)
class Header:
    """What a program says before it moves."""

    name: str
    """What the control calls it: a word of letters, digits and underscores."""
    number: int
    """The same for controls that number programs."""
    notes: tuple[tuple[str, str], ...]
    """What people should know: a word or two, and what it is."""
    tool: int
    """Number of the tool in the control's table."""
    spindle: float
    """Speed of the spindle [rpm]."""
    clockwise: bool
    """Whether it turns clockwise, seen from the spindle."""
    offset: int
    """Which work offset: 1 for the first, G54."""
    rotary: tuple[str, str]
    """Letters of the rotary axes."""
    tolerance: float
    """How far the moves stray from the path [mm]."""


@dataclass(frozen=True)
class Read:
    """A program as it was read back."""

    rapid: np.ndarray
    """Whether each move is a rapid one."""
    tip: np.ndarray | None
    """Where each ends on the part [mm]; None where axes are resolved."""
    axis: np.ndarray | None
    """Tool axis there [-]; None where angles are written."""
    linear: np.ndarray | None
    """Positions of X, Y and Z there [mm]; None unless axes are resolved."""
    rotary: np.ndarray | None
    """Rotary axes there [deg]; None where vectors are written."""
    feed: np.ndarray | None
    """Feed of each move [mm/min], NaN for a rapid one; None in inverse time."""
    seconds: np.ndarray | None
    """Duration of each move [s], NaN for a rapid one; None where feeds are written."""
    tool: int
    """Number of the tool."""
    spindle: float
    """Speed of the spindle [rpm]."""
    clockwise: bool
    """Which way it turns."""
    offset: int
    """Work offset, 1 for G54."""
    notes: tuple[str, ...]
    """The comments."""
