r"""Interior: the least time within limits, by an interior-point method along the path.

The unknowns are the coefficients of y (see `shape`). At a sample, with $D = y^{-1/2}$,

- time is $\sum_i w_i D_i$, convex in y;
- a speed is a bound on y, that is, on its coefficients;
- an acceleration is a strip $|\alpha_0 y + \alpha_1 y'| \le 1$;
- a jerk, at either end of an interval, is
  $\sqrt y\,|\gamma_0 y + \gamma_1 y' + \gamma_2 y''| \le 1$, so
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

import functools
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from . import banded
from .shape import Stencil, apply, assemble, gather, total


# Barrier at the end and at the start, as a share of each sample's time; its fall a step.
MU, MU_START = 2e-4, 0.05
# Its fall in a step, and in one that follows from limits nearly met.
FALL, FALL_FAST, NEAR = 0.5, 0.25, 0.3
# Least share of itself that a slack or a multiplier keeps in a step, and a coefficient
# its least and largest multiple.
KEEP, LEAST, MOST = 0.2, 0.3, 3.0
# Steps after which the search has failed.
STEPS = 60


class Rows(eqx.Module):
    """The limits at the samples, each scaled so that 1 is all of it."""

    weight: Float[Array, " n"]
    """Time at each sample is this over the root of y."""
    slow: Float[Array, " c"]
    """One over the largest coefficients that the speeds allow."""
    force: Float[Array, "2 k n"]
    r"""$\alpha_0, \alpha_1$ of the accelerations."""
    half: Float[Array, "2 k n"]
    """The same half-way through the interval that follows."""
    jerk: Float[Array, "3 k n"]
    r"""$\gamma_0, \gamma_1, \gamma_2$ of the jerks."""
    step: Float[Array, " n"]
    """Length of the interval that follows, zero after the last sample."""


class Sides(NamedTuple):
    """One number for each limit and sample; accelerations and jerks have two sides."""

    slow: Float[Array, " c"]
    force: Float[Array, "2 k n"]
    half: Float[Array, "2 k n"]
    """Of the acceleration half-way through each interval."""
    jerk: Float[Array, "2 k n"]
    """At the start of each interval."""
    then: Float[Array, "2 k n"]
    """At its end."""


def kept(x, near: Array):
    """The same numbers, each worked out once.

    XLA would otherwise work out again, in each of its loops, what several of them read: on
    CPU it drops its own barriers before it forms loops. It never repeats a division, so
    everything is divided by a one that it cannot see through, made from any number `near`.
    """
    one = jnp.where(jnp.isnan(near), near, jnp.ones_like(near))
    return jax.tree.map(lambda v: v / one, x)


class Found(eqx.Module):
    """What the search ends with."""

    c: Float[Array, " c"]
    """Coefficients of y."""
    multiplier: Sides
    slack: Sides
    steps: Int[Array, ""]
    """Steps it took."""
    excess: Float[Array, " n"]
    """Largest relative distance of a limit from its slack at each sample [-]."""
    converged: Bool[Array, ""]


class Here(NamedTuple):
    """y, its derivatives and D at one end of the intervals."""

    y: Float[Array, " n"]
    y1: Float[Array, " n"]
    y2: Float[Array, " n"]
    bound: Float[Array, " n"]
    """D, the root of 1/y."""
    fall: Float[Array, " n"]
    """Derivative of D by y."""


def search(rows: Rows, stencil: Stencil, start: Float[Array, " c"]) -> Found:
    """The time-optimal y to the accuracy of the barrier; not for differentiation.

    Args:
        rows: The limits at the samples.
        stencil: How coefficients give y.
        start: A guess of the coefficients, within a factor of some of the answer.
    """
    tolerance = 1e-5 if start.dtype == jnp.float64 else 1e-3
    ends = _places(rows, apply(stencil, start))
    slack = _room(rows, start, ends)
    slack = slack._replace(
        slow=jnp.maximum(slack.slow, 0.1),
        force=jnp.maximum(slack.force, 0.1),
        half=jnp.maximum(slack.half, 0.1),
        jerk=jnp.maximum(slack.jerk, 0.1 * ends[0].bound[None, None]),
        then=jnp.maximum(slack.then, 0.1 * ends[2].bound[None, None]),
    )
    mu = jnp.asarray(MU_START, start.dtype)
    level = _level(rows, ends[0], mu)
    multiplier = jax.tree.map(jnp.divide, level, slack)

    def unfinished(state):
        return (state[-1] < STEPS) & ~state[-2]

    def step(state):
        c, multiplier, slack, mu, _, _, count = state
        ends = _places(rows, kept(apply(stencil, c), mu))
        room, level = _room(rows, c, ends), _level(rows, ends[0], mu)
        over = jax.tree.map(lambda s: 1.0 / s, slack)
        w = jax.tree.map(jnp.multiply, multiplier, over)
        pull = jax.tree.map(jnp.multiply, level, over)
        lack = jax.tree.map(jnp.subtract, room, slack)
        push = jax.tree.map(lambda p, w, g: p - w * g, pull, w, lack)
        down = _down(rows, stencil, ends, push, mu)
        bends = _bends(rows, ends, multiplier)
        bends = (jnp.maximum(bends[0] + bends[1], 0.0), jnp.zeros_like(bends[1]))
        dc = banded.solve(_matrix(rows, stencil, ends, w, bends), down)
        move = _change(rows, dc, ends, _places(rows, kept(apply(stencil, dc), mu)))
        ds = jax.tree.map(jnp.add, move, lack)
        multiplier = jax.tree.map(
            lambda l, p, w, d: jnp.maximum(p - w * d, KEEP * l), multiplier, pull, w, ds
        )
        slack = jax.tree.map(lambda s, d: jnp.maximum(s + d, KEEP * s), slack, ds)
        excess = _worst(lack, ends)
        ratio = jnp.where(stencil.unknown, dc / c, 0.0)
        still = jnp.max(jnp.abs(ratio)) < jnp.sqrt(tolerance)
        most = jnp.max(excess)
        done = still & (most < tolerance) & (mu <= MU)
        c = c * jnp.clip(1.0 + ratio, LEAST, MOST)
        mu = jnp.maximum(jnp.where(most < NEAR, FALL_FAST, FALL) * mu, MU)
        return c, multiplier, slack, mu, excess, done, count + 1

    none = jnp.zeros_like(rows.weight)
    state = (start, multiplier, slack, mu, none, jnp.array(False), 0)
    c, multiplier, slack, _, excess, done, count = jax.lax.while_loop(
        unfinished, step, state
    )
    return Found(c, multiplier, slack, jnp.asarray(count, jnp.int32), excess, done)


def polish(rows: Rows, stencil: Stencil, found: Found) -> Float[Array, " c"]:
    """What was found, with its derivatives by the rows and the stencil."""
    found, held, table = jax.lax.stop_gradient((found, rows, stencil))
    ends = _places(held, apply(table, found.c))
    w = jax.tree.map(jnp.divide, found.multiplier, found.slack)
    matrix = _matrix(held, table, ends, w, _bends(held, ends, found.multiplier))
    c = found.c
    for _ in range(2):
        ends = _places(rows, apply(stencil, c))
        room, level = _room(rows, c, ends), _level(rows, ends[0], jnp.full_like(c[0], MU))
        push = jax.tree.map(jnp.divide, level, room)
        c = c + banded.solve(matrix, _down(rows, stencil, ends, push, rows.weight[0]))
    return jnp.where(found.converged, c, found.c)


def _places(rows: Rows, parts) -> list[Here]:
    """What holds at the start of each interval, half-way and at its end."""
    y, y1, y2 = parts

    def here(h):
        there = y + h * (y1 + 0.5 * h * y2)
        bound = 1.0 / jnp.sqrt(there)
        return Here(there, y1 + h * y2, y2, bound, -0.5 * bound / there)

    return [here(h) for h in (jnp.zeros_like(y), 0.5 * rows.step, rows.step)]


def _level(rows: Rows, start: Here, mu) -> Sides:
    """Barrier of each limit: a share of the time at its sample."""
    level = mu * rows.weight * start.bound
    k = rows.force.shape[1], rows.jerk.shape[1]
    force, jerk = (jnp.broadcast_to(level[None, None], (2, k, level.size)) for k in k)
    return Sides(jnp.pad(level, 1, mode="edge"), force, force, jerk, jerk)


def _along(gamma, h: Here):
    """Jerk over the root of y."""
    return gamma[0] * h.y[None] + gamma[1] * h.y1[None] + gamma[2] * h.y2[None]


def _strip(alpha, h: Here):
    """Acceleration."""
    return alpha[0] * h.y[None] + alpha[1] * h.y1[None]


def _next(gamma):
    """The jerk's rows at the next sample."""
    return jnp.pad(gamma[..., 1:], ((0, 0), (0, 0), (0, 1)))


