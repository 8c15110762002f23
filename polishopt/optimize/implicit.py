r"""Implicit: how an optimum moves with everything the problem depends on.

The conditions of Karush, Kuhn and Tucker hold at the optimum, whatever the problem's
constants $\theta$ and bounds are; so by the implicit function theorem their derivative
along the optimum vanishes,

$$\begin{pmatrix} H & J_A^T \\ J_A & 0 \end{pmatrix}
\begin{pmatrix} \dot x \\ \dot\lambda \end{pmatrix} =
-\begin{pmatrix} \partial_\theta \nabla L \\ \partial_\theta c_A \end{pmatrix} \dot\theta,$$

with the Hessian $H$ of the Lagrangian $L$ and the constraints $A$ that hold with equality
and push (a multiplier above zero). Unknowns on a bound that pushes move with the bound. At
a point of least violation, the conditions are those of the sum of squared violations.

The derivative is that of the settings of $A$ at the answer: where a limit is just touched
it has two sides, and this is the side on which the limit stays without force. Where a
family of points is optimal it is the shortest move, in widths of the box and scales of the
constraints. It says nothing about another basin that might become the better one.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from .certificate import Solution, Status
from .model import positive
from .penalty import Problem


CUT = 10.0  # share of the largest singular value that counts as none, in root epsilons
PUSH = 1e3  # least multiplier of an active limit, in units of the solution's residual


def tangent(
    problem: Problem, parts, box, solution: Solution, parts_dot, box_dot
) -> Solution:
    """The derivative of a solution along a change of its problem.

    Args:
        problem: The order of the values.
        parts: The user's functions as one, a pytree of what they depend on.
        box: Lower and upper bounds.
        solution: Where the problem as it is has its optimum.
        parts_dot: The change of `parts`; None for leaves that stay.
        box_dot: The change of the bounds.

    Returns:
        The changes of x, values, multipliers and objective; None for the rest, which
        does not change smoothly or not at all.
    """
    width, count = problem.width, problem.lower.size
    point, _ = ravel_pytree(solution.x)
    dtype = point.dtype
    cut = CUT * float(jnp.finfo(dtype).eps) ** 0.5
    infeasible = solution.status == Status.INFEASIBLE

    def values(parts, x):
        return ravel_pytree(parts(problem.place(x)))[0].astype(dtype)

    def gradient(parts, x, m):
        def lagrangian(x):
            found = values(parts, x)
            squares = 0.5 * jnp.sum((problem.excess(found) / problem.unit) ** 2)
            plain = problem.objective(found) + m @ found[problem.plain :]
            return jnp.where(infeasible, squares, plain)

        return jax.jacfwd(lagrangian)(x)

    push, _ = ravel_pytree(solution.bound_multipliers)
    fixed = problem.lower == problem.upper
    held, at_upper = push != 0, ~fixed & (push > 0)
    multiplier = ravel_pytree(
        (solution.inequality_multipliers, solution.equality_multipliers)
    )[0].astype(dtype)
    slopes = jax.jacfwd(lambda x: values(parts, x)[problem.plain :])(point)
    slopes = slopes * width[None, :]
    scale = positive(jnp.max(jnp.abs(slopes), axis=1))
    force = multiplier * scale
    some = PUSH * cut**2 * jnp.max(jnp.abs(force), initial=0.0)
    active = ~infeasible & (~problem.hinged() | (force > some))

    def conditions(parts, box, z):
        x, m = point + width * z[:count], multiplier + z[count:] / scale
        lower, upper = (ravel_pytree(bound)[0] for bound in box)
        rest = jnp.where(at_upper, x - upper, x - lower) / width
        still = jnp.where(held | fixed, rest, width * gradient(parts, x, m))
        found = values(parts, x)
        weight = m - problem.excess(found) / problem.unit**2
        idle = jnp.where(infeasible, weight, m) * scale
        return jnp.concatenate(
            [still, jnp.where(active, found[problem.plain :] / scale, idle)]
        )

    zero = jnp.zeros(count + problem.constraints, dtype)
    matrix = jax.jacfwd(lambda z: conditions(parts, box, z))(zero)
    # rows of the gradient, and multipliers, in units of the Hessian
    size = positive(jnp.max(jnp.abs(matrix[:count, :count])))
    ours = jnp.arange(zero.size) < count
    still = jnp.concatenate([held | fixed, jnp.ones_like(scale, dtype=bool)])
    rows = jnp.where(still, 1.0, 1 / size)
    rows = jnp.where(~ours & ~jnp.concatenate([held, active]), 1 / size, rows)
    columns = jnp.where(ours, 1.0, size)
    inverse = jnp.linalg.pinv(rows[:, None] * matrix * columns[None, :], rtol=cut)
    inverse = columns[:, None] * inverse * rows[None, :]
    _, drift = eqx.filter_jvp(
        lambda parts, box: conditions(parts, box, zero), (parts, box), (parts_dot, box_dot)
    )
    z_dot = -inverse @ drift
    x_dot, m_dot = width * z_dot[:count], z_dot[count:] / scale

    def outcome(parts, x, m):
        found = values(parts, x)
        residual, _, inequality, equality = problem.sort(found)
        return (
            residual,
            inequality,
            equality,
            problem.sort(jnp.concatenate([found[: problem.plain], m]))[2:],
            problem.place(jnp.where(held | fixed, -gradient(parts, x, m), 0.0)),
            problem.objective(found),
        )

    _, moved = eqx.filter_jvp(
        outcome, (parts, point, multiplier), (parts_dot, x_dot, m_dot)
    )
    names = (
        "residual",
        "inequality",
        "equality",
        ("inequality_multipliers", "equality_multipliers"),
        "bound_multipliers",
        "objective",
    )
    found = {"x": problem.place(x_dot)}
    for name, part in zip(names, moved, strict=True):
        found |= (
            {name: part} if isinstance(name, str) else dict(zip(name, part, strict=True))
        )
    other = dataclasses.replace(solution, **found)
    # what was not replaced does not move: that is None, for equinox
    return jax.tree.map(lambda a, b: None if a is b else a, other, solution)
