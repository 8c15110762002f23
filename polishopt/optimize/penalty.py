"""Penalty: the user's problem as the problem without constraints of one outer step.

Residuals, objective, inequalities and equalities travel as one flat vector of values in the
user's units; scales, multipliers and penalties turn it into rows whose squares are summed,
and the objective is added as it stands.
"""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, PyTree

from ..parts import Scalar
from .box import BoxState
from .model import Merit, positive, projected


LARGEST = 1e8  # penalties and multipliers over the first penalty
LEEWAY = 1e-2  # first leeway, in lengths of the unknowns
PENALTY = 10.0  # first penalty, over the objective's steepness or curvature at the start


class Duals(eqx.Module):
    """What makes an inner problem of the user's functions."""

    scale: Float[Array, " c"]
    """Size of each constraint's gradient at the start."""
    multiplier: Float[Array, " c"]
    """Multipliers of the scaled constraints, lambda and nu."""
    penalty: Float[Array, " c"]
    """Penalties of the scaled constraints, mu."""
    most: Scalar
    """Largest penalty and multiplier: above, rounding reigns."""
    leeway: Scalar
    """Scaled violation that is left to the multipliers; see `steering`."""
    restoring: Bool[Array, ""]
    """Whether only the violation counts."""
    measuring: Bool[Array, ""]
    """Whether it then counts in the user's units, not in the scaled ones."""


class Problem(eqx.Module):
    """How the user's problem lies in flat vectors, and the box.

    Values stand in the order residuals, objectives, inequalities, equalities.
    """

    residuals: int = eqx.field(static=True)
    objectives: int = eqx.field(static=True)
    inequalities: int = eqx.field(static=True)
    constraints: int = eqx.field(static=True)
    """Inequalities and equalities."""
    unit: Float[Array, " c"]
    """What one unit of violation is, where the violation is all that counts."""
    lower: Float[Array, " n"]
    upper: Float[Array, " n"]
    width: Float[Array, " n"]
    place: Callable[[Float[Array, " n"]], PyTree] = eqx.field(static=True)
    """From flat unknowns to the user's structure."""
    sort: Callable[[Float[Array, " m"]], tuple] = eqx.field(static=True)
    """From flat values to the user's four structures."""

    @property
    def plain(self) -> int:
        """How many values are no constraints."""
        return self.residuals + self.objectives

    def split(self, values):
        """What is no constraint, constraints, and which of these are inequalities."""
        constraints = values[self.plain :]
        return values[: self.plain], constraints, self.hinged()

    def hinged(self) -> Bool[Array, " c"]:
        """Which of the constraints are inequalities."""
        return jnp.arange(self.constraints) < self.inequalities

    def merit(self, duals: Duals) -> Merit:
        r"""What the inner problem makes small.

        Half the squares of the residuals and of $\sqrt\mu\,c/s + \lambda/\sqrt\mu$, as far
        as positive where c is an inequality, and the objectives as they are; while
        restoring, of the violations $c/s$ alone.

        Args:
            duals: Scales s, multipliers $\lambda$, penalties $\mu$.
        """
        dtype = duals.scale.dtype
        # 1 for the residuals, and 1 for the objectives, among what is no constraint
        squared, single = (
            jnp.asarray(row, dtype)
            for row in np.eye(2).repeat([self.residuals, self.objectives], axis=1)
        )
        counts = jnp.where(duals.restoring, 0.0, jnp.ones((), dtype))
        root = jnp.where(duals.restoring, 1.0, jnp.sqrt(duals.penalty))
        zero = jnp.zeros_like(squared)

        def joined(plain, constraints):
            return jnp.concatenate([plain, constraints])

        return Merit(
            gain=joined(counts * squared, root / self.measure(duals)),
            offset=joined(zero, counts * duals.multiplier / root),
            hinged=joined(zero > 0, self.hinged()),
            lead=joined(counts * single, jnp.zeros_like(root)),
        )

    def measure(self, duals: Duals) -> Float[Array, " c"]:
        """What a violation of one is at present, in the units of each constraint."""
        return jnp.where(duals.measuring, self.unit, duals.scale)

    def excess(self, values: Float[Array, " m"]) -> Float[Array, " c"]:
        """Constraints as far as they are violated, in their units."""
        _, constraints, hinged = self.split(values)
        return jnp.where(hinged & (constraints < 0), 0.0, constraints)

    def breach(self, values: Float[Array, " m"], duals: Duals) -> Float[Array, " c"]:
        """Scaled constraints as far as they are violated."""
        return self.excess(values) / duals.scale

    def objective(self, values: Float[Array, " m"]) -> Scalar:
        """Half the sum of squares of the residuals, and the objective."""
        squares = 0.5 * jnp.sum(values[: self.residuals] ** 2)
        return squares + jnp.sum(values[self.residuals : self.plain])

    def descent(self, x: PyTree, gradient: Float[Array, " n"]) -> Scalar:
        """Largest entry of the step of steepest descent in the box, in its widths."""
        place = ravel_pytree(x)[0] / self.width
        lower, upper = self.lower / self.width, self.upper / self.width
        return jnp.max(jnp.abs(projected(place, gradient, lower, upper)))

    def first(self, state: BoxState) -> tuple[Duals, Scalar]:
        """Scales and penalties, from the values and slopes at the start."""
        _, constraints, _ = self.split(state.values)
        residual = state.values[: self.residuals]
        free = jnp.where(self.upper > self.lower, 1.0, 0.0)
        jacobian = state.jacobian * free[None, :]
        slope = jnp.max(jnp.abs(jacobian[self.plain :]), axis=1)
        # a constraint that is flat at the start, or saturated there, has its size for scale
        scale = positive(jnp.maximum(slope, 1e-2 * jnp.abs(constraints)))
        duals = Duals(
            scale=scale,
            multiplier=jnp.zeros_like(scale),
            penalty=jnp.ones_like(scale),
            most=jnp.ones((), scale.dtype),
            leeway=jnp.full((), LEEWAY, scale.dtype),
            restoring=jnp.array(False),
            measuring=jnp.array(False),
        )
        rows, single = jacobian[: self.residuals], jacobian[self.residuals : self.plain]
        slope = residual @ rows + jnp.sum(single, axis=0)
        steep = jnp.maximum(jnp.sum(rows**2), jnp.max(jnp.abs(slope)))
        # far from the feasible set the steepness says little: there, balance the two sums
        objective = jnp.maximum(1.0, jnp.abs(self.objective(state.values)))
        violation = 0.5 * jnp.sum(self.breach(state.values, duals) ** 2)
        balance = jnp.where(violation > 0, objective / positive(violation), jnp.inf)
        penalty = PENALTY * jnp.minimum(positive(steep), balance)
        penalties = jnp.full_like(scale, penalty), LARGEST * penalty
        return eqx.tree_at(lambda d: (d.penalty, d.most), duals, penalties), penalty
