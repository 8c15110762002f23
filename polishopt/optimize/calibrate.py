r"""Calibrate: the constants of tool and abrasive from what was measured.

Constants are estimated together, from all measurements at once, by least squares with what
was known of them before: a prior for each, log-normal where the constant is positive. The
prior decides only where the data leave a constant open, and the answer says for each how
much rests on which. Where errors of a measurement are given they are taken as known;
otherwise its scatter is estimated with the constants (each kind of measurement has one of
its own), and intervals are those of Student's t.
"""

import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float

from ..constants import START, part, with_constants
from ..contact.flat import flat_force
from ..parts import Scalar
from ..setup import Setup
from .runs import Finished, Run, finished


class Prior(NamedTuple):
    """What is known of a constant before: the config's value is the middle."""

    link: str
    """`log`, `logit` or `plain`: the scale on which it is normally distributed."""
    spread: float
    """Standard deviation on that scale."""


# A factor of 5 is a standard deviation of log 5: two in three lie between 1/5 and 5 times
# the config's value. What the presets call placeholders are no better known than that.
PRIORS = {
    "tool.foundation": Prior("log", math.log(1.5)),
    "tool.stiffening": Prior("plain", 0.5),
    "abrasive.preston": Prior("log", math.log(3.0)),
    "abrasive.active_fraction": Prior("logit", math.log(5.0)),
    "abrasive.asperity_stiffness": Prior("log", math.log(10.0)),
    "abrasive.conformity": Prior("log", math.log(2.0)),
    "abrasive.ripple_gain": Prior("log", math.log(2.0)),
    START[0]: Prior("log", math.log(5.0)),
    START[1]: Prior("plain", 0.7),
    START[2]: Prior("log", 0.5),  # of its distance from 1 + Ssk^2
}
# Constants that are never estimated, but might be confused with one that is.
HELD = (
    "tool.foundation",
    "abrasive.preston",
    "abrasive.hardness",
    "abrasive.half_angle",
    "abrasive.grain",
    "abrasive.depth_variation",
)
# measurement: its relative scatter before anything is known of it; that of Ssk is
# relative to its size, or to that of a small one, all of them added as squares
SMALL_SKEWNESS = 0.3
SCATTER = {"force": 0.05, "removal": 0.05, "Sa": 0.05, "Sq": 0.05, "Ssk": 0.1, "Sku": 0.05}
# Places from which the constants are searched for: a texture may have come about in more
# than one way. Then scatter and constants are estimated in turn, so many times.
STARTS, ROUNDS = 4, 6
LEAST_SCATTER, LEAST_FREEDOM = 1e-5, 0.1
# Share of the prior variance that is left where a constant counts as known from data,
# and where it counts as known from its prior only.
FROM_DATA, FROM_PRIOR = 1 / 9, 0.81


class Data(eqx.Module):
    """Everything that was measured; NaN where a row does not say."""

    tilt: Float[Array, " m"]
    """Tilts at which forces were measured [rad]."""
    displacement: Float[Array, " m"]
    """Displacements at which forces were measured [mm]."""
    runs: Run | None
    """Polishing runs, stacked; None for none."""
    measured: dict[str, Float[Array, " _"]]
    """`force` for each tilt, `removal`, `Sa`, `Sq`, `Ssk`, `Sku` for each run
    [N, mm, -]."""
    errors: dict[str, Float[Array, " _"]]
    """Standard errors of those whose errors are given, in the same units."""


class Calibration(eqx.Module):
    """Constants, how well they are known, and from what."""

    names: tuple[str, ...] = eqx.field(static=True)
    """The constants, such as `tool.foundation`."""
    held: tuple[str, ...] = eqx.field(static=True)
    """Constants that were not estimated, but act on the data too."""
    point: Float[Array, " n"]
    """The estimate, in standard deviations of the priors from their middles."""
    before: Float[Array, " n"]
    """The constants before: the middles of the priors [mm, N, s, rad]."""
    values: Float[Array, " n"]
    """The estimate [mm, N, s, rad]."""
    errors: Float[Array, " n"]
    """One standard error of each [mm, N, s, rad]."""
    covariance: Float[Array, "n n"]
    """Covariance of `point`: 1 on its diagonal where only the prior speaks."""
    freedom: Float[Array, " n"]
    """Degrees of freedom of Student's t for each; infinite where all errors are known."""
    information: Float[Array, "n n"]
    """What the data alone say of `point`, their Fisher information."""
    slopes: Float[Array, "rows columns"]
    """Change of each measurement, in its errors, by the logarithm of each constant of
    `names` and `held` (by the constant itself where it may be negative)."""
    scatter: dict[str, Scalar]
    """Each measurement's scatter around the model: over its errors where they are given;
    else relative; see `SCATTER` for Ssk [-]."""
    scatter_freedom: dict[str, Scalar]
    """Degrees of freedom that each of these rests on."""
    predicted: dict[str, Float[Array, " _"]]
    """What the model gives for each measurement [N, mm, -]."""
    converged: Bool[Array, ""]
    """Whether the search ended by itself."""


