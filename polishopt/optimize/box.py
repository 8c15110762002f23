"""Box: quasi-Newton and Levenberg-Marquardt steps that never leave a box.

Optimistix has no bounds for least squares, and a map onto the box (sine, logistic) pays
for them with a landscape that is folded or stretched just where optima tend to lie: on
Rosenbrock's function with an active bound optimistix's own Levenberg-Marquardt takes 130
steps through a sine map and more than 500 through a logistic one, this solver 18. Here the
iterate itself stays in the box: each step is the least point of a model of the problem
(`model`) over the box and over a trust region of the same shape, so a bound is met exactly,
left freely, and costs nothing. A rejected point costs one evaluation and no Jacobian.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, PyTree

from ..parts import Scalar
from .model import Merit, Model, learned, least_of_model, plain_merit, projected


ACCEPT = 1e-4  # least share of the promised decrease that is worth moving for
SHRINK, GROW = 0.25, 2.5  # of the trust region, after a poor and after a good step
NEARBY = 0.2  # widths of the box over which curvature is learned from rejected points
FAR = 10.0  # times the size of an unknown: a box wider than that says nothing


class BoxState(eqx.Module):
    """What a step knows of the present point, in units of the box's widths."""

    scale: Float[Array, " n"]
    """Lengths over which the unknowns matter: the widths of the box."""
    first: Bool[Array, ""]
    """Whether the start has not been evaluated yet."""
    values: Float[Array, " m"]
    """What the function returned at the point."""
    jacobian: Float[Array, "m n"]
    """Derivative of `values`, per width of the box."""
    curvature: Float[Array, "m n n"]
    """Second derivative of each of them, as far as it was learned."""
    radius: Scalar
    """Half the edge of the trust region, in widths of the box."""
    finite: Bool[Array, ""]
    """Whether the latest trial point gave finite numbers."""
    optimality: Scalar
    """Largest entry of the projected gradient, per width of the box."""
    magnitude: Scalar
    """Largest sum of the gradient's terms, each without its sign."""

    @property
    def model(self) -> Model:
        """What is expected of a step from the point, in widths of the box."""
        return Model(self.values, self.jacobian, self.curvature)


class Trial(eqx.Module):
    """A point to be evaluated, and why it was chosen."""

    y: PyTree
    """The point, in the structure and the units of the unknowns."""
    step: Float[Array, " n"]
    """How it was reached from the present one, in widths of the box."""
    promised: Scalar
    """Change of the merit that the model expects of it."""
    args: PyTree
    """The arguments that it is judged by, which `choose` may have changed."""


