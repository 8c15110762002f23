r"""Direction: which way the grains slide over a place of the part.

A place sees all of the contact pass, at all phases of the loop: the grain at each node of
the contact cuts along $\omega\times r + v_f$, and cuts the more the more that node
removes. As the spindle is much faster than the feed, it is the shape of the contact that
decides: a full disc cuts alike in all directions, a thin segment at the rim across the
direction in which the tool leans.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..contact.pressure import patch
from ..contact.removal import preston_rates, sliding
from ..parts import Process, Tool


def slid_directions(
    process: Process,
    tool: Tool,
    headings: Float[Array, " h"] | None = None,
    shares: Float[Array, " h"] | None = None,
    curvature: Float[Array, "2 2"] | None = None,
    lean: float = 1.0,
    bins: int = 24,
    phases: int = 16,
    rows: int = 32,
    columns: int = 24,
    panels: int = 1,
) -> Float[Array, " {bins}"]:
    r"""How much of the removal slides in each of equal intervals of direction [-].

    The mean over the contact, over the loop of a trochoid on a straight guide at constant
    feed, and over the headings of the guide, weighted by the volume removed. Each node is
    shared between the two nearest intervals, so that the weights are smooth in what moves
    the nodes.

    Args:
        process: Everything but the passes is read.
        tool: Radius and foundation are read.
        headings: Directions of the guide, from x towards y [rad]; along x if None.
        shares: Share of the guide's length with each heading [-]; all alike if None.
        curvature: Normal curvature of the part along (feed, left), convex positive
            [1/mm]; a plane if None.
        lean: +1 where the axis leans towards the feed (pulling), -1 away (pushing).
        bins: Number of intervals of [0, pi), from x towards y.
        phases: Phases of the loop.
        rows: Rows of the contact patch on either side of the feed.
        columns: Nodes along each of these rows and panels.
        panels: As in `pressure.patch`.

    Returns:
        Weights that add up to one; all alike where nothing slides.

    Source: Own derivation.
    """
    real = process.tilt.dtype
    if curvature is None:
        curvature = jnp.zeros((2, 2), real)
    if headings is None:
        headings = jnp.zeros(1, real)
    if shares is None:
        shares = jnp.full(headings.shape, 1.0 / headings.size, real)
    nodes = patch(process, tool, curvature, lean, rows, columns, panels)
    swirl = 2.0 * math.pi * process.trochoid_radius / process.step
    phase = jnp.asarray(2.0 * np.pi * (np.arange(phases) + 0.5) / phases, dtype=real)

    def at(phase):
        way = jnp.stack([1.0 + swirl * jnp.cos(phase), -swirl * jnp.sin(phase)])
        length = jnp.sqrt(jnp.sum(way**2))
        velocity = process.feed * way / length
        # the time at each phase goes with the length of path there
        volume = length * preston_rates(
            nodes, jnp.ones_like(length), process.tilt, process.spin, velocity, lean
        )
        along, across, _ = sliding(nodes, process.tilt, process.spin, velocity, lean)
        moving = volume > 0
        angle = jnp.arctan2(jnp.where(moving, across, 0.0), jnp.where(moving, along, 1.0))
        return angle.reshape(-1), volume.reshape(-1)

    angle, volume = (a.reshape(-1) for a in jax.vmap(at)(phase))
    place = jnp.mod((angle[None, :] + headings[:, None]) / math.pi, 1.0) * bins - 0.5
    weight = shares[:, None] * volume[None, :]
    below = jnp.floor(place)
    part = place - below
    index = jnp.mod(below.astype(int), bins)
    total = jnp.zeros(bins, real).at[index].add(weight * (1.0 - part))
    total = total.at[jnp.mod(index + 1, bins)].add(weight * part)
    whole = jnp.sum(total)
    slides = whole > 0
    return jnp.where(slides, total / jnp.where(slides, whole, 1.0), 1.0 / bins)