class _Fit(NamedTuple):
    """A stationary point."""

    point: Float[Array, " n"]
    cost: Scalar
    rows: Float[Array, " rows"]
    slopes: Float[Array, "rows columns"]
    predicted: dict[str, Float[Array, " _"]]
    ended: Bool[Array, ""]


def unknowns(data: Data, setup: Setup, free_start: bool = False) -> tuple[str, ...]:
    """The constants that a set of measurements asks for.

    Args:
        data: What was measured.
        setup: The job. A ripple gain of 0 stays 0.
        free_start: Whether the texture before is a constant too.
    """
    textures = bool({*data.measured} - {"force", "removal"})
    asked = {
        "tool.foundation": "force" in data.measured,
        "tool.stiffening": "force" in data.measured,
        "abrasive.preston": data.runs is not None,
        "abrasive.active_fraction": textures,
        "abrasive.asperity_stiffness": textures,
        "abrasive.conformity": textures and setup.start.heights is not None,
        "abrasive.ripple_gain": textures and float(setup.abrasive.ripple_gain) > 0,
        **dict.fromkeys(START, textures and free_start),
    }
    return tuple(name for name in PRIORS if asked[name])


def constants(
    names: tuple[str, ...], middles: Float[Array, " n"], point: Float[Array, " n"]
) -> dict[str, Scalar]:
    """Constants at a point of the space in which their priors are standard normal.

    Args:
        names: Which.
        middles: Their values at the origin [mm, N, s, rad].
        point: Where, in standard deviations.
    """
    values: dict[str, Scalar] = {}
    for i, name in enumerate(names):
        prior, middle, shift = PRIORS[name], middles[i], PRIORS[name].spread * point[i]
        if name == START[2]:
            least = 1.0 + middles[i - 1] ** 2
            room = jnp.maximum(middle - least, 1e-3)
            values[name] = 1.0 + values[START[1]] ** 2 + room * jnp.exp(shift)
        elif prior.link == "log":
            values[name] = middle * jnp.exp(shift)
        elif prior.link == "logit":
            inner = jnp.clip(middle, 1e-9, 1.0 - 1e-6)
            values[name] = jax.nn.sigmoid(jnp.log(inner / (1.0 - inner)) + shift)
        else:
            values[name] = middle + shift
    return values


def predict(data: Data, setup: Setup) -> dict[str, Float[Array, " _"]]:
    """What the model gives for each measurement, with the constants of a setup."""
    result = {}
    if "force" in data.measured:
        tool = setup.tool
        result["force"] = jax.vmap(
            lambda tilt, displacement: flat_force(
                tool.radius, tool.foundation, tilt, displacement, tool.stiffening
            )
        )(data.tilt, data.displacement)
    if data.runs is not None:
        left: Finished = finished(data.runs, setup)
        result |= {k: getattr(left, k) for k in data.measured if k != "force"}
    return result


def misses(data: Data, predicted: dict, scatter: dict) -> dict:
    """Measured less predicted, in standard errors; logarithmic where positive.

    Args:
        data: What was measured.
        predicted: By `predict`.
        scatter: Of the measurements whose errors are not given.
    """
    result = {}
    for name, measured in data.measured.items():
        there = jnp.isfinite(measured)
        safe = jnp.where(there, measured, 1.0)
        size = jnp.sqrt(SMALL_SKEWNESS**2 + safe**2) if name == "Ssk" else safe
        if name in data.errors:
            unit = jnp.where(there, data.errors[name], 1.0) / size
        else:
            unit = scatter[name]
        if name == "Ssk":
            miss = (safe - predicted[name]) / (unit * size)
        else:
            # the model may predict nothing at all, which has no logarithm
            given = jnp.maximum(predicted[name], 1e-12 * safe)
            miss = jnp.log(safe / given) / unit
        result[name] = jnp.where(there, miss, 0.0)
    return result


# A fit has ended where the next step would be this share of the standard errors.
NEAR = 1e-3


