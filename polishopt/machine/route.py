r"""Route: which of the machine's two solutions a path takes, and whether it can be run.

Both solutions are the same tool axis, so a path may change from one to the other only
where that is the shorter way for the rotary axes: at the pole, which one solution crosses
with half a turn of the axis next to the part and the change with none. Among such ways
the one with the least time of the rotary axes is taken that stays within travel, whole
turns being free. What cannot be run is an answer too: see `faults`.
"""

import enum
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..parts import Machine, Scalar
from ..units import from_internal, label
from .kinematics import (
    held,
    pole_distance,
    positions,
    reach,
    rotary,
    rotary_order,
    turns,
    unwound,
)


# What each sample out of travel costs, and each rad that it is out [s].
OUTSIDE = 1e9
# What rounding may add to a travel or a reach.
SLACK = 1e-9


class Route(eqx.Module):
    """Axis positions along a path, and how they were chosen."""

    axes: Float[Array, "n 5"]
    """Positions of the linear [mm] and rotary axes [rad], as `machine.names`."""
    branch: Int[Array, " n"]
    """Which solution each sample takes, see `inverse`."""
    pole: Bool[Array, " n"]
    """Where the rotary axis next to the part holds its last angle."""
    reach: Float[Array, " n"]
    """Negative where no position of the rotary axes gives the orientation [-]."""
    cost: Float[Array, "2"]
    """Time of the rotary axes if the path began with either solution, and `OUTSIDE` or
    more for each sample out of travel [s]."""
    turn: Float[Array, "2"]
    """Whole turns by which each rotary axis begins away from the middle of its travel,
    next to the part first [-]."""


class Kind(enum.Enum):
    """What may keep a path from being run."""

    REACH = "orientation out of reach"
    TRAVEL = "out of travel"
    SPEED = "axis that cannot move"


class Fault(NamedTuple):
    """Why a path cannot be run."""

    kind: Kind
    axis: str
    """Name of the axis in the way."""
    sample: int
    """First sample that it concerns."""
    sentence: str
    """The same in words."""


def route(
    tips: Float[Array, "n 3"],
    axes: Float[Array, "n 3"],
    machine: Machine,
    branch: int | None = None,
    hold: float = 1e-5,
) -> Route:
    """Axis positions along a path, with the solution and the whole turns chosen.

    Differentiable as `inverse`; which solution is taken is a constant to a gradient, and so
    is the angle that is held near the pole.

    Args:
        tips: Tool tips on the part [mm].
        axes: Unit tool axes on the part [-].
        machine: The machine.
        branch: Keep to this solution; None to choose.
        hold: So near to the pole, the rotary axis next to the part holds its last angle,
            and the tool axis is off by no more: less than a control resolves [rad].

    Returns:
        Positions and how they were chosen.

    Source: Own derivation.
    """
    one, two = rotary_order(machine)
    both = [jax.vmap(lambda u, b=b: rotary(u, machine, b))(axes) for b in (0, 1)]
    pole = jax.vmap(lambda u: pole_distance(u, machine))(axes) <= hold
    last = held(pole)
    table = jnp.stack([jnp.stack([a[last], b], axis=-1) for (a, b), _ in both], axis=1)
    cost, chosen = _cheapest(jax.lax.stop_gradient(table), machine, branch)
    angles = jnp.take_along_axis(table, chosen[:, None, None], axis=1)[:, 0]
    parts, begun = [], []
    for k, number in enumerate((one, two)):
        plain = unwound(angles[:, k], jnp.zeros_like(angles[0, 0]))
        fitted = plain - 2.0 * jnp.pi * _turns_off(plain, machine, number)
        parts.append(fitted)
        begun.append(turns(fitted[0] - plain[0]))
    places = jax.vmap(lambda tip, a, b: positions(tip, (a, b), machine))(tips, *parts)
    far = jax.vmap(lambda u: reach(u, machine))(axes)
    return Route(places, chosen, pole, far, cost, jnp.stack(begun))


def faults(found: Route, machine: Machine) -> list[Fault]:
    """What keeps a route from being run, worst first; not for use under `jit`.

    Args:
        found: From `route`.
        machine: The machine it was chosen for.
    """
    names, order = machine.names, rotary_order(machine)
    out = np.asarray(found.reach) < -SLACK
    answer = []
    if out.any():
        sample, axis = int(np.argmax(out)), names[order[1]]
        sentence = (
            f"no angle of axis {axis} leans the tool as sample {sample} asks: the rotary "
            f"axes {names[order[0]]} and {axis} do not reach this orientation"
        )
        answer.append(Fault(Kind.REACH, axis, sample, sentence))
    places = np.asarray(found.axes)
    for k, name in enumerate(names):
        unit = "deg" if name in "ABC" else "mm"
        low, high = (float(end[k]) for end in (machine.lower, machine.upper))
        below, above = low - places[:, k], places[:, k] - high
        over = np.maximum(below, above)
        if over.max() > SLACK:
            first, worst = int(np.argmax(over > SLACK)), int(np.argmax(over))
            shown = [f"{from_internal(x, unit):.6g}" for x in (places[worst, k], low, high)]
            sentence = (
                f"axis {name} leaves its travel at sample {first} of {len(places)}: at "
                f"sample {worst} it would stand at {shown[0]} {label(unit)}, must lie in "
                f"[{shown[1]}, {shown[2]}] {label(unit)}"
            )
            answer.append(Fault(Kind.TRAVEL, name, first, sentence))
    return answer + standing(places, machine)


