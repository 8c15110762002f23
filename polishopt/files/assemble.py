"""Assemble: a checked config as the pytrees of the process model.

The one place where both sides meet: everything in `files` before it knows no JAX, and
nothing behind it knows a file.
"""

import dataclasses
import re
from collections.abc import Sequence
from statistics import NormalDist
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .. import setup as jobs
from ..constants import roughness_cumulants
from ..optimize.calibrate import Data
from ..optimize.goals import Goal, Limits, PlanLimits, mapped
from ..optimize.runs import followed
from ..parts import Abrasive, Machine, Process, Scalar, Tool, as_scalar
from ..path.asphere import Asphere
from ..path.even import even
from ..path.families import (
    hatch,
    hilbert,
    hilbert_rectangle,
    lines,
    peano,
    round_spiral,
    spiral,
)
from ..path.guide import Guide
from ..path.nurbs import fit_nurbs, nurbs
from ..path.revolution import peano_revolution
from ..path.soundness import check_surface
from ..path.surface import HyperbolicParaboloid, Plane, SphereCap
from ..plan import Plan
from ..stored import seldom, stored
from ..texture.marks import milled_marks
from ..texture.milling import MilledSurface, milled_map
from ..texture.scratches import Population, groove_population
from ..units import suffix, to_internal
from .asked import Chance
from .measured import start_map
from .measurements import Measurements
from .point_grid import read_points
from .quantity import Tuned, internal
from .schema import StepConfig, erring
from .shop import Machine as MachineSection
from .step_face import read_face


# Settings whose key in a config is not their name in `Process` and a unit.
NAMES = {"spindle": "spin"}
# An earlier grade has polished for so long that its scratches are steady: removal in
# units of its grains' diameter, far beyond the depth over which a scratch fades.
LONG_AGO = 100.0
# The margin of the worst place, where it is not given, in shorter sides of the part.
MARGIN = 0.1
# Cells of the guide that are shorter than this stand for others too, in radii of the disc;
# but so many are looked at in any case, that those chosen are a fair sample.
SMALL, ENOUGH = 1 / 3, 256
# Points along y and x of a milled map: of one period of the cusps, or of five passes
# tooth by tooth.
SCALLOP_PIXELS = (64, 64)
TOOTH_PIXELS = (100, 40)


class Job(eqx.Module):
    """A config, ready for `polish` and `tune`."""

    setup: jobs.Setup
    """What is given."""
    process: Process
    """The process at the start of the search."""
    between: dict[str, tuple[float, float]] = eqx.field(static=True)
    """Bounds of what is tuned, by its name in `Process` [mm, s, rad]."""
    target: dict[str, Goal]
    """What to reach [mm or -]."""
    limits: Limits
    """What to keep."""

    @property
    def errors(self) -> dict[str, Scalar]:
        """Standard errors of constants by their names [mm, N, s, rad]; independent."""
        return self.setup.errors


class PlanJob(eqx.Module):
    """A config with several steps, ready for `follow` and `tune`.

    Settings and goals carry the name of their step: `P600 tilt`.
    """

    plan: Plan
    """What is given."""
    processes: tuple[Process, ...]
    """The processes at the start of the search."""
    between: dict[str, tuple[float, float]] = eqx.field(static=True)
    """Bounds of what is tuned [mm, s, rad]."""
    target: dict[str, Goal]
    """What to reach [mm or -]."""
    limits: PlanLimits
    """What to keep."""

    @property
    def errors(self) -> tuple[dict[str, Scalar], ...]:
        """Standard errors of the constants of each step [mm, N, s, rad]."""
        return tuple(one.errors for one in self.plan.setups)


