"""Occt: the CAD kernel that reads STEP files and turns faces into B-splines.

The one module that knows the kernel (Open CASCADE, the optional extra `cad`). It minds
units, places and orientations, and hands out numbers; the process never asks it for one.
"""

# the kernel comes without types
# pyright: reportAttributeAccessIssue=false

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepAdaptor import BRepAdaptor_Curve, BRepAdaptor_Curve2d, BRepAdaptor_Surface
from OCP.BRepGProp import BRepGProp
from OCP.BRepTools import BRepTools_WireExplorer
from OCP.Geom import Geom_BSplineSurface, Geom_RectangularTrimmedSurface
from OCP.GeomAbs import GeomAbs_CurveType
from OCP.GeomConvert import GeomConvert
from OCP.gp import gp_Pnt, gp_Vec
from OCP.GProp import GProp_GProps
from OCP.IFSelect import IFSelect_ReturnStatus
from OCP.Message import Message
from OCP.ShapeAnalysis import ShapeAnalysis_Surface
from OCP.Standard import Standard_Failure
from OCP.STEPControl import STEPControl_Reader
from OCP.TopAbs import TopAbs_Orientation, TopAbs_ShapeEnum
from OCP.TopExp import TopExp_Explorer
from OCP.TopoDS import TopoDS

from .step_face import Face, Patch, StepFaceError


# A border this close to a line of constant u or v is one [mm].
NEAR = 1e-3
# What a conversion that claims to be exact may miss [mm].
EXACT = 1e-7
# Places along each edge, and along each side of a patch, that are looked at.
LOOKS = 9
# Kinds of surfaces whose name is not a word.
WORDS = {
    "SurfaceOfRevolution": "surface of revolution",
    "SurfaceOfExtrusion": "extrusion",
    "BSplineSurface": "B-spline",
    "BezierSurface": "Bezier",
    "OffsetSurface": "offset",
    "OtherSurface": "surface",
}


def faces(path: str) -> list[Face]:
    """The faces of a STEP file, in mm, where it puts them.

    Args:
        path: The file.

    Raises:
        StepFaceError: if the file is not STEP.
    """
    with quiet_kernel():
        try:
            reader = STEPControl_Reader()
            reader.SetSystemLengthUnit(1.0)
            if reader.ReadFile(path) != IFSelect_ReturnStatus.IFSelect_RetDone:
                raise StepFaceError(f"{path} cannot be read: it is not a STEP file")
            reader.TransferRoots()
            found = _parts(reader.OneShape(), "FACE")
        except Standard_Failure as error:
            raise StepFaceError(f"{path} cannot be read: {error}") from None
    return [_described(TopoDS.Face(one)) for one in found]


def patch(face: Any) -> Patch:
    """A face as one B-spline surface, exactly.

    Args:
        face: The kernel's face.

    Raises:
        StepFaceError: if it is none, in words to follow the name of the face.
    """
    try:
        found = _whole(face)
    except Standard_Failure as error:
        raise _wrong(f"cannot be made a B-spline ({error}); export it as one") from None
    inwards = face.Orientation() == TopAbs_Orientation.TopAbs_REVERSED
    if inwards == face.Location().Transformation().IsNegative():
        return found
    u, v = found.knots
    return found._replace(
        net=[row[::-1] for row in found.net],
        weights=[row[::-1] for row in found.weights],
        knots=(u, [-knot for knot in reversed(v)]),
    )


@contextmanager
def quiet_kernel() -> Iterator[None]:
    """Keeps the kernel from printing what it thinks of a file."""
    messenger = Message.DefaultMessenger_s()
    printers = list(messenger.Printers())
    for printer in printers:
        messenger.RemovePrinter(printer)
    try:
        yield
    finally:
        for printer in printers:
            messenger.AddPrinter(printer)


def _wrong(sentence: str) -> StepFaceError:
    return StepFaceError(sentence, "face")


