"""Sensitivity: how each outcome moves with each setting, as a matrix with names.

Derivatives are exact, by forward-mode differentiation of the whole chain. An elasticity
is the relative change of an outcome per relative change of a setting, so that settings
and outcomes of any unit compare; for Ssk and Sku, which may cross zero or stay near three,
it is their absolute change per relative change of the setting.
"""

import dataclasses
from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..chain import Outcome, polish
from ..parts import Process
from ..plan import Plan, PlanOutcome, follow
from ..setup import Setup
from .goals import applied, setting


OUTCOMES = (
    "Ssk",
    "Sku",
    "Sa",
    "Sq",
    "force",
    "pressure",
    "time",
    "mean_removal",
    "spread",
    "ripple",
)
SETTINGS = ("tilt", "displacement", "step", "trochoid_radius", "feed", "spin")
PLAN_OUTCOMES = ("Ssk", "Sku", "Sa", "Sq", "time")
# Outcomes whose change is given as it is, not relative to their size.
PLAIN = ("Ssk", "Sku")


class Sensitivity(eqx.Module):
    """Derivatives of outcomes (rows) by settings (columns)."""

    outcomes: tuple[str, ...] = eqx.field(static=True)
    """Names of the rows."""
    settings: tuple[str, ...] = eqx.field(static=True)
    """Names of the columns."""
    values: Float[Array, " rows"]
    """The outcomes themselves, in mm, N, s."""
    derivatives: Float[Array, "rows columns"]
    """Change of the outcome per unit of the setting, in mm, N, s, rad."""
    elasticities: Float[Array, "rows columns"]
    """Relative change of the outcome, or plain change of Ssk and Sku, per relative change
    of the setting [-]."""


def sensitivities(
    process: Process,
    setup: Setup,
    outcomes: Sequence[str] = OUTCOMES,
    settings: Sequence[str] = SETTINGS,
    chain: Callable[[Process, Setup], Outcome] = polish,
) -> Sensitivity:
    """How each outcome moves with each setting, around one process.

    Args:
        process: Where.
        setup: The job.
        outcomes: Names of scalars of `Outcome`.
        settings: Names of fields of `Process`.
        chain: Another model of the process, of the same form as `polish`.
    """
    # jitted like anywhere else, it is not traced again
    chain = eqx.filter_jit(chain)

    def values(x):
        given = dict(zip(settings, x, strict=True))
        outcome = chain(dataclasses.replace(process, **given), setup)
        return jnp.stack([getattr(outcome, name) for name in outcomes])

    x = jnp.stack([setting(process, (), name) for name in settings])
    return _matrix(values, x, tuple(outcomes), tuple(settings))


def plan_sensitivities(
    processes: Sequence[Process],
    plan: Plan,
    outcomes: Sequence[str] = PLAN_OUTCOMES,
    settings: Sequence[str] = (),
) -> Sensitivity:
    """How the finished surface and the whole time move with the settings of any step.

    Args:
        processes: The settings of each step.
        plan: The jobs of the steps.
        outcomes: "time" of all steps, or names of scalars of the last step's outcome.
        settings: Each a step and a setting, `P600 tilt`; none: tilt and displacement of
            every step.
    """
    jitted: Callable[..., PlanOutcome] = eqx.filter_jit(follow)
    usual = [f"{name} {word}" for name in plan.names for word in ("tilt", "displacement")]
    settings = settings or usual

    def values(x):
        given = applied(tuple(processes), plan.names, dict(zip(settings, x, strict=True)))
        outcome = jitted(given, plan)
        of = (outcome if name == "time" else outcome.last for name in outcomes)
        reached = (getattr(one, name) for one, name in zip(of, outcomes, strict=True))
        return jnp.stack(list(reached))

    x = jnp.stack([setting(tuple(processes), plan.names, name) for name in settings])
    return _matrix(values, x, tuple(outcomes), tuple(settings))


def _matrix(values, x, outcomes, settings) -> Sensitivity:
    """Values, derivatives and elasticities of a function of settings."""

    def twice(x):
        reached = values(x)
        return reached, reached

    derivatives, reached = jax.jacfwd(twice, has_aux=True)(x)
    plain = jnp.asarray([name in PLAIN for name in outcomes])
    size = jnp.where(plain | (reached == 0), 1.0, reached)
    return Sensitivity(
        outcomes=outcomes,
        settings=settings,
        values=reached,
        derivatives=derivatives,
        elasticities=derivatives * x[None, :] / size[:, None],
    )
