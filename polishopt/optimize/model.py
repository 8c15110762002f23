r"""Model: what the next step expects of a problem, and where it is least.

What is made small is a cheap function of values that are dear, $\tfrac12 |w(v(x))|^2 + l^T
v(x)$: elementwise $w$ is linear or a hinge, and $l$ picks a value that is an objective as
it stands. Values, their Jacobian and the curvature of each at one point give a quadratic
model of every value, $q_k(d) = v_k + J_k d + \tfrac12 d^T S_k d$, and so of what is made
small, $m(d) = \tfrac12 |w(q(d))|^2 + l^T q(d)$. It sees a hinge before the step runs over
it, and follows a curved one, however large its penalty is. The curvatures are learned from
one point to the next, each value's own: multipliers and penalties may change meanwhile, and
what depends on a few unknowns only is known after a few steps.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..parts import Scalar


NOISE = 10.0  # rounding of a sum of squares, in units of the last place
STEPS = 40  # Newton steps on the model; they cost no evaluation
AT_BOUND = 1e-6  # so near to a bound is at it, in widths of the box
HALVINGS = 12  # lengths tried along each of them
SAFE = 1e-1  # least cosine between step and surprise that an update of curvature divides by


class Merit(eqx.Module):
    """What is made small, as a function of the values."""

    gain: Float[Array, " m"]
    """Slope of $w$: how much a residual grows with its value."""
    offset: Float[Array, " m"]
    """Residual where the value is zero."""
    hinged: Bool[Array, " m"]
    """Whether a residual below zero counts as zero."""
    lead: Float[Array, " m"]
    """Weight $l$ of each value as it stands."""

    def rows(
        self, values: Float[Array, " m"]
    ) -> tuple[Float[Array, " m"], Float[Array, " m"]]:
        """Residuals $w$, and their slopes."""
        rows = self.gain * values + self.offset
        idle = self.hinged & (rows < 0)
        return jnp.where(idle, 0.0, rows), jnp.where(idle, 0.0, self.gain)

    def __call__(self, values: Float[Array, " m"]) -> Scalar:
        """Half the sum of squares of the residuals, and the leading values."""
        return 0.5 * jnp.sum(self.rows(values)[0] ** 2) + self.lead @ values

    def noise(self, values: Float[Array, " m"]) -> Scalar:
        """What of the merit is rounding."""
        size = 0.5 * jnp.sum(self.rows(values)[0] ** 2) + jnp.abs(self.lead @ values)
        return NOISE * jnp.finfo(values.dtype).eps * size

    def pull(self, values: Float[Array, " m"]) -> Float[Array, " m"]:
        """Derivative with respect to the values: their multipliers."""
        rows, slope = self.rows(values)
        return slope * rows + self.lead


def plain_merit(values: Float[Array, " m"]) -> Merit:
    """Half the sum of squares of the values themselves."""
    zero = jnp.zeros_like(values)
    return Merit(zero + 1, zero, zero > 0, zero)


class Model(eqx.Module):
    """Values as quadratic functions of a step."""

    values: Float[Array, " m"]
    """At the present point, $v$."""
    jacobian: Float[Array, "m n"]
    """Their derivative there, $J$."""
    curvature: Float[Array, "m n n"]
    """Their second derivatives, as far as they are known, $S$."""

    def __call__(self, step: Float[Array, " n"]) -> Float[Array, " m"]:
        """Values that are expected after a step."""
        return self.values + (self.jacobian + 0.5 * (self.curvature @ step)) @ step

    def slopes(self, step: Float[Array, " n"]) -> Float[Array, "m n"]:
        """Their derivative there."""
        return self.jacobian + self.curvature @ step


def projected(point, gradient, lower, upper) -> Float[Array, " n"]:
    """Step of steepest descent, cut off at the box; zero at a stationary point."""
    return jnp.clip(point - gradient, lower, upper) - point


def positive(number: Float[Array, "..."]) -> Float[Array, "..."]:
    """The number, or 1 in place of 0, to divide by."""
    return jnp.where(number > 0, number, 1.0)


def least_of_model(
    merit: Merit,
    model: Model,
    low: Float[Array, " n"],
    high: Float[Array, " n"],
) -> tuple[Float[Array, " n"], Scalar]:
    r"""Step to the least point found of the model in a box, and the merit's change.

    By projected Newton steps on the variables that do not push against the box. Where the
    merit is not convex the eigenvalues are taken positive, so that every step goes down.

    Args:
        merit: What is made small, of the values.
        model: The values of a step.
        low: Smallest step, at most 0.
        high: Largest step, at least 0.

    Returns:
        The step, and the change of the merit that is expected of it, at most 0.
    """
    lengths = jnp.asarray([0.5**k for k in range(HALVINGS)], low.dtype)

    def after(step):
        return merit(model(step))

    def newton_step(step, slopes, rows, slope):
        pull = slope * rows + merit.lead
        gradient = slopes.T @ pull
        # what is all but at a bound and pushes against it goes there, and stays
        down = (step <= low + AT_BOUND) & (gradient >= 0)
        up = (step >= high - AT_BOUND) & (gradient <= 0)
        stuck = down | up
        rest = jnp.where(down, step - low, jnp.where(up, step - high, 0.0))
        free = ~stuck[:, None] & ~stuck[None, :]
        scaled = slope[:, None] * slopes
        bend = jnp.tensordot(pull, model.curvature, 1)
        hessian = jnp.where(free, scaled.T @ scaled + bend, 0.0)
        eigenvalues, vectors = jnp.linalg.eigh(hessian)
        size = jnp.abs(eigenvalues)
        floor = 1e4 * jnp.finfo(size.dtype).eps * jnp.max(size)
        size = jnp.maximum(size, jnp.where(floor > 0, floor, 1.0))
        downhill = jnp.where(stuck, 0.0, gradient)
        newton = vectors @ ((vectors.T @ downhill) / size)
        return jnp.where(stuck, rest, newton), downhill

    def descend(carry):
        step, best, _, count = carry
        slopes = model.slopes(step)
        rows, slope = merit.rows(model(step))
        newton, downhill = newton_step(step, slopes, rows, slope)
        # hinges that this step would run into hold it as if they were touched already:
        # else a search that stands at one could not slide along it
        ahead = jnp.clip(step - newton, low, high)
        later, bent = merit.rows(model(ahead))
        met = bent != 0
        later = later - bent * (slopes @ (ahead - step))
        sliding, _ = newton_step(
            step, slopes, jnp.where(met, later, rows), jnp.where(met, bent, slope)
        )
        # lengths that reach across the box at most, or all halvings might fall outside
        newton, sliding, steepest = (
            p * jnp.minimum(1.0, jnp.max(high - low) / positive(jnp.max(jnp.abs(p))))
            for p in (newton, sliding, downhill / positive(jnp.max(jnp.abs(downhill))))
        )
        along, slides = (jnp.outer(lengths, p) for p in (newton, sliding))
        directions = jnp.concatenate([along, slides, jnp.outer(lengths**2, steepest)])
        tries = jax.vmap(lambda p: jnp.clip(step - p, low, high))(directions)
        found = jax.vmap(after)(tries)
        pick = jnp.argmin(jnp.where(jnp.isnan(found), jnp.inf, found))
        better = found[pick] < best
        # near the end the decrease drowns in rounding, but the Newton step is still right
        last = ~better & (found[0] <= best + noise)
        step = jnp.where(better, tries[pick], jnp.where(last, tries[0], step))
        return step, jnp.where(better, found[pick], best), ~better, count + 1

    start = merit(model.values)
    noise = merit.noise(model.values)
    step, best, _, _ = jax.lax.while_loop(
        lambda carry: ~carry[2] & (carry[3] < STEPS),
        descend,
        (jnp.zeros_like(low), start, jnp.array(False), jnp.array(0)),
    )
    return step, best - start


def learned(
    curvature: Float[Array, "m n n"], step: Float[Array, " n"], change: Float[Array, "m n"]
) -> Float[Array, "m n n"]:
    """The curvatures after a step along which slopes have changed.

    The symmetric rank-one update of each. Its denominator is held up where it is too small
    to trust: the change is then explained in part. It keeps to the unknowns that a value
    depends on, and the matrices may well be indefinite.

    Args:
        curvature: As known so far.
        step: From one point to another.
        change: Of the Jacobian between them.

    Source: Conn, Gould & Toint (1991), Convergence of quasi-Newton matrices generated by
    the symmetric rank one update.
    """
    miss = change - curvature @ step
    along = miss @ step
    size = jnp.sqrt(jnp.sum(miss**2, axis=1)) * jnp.linalg.norm(step)
    least = jnp.where(along < 0, -SAFE, SAFE) * size
    divisor = jnp.where(jnp.abs(along) > SAFE * size, along, least)
    some = size > 0
    scaled = jnp.where(some[:, None], miss / jnp.where(some, divisor, 1.0)[:, None], 0.0)
    return curvature + miss[:, :, None] * scaled[:, None, :]