def _room(rows: Rows, c, ends: list[Here]) -> Sides:
    """What is left of each limit; of those of jerk, over the root of y."""
    start, mid, end = ends
    force, half = _strip(rows.force, start), _strip(rows.half, mid)
    jerk, then = _along(rows.jerk, start), _along(_next(rows.jerk), end)
    return Sides(
        slow=1.0 - rows.slow * c,
        force=jnp.stack([1.0 - force, 1.0 + force]),
        half=jnp.stack([1.0 - half, 1.0 + half]),
        jerk=jnp.stack([start.bound[None] - jerk, start.bound[None] + jerk]),
        then=jnp.stack([end.bound[None] - then, end.bound[None] + then]),
    )


def _change(rows: Rows, dc, ends, moves) -> Sides:
    """How the rooms change with the coefficients."""
    start, mid, end = moves
    force, half = _strip(rows.force, start), _strip(rows.half, mid)
    jerk, then = _along(rows.jerk, start), _along(_next(rows.jerk), end)
    low, high = (ends[0].fall * start.y)[None], (ends[2].fall * end.y)[None]
    return Sides(
        slow=-rows.slow * dc,
        force=jnp.stack([-force, force]),
        half=jnp.stack([-half, half]),
        jerk=jnp.stack([low - jerk, low + jerk]),
        then=jnp.stack([high - then, high + then]),
    )


