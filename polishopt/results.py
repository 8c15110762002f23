"""Results: the folder that a fit leaves behind, numbers first and then pictures."""

import dataclasses
import platform
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import version
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from . import feed_plot, plots, postprocess, report, resolved, shares_plot
from .chain import polish
from .contact.pressure import patch
from .files import assemble
from .files.answered import optimum
from .files.assemble import Job, PlanJob
from .files.config import Loaded
from .files.document import write_text
from .files.results import write_json, write_maps, write_sensitivity, write_shares
from .files.schema import StepConfig
from .files.topography import Topography, write as write_topography
from .optimize.basins import basins
from .optimize.sensitivity import (
    OUTCOMES,
    PLAN_OUTCOMES,
    Sensitivity,
    plan_sensitivities,
    sensitivities,
)
from .optimize.tune import Tuning
from .optimize.uncertainty import Spread, spread
from .optimize.variance import Variance, variance_shares
from .parts import Abrasive, Process, Scalar
from .setup import FINE, Setup
from .stored import seldom, stored
from .texture.evolution import draw_patch
from .texture.scratches import decay_rate, groove_depth
from .texture.uncertainty import moment_errors


INNER_UNITS = {
    "Sa": "mm",
    "Sq": "mm",
    "force": "N",
    "pressure": "MPa",
    "contact_area": "mm^2",
    "time": "s",
    "mean_removal": "mm",
    "tilt": "rad",
    "displacement": "mm",
    "step": "mm",
    "trochoid_radius": "mm",
    "feed": "mm/s",
    "spin": "rad/s",
    **{f"shift_{way}": "mm" for way in "xyz"},
    **{f"wedge_{way}": "rad" for way in "xyz"},
}
# map of texture: its unit, and what it is
TEXTURE_MAPS = {
    "Sa": ("mm", "mean height of the texture at each place, estimated"),
    "Sq": ("mm", "rms height of the texture at each place"),
    "Ssk": ("1", "skewness of the texture at each place"),
    "Sku": ("1", "kurtosis of the texture at each place"),
}
PAINTERS = 2  # pictures drawn at a time
GROOVES = 4096  # most grooves in a drawn patch; the oldest have faded long before
GROOVE_PIXELS = 8  # width of a mean groove in a drawn patch


def write(
    tuning: Tuning,
    job: Job,
    loaded: Loaded,
    target: Path,
    say: Callable[[str], None],
    spread: Spread | None = None,
) -> tuple[report.Scatter, postprocess.Programs]:
    """Writes all results of a fit.

    Args:
        tuning: The answer.
        job: What was asked.
        loaded: The config it came from.
        target: The folder; exists.
        say: Called with a sentence as things get done.
        spread: What the errors of the constants do, where any is given.

    Returns:
        How far a measured patch as large as the drawn one scatters, and what the machine
        will make of the path.
    """
    numbers(tuning, job, loaded, target, spread)
    write_text(
        target / "optimum.yaml",
        optimum(loaded, report.answers(tuning, loaded), target),
    )
    process, setup = tuning.process, job.setup
    size = np.asarray(setup.size)
    with ThreadPoolExecutor(PAINTERS) as pool:
        say("drawing the sensitivities")
        painted = [pool.submit(write_sensitivities, job, process, target)]

        def paint(name, draw, *given):
            def work():
                plots.save(draw(*given), target / name)

            painted.append(pool.submit(work))

        paint("contact.png", plots.contact, process, setup)
        say("running the path with every loop")
        run = _run(process, setup, resolved.samples(process, setup))
        paint("path.png", plots.path, run, setup)
        paint("feed.png", feed_plot.feed, run, process, setup.machine.names)
        programmed = pool.submit(postprocess.programs, run, process, setup, loaded.config)
        fine = _fine_maps(process, setup)
        paint("removal.png", plots.removal, np.asarray(fine[0]), size)
        margin = float(setup.margin)
        paint("texture_maps.png", plots.texture_maps, *fine, size, margin)
        heights, extent = texture_patch(tuning, job, loaded.config)
        paint("texture.png", plots.texture, heights, extent, tuning.outcome)
        errors, _ = stored(moment_errors)(jnp.asarray(heights))
        title = f"Texture drawn by polishopt, not measured: {loaded.config.title}"
        start = loaded.config.start
        if start.file or start.milled or start.roughness:
            title += "; without what is left of the start surface"
        dy, dx = (extent / heights.shape).tolist()
        write_topography(target / "texture.x3p", Topography(heights, (dy, dx), title))
        maps(tuning, _closely(setup), loaded, run, *fine, heights, extent, target)
        say("drawing the pictures")
        for picture in painted:
            picture.result()  # raises what it raised
        programs = programmed.result()
        postprocess.deliver([programs], target / "program")
    numbers(tuning, job, loaded, target, spread, programs)
    names = ("Sa", "Sq", "Ssk", "Sku")
    scatter = report.Scatter(
        float(extent[0]), dict(zip(names, np.asarray(errors).tolist(), strict=True))
    )
    return scatter, programs


