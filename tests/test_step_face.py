"""STEP faces: files that the CAD kernel writes, and its own evaluation as the oracle."""

# the kernel comes without types
# pyright: reportAttributeAccessIssue=false, reportFunctionMemberAccess=false

import json
import sys
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close
from polishopt.chain import polish
from polishopt.files.answered import optimum
from polishopt.files.assemble import job, step_surface
from polishopt.files.config import ConfigError, check
from polishopt.files.step_face import StepFaceError, read_face
from polishopt.fit import main
from polishopt.path.surface import normal


pytest.importorskip("OCP", reason="the CAD kernel, the extra `cad`, is not installed")

from OCP.BRep import BRep_Builder  # noqa: E402
from OCP.BRepBuilderAPI import (  # noqa: E402
    BRepBuilderAPI_MakeEdge as Edge,
    BRepBuilderAPI_MakeFace as Face,
    BRepBuilderAPI_MakePolygon as Polygon,
    BRepBuilderAPI_MakeWire as Wire,
)
from OCP.BRepLib import BRepLib  # noqa: E402
from OCP.BRepPrimAPI import (  # noqa: E402
    BRepPrimAPI_MakeBox as Box,
    BRepPrimAPI_MakeCylinder as CylinderSolid,
    BRepPrimAPI_MakeRevol as Revolved,
)
from OCP.collections import (  # noqa: E402
    Array1_double,
    Array1_int,
    Array2_double,
    Array2_gp_Pnt,
)
from OCP.Geom import (  # noqa: E402
    Geom_BSplineSurface,
    Geom_Circle,
    Geom_OffsetSurface,
    Geom_SurfaceOfLinearExtrusion,
    Geom_SurfaceOfRevolution,
)
from OCP.Geom2d import Geom2d_Line  # noqa: E402
from OCP.gp import (  # noqa: E402
    gp_Ax1,
    gp_Ax2,
    gp_Ax3,
    gp_Circ,
    gp_Cone,
    gp_Cylinder,
    gp_Dir,
    gp_Dir2d,
    gp_Pln,
    gp_Pnt,
    gp_Pnt2d,
    gp_Sphere,
    gp_Torus,
    gp_Trsf,
    gp_Vec,
)
from OCP.Interface import Interface_Static  # noqa: E402
from OCP.STEPControl import STEPControl_StepModelType, STEPControl_Writer  # noqa: E402
from OCP.TopLoc import TopLoc_Location  # noqa: E402
from OCP.TopoDS import TopoDS, TopoDS_Compound  # noqa: E402
from polishopt.files.occt import faces, patch, quiet_kernel  # noqa: E402


SLENDER = Path(__file__).parent.parent / "configs" / "slender_insert.yaml"
SIZE = (60.0, 15.0)


def filled(kind, values):
    """An array of the kernel's, which counts from 1."""
    shape = np.shape(values)[: 2 if "2" in kind.__name__ else 1]
    made = kind(*[end for n in shape for end in (1, n)])
    for place in np.ndindex(*shape):
        made.SetValue(*(i + 1 for i in place), values[place])
    return made


