"""Given: the sections of a config that say what a shop has.

The part, the tool, the abrasive, the machine, and the curve that guides the trochoid.
Every physical key ends in its unit, and the docstring under each key is what an editor
shows.
"""

import math
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from . import library
from .quantity import ANY, BRIEF, Between, reject


Millimetres = Annotated[float, Between("[-1e4, 1e4]")]
Side = Annotated[float, Between("(0, 2000]")]


class Section(BaseModel):
    """A part of the config: no unknown keys, no later change."""

    model_config = BRIEF


def shelf(name: str) -> ConfigDict:
    """A section whose keys may come from a preset: then none of them is required."""

    def loosen(schema: dict[str, Any]) -> None:
        schema["properties"]["preset"] = {
            "description": f"Take the keys that are not given from one of the {name}.",
            "enum": list(library.names(name)),
        }
        required = schema.pop("required", [])
        schema["anyOf"] = [{"required": ["preset"]}, {"required": required}]

    return {**BRIEF, "json_schema_extra": loosen}


def named(name: str) -> Any:
    """In the JSON schema of a key, the name of a preset beside the section itself."""

    def widen(schema: dict[str, Any]) -> None:
        section = {"$ref": schema.pop("$ref")}
        schema["anyOf"] = [{"enum": list(library.names(name))}, section]

    return Field(json_schema_extra=widen)


class Plane(Section):
    """A flat part."""

    surface: Literal["plane"]
    size_mm: tuple[Side, Side]
    """Sides of the rectangle to polish."""


class SphereCap(Section):
    """A rectangular patch of a sphere, its middle on top."""

    surface: Literal["sphere_cap"]
    size_mm: tuple[Side, Side]
    """Sides of the patch, seen from above."""
    radius_mm: Annotated[float, Between("[-1e6, 1e6]")]
    """Radius of the sphere: positive for a convex part, negative for a concave one."""

    @model_validator(mode="after")
    def _spans(self):
        reach = math.hypot(*self.size_mm) / 2
        if abs(self.radius_mm) <= reach:
            reject(
                (
                    ("radius_mm",),
                    f"must exceed half the diagonal of the patch, {reach:.6g} mm",
                    self.radius_mm,
                )
            )
        return self


class HyperbolicParaboloid(Section):
    """A saddle, z = twist x y."""

    surface: Literal["hyperbolic_paraboloid"]
    size_mm: tuple[Side, Side]
    """Sides of the patch, seen from above."""
    twist_1_mm: Annotated[float, Between("[-1, 1]")]
    """Change of slope along one side per length along the other."""


class Asphere(Section):
    """A rectangular patch of a conic section with even powers on top, about its vertex."""

    surface: Literal["asphere"]
    size_mm: tuple[Side, Side]
    """Sides of the patch, seen from above."""
    radius_mm: Annotated[float, Between("[-1e6, 1e6]")]
    """Radius at the vertex: positive for a convex part, negative for a concave one."""
    conic: Annotated[float, Between("[-1e4, 1e4]")] = 0.0
    """Conic constant: 0 a sphere, -1 a paraboloid."""
    even_terms: tuple[Annotated[float, ANY], ...] = ()
    """Coefficients of r^4, r^6, ... in 1/mm^3, 1/mm^5, ...; they go down, as the radius."""

    @model_validator(mode="after")
    def _spans(self):
        reach = math.hypot(*self.size_mm) / 2
        if self.radius_mm == 0 or (1 + self.conic) * (reach / self.radius_mm) ** 2 >= 1:
            sentence = (
                f"must be larger: the conic ends before the corners, {reach:.6g} mm out"
            )
            reject((("radius_mm",), sentence, self.radius_mm))
        return self


Degree = Annotated[int, Between("[1, 9]")]
Coordinate = Annotated[float, Between("[-1e5, 1e5]")]
Point = tuple[Coordinate, Coordinate, Coordinate]
Knots = tuple[Annotated[float, ANY], ...]