def rehearse(job: Job) -> None:
    """Compiles, around the start, what `write` will need around the answer.

    Worth doing in the background of the search. The path with every loop is left out: how
    long it is depends on the answer.

    Args:
        job: The job.
    """
    _sensitivities(job.process, job.setup, OUTCOMES, _columns(job))
    _fine_maps(job.process, job.setup)
    spread_of(job.process, job)


def spread_of(process: Process, job: Job) -> Spread | None:
    """What the errors of the constants do to the outcomes; None where none is given."""
    return _spread(process, job.setup) if job.errors else None


_run = stored(resolved.run)
_sensitivities = seldom(sensitivities)
_spread = seldom(spread)


@seldom
def _fine_maps(process: Process, setup: Setup):
    """Maps of the removal [mm] and of the texture."""
    done = polish(process, dataclasses.replace(_closely(setup), local=True))
    return done.removal, done.maps


def _closely(setup: Setup) -> Setup:
    """The job with more nodes: the search needs sums over the part, a map wants detail."""
    fine = dataclasses.replace(FINE, one_cell_in=setup.sampling.one_cell_in)
    return eqx.tree_at(lambda s: s.sampling, setup, fine)


def _columns(job: Job) -> tuple[str, ...]:
    """The settings by which outcomes are differentiated."""
    return tuple(job.between) or ("tilt", "displacement")


def spread_numbers(spread: Spread | None) -> dict[str, Any]:
    """A spread for `result.json`; nothing where no constant has an error."""
    if spread is None:
        return {}
    by_constant = [dict(zip(spread.constants, row, strict=True)) for row in spread.shares]
    return {
        "spread_from_constants": {
            "errors": dict(zip(spread.constants, spread.errors, strict=True)),
            "deviations": report.deviations(spread),
            "shares_of_variance": dict(zip(spread.outcomes, by_constant, strict=True)),
        }
    }


def numbers(
    tuning: Tuning,
    job: Job,
    loaded: Loaded,
    target: Path,
    spread: Spread | None = None,
    programs: postprocess.Programs | None = None,
) -> None:
    """`result.json`: the answer, its certificate, and where every start ended."""
    outcome = {
        field.name: getattr(tuning.outcome, field.name)
        for field in dataclasses.fields(tuning.outcome)
        if field.name not in ("removal", "load", "waves", "parts", "left", "maps")
    }
    names = ("start map", "earlier scratches", "scratches", "ripple")
    parts = {
        name: {"k2_mm2": part.k2, "k3_mm3": part.k3, "k4_mm4": part.k4}
        for name, part in zip(names, tuning.outcome.parts, strict=True)
    }
    write_json(
        target / "result.json",
        {
            "verdict": report.ended(tuning, programs).name.lower(),
            "sentence": report.verdict(tuning, programs),
            "units": "mm, N, s, rad, MPa",
            **({"choice": loaded.chosen} if loaded.chosen else {}),
            "answers": report.answers(tuning, loaded),
            "process": {k: v for k, v in vars(tuning.process).items() if v is not None},
            "target": {k: vars(goal) for k, goal in job.target.items()},
            "outcome": outcome,
            "texture_parts": parts,
            **spread_numbers(spread),
            "misses_in_tolerances": tuning.misses,
            "limit_excesses": tuning.excesses,
            "limit_multipliers": tuning.multipliers,
            "goal_multipliers": tuning.goal_multipliers,
            "bound_multipliers": tuning.bound_multipliers,
            "preflight": [one.sentence for one in programs.findings] if programs else [],
            "kkt": tuning.kkt,
            "violation": tuning.violation,
            "starts": tuning.starts,
            "ends": tuning.answers,
            "end_distances_in_tolerances": tuning.distances,
            "end_costs": tuning.costs,
            "end_statuses": tuning.statuses,
            "evaluations": tuning.evaluations,
            "distinct_answers": [one._asdict() for one in basins(tuning, job.between)],
            "versions": versions(),
            "config": loaded.text,
        },
    )


