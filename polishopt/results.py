"""Results: the folder that a fit leaves behind, numbers first and then pictures."""

import dataclasses
import platform
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from . import plots, report, resolved
from .chain import polish
from .contact.pressure import patch
from .files import assemble
from .files.assemble import Job
from .files.config import Config, Loaded, optimum
from .files.document import write_text
from .files.results import write_json, write_maps, write_sensitivity
from .files.topography import Topography, write as write_topography
from .optimize.sensitivity import OUTCOMES, sensitivities
from .optimize.tune import Tuning, Verdict
from .parts import Process
from .setup import FINE
from .texture.evolution import draw_patch
from .texture.scratches import decay_rate, groove_depth


INNER_UNITS = {
    "Sa": "mm",
    "Sq": "mm",
    "force": "N",
    "pressure": "MPa",
    "time": "s",
    "mean_removal": "mm",
    "tilt": "rad",
    "displacement": "mm",
    "step": "mm",
    "trochoid_radius": "mm",
    "feed": "mm/s",
    "spin": "rad/s",
}
GROOVES = 4096  # most grooves in a drawn patch; the oldest have faded long before
GROOVE_PIXELS = 8  # width of a mean groove in a drawn patch


def write(
    tuning: Tuning, job: Job, loaded: Loaded, target: Path, say: Callable[[str], None]
) -> None:
    """Writes all results of a fit.

    Args:
        tuning: The answer.
        job: What was asked.
        loaded: The config it came from.
        target: The folder; exists.
        say: Called with a sentence as things get done.
    """
    numbers(tuning, job, loaded, target)
    write_text(
        target / "optimum.yaml",
        optimum(loaded, report.answers(tuning, loaded.config), target),
    )
    say("drawing the sensitivities")
    write_sensitivities(job, tuning.process, target)
    say("running the path with every loop")
    process, setup = tuning.process, job.setup
    samples = resolved.samples(process, setup)
    run = eqx.filter_jit(resolved.run)(process, setup, samples)
    heights, extent = texture_patch(tuning, job, loaded.config)
    title = f"Texture drawn by polishopt, not measured: {loaded.config.title}"
    start = loaded.config.start
    if start.file or start.milled or start.roughness:
        title += "; without what is left of the start surface"
    dy, dx = (extent / heights.shape).tolist()
    write_topography(target / "texture.x3p", Topography(heights, (dy, dx), title))
    # the search needs sums over the part; a map wants more nodes
    close = eqx.tree_at(lambda s: s.sampling, setup, FINE)
    removal = eqx.filter_jit(lambda p, s: polish(p, s).removal)(process, close)
    maps(tuning, close, loaded, run, removal, heights, extent, target)
    say("drawing the pictures")
    plots.save(plots.path(run, setup), target / "path.png")
    plots.save(plots.feed(run, process), target / "feed.png")
    plots.save(plots.contact(process, setup), target / "contact.png")
    plots.save(
        plots.removal(np.asarray(removal), np.asarray(setup.size)),
        target / "removal.png",
    )
    plots.save(plots.texture(heights, extent, tuning.outcome), target / "texture.png")