class Nurbs(Section):
    """A NURBS surface, as CAD exports it."""

    surface: Literal["nurbs"]
    size_mm: tuple[Side, Side]
    """Lengths of the part along u and v, about its middle: the sheet that the guide is
    laid out on."""
    degrees: tuple[Degree, Degree]
    """Degrees along u and v."""
    net_mm: tuple[tuple[Point, ...], ...]
    """Control points [x, y, z]: a list of rows, one for each index along u, which is x on
    the sheet. The material lies on the side from which v turns clockwise into u."""
    weights: tuple[tuple[Annotated[float, Between("(0, 1e6]")], ...], ...] | None = None
    """Weights of the control points, in the same rows; left out, all are one."""
    u_knots: Knots | None = None
    """Knots along u; left out, even ones."""
    v_knots: Knots | None = None
    """Knots along v; left out, even ones."""

    @model_validator(mode="after")
    def _fits(self):
        wrongs = []
        rows = [len(row) for row in self.net_mm]
        if not rows or min(rows) != max(rows):
            reject((("net_mm",), "must have rows of equal length", rows))
        counts = (len(rows), rows[0])
        weights = self.weights
        if weights is not None and [len(row) for row in weights] != rows:
            wrongs.append(
                (("weights",), "must have as many rows and columns as `net_mm`", ...)
            )
        for i, (name, knots) in enumerate((("u", self.u_knots), ("v", self.v_knots))):
            degree, count = self.degrees[i], counts[i]
            if degree >= count:
                sentence = f"must be below the {count} control points along {name}"
                wrongs.append((("degrees", i), sentence, degree))
            elif knots is not None and len(knots) != count + degree + 1:
                sentence = (
                    f"holds {len(knots)} knots, must hold {count + degree + 1}: "
                    "as many as control points, the degree and one"
                )
                wrongs.append(((f"{name}_knots",), sentence, ...))
            elif knots is not None and sorted(knots) != list(knots):
                wrongs.append(((f"{name}_knots",), "must never descend", list(knots)))
        if wrongs:
            reject(*wrongs)
        return self


class PointGrid(Section):
    """A surface fitted to points that were measured in rows and columns."""

    surface: Literal["point_grid"]
    size_mm: tuple[Side, Side]
    """Lengths of the part along its rows and columns, about its middle: the sheet that
    the guide is laid out on."""
    file: str
    """Text file with a point in each line, x, y, z in mm with commas between them, row by
    row; a row is what follows y, and rows follow each other along x. A relative path
    starts at the folder of this config."""
    columns: Annotated[int, Between("[2, 10000]")]
    """Number of points in a row."""
    control_points: tuple[Annotated[int, Between("[2, 500]")], ...] = (8, 8)
    """Numbers of control points along x and y of the surface that is fitted."""
    degrees: tuple[Degree, Degree] = (3, 3)
    """Its degrees."""

    @model_validator(mode="after")
    def _fits(self):
        if len(self.control_points) != 2:
            reject((("control_points",), "must be two numbers", list(self.control_points)))
        for i, (degree, count) in enumerate(
            zip(self.degrees, self.control_points, strict=True)
        ):
            if degree >= count:
                sentence = f"must be below the {count} control points"
                reject((("degrees", i), sentence, degree))
        return self


class StepFace(Section):
    """A face of a STEP file."""

    surface: Literal["step"]
    size_mm: tuple[Side, Side]
    """Lengths of the face along its u and v, about its middle: the sheet that the guide is
    laid out on."""
    file: str
    """STEP file, whose coordinates are those of the part. A relative path starts at the
    folder of this config."""
    face: Annotated[int, Between("[0, 1e6]")] | None = None
    """Which of its faces, from 0; left out, the only one. It must be a whole patch of its
    surface, or a rectangle of it in u and v."""


Part = Annotated[
    Plane | SphereCap | HyperbolicParaboloid | Asphere | Nurbs | PointGrid | StepFace,
    Field(discriminator="surface"),
]


class Unstick(Section):
    """Measured forces at which the disc comes unstuck."""

    tilt_deg: tuple[Annotated[float, Between("[0, 45]")], ...]
    """Tilts of the measurements, ascending."""
    force_N: tuple[Annotated[float, Between("(0, 1e4]")], ...]
    """Force at which the disc comes unstuck, one for each tilt."""

    @model_validator(mode="after")
    def _table(self):
        tilts, forces = self.tilt_deg, self.force_N
        wrongs = []
        if not tilts or any(a >= b for a, b in zip(tilts, tilts[1:], strict=False)):
            wrongs.append(
                (("tilt_deg",), "must hold tilts in ascending order", list(tilts))
            )
        if len(forces) != len(tilts):
            sentence = f"must hold one force for each of the {len(tilts)} tilts"
            wrongs.append((("force_N",), sentence, list(forces)))
        if wrongs:
            reject(*wrongs)
        return self


