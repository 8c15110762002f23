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
import numpy as np
from jaxtyping import Array, Float

from ..chain import Outcome, polish
from ..constants import part, with_constants
from ..parts import Process, Scalar
from ..plan import Plan, PlanOutcome, follow
from ..setup import Setup
from ..stored import seldom


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


def one_by_one(plan: Plan) -> dict[str, tuple[int, ...]]:
    """The uncertain constants of a plan, each with the steps that have it.

    Steps whose tool is the same in every number have the same tool, so that what is wrong
    with its constants in one step is as wrong in the others; abrasives likewise. All else
    is independent. A name that stands for several constants gets their steps in front.

    Args:
        plan: The jobs of the steps, with concrete numbers.
    """
    found: dict[tuple, list[int]] = {}
    for i, setup in enumerate(plan.setups):
        for name, error in setup.errors.items():
            noun = getattr(setup, name.partition(".")[0])
            numbers = (np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(noun))
            found.setdefault((name, float(error), *numbers), []).append(i)
    result = {}
    for (name, *_), steps in found.items():
        alone = sum(other == name for other, *_ in found) == 1
        where = ", ".join(plan.names[i] for i in steps)
        result[name if alone else f"{where} {name}"] = tuple(steps)
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
    places = tuple((name.split()[-1], steps) for name, steps in uncertain.items())
    first = [(name, plan.setups[steps[0]]) for name, steps in places]
    values = jnp.stack([part(setup, name) for name, setup in first])
    errors = jnp.stack([setup.errors[name] for name, setup in first])
    slopes = _plan_slopes(values, tuple(processes), plan, places, tuple(outcomes), chain)
    return tuple(Spread(tuple(outcomes), tuple(uncertain), errors, rows) for rows in slopes)


@seldom
def _plan_slopes(values, processes, plan: Plan, places, outcomes, chain):
    """Derivatives `[step, outcome, constant]` of the outcomes by all constants."""

    def reached(values):
        mine: list[dict[str, Scalar]] = [{} for _ in plan.setups]
        for value, (name, steps) in zip(values, places, strict=True):
            for i in steps:
                mine[i][name] = value
        made = map(with_constants, plan.setups, mine)
        done = chain(processes, Plan(plan.names, tuple(made)))
        return jnp.stack(
            [jnp.stack([getattr(step, name) for name in outcomes]) for step in done.steps]
        )

    return jax.jacfwd(reached)(values)