def _trimmed(lines: str = "lines of constant u and v") -> StepFaceError:
    return _wrong(
        f"is trimmed by other curves than {lines}; export the untrimmed surface, or a "
        "rectangle of it"
    )


def _parts(shape: Any, kind: str) -> list[Any]:
    """All parts of a shape that are of one kind, with place and orientation in it."""
    found = []
    if not shape.IsNull():
        walk = TopExp_Explorer(shape, getattr(TopAbs_ShapeEnum, f"TopAbs_{kind}"))
        while walk.More():
            found.append(walk.Current())
            walk.Next()
    return found


def _described(face: Any) -> Face:
    """A face with what it is told apart by."""
    held = GProp_GProps()
    BRepGProp.SurfaceProperties_s(face, held)
    x, y, z = _numbers(held.CentreOfMass())
    return Face(face, _kind(face), held.Mass(), (x, y, z))


def _kind(face: Any) -> str:
    """What the surface of a face is, in words."""
    kind = str(BRepAdaptor_Surface(face).GetType())
    name = kind.rpartition("GeomAbs_")[2]
    return WORDS.get(name, name.lower())


def _numbers(point: Any) -> list[float]:
    return [point.X(), point.Y(), point.Z()]


def _whole(face: Any) -> Patch:
    """The surface of a face, which must cover a rectangle of u and v."""
    if len(_parts(face, "WIRE")) > 1:
        raise _wrong("has holes; fill them in the CAD system")
    if not _parts(face, "EDGE"):
        raise _wrong("has no border; cut out what is to be polished in the CAD system")
    if _kind(face) == "plane":
        net = _quadrilateral(face)
        knots, ones = [0.0, 0.0, 1.0, 1.0], [[1.0, 1.0], [1.0, 1.0]]
        return Patch(net.tolist(), ones, (knots, knots), (1, 1), _lengths(net))
    surface = BRep_Tool.Surface_s(face)
    found = _rectangle(face, surface)
    if isinstance(surface, Geom_BSplineSurface) and found == tuple(surface.Bounds()):
        spline = Geom_BSplineSurface(surface)
    else:
        part = Geom_RectangularTrimmedSurface(surface, *found)
        spline = GeomConvert.SurfaceToBSplineSurface_s(part)
    if spline.IsUPeriodic():
        spline.SetUNotPeriodic()
    if spline.IsVPeriodic():
        spline.SetVNotPeriodic()
    points = _grid(spline)
    for name, way in (("u", points), ("v", points.swapaxes(0, 1))):
        if np.abs(way[0] - way[-1]).max() < NEAR:
            raise _wrong(
                f"is closed along {name}; split it into two faces or more in the CAD system"
            )
        if min(np.ptp(way[i], axis=0).max() for i in (0, -1)) < NEAR:
            raise _wrong("has a pole, a side without length; cut the pole off")
    there = ShapeAnalysis_Surface(surface)
    same = _kind(face) in ("B-spline", "Bezier")
    for point in [] if same else points.reshape(-1, 3).tolist():
        there.ValueOfUV(gp_Pnt(*point), EXACT)
        if there.Gap() > EXACT:
            raise _wrong(
                f"is no B-spline, and one would miss it by {there.Gap():.2g} mm; export "
                "it as a B-spline"
            )
    return _patch(spline, _lengths(points))


