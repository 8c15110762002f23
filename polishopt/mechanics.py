r"""Mechanics: what a step does to the part, whatever its texture was before.

The optimiser sees the process averaged over the phase at which each loop of the trochoid
happens to start. At the end of a path ten metres long that phase turns with every micron
of the step, so the map of one particular path is noise to a derivative, while its
average is smooth. What the average leaves out is the ripple, whose strength is known in
closed form. Along the guide, each station carries one loop of the trochoid: its feed is
the fastest the axes allow for that loop run again and again.
"""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .batched import in_batches
from .contact.flat import effective_diameter, envelope, flat_load, flat_patch
from .contact.limits import body_clearance, shear_margin, unstick_force
from .contact.pressure import force_and_area, patch
from .contact.removal import deposit, fraction_inside, preston_rates
from .contact.ripple import Ripple, ripple
from .hold import held_displacement, loop_bend
from .machine.feed import Limits
from .machine.kinematics import placed, rotary
from .machine.loop import axis_slopes, loop_rate, pole_pace
from .margin import margin_deviations
from .parts import Process, Scalar
from .path.surface import area_stretch, curvature, tangent_to_parameter
from .path.toolpath import posture
from .setup import Setup
from .texture.filters import gaussian_transmission
from .texture.scratches import STEEPNESS, Population


# Stations are worked off a few at a time: a batch that stays in the processor's cache is
# several times faster than all of them at once, most of all when differentiated.
STATIONS_AT_ONCE = 16
# With more stations than this, a gradient computes them twice rather than keep them: what
# it would keep no longer fits the cache either (a gradient of order 5 costs 4.9 instead of
# 6.7 forward runs, one of order 3 would cost more than it does).
MOST_KEPT = 1000


class Mechanics(eqx.Module):
    """What one polishing step does to the part."""

    force: Scalar
    """Force normal to the part, averaged over time [N]."""
    force_max: Scalar
    """Its largest value along the path [N]."""
    force_min: Scalar
    """Its smallest value along the path, where the tool is not lifted [N]."""
    displacement_max: Scalar
    """Largest displacement along the path [mm]."""
    pressure: Scalar
    """Mean pressure in the contact [MPa]."""
    contact_area: Scalar
    """Area in contact, averaged over time [mm^2]."""
    effective_diameter: Scalar
    """Width that the disc wipes on a flat, D_eff [mm]."""
    envelope: Scalar
    """Width of the strip polished by one trochoid, E [mm]."""
    time: Scalar
    """Duration of all passes [s]."""
    feed: Scalar
    """Speed of the contact point that is reached on average over the path [mm/s]."""
    path_length: Scalar
    """Length of the contact path, all passes [mm]."""
    mean_removal: Scalar
    """Depth removed, averaged over the part [mm]."""
    removal: Float[Array, "ny nx"]
    """Depth removed, averaged over the loops' phase, `[y, x]` [mm]."""
    spread: Scalar
    """Standard deviation of `removal` over the part, over its mean [-]."""
    ripple: Scalar
    """Rms of the removal's ripple along the guide, over the mean removal [-]."""
    body_clearance: Scalar
    """Displacement left before the rigid body touches [mm]."""
    unstick_margin: Scalar
    """Force left before the disc comes unstuck [N]."""
    unstick_deviation: Scalar
    """Standard deviation of that force, by the errors of the tool's constants [N]."""
    shear_margin: Scalar
    """Shear stress left before the adhesive fails [MPa]."""
    shear_deviation: Scalar
    """Standard deviation of that stress [MPa]."""
    load: Float[Array, "ny nx"]
    """Mean pressure of the contacts that removed it, 0 where nothing did [MPa]."""
    waves: Population
    """Cumulants of the ripple that the roughness filter lets through [mm^2, mm^3, mm^4],
    and the half-width of grooves that a pad would follow as well as its waves [mm]."""