def versions() -> dict[str, str]:
    """What computed the result."""
    packages = ("polishopt", "jax", "jaxlib", "equinox", "optimistix", "numpy")
    return {"python": platform.python_version()} | {p: version(p) for p in packages}


def write_sensitivities(job: Job, process: Process, target: Path) -> None:
    """`sensitivity.csv` and `.png` around one process.

    Args:
        job: The job; what it tunes are the columns.
        process: Around which settings.
        target: The folder; exists.
    """
    _write(_sensitivities(process, job.setup, OUTCOMES, _columns(job)), target)


def write_plan_sensitivities(job: PlanJob, target: Path) -> None:
    """The same for the finished surface of a plan, around its start.

    Args:
        job: The job; what it tunes are the columns, or else tilts and displacements.
        target: The folder; exists.
    """
    names = tuple(job.between)
    matrix = seldom(plan_sensitivities)(job.processes, job.plan, PLAN_OUTCOMES, names)
    _write(matrix, target)


def write_variance(job: Job, target: Path, samples: int) -> Variance | None:
    """`variance.csv`, `.png` and `.svg`: Sobol indices between the bounds.

    Args:
        job: The job; what it tunes is varied.
        target: The folder; exists.
        samples: A power of two.

    Returns:
        The indices; None where nothing is tuned.
    """
    if not job.between:
        return None
    found = variance_shares(job.process, job.setup, job.between, samples=samples)
    write_shares(target / "variance.csv", found, INNER_UNITS)
    _draw(shares_plot.variance_bars(found), target / "variance")
    return found


def _draw(figure, path: Path) -> None:
    for kind in (".png", ".svg"):
        plots.save(figure, path.with_suffix(kind))


def _write(matrix: Sensitivity, target: Path) -> None:
    write_sensitivity(target / "sensitivity.csv", matrix, INNER_UNITS)
    figure = plots.sensitivities(
        np.asarray(matrix.elasticities), matrix.outcomes, matrix.settings
    )
    _draw(figure, target / "sensitivity")


def texture_patch(tuning: Tuning, job: Job, config: StepConfig):
    """A drawn patch of the finished texture [mm], and its sides along y and x [mm].

    The grooves of this step and what is left of those of the step before, one by one, and
    the ripple as one wave. What a start map or a measured roughness leaves is not drawn.
    """
    asked, abrasive, outcome = config.texture, job.setup.abrasive, tuning.outcome
    width = float(_groove_width(abrasive, outcome.pressure))
    side = asked.patch_mm or asked.patch_pixels * width / GROOVE_PIXELS
    extent, shape = np.full(2, side), (asked.patch_pixels, asked.patch_pixels)
    before = config.start.scratches
    grade = None if before is None else assemble.abrasive(before.abrasive)
    pressure = 0.0 if before is None else before.pressure_MPa
    heights = _drawn(
        jax.random.key(config.solver.seed),
        abrasive,
        outcome,
        tuning.process.step,
        grade,
        jnp.asarray(pressure, dtype=extent.dtype),
        jnp.asarray(extent),
        shape,
    )
    return np.asarray(heights), extent


