r"""Interior: the least time within limits, by an interior-point method along the path.

The unknowns are the coefficients of y (see `shape`). At a sample, with $D = y^{-1/2}$,

- time is $\sum_i w_i D_i$, convex in y;
- a speed is a bound $y \le$ cap, an acceleration a strip $|\alpha_0 y + \alpha_1 y'| \le 1$;
- a jerk is $\sqrt y\,|\gamma_0 y + \gamma_1 y' + \gamma_2 y''| \le 1$, so
  $|\gamma_0 y + \gamma_1 y' + \gamma_2 y''| \le D(y)$.

Only the last is not convex. Its right side is: the tangent to D lies below D, so a step
that keeps to the tangent keeps to the limit, and repeating it never leaves the limits
(convex-concave procedure; Debrouwere et al. 2013 did so for the time-optimal problem).

All rows look at one sample, so Newton's matrix has five diagonals, and a step costs time in
proportion to n. What makes few steps enough is that everything is local: slacks,
multipliers and coefficients are held positive one by one, so that a hard place does not
slow down the rest of the path, as one common step length would.

The barrier stays at a share `MU` of each sample's time. So the answer is a smooth function
of the limits and the path, even where the limiting axis changes; it is slower than the
optimum by some 0.1 %; and `polish`, two more Newton steps with the matrix held constant,
has the right derivatives whatever the loop before it did (implicit function theorem).

Source: Own derivation.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from . import banded
from .shape import Stencil, apply, assemble, gather, inner


# Barrier at the end and at the start, as a share of each sample's time; its fall a step.
MU, MU_START, FALL = 3e-4, 0.05, 0.5
# Least share of itself that a slack or a multiplier keeps in a step, and a coefficient
# its least and largest multiple.
KEEP, LEAST, MOST = 0.2, 0.3, 3.0
# Steps after which the search has failed.
STEPS = 60


class Rows(eqx.Module):
    """The limits at the samples, each scaled so that 1 is all of it."""

    weight: Float[Array, " n"]
    """Time at each sample is this over the root of y."""
    slow: Float[Array, " n"]
    """One over the largest y that the speeds allow."""
    force: Float[Array, "2 k n"]
    r"""$\alpha_0, \alpha_1$ of the accelerations."""
    jerk: Float[Array, "3 k n"]
    r"""$\gamma_0, \gamma_1, \gamma_2$ of the jerks."""


class Sides(NamedTuple):
    """One number for each limit and sample; accelerations and jerks have two sides."""

    slow: Float[Array, " n"]
    force: Float[Array, "2 k n"]
    jerk: Float[Array, "2 k n"]


class Found(eqx.Module):
    """What the search ends with."""

    c: Float[Array, " n"]
    """Coefficients of y."""
    multiplier: Sides
    slack: Sides
    steps: Int[Array, ""]
    """Steps it took."""
    excess: Float[Array, " n"]
    """Largest relative distance of a limit from its slack at each sample [-]."""
    converged: Bool[Array, ""]


def search(rows: Rows, stencil: Stencil, rest, start: Float[Array, " n"]) -> Found:
    """The time-optimal y to the accuracy of the barrier; not for differentiation.

    Args:
        rows: The limits at the samples.
        stencil: How coefficients give y.
        rest: Whether the path starts and ends at rest.
        start: A guess of y at the samples, within a factor of some of the answer.
    """
    inside = inner(stencil, rest)
    tolerance = 1e-7 if start.dtype == jnp.float64 else 1e-3
    y, y1, y2 = apply(stencil, start)
    share = rows.weight / jnp.sqrt(y)
    slack = jax.tree.map(lambda g: jnp.maximum(g, 0.1), _room(rows, y, y1, y2))
    slack = slack._replace(jerk=slack.jerk / jnp.sqrt(y))
    mu = jnp.asarray(MU_START, start.dtype)
    multiplier = jax.tree.map(lambda s: mu * share / s, slack)

    def unfinished(state):
        return (state[-1] < STEPS) & ~state[-2]

    def step(state):
        c, multiplier, slack, mu, _, _, count = state
        y, y1, y2 = apply(stencil, c)
        root = jnp.sqrt(y)
        slope = -0.5 / (y * root)
        room = _room(rows, y, y1, y2)
        room = room._replace(jerk=room.jerk / root)
        level = mu * rows.weight / root
        w = jax.tree.map(lambda l, s: l / s, multiplier, slack)
        push = jax.tree.map(lambda s, w, g: level / s - w * (g - s), slack, w, room)
        down = gather(stencil, _force(rows, slope, push))
        bend = jnp.maximum(rows.weight - jnp.sum(multiplier.jerk, axis=(0, 1)), 0.0)
        matrix = _matrix(rows, stencil, inside, slope, w, 0.75 * bend / (y * y * root))
        dc = banded.solve(matrix, jnp.where(inside, down, 0.0))
        move = _change(rows, slope, *apply(stencil, dc))
        ds = jax.tree.map(lambda m, g, s: m + g - s, move, room, slack)
        new = jax.tree.map(lambda s, w, d: level / s - w * d, slack, w, ds)
        off = jax.tree.map(lambda g, s: jnp.abs(g - s), room, slack)
        off = off._replace(jerk=off.jerk * root)
        excess = jnp.maximum(off.slow, jnp.max(off.force, axis=(0, 1)))
        excess = jnp.maximum(excess, jnp.max(off.jerk, axis=(0, 1)))
        multiplier = jax.tree.map(lambda l, x: jnp.maximum(x, KEEP * l), multiplier, new)
        slack = jax.tree.map(lambda s, d: jnp.maximum(s + d, KEEP * s), slack, ds)
        ratio = dc / c
        still = jnp.max(jnp.abs(jnp.where(inside, ratio, 0.0))) < jnp.sqrt(tolerance)
        done = still & (jnp.max(excess) < tolerance) & (mu <= MU)
        c = c * jnp.clip(1.0 + ratio, LEAST, MOST)
        mu = jnp.maximum(FALL * mu, MU)
        return c, multiplier, slack, mu, excess, done, count + 1

    state = (start, multiplier, slack, mu, jnp.zeros_like(y), jnp.array(False), 0)
    c, multiplier, slack, _, excess, done, count = jax.lax.while_loop(
        unfinished, step, state
    )
    return Found(c, multiplier, slack, jnp.asarray(count), excess, done)


def polish(rows: Rows, stencil: Stencil, rest, found: Found) -> Float[Array, " n"]:
    """What was found, with its derivatives by the rows and the stencil."""
    inside = inner(stencil, rest)
    found, still = jax.lax.stop_gradient((found, (rows, stencil)))
    y = apply(still[1], found.c)[0]
    root = jnp.sqrt(y)
    w = jax.tree.map(lambda l, s: l / s, found.multiplier, found.slack)
    bend = still[0].weight - jnp.sum(found.multiplier.jerk, axis=(0, 1))
    slope = -0.5 / (y * root)
    matrix = _matrix(still[0], still[1], inside, slope, w, 0.75 * bend / (y * y * root))
    c = found.c
    for _ in range(2):
        y, y1, y2 = apply(stencil, c)
        root = jnp.sqrt(y)
        room = _room(rows, y, y1, y2)
        room = room._replace(jerk=room.jerk / root)
        level = MU * rows.weight / root
        push = jax.tree.map(lambda g: level / g, room)
        down = gather(stencil, _force(rows, -0.5 / (y * root), push))
        c = c + banded.solve(matrix, jnp.where(inside, down, 0.0))
    return jnp.where(found.converged, c, found.c)


def _room(rows: Rows, y, y1, y2) -> Sides:
    """What is left of each limit, as a share of it."""
    force = rows.force[0] * y[None] + rows.force[1] * y1[None]
    jerk = rows.jerk[0] * y[None] + rows.jerk[1] * y1[None] + rows.jerk[2] * y2[None]
    jerk = jnp.sqrt(y)[None] * jerk
    return Sides(
        slow=1.0 - rows.slow * y,
        force=jnp.stack([1.0 - force, 1.0 + force]),
        jerk=jnp.stack([1.0 - jerk, 1.0 + jerk]),
    )


def _change(rows: Rows, slope, y, y1, y2) -> Sides:
    """How the rooms (those of jerk over the root of y) change with y, y' and y''."""
    force = rows.force[0] * y[None] + rows.force[1] * y1[None]
    jerk = rows.jerk[0] * y[None] + rows.jerk[1] * y1[None] + rows.jerk[2] * y2[None]
    bound = (slope * y)[None]
    return Sides(
        slow=-rows.slow * y,
        force=jnp.stack([-force, force]),
        jerk=jnp.stack([bound - jerk, bound + jerk]),
    )


