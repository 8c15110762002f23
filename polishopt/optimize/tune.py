r"""Tune: the process whose texture hits the target while the limits hold.

Two targets and four settings leave a family of answers, so the search has two stages.
The first brings the texture to the target, as a least-squares problem under the limits.
The second goes on from there to the least time (or force) while the target is met. Where
the first stage cannot reach the target, its answer is the nearest texture that the limits
allow, and the limits with multipliers are the ones in the way.

The starts are the given one and a scrambled Sobol sequence over the bounds. They run side
by side, a few at a time; the cheapest of those that reach the target go on.
What is finished can be kept, so that a search that was interrupted goes on where it was.
"""

import dataclasses
import enum
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Generic, TypeVar, overload

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..chain import Outcome, polish
from ..parts import Process, Scalar, as_scalar
from ..plan import Plan, PlanOutcome, follow_forward
from ..setup import Setup
from ..stored import seldom
from .batches import in_batches
from .certificate import Solution, Status
from .goals import (
    Goal as Goal,
    Limits as Limits,
    PlanLimits as PlanLimits,
    all_excesses,
    all_misses,
    applied,
    band_names,
    excesses as excesses,
    mapped,
    misses as misses,
    setting,
)
from .kept import Kept, Store
from .stage import Stage, prepare, searched, seen, steps_of
from .starts import spread_starts


# A texture is on target when every goal is met to this share of its tolerance: for the
# usual tolerances of 0.05 and 0.1 far below what can be measured. Searches aim at a little
# less: within that, all textures are as good, and the valleys along which ever smaller
# misses could be chased are not followed.
HIT = 1e-2
AIM = 0.9 * HIT
# Limits hold if they are exceeded by no more than this share of their scale.
KEPT = 1e-6
# The search ends at a projected gradient this small, in units of tolerances.
TOLERANCE = 1e-6
# Searches side by side in one batch, and answers from which the cheapest is sought.
TOGETHER, CHEAPEST = 8, 8


class Verdict(enum.IntEnum):
    """How a tuning ended; the values are the exit codes of the command line."""

    SOLVED = 0
    INFEASIBLE = 3
    NOT_CONVERGED = 4


Settings = TypeVar("Settings")
Result = TypeVar("Result")


class Tuning(eqx.Module, Generic[Settings, Result]):
    """The answer, and what proves it: of one step, or of a plan of steps."""

    process: Settings
    """The tuned process; of a plan, those of its steps."""
    outcome: Result
    """What it does."""
    misses: dict[str, Scalar]
    """How far each goal is missed, in tolerances."""
    excesses: dict[str, Scalar]
    """By how much each limit is exceeded, in its unit; negative while it holds."""
    multipliers: dict[str, Scalar]
    """What one unit more of each limit is worth: fall of the secondary objective where
    solved [s/unit or N/unit], fall of half the squared misses where not [1/unit]."""
    goal_multipliers: dict[str, Scalar]
    """Change of the secondary objective per tolerance that a goal moves up [s or N]."""
    bound_multipliers: dict[str, Scalar]
    """The same for the bounds: negative at a lower, positive at an upper one [1/unit]."""
    kkt: Scalar
    """Largest projected gradient and lack of complementarity, per width of the box."""
    violation: Scalar
    """Largest violation of a limit, in its unit; of a goal too, where solved."""
    verdict: Int[Array, ""]
    """A `Verdict`."""
    best: Int[Array, ""]
    """Which start led to the answer."""
    starts: dict[str, Float[Array, " starts"]]
    """Where each search started, by setting."""
    answers: dict[str, Float[Array, " starts"]]
    """Where each ended."""
    distances: Float[Array, " starts"]
    """Largest miss of a goal at each of these ends, in tolerances."""
    costs: Float[Array, " starts"]
    """Secondary objective there [s or N]."""
    statuses: Int[Array, " starts"]
    """How each search ended: a `Status` of the certificate."""
    evaluations: Int[Array, " starts"]
    """How often each evaluated the chain."""
    followed: Bool[Array, " starts"]
    """Which of them reached the target and went on to the least cost."""


def _put(values, where, new):
    """A copy of an array with some of its rows replaced."""
    values = np.array(values)
    values[where] = new
    return values


def _sensible(between: Mapping[str, Any], target: Mapping[str, Any], starts: int) -> None:
    """Refuses what no search can be made of."""
    if not between:
        raise ValueError("`between` is empty, must have a setting that may move.")
    known = {field.name for field in dataclasses.fields(Outcome)}
    for name in target:
        if name.rpartition(" ")[2] not in known:
            raise ValueError(f"`target` has {name!r}, which is no outcome, such as 'Ssk'.")
    if starts < 1:
        raise ValueError(f"`starts` is {starts}, must be 1 or more.")