class Stations(eqx.Module):
    """The process at stations along the guide (k), each with a whole loop there."""

    weight: Float[Array, "*k"]
    """Length of guide, run in contact, that a station stands for [mm]."""
    pace: Float[Array, "*k"]
    """Time per length of guide, rms over the loop [s/mm]."""
    dwell: Float[Array, "*k"]
    """Time that a station stands for, one pass [s]."""
    length: Float[Array, "*k"]
    """Contact path that it stands for, one pass [mm]."""
    idle: Float[Array, "*k"]
    """Time on the way with the tool lifted, which no dwell counts, one pass [s]."""
    curvature: Float[Array, "*k 2 2"]
    """Normal curvature of the part along (feed, left), averaged over the loop [1/mm]."""
    displacement: Float[Array, "*k"]
    """Displacement of the disc [mm]."""
    force: Float[Array, "*k"]
    """Force normal to the part [N]."""
    area: Float[Array, "*k"]
    """Area in contact [mm^2]."""
    taken: Float[Array, "*k"]
    """Volume that a station's loop would remove if the part had no edges, one pass
    [mm^3]."""
    kept: Float[Array, "*k"]
    """What of it is removed from the part [mm^3]."""
    points: Float[Array, "*k n 2"]
    """Where each node of its contact patches removes, in the parameter plane [mm]."""
    volumes: Float[Array, "*k n"]
    """How much it removes there, one pass [mm^3]."""


def along(process: Process, setup: Setup) -> Stations:
    r"""Posture, true feed, contact and removal at all stations and phases.

    The axes move with the derivative $\partial_s + (2\pi/p)\,\partial_\varphi$ along the
    path, and the feed follows from it loop by loop.

    Args:
        process: The settings.
        setup: The job.
    """
    one_in = setup.sampling.one_cell_in
    s, weight = setup.guide.stations(setup.sampling.stations, one_in)
    count, side = setup.sampling.phases, setup.side
    phases = jnp.asarray(2 * np.pi * np.arange(count) / count, dtype=s.dtype)
    machine = placed(setup.machine, process)
    limits = Limits.of(machine)
    if "feed" in setup.idealised:
        limits = jax.tree.map(lambda limit: jnp.full_like(limit, jnp.inf), limits)
    spacing = process.step / count
    surface, grid = setup.surface, setup.grid

    tool, per_patch = setup.tool, (setup.sampling.rows, setup.sampling.columns)

    # one contact patch serves all phases of a loop, and on a plane all stations; its force
    # and area are found apart: the area of its nodes has a corner wherever a row of them
    # comes to reach across the disc
    level, flat = None, ()
    if setup.level:
        level = flat_patch(process, tool, side, *per_patch)
        pressed = process.tilt, process.displacement
        flat = flat_load(tool.radius, tool.foundation, *pressed, tool.stiffening)
        flat = tuple(jnp.where(process.displacement > 0, one, 0.0) for one in flat)

    def place_at(process, point, phase):
        return posture(
            surface,
            point,
            phase,
            process,
            setup.tool.radius,
            setup.pulling,
            setup.lean,
        )

    def at(process, s, weight, phase):
        zero, one = jnp.zeros_like(s), jnp.ones_like(s)

        def move(t):
            point = setup.guide(s + t)
            place = place_at(process, point, phase + 2 * jnp.pi * t / process.step)
            way = place.contact
            if "stretch" in setup.idealised:
                way = jnp.pad(place.xy, (0, 1))
            angles, _ = rotary(place.axis, machine)
            return (way, place.axis, (place.tip, angles)), (place, angles, point.contact)

        def moving(t):
            _, slopes, there = jax.jvp(move, (t,), (one,), has_aux=True)
            return slopes, there

        (tangent, turning, first), (_, _, second), (place, angles, contact) = jax.jvp(
            moving, (zero,), (one,), has_aux=True
        )
        pace = one
        # else the axis keeps its distance from the pole
        if not setup.flat or process.wedged:

            def axis_at(s):
                return place_at(process, setup.guide(s), phase).axis

            _, aside = jax.jvp(axis_at, (s,), (one,))
            # a cell that stands for others does so with the pole as it is in each of them
            cell = jnp.stack([spacing * turning, weight / one_in * aside])
            pace = pole_pace(place.axis, cell, machine)
        dq, ddq = axis_slopes((place.tip, angles), first, second, pace, machine)
        return place, contact, tangent, dq, ddq

    def touch(nodes, place, tangent, speed, dwell):
        f, b = place.feed_direction, place.side
        velocity = speed * jnp.stack([jnp.sum(tangent * f), jnp.sum(tangent * b)])
        rates = preston_rates(
            nodes, setup.abrasive.preston, process.tilt, process.spin, velocity, side
        )
        frame = tangent_to_parameter(surface, place.xy, f, b)
        xi, eta = nodes.offsets[..., 0], nodes.offsets[..., 1]
        x, y = (place.xy[i] + frame[i, 0] * xi + frame[i, 1] * eta for i in (0, 1))
        points = jnp.stack([x.reshape(-1), y.reshape(-1)], axis=-1)
        return points, dwell * rates.reshape(-1)

    def bend(place):
        return curvature(surface, place.xy, place.feed_direction, place.side)

    def station(given):
        s, weight = given
        here = process
        if setup.holds:
            found = held_displacement(process, setup, loop_bend(process, setup, s))
            here = dataclasses.replace(process, displacement=found)
        place, contact, tangent, dq, ddq = jax.vmap(
            at, in_axes=(None, None, None, 0), out_axes=(0, None, 0, 0, 0)
        )(here, s, weight, phases)
        rate = jnp.sqrt(jnp.sum(tangent**2, axis=1))
        speed = loop_rate(dq, ddq, rate, spacing, process.feed, limits)
        idle = jnp.sum((1 - contact) * weight / count / speed)
        weight = contact * weight
        dwell = weight / count / speed
        mean_bend = jnp.zeros((2, 2), dtype=s.dtype)
        if not setup.flat:
            mean_bend = jnp.mean(jax.vmap(bend)(place), axis=0)
        touching = here, tool, mean_bend, side
        nodes = level or patch(*touching, *per_patch, setup.panels)
        force, area = flat or force_and_area(*touching, setup.panels)
        points, volumes = jax.vmap(touch, in_axes=(None, 0, 0, 0, 0))(
            nodes, place, tangent, speed, dwell
        )
        points, volumes = points.reshape(-1, 2), volumes.reshape(-1)
        return Stations(
            weight=weight,
            pace=jnp.sqrt(jnp.mean(1 / speed**2)),
            dwell=jnp.sum(dwell),
            length=jnp.sum(weight / count * rate),
            idle=idle,
            curvature=mean_bend,
            displacement=here.displacement,
            force=jnp.where(contact > 0, force, 0.0),
            area=area,
            taken=jnp.sum(volumes),
            kept=jnp.sum(volumes * fraction_inside(points, grid)),
            points=points,
            volumes=volumes,
        )

    if s.size > MOST_KEPT:
        station = jax.checkpoint(station)
    return in_batches(station, (s, weight), STATIONS_AT_ONCE)