def _force(rows: Rows, slope, push: Sides):
    """Minus the gradient by y, y', y'' of time, and of the rooms weighted by `push`."""
    force = push.force[1] - push.force[0]
    jerk, bound = push.jerk[1] - push.jerk[0], jnp.sum(push.jerk, axis=(0, 1))
    y = -rows.weight * slope - rows.slow * push.slow + slope * bound
    y = y + jnp.sum(rows.force[0] * force + rows.jerk[0] * jerk, axis=0)
    y1 = jnp.sum(rows.force[1] * force + rows.jerk[1] * jerk, axis=0)
    return y, y1, jnp.sum(rows.jerk[2] * jerk, axis=0)


def _matrix(rows: Rows, stencil: Stencil, inside, slope, w: Sides, bend) -> banded.Band:
    """Newton's matrix for limits of weight w and the given curvature by y."""
    a0, a1 = rows.force
    g0, g1, g2 = rows.jerk
    force, jerk = w.force[0] + w.force[1], w.jerk[0] + w.jerk[1]
    # both sides of a jerk lean on D alike
    lean = slope[None] * (w.jerk[1] - w.jerk[0])
    cross = g0 * jerk + lean
    h00 = bend + w.slow * rows.slow**2 + slope**2 * jnp.sum(jerk, axis=0)
    h00 = h00 + jnp.sum(force * a0**2 + g0 * (cross + lean), axis=0)
    h01 = jnp.sum(force * a0 * a1 + g1 * cross, axis=0)
    h11 = jnp.sum(force * a1**2 + jerk * g1**2, axis=0)
    h02 = jnp.sum(g2 * cross, axis=0)
    h12 = jnp.sum(jerk * g1 * g2, axis=0)
    h22 = jnp.sum(jerk * g2**2, axis=0)
    diagonal, first, second = assemble(stencil, (h00, h01, h02, h11, h12, h22))
    # rounding must not cost definiteness; a coefficient that is none stands alone
    tiny = 4.0 * jnp.finfo(diagonal.dtype).eps
    diagonal = jnp.where(inside, diagonal * (1.0 + tiny), 1.0)
    both = inside[:-1] & inside[1:]
    first = jnp.where(jnp.pad(both, (0, 1)), first, 0.0)
    both = inside[:-2] & inside[2:]
    return banded.Band(diagonal, first, jnp.where(jnp.pad(both, (0, 2)), second, 0.0))