class Tool(Section):
    """A compliant disc on a stiffer body."""

    model_config = shelf("tools")

    preset: str | None = None
    diameter_mm: Annotated[float, Between("(0, 500]")]
    """Diameter of the disc, D."""
    foundation_N_mm3: Annotated[float, Between("(0, 1000]")]
    """Stiffness of the elastic disc per area: pressure per depth pressed in, k."""
    body_radius_mm: Annotated[float, Between("[0, 250]")]
    """Radius of the rigid body behind the disc."""
    body_recess_mm: Annotated[float, Between("(0, 100]")]
    """How far that body stands behind the face of the disc."""
    friction: Annotated[float, Between("[0, 2]")] = 0.4
    """Friction coefficient between abrasive and part."""
    shear_strength_MPa: Annotated[float, Between("(0, 1000]")] | None = None
    """Shear stress at which the adhesive of the disc fails; leave out if unknown."""
    stiffening_1_mm: Annotated[float, Between("[-10, 100]")] = 0.0
    """Relative growth of that stiffness per depth pressed in, beta."""
    unstick: Unstick | None = None
    """Forces at which the disc comes unstuck; leave out for a tool that is not glued."""

    @model_validator(mode="after")
    def _body_fits(self):
        if self.body_radius_mm >= self.diameter_mm / 2:
            sentence = (
                f"must be smaller than the disc's radius, {self.diameter_mm / 2:g} mm"
            )
            reject((("body_radius_mm",), sentence, self.body_radius_mm))
        return self


class Abrasive(Section):
    """A grade of abrasive on a given work material."""

    model_config = shelf("abrasives")

    preset: str | None = None
    preston_1_Pa: Annotated[float, Between("(0, 1e-6]")]
    """Preston coefficient: depth removed per pressure and per length of sliding."""
    grain_um: Annotated[float, Between("(0, 2000]")]
    """Mean diameter of the grains."""
    active_fraction: Annotated[float, Between("(0, 1]")]
    """Active grains per grain diameter squared of contact."""
    half_angle_deg: Annotated[float, Between("(0, 89]")]
    """Half-angle of the cone that stands for the tip of a grain."""
    hardness_GPa: Annotated[float, Between("(0, 100]")]
    """Hardness of the work material."""
    pad_modulus_MPa: Annotated[float, Between("(0, 1e6]")]
    """Effective elastic modulus of what carries the grains."""
    depth_variation: Annotated[float, Between("[0, 3]")]
    """Standard deviation of the depths of grooves over their mean."""
    conformity_mm: Annotated[float, Between("(0, 100]")]
    """Length above which the disc follows the surface instead of bridging it."""
    asperity_stiffness_N_mm3: Annotated[float, Between("(0, 1e12]")] | None = None
    """Pressure per height of an asperity, if measured; else it follows from the pad."""
    ripple_gain: Annotated[float, Between("[0, 1000]")] = 1.0
    """Amplitude of the ripple as measured, over the one that the path predicts."""


Component = Annotated[float, Between("[-1, 1]")]
Millimetre3 = tuple[Millimetres, Millimetres, Millimetres]
Turn = Annotated[float, Between("[-1e5, 1e5]")]
Lean = Annotated[float, Between("[-180, 180]")]


def _ordered(key: str, travel: tuple[float, float] | None) -> None:
    """Rejects a travel that ends before it begins."""
    if travel is not None and travel[0] >= travel[1]:
        sentence = "must have the lower end first, then a higher one"
        reject(((key,), sentence, list(travel)))


def _pointing(way: tuple[float, float, float] | None) -> None:
    """Rejects a direction without length."""
    if way is not None and math.hypot(*way) < 1e-3:
        reject((("direction",), "must have a length", list(way)))


class LinearAxis(Section):
    """Limits of an axis that moves along a line."""

    speed_m_min: Annotated[float, Between("[0, 1000]")]
    """Fastest speed; zero for an axis that is clamped."""
    acceleration_m_s2: Annotated[float, Between("(0, 1000]")]
    """Largest acceleration."""
    jerk_m_s3: Annotated[float, Between("(0, 1e6]")]
    """Largest jerk."""
    travel_mm: tuple[Millimetres, Millimetres] | None = None
    """Both ends of its travel, counted from where the tool tip stands with all axes at
    zero; leave out for no limit."""
    direction: tuple[Component, Component, Component] | None = None
    """Where a positive position moves the tool against the part, with all axes at zero;
    left out, along the letter of the axis."""

    @model_validator(mode="after")
    def _makes_sense(self):
        _ordered("travel_mm", self.travel_mm)
        _pointing(self.direction)
        return self


