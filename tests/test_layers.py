"""Layers: imports point down, and only the top floor talks to people."""

import ast
from pathlib import Path

import polishopt
import pytest


# Modules from the lowest floor to the highest; each may import what stands before it.
# All of `files` is one place: its modules read each other in any order.
FLOORS = """
units compiler stored parts batched
path.surface path.asphere path.nurbs path.soundness path.even
path.corner path.guide path.polyline path.involute path.families path.revolution
path.trochoid path.toolpath path
machine.kinematics machine.route machine.sweep machine.feed machine.exact machine.loop
machine.shape machine.banded machine.interior machine.jerk machine.jerk_exact machine.usage
machine
contact.pressure contact.flat contact.limits contact.removal contact.ripple contact
texture.filters texture.areal texture.hybrid texture.lay texture.spatial texture.spectrum
texture.functional
texture.feature texture.uncertainty texture.parameters
texture.milling texture.cutter texture.cutting texture.marks
texture.planarisation texture.scratches texture.evolution texture.direction
texture.local texture
setup constants margin hold mechanics chain plan resolved
coverage
blocks preflight evenness
optimize.model optimize.box optimize.values optimize.penalty optimize.certificate
optimize.naming
optimize.steering optimize.outer optimize.implicit optimize.adapted optimize.walk
optimize.auglag optimize.goals optimize.uncertainty
optimize.kept optimize.batches optimize.stage optimize.starts
optimize.tune optimize.choices optimize.basins optimize.explore optimize.front
optimize.sensitivity optimize.variance
optimize.attribution
optimize.runs optimize.calibrate optimize.identify optimize
files
postprocess plots feed_plot path_plots shares_plot report basin_report front_plot results
plan_report session program
interruption relax answer choice_report choice_plot choices
fit front sensitivity attribution
measure
calibrate
texture.__main__
"""
ORDER = FLOORS.split()
TOP = set(ORDER[ORDER.index("files") + 1 :])
ROOT = Path(polishopt.__file__).parent
# where a checked config becomes JAX arrays, and where these become a table
WITH_JAX = {"files.assemble", "files.results"}


def module_name(path):
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


PATHS = {module_name(path): path for path in sorted(ROOT.rglob("*.py"))}
MODULES = [name for name in PATHS if name]


def tree_of(name):
    return ast.parse(PATHS[name].read_text(encoding="utf-8"))


def known(module):
    """The longest beginning of a dotted name that is a module of the package."""
    while module not in PATHS:
        module = module.rpartition(".")[0]
    return module


def imported(name, tree=None):
    """Own modules, and outside packages, that a module imports anywhere."""
    package = name.split(".") if PATHS[name].name == "__init__.py" else name.split(".")[:-1]
    package = [part for part in package if part]
    own, outside = set(), set()
    for node in ast.walk(tree or tree_of(name)):
        if isinstance(node, ast.Import):
            dotted = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            above = ["polishopt", *package[: len(package) + 1 - node.level]]
            start = above if node.level else []
            base = ".".join([*start, *([node.module] if node.module else [])])
            dotted = [f"{base}.{alias.name}" for alias in node.names]
        else:
            continue
        for full in dotted:
            first, _, rest = full.partition(".")
            if first == "polishopt":
                own.add(known(rest))
            else:
                outside.add(first)
    return own, outside


def place(name):
    return "files" if name.split(".")[0] == "files" else name


@pytest.mark.parametrize("name", MODULES)
def test_imports_point_down(name):
    assert place(name) in ORDER, f"{name} has no place: give it one in ORDER"
    rank = ORDER.index(place(name))
    for other in imported(name)[0]:
        assert other, f"{name} imports the package itself"
        same = place(other) == place(name) == "files"
        assert same or ORDER.index(place(other)) < rank, f"{name} imports {other}"


@pytest.mark.parametrize("name", MODULES)
def test_outside_packages_stay_on_their_floor(name):
    _, outside = imported(name)
    if name not in TOP:
        assert "matplotlib" not in outside
    if place(name) != "files":
        assert not outside & {"ruamel", "pydantic", "xarray"}


@pytest.mark.parametrize("name", [n for n in MODULES if place(n) == "files"])
def test_files_know_no_jax(name):
    """Neither directly nor by way of a module of the process model."""
    if name in WITH_JAX:
        return
    own, outside = imported(name)
    assert not outside & {"jax", "jaxlib", "equinox", "jaxtyping", "optimistix"}
    assert all(place(other) == "files" or other == "units" for other in own), own
    assert not own & WITH_JAX


def calls(tree):
    return [ast.unparse(n.func) for n in ast.walk(tree) if isinstance(n, ast.Call)]


@pytest.mark.parametrize("name", MODULES)
def test_only_the_top_floor_prints(name):
    assert name in TOP or "print" not in calls(tree_of(name))


@pytest.mark.parametrize("name", MODULES)
def test_global_settings_are_left_alone(name):
    """How JAX behaves is the caller's choice: only commands of their own may choose."""
    if name in {"session", "fit", "sensitivity"}:
        return
    assert not [call for call in calls(tree_of(name)) if call.endswith("config.update")]


def test_the_package_imports_nothing_eagerly():
    """What stands under TYPE_CHECKING, or in a function, is not run on import."""
    body = []
    for node in tree_of("").body:
        checking = isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
        if not checking and not isinstance(node, ast.FunctionDef):
            body.append(node)
    own, outside = imported("", ast.Module(body, type_ignores=[]))
    assert not own
    assert outside <= {"typing", "types", "importlib", "collections"}


def test_a_wrong_import_would_be_seen():
    """The reader of imports, on every way to write one."""
    text = "from .. import chain\nfrom ..chain import polish\nimport polishopt.plots\n"
    text += "from . import trochoid\nfrom .guide import Guide\nimport jax.numpy\n"
    own, outside = imported("path.surface", ast.parse(text))
    want = {"chain", "path.trochoid", "path.guide"}
    assert own - {"", "plots"} == want
    assert outside == {"jax"}
    assert own <= want | {known("plots")}
