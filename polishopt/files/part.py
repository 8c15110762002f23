"""Part: the section of a config that says what shape is polished."""

import math
from typing import Annotated, Literal

from pydantic import Field, model_validator

from .quantity import ANY, Between, reject
from .section import Section


Side = Annotated[float, Between("(0, 2000]")]


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
