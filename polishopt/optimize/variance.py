"""Variance: how much of an outcome's variance over the bounds each setting makes.

Sobol indices, by scipy: settings are drawn evenly between their bounds, and the variance
of each outcome is divided among them. A first-order index is a setting's share by itself;
a total one counts all that it does together with others too. Unlike derivatives they speak
of the whole box, and unlike an answer's certificate they need no optimum.

Sources: Sobol' (1993), Sensitivity estimates for nonlinear mathematical models; Saltelli et
al. (2010), Variance based sensitivity analysis of model output.
"""

import dataclasses
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..chain import Outcome, polish
from ..parts import Process
from ..setup import Setup
from ..stored import stored
from .sensitivity import OUTCOMES


SAMPLES = 256  # a power of two; the chain runs (settings + 2) times as often
AT_ONCE = 64  # points in one call of the compiled chain
CONFIDENCE = 0.95
# an outcome that varies less than this share of its size has no variance to divide
STEADY = 1e-9


class Variance(NamedTuple):
    """Sobol indices of outcomes (rows) for settings (columns); NaN if nothing varies."""

    outcomes: tuple[str, ...]
    """Names of the rows."""
    settings: tuple[str, ...]
    """Names of the columns."""
    samples: int
    """Points drawn; the function was evaluated (settings + 2) times as often."""
    deviations: Float[np.ndarray, " rows"]
    """Standard deviation of each outcome over the box, in its unit."""
    first: Float[np.ndarray, "rows columns"]
    """Share of the variance that a setting makes by itself [-]."""
    first_between: Float[np.ndarray, "2 rows columns"]
    """Confidence bounds of these."""
    total: Float[np.ndarray, "rows columns"]
    """Share in which a setting takes part [-]."""
    total_between: Float[np.ndarray, "2 rows columns"]
    """Confidence bounds of these."""


def sobol_shares(
    function: Callable[[Float[np.ndarray, "n columns"]], Float[Any, "n rows"]],
    between: Mapping[str, tuple[float, float]],
    outcomes: Sequence[str],
    samples: int = SAMPLES,
    seed: int = 0,
    confidence: float = CONFIDENCE,
) -> Variance:
    """Sobol indices of any function of settings between bounds.

    Args:
        function: Outcomes of many points, one a row.
        between: Lower and upper bound of each setting.
        outcomes: Names of what the function returns.
        samples: A power of two; bounds shrink with its root.
        seed: Seed of the scrambled Sobol sequence and of the bootstrap.
        confidence: Of the bounds, which come from resampling.

    Raises:
        ValueError: if the number of samples is no power of two.
    """
    if samples < 2 or samples & (samples - 1):
        raise ValueError(f"`samples` is {samples}, must be a power of two from 2 on.")
    from scipy import stats  # takes longer to import than all of JAX

    drawn = []
    low, high = (
        np.asarray(end, dtype=float) for end in zip(*between.values(), strict=True)
    )
    shape = (len(outcomes), len(between))

    def rows(x):
        drawn.append(np.asarray(function(x.T), dtype=float).T)
        return drawn[-1]

    box = [stats.uniform(a, b - a) for a, b in zip(low, high, strict=True)]
    with np.errstate(invalid="ignore", divide="ignore"), warnings.catch_warnings():
        # an outcome that does not vary at all has no shares, and no bounds of them
        warnings.simplefilter("ignore", stats.DegenerateDataWarning)
        made = stats.sobol_indices(
            func=rows, n=samples, dists=box, rng=np.random.default_rng(seed)
        )
        bounds = made.bootstrap(confidence_level=confidence)
    values = (
        np.reshape(each, shape)
        for each in (
            made.first_order,
            bounds.first_order.confidence_interval.low,
            bounds.first_order.confidence_interval.high,
            made.total_order,
            bounds.total_order.confidence_interval.low,
            bounds.total_order.confidence_interval.high,
        )
    )
    one, one_low, one_high, all_, all_low, all_high = values
    return Variance(
        outcomes=tuple(outcomes),
        settings=tuple(between),
        samples=samples,
        # of the two independent samples, which are asked for first
        deviations=np.std(np.concatenate(drawn[:2], axis=1), axis=1),
        first=one,
        first_between=np.stack([one_low, one_high]),
        total=all_,
        total_between=np.stack([all_low, all_high]),
    )


def variance_shares(
    process: Process,
    setup: Setup,
    between: Mapping[str, tuple[float, float]],
    outcomes: Sequence[str] = OUTCOMES,
    samples: int = SAMPLES,
    seed: int = 0,
    chain: Callable[[Process, Setup], Outcome] = polish,
) -> Variance:
    """Which settings make the outcomes of a process vary between their bounds.

    Args:
        process: Where the settings that do not vary stand.
        setup: The job.
        between: Lower and upper bound of each setting, by its name in `Process`.
        outcomes: Names of scalars of `Outcome`.
        samples: As in `sobol_shares`.
        seed: As in `sobol_shares`.
        chain: Another model of the process, of the same form as `polish`.
    """

    def function(points):
        count = len(points)
        # the last call is filled up with the last point: one shape, one compilation
        index = np.minimum(np.arange(-(-count // AT_ONCE) * AT_ONCE), count - 1)
        parts = [
            outcomes_at(
                jnp.asarray(points[part]), process, setup, names, tuple(outcomes), chain
            )
            for part in index.reshape(-1, AT_ONCE)
        ]
        return np.concatenate([np.asarray(part) for part in parts])[:count]

    names = tuple(between)
    found = sobol_shares(function, between, outcomes, samples, seed)
    centre = np.asarray([[0.5 * (low + high) for low, high in between.values()]])
    steady = found.deviations <= STEADY * np.abs(function(centre)[0])
    blank = np.where(steady, np.nan, 1.0)
    return found._replace(
        first=found.first * blank[:, None],
        total=found.total * blank[:, None],
        first_between=found.first_between * blank[None, :, None],
        total_between=found.total_between * blank[None, :, None],
    )


@stored
def outcomes_at(
    points: Float[Array, "n columns"],
    process: Process,
    setup: Setup,
    settings: tuple[str, ...],
    outcomes: tuple[str, ...],
    chain: Callable[[Process, Setup], Outcome] = polish,
) -> Float[Array, "n rows"]:
    """Outcomes of many processes that differ in some settings, one a row.

    Args:
        points: The settings, one process a row.
        process: Where all other settings stand.
        setup: The job.
        settings: Names of the columns.
        outcomes: Names of scalars of `Outcome`.
        chain: Another model of the process, of the same form as `polish`.
    """

    def one(point):
        given = dict(zip(settings, point, strict=True))
        outcome = chain(dataclasses.replace(process, **given), setup)
        return jnp.stack([getattr(outcome, name) for name in outcomes])

    return jax.lax.map(one, points, batch_size=4)