def mechanics(process: Process, setup: Setup) -> Mechanics:
    """Force, time, removal and ripple of one polishing step.

    Pure and differentiable in everything physical. What is not used of the answer costs
    nothing under `jit`: the maps most of all.

    Args:
        process: Tilt, displacement, step, trochoid radius, feed, spindle speed, passes.
        setup: The job; its start texture is not read.

    Source: S0 (Pessoles & Tournier 2009).
    """
    path = along(process, setup)
    once = jnp.sum(path.dwell)
    share = path.dwell / once
    force, area = jnp.sum(share * path.force), jnp.sum(share * path.area)
    pressure = _share(force, area)
    force_max = jnp.max(path.force)
    force_min = jnp.min(jnp.where(path.weight > 0, path.force, jnp.inf))
    deepest = dataclasses.replace(process, displacement=jnp.max(path.displacement))

    grid = setup.grid
    stretch = jnp.ones(grid.shape, grid.x.dtype)
    if "stretch" not in setup.idealised:
        pixels = jnp.stack(jnp.meshgrid(grid.x, grid.y), axis=-1).reshape(-1, 2)
        stretch = jax.vmap(lambda xy: area_stretch(setup.surface, xy))(pixels)
        stretch = stretch.reshape(grid.shape)
    part_area = jnp.sum(stretch) * grid.pixel_area
    mean_removal = process.passes * jnp.sum(path.kept) / part_area
    points, volumes = path.points.reshape(-1, 2), path.volumes.reshape(-1)
    removal = process.passes * deposit(points, volumes, grid) / stretch
    variance = (
        jnp.sum(stretch * (removal - mean_removal) ** 2) * grid.pixel_area / part_area
    )
    spread = _ratio(variance, mean_removal)
    pressures = _share(path.force, path.area)
    pressed = volumes * jnp.repeat(pressures, path.volumes.shape[1])
    load = _share(process.passes * deposit(points, pressed, grid) / stretch, removal)

    waves = _ripple(process, setup, path)
    inside = _share(jnp.sum(path.kept), jnp.sum(path.taken))
    density = setup.guide.contact_length / part_area * inside
    passed = 1 - gaussian_transmission(waves.wavelengths, setup.roughness_cutoff)
    bare, _ = waves.moments(density)
    second, fourth = waves.moments(density, passed)
    seen = waves.shares[:, None, None] * waves.variances * passed**2
    wave = _share(jnp.sum(seen * waves.wavelengths), jnp.sum(seen))
    width = math.sqrt(STEEPNESS) / (2 * math.pi) * wave
    rippled = Population(second, jnp.zeros_like(second), fourth, width)

    unstick_deviation, shear_deviation = margin_deviations(
        process, setup, path.curvature, path.force, path.displacement
    )

    dwell = process.passes * once
    time = dwell + process.passes * jnp.sum(path.idle)
    length = process.passes * jnp.sum(path.length)
    return Mechanics(
        force=force,
        force_max=force_max,
        force_min=force_min,
        displacement_max=deepest.displacement,
        pressure=pressure,
        contact_area=area,
        effective_diameter=effective_diameter(
            setup.tool.radius, process.tilt, process.displacement
        ),
        envelope=envelope(setup.tool.radius, process),
        time=time,
        feed=length / dwell,
        path_length=length,
        mean_removal=mean_removal,
        removal=removal,
        spread=spread,
        ripple=_ratio(bare, mean_removal),
        body_clearance=body_clearance(deepest, setup.tool),
        unstick_margin=unstick_force(process.tilt, setup.tool) - force_max,
        unstick_deviation=unstick_deviation,
        shear_margin=shear_margin(deepest, setup.tool),
        shear_deviation=shear_deviation,
        load=load,
        waves=rippled,
    )


