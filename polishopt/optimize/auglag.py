r"""Auglag: constrained least squares and minimisation, with a certificate.

$$\min_{l \le x \le u} f(x) + \tfrac12 |r(x)|^2 \ \text{with}\ g(x) \le 0,\ h(x) = 0$$

The augmented Lagrangian of Powell, Hestenes and Rockafellar turns this into a series of
problems without constraints,
$f + \tfrac12 |r|^2 + \tfrac\mu2 |(g + \lambda/\mu)_+|^2 + \tfrac\mu2 |h + \nu/\mu|^2$,
whose multipliers are then improved by $\lambda \leftarrow (\lambda + \mu g)_+$,
$\nu \leftarrow \nu + \mu h$. Every constraint has a penalty $\mu$ of its own, raised only
while that constraint does not improve, and a scale of its own, its gradient at the start,
so that its unit of measure does not matter. Residuals are used as they are: give them a
size of about one.

The loop is flat: a turn is one trial point (`walk`, `box`), and where the inner problem is
solved well enough the multipliers change on the spot, without a new evaluation (`outer`).
Under `vmap` no start waits for another one's inner problem. Other solvers of optimistix may
take the place of `box`; then a turn is one of their solves (`adapted`).

Where nothing is feasible near, the answer is a point of least violation and says so. The
answer can be differentiated, by the implicit function theorem (`implicit`).
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Float, PyTree

from .adapted import CROSSOVER, ROUNDS, Adapted
from .box import BoxLevenbergMarquardt, slopes
from .certificate import Solution
from .implicit import tangent
from .penalty import Problem
from .values import Values
from .walk import Rules, ended, over, problem_of, proposed, set_out, taken_in


Solver = optx.AbstractLeastSquaresSolver | optx.AbstractMinimiser


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
    solver: Solver | None = None,
    unit: tuple[PyTree, PyTree] | None = None,
) -> Solution:
    """The least-squares solution under inequalities, equalities and bounds.

    Functions are called as `f(x, args)`, or as `f(x)` if `args` is None, and never outside
    the bounds. The whole is one `while_loop`: put `jit`, `vmap`, `jvp` and `grad` around it
    as you like. It raises nothing; `status` says how it went.

    Args:
        residual: Residuals of size about one, a pytree of arrays; or all parts of the
            problem from one evaluation, as `Values`, the next two then being None.
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
        solver: None for `BoxLevenbergMarquardt()`; or any least-squares solver or
            minimiser of optimistix. All but the first reach the box through a map of it,
            and take many more evaluations. Their own tolerances are set by the outer loop,
            and the first one finds the last digits.
        unit: What one unit of violation is for each constraint where no point is feasible
            and the sum of its squares is made least: a pair of pytrees like `inequality`
            and `equality`; None: one of the constraint's own units.

    Returns:
        The last point, with its certificate. Its derivatives with respect to all that the
        functions depend on, and the bounds, are those of the optimum.

    Source: Birgin & Martinez (2014), Practical augmented Lagrangian methods, algorithm 4.1.
    """
    parts = _gathered(residual, inequality, equality, args, "residual")
    options = _Options(solver, Rules(tolerance, max_outer, max_inner))
    return _prepared(parts, start, lower, upper, unit, options)


def minimise(
    objective: Callable[..., PyTree],
    inequality: Callable[..., PyTree] | None,
    start: PyTree,
    lower: PyTree,
    upper: PyTree,
    *,
    equality: Callable[..., PyTree] | None = None,
    args: PyTree = None,
    tolerance: float | None = None,
    max_outer: int = 20,
    max_inner: int = 60,
    solver: Solver | None = None,
    unit: tuple[PyTree, PyTree] | None = None,
) -> Solution:
    """The least objective under inequalities, equalities and bounds.

    As `solve`, for an objective that is no sum of squares. Without `solver`, curvature is
    learned from one step to the next; `optimistix.BFGS(...)` is another choice.

    Args:
        objective: What is made small, a scalar or a pytree to be summed; or all parts of
            the problem from one evaluation, as `Values`, the next two then being None.
        inequality: As in `solve`.
        start: As in `solve`.
        lower: As in `solve`.
        upper: As in `solve`.
        equality: As in `solve`.
        args: As in `solve`.
        tolerance: As in `solve`.
        max_outer: As in `solve`.
        max_inner: As in `solve`.
        solver: As in `solve`, but a minimiser.
        unit: As in `solve`.

    Returns:
        The last point, with its certificate, as from `solve`.

    Raises:
        ValueError: if the solver is one for least squares only.
    """
    parts = _gathered(objective, inequality, equality, args, "objective")
    options = _Options(solver, Rules(tolerance, max_outer, max_inner))
    return _prepared(parts, start, lower, upper, unit, options)


class _Options(eqx.Module):
    """How to solve; nothing of it is differentiated."""

    solver: Any
    rules: Rules


def _gathered(first, inequality, equality, args, role):
    """The user's functions as one, which returns the four parts of `Values`."""
    given = () if args is None else (args,)

    def parts(x):
        value = first(x, *given)
        if not isinstance(value, Values):
            rest = (None if f is None else f(x, *given) for f in (inequality, equality))
            held = dict(zip(("inequality", "equality"), rest, strict=True))
            value = Values(**{role: value}, **held)
        return jax.tree.map(as_float, value.parts())

    return parts