def job(config: StepConfig, first: bool = True) -> Job:
    """The job that a config describes.

    Args:
        config: A checked config.
        first: Whether it finds the start surface; a later step of a plan does not.
    """
    size = jnp.asarray(config.part.size_mm, dtype=float)
    asked = {k: v for k, v in internal(config.process).items() if v is not None}
    settings = {NAMES.get(k, k): v for k, v in asked.items()}
    begin = {k: v.start if isinstance(v, Tuned) else v for k, v in settings.items()}
    if config.part.surface == "plane" and any(config.machine.placement.wedge_deg):
        # a plane that stands aslant may meet the pole, whoever turned it
        begin.setdefault("wedge_x", 0.0)
    between = {k: v.between for k, v in settings.items() if isinstance(v, Tuned)}
    aims = internal(config.target) if config.target is not None else {}
    goals = {k: v for k, v in aims.items() if v is not None}
    margin = internal(config.texture)["margin"]
    target = {k: Goal(v.value, v.tolerance, v.at == "worst") for k, v in goals.items()}
    made_surface = surface(config, size)
    made_guide, made_tool = guide(config, made_surface), tool(config)
    made = jobs.Setup(
        surface=made_surface,
        size=size,
        guide=made_guide,
        tool=made_tool,
        abrasive=abrasive(config.abrasive),
        machine=machine(config.machine),
        start=start(config) if first else jobs.Start(),
        roughness_cutoff=internal(config.texture)["l_filter"],
        margin=MARGIN * min(config.part.size_mm) if margin is None else margin,
        pulling=config.guide.mode == "pulling",
        lean=config.guide.lean,
        hold=config.guide.hold,
        concave=not (
            config.part.surface == "plane"
            or (config.part.surface == "sphere_cap" and config.part.radius_mm > 0)
        ),
        sampling=sampling(config, made_guide, made_tool),
        errors=errors(config, first),
    )
    return Job(
        setup=mapped(made, target),
        process=Process(**begin),
        between=between,
        target=target,
        limits=limits(config),
    )


def plan_job(steps: Sequence[tuple[str, StepConfig]]) -> PlanJob:
    """The plan that the steps of a config describe.

    Args:
        steps: Name and checked config of each.
    """
    made = [(name, job(config, first=i == 0)) for i, (name, config) in enumerate(steps)]
    target = {f"{name} {k}": v for name, one in made for k, v in one.target.items()}
    plan = Plan(tuple(name for name, _ in made), tuple(one.setup for _, one in made))
    return PlanJob(
        plan=mapped(plan, target),
        processes=tuple(one.process for _, one in made),
        between={f"{name} {k}": v for name, one in made for k, v in one.between.items()},
        target=target,
        limits=PlanLimits(tuple(one.limits for _, one in made)),
    )


def surface(config: StepConfig, size):
    """The part's surface.

    Raises:
        ValueError: if it is none that can be polished.
    """
    given = internal(config.part)
    kind = given.pop("surface")
    given["size"] = size
    kinds = {
        "plane": Plane,
        "sphere_cap": SphereCap,
        "hyperbolic_paraboloid": HyperbolicParaboloid,
    }
    if kind in kinds:
        made = kinds[kind](**given)
    elif kind == "asphere":
        made = Asphere(size, given["radius"], given["conic"], given["even_terms"])
        check_surface(made, config.part.size_mm)
    else:
        sides = config.part.size_mm
        free = {"nurbs": cad_surface, "point_grid": fitted, "step": step_surface}
        made = free[kind](given, sides)
        check_surface(made, sides)
    if config.guide.even and kind != "plane":
        return even(made, size)
    return made


def cad_surface(given: dict[str, Any], sides: tuple[float, float]):
    """A NURBS surface from its keys; even knots where none are given."""
    net = np.asarray(given["net"])
    knots = []
    for i, name in enumerate(("u_knots", "v_knots")):
        degree = given["degrees"][i]
        inner = np.linspace(0.0, 1.0, net.shape[i] - degree + 1)
        plain = np.concatenate([np.zeros(degree), inner, np.ones(degree)])
        knots.append(plain if given[name] is None else np.asarray(given[name], dtype=float))
    weights = None if given["weights"] is None else np.asarray(given["weights"])
    return nurbs(net, (knots[0], knots[1]), given["degrees"], sides, weights)


def fitted(given: dict[str, Any], sides: tuple[float, float]):
    """A surface fitted to the points of a file."""
    points = np.asarray(read_points(given["file"], given["columns"]))
    return fit_nurbs(points, given["control_points"], given["degrees"], sides)


def step_surface(given: dict[str, Any], sides: tuple[float, float]):
    """A face of a STEP file."""
    face = read_face(given["file"], given["face"])
    net, u_knots, v_knots = map(np.asarray, (face.net, *face.knots))
    return nurbs(net, (u_knots, v_knots), face.degrees, sides, np.asarray(face.weights))


