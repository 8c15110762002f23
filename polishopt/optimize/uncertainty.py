r"""Uncertainty: how far the errors of constants make the outcomes scatter.

To first order the variance of an outcome $y$ is $\sum_i (\partial y/\partial c_i)^2
\sigma_i^2$, a share for each constant $c_i$; derivatives are exact, by forward-mode
differentiation of the whole chain. Errors are taken as independent: a config holds no
correlations.
"""

from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..chain import Outcome, polish
from ..constants import part, with_constants
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


def one_by_one(plan: Plan) -> dict[str, dict[int, str]]:
    """The uncertain constants of a plan: for each the steps that have it, and its name.

    A constant of the same name, value and error in several steps is one: what is wrong
    with it in one step is as wrong in the others. All others are independent.

    Args:
        plan: The jobs of the steps, with concrete errors.
    """
    found: dict[tuple[str, float, float], dict[int, str]] = {}
    for i, setup in enumerate(plan.setups):
        for name, error in setup.errors.items():
            same = (name, float(part(setup, name)), float(error))
            found.setdefault(same, {})[i] = name
    result = {}
    for (name, *_), steps in found.items():
        alone = sum(other == name for other, *_ in found) == 1
        where = ", ".join(plan.names[i] for i in steps)
        result[name if alone else f"{where} {name}"] = steps
    return result


def plan_spread(
    processes: Sequence[Process],
    plan: Plan,
    outcomes: Sequence[str] = OUTCOMES,
    chain: Callable[[Sequence[Process], Plan], PlanOutcome] = follow,
) -> tuple[Spread, ...]:
    """How the outcomes of each step scatter with the errors of all steps' constants.

    An error of one step's constant is carried on to what later steps leave.

    Args:
        processes: The settings of each step.
        plan: The jobs of the steps, with their errors; not to be traced.
        outcomes: Names of scalars of `Outcome`.
        chain: Another model of the process, of the same form as `plan.follow`.
    """
    uncertain = one_by_one(plan)
    first = [next(iter(steps.items())) for steps in uncertain.values()]
    values = jnp.stack([part(plan.setups[i], name) for i, name in first])
    errors = jnp.stack([plan.setups[i].errors[name] for i, name in first])
    places = tuple(tuple(steps.items()) for steps in uncertain.values())
    slopes = _plan_slopes(values, tuple(processes), plan, places, tuple(outcomes), chain)
    return tuple(Spread(tuple(outcomes), tuple(uncertain), errors, rows) for rows in slopes)


@eqx.filter_jit
def _plan_slopes(values, processes, plan: Plan, places, outcomes, chain):
    """Derivatives of the outcomes of each step by all constants."""

    def reached(values):
        mine: list[dict[str, Scalar]] = [{} for _ in plan.setups]
        for value, steps in zip(values, places, strict=True):
            for i, name in steps:
                mine[i][name] = value
        made = map(with_constants, plan.setups, mine)
        done = chain(processes, Plan(plan.names, tuple(made)))
        return jnp.stack(
            [jnp.stack([getattr(step, name) for name in outcomes]) for step in done.steps]
        )

    return jax.jacfwd(reached)(values)
