r"""Tune: the process whose texture hits the target while the limits hold.

Two targets and four settings leave a family of answers, so the search has two stages.
The first brings the texture to the target, as a least-squares problem under the limits.
The second goes on from there to the least time (or force) on the set where the target is
met exactly. Where the first stage cannot reach the target, its answer is the nearest
texture that the limits allow, and the limits with multipliers are the ones in the way.

The starts are the given one and a scrambled Sobol sequence over the bounds. They run side
by side under `vmap`, a few at a time; the cheapest of those that reach the target go on.
"""

import dataclasses
import enum
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..chain import Outcome, polish
from ..parts import Process, Scalar, as_scalar
from ..setup import Setup
from .auglag import solve
from .certificate import Solution, Status
from .values import Values


# A texture is on target when every goal is met to this share of its tolerance: for the
# usual tolerances of 0.05 and 0.1 far below what can be measured.
HIT = 1e-3
# The search ends at a projected gradient this small, in units of tolerances.
TOLERANCE = 1e-6
# Rounds of multipliers, and trial points in each. All starts wait for the last one, and
# the few that have not ended by then are lost in a corner that others avoid.
ROUNDS, TRIALS = 10, 10
# Searches side by side under one `vmap`, and answers from which the cheapest is sought.
TOGETHER, CHEAPEST = 4, 8


class Goal(eqx.Module):
    """One texture parameter to reach."""

    value: Scalar = eqx.field(converter=as_scalar)
    """The target, in the unit of the parameter."""
    tolerance: Scalar = eqx.field(converter=as_scalar)
    """What counts as one unit of miss, in the same unit."""


class Limits(eqx.Module):
    """What a process must keep; None does not limit."""

    time: Scalar | None = None
    """Longest duration [s]."""
    force: Scalar | None = None
    """Largest force along the path [N]."""
    least_removal: Scalar | None = None
    """Least mean removal [mm]."""
    most_removal: Scalar | None = None
    """Largest mean removal [mm]."""
    spread: Scalar | None = None
    """Largest spread of the removal over the part [-]."""
    unstick: bool = eqx.field(static=True, default=True)
    """Whether the force must stay below the disc's unstick force."""
    shear: bool = eqx.field(static=True, default=False)
    """Whether friction must stay below the adhesive's shear strength."""
    rigid_body: bool = eqx.field(static=True, default=True)
    """Whether the rigid body behind the disc must stay off the part."""


class Verdict(enum.IntEnum):
    """How a tuning ended; the values are the exit codes of the command line."""

    SOLVED = 0
    INFEASIBLE = 3
    NOT_CONVERGED = 4


def excesses(outcome: Outcome, limits: Limits) -> dict[str, Scalar]:
    """By how much each named limit is exceeded; negative while it holds.

    Units are those of the limit: s, N, mm, MPa or a share.

    Args:
        outcome: What the process does.
        limits: What it must keep.
    """
    result = {}
    if limits.time is not None:
        result["time"] = outcome.time - limits.time
    if limits.force is not None:
        result["force"] = outcome.force_max - limits.force
    if limits.least_removal is not None:
        result["least removal"] = limits.least_removal - outcome.mean_removal
    if limits.most_removal is not None:
        result["most removal"] = outcome.mean_removal - limits.most_removal
    if limits.spread is not None:
        result["spread"] = outcome.spread - limits.spread
    if limits.unstick:
        result["unstick force"] = -outcome.unstick_margin
    if limits.shear:
        result["adhesive shear"] = -outcome.shear_margin
    if limits.rigid_body:
        result["rigid body"] = -outcome.body_clearance
    return result


def misses(outcome: Outcome, target: Mapping[str, Goal]) -> dict[str, Scalar]:
    """How far each goal is missed, in units of its tolerance.

    Args:
        outcome: What the process does.
        target: Goals by the name of a texture parameter of the outcome.
    """
    return {
        name: (getattr(outcome, name) - goal.value) / goal.tolerance
        for name, goal in target.items()
    }


class Tuning(eqx.Module):
    """The answer, and what proves it."""

    process: Process
    """The tuned process."""
    outcome: Outcome
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