def _prepared(parts, start, lower, upper, unit, options: _Options) -> Solution:
    """The solution, after everything has its type and shape."""
    start = jax.tree.map(as_float, start)
    lower, upper = like(start, lower), like(start, upper)
    start = jax.tree.map(jnp.clip, start, lower, upper)
    # what the functions close over becomes an input, so that it can be differentiated
    parts = eqx.filter_closure_convert(parts, start)
    _, objective, inequality, equality = jax.eval_shape(parts, start)
    if objective is not None and not isinstance(
        options.solver, optx.AbstractMinimiser | BoxLevenbergMarquardt | None
    ):
        raise ValueError(
            f"`solver` is {type(options.solver).__name__}, which knows least squares only, "
            f"must be a minimiser or None where there is an objective."
        )
    ones = (None, None) if unit is None else unit
    unit = tuple(
        like(part, 1.0 if one is None else one)
        for part, one in zip((inequality, equality), ones, strict=True)
    )
    return _answer(parts, (lower, upper), start, unit, options=options)


def _problem(parts, box, start, unit) -> Problem:
    """The order of the flat values."""
    lower, upper = box
    return problem_of(jax.eval_shape(parts, start), start, lower, upper, unit)


@eqx.filter_custom_jvp
def _answer(parts, box, start, unit, *, options: _Options) -> Solution:
    """The loop, on one function of the unknowns."""
    problem, rules = _problem(parts, box, start, unit), options.rules
    other, solver = None, options.solver
    if solver is not None and not isinstance(solver, BoxLevenbergMarquardt):
        other = Adapted(solver, problem, rules.max_inner)

    def turn(walk):
        most = None
        if other is not None:
            most = jnp.where(walk.outer.loose < CROSSOVER, rules.max_inner, ROUNDS)
        values, columns, _ = slopes(lambda x: (parts(x), None), walk.trial.y, problem.width)
        walk = taken_in(problem, rules, walk, values, columns, most)
        if other is None:
            return proposed(problem, rules, walk)
        skip = (walk.outer.loose < CROSSOVER) | over(rules, walk)
        x, state, spent = other.inner(parts, walk.x, walk.outer, walk.state, skip)
        walk = eqx.tree_at(lambda w: (w.x, w.state), walk, (x, state))
        return proposed(problem, rules, walk, spent)

    walk = jax.lax.while_loop(
        lambda walk: ~over(rules, walk), turn, set_out(problem, start)
    )
    return ended(problem, rules, walk)


@_answer.def_jvp
def _answer_jvp(primals, tangents, *, options: _Options):
    """Values by the loop, derivatives from the conditions that hold at its end."""
    parts, box, start, unit = primals
    solution = _answer(parts, box, start, unit, options=options)
    problem = _problem(parts, box, start, unit)
    return solution, tangent(problem, parts, box, solution, tangents[0], tangents[1])


def as_float(leaf) -> Float[Array, "..."]:
    """A leaf as a strongly typed array of floats, of its own precision if it has one."""
    leaf = jnp.asarray(leaf)
    kind = leaf.dtype if jnp.issubdtype(leaf.dtype, jnp.floating) else float
    return jnp.asarray(leaf, dtype=kind)


def like(start: PyTree, bound: PyTree) -> PyTree:
    """Bounds in the types and shapes of the start; one number serves for all of them."""
    if isinstance(bound, int | float):
        bound = jax.tree.map(lambda _: bound, start)
    return jax.tree.map(
        lambda s, b: jnp.broadcast_to(jnp.asarray(b, s.dtype), s.shape), start, bound
    )