def standing(places: Float[np.ndarray, "n 5"], machine: Machine) -> list[Fault]:
    """Axes that a path asks to move and that have no speed, acceleration or jerk."""
    answer = []
    limits = {
        "speed": machine.max_speed,
        "acceleration": machine.max_acceleration,
        "jerk": machine.max_jerk,
    }
    for k, name in enumerate(machine.names):
        steps = np.abs(np.diff(places[:, k]))
        moves = steps > SLACK
        for what, most in limits.items():
            if moves.any() and not float(most[k]) > 0.0:
                sample = int(np.argmax(moves))
                sentence = (
                    f"axis {name} has to move at sample {sample}, but its largest {what} "
                    f"is {float(most[k]):g}; it must be positive"
                )
                answer.append(Fault(Kind.SPEED, name, sample, sentence))
                break
    return answer


def reasons(found: Route, machine: Machine) -> list[str]:
    """Why the route is what it is, in sentences; not for use under `jit`.

    Args:
        found: From `route`.
        machine: The machine it was chosen for.
    """
    names, order = machine.names, rotary_order(machine)
    first, second = names[order[0]], names[order[1]]
    branch, cost = np.asarray(found.branch), np.asarray(found.cost)
    begins = int(branch[0])
    mine, other = cost[begins], cost[1 - begins]
    how = f"the path begins with the {('larger', 'smaller')[begins]} angle of {second}: "
    if np.isinf(other):
        how += "it was asked for"
    elif other >= OUTSIDE > mine:
        how += f"with the other one {first} or {second} leaves its travel"
    elif other - mine > 1e-6 * (1.0 + mine):
        how += f"with the other one the rotary axes need {other - mine:.3g} s more"
    else:
        how += "the other one is no better"
    sentences = [how]
    for at in np.flatnonzero(np.diff(branch)) + 1:
        sentences.append(
            f"at sample {at} the path crosses the pole: {second} changes its sign, or "
            f"{first} would turn by half a turn"
        )
    waits = int(np.sum(np.asarray(found.pole)))
    if waits:
        sentences.append(f"{first} holds its angle on {waits} samples at the pole")
    for name, turn in zip((first, second), np.asarray(found.turn).tolist(), strict=True):
        if turn:
            many = "1 turn" if abs(turn) == 1 else f"{abs(turn):.0f} turns"
            way = "higher" if turn > 0 else "lower"
            sentences.append(f"{name} begins {many} {way}, to stay within its travel")
    return sentences


def _turns_off(angle: Float[Array, " n"], machine: Machine, number: int) -> Scalar:
    """Whole turns to take off a run of angles so that its middle fits the travel's."""
    low, high = machine.lower[number], machine.upper[number]
    ends = jnp.stack([jnp.min(angle), jnp.max(angle)])
    middle = 0.5 * (ends[0] + ends[1])
    both = jnp.isfinite(low) & jnp.isfinite(high)
    whole = turns(middle - jnp.where(both, 0.5 * (low + high), 0.0))
    # with one end only, or none, as few as it needs
    up = jnp.maximum(jnp.ceil((low - ends[0] - SLACK) / (2.0 * jnp.pi)), 0.0)
    down = jnp.maximum(jnp.ceil((ends[1] - high - SLACK) / (2.0 * jnp.pi)), 0.0)
    return jax.lax.stop_gradient(jnp.where(both, whole, down - up))


def _cheapest(table, machine: Machine, branch: int | None):
    """Cost of either beginning, and the solution of each sample on the cheaper one.

    Dynamic programming from the end of the path: what is left to pay from each solution.
    """
    order = jnp.asarray(rotary_order(machine))
    given = (machine.max_speed, machine.lower, machine.upper)
    speed, low, high = (x[order][None, None] for x in given)
    slow = 1.0 / jnp.where(speed > 0.0, speed, 1.0)
    turn = 2.0 * jnp.pi
    # the least distance from travel that whole turns leave
    below = low - table
    lifted = table + turn * jnp.maximum(jnp.ceil(below / turn - SLACK), 0.0)
    lowered = lifted - turn * jnp.maximum(jnp.ceil((lifted - high) / turn - SLACK), 0.0)
    outside = jnp.maximum(jnp.maximum(low - lowered, lowered - high), 0.0)
    outside = jnp.where(outside > SLACK, OUTSIDE * (1.0 + outside), 0.0)
    outside = jnp.sum(outside, axis=-1)
    if branch is not None:
        outside = outside.at[:, 1 - branch].set(jnp.inf)
    # time between all pairs of solutions of neighbouring samples (n - 1, from, to)
    move = table[1:, None, :, :] - table[:-1, :, None, :]
    move = jnp.abs(move - turn * jnp.round(move / turn)) * slow[None]
    time = jnp.max(move, axis=-1)
    stay = jnp.stack([time[:, 0, 0], time[:, 1, 1]], axis=-1)
    swap = jnp.stack([time[:, 0, 1], time[:, 1, 0]], axis=-1)
    swap = jnp.where(swap < stay, swap, jnp.inf)

    def backward(left, row):
        stay, swap, outside = row
        by_stay, by_swap = stay + left, swap + left[::-1]
        return outside + jnp.minimum(by_stay, by_swap), by_swap < by_stay

    start = outside[-1]
    cost, swaps = jax.lax.scan(backward, start, (stay, swap, outside[:-1]), reverse=True)

    def follow(at, swaps):
        at = jnp.where(swaps[at], 1 - at, at)
        return at, at

    # a tie goes to the machine's own
    mine = machine.branch if branch is None else branch
    better = cost[1 - mine] < cost[mine]
    begin = jnp.where(better, 1 - mine, mine).astype(jnp.int32)
    _, rest = jax.lax.scan(follow, begin, swaps)
    return cost, jnp.concatenate([begin[None], rest]).astype(jnp.int32)
