"""Goals: what a tuning moves, aims at and must keep, for one step or a plan of steps.

In a plan, a setting, a goal or a limit carries the name of its step: `P600 tilt`.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..chain import Outcome
from ..parts import Process, Scalar, as_scalar
from ..plan import Plan, PlanOutcome
from ..setup import Setup
from ..texture.local import TextureMaps, extremes


SETTINGS = tuple(field.name for field in dataclasses.fields(Process))


class Goal(eqx.Module):
    """One texture parameter to reach.

    The texture at the mean removal and pressure of the part can meet a value exactly. All
    places of a part together cannot: there the goal is a band, the value and its tolerance
    to either side, in which the worst place must lie.
    """

    value: Scalar = eqx.field(converter=as_scalar)
    """The target, in the unit of the parameter."""
    tolerance: Scalar = eqx.field(converter=as_scalar)
    """What counts as one unit of miss, in the same unit."""
    worst: bool = eqx.field(static=True, default=False)
    """Whether the worst place of the part must lie within the tolerance."""


Job = TypeVar("Job", bound=Setup | Plan)


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
    unstick_quantile: Scalar | None = None
    """With how many standard deviations to spare, and shear likewise: 2.33 for a chance of
    1 % to come unstuck; None for none, as if all constants were exact [-]."""
    shear: bool = eqx.field(static=True, default=False)
    """Whether friction must stay below the adhesive's shear strength."""
    rigid_body: bool = eqx.field(static=True, default=True)
    """Whether the rigid body behind the disc must stay off the part."""
    clears: bool = eqx.field(static=True, default=False)
    """Whether the mean removal must reach the height Sz that the step finds."""