class RotaryAxis(Section):
    """Limits of an axis that turns."""

    speed_rpm: Annotated[float, Between("[0, 1e4]")]
    """Fastest speed; zero for an axis that is clamped."""
    acceleration_rev_s2: Annotated[float, Between("(0, 1e4]")]
    """Largest acceleration."""
    jerk_rev_s3: Annotated[float, Between("(0, 1e6]")]
    """Largest jerk."""
    travel_deg: tuple[Turn, Turn] | None = None
    """Both ends of its travel; leave out for an axis that turns without end."""
    direction: tuple[Component, Component, Component] | None = None
    """About what a positive angle turns what the axis carries, the part or the tool, with
    all axes at zero; left out, about X for A, Y for B and Z for C."""
    at_mm: Millimetre3 = (0.0, 0.0, 0.0)
    """A point of its line, all axes at zero, counted from where the tool tip is then."""

    @model_validator(mode="after")
    def _makes_sense(self):
        _ordered("travel_deg", self.travel_deg)
        _pointing(self.direction)
        return self


class Axes(Section):
    """The five axes: X, Y and Z move along lines, two of A, B and C turn."""

    X: LinearAxis
    Y: LinearAxis
    Z: LinearAxis
    A: RotaryAxis | None = None
    B: RotaryAxis | None = None
    C: RotaryAxis | None = None


class Placement(Section):
    """How the part stands on what carries it; the process may move it from there."""

    offset_mm: Millimetre3 = (0.0, 0.0, 0.0)
    """Origin of the part with all axes at zero, from the point given for the rotary axis
    next to it, or from the tool tip where no axis turns the part."""
    wedge_deg: tuple[Lean, Lean, Lean] = (0.0, 0.0, 0.0)
    """How the part is turned on it: about X, then Y, then Z."""


class Machine(Section):
    """A 5-axis machine: a chain of three linear and two rotary axes."""

    model_config = shelf("machines")

    preset: str | None = None
    chain: str
    """Its axes from the part (w) by the bed (b) to the tool (t), as `w C A b X Y Z t` for a
    table that C turns and A tilts."""
    axes: Axes
    """Limits of each axis, and where it is."""
    placement: Placement = Placement()
    """How the part stands on what carries it."""

    def names(self) -> tuple[str, ...]:
        """The axes: linear ones first, each kind by the alphabet."""
        links = [name for name in self.chain.split() if name in "XYZABC"]
        return tuple(sorted(links, key=lambda name: (name in "ABC", name)))

    @model_validator(mode="after")
    def _is_a_machine(self):
        links, held = self.chain.split(), [name for name, axis in self.axes if axis]
        sound = links[:1] == ["w"] and links[-1:] == ["t"] and links.count("b") == 1
        if not sound or sorted(links[1:-1]) != sorted(["b", *self.names()]):
            sentence = (
                "must name the axes from w, the part, by b, the bed, to t, the tool, as "
                "'w C A b X Y Z t'"
            )
            reject((("chain",), sentence, self.chain))
        if list(self.names()) != held or len(held) != 5:
            sentence = (
                f"must name X, Y, Z and two of A, B, C, once each, and just those that "
                f"`axes` describes: {', '.join(held)}"
            )
            reject((("chain",), sentence, self.chain))
        one, two = (self.direction(name) for name in links if name in ("A", "B", "C"))
        aside = math.hypot(*_crossed(one, two))
        if aside < 0.1:
            sentence = "must not have two rotary axes that are parallel, or nearly so"
            reject((("chain",), sentence, self.chain))
        if abs(two[2]) > 0.99:
            sentence = "must not have the rotary axis next to the tool along the spindle"
            reject((("chain",), sentence, self.chain))
        x, y, z = (self.direction(name) for name in "XYZ")
        if abs(sum(a * b for a, b in zip(x, _crossed(y, z), strict=True))) < 0.1:
            sentence = "must have linear axes that span all directions"
            reject((("axes",), sentence, self.chain))
        return self

    def direction(self, name: str) -> tuple[float, float, float]:
        """Unit vector of an axis, all axes at zero."""
        x, y, z = getattr(self.axes, name).direction or [
            float("XYZABC".index(name) % 3 == i) for i in range(3)
        ]
        size = math.hypot(x, y, z)
        return x / size, y / size, z / size


def _crossed(a: tuple[float, ...], b: tuple[float, ...]) -> tuple[float, ...]:
    """Vector product."""
    return tuple(a[i - 2] * b[i - 1] - a[i - 1] * b[i - 2] for i in range(3))


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
