"""Outer: when an inner problem is solved well enough, and what the next one is.

The multipliers change on the spot, from values that are there already. When the violation
stops falling at a point that is stationary for it, the violation alone is looked at, at
first in the scaled constraints, which balances them: that finds a feasible point to go on
from, or a least-violating one. Scales come from the start, so what is least would depend on
it: from there on, therefore, violations count in the units that the user gave them.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PyTree

from ..parts import Scalar
from .box import BoxState, stalled
from .certificate import Status
from .penalty import Duals, Problem


RAISE = 10.0  # factor on the penalty of a constraint that does not improve
IMPROVED = 0.1  # a constraint improves if its error falls below this share
LOOSE = 0.1  # first inner tolerance, and the factor by which it tightens
FINE = 1e-3  # violation that goes with an inner tolerance
POLISH = 8  # turns that may follow the first point within the tolerance
PATIENCE = 3  # outer steps in a row that may fail to halve the violation
RADIUS = 0.1  # least trust region at the start of an inner problem


class Outer(eqx.Module):
    """How the outer loop stands."""

    duals: Duals
    pulls: Float[Array, " m"]
    """Multipliers of the user's values: the residuals themselves, then the constraints'."""
    penalty: Scalar
    """The first penalty."""
    loose: Scalar
    """Inner tolerance, relative to the size of the terms that cancel."""
    error: Float[Array, " c"]
    """Violation or lack of complementarity, when the multipliers last changed."""
    violation: Scalar
    """Largest scaled violation at that time."""
    failures: Int[Array, ""]
    """Outer steps since that was last halved."""
    inner: Int[Array, ""]
    """Trial points since that time."""
    steps: Int[Array, ""]
    """Changes of the multipliers."""
    polish: Int[Array, ""]
    """Turns at points that met the tolerance."""
    status: Int[Array, ""]
    """Whether it is over, and how; negative while it is not."""


def outer_step(
    problem: Problem,
    x: PyTree,
    state: BoxState,
    outer: Outer,
    goal: float,
    sharp: bool,
    max_inner: int | Int[Array, ""],
) -> tuple[BoxState, Outer]:
    """Judge the present point; renew multipliers, penalties and tolerance if it is time.

    Args:
        problem: The order of the values, and the box.
        x: The present point.
        state: What is known there.
        outer: How the outer loop stood.
        goal: Tolerance, as `solve` describes it.
        sharp: Whether a few more evaluations may go into what rounding leaves.
        max_inner: Trial points after which the multipliers change in any case.

    Returns:
        Both states. The first only has its trust region widened.
    """
    duals, feasible = outer.duals, tolerable(goal, state.values)
    _, constraints, hinged = problem.split(state.values)
    scaled, breach = constraints / duals.scale, problem.breach(state.values, duals)
    pulls = problem.merit(duals).pull(state.values)
    multiplier = pulls[problem.plain :] * duals.scale
    violation = jnp.max(jnp.abs(breach), initial=0.0)
    size = jnp.maximum(state.magnitude, 1.0)
    slack = jnp.where(hinged, jnp.minimum(multiplier / size, -scaled), 0.0)
    short = jnp.maximum(state.optimality / size, jnp.max(slack, initial=0.0))

    numbers = jnp.all(jnp.isfinite(state.values)) & jnp.all(jnp.isfinite(state.jacobian))
    lost = ~numbers | (stalled(state) & ~state.finite)
    solved = ~duals.restoring & (short <= goal) & (violation <= feasible)
    polish = outer.polish + jnp.where(solved, 1, 0)
    aim = goal
    if sharp:
        epsilon = jnp.finfo(size.dtype).eps
        aim = jnp.maximum(10 * goal / size, 50 * epsilon)
        stationary = short <= aim
        absolute = jnp.maximum(1e7 * goal**2 / duals.scale, 4 * epsilon)
        exact = stationary & jnp.all(jnp.abs(breach) <= absolute)
        solved = solved & (exact | stalled(state) | (polish > POLISH))
    spent = outer.inner + 1 >= max_inner

    # the inner problem is solved: better multipliers, larger penalties where needed
    near = state.optimality <= jnp.maximum(outer.loose, LOOSE * aim) * size
    # what is good enough and does not get better wants other multipliers
    renew = near | stalled(state) | spent | (sharp & (polish > 2))
    renew = renew & ~duals.restoring & ~solved & ~lost
    error = jnp.maximum(scaled, -duals.multiplier / duals.penalty)
    error = jnp.abs(jnp.where(hinged, error, scaled))
    # what was cut short says nothing about the penalties
    cut = renew & spent & ~near & ~stalled(state)
    improved = error <= jnp.maximum(IMPROVED * outer.error, FINE * outer.loose)
    improved = improved | (error <= feasible) | cut
    raised = jnp.where(improved, duals.penalty, RAISE * duals.penalty)
    halved = (violation <= 0.5 * outer.violation) | (violation <= feasible)
    failures = jnp.where(renew, jnp.where(halved, 0, outer.failures + 1), outer.failures)

    # or the violation has stopped falling: look at it alone, until that is settled
    slope = state.jacobian[problem.plain :].T @ (breach / duals.scale)
    cornered = problem.descent(x, slope) <= 0.1 * violation
    restore = renew & cornered & (failures >= PATIENCE)
    found = duals.restoring & (violation <= feasible)
    amount = jnp.max(
        jnp.abs(problem.excess(state.values) / problem.measure(duals)), initial=0.0
    )
    fine = jnp.where(duals.measuring, 0.1 * goal, 1e3 * goal)
    flat = state.optimality <= fine * jnp.maximum(state.magnitude, amount**2)
    bottom = duals.restoring & ~found & (flat | stalled(state))
    least = bottom & duals.measuring
    measure = bottom & ~duals.measuring

    multiplier = jnp.clip(
        jnp.where(renew, multiplier, duals.multiplier), -duals.most, duals.most
    )
    penalty = jnp.where(renew, jnp.minimum(raised, duals.most), duals.penalty)
    # a start on the constraints knows nothing of the multipliers: tighten step by step
    tighter = jnp.maximum(LOOSE**2 * outer.loose, jnp.max(error, initial=0.0) / FINE)
    tighter = jnp.minimum(LOOSE * outer.loose, tighter)
    loose = jnp.where(
        renew, jnp.maximum(tighter, LOOSE * aim if sharp else goal), outer.loose
    )
    duals = Duals(
        scale=duals.scale,
        multiplier=jnp.where(found, 0.0, multiplier),
        penalty=jnp.where(found, RAISE * outer.penalty, penalty),
        most=jnp.where(found, RAISE * duals.most, duals.most),
        leeway=jnp.where(found, IMPROVED * duals.leeway, duals.leeway),
        restoring=(duals.restoring & ~found) | restore,
        measuring=(duals.measuring & ~found) | measure,
    )
    new_problem = renew | found | measure
    wider = jnp.where(new_problem & ~cut, RADIUS, 0.0)
    state = eqx.tree_at(lambda s: s.radius, state, jnp.maximum(state.radius, wider))
    lasting = outer.duals.restoring & spent & ~new_problem
    status = jnp.where(lasting, Status.WORK_LIMIT.value, -1)
    status = jnp.where(least, Status.INFEASIBLE.value, status)
    status = jnp.where(solved, Status.SOLVED.value, status)
    return state, Outer(
        duals=duals,
        pulls=pulls,
        penalty=jnp.where(found, RAISE * outer.penalty, outer.penalty),
        loose=jnp.where(found, LOOSE, loose),
        error=jnp.where(renew, error, outer.error),
        violation=jnp.where(renew, violation, outer.violation),
        failures=jnp.where(found, 0, failures),
        inner=jnp.where(new_problem, 0, outer.inner + 1),
        steps=outer.steps + jnp.where(new_problem & (polish == 0), 1, 0),
        polish=polish,
        status=jnp.where(lost, Status.NOT_A_NUMBER.value, status),
    )


def tolerable(goal: float, values: Float[Array, " m"]) -> float:
    """Largest scaled violation of a feasible point: well below the tolerance."""
    return max(FINE * goal, 100 * float(jnp.finfo(values.dtype).eps))