def guide(config: StepConfig, surface) -> Guide:
    """The guide curve.

    Args:
        config: A checked config.
        surface: The part's surface.

    Raises:
        ValueError: if the part or the fillet leaves no room for it.
    """
    asked, size = config.guide, config.part.size_mm
    rounded = (asked.corner, 0.5 if asked.corner == "sharp" else asked.fillet)
    match asked.family:
        case "hilbert":
            return hilbert(asked.order, size, *rounded)
        case "hilbert_rectangle":
            return hilbert_rectangle(asked.count, size, *rounded)
        case "peano":
            return peano(asked.order, size, *rounded)
        case "peano_round":
            sides, outer = jnp.asarray(size, dtype=float), min(size) / 2
            length, closed = internal(asked)["segment"], asked.closed
            return peano_revolution(
                surface, sides, length, outer, 0.0, None, closed, *rounded
            )
        case "hatch":
            angle = internal(asked)["angle"]
            return hatch(asked.count, size, asked.repeats, angle, *rounded)
        case "spiral":
            if asked.shape == "round":
                return round_spiral(asked.turns, size)
            return spiral(asked.turns, size, *rounded)
    return lines(asked.count, size, *rounded, asked.one_way)


def geometry(config: StepConfig) -> str:
    """What is wrong with the part or the guide that only shows when they are made, or ''.

    Args:
        config: A checked config.
    """
    try:
        made = surface(config, jnp.asarray(config.part.size_mm, dtype=float))
        guide(config, made)
    except ValueError as error:
        return str(error)
    return ""


def tool(config: StepConfig) -> Tool:
    """The disc; one without an unstick table gets one that never holds it back."""
    given = internal(config.tool)
    table = given["unstick"] and internal(given["unstick"])
    shear = given["shear_strength"]
    return Tool(
        radius=given["diameter"] / 2,
        foundation=given["foundation"],
        body_radius=given["body_radius"],
        body_recess=given["body_recess"],
        unstick_tilts=table["tilt"] if table else [0.0],
        unstick_forces=table["force"] if table else [jnp.inf],
        friction=given["friction"],
        shear_strength=jnp.inf if shear is None else shear,
        stiffening=given["stiffening"],
    )


def abrasive(section) -> Abrasive:
    """The abrasive of a config section."""
    given = internal(section)
    del given["preset"]
    if given["asperity_stiffness"] is None:
        del given["asperity_stiffness"]
    return Abrasive(**given)


def machine(asked: MachineSection) -> Machine:
    """The machine of a config section."""
    names = asked.names()
    axes = [internal(getattr(asked.axes, name)) for name in names]
    placed = internal(asked.placement)
    free = (-jnp.inf, jnp.inf)
    travel = [axis["travel"] or free for axis in axes]
    # the rotary axis next to the tool leans it: of both ways, the one with more room
    leaning = [name for name in asked.chain.split() if name in ("A", "B", "C")][1]
    low, high = travel[names.index(leaning)]
    return Machine(
        max_speed=[axis["speed"] for axis in axes],
        max_acceleration=[axis["acceleration"] for axis in axes],
        max_jerk=[axis["jerk"] for axis in axes],
        chain=asked.chain,
        directions=tuple(asked.direction(name) for name in names),
        pivots=[axis["at"] for axis in axes[3:]],
        lower=[low for low, _ in travel],
        upper=[high for _, high in travel],
        offset=placed["offset"],
        wedge=[angle or None for angle in placed["wedge"]],
        branch=int(-low > high),
    )


def start(config: StepConfig) -> jobs.Start:
    """The texture before the step."""
    asked = config.start
    if asked.file is not None:
        measured = start_map(asked.file, config.sampling.start_points)
        heights = jnp.asarray(measured.heights, dtype=float)
        return jobs.Start(heights=heights, spacing=measured.spacing)
    scratches: tuple[Population, ...] = ()
    if asked.scratches is not None:
        grade = abrasive(asked.scratches.abrasive)
        pressure = as_scalar(internal(asked.scratches)["pressure"])
        scratches = (steady_scratches(grade, pressure),)
    elif asked.roughness is not None:
        rough = internal(asked.roughness)
        known = (as_scalar(rough[name]) for name in ("Sq", "Ssk", "Sku"))
        scratches = (roughness_cumulants(*known),)
    if asked.milled is None:
        return jobs.Start(scratches=scratches)
    given = internal(asked.milled)
    by_tooth = given.pop("marks") == "per_tooth"
    milled = MilledSurface(**given)
    if by_tooth:
        heights, spacing = milled_marks(milled, TOOTH_PIXELS)
    else:
        heights, spacing = stored(milled_map)(milled, SCALLOP_PIXELS)
    return jobs.Start(scratches=scratches, heights=heights, spacing=spacing)


@seldom  # one compilation, not one for each of its operations
def steady_scratches(grade: Abrasive, pressure: Scalar) -> Population:
    """What a grade that has polished for long leaves."""
    return groove_population(grade, pressure, LONG_AGO * grade.grain)