class BoxLevenbergMarquardt(optx.AbstractLeastSquaresSolver):
    """Levenberg-Marquardt with bounds, as an optimistix solver.

    Use it with `optimistix.least_squares`, or step by step. It ends where the projected
    gradient falls below `atol` plus `rtol` times the size of the terms that cancel in it.

    Options:
        lower, upper: Bounds, pytrees like the unknowns; none by default.
        scale: Lengths over which the unknowns matter, a pytree like them; see `widths`.
        merit: `merit(args)`, the `model.Merit` that is made small; half the sum of squares
            of the function's values by default.
        choose: `choose(args, state, low, high)`, another choice of the step between `low`
            and `high`: the step, the change it promises, and new `args`.
        radius: Half the edge of the first trust region, in units of `scale`.
    """

    rtol: float = 0.0
    atol: float = 1e-8
    norm: Callable[[PyTree], Scalar] = optx.max_norm

    def init(self, fn, y, args, options, f_struct, aux_struct, tags) -> BoxState:
        """State before the first evaluation, which the first step makes."""
        del fn, aux_struct, tags
        flat, _ = ravel_pytree(y)
        outputs = sum(leaf.size for leaf in jax.tree.leaves(f_struct))
        one = jnp.ones((), flat.dtype)
        lower, upper = bounds(y, options)
        scale = widths(flat, lower, upper)
        if "scale" in options:
            scale = ravel_pytree(options["scale"])[0]
        return BoxState(
            scale=scale,
            first=jnp.array(True),
            values=jnp.zeros(outputs, flat.dtype),
            jacobian=jnp.zeros((outputs, flat.size), flat.dtype),
            curvature=jnp.zeros((outputs, flat.size, flat.size), flat.dtype),
            radius=one * options.get("radius", 0.5),
            finite=jnp.array(True),
            optimality=jnp.inf * one,
            magnitude=one,
        )

    def step(self, fn, y, args, options, state, tags) -> tuple[PyTree, BoxState, Any]:
        """One trial point, with values and slopes in one evaluation."""
        del tags
        trial = self.propose(y, args, options, state)
        values, columns, aux = slopes(lambda x: fn(x, args), trial.y, state.scale)
        y, state = self.judge(y, options, state, trial, values, columns)
        return y, state, aux

    def propose(self, y, args, options, state: BoxState) -> Trial:
        """The next point to evaluate: at first the start itself."""
        point, restore = ravel_pytree(y)
        (lower, upper), scale = bounds(y, options), state.scale
        low = jnp.maximum((lower - point) / scale, -state.radius)
        high = jnp.minimum((upper - point) / scale, state.radius)
        if "choose" in options:
            step, promised, args = options["choose"](args, state, low, high)
        else:
            merit = merit_of(args, options, state.values)
            step, promised = least_of_model(merit, state.model, low, high)
        step = jnp.where(state.first, 0.0, step)
        trial = jnp.clip(point + scale * step, lower, upper)
        # a bound met is met exactly, whatever the rounding of the line above
        trial = jnp.where(step <= (lower - point) / scale, lower, trial)
        trial = jnp.where(step >= (upper - point) / scale, upper, trial)
        trial = jnp.where(state.first, jnp.clip(point, lower, upper), trial)
        return Trial(restore(trial), step, promised, args)

    def judge(
        self,
        y,
        options,
        state: BoxState,
        trial: Trial,
        values: Float[Array, " m"],
        columns: Float[Array, "m n"],
    ) -> tuple[PyTree, BoxState]:
        """The point that is kept, and what is known there.

        Args:
            y: The point that the trial was proposed at.
            options: As in `step`.
            state: What was known at `y`.
            trial: From `propose`.
            values: What the function returned at the trial point.
            columns: Its derivative there, per `scale`.
        """
        point, restore = ravel_pytree(y)
        there, _ = ravel_pytree(trial.y)
        step, promised, args = trial.step, trial.promised, trial.args
        merit = merit_of(args, options, state.values)
        old, new = merit(state.values), merit(values)
        # a decrease below rounding cannot be told from none: it counts as kept
        noise = merit.noise(state.values)
        promised = jnp.where(promised - noise < 0, promised - noise, -1.0)
        share = (new - old - noise) / promised
        finite = jnp.all(jnp.isfinite(values))
        keep = state.first | (finite & (share > ACCEPT))
        jacobian = jnp.where(keep, columns, state.jacobian)
        finite = finite & jnp.all(jnp.isfinite(jacobian))
        keep = keep & (finite | state.first)
        moved = (there - point) / state.scale
        # a point near by tells how the values bend, kept or not
        told = keep | (jnp.max(jnp.abs(step)) <= NEARBY)
        told = told & ~state.first & finite & jnp.all(jnp.isfinite(columns))
        told = told & (jnp.max(jnp.abs(moved)) > 0)
        change = jnp.where(told, columns - state.jacobian, 0.0)
        curvature = jnp.where(
            told, learned(state.curvature, moved, change), state.curvature
        )
        length = jnp.max(jnp.abs(step))
        grown = jnp.where(
            (share > 0.75) & (length > 0.9 * state.radius),
            GROW * state.radius,
            state.radius,
        )
        radius = jnp.where(finite & (share > 0.25), grown, SHRINK * length)
        radius = jnp.where(state.first, state.radius, radius)
        point = jnp.where(keep, there, point)
        state = BoxState(
            scale=state.scale,
            first=jnp.array(False),
            values=jnp.where(keep, values, state.values),
            jacobian=jnp.where(keep, jacobian, state.jacobian),
            curvature=curvature,
            radius=radius,
            finite=finite,
            optimality=state.optimality,
            magnitude=state.magnitude,
        )
        y = restore(point)
        return y, self.measured(y, args, options, state)

    def measured(self, y, args, options, state) -> BoxState:
        """The state with its optimality, under the present `args`."""
        point, _ = ravel_pytree(y)
        (lower, upper), scale = bounds(y, options), state.scale
        weights = merit_of(args, options, state.values).pull(state.values)
        gradient = state.jacobian.T @ weights
        free = jnp.where(upper > lower, 1.0, 0.0)
        magnitude = self.norm(free * (jnp.abs(state.jacobian).T @ jnp.abs(weights)))
        # steep problems would otherwise see nothing but the distance to the box
        size = jnp.maximum(magnitude, 1.0)
        place, low, high = point / scale, lower / scale, upper / scale
        return eqx.tree_at(
            lambda s: (s.optimality, s.magnitude),
            state,
            (
                size * self.norm(projected(place, gradient / size, low, high)),
                magnitude,
            ),
        )

    def terminate(self, fn, y, args, options, state, tags):
        """Whether the point is stationary, or no step leads anywhere."""
        del fn, y, args, options, tags
        done = state.optimality <= self.atol + self.rtol * state.magnitude
        lost = ~jnp.all(jnp.isfinite(state.values)) | (stalled(state) & ~state.finite)
        result = optx.RESULTS.where(
            ~state.first & lost, optx.RESULTS.nonfinite, optx.RESULTS.successful
        )
        return ~state.first & (done | stalled(state)), result

    def postprocess(self, fn, y, aux, args, options, state, tags, result):
        """Nothing to add."""
        del fn, args, options, state, tags, result
        return y, aux, {}