def excesses(outcome: Outcome, limits: Limits) -> dict[str, Scalar]:
    """By how much each named limit is exceeded; negative while it holds.

    A limit with a chance to fail is exceeded where the margin is less than its quantile
    times its standard deviation. Units are those of the limit: s, N, mm, MPa or a share.

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
    if limits.clears:
        result["removal over Sz before"] = outcome.Sz_before - outcome.mean_removal
    if limits.spread is not None:
        result["spread"] = outcome.spread - limits.spread
    if limits.unstick:
        spare = _spare(limits, outcome.unstick_deviation)
        result["unstick force"] = spare - outcome.unstick_margin
    if limits.shear:
        spare = _spare(limits, outcome.shear_deviation)
        result["adhesive shear"] = spare - outcome.shear_margin
    if limits.rigid_body:
        result["rigid body"] = -outcome.body_clearance
    return result


def _spare(limits: Limits, deviation: Scalar) -> Scalar:
    """What must be left of a margin so that the chance to lose it is as asked for."""
    quantile = limits.unstick_quantile
    return jnp.zeros_like(deviation) if quantile is None else quantile * deviation


def misses(outcome: Outcome, target: Mapping[str, Goal]) -> dict[str, Scalar]:
    """How far each goal is missed, in units of its tolerance.

    A goal at the worst place has two: `Ssk lowest`, how far the lowest value of the part
    lies below the band, which is not positive, and `Ssk highest`, how far the highest one
    lies above it. Both are zero where all places lie within the tolerance.

    Args:
        outcome: What the process does.
        target: Goals by the name of a texture parameter of the outcome.

    Raises:
        ValueError: if a goal is at the worst place and the outcome has no maps.
    """
    found = {}
    for name, goal in target.items():
        if goal.worst:
            left = bands(outcome, {name: goal})
            signed = zip(left.items(), (-1.0, 1.0), strict=True)
            found |= {end: sign * jnp.maximum(band, 0.0) for (end, band), sign in signed}
        else:
            found[name] = (getattr(outcome, name) - goal.value) / goal.tolerance
    return found


def band_names(name: str) -> tuple[str, str]:
    """What the two ends of the band of a goal at the worst place are called."""
    return f"{name} lowest", f"{name} highest"


def bands(outcome: Outcome, target: Mapping[str, Goal]) -> dict[str, Scalar]:
    """How far the part leaves the bands of the goals at the worst place, in tolerances.

    Args:
        outcome: What the process does.
        target: Goals; those at the mean have no band.

    Returns:
        `Ssk lowest` and `Ssk highest`, negative as long as all places lie in the band.

    Raises:
        ValueError: if the outcome has no maps.
    """
    return {name: jnp.max(band) for name, band in local_bands(outcome, target).items()}


def local_bands(
    outcome: Outcome, target: Mapping[str, Goal]
) -> dict[str, Float[Array, "ny nx"]]:
    """`bands` at every place of the part: smooth in the process, as their ends are not.

    Places in the margin do not count: there each is -1, as in the middle of its band.
    """
    found = {}
    for name, goal in target.items():
        if goal.worst:
            maps = _maps(outcome, name)
            off = (getattr(maps, name) - goal.value) / goal.tolerance
            sides = zip(band_names(name), (-off - 1.0, off - 1.0), strict=True)
            found |= {end: jnp.where(maps.evaluated, side, -1.0) for end, side in sides}
    return found


def _maps(outcome: Outcome, name: str) -> TextureMaps:
    if outcome.maps is None:
        raise ValueError(
            f"the goal `{name}` is at the worst place, which needs maps: use a setup "
            f"with `local=True`."
        )
    return outcome.maps


def ends(outcome: Outcome, name: str) -> tuple[Scalar, Scalar]:
    """The lowest and the highest value over the part, without its margin.

    Args:
        outcome: What the process does.
        name: Of a texture parameter.

    Raises:
        ValueError: if the outcome has no maps.
    """
    maps = _maps(outcome, name)
    return extremes(getattr(maps, name), maps.evaluated)


def reached(outcome: Outcome, name: str, goal: Goal) -> Scalar:
    """What a goal looks at: the texture of the mean place, or that of the worst.

    Args:
        outcome: What the process does.
        name: Of a texture parameter.
        goal: The goal for it.
    """
    if not goal.worst:
        return getattr(outcome, name)
    low, high = ends(outcome, name)
    return jnp.where(high - goal.value > goal.value - low, high, low)


def mapped(job: Job, target: Mapping[str, Goal]) -> Job:
    """The job, with maps of texture if a goal needs them.

    Args:
        job: The setup, or a plan of several.
        target: The goals.
    """
    if not any(goal.worst for goal in target.values()):
        return job
    if isinstance(job, Plan):
        setups = tuple(dataclasses.replace(setup, local=True) for setup in job.setups)
        return dataclasses.replace(job, setups=setups)
    return dataclasses.replace(job, local=True)


class PlanLimits(eqx.Module):
    """What each step of a plan must keep."""

    steps: tuple[Limits, ...]
    """One for each step, in their order."""


def all_excesses(
    outcome: Outcome | PlanOutcome, limits: Limits | PlanLimits
) -> dict[str, Scalar]:
    """`excesses` of a step, or of all steps of a plan under `P600 time` and the like."""
    if isinstance(outcome, PlanOutcome):
        assert isinstance(limits, PlanLimits)
        steps = zip(outcome.names, outcome.steps, limits.steps, strict=True)
        return {
            f"{name} {limit}": value
            for name, step, kept in steps
            for limit, value in excesses(step, kept).items()
        }
    assert isinstance(limits, Limits)
    return excesses(outcome, limits)


def all_misses(
    outcome: Outcome | PlanOutcome, target: Mapping[str, Goal]
) -> dict[str, Scalar]:
    """`misses` of a step, or of the goals `P600 Ssk` and the like of a plan."""
    return _everywhere(misses, outcome, target)


def all_local_bands(
    outcome: Outcome | PlanOutcome, target: Mapping[str, Goal]
) -> dict[str, Float[Array, "ny nx"]]:
    """`local_bands` of a step, or of the goals `P600 Ssk` and the like of a plan."""
    return _everywhere(local_bands, outcome, target)


def _everywhere(
    found: Callable[[Outcome, Mapping[str, Goal]], dict[str, Array]],
    outcome: Outcome | PlanOutcome,
    target: Mapping[str, Goal],
) -> dict[str, Array]:
    """What is found of an outcome, or of the steps of a plan, in the order of the goals."""
    if not isinstance(outcome, PlanOutcome):
        return found(outcome, target)
    steps = dict(zip(outcome.names, outcome.steps, strict=True))
    split = [(*name.rpartition(" "), goal) for name, goal in target.items()]
    return {
        f"{step} {part}": value
        for step, _, parameter, goal in split
        for part, value in found(steps[step], {parameter: goal}).items()
    }


def setting(
    process: Process | Sequence[Process], names: Sequence[str], name: str
) -> Scalar:
    """One setting of a process, or `P600 tilt` of the processes of a plan.

    A shift or a wedge that is not set is 0.

    Args:
        process: The settings.
        names: What the steps of a plan are called.
        name: Which setting.

    Raises:
        ValueError: if there is no such step or setting.
    """
    if isinstance(process, Process):
        word, one = name, process
    else:
        step, _, word = name.rpartition(" ")
        if step not in names:
            raise ValueError(
                f"`between` has {name!r}, must be a step and a setting; the steps are "
                f"{', '.join(names)}."
            )
        one = process[names.index(step)]
    if word not in SETTINGS:
        raise ValueError(f"`between` has {name!r}, which is no setting of `Process`.")
    value = getattr(one, word)
    return jnp.zeros_like(one.tilt) if value is None else value


def applied(
    process: Process | Sequence[Process], names: Sequence[str], x: Mapping[str, Scalar]
) -> Process | tuple[Process, ...]:
    """The process, or the processes of a plan, with some settings replaced.

    Args:
        process: The settings.
        names: What the steps of a plan are called.
        x: New values, named as in `setting`.
    """
    if isinstance(process, Process):
        return dataclasses.replace(process, **x)
    split = [(*name.rpartition(" "), value) for name, value in x.items()]
    return tuple(
        dataclasses.replace(
            one, **{word: value for step, _, word, value in split if step == name}
        )
        for name, one in zip(names, process, strict=True)
    )