def spread_starts(
    first: Mapping[str, float | Scalar],
    between: Mapping[str, tuple[float, float]],
    count: int,
    seed: int = 0,
) -> dict[str, Float[Array, " count"]]:
    """The given start, then a scrambled Sobol sequence over the bounds.

    Args:
        first: The given start, by setting.
        between: Lower and upper bound of each setting.
        count: How many starts in all.
        seed: Seed of the scrambling.
    """
    from scipy.stats import qmc  # takes longer to import than all of JAX

    names = list(between)
    with np.errstate(all="ignore"):
        power = max(count - 1, 1).bit_length()
        cloud = qmc.Sobol(len(names), rng=np.random.default_rng(seed)).random_base2(power)
    starts = {}
    for i, name in enumerate(names):
        low, high = between[name]
        column = low + (high - low) * cloud[: count - 1, i]
        starts[name] = jnp.asarray(np.concatenate([[float(first[name])], column]))
    return starts


class _Stage(eqx.Module):
    """What the search needs to know beside the settings it moves."""

    setup: Setup
    fixed: Process
    target: dict[str, Goal]
    limits: Limits
    weight: Scalar
    """0 while reaching for the target, 1 while holding it at the least cost."""
    unit: Scalar
    """Cost of the given start, so that the residual is of size one."""


@eqx.filter_jit
def _search(places, lower, upper, stage: _Stage, secondary, tolerance, chain) -> Solution:
    """One search from each place, side by side; both stages share the compilation.

    The chain comes jitted: however often the solver calls it, it is traced once.
    """

    def values(x, stage):
        outcome = chain(dataclasses.replace(stage.fixed, **x), stage.setup)
        missed = jnp.stack(list(misses(outcome, stage.target).values()))
        exact = jnp.where(stage.weight > 0, 1.0, 0.0)
        return Values(
            residual=(
                missed * (1 - exact),
                stage.weight * _cost(outcome, secondary) / stage.unit,
            ),
            inequality=excesses(outcome, stage.limits),
            equality=missed * exact,
        )

    return jax.vmap(
        lambda x: solve(
            values,
            None,
            x,
            lower,
            upper,
            args=stage,
            tolerance=tolerance,
            max_outer=ROUNDS,
            max_inner=TRIALS,
        )
    )(places)