def slopes(fn, y, scale) -> tuple[Float[Array, " m"], Float[Array, "m n"], Any]:
    """Flat values of a function with auxiliary output, and their derivative per `scale`.

    In one go: nothing has to be stored between values and slopes.
    """
    point, restore = ravel_pytree(y)

    def flat(x):
        out, aux = fn(restore(x))
        return ravel_pytree(out)[0].astype(point.dtype), aux

    return jax.vmap(
        lambda direction: jax.jvp(flat, (point,), (direction,), has_aux=True),
        out_axes=(None, 1, None),
    )(jnp.diag(scale))


def stalled(state: BoxState) -> Bool[Array, ""]:
    """Whether the trust region is too small for a step to change a number."""
    return state.radius < 4 * jnp.finfo(state.radius.dtype).eps


def merit_of(args, options, values: Float[Array, " m"]) -> Merit:
    """What `options` ask to make small."""
    return options["merit"](args) if "merit" in options else plain_merit(values)


def bounds(y, options) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    """Lower and upper bounds of the flat unknowns; infinite where there are none."""
    flat, _ = ravel_pytree(y)
    free = jnp.full_like(flat, jnp.inf)
    lower = ravel_pytree(options["lower"])[0] if "lower" in options else -free
    upper = ravel_pytree(options["upper"])[0] if "upper" in options else free
    return lower, upper


def widths(point, lower, upper) -> Float[Array, " n"]:
    """Lengths over which unknowns matter: the width of the box, where that is sensible.

    Where it is infinite or zero, max(1, |point|) is taken; and never more than ten times
    that, since bounds far away say nothing.
    """
    width, size = upper - lower, jnp.maximum(1.0, jnp.abs(point))
    return jnp.where(
        jnp.isfinite(width) & (width > 0), jnp.minimum(width, FAR * size), size
    )