def _quadrilateral(face: Any) -> np.ndarray:
    """A plane face with four straight sides as a net of its corners.

    It has u along the side that is nearest to the u of the plane.
    """
    for edge in _parts(face, "EDGE"):
        kind = BRepAdaptor_Curve(TopoDS.Edge(edge)).GetType()
        if kind != GeomAbs_CurveType.GeomAbs_Line:
            raise _trimmed("four straight sides")
    walk = BRepTools_WireExplorer(TopoDS.Wire(_parts(face, "WIRE")[0]), face)
    corners = []
    while walk.More():
        corners.append(_numbers(BRep_Tool.Pnt_s(walk.CurrentVertex())))
        walk.Next()
    u, v = gp_Vec(), gp_Vec()
    BRepAdaptor_Surface(face).D1(0.0, 0.0, gp_Pnt(), u, v)
    corner = np.array(corners)
    flat = corner @ np.array([_numbers(u), _numbers(v)]).T

    def turns(flat: np.ndarray) -> np.ndarray:
        ahead, behind = np.roll(flat, -1, axis=0) - flat, flat - np.roll(flat, 1, axis=0)
        return behind[:, 0] * ahead[:, 1] - behind[:, 1] * ahead[:, 0]

    if turns(flat).sum() < 0:
        corner, flat = corner[::-1], flat[::-1]
    # a side may consist of several edges
    bends = np.abs(turns(flat)) > NEAR * np.ptp(flat, axis=0).max()
    corner, flat = corner[bends], flat[bends]
    if len(corner) != 4 or turns(flat).min() < 0:
        raise _trimmed("four straight sides")
    ahead = np.roll(flat, -1, axis=0) - flat
    first = np.argmax(ahead[:, 0] / np.linalg.norm(ahead, axis=1))
    a, b, c, d = np.roll(corner, -int(first), axis=0)
    return np.array([[a, d], [b, c]])


def _rectangle(face: Any, surface: Any) -> tuple[float, ...]:
    """The range of u and v of a face whose borders are lines of constant u or v."""
    adaptor = BRepAdaptor_Surface(face)
    near = np.array([adaptor.UResolution(NEAR), adaptor.VResolution(NEAR)])
    ways = []
    for edge in map(TopoDS.Edge, _parts(face, "EDGE")):
        curve = BRepAdaptor_Curve2d(edge, face)
        first, last = curve.FirstParameter(), curve.LastParameter()
        points = [curve.Value(t) for t in np.linspace(first, last, LOOKS).tolist()]
        ways.append([[point.X(), point.Y()] for point in points])
    way = np.array(ways)
    low, high = way.min(axis=(0, 1)), way.max(axis=(0, 1))
    away = np.minimum(np.abs(way - low).max(axis=1), np.abs(way - high).max(axis=1))
    if np.any(np.all(away > near, axis=1)):
        raise _trimmed()
    # up to what the file has lost, the borders of the surface itself
    own = np.array(surface.Bounds()).reshape(2, 2)
    found = np.stack([low, high], axis=1)
    same = np.abs(found - own) <= near[:, None]
    return tuple(np.where(same, own, found).reshape(-1).tolist())


def _grid(spline: Any) -> np.ndarray:
    """Points of a surface along lines of constant u and v, `[u, v, xyz]` [mm]."""
    u0, u1, v0, v1 = spline.Bounds()
    u, v = (np.linspace(*ends, LOOKS).tolist() for ends in ((u0, u1), (v0, v1)))
    return np.array([[_numbers(spline.Value(a, b)) for b in v] for a in u])


def _lengths(points: np.ndarray) -> tuple[float, float]:
    """Mean lengths of the lines of a grid of points [mm]."""
    u, v = (np.linalg.norm(np.diff(points, axis=i), axis=2).sum(axis=i) for i in (0, 1))
    return float(u.mean()), float(v.mean())


def _patch(spline: Any, lengths: tuple[float, float]) -> Patch:
    """What a B-spline surface consists of."""
    rows, columns = range(1, spline.NbUPoles() + 1), range(1, spline.NbVPoles() + 1)
    return Patch(
        net=[[_numbers(spline.Pole(i, j)) for j in columns] for i in rows],
        weights=[[spline.Weight(i, j) for j in columns] for i in rows],
        knots=(list(spline.UKnotSequence()), list(spline.VKnotSequence())),
        degrees=(spline.UDegree(), spline.VDegree()),
        lengths=lengths,
    )