def spline(degrees=(3, 2), counts=(6, 5), seed=0, around=None):
    """A rational surface with uneven knots; `around` makes it periodic along u."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(
        *(s * np.linspace(-0.5, 0.5, n) for s, n in zip(SIZE, counts, strict=True)),
        indexing="ij",
    )
    net = np.stack([x, y, -(x**2) / 600 - y**2 / 60], -1) + rng.normal(0, 0.2, (*counts, 3))
    if around is not None:
        turn = 2 * np.pi * np.arange(counts[0]) / counts[0]
        net = np.stack([around * np.cos(turn)[:, None] + 0 * y,
                        around * np.sin(turn)[:, None] + 0 * y, y], -1)  # fmt: skip
    points = np.empty(counts, object)
    for place in np.ndindex(*counts):
        points[place] = gp_Pnt(*net[place].tolist())
    knots, many = [], []
    for i, (n, p) in enumerate(zip(counts, degrees, strict=True)):
        loops = around is not None and i == 0
        inner = n - 1 if loops else n - p - 1
        between = np.sort(rng.uniform(0.1, 0.9, inner))
        knots.append(filled(Array1_double, np.array([0.0, *between, 1.0])))
        ends = 1 if loops else p + 1
        many.append(filled(Array1_int, np.array([ends, *[1] * inner, ends], object)))
    weights = filled(Array2_double, rng.uniform(0.5, 2.0, counts))
    return Geom_BSplineSurface(
        filled(Array2_gp_Pnt, points), weights, *knots, *many, *degrees, around is not None
    )


def face(surface, *bounds):
    """A face on a surface: whole, or between bounds of u and v."""
    return Face(surface, *bounds, *([1e-6] if not isinstance(surface, GP) else [])).Face()


GP = (gp_Cylinder, gp_Cone, gp_Sphere, gp_Torus, gp_Pln)
MOVE = gp_Trsf()
MOVE.SetRotation(gp_Ax1(gp_Pnt(1, 2, 3), gp_Dir(1, 1, 0)), 0.7)
MOVE.SetTranslationPart(gp_Vec(5, -40, 12))


def written(shape, folder, unit="MM"):
    """The shape as a STEP file."""
    path = folder / "insert.step"
    with quiet_kernel():
        writer = STEPControl_Writer()
        Interface_Static.SetCVal_s("write.step.unit", unit)
        writer.Transfer(shape, STEPControl_StepModelType.STEPControl_AsIs)
        writer.Write(str(path))
        Interface_Static.SetCVal_s("write.step.unit", "MM")
    return path


def together(*shapes):
    """Shapes as one assembly."""
    builder, made = BRep_Builder(), TopoDS_Compound()
    builder.MakeCompound(made)
    for shape in shapes:
        builder.Add(made, shape)
    return made


@eqx.filter_jit
def seen(surface, places):
    return jax.vmap(lambda xy: (surface(xy), normal(surface, xy)))(places)


def looked_at(path, index=None, count=200):
    """200 places on the sheet, as shares, with points and normals of the part there."""
    made = step_surface({"file": path, "face": index}, SIZE)
    shares = np.random.default_rng(1).uniform(size=(count, 2))
    points, normals = seen(made, jnp.asarray(shares * SIZE))
    return shares, np.asarray(points), np.asarray(normals)


def by_kernel(surface, shares, bounds, inwards, move=None):
    """The same from the kernel, of the surface that the file was written from."""
    u0, u1, v0, v1 = bounds
    found = []
    for a, b in shares:
        at, u, v = gp_Pnt(), gp_Vec(), gp_Vec()
        # turned round, v begins at its end
        b = 1 - b if inwards else b
        surface.D1(u0 + a * (u1 - u0), v0 + b * (v1 - v0), at, u, v)
        out = u.Crossed(v).Normalized()
        out = out.Reversed() if inwards else out
        if move is not None:
            at, out = at.Transformed(move), out.Transformed(move)
        found.append([[at.X(), at.Y(), at.Z()], [out.X(), out.Y(), out.Z()]])
    return np.moveaxis(np.array(found), 1, 0)


WHOLE = (0.0, 1.0, 0.0, 1.0)
ROUND_TRIPS = {
    "whole": {},
    "reversed": {"inwards": True},
    "inches": {"unit": "INCH", "inwards": True},
    "moved": {"move": MOVE},
    "moved, reversed": {"move": MOVE, "inwards": True},
    "a rectangle": {"bounds": (0.2, 0.7, 0.1, 0.9), "inwards": True},
    "up to one border": {"bounds": (0.0, 1.0, 0.3, 1.0)},
    "degrees 1 and 5": {"kind": {"degrees": (1, 5), "counts": (4, 7), "seed": 3}},
    "periodic": {"kind": {"around": 30.0}, "bounds": (0.1, 0.6, 0.0, 1.0)},
}


@pytest.mark.parametrize("case", ROUND_TRIPS.values(), ids=ROUND_TRIPS.keys())
def test_round_trip(case, tmp_path):
    """Points to 1e-9 mm and normals out of the material at 200 places."""
    surface, bounds = spline(**case.get("kind", {})), case.get("bounds", WHOLE)
    made = face(surface, *(() if bounds == WHOLE else bounds))
    inwards, move = case.get("inwards", False), case.get("move")
    made = made.Reversed() if inwards else made
    made = made if move is None else made.Moved(TopLoc_Location(move))
    path = written(made, tmp_path, case.get("unit", "MM"))
    shares, points, normals = looked_at(path)
    want = by_kernel(surface, shares, bounds, inwards, move)
    assert_close(points, want[0], rtol=0, atol=1e-9)
    assert_close(normals, want[1], rtol=0, atol=1e-9)


def test_the_parts_of_an_assembly(tmp_path):
    """One face twice, once moved."""
    surface = spline()
    made = face(surface)
    path = written(together(made, made.Moved(TopLoc_Location(MOVE))), tmp_path)
    for index, move in enumerate((None, MOVE)):
        shares, points, normals = looked_at(path, index)
        want = by_kernel(surface, shares, WHOLE, False, move)
        assert_close(points, want[0], rtol=0, atol=1e-9)
        assert_close(normals, want[1], rtol=0, atol=1e-9)


def test_a_mirrored_place():
    """The kernel can put a face in a mirror: its normal still leaves the material."""
    mirror = gp_Trsf()
    mirror.SetMirror(gp_Ax2(gp_Pnt(0, 0, 0), gp_Dir(0, 0, 1)))
    flat = Face(gp_Pln(), 0, 2, 0, 3).Face()
    for turned in (flat, flat.Reversed()):
        up = 1.0 if turned is flat else -1.0
        shape = turned.Located(TopLoc_Location(mirror), False)
        net = np.array(patch(TopoDS.Face(shape)).net)
        out = np.cross(net[1, 0] - net[0, 0], net[0, 1] - net[0, 0])
        assert_close(out / 6, [0.0, 0.0, -up])


def along(points, axis):
    return np.linalg.norm(points[:, axis], axis=1)


ANALYTIC = {
    "cylinder": (gp_Cylinder(gp_Ax3(), 10.0), lambda p: along(p, [0, 1]) - 10),
    "cone": (
        gp_Cone(gp_Ax3(), 0.3, 10.0),
        lambda p: (along(p, [0, 1]) - 10) * np.cos(0.3) - p[:, 2] * np.sin(0.3),
    ),
    "sphere": (gp_Sphere(gp_Ax3(), 30.0), lambda p: along(p, [0, 1, 2]) - 30),
    "torus": (
        gp_Torus(gp_Ax3(), 30.0, 8.0),
        lambda p: np.hypot(along(p, [0, 1]) - 30, p[:, 2]) - 8,
    ),
}


@pytest.mark.parametrize("inwards", [False, True])
@pytest.mark.parametrize(("made", "distance"), ANALYTIC.values(), ids=ANALYTIC.keys())
def test_surfaces_with_a_formula(made, distance, inwards, tmp_path):
    """On their formula, across the seam too; the distance grows along the normal."""
    shape = face(made, 5.9, 7.1, 0.1, 0.8)
    path = written(shape.Reversed() if inwards else shape, tmp_path)
    _, points, normals = looked_at(path)
    assert_close(distance(points), 0, rtol=0, atol=1e-9)
    step = -1e-3 if inwards else 1e-3
    assert_close(distance(points + 1e-3 * normals), step, rtol=0, atol=1e-9)


def test_extrusion_and_revolution_of_a_curve(tmp_path):
    """Of a circle, so that they are a cylinder and a torus."""
    curve = Geom_Circle(gp_Circ(gp_Ax2(gp_Pnt(30, 0, 0), gp_Dir(0, 1, 0)), 8.0))
    pulled = Geom_SurfaceOfLinearExtrusion(curve, gp_Dir(0, 1, 0))
    turned = Geom_SurfaceOfRevolution(curve, gp_Ax1(gp_Pnt(0, 0, 0), gp_Dir(0, 0, 1)))
    _, points, _ = looked_at(written(face(pulled, 0.3, 1.5, 1, 9), tmp_path))
    assert_close(along(points - [30, 0, 0], [0, 2]), 8, rtol=0, atol=1e-9)
    _, points, _ = looked_at(written(face(turned, 0.3, 1.5, 0.4, 1.2), tmp_path))
    assert_close(ANALYTIC["torus"][1](points), 0, rtol=0, atol=1e-9)


def polygon(*corners):
    """A plane face with straight sides, on a plane of its own turned by 30 degrees."""
    made = Polygon()
    for x, y in corners:
        made.Add(gp_Pnt(x, y, 2.0))
    made.Close()
    turned = gp_Ax3(gp_Pnt(0, 0, 2), gp_Dir(0, 0, 1), gp_Dir(np.cos(0.5), np.sin(0.5), 0))
    return Face(gp_Pln(turned), made.Wire()).Face()


def test_plane_faces_with_four_sides(tmp_path):
    """Any of them; a side may be in pieces. u is the side nearest to that of the plane."""
    corners = np.array([[0.0, 0.0], [60.0, 0.0], [50.0, 15.0], [20.0, 15.0], [5.0, 15.0]])
    path = written(polygon(*corners.tolist()), tmp_path)
    shares, points, normals = looked_at(path)
    a, b = shares.T[:, :, None]
    low, high = (1 - a) * corners[0] + a * corners[1], (1 - a) * corners[4] + a * corners[2]
    assert_close(points[:, :2], (1 - b) * low + b * high, rtol=0, atol=1e-9)
    assert_close(normals, np.tile([0.0, 0.0, 1.0], (200, 1)), rtol=0, atol=1e-9)


def test_faces_of_solids_look_out(tmp_path):
    """All six of a box; inside and outside of a quarter of a tube."""
    found = faces(str(written(Box(60.0, 15.0, 5.0).Shape(), tmp_path)))
    assert len(found) == 6
    for one in found:
        net = np.array(patch(one.shape).net)
        out = np.cross(net[1, 0] - net[0, 0], net[0, 1] - net[0, 0])
        assert_close(np.linalg.norm(out), one.area, rtol=1e-9)
        assert out @ (np.array(one.middle) - [30, 7.5, 2.5]) > 0
    wall = polygon((10, 0), (14, 0), (14, 5), (10, 5))
    tube = Revolved(wall, gp_Ax1(gp_Pnt(0, 0, 0), gp_Dir(0, 1, 0)), 1.5)
    path = written(tube.Shape(), tmp_path)
    round_ones = [i for i, one in enumerate(faces(str(path))) if one.kind == "cylinder"]
    assert len(round_ones) == 2
    ways = []
    for index in round_ones:
        _, points, normals = looked_at(path, index)
        radius = along(points, [0, 2])
        way = np.sum(normals[:, [0, 2]] * points[:, [0, 2]], axis=1) / radius
        assert_close(way, np.sign(way[0]), rtol=1e-9)
        ways.append((radius[0] > 12, way[0] > 0))
    assert sorted(ways) == [(False, False), (True, True)]


def round_hole(outer):
    """A round border in the middle of the spline, or of a face."""
    ring = Edge(gp_Circ(gp_Ax2(gp_Pnt(0, 0, 0), gp_Dir(0, 0, 1)), 3.0)).Edge()
    return Face(outer, Wire(ring).Wire())


def drilled():
    made = round_hole(Face(gp_Pln(), -30, 30, -7, 7).Face())
    return made.Face()


def cut_askew():
    """A B-spline whose border is a slanted line of its plane of parameters."""
    surface, way = spline(), Wire()
    corners = np.array([[0.1, 0.1], [0.9, 0.2], [0.8, 0.9], [0.1, 0.8]])
    for one, two in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        long = float(np.linalg.norm(two - one))
        line = Geom2d_Line(gp_Pnt2d(*one.tolist()), gp_Dir2d(*(two - one).tolist()))
        way.Add(Edge(line, surface, 0.0, long).Edge())
    made = Face(surface, way.Wire()).Face()
    BRepLib.BuildCurves3d_s(made)
    return made


BAD = {
    "hole": (drilled, "has holes; fill them"),
    "askew": (cut_askew, "is trimmed by other curves than lines of constant u and v"),
    "disc": (lambda: round_hole(gp_Pln()).Face(), "other curves than four straight sides"),
    "triangle": (lambda: polygon((0, 0), (9, 0), (0, 9)), "four straight sides"),
    "periodic": (lambda: face(gp_Cylinder(gp_Ax3(), 9.0), 0, 2 * np.pi, 0, 5), "is closed"),
    "periodic spline": (lambda: face(spline(around=30.0)), "is closed along u"),
    "pole": (lambda: face(gp_Sphere(gp_Ax3(), 9.0), 0, 1, 0, np.pi / 2), "has a pole"),
    "sphere": (lambda: Face(gp_Sphere(gp_Ax3(), 9.0)).Face(), "is closed along u"),
    "offset": (
        lambda: face(Geom_OffsetSurface(spline(), 2.0)),
        "is no B-spline, and one would miss it by",
    ),
    "no face": (lambda: Edge(gp_Pnt(0, 0, 0), gp_Pnt(1, 0, 0)).Edge(), "holds no face"),
    "several": (lambda: Box(60.0, 15.0, 5.0).Shape(), "holds 6 faces, and `face` must say"),
}


@pytest.mark.parametrize(("shape", "says"), BAD.values(), ids=BAD.keys())
def test_faces_that_are_no_part(shape, says, tmp_path, capfd):
    with pytest.raises(StepFaceError, match=says):
        read_face(written(shape(), tmp_path))
    assert capfd.readouterr() == ("", "")


def test_a_list_of_faces(tmp_path):
    path = written(CylinderSolid(10.0, 5.0, 1.0).Shape(), tmp_path)
    with pytest.raises(StepFaceError) as caught:
        read_face(path, 9)
    assert "part.face is 9, must be one of the faces of" in str(caught.value)
    assert "0 (cylinder, 50 mm² about (8.415, 4.597, 2.5) mm)" in str(caught.value)
    assert caught.value.key == "face"


TEXT = SLENDER.read_text()
NET = TEXT[TEXT.index("  surface: nurbs") : TEXT.index("\ntool:")]


def config(keys="", size="[60, 15]"):
    part = f"  surface: step\n  size_mm: {size}\n  file: insert.step\n{keys}"
    return TEXT.replace(NET, part)


polished = eqx.filter_jit(polish)


def write_insert(net, folder):
    """The crown of the slender insert, as a CAD program would export it."""
    net = np.asarray(net)
    points = np.empty(net.shape[:2], object)
    for place in np.ndindex(*net.shape[:2]):
        points[place] = gp_Pnt(*net[place].tolist())
    knots = filled(Array1_double, np.array([0.0, 1.0]))
    many = filled(Array1_int, np.array([3, 3], object))
    crown = Geom_BSplineSurface(
        filled(Array2_gp_Pnt, points), knots, knots, many, many, 2, 2
    )
    written(face(crown), folder)


@pytest.mark.slow
def test_a_step_face_is_tuned(tmp_path):
    """All four settings, end to end by the command."""
    path, target = tmp_path / "job.yaml", tmp_path / "results"
    surface = job(check(TEXT, path).config).setup.surface
    write_insert(surface.surface.net, tmp_path)
    path.write_text(config())
    assert main([str(path), "-o", str(target), "--set", "solver.starts=4"]) == 0
    result = json.loads((target / "result.json").read_text())
    assert result["verdict"] == "solved"
    assert abs(result["outcome"]["Ssk"] + 0.82) < 1e-3
    assert list(result["starts"]) == ["tilt", "displacement", "step", "trochoid_radius"]


def test_a_step_face_as_a_job(tmp_path, capsys):
    """The slender insert from a file: checked by the command, kept beside its answer, and
    polished like the one from the numbers in its config."""
    path = tmp_path / "job.yaml"
    as_numbers = job(check(TEXT.replace("  even: true\n", ""), path).config)
    write_insert(as_numbers.setup.surface.net, tmp_path)
    path.write_text(config().replace("  even: true\n", ""))
    assert main([str(path), "--check"]) == 0
    assert "insert.step, 60 x 15 mm" in capsys.readouterr().out
    found = check(path.read_text(), path)
    (tmp_path / "elsewhere").mkdir()
    assert "file: ../insert.step" in optimum(found, {}, tmp_path / "elsewhere")
    got, want = (
        polished(made.process, made.setup) for made in (job(found.config), as_numbers)
    )
    for name in ("force", "time", "removal", "Ssk", "Sku"):
        assert_close(getattr(got, name), getattr(want, name), rtol=1e-8)


MISTAKES = {
    "no such face": (config("  face: 1\n"), "part.face is 1, must be one of the faces of"),
    "negative": (config("  face: -1\n"), "part.face is -1, must lie in [0, 1e6]"),
    "sides": (config(size="[15, 60]"), "must be near the lengths of the face, 60"),
}


@pytest.mark.parametrize(("text", "says"), MISTAKES.values(), ids=MISTAKES.keys())
def test_mistakes_are_sentences(text, says, tmp_path):
    written(face(spline()), tmp_path)
    with pytest.raises(ConfigError) as caught:
        check(text, tmp_path / "bad.yaml")
    assert says in str(caught.value)


def test_files_that_cannot_be_read(tmp_path, capsys, monkeypatch):
    """No file, one that is not STEP, and no kernel to read it: each with exit code 2."""
    path, step = tmp_path / "job.yaml", tmp_path / "insert.step"
    path.write_text(config())
    for content, says in ((None, "No such file"), ("solid x", "it is not a STEP file")):
        if content is not None:
            step.write_text(content)
        assert main([str(path), "--check"]) == 2
        said = capsys.readouterr().err
        assert "part.file: " in said
        assert says in said
    monkeypatch.setitem(sys.modules, "polishopt.files.occt", None)  # it fails to import
    assert main([str(path), "--check"]) == 2
    assert "pip install 'polishopt[cad]'" in capsys.readouterr().err
