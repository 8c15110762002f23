"""Penalty: the user's problem as the least-squares problem of one outer step.

Residuals, inequalities and equalities travel as one flat vector of values in the user's
units; scales, multipliers and penalties turn it into rows whose squares are summed.
"""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, PyTree

from ..parts import Scalar
from .box import BoxState
from .model import positive, projected


PENALTY = 10.0  # first penalty, over the objective's steepness or curvature at the start


class Duals(eqx.Module):
    """What makes an inner problem of the user's functions."""

    scale: Float[Array, " c"]
    """Size of each constraint's gradient at the start."""
    multiplier: Float[Array, " c"]
    """Multipliers of the scaled constraints, lambda and nu."""
    penalty: Float[Array, " c"]
    """Penalties of the scaled constraints, mu."""
    restoring: Bool[Array, ""]
    """Whether only the violation counts."""


class Problem(eqx.Module):
    """How the user's problem lies in flat vectors, and the box.

    Values stand in the order residuals, inequalities, equalities.
    """

    residuals: int = eqx.field(static=True)
    inequalities: int = eqx.field(static=True)
    lower: Float[Array, " n"]
    upper: Float[Array, " n"]
    width: Float[Array, " n"]
    place: Callable[[Float[Array, " n"]], PyTree] = eqx.field(static=True)
    """From flat unknowns to the user's structure."""
    sort: Callable[[Float[Array, " m"]], tuple] = eqx.field(static=True)
    """From flat values to the user's three structures."""

    def split(self, values):
        """Residuals, constraints, and which of the constraints are inequalities."""
        constraints = values[self.residuals :]
        return values[: self.residuals], constraints, self.hinged(constraints)

    def hinged(self, constraints) -> Bool[Array, " c"]:
        """Which of the constraints are inequalities."""
        return jnp.arange(constraints.size) < self.inequalities

    def weigh(self, values: Float[Array, " m"], duals: Duals) -> Float[Array, " m"]:
        """Residuals of the inner problem."""
        plain, constraints, hinged = self.split(values)
        scaled, root = constraints / duals.scale, jnp.sqrt(duals.penalty)
        rows = jnp.where(duals.restoring, scaled, root * scaled + duals.multiplier / root)
        plain = jnp.where(duals.restoring, 0.0, plain)
        return jnp.concatenate([plain, jnp.where(hinged & (rows < 0), 0.0, rows)])

    def breach(self, values: Float[Array, " m"], duals: Duals) -> Float[Array, " c"]:
        """Scaled constraints as far as they are violated."""
        _, constraints, hinged = self.split(values)
        return jnp.where(hinged & (constraints < 0), 0.0, constraints) / duals.scale

    def descent(self, x: PyTree, gradient: Float[Array, " n"]) -> Scalar:
        """Largest entry of the step of steepest descent in the box, in its widths."""
        place = ravel_pytree(x)[0] / self.width
        lower, upper = self.lower / self.width, self.upper / self.width
        return jnp.max(jnp.abs(projected(place, gradient, lower, upper)))

    def first(self, state: BoxState) -> tuple[Duals, Scalar]:
        """Scales and penalties, from the values and slopes at the start."""
        plain, constraints, _ = self.split(state.values)
        free = jnp.where(self.upper > self.lower, 1.0, 0.0)
        jacobian = state.jacobian * free[None, :]
        slope = jnp.max(jnp.abs(jacobian[self.residuals :]), axis=1)
        # a constraint that is flat at the start, or saturated there, has its size for scale
        scale = positive(jnp.maximum(slope, 1e-2 * jnp.abs(constraints)))
        duals = Duals(
            scale=scale,
            multiplier=jnp.zeros_like(scale),
            penalty=jnp.ones_like(scale),
            restoring=jnp.array(False),
        )
        jacobian = jacobian[: self.residuals]
        steep = jnp.maximum(jnp.sum(jacobian**2), jnp.max(jnp.abs(plain @ jacobian)))
        # far from the feasible set the steepness says little: there, balance the two sums
        objective = jnp.maximum(1.0, 0.5 * jnp.sum(plain**2))
        violation = 0.5 * jnp.sum(self.breach(state.values, duals) ** 2)
        balance = jnp.where(violation > 0, objective / positive(violation), jnp.inf)
        penalty = PENALTY * jnp.minimum(positive(steep), balance)
        return eqx.tree_at(
            lambda d: d.penalty, duals, jnp.full_like(scale, penalty)
        ), penalty
