"""Explore: what outcomes can be, one question at a time, many searches side by side.

A question makes some outcomes small while others are held at a value or under a level and
all limits hold. All questions of a job are one compiled program. Settings drawn at random
beforehand say how the outcomes lie and where a search may start.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..chain import Outcome, polish
from ..parts import Process, Scalar, as_scalar
from ..plan import Plan, PlanOutcome, follow_forward
from ..setup import Setup
from ..stored import seldom, stored
from .batches import in_batches, looked_at, walked
from .certificate import Solution, Status
from .goals import (
    Goal,
    Limits,
    PlanLimits,
    all_excesses,
    all_local_bands,
    all_misses,
    applied,
    mapped,
    setting,
)
from .kept import Kept, Store
from .starts import spread_starts
from .tune import KEPT, TOGETHER
from .values import Values
from .walk import Rules


# the largest miss of a goal, in tolerances: an outcome like any other here
MISS = "miss"
# outcomes of which more is better
MORE = ("mean_removal", "unstick_margin", "shear_margin", "body_clearance", "feed")
KNOWN = {MISS, *(field.name for field in dataclasses.fields(Outcome))}
DRAWN = 256  # settings drawn at random
TOLERANCE = 1e-6  # of the searches, as in `minimise`
ROUNDS, TRIALS = 10, 12  # as in `tune`; curvature is learned here, which takes more points
LEVEL = "level"  # the unknown beside the settings


Numbers = np.ndarray | float


class Question(NamedTuple):
    """What to make small, and what to hold; k outcomes in units of their spread."""

    weights: Numbers
    """What each outcome counts in what is made small."""
    weight: Numbers = 0.0
    """What the level counts in it."""
    capped: Numbers = 0.0
    """1 for outcomes that must not exceed the level, else 0."""
    near: Numbers = 0.0
    """1 if no goal may be missed by more than the level, in tolerances; else 0."""
    held: Numbers = 0.0
    """1 for outcomes that must be as `at` says, else 0."""
    at: Numbers = 0.0
    """Where."""
    least: Numbers = 0.0
    """Lower bound of the level."""
    most: Numbers = 0.0
    """Upper bound of the level."""


class Found(NamedTuple):
    """The best answer to a question."""

    x: dict[str, float]
    """The settings [mm, s, rad]."""
    objective: float
    """What was made small, in units of spread."""
    level: float
    """The level there."""
    slope: float
    """Fall of the objective per unit of the level, where that was fixed."""


class _Job(eqx.Module):
    """What all questions share."""

    setup: Setup | Plan
    fixed: Process | tuple[Process, ...]
    target: dict[str, Goal]
    limits: Limits | PlanLimits
    middles: Float[Array, " k"]
    units: Float[Array, " k"]
    lower: dict[str, Scalar]
    upper: dict[str, Scalar]


def value(outcome: Outcome | PlanOutcome, name: str) -> Scalar:
    """An outcome by its name; of a plan, that of the last step, or that of `P600 Ssk`.

    Args:
        outcome: What the process does.
        name: Of a scalar of `Outcome`; "force" is the largest one.

    Raises:
        ValueError: if there is no such outcome.
    """
    step, _, word = name.rpartition(" ")
    word = {"force": "force_max"}.get(word, word)
    if isinstance(outcome, PlanOutcome):
        steps = dict(zip(outcome.names, outcome.steps, strict=True))
        whole = not step and word in ("time", "force_max")
        at: Any = outcome if whole else steps.get(step or outcome.names[-1])
    else:
        at = outcome
    found = getattr(at, word, None)
    if not isinstance(found, jax.Array) or found.ndim:
        raise ValueError(f"{name!r} is no outcome with one value, such as 'time' or 'Ssk'.")
    return found


def sign(name: str) -> float:
    """-1 for outcomes of which more is better, else 1."""
    return -1.0 if name.rpartition(" ")[2] in MORE else 1.0


@stored
def _looked_at(
    x, skipped, questions: Question, job: _Job, names: tuple[str, ...], chain
) -> tuple[Any, Any]:
    """What the searches need to know of several places, each with its question."""
    steps = job.setup.names if isinstance(job.setup, Plan) else ()

    def values(x, ask):
        level = x[LEVEL]
        given = {name: v for name, v in x.items() if name != LEVEL}
        outcome = chain(applied(job.fixed, steps, given), job.setup)
        found = [sign(name) * value(outcome, name) for name in names]
        found = (jnp.stack([*found, jnp.zeros_like(level)])[:-1] - job.middles) / job.units
        bands = all_local_bands(outcome, job.target)
        missed = all_misses(outcome, job.target)
        off = [s * m for n, m in missed.items() if n not in bands for s in (1.0, -1.0)]
        return Values(
            objective=jnp.sum(ask.weights * found) + ask.weight * level,
            inequality={
                "limits": all_excesses(outcome, job.limits),
                "level": jnp.where(ask.capped > 0, found - level, -1.0),
                "goals": tuple(
                    jnp.where(ask.near > 0, each - level, -1.0)
                    for each in (*bands.values(), *off)
                ),
            },
            equality=jnp.where(ask.held > 0, found - ask.at, 0.0),
        )

    return looked_at(values, x, skipped, questions)


def _search(
    places, questions: Question, vacant, job: _Job, names, tolerance, chain
) -> Solution:
    """One search from each place, side by side."""

    def bounded(bounds, level):
        count = level.shape
        return {n: jnp.broadcast_to(b, count) for n, b in bounds.items()} | {LEVEL: level}

    lower = bounded(job.lower, questions.least)
    upper = bounded(job.upper, questions.most)

    def look(x, skipped):
        return _looked_at(x, skipped, questions, job, names, chain)

    places = jax.tree.map(jnp.clip, places, lower, upper)
    rules = Rules(tolerance, ROUNDS, TRIALS)
    return walked(look, places, lower, upper, rules, vacant)


class Explorer:
    """Asks questions about one job, and knows roughly how the outcomes lie."""

    def __init__(
        self,
        setup: Setup | Plan,
        start: Process | Sequence[Process],
        between: Mapping[str, tuple[float, float]],
        target: Mapping[str, Goal],
        limits: Limits | PlanLimits | None,
        names: Sequence[str],
        *,
        drawn: int = DRAWN,
        seed: int = 0,
        tolerance: float = TOLERANCE,
        chain: Callable[..., Any] | None = None,
        progress: Callable[[str], None] | None = None,
        store: Store | None = None,
    ):
        """Draws settings between the bounds, and looks at what they do.

        Args:
            setup: As in `tune`.
            start: As in `tune`; the first of those that are drawn.
            between: As in `tune`.
            target: As in `tune`; read for `miss` only.
            limits: As in `tune`.
            names: The outcomes that questions are about, see `value`; or `miss`, the
                largest miss of a goal in tolerances.
            drawn: How many settings are drawn.
            seed: Of what is drawn.
            tolerance: Of the searches.
            chain: As in `tune`.
            progress: As in `tune`.
            store: As in `tune`.

        Raises:
            ValueError: if a name or a bound makes no sense.
        """
        if MISS in names and not target:
            raise ValueError("`target` is empty, must have a goal to be missed.")
        if not between:
            raise ValueError("`between` is empty, must have a setting that may move.")
        for name in names:
            if name.rpartition(" ")[2] not in KNOWN:
                raise ValueError(f"{name!r} is no outcome, such as 'time' or 'Ssk'.")
        steps = setup.names if isinstance(setup, Plan) else ()
        begin = start if isinstance(start, Process) else tuple(start)
        if limits is None:
            limits = PlanLimits((Limits(),) * len(steps)) if steps else Limits()
        self.names = tuple(name for name in names if name != MISS)
        self.say = progress or (lambda _: None)
        goals = dict(target) if MISS in names else {}
        setup = mapped(setup, goals)
        chain = chain or (follow_forward if steps else polish)
        outcome: Callable[..., Any] = seldom(chain)

        def row(x):
            done = outcome(applied(begin, steps, x), setup)
            missed = [jnp.abs(each) for each in all_misses(done, goals).values()]
            over = all_excesses(done, limits).values()
            return (
                [float(value(done, name)) for name in self.names],
                float(max(missed, default=0.0)),
                [float(each) for each in over] or [-1.0],
            )

        self.row = row
        first = {name: float(setting(begin, steps, name)) for name in between}
        self.say(f"drawing {drawn} settings between the bounds")
        self.places = spread_starts(first, between, drawn, seed)
        each = [{n: x[i] for n, x in self.places.items()} for i in range(drawn)]
        with ThreadPoolExecutor(2) as pool:
            seen, missed, over = zip(*pool.map(row, each), strict=True)
        self.drawn = [{n: float(v) for n, v in x.items()} for x in each]
        seen, over = np.asarray(seen, float).reshape(drawn, -1), np.asarray(over)
        finite = np.isfinite(seen).all(axis=1) & np.isfinite(over).all(axis=1)
        if not finite.any():
            raise ValueError("None of the settings that were drawn has finite outcomes.")
        unit = np.std(seen[finite], axis=0)
        self.units = np.where(unit > 0, unit, 1.0)
        """What one unit of each outcome is, in its own; negative where more is better."""
        self.units *= [sign(name) for name in self.names]
        self.middles = np.mean(seen[finite], axis=0)
        """Where outcomes are zero in these units."""
        self.seen = (seen - self.middles) / self.units
        """Outcomes of what was drawn, in these units."""
        self.missed = np.where(finite, missed, np.inf)
        """Largest miss of a goal."""
        wide = np.maximum(np.std(over[finite], axis=0), 1e-300)
        self.over = np.where(finite, np.max(over / wide, axis=1), np.inf)
        """Largest excess of a limit, in spreads of that limit; negative within all."""
        self.job = _Job(
            setup,
            begin,
            goals,
            limits,
            jnp.asarray(self.middles * np.sign(self.units)),
            jnp.asarray(np.abs(self.units)),
            {name: as_scalar(low) for name, (low, _) in between.items()},
            {name: as_scalar(high) for name, (_, high) in between.items()},
        )
        self.tolerance, self.chain, self.searches = tolerance, chain, 0
        self.kept = None
        if store is not None:
            self.kept = Kept(store, self.job, self.names, tolerance, chain)

    def shown(self, i: int | None) -> Float[np.ndarray, " drawn"]:
        """What was drawn, in an outcome's own unit; None for the largest miss."""
        if i is None:
            return self.missed
        return self.seen[:, i] * self.units[i] + self.middles[i]

    def likely(self, cost: np.ndarray, count: int) -> list[dict[str, float]]:
        """Settings among those drawn that keep the limits at the least cost.

        Args:
            cost: Of each that was drawn.
            count: How many; where too few keep the limits, those that exceed them least.
        """
        cost = np.where(np.isfinite(cost), cost, np.inf)
        order = np.lexsort((cost, np.maximum(self.over, 0.0)))
        return [self.drawn[i] for i in order[:count]]

    def ask(
        self, asked: Sequence[tuple[Question, Sequence[Mapping[str, float]]]]
    ) -> list[Found | None]:
        """The best answer to each question; None where no search ended within the limits.

        Args:
            asked: Questions, each with the settings from which to search.
        """
        pairs = [(i, q, x) for i, (q, places) in enumerate(asked) for x in places]
        if not pairs:
            return [None] * len(asked)
        places: dict[str, list[Any]] = {name: [] for name in (*self.places, LEVEL)}
        for _, question, x in pairs:
            for name in self.places:
                places[name].append(x[name])
            # as low as the level may be is where a search that lowers it ends
            places[LEVEL].append(x.get(LEVEL, question.most))
        blank = np.zeros(len(self.names))
        stacked = Question(
            *(
                np.stack(
                    [np.asarray(part + (blank if wide else 0.0), float) for part in parts]
                )
                for parts, wide in zip(
                    zip(*(question for _, question, _ in pairs), strict=True),
                    (True, False, True, False, True, True, False, False),
                    strict=True,
                )
            )
        )

        def some(part, questions, vacant):
            part, questions = jax.tree.map(jnp.asarray, (part, questions))
            return _search(
                part, questions, vacant, self.job, self.names, self.tolerance, self.chain
            )

        arrays = {name: np.asarray(column) for name, column in places.items()}
        ended = in_batches(some, arrays, TOGETHER, self.kept, stacked)
        self.searches += len(pairs)
        best: list[Found | None] = [None] * len(asked)
        for row, (i, _, _) in enumerate(pairs):
            status, over = int(ended.status[row]), float(ended.scaled_violation[row])
            fine = status == Status.SOLVED or (status == Status.WORK_LIMIT and over <= KEPT)
            objective, old = float(ended.objective[row]), best[i]
            if fine and (old is None or objective < old.objective):
                at = {name: float(column[row]) for name, column in ended.x.items()}
                slope = float(ended.bound_multipliers[LEVEL][row])
                best[i] = Found(at, objective, at.pop(LEVEL), slope)
        return best

    def values(self, x: Mapping[str, float]) -> tuple[list[float], float]:
        """Outcomes in their own units, and the largest miss, at some settings."""
        found, missed, _ = self.row({name: as_scalar(v) for name, v in x.items()})
        return found, missed
