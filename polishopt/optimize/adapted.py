"""Adapted: an inner problem for the other solvers of optimistix, through a map of the box.

They know no bounds, so they move a free point that a smooth map takes into the box: a sine
between two bounds, a branch of a hyperbola at a single one. All its points lie in the box,
and a bound that holds is an ordinary minimum there. That costs them many evaluations (see
`box`), and gradients that vanish at a bound the answer must leave: so each solve starts a
little inside of such a bound, and ends on a bound that it came very close to. A line search
cannot see a decrease below the rounding of its objective, which a penalty makes large: the
last digits are left to the steps of `box`.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int, PyTree

from .box import BoxState
from .outer import Outer
from .penalty import Problem


ROUNDS = 4  # solves of one inner problem, each from where the last one ended
CROSSOVER = 2e-4  # relative inner tolerance from which the steps of `box` go on
NUDGE = 1e-3  # start inside a bound, in widths of the box
SNAP = 1e-7  # and this close to it, on it
SHARE = 1e-3  # tolerance on steps over the tolerance on gradients that is asked for


def into_box(
    free: Float[Array, " n"], lower: Float[Array, " n"], upper: Float[Array, " n"], width
) -> Float[Array, " n"]:
    """The point of the box that belongs to a free one, in the units of the unknowns."""
    below, above = jnp.isfinite(lower), jnp.isfinite(upper)
    low, high = jnp.where(below, lower, 0.0), jnp.where(above, upper, 0.0)
    branch = width * (jnp.sqrt(1 + free**2) - 1)
    single = jnp.where(below, low + branch, jnp.where(above, high - branch, width * free))
    double = low + width * (0.5 + 0.5 * jnp.sin(free))
    return within(jnp.where(below & above, double, single), lower, upper)


def from_box(point, lower, upper, width) -> Float[Array, " n"]:
    """A free point that belongs to a point of the box."""
    below, above = jnp.isfinite(lower), jnp.isfinite(upper)
    low, high = jnp.where(below, lower, point), jnp.where(above, upper, point)
    branch = jnp.where(below, point - low, high - point) / width
    single = jnp.where(
        below | above, jnp.sqrt((1 + jnp.maximum(branch, 0.0)) ** 2 - 1), point / width
    )
    inside = jnp.clip(2 * (point - low) / width - 1, -1.0, 1.0)
    return jnp.where(below & above, jnp.arcsin(inside), single)


@jax.custom_jvp
def within(point, lower, upper):
    """The point without its rounding across a bound; slopes as if it were never moved."""
    return jnp.clip(point, lower, upper)


@within.defjvp
def _within_jvp(primals, tangents):
    return within(*primals), tangents[0]


class Adapted(eqx.Module):
    """A solver of optimistix for the inner problems."""

    solver: optx.AbstractLeastSquaresSolver | optx.AbstractMinimiser
    problem: Problem
    max_steps: int

    def inner(
        self, parts, x: PyTree, outer: Outer, state: BoxState, skip
    ) -> tuple[PyTree, BoxState, Int[Array, ""]]:
        """Where an inner problem ends, to be evaluated there; and steps that took.

        Args:
            parts: The user's functions as one.
            x: Where it begins.
            outer: Multipliers and tolerance.
            state: Values and slopes at `x`.
            skip: Whether to stay at `x`.
        """
        box = self.problem.lower, self.problem.upper, self.problem.width
        lower, upper, width = box
        point, _ = ravel_pytree(x)
        duals = outer.duals
        merit = self.problem.merit(duals)

        # a bound that the descent leaves is left by a nudge: the map is flat there
        slope = state.jacobian.T @ merit.pull(state.values)
        inwards = jnp.where(slope < 0, point + NUDGE * width, point - NUDGE * width)
        near = (point - lower <= NUDGE * width) & (slope < 0)
        near = near | ((upper - point <= NUDGE * width) & (slope > 0))
        begin = jnp.clip(jnp.where(near, inwards, point), lower, upper)

        def at(end):
            return ravel_pytree(parts(self.problem.place(end)))[0].astype(point.dtype)

        def values(free):
            # a step that went nowhere is evaluated at 0, and not believed
            known = jnp.all(jnp.isfinite(free))
            found = at(into_box(jnp.where(known, free, 0.0), *box))
            return jnp.where(known, found, jnp.nan)

        def solved():
            free = from_box(begin, *box)
            share = jnp.maximum(SHARE * outer.loose, 10 * jnp.finfo(point.dtype).eps)
            solver = tuned(self.solver, share)
            if isinstance(solver, optx.AbstractMinimiser):
                answer = optx.minimise(
                    lambda y, _: merit(values(y)),
                    solver,
                    free,
                    max_steps=self.max_steps,
                    throw=False,
                )
            else:
                answer = optx.least_squares(
                    lambda y, _: merit.rows(values(y))[0],
                    solver,
                    free,
                    max_steps=self.max_steps,
                    throw=False,
                )
            known = jnp.all(jnp.isfinite(answer.value))
            end = jnp.where(known, into_box(answer.value, *box), point)
            end = jnp.where(end - lower <= SNAP * width, lower, end)
            end = jnp.where(upper - end <= SNAP * width, upper, end)
            end = jnp.where(jnp.all(jnp.isfinite(at(end))), end, point)
            return end, jnp.asarray(answer.stats["num_steps"]) + 2

        end, steps = jax.lax.cond(skip, lambda: (point, jnp.ones_like(outer.steps)), solved)
        # the next step of `box` then evaluates this point, and moves no further
        return (
            self.problem.place(end),
            eqx.tree_at(lambda s: s.first, state, ~skip | state.first),
            steps,
        )


def tuned(solver, tolerance):
    """The solver with another tolerance, if it has one; a wrapped solver's too."""
    if isinstance(getattr(solver, "solver", None), eqx.Module):
        return eqx.tree_at(lambda s: s.solver, solver, tuned(solver.solver, tolerance))
    if not (hasattr(solver, "rtol") and hasattr(solver, "atol")):
        return solver
    return eqx.tree_at(lambda s: (s.rtol, s.atol), solver, (tolerance, tolerance))