@overload
def tune(
    setup: Setup,
    start: Process,
    between: Mapping[str, tuple[float, float]],
    target: Mapping[str, Goal],
    limits: Limits | None = ...,
    secondary: str = ...,
    starts: int = ...,
    seed: int = ...,
    tolerance: float = ...,
    chain: Callable[[Process, Setup], Outcome] | None = ...,
    progress: Callable[[str], None] | None = ...,
    store: Store | None = ...,
) -> Tuning[Process, Outcome]: ...


@overload
def tune(
    setup: Plan,
    start: Sequence[Process],
    between: Mapping[str, tuple[float, float]],
    target: Mapping[str, Goal],
    limits: PlanLimits | None = ...,
    secondary: str = ...,
    starts: int = ...,
    seed: int = ...,
    tolerance: float = ...,
    chain: Callable[[tuple[Process, ...], Plan], PlanOutcome] | None = ...,
    progress: Callable[[str], None] | None = ...,
    store: Store | None = ...,
) -> Tuning[tuple[Process, ...], PlanOutcome]: ...


def tune(
    setup: Setup | Plan,
    start: Process | Sequence[Process],
    between: Mapping[str, tuple[float, float]],
    target: Mapping[str, Goal],
    limits: Limits | PlanLimits | None = None,
    secondary: str = "time",
    starts: int = 16,
    seed: int = 0,
    tolerance: float = TOLERANCE,
    chain: Callable[..., Any] | None = None,
    progress: Callable[[str], None] | None = None,
    store: Store | None = None,
) -> Tuning[Any, Any]:
    """The process whose texture is nearest to the target while all limits hold.

    Args:
        setup: The job, or a plan of several steps.
        start: The process to start from, or those of all steps; what is not in `between`
            stays as it is.
        between: Lower and upper bound of each setting that is tuned, by its name in
            `Process`, in mm, s and rad; in a plan `P600 tilt`, the step first. No
            evaluation leaves them.
        target: Goals by the name of a texture parameter: `{"Ssk": Goal(-0.5, 0.05)}`; in
            a plan `P600 Ssk`, the texture after that step.
        limits: What must be kept; None keeps the discs' own limits only.
        secondary: What to make small where the target is met: "time", "force", "none".
        starts: How many searches run side by side.
        seed: Seed of all but the first start.
        tolerance: Projected gradient at which a search ends, in tolerances of the goals.
        chain: Another model of the process, of the same form as `polish` or, for a plan,
            `plan.follow`; its slopes are taken in forward mode.
        progress: Called with a sentence as the stages go by.
        store: Where finished searches are kept as they end, and taken from if they were
            finished before: a dictionary, or `files.searches.Searches`. The answer is the
            same, bit for bit. Needs a chain that is a function of a module, which depends
            on nothing but its arguments and the source of this package.

    Returns:
        The answer of the best start, its certificate, and what became of the others.

    Raises:
        ValueError: if a name or a bound makes no sense, or if searches are to be kept of
            a chain without a name of its own.
    """
    steps = steps_of(setup)
    begin = start if isinstance(start, Process) else tuple(start)
    _sensible(between, target, starts)
    setup = mapped(setup, target)
    first = {name: float(setting(begin, steps, name)) for name in between}
    for name, (low, high) in between.items():
        if not low <= first[name] <= high:
            raise ValueError(
                f"`start.{name}` is {first[name]:g}, must lie between its bounds {low:g} "
                f"and {high:g}."
            )
    if secondary not in ("time", "force", "none"):
        raise ValueError(
            f"`secondary` is {secondary!r}, must be 'time', 'force' or 'none'."
        )
    if limits is None:
        limits = PlanLimits((Limits(),) * len(steps)) if steps else Limits()
    chain = chain or (follow_forward if steps else polish)
    say = progress or (lambda _: None)
    lower = {name: as_scalar(low) for name, (low, _) in between.items()}
    upper = {name: as_scalar(high) for name, (_, high) in between.items()}

    # an accelerator takes all starts at once; a processor has work for two batches
    together = starts
    if jax.default_backend() == "cpu":
        together = min(-(-starts // 2), TOGETHER)
    low, high = (
        {name: jnp.full(together, bound) for name, bound in side.items()}
        for side in (lower, upper)
    )
    zero = as_scalar(0.0)
    reach = Stage(
        setup, begin, dict(target), limits, zero, zero, zero + AIM, secondary, chain
    )
    prepare(low, high, reach, tolerance)
    places = spread_starts(first, between, starts, seed)
    some = {name: column[:together] for name, column in places.items()}
    unit = jnp.maximum(seen(some, reach, together)[0][0], 1e-12)
    reach = dataclasses.replace(reach, unit=unit)
    hold = dataclasses.replace(reach, weight=jnp.ones_like(unit))
    exact = dataclasses.replace(reach, slack=zero)
    outcome = seldom(chain)
    done = None
    if store is not None:
        done = Kept(store, lower, upper, reach, tolerance)
        if strange := done.strange():
            say(strange)

    def search(places, stage, numbers, number):
        def some(part, vacant):
            return searched(part, low, high, stage, tolerance, vacant)

        kinds = np.full(numbers.shape, number)
        return in_batches(some, places, together, done, start=numbers, stage=kinds)

    say(f"reaching for the target from {starts} starts")
    # not needed before the end, so not in the way of what is
    outcome.meanwhile(begin, setup)
    final = search(places, reach, np.arange(starts), 1)
    cost, distance = seen(final.x, reach, together)
    kept = final.status == Status.SOLVED
    hit = (distance <= HIT) & kept
    say(f"{int(np.sum(hit))} of {starts} starts reach it")
    solved, at_cost = bool(hit.any()), False
    followed = np.zeros(starts, bool)
    # where nothing reaches the target: the least miss that keeps the limits, or failing
    # that the least violation
    rank = np.where(kept, final.objective, np.inf)
    if not kept.any():
        rank = final.scaled_violation
    if solved:
        rank = np.where(hit, distance if secondary == "none" else cost, np.inf)
    if kept.any():
        chosen = np.argsort(rank)[: min(CHEAPEST, np.isfinite(rank).sum())]
        if solved and secondary != "none":
            stage, number, what = hold, 2, f"the least {secondary}"
        else:
            stage, number, what = exact, 3, "the nearest texture"
        say(f"looking for {what} from the {len(chosen)} best answers")
        at = {name: x[chosen] for name, x in final.x.items()}
        held = search(at, stage, chosen, number)
        paid, far = seen(held.x, reach, together)
        # where the work ran out on the way to the least cost, the point may still do
        good = held.status == Status.SOLVED
        if stage is hold:
            good |= (held.status == Status.WORK_LIMIT) & (held.scaled_violation <= KEPT)
            good &= far <= HIT
        work = held.evaluations + final.evaluations[chosen]
        held = eqx.tree_at(lambda solution: solution.evaluations, held, work)
        # else the target is reached, only not at the least cost: the first stage stands
        if good.any():
            at_cost = stage is hold
            final = jax.tree.map(lambda a, b: _put(a, chosen, b), final, held)
            distance, cost = _put(distance, chosen, far), _put(cost, chosen, paid)
            followed = _put(followed, chosen, np.full(len(chosen), at_cost))
            value = paid if at_cost else held.objective
            rank = _put(np.full(starts, np.inf), chosen[good], value[good])
    best = int(np.argmin(np.where(np.isnan(rank), np.inf, rank)))
    # the loops above ran on the host; what is handed out are JAX arrays again
    answer: Solution = jax.tree.map(lambda leaf: jnp.asarray(leaf[best]), final)
    final, distance, cost = jax.tree.map(jnp.asarray, (final, distance, cost))
    x = {name: as_scalar(value) for name, value in answer.x.items()}
    process = applied(begin, steps, x)
    reached = outcome(process, setup)
    if solved:
        verdict = Verdict.SOLVED
    elif int(answer.status) in (Status.WORK_LIMIT, Status.NOT_A_NUMBER):
        verdict = Verdict.NOT_CONVERGED
    else:
        verdict = Verdict.INFEASIBLE
    # half the square of a cost c has the gradient c dc: divide it out again
    share = float(unit) / max(float(answer.residual[1]), 1e-12) if at_cost else 1.0
    worth = jax.tree.map(lambda m: m * share, answer.inequality_multipliers)
    missed, exceeded = all_misses(reached, target), all_excesses(reached, limits)

    def moved(name: str) -> Scalar:
        low, high = (jnp.sum(worth[band]) for band in band_names(name))
        return low - high

    return Tuning(
        process=process,
        outcome=reached,
        misses=missed,
        excesses=exceeded,
        multipliers={name: worth[name] for name in exceeded},
        goal_multipliers={name: moved(name) for name in target},
        bound_multipliers=jax.tree.map(lambda m: m * share, answer.bound_multipliers),
        kkt=answer.kkt,
        violation=answer.violation,
        verdict=jnp.asarray(verdict.value),
        best=jnp.asarray(best),
        starts=places,
        answers=final.x,
        distances=distance,
        costs=cost,
        statuses=final.status,
        evaluations=jnp.asarray(final.evaluations),
        followed=jnp.asarray(followed),
    )
