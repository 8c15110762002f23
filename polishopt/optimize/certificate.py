"""Certificate: where a constrained solve ended, and what proves it.

A point alone convinces nobody. With it come the multipliers, in the user's units, and the
two numbers that say how well it satisfies the conditions of Karush, Kuhn and Tucker: `kkt`
for stationarity and complementarity, `violation` for feasibility.
"""

import enum

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int, PyTree

from ..parts import Scalar
from .box import BoxState
from .penalty import Duals, Problem


SHARE = 1e-4  # of the largest force or violation: less is no part of a conflict


class Status(enum.IntEnum):
    """How a solve ended."""

    SOLVED = 0
    INFEASIBLE = 1
    WORK_LIMIT = 2
    NOT_A_NUMBER = 3


SENTENCES = {
    Status.SOLVED: "Solved: stationary and feasible within the tolerance.",
    Status.INFEASIBLE: "No feasible point near: the violation is least here, and not zero.",
    Status.WORK_LIMIT: "Stopped at the limit on work, before the tolerance was met.",
    Status.NOT_A_NUMBER: "Stopped where the problem's functions are not a number.",
}


def sentence(status: int | Int[Array, ""]) -> str:
    """What a status code means, for people; not for use under `jit`."""
    return SENTENCES[Status(int(status))]


class Solution(eqx.Module):
    r"""Where a solve ended, and what proves it.

    Multipliers belong to the unscaled constraints and the objective $\tfrac12 |r|^2$:
    $\lambda_i$ is how much the objective falls per unit that limit $i$ is relaxed.
    """

    x: PyTree
    """The unknowns, a pytree like the start [its units]."""
    residual: PyTree
    """Residuals at x [-]."""
    inequality: PyTree
    """Inequalities at x, at most 0 where they hold [their units]; None if none."""
    equality: PyTree
    """Equalities at x [their units]; None if none."""
    inequality_multipliers: PyTree
    """At least 0 [1 / units of the inequality]. Where the problem is infeasible: the
    weight of each constraint in the conflict."""
    equality_multipliers: PyTree
    """Positive if the objective falls as the equality rises [1 / units of the equality]."""
    bound_multipliers: PyTree
    """Negative at a lower bound, positive at an upper one, 0 inside [1 / units of x]."""
    kkt: Scalar
    """Largest entry of the projected gradient of the Lagrangian, per width of the box, and
    of min(multiplier, slack) of the scaled inequalities [-]. Where the problem is
    infeasible: of half the sum of squared scaled violations, without the objective."""
    violation: Scalar
    """Largest violation [units of the constraint]."""
    scaled_violation: Scalar
    """Largest violation of the scaled constraints [widths of the box]."""
    infeasibility: Scalar
    """Root of the sum of squared violations, in the units that `solve` was given; what is
    made least where no point is feasible."""
    conflict: tuple[PyTree, PyTree, PyTree]
    """Which inequalities, equalities and bounds stand against each other, where the problem
    is infeasible [bool]; `naming.conflict` lists them by name."""
    objective: Scalar
    """What is made small: half the sum of squared residuals, plus the objective."""
    active: PyTree
    """Which inequalities hold with equality, or do not hold [bool]."""
    outer_steps: Int[Array, ""]
    """Changes of the multipliers."""
    inner_steps: Int[Array, ""]
    """Trial points after the start."""
    evaluations: Int[Array, ""]
    """Points at which the functions were evaluated, the start included."""
    status: Int[Array, ""]
    """A `Status`; `sentence` says it in words."""


def certify(
    problem: Problem,
    x: PyTree,
    state: BoxState,
    duals: Duals,
    pulls: Float[Array, " m"],
    goal: float,
    counts: tuple[Int[Array, ""], Int[Array, ""], Int[Array, ""]],
    status: Int[Array, ""],
) -> Solution:
    """The solution in the user's units and structures, without another evaluation.

    Args:
        problem: How the values lie in flat vectors, and the box.
        x: The last point.
        state: Values and Jacobian there.
        duals: Scales of the constraints, and multipliers.
        pulls: Multipliers of the values, in their units.
        goal: Tolerance, which says what counts as active.
        counts: Outer steps, inner steps and evaluations.
        status: A `Status`.

    Returns:
        The solution with its certificate.
    """
    plain, constraints, hinged = problem.split(state.values)
    excess = problem.excess(state.values) / problem.unit
    infeasible = status == Status.INFEASIBLE.value
    scale, width, point = duals.scale, problem.width, ravel_pytree(x)[0]
    multipliers = pulls[problem.plain :]
    gradient = state.jacobian.T @ pulls
    # a bound pushes from a rounding error away too
    room = jnp.minimum(point - problem.lower, problem.upper - point) / width
    inside = problem.upper - point > point - problem.lower
    held = (room <= goal) & (jnp.abs(gradient) > room)
    held = held & jnp.where(inside, gradient > 0, gradient < 0)
    held = held | ((problem.lower == problem.upper) & (gradient != 0))
    slack = jnp.where(hinged, jnp.minimum(multipliers * scale, -constraints / scale), 0.0)
    breach = jnp.abs(problem.breach(state.values, duals))
    touching = jnp.where(constraints / scale >= -10 * goal, 1.0, 0.0)
    # what pulls at the point, and what is violated although it is flat there
    force = jnp.abs(multipliers) * jnp.max(jnp.abs(state.jacobian[problem.plain :]), axis=1)
    most = jnp.max(force, initial=0.0)
    worst = jnp.max(jnp.abs(excess), initial=0.0)
    involved = (force > SHARE * most) | (jnp.abs(excess) > SHARE * worst)
    involved = jnp.where(infeasible & involved, 1.0, 0.0)
    _, _, *sides = problem.sort(jnp.concatenate([plain, involved]))
    wall = infeasible & held & (jnp.abs(gradient) > SHARE * most)
    conflict = (*sides, problem.place(jnp.where(wall, 1.0, 0.0)))
    residual, _, inequality, equality = problem.sort(state.values)
    _, _, inequality_multipliers, equality_multipliers = problem.sort(pulls)
    _, _, touched, _ = problem.sort(jnp.concatenate([plain, touching]))
    return Solution(
        x=x,
        residual=residual,
        inequality=inequality,
        equality=equality,
        inequality_multipliers=inequality_multipliers,
        equality_multipliers=equality_multipliers,
        bound_multipliers=problem.place(jnp.where(held, -gradient / width, 0.0)),
        kkt=jnp.maximum(problem.descent(x, gradient), jnp.max(slack, initial=0.0)),
        violation=jnp.max(breach * scale, initial=0.0),
        scaled_violation=jnp.max(breach, initial=0.0),
        infeasibility=jnp.sqrt(jnp.sum(excess**2)),
        conflict=jax.tree.map(lambda leaf: leaf > 0, conflict),
        objective=problem.objective(state.values),
        active=jax.tree.map(lambda leaf: leaf > 0, touched),
        outer_steps=counts[0],
        inner_steps=counts[1],
        evaluations=counts[2],
        status=status,
    )
