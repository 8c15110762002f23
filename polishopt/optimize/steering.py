"""Steering: penalties large enough that the next step looks where the limits are.

Far from an optimum the first penalty is a guess. Where it is too small, an objective that
falls fast carries the search away from the limits, and back to another basin or nowhere.
The model of the problem tells before any evaluation: if it expects a step to end further
outside than a leeway, and a step for the violation alone to do much better, penalties rise
at once.

Source: Curtis, Jiang & Robinson (2015), An adaptive augmented Lagrangian method for
large-scale constrained optimization, section 2.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..parts import Scalar
from .box import BoxState
from .model import least_of_model
from .penalty import Duals, Problem


SHARE = 0.1  # of the fall of violation that a step for it alone would bring
TRIES = 6  # one for the step as it is, one for the violation, the rest with penalties up
FIRMER = 10.0  # factor on a penalty that is too small


def steered(
    problem: Problem,
    duals: Duals,
    state: BoxState,
    low: Float[Array, " n"],
    high: Float[Array, " n"],
) -> tuple[Float[Array, " n"], Scalar, Duals]:
    """The step to the model's least point, its promise, and the penalties for it.

    Args:
        problem: The order of the values.
        duals: Multipliers and penalties as they are.
        state: Values, slopes and curvature at the present point.
        low: Smallest step.
        high: Largest step.
    """
    breach = problem.breach(state.values, duals)
    now = jnp.max(jnp.abs(breach), initial=0.0)

    def attempt(carry):
        firm, _, _, best, _, count = carry
        # the second try asks what a step for the violation alone would bring
        alone = duals.restoring | (count == 1)
        trial = eqx.tree_at(lambda d: d.restoring, firm, alone)
        step, promised = least_of_model(problem.merit(trial), state.model, low, high)
        there = jnp.abs(problem.breach(state.model(step), duals))
        then = jnp.max(there, initial=0.0)
        best = jnp.where(count == 1, then, best)
        enough = now - SHARE * jnp.maximum(now - best, 0.0)
        fine = (then <= duals.leeway) | jnp.where(
            count == 0, then <= 0.5 * now, then <= enough
        )
        fine = (fine & (count != 1)) | duals.restoring | state.first
        raised = (there > duals.leeway) & ~fine & (count > 0)
        firmer = jnp.minimum(FIRMER * firm.penalty, duals.most)
        penalty = jnp.where(raised, firmer, firm.penalty)
        last = fine | (count == TRIES - 1)
        firm = eqx.tree_at(
            lambda d: d.penalty, firm, jnp.where(last, firm.penalty, penalty)
        )
        return firm, step, promised, best, fine, count + 1

    zero = jnp.zeros((), low.dtype)
    firm, step, promised, _, _, _ = jax.lax.while_loop(
        lambda carry: ~carry[4] & (carry[5] < TRIES),
        attempt,
        (duals, jnp.zeros_like(low), zero, zero, jnp.array(False), jnp.array(0)),
    )
    return step, promised, firm
