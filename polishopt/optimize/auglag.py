r"""Auglag: constrained nonlinear least squares, with a certificate.

$$\min_{l \le x \le u} \tfrac12 |r(x)|^2 \quad\text{with}\quad g(x) \le 0,\ h(x) = 0$$

The augmented Lagrangian of Powell, Hestenes and Rockafellar turns this into a series of
least-squares problems,
$\tfrac12 |r|^2 + \tfrac\mu2 |(g + \lambda/\mu)_+|^2 + \tfrac\mu2 |h + \nu/\mu|^2$, whose
multipliers $\lambda, \nu$ are then improved by $\lambda \leftarrow (\lambda + \mu g)_+$,
$\nu \leftarrow \nu + \mu h$. Every constraint has a penalty $\mu$ of its own, raised only
while that constraint does not improve, and a scale of its own, its gradient at the start,
so that its unit of measure does not matter. Residuals are used as they are: give them a
size of about one.

The loop is flat: a turn is one trial point of Levenberg-Marquardt (`box`), and where the
inner problem is solved well enough the multipliers change on the spot, without a new
evaluation. Under `vmap` no start waits for another one's inner problem.

When the violation stops falling at a point that is stationary for it, the loop turns to the
violation alone, $\tfrac12 |g_+|^2 + \tfrac12 |h|^2$ of the scaled constraints: it finds a
feasible point to go on from, or ends at a least-violating one and says so.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int, PyTree

from ..parts import Scalar
from .box import BoxLevenbergMarquardt, BoxState, stalled, widths
from .certificate import Solution, Status, certify
from .model import pull
from .penalty import Duals, Problem
from .values import Values


RAISE = 10.0  # factor on the penalty of a constraint that does not improve
IMPROVED = 0.1  # a constraint improves if its error falls below this share
LARGEST = 1e8  # penalties and multipliers over the first penalty: above, rounding reigns
LOOSE = 0.1  # first inner tolerance, and the factor by which it tightens
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
    status: Int[Array, ""]
    """Whether it is over, and how; negative while it is not."""


def outer_step(
    problem: Problem,
    x: PyTree,
    state: BoxState,
    outer: Outer,
    goal: float,
    max_inner: int,
) -> tuple[BoxState, Outer]:
    """Judge the present point; renew multipliers, penalties and tolerance if it is time.

    Args:
        problem: The order of the values, and the box.
        x: The present point.
        state: What is known there.
        outer: How the outer loop stood.
        goal: Tolerance, as `solve` describes it.
        max_inner: Trial points after which the multipliers change in any case.

    Returns:
        Both states. The first only has its trust region widened and, where the objective
        comes or goes, its curvature forgotten.
    """
    duals, feasible = outer.duals, tolerable(goal, state.values)
    _, constraints, hinged = problem.split(state.values)
    scaled, breach = constraints / duals.scale, problem.breach(state.values, duals)
    pulls = pull(lambda values: problem.weigh(values, duals), state.values)
    multiplier = pulls[problem.residuals :] * duals.scale
    violation = jnp.max(jnp.abs(breach), initial=0.0)
    slack = jnp.where(hinged, jnp.minimum(multiplier, -scaled), 0.0)
    size = jnp.maximum(state.magnitude, 1.0)

    numbers = jnp.all(jnp.isfinite(state.values)) & jnp.all(jnp.isfinite(state.jacobian))
    lost = ~numbers | (stalled(state) & ~state.finite)
    stationary = jnp.maximum(state.optimality, jnp.max(slack, initial=0.0)) <= goal * size
    solved = ~duals.restoring & stationary & (violation <= feasible)
    spent = outer.inner + 1 >= max_inner

    # the inner problem is solved: better multipliers, larger penalties where needed
    renew = (state.optimality <= outer.loose * size) | stalled(state) | spent
    renew = renew & ~duals.restoring & ~solved & ~lost
    error = jnp.maximum(scaled, -duals.multiplier / duals.penalty)
    error = jnp.abs(jnp.where(hinged, error, scaled))
    improved = (error <= IMPROVED * outer.error) | (error <= feasible)
    raised = jnp.where(improved, duals.penalty, RAISE * duals.penalty)
    most = LARGEST * outer.penalty
    halved = (violation <= 0.5 * outer.violation) | (violation <= feasible)
    failures = jnp.where(renew, jnp.where(halved, 0, outer.failures + 1), outer.failures)

    # or the violation has stopped falling: look at it alone, until that is settled
    slope = state.jacobian[problem.residuals :].T @ (breach / duals.scale)
    cornered = problem.descent(x, slope) <= 0.1 * violation
    restore = renew & cornered & (failures >= PATIENCE)
    found = duals.restoring & (violation <= feasible)
    bottom = (state.optimality <= goal * violation) | stalled(state)
    least = duals.restoring & ~found & bottom

    multiplier = jnp.clip(jnp.where(renew, multiplier, duals.multiplier), -most, most)
    penalty = jnp.where(renew, jnp.minimum(raised, most), duals.penalty)
    tighter = jnp.minimum(LOOSE * outer.loose, jnp.max(error, initial=0.0))
    loose = jnp.where(renew, jnp.maximum(tighter, goal), outer.loose)
    duals = Duals(
        scale=duals.scale,
        multiplier=jnp.where(found, 0.0, multiplier),
        penalty=jnp.where(found, RAISE * outer.penalty, penalty),
        restoring=(duals.restoring & ~found) | restore,
    )
    new_problem = renew | found
    new_curvature = restore | found
    state = eqx.tree_at(
        lambda s: (s.radius, s.curvature),
        state,
        (
            jnp.where(new_problem, jnp.maximum(state.radius, RADIUS), state.radius),
            jnp.where(new_curvature, 0.0, state.curvature),
        ),
    )
    status = jnp.where(outer.duals.restoring & spent, Status.WORK_LIMIT.value, -1)
    status = jnp.where(least, Status.INFEASIBLE.value, status)
    status = jnp.where(solved, Status.SOLVED.value, status)
    return state, Outer(
        duals=duals,
        pulls=pulls,
        penalty=outer.penalty,
        loose=jnp.where(found, LOOSE, loose),
        error=jnp.where(renew, error, outer.error),
        violation=jnp.where(renew, violation, outer.violation),
        failures=jnp.where(found, 0, failures),
        inner=jnp.where(new_problem, 0, outer.inner + 1),
        steps=outer.steps + jnp.where(new_problem, 1, 0),
        status=jnp.where(lost, Status.NOT_A_NUMBER.value, status),
    )


def solve(
    residual: Callable[..., PyTree],
    inequality: Callable[..., PyTree] | None,
    start: PyTree,
    lower: PyTree,
    upper: PyTree,
    *,
    equality: Callable[..., PyTree] | None = None,
    args: PyTree = None,
    tolerance: float | None = None,
    max_outer: int = 20,
    max_inner: int = 40,
    solver: BoxLevenbergMarquardt | None = None,
) -> Solution:
    """The least-squares solution under inequalities, equalities and bounds.

    Functions are called as `f(x, args)`, or as `f(x)` if `args` is None, and never outside
    the bounds. The whole is one `while_loop`: put `jit` and `vmap` around it as you like.
    It raises nothing; `status` says how it went.

    Args:
        residual: Residuals of size about one, a pytree of arrays; or all three parts of
            the problem from one evaluation, as `Values`, the other two then being None.
        inequality: Quantities that must not be positive, a pytree; None for none.
        start: First guess, a pytree of floats; moved onto the box if it lies outside.
        lower: Lower bounds, of the same structure; may be infinite, may equal `upper`.
        upper: Upper bounds.
        equality: Quantities that must vanish, a pytree; None for none.
        args: Passed on to the three functions.
        tolerance: Bound on the projected gradient over the size of the terms that cancel
            in it, per width of the box; a thousandth of it bounds the scaled violation.
            None: half the root of the rounding unit, 7e-9 in double precision.
        max_outer: Most changes of the multipliers.
        max_inner: Most trial points between two changes.
        solver: Another `BoxLevenbergMarquardt`, say with another `norm`.

    Returns:
        The last point, with its certificate.

    Source: Birgin & Martinez (2014), Practical augmented Lagrangian methods, algorithm 4.1.
    """
    solver = BoxLevenbergMarquardt() if solver is None else solver
    start = jax.tree.map(as_float, start)
    lower, upper = like(start, lower), like(start, upper)
    start = jax.tree.map(jnp.clip, start, lower, upper)
    point, unravel = ravel_pytree(start)
    low, high = ravel_pytree(lower)[0], ravel_pytree(upper)[0]
    epsilon = float(jnp.finfo(point.dtype).eps)
    goal = 0.5 * epsilon**0.5 if tolerance is None else tolerance

    def functions(x, _):
        given = () if args is None else (args,)
        first = residual(x, *given)
        if isinstance(first, Values):
            parts = (first.residual, first.inequality, first.equality)
        else:
            rest = (inequality, equality)
            parts = (first, *(None if f is None else f(x, *given) for f in rest))
        return jax.tree.map(as_float, parts), None

    shapes, _ = jax.eval_shape(functions, start, None)
    zeros = jax.tree.map(lambda s: jnp.zeros(s.shape, point.dtype), shapes)
    blank, sort = ravel_pytree(zeros)
    sizes = [sum(leaf.size for leaf in jax.tree.leaves(part)) for part in shapes]
    width = widths(point, low, high)
    problem = Problem(sizes[0], sizes[1], low, high, width, unravel, sort)
    options = {
        "lower": lower,
        "upper": upper,
        "scale": unravel(width),
        "weigh": problem.weigh,
    }

    def turn(carry):
        x, state, outer, count = carry
        x, state, _ = solver.step(functions, x, outer.duals, options, state, frozenset())
        fresh, penalty = problem.first(state)
        opened = eqx.tree_at(lambda o: (o.duals, o.penalty), outer, (fresh, penalty))
        outer = jax.tree.map(lambda a, b: jnp.where(count == 0, a, b), opened, outer)
        state = solver.measured(x, outer.duals, options, state)
        state, outer = outer_step(problem, x, state, outer, goal, max_inner)
        return x, state, outer, count + 1

    none, one = problem.split(blank)[1], jnp.ones((), point.dtype)
    outer = Outer(
        duals=Duals(none + 1, none, none + 1, jnp.array(False)),
        pulls=blank,
        penalty=one,
        loose=LOOSE * one,
        error=none + jnp.inf,
        violation=jnp.inf * one,
        failures=jnp.array(0),
        inner=jnp.array(-1),
        steps=jnp.array(0),
        status=jnp.array(-1),
    )
    state = solver.init(functions, start, None, options, shapes, None, frozenset())
    x, state, outer, count = jax.lax.while_loop(
        lambda carry: (carry[2].status < 0) & (carry[2].steps < max_outer),
        turn,
        (start, state, outer, jnp.array(0)),
    )
    status = jnp.where(outer.status < 0, Status.WORK_LIMIT.value, outer.status)
    counts = (outer.steps, count - 1, count)
    return certify(problem, x, state, outer.duals, outer.pulls, goal, counts, status)


def tolerable(goal: float, values: Float[Array, " m"]) -> float:
    """Largest scaled violation of a feasible point: well below the tolerance."""
    return max(1e-3 * goal, 100 * float(jnp.finfo(values.dtype).eps))


def as_float(leaf) -> Float[Array, "..."]:
    """A leaf as a strongly typed array of floats, of its own precision if it has one."""
    leaf = jnp.asarray(leaf)
    kind = leaf.dtype if jnp.issubdtype(leaf.dtype, jnp.floating) else float
    return jnp.asarray(leaf, dtype=kind)


def like(start: PyTree, bound: PyTree) -> PyTree:
    """Bounds in the types and shapes of the start."""
    return jax.tree.map(
        lambda s, b: jnp.broadcast_to(jnp.asarray(b, s.dtype), s.shape), start, bound
    )
