"""Guides: the section of a config that says which curve the trochoid runs along."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from .quantity import Between, reject
from .section import Section


class Guide(Section):
    """The curve that the trochoid runs along."""

    corner: Literal["smooth", "arc", "sharp"] = "smooth"
    """How corners are rounded: smooth (curvature changes gently), by an arc, or not."""
    fillet: Annotated[float, Between("(0, 0.5]")] = 0.5
    """How much of each side a rounded corner takes, as a share of the side."""
    mode: Literal["pulling", "pushing"] = "pulling"
    """Pulling: the tool axis leans along the travel. Pushing: against it."""
    lean: Literal["guide", "fixed"] = "guide"
    """Lean along the guide curve, or everywhere along the x axis of the part."""
    hold: Literal["displacement", "force", "pressure"] = "displacement"
    """What stays the same where the curvature of the part changes: the displacement, or
    the force or the mean pressure of the contact, which the displacement then follows as
    far as rigid body and adhesive allow."""
    even: bool = False
    """Lay the curve out by area, so that it covers a curved part as evenly as a plane."""

    @model_validator(mode="after")
    def _fillet_is_used(self):
        if self.corner == "sharp" and "fillet" in self.model_fields_set:
            reject((("fillet",), "must be left out where `corner` is sharp", self.fillet))
        return self


class Hilbert(Guide):
    """A Hilbert curve, which covers the part without a preferred direction."""

    family: Literal["hilbert"]
    order: Annotated[int, Between("[1, 7]")]
    """Order of the curve: it visits 2^order by 2^order cells."""


class HilbertRectangle(Guide):
    """A Hilbert-like curve on any rectangle, which visits every cell of a lattice."""

    family: Literal["hilbert_rectangle"]
    count: Annotated[int, Between("[1, 128]")]
    """Number of cells along the shorter side; along the other they are nearly square."""


class Peano(Guide):
    """Peano's curve: equal segments along diagonals, a right angle between any two."""

    family: Literal["peano"]
    order: Annotated[int, Between("[1, 4]")]
    """Order of the curve: 3^order cells along the shorter side."""


class PeanoRound(Guide):
    """A Peano-like path round the middle of a plane, a sphere cap or an asphere."""

    family: Literal["peano_round"]
    segment_mm: Annotated[float, Between("(0, 500]")]
    """Length of the segments on the part, p; there are 2/p of path on an area."""
    closed: bool = False
    """Whether a way back leads to the start; the vertex then stays free."""


class Lines(Guide):
    """Parallel lines."""

    family: Literal["lines"]
    count: Annotated[int, Between("[2, 500]")]
    """Number of lines."""
    one_way: bool = False
    """All in one direction, with the tool lifted on the way back; else there and back."""


class Hatch(Guide):
    """Parallel lines there and back, repeated at another angle."""

    family: Literal["hatch"]
    count: Annotated[int, Between("[2, 200]")]
    """Number of lines of the first repeat."""
    repeats: Annotated[int, Between("[1, 12]")] = 2
    """How often the part is covered."""
    angle_deg: Annotated[float, Between("[1, 179]")] = 90.0
    """By how much each repeat is turned from the last."""


class Spiral(Guide):
    """A spiral, with straight edges inwards or round outwards."""

    family: Literal["spiral"]
    turns: Annotated[int, Between("[2, 200]")]
    """How often it runs round."""
    shape: Literal["rectangular", "round"] = "rectangular"
    """Rectangular: it covers the part. Round: it covers the circle inside, by an involute;
    `corner` and `fillet` do not matter then."""


Family = Annotated[
    Hilbert | HilbertRectangle | Peano | PeanoRound | Lines | Hatch | Spiral,
    Field(discriminator="family"),
]
