r"""Uncertainty: how far the errors of constants make the outcomes scatter.

To first order the variance of an outcome $y$ is $\sum_i (\partial y/\partial c_i)^2
\sigma_i^2$, a share for each constant $c_i$; derivatives are exact, by forward-mode
differentiation of the whole chain. Errors are taken as independent: a config holds no
correlations.
"""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..chain import Outcome, polish
from ..constants import START, part, with_constants
from ..parts import Process, Scalar
from ..plan import Plan, PlanOutcome, follow
from ..setup import Setup


OUTCOMES = (
    "Sa",
    "Sq",
    "Ssk",
    "Sku",
    "force_max",
    "unstick_margin",
    "shear_margin",
    "mean_removal",
    "time",
)


class Spread(eqx.Module):
    """How outcomes (rows) scatter with constants (columns)."""

    outcomes: tuple[str, ...] = eqx.field(static=True)
    """Names of the rows."""
    constants: tuple[str, ...] = eqx.field(static=True)
    """Names of the columns."""
    errors: Float[Array, " columns"]
    """Standard errors of the constants [mm, N, s, rad]."""
    slopes: Float[Array, "rows columns"]
    """Change of the outcome per unit of the constant [mm, N, s, rad]."""

    @property
    def deviations(self) -> Float[Array, " rows"]:
        """Standard deviation of each outcome [mm, N, s]."""
        return jnp.linalg.norm(self.slopes * self.errors[None, :], axis=1)

    @property
    def shares(self) -> Float[Array, "rows columns"]:
        """Share of each constant in the variance of each outcome; 0 where there is none."""
        squares = (self.slopes * self.errors[None, :]) ** 2
        total = jnp.sum(squares, axis=1, keepdims=True)
        return jnp.where(total > 0, squares / jnp.where(total > 0, total, 1.0), 0.0)


def spread(
    process: Process,
    setup: Setup,
    outcomes: Sequence[str] = OUTCOMES,
    chain: Callable[[Process, Setup], Outcome] = polish,
) -> Spread:
    """How the outcomes of one step scatter with the errors that its setup gives.

    Args:
        process: The settings.
        setup: The job, with its errors.
        outcomes: Names of scalars of `Outcome`.
        chain: Another model of the process, of the same form as `polish`.

    Source: first-order propagation of errors (JCGM 100:2008, Eq. 10).
    """
    names = tuple(setup.errors)

    def reached(values):
        made = with_constants(setup, dict(zip(names, values, strict=True)))
        # jitted like anywhere else, it is not traced again
        outcome = eqx.filter_jit(chain)(process, made)
        return jnp.stack([getattr(outcome, name) for name in outcomes])

    values = jnp.stack([part(setup, name) for name in names])
    return Spread(
        outcomes=tuple(outcomes),
        constants=names,
        errors=jnp.stack(list(setup.errors.values())),
        slopes=jax.jacfwd(reached)(values),
    )