@eqx.filter_jit
def calibrate(data: Data, setup: Setup, names: tuple[str, ...]) -> Calibration:
    """Estimates constants from measurements.

    Args:
        data: What was measured.
        setup: The job; its constants are the middles of the priors.
        names: The constants to estimate, as `unknowns` lists them.

    Returns:
        The constants of largest posterior probability, with their errors in the usual
        linear approximation around them.
    """
    middles = jnp.stack([part(setup, name) for name in names])
    kind = middles.dtype
    unknown = [name for name in data.measured if name not in data.errors]
    first = {name: jnp.asarray(SCATTER[name], kind) for name in unknown}
    held = tuple(name for name in HELD if name not in names and data.runs is not None)
    nothing = jnp.zeros(len(held), kind)
    sizes = [data.measured[name].size for name in data.measured]

    def missed(point, shifts, scatter):
        made = with_constants(setup, constants(names, middles, point))
        for i, name in enumerate(held):
            made = with_constants(made, {name: part(made, name) * jnp.exp(shifts[i])})
        predicted = predict(data, made)
        wide = misses(data, predicted, scatter)
        return jnp.concatenate([wide[name] for name in data.measured]), predicted

    def residuals(point, scatter):
        return jnp.concatenate([missed(point, nothing, scatter)[0], point])

    def apart(rows):
        """Numbers of all rows, by what was measured there."""
        pieces = jnp.split(rows, np.cumsum(sizes)[:-1])
        return dict(zip(data.measured, pieces, strict=True))

    def fitted(point, scatter):
        """The least sum of squares near a point, and the slopes there."""
        found = optx.least_squares(
            residuals,
            optx.LevenbergMarquardt(rtol=1e-7, atol=1e-7),
            point,
            args=scatter,
            max_steps=300,
            throw=False,
        )

        def both(x):
            rows, predicted = missed(x[: point.size], x[point.size :], scatter)
            return rows, (rows, predicted)

        place = jnp.concatenate([found.value, nothing])
        slopes, (rows, predicted) = jax.jacfwd(both, has_aux=True)(place)
        cost = jnp.sum(rows**2) + jnp.sum(found.value**2)
        # what the solver says depends on rounding where the fit is nearly exact: it has
        # ended where Newton's next step is a small part of the standard errors
        own = slopes[:, : point.size]
        gradient = own.T @ rows + found.value
        _, covariance = _spread(own)
        ended = gradient @ covariance @ gradient <= NEAR**2
        return _Fit(found.value, cost, rows, slopes, predicted, ended)

    def seen(fit: _Fit):
        """Degrees of freedom of each kind of measurement, and its scatter over errors."""
        jacobian = fit.slopes[:, : fit.point.size]
        _, covariance = _spread(jacobian)
        taken = apart(jnp.einsum("ri,ij,rj->r", jacobian, covariance, jacobian))
        freedom, ratio = {}, {}
        for name, square in apart(fit.rows**2).items():
            count = jnp.sum(jnp.isfinite(data.measured[name]).astype(kind))
            freedom[name] = jnp.maximum(count - jnp.sum(taken[name]), LEAST_FREEDOM)
            ratio[name] = jnp.sqrt(jnp.sum(square) / freedom[name])
        return freedom, ratio

    def turn(carry, given):
        best, scatter = carry
        place, searching, settled = given
        fit = fitted(jnp.where(searching, place, best.point), scatter)
        lower = (fit.cost < best.cost) | ~searching
        best = jax.tree.map(lambda new, old: jnp.where(lower, new, old), fit, best)
        _, ratio = seen(best)
        better = {
            name: jnp.maximum(s * ratio[name], LEAST_SCATTER) for name, s in scatter.items()
        }
        better = jax.tree.map(
            lambda new, old: jnp.where(settled, new, old), better, scatter
        )
        # slopes and misses in the scatter that is known now
        finer = [
            jnp.full(size, scatter[name] / better[name] if name in unknown else 1.0, kind)
            for name, size in zip(data.measured, sizes, strict=True)
        ]
        finer = jnp.concatenate(finer)
        best = eqx.tree_at(
            lambda f: (f.rows, f.slopes),
            best,
            (finer * best.rows, finer[:, None] * best.slopes),
        )
        return (best, better), None

    # first from several places, then on from the best, with the scatter seen there
    places = np.random.default_rng(0).standard_normal((STARTS, len(names)))
    places[0] = 0.0
    count = np.arange(STARTS + (ROUNDS if unknown else 0))
    begin = jnp.asarray(places[np.minimum(count, STARTS - 1)], kind)
    searching, settled = jnp.asarray(count < STARTS), jnp.asarray(count >= STARTS - 1)
    nowhere = jax.tree.map(
        lambda x: jnp.full(x.shape, jnp.inf if x.dtype == kind else False, x.dtype),
        jax.eval_shape(fitted, begin[0], first),
    )
    (best, better), _ = jax.lax.scan(turn, (nowhere, first), (begin, searching, settled))
    freedom, ratio = seen(best)
    scatter = {name: better.get(name, ratio[name]) for name in ratio}
    point, slopes = best.point, best.slopes
    jacobian = slopes[:, : point.size]
    information, covariance = _spread(jacobian)

    # Satterthwaite: how much of each variance rests on scatter that is itself estimated
    variance = jnp.diag(covariance)
    uncertain = jnp.zeros_like(variance)
    for name, share in apart((jacobian @ covariance) ** 2).items():
        if name in unknown:
            uncertain = uncertain + jnp.sum(share, axis=0) ** 2 / freedom[name]
    some = uncertain > 0

    def listed(point):
        values = constants(names, middles, point)
        return jnp.stack([values[name] for name in names])

    stretch = jax.jacfwd(listed)(point)
    unit = _per_logarithm(names, listed(point), jnp.diag(stretch))
    return Calibration(
        names=names,
        held=held,
        point=point,
        before=middles,
        values=listed(point),
        errors=jnp.sqrt(jnp.diag(stretch @ covariance @ stretch.T)),
        covariance=covariance,
        freedom=jnp.where(some, variance**2 / jnp.where(some, uncertain, 1.0), jnp.inf),
        information=information,
        slopes=slopes * jnp.concatenate([unit, jnp.ones_like(nothing)])[None, :],
        scatter=scatter,
        scatter_freedom=freedom,
        predicted=best.predicted,
        converged=best.ended,
    )


