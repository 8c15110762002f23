"""Resolved: one particular path with every loop, its true feed, and its removal.

The averaged process (`chain`) is what is tuned. This is what is then run: for maps, NC
programs and checks. Its removal carries the ripple, and depends on the phase at which the
trochoid starts.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .contact.pressure import patch
from .contact.removal import Footprint, Grid, deposit, preston_rates, superpose
from .machine.feed import TimeLaw, time_law
from .machine.kinematics import inverse_path
from .parts import Process, Scalar
from .path.surface import area_stretch, curvature, tangent_to_parameter
from .path.toolpath import Posture, resolved
from .setup import Setup


# Samples in each loop: with 64, no axis exceeds a limit between samples by over 0.1 %.
PER_LOOP = 64


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


def samples(process: Process, setup: Setup, per_loop: int = PER_LOOP) -> int:
    """How many samples the path needs; not for use under `jit`."""
    return int(np.ceil(float(setup.guide.length / process.step) * per_loop)) + 1


def run(process: Process, setup: Setup, samples: int, phase: Scalar | float = 0.0) -> Run:
    """The path with every loop, and the fastest motion along it.

    Args:
        process: The settings.
        setup: The job.
        samples: Number of samples, static: see `samples`.
        phase: Phase of the trochoid at the start [rad].

    Source: S0 (Pessoles & Tournier 2009), section 2.2.3.
    """
    posture, s = resolved(
        setup.surface,
        setup.guide,
        process,
        setup.tool.radius,
        samples,
        setup.pulling,
        setup.lean,
        phase,
    )
    axes = inverse_path(posture.tip, posture.axis, setup.machine)
    chords = jnp.sqrt(jnp.sum(jnp.diff(posture.contact, axis=0) ** 2, axis=1))
    arc = jnp.pad(jnp.cumsum(chords), (1, 0))
    law = time_law(axes, setup.machine, arc, process.feed, s)
    return Run(posture, s, arc, axes, law)


def removal(
    path: Run, process: Process, setup: Setup, grid: Grid, rows: int = 8, columns: int = 6
) -> Float[Array, "ny nx"]:
    """Depth that this path removes, ripple included, all passes [mm].

    On a plane one footprint serves the whole path (the few percent that the feed adds to
    the speed are averaged over its direction); elsewhere every sample has its own.

    Args:
        path: From `run`.
        process: The settings.
        setup: The job.
        grid: Pixels, no finer than the distance between the nodes of the contact patch.
        rows: Rows of the contact patch on either side of the feed.
        columns: Nodes along each row.
    """
    half = 0.5 * jnp.diff(path.law.time)
    dwell = process.passes * (jnp.pad(half, (1, 0)) + jnp.pad(half, (0, 1)))
    xy, f, b = path.posture.xy, path.posture.feed_direction, path.posture.side
    frames = jax.vmap(lambda *at: tangent_to_parameter(setup.surface, *at))(xy, f, b)
    side, panels = setup.side, setup.panels

    def footing(bend):
        nodes = patch(process, setup.tool, bend, side, rows, columns, panels)
        still = jnp.zeros_like(bend[0])
        rates = preston_rates(
            nodes, setup.abrasive.preston, process.tilt, process.spin, still, side
        )
        return nodes.offsets.reshape(-1, 2), rates.reshape(-1)

    if setup.flat:
        footprint = Footprint(*footing(jnp.zeros_like(frames[0])))
        depth = superpose(footprint, xy, dwell, grid, frames)
    else:

        def add(total, sample):
            xy, f, b, frame, dwell = sample
            offsets, rates = jax.vmap(lambda *at: footing(curvature(setup.surface, *at)))(
                xy, f, b
            )
            moved = jnp.einsum("nij,nmj->nmi", frame, offsets) + xy[:, None, :]
            volumes = (dwell[:, None] * rates).reshape(-1)
            return total + deposit(moved.reshape(-1, 2), volumes, grid), None

        count = 256
        pad = -xy.shape[0] % count

        def blocks(x):
            # the tail repeats the last sample, without dwelling there
            tail = jnp.broadcast_to(x[-1:], (pad, *x.shape[1:]))
            return jnp.concatenate([x, tail]).reshape(-1, count, *x.shape[1:])

        padded = jnp.pad(dwell, (0, pad)).reshape(-1, count)
        given = (blocks(xy), blocks(f), blocks(b), blocks(frames), padded)
        depth, _ = jax.lax.scan(add, jnp.zeros(grid.shape, xy.dtype), given)
    pixels = jnp.stack(jnp.meshgrid(grid.x, grid.y), axis=-1).reshape(-1, 2)
    stretch = jax.vmap(lambda at: area_stretch(setup.surface, at))(pixels)
    return depth / stretch.reshape(grid.shape)