def _ripple(process: Process, setup: Setup, path: Stations) -> Ripple:
    """Ripple of the removal, from the mean curvature and the mean loop of the path."""
    gain = setup.abrasive.ripple_gain
    share = path.weight / jnp.sum(path.weight)
    bend = jnp.einsum("k,kab->ab", share, path.curvature)
    square = jnp.sum(share * path.pace**2)
    mean = jnp.sum(share * path.displacement)
    waves = ripple(
        dataclasses.replace(process, displacement=mean),
        setup.tool,
        process.passes * setup.abrasive.preston,
        setup.guide.bends() if setup.lean == "guide" else setup.guide.compass(),
        bend,
        jnp.sqrt(square),
        process.passes * jnp.sum(path.taken) / jnp.sum(path.dwell),
        setup.side,
    )
    return eqx.tree_at(lambda w: w.variances, waves, gain**2 * waves.variances)


def _share(part: Float[Array, "..."], whole: Float[Array, "..."]) -> Float[Array, "..."]:
    """One over the other; 0, with a gradient of 0, where that is nothing."""
    some = whole > 0
    return jnp.where(some, part / jnp.where(some, whole, 1.0), 0.0)


def _ratio(variance: Scalar, mean: Scalar) -> Scalar:
    """Standard deviation over mean; 0, with a gradient of 0, where either vanishes."""
    some = (variance > 0) & (mean > 0)
    root = jnp.sqrt(jnp.where(some, variance, 1.0)) / jnp.where(some, mean, 1.0)
    return jnp.where(some, root, 0.0)