def _spread(jacobian):
    """Information of the data, and covariance together with the unit prior."""
    information = jacobian.T @ jacobian
    identity = jnp.eye(information.shape[0], dtype=information.dtype)
    return information, jnp.linalg.inv(information + identity)


def _per_logarithm(names, values, stretch):
    """Standard deviations of the priors per unit of a constant's logarithm, or of it."""
    plain = jnp.asarray([PRIORS[name].link == "plain" for name in names])
    return jnp.where(plain, 1.0, values) / stretch


def intervals(calibration: Calibration, level: float = 0.95) -> np.ndarray:
    """Intervals that hold each constant with a probability, lower and upper ends.

    Student's t on the scale of each prior, so that a positive constant has a positive
    interval; the other constants stay at their estimates.

    Args:
        calibration: The answer.
        level: The probability.

    Returns:
        Of shape (constants, 2) [mm, N, s, rad].
    """
    reach = quantiles(calibration, level)
    reach = reach * np.sqrt(np.diag(np.asarray(calibration.covariance)))
    ends = []
    for i, name in enumerate(calibration.names):
        for sign in (-1.0, 1.0):
            point = calibration.point.at[i].add(sign * float(reach[i]))
            ends.append(constants(calibration.names, calibration.before, point)[name])
    return np.asarray(jnp.stack(ends)).reshape(-1, 2)


def quantiles(calibration: Calibration, level: float = 0.95) -> np.ndarray:
    """How many standard errors an interval of each constant reaches to either side."""
    from scipy.special import ndtri, stdtrit  # long to import, and rarely needed

    freedom, share = np.asarray(calibration.freedom), 0.5 + level / 2
    finite = np.isfinite(freedom)
    return np.where(finite, stdtrit(np.where(finite, freedom, 1.0), share), ndtri(share))


def rests_on(calibration: Calibration) -> list[str]:
    """Whether each constant is known from `data`, from `prior`, or from `both`."""
    left = np.diag(np.asarray(calibration.covariance))
    return [
        "data" if share <= FROM_DATA else "prior" if share >= FROM_PRIOR else "both"
        for share in left
    ]


def unstick_table(
    tilt: np.ndarray, force: np.ndarray, error: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean force at which the disc came unstuck, tilt by tilt, with its standard error.

    Errors that are given are taken as known. Otherwise the relative scatter is taken to be
    the same at all tilts; where no tilt was measured twice there is none to be seen.

    Args:
        tilt: Tilt of each measurement [rad].
        force: Force at which the disc came unstuck [N].
        error: Its standard error, NaN where not given [N].

    Returns:
        Tilts, ascending [rad], forces [N] and their errors [N], NaN where unknown.
    """
    tilts, group = np.unique(np.round(tilt, 9), return_inverse=True)
    known = np.isfinite(error).all()
    weight = 1.0 / error**2 if known else np.ones_like(force)
    total = np.bincount(group, weight)
    mean = np.bincount(group, weight * force) / total
    if known:
        return tilts, mean, 1.0 / np.sqrt(total)
    freedom = force.size - tilts.size
    square = np.sum((force / mean[group] - 1.0) ** 2)
    relative = math.sqrt(square / freedom) if freedom else math.nan
    return tilts, mean, relative * mean / np.sqrt(total)