def _worst(lack: Sides, ends) -> Float[Array, " n"]:
    """Largest distance of limits from their slacks at each sample, as a share of them."""
    rows = [lack.slow[1:-1], *lack.force[0], *lack.force[1], *lack.half[0], *lack.half[1]]
    for side, h in ((lack.jerk, ends[0]), (lack.then, ends[2])):
        rows += [x / h.bound for x in (*side[0], *side[1])]
    return functools.reduce(jnp.maximum, map(jnp.abs, rows))


def _down(rows: Rows, stencil: Stencil, ends, push: Sides, near):
    """Minus the gradient by c of time, and that of the rooms weighted by `push`."""
    start, _, end = ends
    force, half = push.force[1] - push.force[0], push.half[1] - push.half[0]

    def lean(gamma, side, h):
        jerk = side[1] - side[0]
        y = h.fall * total(total(side)) + total(gamma[0] * jerk)
        return y, total(gamma[1] * jerk), total(gamma[2] * jerk)

    y, y1, y2 = lean(rows.jerk, push.jerk, start)
    mid = (total(rows.half[0] * half), total(rows.half[1] * half), jnp.zeros_like(start.y))
    after = kept(lean(_next(rows.jerk), push.then, end), near)
    y = y - rows.weight * start.fall + total(rows.force[0] * force)
    y1 = y1 + total(rows.force[1] * force)
    for h, (z, z1, z2) in ((0.5 * rows.step, kept(mid, near)), (rows.step, after)):
        y, y1, y2 = y + z, y1 + z1 + h * z, y2 + z2 + h * (z1 + 0.5 * h * z)
    down = gather(stencil, kept((y, y1, y2), near)) - rows.slow * push.slow
    return jnp.where(stencil.unknown, down, 0.0)


def _bends(rows: Rows, ends, multiplier: Sides):
    """Second derivatives of time less the jerk's bounds, by y at start and end."""
    start, _, end = (0.75 * h.bound / h.y**2 for h in ends)
    here, then = total(total(multiplier.jerk)), total(total(multiplier.then))
    return (rows.weight - here) * start, -then * end


def _matrix(rows: Rows, stencil: Stencil, ends, w: Sides, bends) -> banded.Band:
    """Newton's matrix for limits of weight w and the given curvatures by y."""

    def jerks(gamma, side, h, bend):
        g0, g1, g2 = gamma
        both = side[0] + side[1]
        # both sides of a jerk lean on D alike
        lean = h.fall[None] * (side[1] - side[0])
        cross = g0 * both + lean
        return (
            bend + h.fall**2 * total(both) + total(g0 * (cross + lean)),
            total(g1 * cross),
            total(g2 * cross),
            total(both * g1**2),
            total(both * g1 * g2),
            total(both * g2**2),
        )

    def forces(rows, side):
        a0, a1 = rows
        both, zero = side[0] + side[1], jnp.zeros_like(bends[0])
        low, cross, high = (total(both * x) for x in (a0**2, a0 * a1, a1**2))
        return low, cross, zero, high, zero, zero

    start, _, end = ends
    near = rows.weight[0]
    then = kept(jerks(_next(rows.jerk), w.then, end, bends[1]), near)
    half = kept(forces(rows.half, w.half), near)
    parts = [
        jerks(rows.jerk, w.jerk, start, bends[0]),
        forces(rows.force, w.force),
        _moved(0.5 * rows.step, half),
        _moved(rows.step, then),
    ]
    hessian = kept(tuple(map(total, zip(*parts, strict=True))), near)
    diagonal, first, second = assemble(stencil, hessian)
    diagonal = diagonal + w.slow * rows.slow**2
    # rounding must not cost definiteness; a coefficient that is none stands alone
    tiny, free = 4.0 * jnp.finfo(diagonal.dtype).eps, stencil.unknown
    both, apart = free & jnp.roll(free, -1), free & jnp.roll(free, -2)
    return banded.Band(
        jnp.where(free, diagonal * (1.0 + tiny), 1.0),
        jnp.where(both, first, 0.0),
        jnp.where(apart, second, 0.0),
    )


def _moved(h, hessian):
    """A Hessian by (y, y', y'') taken h further on, by those here.

    There they are y + h y' + h^2/2 y'', y' + h y'' and y''.
    """
    e00, e01, e02, e11, e12, e22 = hessian
    q = 0.5 * h**2
    f1, f2 = h * e00 + e01, q * e00 + h * e01 + e02
    g2 = q * e01 + h * e11 + e12
    return (
        e00,
        f1,
        f2,
        h * (f1 + e01) + e11,
        h * f2 + g2,
        q * (f2 + e02) + h * (g2 + e12) + e22,
    )
