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
from ..setup import Setup


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

    def values(x):
        given = dict(zip(settings, x, strict=True))
        # jitted like anywhere else, it is not traced again
        outcome = eqx.filter_jit(chain)(dataclasses.replace(process, **given), setup)
        reached = jnp.stack([getattr(outcome, name) for name in outcomes])
        return reached, reached

    x = jnp.stack([getattr(process, name) for name in settings])
    derivatives, reached = jax.jacfwd(values, has_aux=True)(x)
    plain = jnp.asarray([name in PLAIN for name in outcomes])
    size = jnp.where(plain | (reached == 0), 1.0, reached)
    return Sensitivity(
        outcomes=tuple(outcomes),
        settings=tuple(settings),
        values=reached,
        derivatives=derivatives,
        elasticities=derivatives * x[None, :] / size[:, None],
    )