def numbers(tuning: Tuning, job: Job, loaded: Loaded, target: Path) -> None:
    """`result.json`: the answer, its certificate, and where every start ended."""
    outcome = {
        field.name: getattr(tuning.outcome, field.name)
        for field in dataclasses.fields(tuning.outcome)
        if field.name not in ("removal", "parts")
    }
    names = ("start map", "earlier scratches", "scratches", "ripple")
    parts = {
        name: {"k2_mm2": part.k2, "k3_mm3": part.k3, "k4_mm4": part.k4}
        for name, part in zip(names, tuning.outcome.parts, strict=True)
    }
    write_json(
        target / "result.json",
        {
            "verdict": Verdict(int(tuning.verdict)).name.lower(),
            "sentence": report.verdict(tuning),
            "units": "mm, N, s, rad, MPa",
            "answers": report.answers(tuning, loaded.config),
            "process": vars(tuning.process),
            "target": {k: vars(goal) for k, goal in job.target.items()},
            "outcome": outcome,
            "texture_parts": parts,
            "misses_in_tolerances": tuning.misses,
            "limit_excesses": tuning.excesses,
            "limit_multipliers": tuning.multipliers,
            "goal_multipliers": tuning.goal_multipliers,
            "bound_multipliers": tuning.bound_multipliers,
            "kkt": tuning.kkt,
            "violation": tuning.violation,
            "starts": tuning.starts,
            "ends": tuning.answers,
            "end_distances_in_tolerances": tuning.distances,
            "end_costs": tuning.costs,
            "end_statuses": tuning.statuses,
            "evaluations": tuning.evaluations,
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
    matrix = eqx.filter_jit(sensitivities)(
        process, job.setup, OUTCOMES, tuple(job.between) or ("tilt", "displacement")
    )
    write_sensitivity(target / "sensitivity.csv", matrix, INNER_UNITS)
    plots.save(
        plots.sensitivities(
            np.asarray(matrix.elasticities), matrix.outcomes, matrix.settings
        ),
        target / "sensitivity.png",
    )


def texture_patch(tuning: Tuning, job: Job, config: Config):
    """A drawn patch of the finished texture [mm], and its sides along y and x [mm].

    The grooves of this step and what is left of those of the step before, one by one, and
    the ripple as one wave. What a start map or a measured roughness leaves is not drawn.
    """
    asked, abrasive = config.texture, job.setup.abrasive
    pressure = jnp.asarray(tuning.outcome.pressure)
    removal = jnp.asarray(tuning.outcome.mean_removal)
    width = 2 * groove_depth(abrasive, pressure) * jnp.tan(abrasive.half_angle)
    side = asked.patch_mm or asked.patch_pixels * float(width) / GROOVE_PIXELS
    extent, shape = jnp.full(2, side), (asked.patch_pixels, asked.patch_pixels)
    keys = jax.random.split(jax.random.key(config.solver.seed))
    waves = tuning.outcome.parts[-1]
    draw = eqx.filter_jit(draw_patch)
    heights = draw(
        keys[0],
        abrasive,
        pressure,
        removal,
        shape,
        extent,
        GROOVES,
        amplitudes=jnp.sqrt(jnp.maximum(2 * waves.k2, 0.0))[None],
        wavelengths=tuning.process.step[None],
    )
    before = config.start.scratches
    if before is not None:
        grade = assemble.abrasive(before.abrasive)
        steady = assemble.LONG_AGO * grade.grain
        earlier = draw(
            keys[1], grade, jnp.asarray(before.pressure_MPa), steady, shape, extent, GROOVES
        )
        heights += earlier * jnp.exp(-decay_rate(abrasive, pressure) * removal)
    return np.asarray(heights), np.asarray(extent)


def maps(tuning, setup, loaded, run, removal, heights, extent, target: Path) -> None:
    """`maps.nc`: removal, contact footprint, texture patch, and the path with its feed."""
    grid, law = setup.grid, run.law
    rows, columns = np.asarray(heights).shape
    flat = jnp.zeros((2, 2), dtype=grid.x.dtype)
    nodes = patch(tuning.process, setup.tool, flat, setup.side, 16, 24)
    axes = np.asarray(run.axes)
    along = ("sample",)
    variables = {
        "x": (("x",), grid.x, "mm", "place along x"),
        "y": (("y",), grid.y, "mm", "place along y"),
        "removal": (("y", "x"), removal, "mm", "depth removed, loops averaged"),
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
        "machine_AC": (("sample", "rotary"), axes[:, 3:], "rad", "axes A, C"),
    }
    described = {"title": loaded.config.title, "config": loaded.text, **versions()}
    write_maps(target / "maps.nc", variables, described)
