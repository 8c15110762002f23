"""Resolved: one particular path with every loop, its true feed, and its removal.

The averaged process (`chain`) is what is tuned. This is what is then run: for maps, NC
programs and checks. Its removal carries the ripple, and depends on the phase at which the
trochoid starts.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .contact.pressure import patch
from .contact.removal import Grid, deposit, preston_rates
from .hold import Schedule, schedule
from .machine.exact import exact_time_law
from .machine.feed import TimeLaw, time_law
from .machine.jerk import jerk_law
from .machine.jerk_exact import exact_jerk_law
from .machine.kinematics import inverse, inverse_path, placed
from .parts import Process, Scalar
from .path.surface import area_stretch, curvature, tangent_to_parameter
from .path.toolpath import Posture, resolved
from .setup import Setup


# Samples in each loop, on average: they gather where the rotary axes turn fast.
PER_LOOP = 96
# Turn of the rotary axes that counts as much as the mean distance of samples [rad], and
# rounds of placing them anew: each finds a whip of C past the pole more closely.
TURN, ROUNDS = 0.05, 6
# Node positions that `removal` holds in memory at a time.
NODES_AT_ONCE = 1 << 15


class Run(eqx.Module):
    """A path as it is run once, sample by sample."""

    posture: Posture
    """Place and axis of the tool at each sample."""
    s: Float[Array, " n"]
    """Arc length of the guide [mm]."""
    arc: Float[Array, " n"]
    """Length of the contact path so far [mm]."""
    axes: Float[Array, "n 5"]
    """X, Y, Z [mm], A, C [rad]."""
    law: TimeLaw
    """Feed, time and what limits them."""
    held: Schedule | None = None
    """The displacement along the guide; None where it is that of the process."""


def samples(process: Process, setup: Setup, per_loop: int = PER_LOOP) -> int:
    """How many samples the path needs; not for use under `jit`."""
    return int(np.ceil(float(setup.guide.length / process.step) * per_loop)) + 1


def run(
    process: Process,
    setup: Setup,
    samples: int,
    phase: Scalar | float = 0.0,
    jerk: bool = True,
) -> Run:
    """The path with every loop, and the fastest motion along it.

    Samples lie closer where the rotary axes turn: past the pole, where C may turn by half
    a turn within a hundredth of a millimetre, evenly spaced ones would hide how fast.
    Their places are held fixed when the path is differentiated. On a curved part, and on
    one that is turned by a wedge, limits are kept between the samples too.

    Args:
        process: The settings.
        setup: The job.
        samples: Number of samples, static: see `samples`.
        phase: Phase of the trochoid at the start [rad].
        jerk: Whether the axes keep their limits of jerk too, which takes twice as long
            on a plane; static. `machine.jerk.check` says whether that could be.

    Source: S0 (Pessoles & Tournier 2009), section 2.2.3.
    """
    held = schedule(process, setup)
    machine = placed(setup.machine, process)
    # on a plane no axis turns faster than the guide does, unless a wedge is under it
    even = setup.flat and not process.wedged
    uniform = jnp.arange(samples, dtype=setup.size.dtype) / (samples - 1)

    def postures(s):
        return resolved(
            setup.surface,
            setup.guide,
            process,
            setup.tool.radius,
            s,
            setup.pulling,
            setup.lean,
            phase,
            displacement=held,
        )

    def turning(posture):
        return inverse_path(posture.tip, posture.axis, machine)

    def place(s):
        at = jax.tree.map(lambda leaf: leaf[0], postures(s[None]))
        return inverse(at.tip, at.axis, machine), at.contact

    def gather(_, s):
        axes = turning(postures(s))
        turned = jnp.sum(jnp.abs(jnp.diff(axes[:, 3:], axis=0)), axis=1)
        share = jnp.diff(s) / setup.guide.length * (samples - 1) + turned / TURN
        total = jnp.pad(jnp.cumsum(share), (1, 0))
        return jnp.interp(uniform * total[-1], total, s)

    s = setup.guide.length * uniform
    if not even:
        s = jax.lax.stop_gradient(jax.lax.fori_loop(0, ROUNDS, gather, s))
    posture = postures(s)
    axes = turning(posture)
    chords = jnp.sqrt(jnp.sum(jnp.diff(posture.contact, axis=0) ** 2, axis=1))
    arc = jnp.pad(jnp.cumsum(chords), (1, 0))
    if even:
        found = jerk_law if jerk else time_law
        law = found(axes, machine, arc, process.feed, s)
    else:
        found = exact_jerk_law if jerk else exact_time_law
        law = found(place, s, machine, process.feed)
    return Run(posture, s, arc, axes, law, held)


def removal(
    path: Run,
    process: Process,
    setup: Setup,
    grid: Grid,
    rows: int = 12,
    columns: int = 24,
) -> Float[Array, "ny nx"]:
    """Depth that this path removes, ripple included, all passes [mm].

    Args:
        path: From `run`.
        process: The settings.
        setup: The job.
        grid: Pixels, no finer than the distance between the nodes of the contact patch.
        rows: Rows of the contact patch on either side of the feed.
        columns: Nodes along each row; too few of them make ripple of their own.
    """
    half = 0.5 * jnp.diff(path.law.time)
    dwell = process.passes * (jnp.pad(half, (1, 0)) + jnp.pad(half, (0, 1)))
    dwell = dwell * jax.vmap(setup.guide)(path.s).contact
    # the path's direction, by central differences of the contact points
    contact = path.posture.contact
    chord = jnp.concatenate([contact[1:], contact[-1:]])
    chord = chord - jnp.concatenate([contact[:1], contact[:-1]])
    length = jnp.sqrt(jnp.sum(chord**2, axis=1))
    moves = length > 0
    direction = chord / jnp.where(moves, length, 1.0)[:, None]
    velocity = jnp.where(moves, path.law.feed, 0.0)[:, None] * direction
    surface, tool, side = setup.surface, setup.tool, setup.side

    def footing(bend, displacement):
        pressed = dataclasses.replace(process, displacement=displacement)
        return patch(pressed, tool, bend, side, rows, columns, setup.panels)

    displacement = jnp.broadcast_to(process.displacement, path.s.shape)
    if path.held is not None:
        displacement = jax.vmap(path.held)(path.s)
    level = None
    if setup.flat:
        level = footing(jnp.zeros((2, 2), dtype=dwell.dtype), process.displacement)

    def touch(xy, f, b, velocity, displacement, dwell):
        bend = curvature(surface, xy, f, b)
        nodes = footing(bend, displacement) if level is None else level
        slide = jnp.stack([jnp.sum(velocity * f), jnp.sum(velocity * b)])
        rates = preston_rates(
            nodes, setup.abrasive.preston, process.tilt, process.spin, slide, side
        )
        frame = tangent_to_parameter(surface, xy, f, b)
        xi, eta = nodes.offsets[..., 0], nodes.offsets[..., 1]
        x, y = (xy[i] + frame[i, 0] * xi + frame[i, 1] * eta for i in (0, 1))
        return jnp.stack([x.reshape(-1), y.reshape(-1)], axis=-1), dwell * rates.reshape(-1)

    def add(total, samples):
        points, volumes = jax.vmap(touch)(*samples)
        return total + deposit(points.reshape(-1, 2), volumes.reshape(-1), grid), None

    posture = path.posture
    given = (posture.xy, posture.feed_direction, posture.side, velocity)
    given = (*given, displacement, dwell)
    count = max(1, NODES_AT_ONCE // (2 * rows * columns))
    tail = -dwell.shape[0] % count

    def blocks(x):
        # the tail repeats the last sample
        end = jnp.broadcast_to(x[-1:], (tail, *x.shape[1:]))
        return jnp.concatenate([x, end]).reshape(-1, count, *x.shape[1:])

    # without dwelling there
    given = (*map(blocks, given[:-1]), jnp.pad(dwell, (0, tail)).reshape(-1, count))
    depth, _ = jax.lax.scan(add, jnp.zeros(grid.shape, dwell.dtype), given)
    pixels = jnp.stack(jnp.meshgrid(grid.x, grid.y), axis=-1).reshape(-1, 2)
    stretch = jax.vmap(lambda at: area_stretch(surface, at))(pixels)
    return depth / stretch.reshape(grid.shape)