@seldom
def _groove_width(abrasive: Abrasive, pressure: Scalar) -> Scalar:
    return 2 * groove_depth(abrasive, pressure) * jnp.tan(abrasive.half_angle)


@stored
def _drawn(key, abrasive, outcome, wavelength, grade, grade_pressure, extent, shape):
    """Grooves of this step and of the grade before, and the ripple [mm]."""
    now, before = jax.random.split(key)
    pressure, removal = outcome.pressure, outcome.mean_removal
    heights = draw_patch(
        now,
        abrasive,
        pressure,
        removal,
        shape,
        extent,
        GROOVES,
        amplitudes=jnp.sqrt(jnp.maximum(2 * outcome.parts[-1].k2, 0.0))[None],
        wavelengths=wavelength[None],
    )
    if grade is None:
        return heights
    steady = assemble.LONG_AGO * grade.grain
    earlier = draw_patch(before, grade, grade_pressure, steady, shape, extent, GROOVES)
    return heights + earlier * jnp.exp(-decay_rate(abrasive, pressure) * removal)


def maps(
    tuning, setup, loaded, run, removal, texture, heights, extent, target: Path
) -> None:
    """`maps.nc`: removal, texture, contact, a patch of texture, the path and its feed."""
    grid, law = setup.grid, run.law
    rows, columns = np.asarray(heights).shape
    flat = jnp.zeros((2, 2), dtype=grid.x.dtype)
    nodes = seldom(patch)(tuning.process, setup.tool, flat, setup.side, 16, 24)
    axes, rotary = np.asarray(run.axes), setup.machine.names[3:]
    along = ("sample",)
    variables = {
        "x": (("x",), grid.x, "mm", "place along x"),
        "y": (("y",), grid.y, "mm", "place along y"),
        "removal": (("y", "x"), removal, "mm", "depth removed, loops averaged"),
        **{
            name: (("y", "x"), getattr(texture, name), unit, meaning)
            for name, (unit, meaning) in TEXTURE_MAPS.items()
        },
        "evaluated": (
            ("y", "x"),
            np.asarray(texture.evaluated).astype(np.int8),
            "1",
            "1 where the worst place is looked for, 0 nearer to an edge",
        ),
        "patch_x": (
            ("patch_x",),
            (np.arange(columns) + 0.5) * extent[1] / columns,
            "mm",
            "place along x in the drawn patch",
        ),
        "patch_y": (
            ("patch_y",),
            (np.arange(rows) + 0.5) * extent[0] / rows,
            "mm",
            "place along y in the drawn patch",
        ),
        "texture": (("patch_y", "patch_x"), heights, "mm", "drawn texture"),
        "contact_xi": (("row", "column"), nodes.offsets[..., 0], "mm", "along the feed"),
        "contact_eta": (("row", "column"), nodes.offsets[..., 1], "mm", "across the feed"),
        "contact_pressure": (
            ("row", "column"),
            nodes.pressure,
            "MPa",
            "on a flat part",
        ),
        "guide_length": (along, run.s, "mm", "arc length of the guide"),
        "path_length": (along, run.arc, "mm", "length of the contact path"),
        "feed": (along, law.feed, "mm/s", "speed of the contact point"),
        "time": (along, law.time, "s", "time since the start of a pass"),
        "limiting": (along, law.limiting, "1", "what limits the feed, a code"),
        "contact": (("sample", "xyz"), run.posture.contact, "mm", "contact point"),
        "tip": (("sample", "xyz"), run.posture.tip, "mm", "driven point of the tool"),
        "axis": (("sample", "xyz"), run.posture.axis, "1", "tool axis"),
        "machine_XYZ": (("sample", "xyz"), axes[:, :3], "mm", "axes X, Y, Z"),
        "machine_" + "".join(rotary): (
            ("sample", "rotary"),
            axes[:, 3:],
            "rad",
            f"axes {', '.join(rotary)}",
        ),
    }
    described = {"title": loaded.config.title, "config": loaded.text, **versions()}
    write_maps(target / "maps.nc", variables, described)
