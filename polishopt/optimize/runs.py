r"""Runs: what the constants of tool and abrasive make of a polishing run.

Path, feed and contact patch of a run do not depend on the constants: pressure is
$k(P_0 + \beta P_1)$ and removal $K_P k(M_0 + \beta M_1)$. So a run is followed along its
path once, and what any other constants would have made of it costs next to nothing.
"""

import dataclasses
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..chain import evolved
from ..contact.ripple import Rims, rims, waves
from ..mechanics import along
from ..parts import Process, Scalar
from ..path.surface import area_stretch
from ..setup import Setup
from ..texture.areal import Cumulants
from ..texture.evolution import Texture, combine
from ..texture.filters import gaussian_transmission
from ..texture.scratches import Population


class Run(eqx.Module):
    r"""A run with $k$ and $K_P$ taken out: coefficients of 1 and of $\beta$."""

    process: Process
    """The settings."""
    before: Population
    """Texture measured before the run, as cumulants; NaN for that of the setup."""
    pressure: Float[Array, "*n 2"]
    """Mean contact pressure over k [mm, mm^2]."""
    kept: Float[Array, "*n 2"]
    """Volume that one pass removes from the part, over k and K_P [mm^4, mm^5]."""
    total: Float[Array, "*n 2"]
    """Volume with what it would remove beside the part, over k and K_P [mm^4, mm^5]."""
    dwell: Float[Array, "*n"]
    """Time of one pass [s]."""
    rims: Rims
    """Where the rim makes the ripple."""
    passed: Float[Array, "*n bends harmonics waves"]
    """Share of each wave's amplitude that the roughness filter lets through [-]."""
    area: Float[Array, "*n"]
    """Area of the part [mm^2]."""


class Finished(eqx.Module):
    """What a run leaves."""

    removal: Float[Array, "*n"]
    """Mean depth removed [mm]."""
    Sa: Float[Array, "*n"]
    """Mean height, estimated [mm]."""
    Sq: Float[Array, "*n"]
    """Root mean square height [mm]."""
    Ssk: Float[Array, "*n"]
    """Skewness [-]."""
    Sku: Float[Array, "*n"]
    """Kurtosis [-]."""


@eqx.filter_jit
def followed(processes: Process, before: Population, setup: Setup) -> Run:
    """Runs, followed along their paths once.

    Args:
        processes: The settings of each run, stacked.
        before: Cumulants of the texture before each run; NaN for that of the setup.
        setup: The job. Its foundation, stiffening and Preston coefficient do not matter.
    """
    bends = setup.guide.bends() if setup.lean == "guide" else setup.guide.compass()

    whole = part_area(setup)

    def coefficients(process: Process, stiffening: Scalar):
        one = jnp.ones_like(stiffening)
        tool = dataclasses.replace(setup.tool, foundation=one, stiffening=stiffening)
        abrasive = dataclasses.replace(setup.abrasive, preston=one)
        path = along(process, dataclasses.replace(setup, tool=tool, abrasive=abrasive))
        dwell = jnp.sum(path.dwell)
        share = path.dwell / dwell
        area = jnp.sum(share * path.area)
        force = jnp.sum(share * path.force)
        pressure = jnp.where(area > 0, force / jnp.where(area > 0, area, 1.0), 0.0)
        weight = path.weight / jnp.sum(path.weight)
        square = jnp.sum(weight * path.pace**2)
        bend = jnp.einsum("k,kab->ab", weight, path.curvature)
        scaled = (pressure, jnp.sum(path.kept), jnp.sum(path.taken))
        made = rims(process, setup.tool.radius, bends, bend, jnp.sqrt(square), setup.side)
        passed = 1 - gaussian_transmission(made.wavelengths, setup.roughness_cutoff)
        return scaled, (dwell, made, passed, whole)

    def follow(given):
        process, before = given
        plain = jnp.asarray([0.0, 1.0], dtype=process.tilt.dtype)
        scaled, same = jax.vmap(coefficients, in_axes=(None, 0))(process, plain)
        # both ends of a straight line: its value at 0, and its slope
        pressure, kept, total = (jnp.stack([y[0], y[1] - y[0]]) for y in scaled)
        dwell, made, passed, area = jax.tree.map(lambda y: y[0], same)
        return Run(process, before, pressure, kept, total, dwell, made, passed, area)

    return jax.lax.map(follow, (processes, before))


def part_area(setup: Setup) -> Scalar:
    """Area of the part [mm^2], by the pixels of its removal map."""
    grid = setup.grid
    pixels = jnp.stack(jnp.meshgrid(grid.x, grid.y), axis=-1).reshape(-1, 2)
    stretch = jax.vmap(lambda xy: area_stretch(setup.surface, xy))(pixels)
    return jnp.sum(stretch) * grid.pixel_area


def finished(runs: Run, setup: Setup) -> Finished:
    """What runs leave, with the constants of a setup.

    Agrees with `polish`, run by run.

    Args:
        runs: Runs of this job, stacked, from `followed`.
        setup: The job with any constants of tool and abrasive, and any start.
    """
    tool, abrasive = setup.tool, setup.abrasive
    bed = tool.foundation * jnp.stack([jnp.ones_like(tool.stiffening), tool.stiffening])

    def finish(run: Run) -> Finished:
        passes = run.process.passes
        pressure, kept = run.pressure @ bed, abrasive.preston * (run.kept @ bed)
        total = abrasive.preston * (run.total @ bed)
        removal = passes * kept / run.area
        inside = jnp.where(total > 0, kept / jnp.where(total > 0, total, 1.0), 0.0)
        density = setup.guide.contact_length / run.area * inside
        scale = (abrasive.ripple_gain * abrasive.preston * tool.foundation) ** 2
        second, fourth = _linear(lambda beta: _ripple(run, beta), tool.stiffening)
        left = Cumulants(
            density * scale * second, jnp.zeros_like(second), density * scale**2 * fourth
        )
        # what was measured before the run replaces what the setup says
        known = ~jnp.isnan(run.before.k2)
        measured = jax.tree.map(lambda k: jnp.where(known, k, 0.0), run.before)
        assumed = jax.tree.map(lambda k: jnp.where(known, 0.0, k), setup.start.scratches)
        start = dataclasses.replace(setup.start, scratches=(*assumed, measured))
        rest, after = evolved(setup, start, pressure, removal)
        texture: Texture = combine(rest, after.total, left)
        return Finished(removal, texture.Sa, texture.Sq, texture.Ssk, texture.Sku)

    return jax.vmap(finish)(runs)


def _ripple(run: Run, stiffening: Scalar) -> tuple[Scalar, Scalar]:
    """Moments of the ripple per density of strips, with k and K_P taken out."""
    one = jnp.ones_like(stiffening)
    volume = run.total @ jnp.stack([one, stiffening]) / run.dwell
    passes = run.process.passes
    made = waves(run.rims, one, stiffening, passes, passes * volume)
    return made.moments(one, run.passed)


def _linear(f: Callable[[Scalar], tuple[Scalar, Scalar]], x: Scalar):
    """f(x) with its first derivative, computed once however many directions are asked.

    Most constants do not touch the ripple, and there are many waves.
    """
    fixed = jax.lax.stop_gradient(x)
    values, slopes = jax.jvp(f, (fixed,), (jnp.ones_like(x),))
    return tuple(y + dy * (x - fixed) for y, dy in zip(values, slopes, strict=True))
