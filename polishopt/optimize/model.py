r"""Model: what the next step expects of a problem, and where it is least.

What is made small is a cheap function of values that are dear, $\tfrac12 |w(v(x))|^2 + l^T
v(x)$: elementwise $w$ is a hinge or a weight, and $l$ picks a value that is an objective as
it stands. Values and their Jacobian at one point give the model
$m(d) = \tfrac12 |w(v + J d)|^2 + l^T (v + J d) + \tfrac12 d^T S d$ around it. It sees a
hinge before the step runs over it, and the matrix $S$ holds the curvature of the values
themselves, learned from the Jacobians of accepted points. An objective that is no sum of
squares, a problem with fewer residuals than unknowns, or with multipliers on curved
constraints, has no other curvature along its valley.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..parts import Scalar


NOISE = 10.0  # rounding of a sum of squares, in units of the last place
STEPS = 40  # Newton steps on the model; they cost no evaluation
AT_BOUND = 1e-6  # so near to a bound is at it, in widths of the box
HALVINGS = 12  # lengths tried along each of them

Weigh = Callable[[Float[Array, " m"]], Float[Array, " m"]]


class Merit(eqx.Module):
    """What is made small, as a function of the values."""

    weigh: Weigh
    """Elementwise map $w$ from values to residuals."""
    lead: Float[Array, " m"]
    """Weight $l$ of each value as it stands."""

    def __call__(self, values: Float[Array, " m"]) -> Scalar:
        """Half the sum of squares of the residuals, and the leading values."""
        return 0.5 * jnp.sum(self.weigh(values) ** 2) + self.lead @ values

    def noise(self, values: Float[Array, " m"]) -> Scalar:
        """What of the merit is rounding."""
        size = 0.5 * jnp.sum(self.weigh(values) ** 2) + jnp.abs(self.lead @ values)
        return NOISE * jnp.finfo(values.dtype).eps * size

    def pull(self, values: Float[Array, " m"]) -> Float[Array, " m"]:
        """Derivative with respect to the values: their multipliers."""
        rows, slope = jax.jvp(self.weigh, (values,), (jnp.ones_like(values),))
        return slope * rows + self.lead


def projected(point, gradient, lower, upper) -> Float[Array, " n"]:
    """Step of steepest descent, cut off at the box; zero at a stationary point."""
    return jnp.clip(point - gradient, lower, upper) - point


def positive(number: Float[Array, "..."]) -> Float[Array, "..."]:
    """The number, or 1 in place of 0, to divide by."""
    return jnp.where(number > 0, number, 1.0)


def least_of_model(
    merit: Merit,
    values: Float[Array, " m"],
    jacobian: Float[Array, "m n"],
    curvature: Float[Array, "n n"],
    low: Float[Array, " n"],
    high: Float[Array, " n"],
) -> tuple[Float[Array, " n"], Scalar]:
    r"""Step to the least point found of the model in a box, and the model's change.

    By projected Newton steps on the variables that do not push against the box. Where the
    model is not convex the eigenvalues are taken positive, so that every step goes down.

    Args:
        merit: What is made small, of the values.
        values: The values $v$ at the present point.
        jacobian: Their derivative $J$.
        curvature: The curvature $S$ that $J$ does not show.
        low: Smallest step, at most 0.
        high: Largest step, at least 0.

    Returns:
        The step, and the change of the model, at most 0.
    """
    lengths = jnp.asarray([0.5**k for k in range(HALVINGS)], values.dtype)
    lead = jacobian.T @ merit.lead

    def model(step):
        rows = merit.weigh(values + jacobian @ step)
        return 0.5 * jnp.sum(rows**2) + lead @ step + 0.5 * step @ (curvature @ step)

    def hinged(step):
        there = values + jacobian @ step
        return jax.jvp(merit.weigh, (there,), (jnp.ones_like(values),))

    def newton_step(step, rows, slope):
        gradient = jacobian.T @ (slope * rows) + lead + curvature @ step
        # what is all but at a bound and pushes against it goes there, and stays
        down = (step <= low + AT_BOUND) & (gradient >= 0)
        up = (step >= high - AT_BOUND) & (gradient <= 0)
        stuck = down | up
        rest = jnp.where(down, step - low, jnp.where(up, step - high, 0.0))
        free = ~stuck[:, None] & ~stuck[None, :]
        scaled = slope[:, None] * jacobian
        hessian = jnp.where(free, scaled.T @ scaled + curvature, 0.0)
        eigenvalues, vectors = jnp.linalg.eigh(hessian)
        size = jnp.abs(eigenvalues)
        floor = 1e4 * jnp.finfo(size.dtype).eps * jnp.max(size)
        size = jnp.maximum(size, jnp.where(floor > 0, floor, 1.0))
        downhill = jnp.where(stuck, 0.0, gradient)
        newton = vectors @ ((vectors.T @ downhill) / size)
        return jnp.where(stuck, rest, newton), downhill

    def descend(carry):
        step, best, _, count = carry
        rows, slope = hinged(step)
        newton, downhill = newton_step(step, rows, slope)
        # hinges that this step would run into hold it as if they were touched already:
        # else a search that stands at one could not slide along it
        ahead = jnp.clip(step - newton, low, high)
        later, bent = hinged(ahead)
        met = bent != 0
        later = later - bent * (jacobian @ (ahead - step))
        sliding, _ = newton_step(
            step, jnp.where(met, later, rows), jnp.where(met, bent, slope)
        )
        # lengths that reach across the box at most, or all halvings might fall outside
        newton, sliding, steepest = (
            p * jnp.minimum(1.0, jnp.max(high - low) / positive(jnp.max(jnp.abs(p))))
            for p in (newton, sliding, downhill / positive(jnp.max(jnp.abs(downhill))))
        )
        along, slides = (jnp.outer(lengths, p) for p in (newton, sliding))
        directions = jnp.concatenate([along, slides, jnp.outer(lengths**2, steepest)])
        tries = jax.vmap(lambda p: jnp.clip(step - p, low, high))(directions)
        found = jax.vmap(model)(tries)
        pick = jnp.argmin(jnp.where(jnp.isnan(found), jnp.inf, found))
        better = found[pick] < best
        # near the end the decrease drowns in rounding, but the Newton step is still right
        last = ~better & (found[0] <= best + noise)
        step = jnp.where(better, tries[pick], jnp.where(last, tries[0], step))
        return step, jnp.where(better, found[pick], best), ~better, count + 1

    start = model(jnp.zeros_like(low))
    noise = merit.noise(values)
    step, best, _, _ = jax.lax.while_loop(
        lambda carry: ~carry[2] & (carry[3] < STEPS),
        descend,
        (jnp.zeros_like(low), start, jnp.array(False), jnp.array(0)),
    )
    return step, best - start


def learned(curvature, step, change) -> Float[Array, "n n"]:
    """The curvature after a step along which it should have been `change`.

    The symmetric rank-one update, left out where its denominator is too small to trust.
    The matrix may well be indefinite, as the curvature of a Lagrangian often is.

    Source: Conn, Gould & Toint (1991), Convergence of quasi-Newton matrices generated by
    the symmetric rank one update.
    """
    miss = change - curvature @ step
    along = miss @ step
    safe = jnp.abs(along) > 1e-6 * jnp.linalg.norm(miss) * jnp.linalg.norm(step)
    update = miss[:, None] * miss[None, :] / jnp.where(safe, along, 1.0)
    return curvature + jnp.where(safe, update, 0.0)
