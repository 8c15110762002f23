"""Walk: one search of the augmented Lagrangian, turn by turn.

A turn takes in what the functions are at the trial point, and proposes the next one. It
knows nothing of the functions themselves: `auglag` runs turns in one compiled loop around
any functions, `batches` runs them from the host around a model that is dear to compile.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, Int, PyTree

from .box import BoxLevenbergMarquardt, BoxState, Trial, widths
from .certificate import Solution, Status, certify
from .outer import LOOSE, Outer, outer_step
from .penalty import Duals, Problem
from .steering import steered


class Rules(NamedTuple):
    """When a walk is over."""

    tolerance: float | None
    """As in `auglag.solve`; None for as sharp as rounding allows."""
    max_outer: int
    """Most changes of the multipliers."""
    max_inner: int
    """Most trial points between two changes."""


class Walk(eqx.Module):
    """How a search stands between two evaluations."""

    x: PyTree
    """The present point, in the structure and the units of the unknowns."""
    state: BoxState
    """What is known there."""
    outer: Outer
    """Multipliers, penalties and tolerance."""
    trial: Trial
    """The point that is to be evaluated next."""
    turns: Int[Array, ""]
    """Points that were taken in."""
    work: Int[Array, ""]
    """Points at which the functions were or will be evaluated."""


def problem_of(
    parts: tuple[PyTree, PyTree, PyTree, PyTree],
    x: PyTree,
    lower: PyTree,
    upper: PyTree,
    unit: tuple[PyTree, PyTree] | None = None,
    width: Float[Array, " n"] | None = None,
) -> Problem:
    """The order of the flat values.

    Args:
        parts: Residual, objective, inequality and equality; only shapes are read.
        x: The unknowns; where `width` is None, the start.
        lower: Their lower bounds.
        upper: Their upper bounds.
        unit: As in `auglag.solve`, in full; None for the constraints' own units.
        width: Lengths over which the unknowns matter; None for those of `box.widths`.
    """
    point, place = ravel_pytree(x)
    low, high = (ravel_pytree(bound)[0] for bound in (lower, upper))
    zeros = jax.tree.map(lambda s: jnp.zeros(s.shape, point.dtype), parts)
    _, sort = ravel_pytree(zeros)
    sizes = [sum(leaf.size for leaf in jax.tree.leaves(part)) for part in parts]
    if unit is None:
        unit = jax.tree.map(jnp.ones_like, zeros[2:])
    return Problem(
        residuals=sizes[0],
        objectives=sizes[1],
        inequalities=sizes[2],
        constraints=sizes[2] + sizes[3],
        unit=ravel_pytree(unit)[0].astype(point.dtype),
        lower=low,
        upper=high,
        width=widths(point, low, high) if width is None else width,
        place=place,
        sort=sort,
    )


def set_out(problem: Problem, start: PyTree) -> Walk:
    """A walk whose first trial point is its start.

    Args:
        problem: The order of the values, and the box.
        start: Within the box.
    """
    dtype = problem.lower.dtype
    none, one = jnp.zeros(problem.constraints, dtype), jnp.ones((), dtype)
    blank = jnp.zeros(problem.plain + problem.constraints, dtype)
    outer = Outer(
        duals=Duals(none + 1, none, none + 1, one, one, *[jnp.array(False)] * 2),
        pulls=blank,
        penalty=one,
        loose=LOOSE * one,
        error=none + jnp.inf,
        violation=jnp.inf * one,
        failures=jnp.array(0),
        inner=jnp.array(-1),
        steps=jnp.array(0),
        polish=jnp.array(0),
        status=jnp.array(-1),
    )
    state = BoxLevenbergMarquardt().init(
        lambda x, _: (x, None),  # only shapes are read
        start,
        outer.duals,
        _how(problem),
        blank,
        None,
        frozenset(),
    )
    still = Trial(start, jnp.zeros_like(problem.lower), 0 * one, outer.duals)
    return Walk(start, state, outer, still, jnp.array(0), jnp.array(1))


def taken_in(
    problem: Problem,
    rules: Rules,
    walk: Walk,
    values: Float[Array, " m"],
    columns: Float[Array, "m n"],
    most: int | Int[Array, ""] | None = None,
) -> Walk:
    """The walk after its trial point was evaluated; its next one is not chosen yet.

    Args:
        problem: The order of the values, and the box.
        rules: When it is over.
        walk: How it stood.
        values: The functions at the trial point.
        columns: Their derivative there, per width of the box.
        most: Trial points between two changes of the multipliers; None for the rules'.
    """
    solver, how = BoxLevenbergMarquardt(), _how(problem)
    x, state = solver.judge(walk.x, how, walk.state, walk.trial, values, columns)
    outer = eqx.tree_at(lambda o: o.duals, walk.outer, walk.trial.args)
    fresh, penalty = problem.first(state)
    opened = eqx.tree_at(lambda o: (o.duals, o.penalty), outer, (fresh, penalty))
    begins = walk.turns == 0
    outer = jax.tree.map(lambda a, b: jnp.where(begins, a, b), opened, outer)
    state = solver.measured(x, outer.duals, how, state)
    most = rules.max_inner if most is None else most
    goal, sharp = _goal(problem, rules), rules.tolerance is None
    state, outer = outer_step(problem, x, state, outer, goal, sharp, most)
    return Walk(x, state, outer, walk.trial, walk.turns + 1, walk.work)


def proposed(
    problem: Problem, rules: Rules, walk: Walk, spent: int | Int[Array, ""] = 1
) -> Walk:
    """The walk with its next trial point.

    Args:
        problem: The order of the values, and the box.
        rules: When it is over.
        walk: After `taken_in`.
        spent: Evaluations that the next point costs.
    """
    trial = BoxLevenbergMarquardt().propose(
        walk.x, walk.outer.duals, _how(problem), walk.state
    )
    work = walk.work + jnp.where(over(rules, walk), 0, spent)
    return Walk(walk.x, walk.state, walk.outer, trial, walk.turns, work)


def over(rules: Rules, walk: Walk) -> Bool[Array, ""]:
    """Whether the search has ended, in whatever way."""
    return (walk.outer.status >= 0) | (walk.outer.steps >= rules.max_outer)


def ended(problem: Problem, rules: Rules, walk: Walk) -> Solution:
    """What a walk that is over has found.

    Args:
        problem: The order of the values, and the box.
        rules: When it is over.
        walk: How it stands.
    """
    outer, goal = walk.outer, _goal(problem, rules)
    status = jnp.where(outer.status < 0, Status.WORK_LIMIT.value, outer.status)
    counts = (outer.steps, walk.turns - 1, walk.work)
    return certify(
        problem, walk.x, walk.state, outer.duals, outer.pulls, goal, counts, status
    )


def _goal(problem: Problem, rules: Rules) -> float:
    """The tolerance as a number."""
    if rules.tolerance is not None:
        return rules.tolerance
    return 0.5 * float(jnp.finfo(problem.lower.dtype).eps) ** 0.5


def _how(problem: Problem) -> dict[str, Any]:
    """The options of the inner solver."""
    return {
        "lower": problem.lower,
        "upper": problem.upper,
        "scale": problem.width,
        "merit": problem.merit,
        "choose": lambda duals, *rest: steered(problem, duals, *rest),
    }