def limits(config: StepConfig) -> Limits:
    """The limits; the tool's own hold only where the tool knows them."""
    given = internal(config.limits)
    numbers = ("time", "force", "least_removal", "most_removal", "spread")
    held: dict[str, Any] = {
        k: None if given[k] is None else as_scalar(given[k]) for k in numbers
    }
    wanted = config.limits.unstick
    if isinstance(wanted, Chance):
        chance = to_internal(wanted.probability_percent, "percent")
        held["unstick_quantile"] = as_scalar(-NormalDist().inv_cdf(chance))
    return Limits(
        **held,
        clears=config.limits.removal_over_Sz,
        unstick=wanted is not False and config.tool.unstick is not None,
        shear=wanted is not False and config.tool.shear_strength_MPa is not None,
        rigid_body=config.limits.rigid_body,
    )


def errors(config: StepConfig, first: bool = True) -> dict[str, Scalar]:
    """Standard errors by the names of constants; a key that a step lacks has none.

    Args:
        config: A checked config.
        first: Whether it finds the start surface.
    """
    found = {}
    for key, error in config.errors.items():
        start = key.startswith("start.")
        if not erring(config, key) and (first or not start):
            name, scale = constant_of(key)
            found[name] = as_scalar(error * scale)
    return found


def constant_of(key: str) -> tuple[str, float]:
    """The name of a constant, and the factor to its unit, from its key in a config.

    `tool.unstick.force_N[0]` is `tool.unstick_forces[0]`.

    Args:
        key: With its sections.
    """
    if key == "tool.diameter_mm":
        return "tool.radius", 0.5
    stem, bracket, place = key.partition("[")
    unit = suffix(stem)
    name = stem.removesuffix(f"_{unit}") if unit else stem
    name = re.sub(r"^tool\.unstick\.(\w+)$", r"tool.unstick_\1s", name)
    return name + bracket + place, to_internal(1.0, unit)


def sampling(config: StepConfig, curve: Guide, disc: Tool) -> jobs.Sampling:
    """How finely averages are taken.

    Args:
        config: A checked config.
        curve: The guide.
        disc: The tool.
    """
    asked = config.sampling
    alike = round(SMALL * float(disc.radius / curve.pitch))
    most = (curve.panels.size - 1) // ENOUGH
    one_in = asked.one_cell_in or max(1, min(alike, most))
    return jobs.Sampling(
        stations=asked.stations_per_cell,
        one_cell_in=one_in,
        phases=asked.phases,
        rows=asked.rows,
        columns=asked.columns,
        pixels=(asked.grid, asked.grid),
        planarisation=asked.planarisation,
    )


def data(given: Measurements, made: Job) -> Data:
    """Measurements as the arrays that `calibrate` takes; every run is followed here.

    Args:
        given: Measurements at settings of this job.
        made: The job, for what a row does not say.
    """

    def column(rows, name: str):
        cells = [row.get(name) for row in rows]
        return jnp.asarray([jnp.nan if cell is None else cell for cell in cells], float)

    def settings(row) -> Process:
        typed = {NAMES.get(name, name): value for name, value in row.items()}
        usual = {f.name: getattr(made.process, f.name) for f in dataclasses.fields(Process)}
        mine = {k: usual[k] if typed.get(k) is None else typed[k] for k in usual}
        return Process(**mine)

    forces, runs = given.forces, given.runs
    followed_runs = None
    if runs:
        processes = jax.tree.map(lambda *x: jnp.stack(x), *map(settings, runs))
        known = [column(runs, f"start_{name}") for name in ("Sq", "Ssk", "Sku")]
        before = jax.vmap(roughness_cumulants)(*known)
        followed_runs = followed(processes, before, made.setup)
    tables = {"force": forces} | dict.fromkeys(("removal", "Sa", "Sq", "Ssk", "Sku"), runs)
    held = {name: rows for name, rows in tables.items() if any(name in r for r in rows)}
    measured = {name: column(rows, name) for name, rows in held.items()}
    errors = {name: column(rows, f"{name}_error") for name, rows in held.items()}
    return Data(
        tilt=column(forces, "tilt"),
        displacement=column(forces, "displacement"),
        runs=followed_runs,
        measured={k: v for k, v in measured.items() if jnp.isfinite(v).any()},
        errors={k: v for k, v in errors.items() if jnp.isfinite(v).any()},
    )