def _in_batches(
    search, places: Mapping[str, Float[Array | np.ndarray, " starts"]], size: int
) -> Solution:
    """Searches from all places, `size` of them at a time, on the host.

    A batch ends with its slowest search, so small batches wait less; and two of them run
    at once, since one alone does not keep two cores busy.
    """
    count = len(next(iter(places.values())))
    # the last batch is filled up with its last place
    index = np.minimum(np.arange(-(-count // size) * size), count - 1).reshape(-1, size)

    def batch(chosen):
        return jax.device_get(search({n: x[chosen] for n, x in places.items()}))

    first = batch(index[0])  # compiles
    with ThreadPoolExecutor(2) as pool:
        parts = [first, *pool.map(batch, index[1:])]
    return jax.tree.map(lambda *leaves: np.concatenate(leaves)[:count], *parts)


def _put(values, where, new):
    """A copy of an array with some of its rows replaced."""
    values = np.array(values)
    values[where] = new
    return values


def _cost(outcome: Outcome, secondary: str) -> Scalar:
    return outcome.force_max if secondary == "force" else outcome.time


def tune(
    setup: Setup,
    start: Process,
    between: Mapping[str, tuple[float, float]],
    target: Mapping[str, Goal],
    limits: Limits | None = None,
    secondary: str = "time",
    starts: int = 16,
    seed: int = 0,
    tolerance: float = TOLERANCE,
    chain: Callable[[Process, Setup], Outcome] = polish,
    progress: Callable[[str], None] | None = None,
) -> Tuning:
    """The process whose texture is nearest to the target while all limits hold.

    Args:
        setup: The job.
        start: The process to start from; what is not in `between` stays as it is.
        between: Lower and upper bound of each setting that is tuned, by its name in
            `Process`, in mm, s and rad. No evaluation leaves them.
        target: Goals by the name of a texture parameter: `{"Ssk": Goal(-0.5, 0.05)}`.
        limits: What must be kept; None keeps the disc's own limits only.
        secondary: What to make small where the target is met: "time", "force", "none".
        starts: How many searches run side by side.
        seed: Seed of all but the first start.
        tolerance: Projected gradient at which a search ends, in tolerances of the goals.
        chain: Another model of the process, of the same form as `polish`.
        progress: Called with a sentence as the stages go by.

    Returns:
        The answer of the best start, its certificate, and what became of the others.

    Raises:
        ValueError: if a name or a bound makes no sense.
    """
    for name, (low, high) in between.items():
        if name not in {field.name for field in dataclasses.fields(Process)}:
            raise ValueError(f"`between` has {name!r}, which is no setting of `Process`.")
        if not low <= float(getattr(start, name)) <= high:
            raise ValueError(
                f"`start.{name}` is {float(getattr(start, name)):g}, must lie between its "
                f"bounds {low:g} and {high:g}."
            )
    if secondary not in ("time", "force", "none"):
        raise ValueError(
            f"`secondary` is {secondary!r}, must be 'time', 'force' or 'none'."
        )
    limits = Limits() if limits is None else limits
    say = progress or (lambda _: None)
    lower = {name: as_scalar(low) for name, (low, _) in between.items()}
    upper = {name: as_scalar(high) for name, (_, high) in between.items()}
    first = {name: float(getattr(start, name)) for name in between}
    places = spread_starts(first, between, starts, seed)

    outcome = eqx.filter_jit(chain)
    unit = jnp.maximum(_cost(outcome(start, setup), secondary), 1e-12)

    # an accelerator takes all starts at once
    together = min(starts, TOGETHER if jax.default_backend() == "cpu" else starts)

    def search(places, weight):
        stage = _Stage(setup, start, dict(target), limits, weight, unit)

        def some(part):
            return _search(part, lower, upper, stage, secondary, tolerance, outcome)

        return _in_batches(some, places, together)

    def cost_at(i):
        x = {name: as_scalar(column[i]) for name, column in final.x.items()}
        return float(_cost(outcome(dataclasses.replace(start, **x), setup), secondary))

    say(f"reaching for the target from {starts} starts")
    final = search(places, jnp.zeros_like(unit))
    distance = np.max(np.abs(final.residual[0]), axis=1)
    hit = (distance <= HIT) & (final.status == Status.SOLVED)
    say(f"{int(np.sum(hit))} of {starts} starts reach it")
    solved, at_cost = bool(np.any(hit)), False
    cost = np.zeros_like(distance)
    # where nothing reaches the target: the least miss that keeps the limits, or failing
    # that the least violation
    kept = final.status == Status.SOLVED
    rank = np.where(kept, final.objective, np.inf)
    if not kept.any():
        rank = final.scaled_violation
    if solved:
        rank = np.where(hit, distance, np.inf)
    if solved and secondary != "none":
        cost = np.asarray([cost_at(i) for i in range(starts)])
        cheapest = np.argsort(np.where(hit, cost, np.inf))[: min(CHEAPEST, hit.sum())]
        say(f"looking for the least {secondary} from the {len(cheapest)} cheapest answers")
        held = search({n: x[cheapest] for n, x in final.x.items()}, jnp.ones_like(unit))
        far = np.max(np.abs(held.equality), axis=1)
        good = (held.status == Status.SOLVED) & (far <= HIT)
        work = held.evaluations + final.evaluations[cheapest]
        held = eqx.tree_at(lambda solution: solution.evaluations, held, work)
        # else the target is reached, only not at the least cost: the first stage stands
        at_cost = bool(good.any())
        if at_cost:
            final = jax.tree.map(lambda a, b: _put(a, cheapest, b), final, held)
            distance = _put(distance, cheapest, far)
            cost = _put(cost, cheapest, held.residual[1] * float(unit))
            rank = _put(np.full(starts, np.inf), cheapest[good], cost[cheapest[good]])
    best = int(np.argmin(np.where(np.isnan(rank), np.inf, rank)))
    # the loops above ran on the host; what is handed out are JAX arrays again
    answer: Solution = jax.tree.map(lambda leaf: jnp.asarray(leaf[best]), final)
    final, distance, cost = jax.tree.map(jnp.asarray, (final, distance, cost))
    x = {name: as_scalar(value) for name, value in answer.x.items()}
    process = dataclasses.replace(start, **x)
    reached = outcome(process, setup)
    if solved:
        verdict = Verdict.SOLVED
    elif int(answer.status) in (Status.WORK_LIMIT, Status.NOT_A_NUMBER):
        verdict = Verdict.NOT_CONVERGED
    else:
        verdict = Verdict.INFEASIBLE
    # half the square of a cost c has the gradient c dc: divide it out again
    share = float(unit) / max(float(answer.residual[1]), 1e-12) if at_cost else 1.0
    goal_multipliers = -answer.equality_multipliers * share
    missed, exceeded = misses(reached, target), excesses(reached, limits)
    return Tuning(
        process=process,
        outcome=reached,
        misses=missed,
        excesses=exceeded,
        multipliers=jax.tree.map(lambda m: m * share, answer.inequality_multipliers),
        goal_multipliers=dict(zip(target, goal_multipliers, strict=True)),
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
    )
