"""Preflight: what a machine will make of a path, in sentences, before it is run.

Some findings are in the way: a position beyond the travel of an axis, an axis that cannot
move, an orientation that the rotary axes cannot give. The others are what an operator
wants to know: how long it takes, how hard the rotary axes work, and where the path passes
the pole, near which the rotary axis next to the part whips round.
"""

from collections.abc import Callable
from dataclasses import dataclass

import jax
import numpy as np

from .blocks import chunks, poses_of
from .machine.feed import limiting_name
from .machine.jerk import JerkLaw, check
from .machine.kinematics import pole_distance, rotary_order
from .machine.route import standing
from .parts import Machine, Process
from .resolved import Run
from .stored import seldom


# An orientation counts as reached within this angle [rad].
ALIGNED = 1e-4
# A position counts as beyond a travel, and an axis as moving, from here on [mm or rad].
BEYOND = 1e-6
# Angle to the pole from which on a fast turn is put down to it [rad].
NEAR_POLE = np.radians(5.0)


@dataclass(frozen=True)
class Finding:
    """Something that a machine's owner should know."""

    sentence: str
    """What it is."""
    prevents: bool = False
    """Whether the path cannot be run for it."""


def position(value: float, axis: int) -> str:
    """A position of an axis, by its number, as people write it."""
    return f"{np.degrees(value):.4g}°" if axis > 2 else f"{value:.5g} mm"


def obstacles(path: Run, machine: Machine) -> list[Finding]:
    """What keeps a machine from running a path at all; empty if nothing does.

    Args:
        path: From `resolved.run`.
        machine: The machine.
    """
    axes, names = np.asarray(path.axes), machine.names
    wanted = np.asarray(path.posture.axis)

    def at(sample: int) -> str:
        place = ", ".join(f"{x:.3f}" for x in np.asarray(path.posture.contact)[sample])
        return f"at sample {sample + 1} of {axes.shape[0]}, ({place}) mm on the part"

    _, axis = poses_of(axes, machine)
    missed = ~(np.linalg.norm(axis - wanted, axis=1) <= ALIGNED)
    if missed.any():
        first = int(np.argmax(missed))
        way = ", ".join(f"{x:.5f}" for x in wanted[first])
        return [
            Finding(
                f"{names[3]} and {names[4]} cannot point the tool along ({way}), as asked "
                f"{at(first)}.",
                prevents=True,
            )
        ]
    found = beyond(axes, machine, at)
    still = [fault.sentence for fault in standing(axes, machine)]
    found += [f"{sentence[0].upper()}{sentence[1:]}." for sentence in still]
    if not found and isinstance(path.law, JerkLaw):
        found += _without_feed(path.law, machine, at)
    time = np.asarray(path.law.time)
    if not found and not np.isfinite(time[-1]):
        stuck = int(np.argmax(~np.isfinite(time)))
        limit = limiting_name(np.asarray(path.law.limiting)[stuck], names)
        found.append(f"The motion comes to a stop {at(stuck)}: {limit}.")
    return [Finding(sentence, prevents=True) for sentence in found]


def _without_feed(law: JerkLaw, machine: Machine, at: Callable[[int], str]) -> list[str]:
    """A sentence where no feed keeps all limits; nothing where there is one."""
    try:
        check(law, machine)
    except ValueError as error:
        sentence = str(error)
        return [f"{sentence[0].upper()}{sentence[1:]}, {at(int(law.fault.sample))}."]
    return []


def beyond(axes: np.ndarray, machine: Machine, at: Callable[[int], str]) -> list[str]:
    """Sentences on axis positions that lie beyond the travels.

    Args:
        axes: Positions of the linear [mm] and rotary axes [rad], one a row.
        machine: The machine.
        at: Where a row lies, in words.
    """
    found, names = [], machine.names
    for i, (low, high) in enumerate(
        zip(machine.lower.tolist(), machine.upper.tolist(), strict=True)
    ):
        over = np.maximum(low - axes[:, i], axes[:, i] - high)
        if over.max() > BEYOND:
            worst, first = int(np.argmax(over)), int(np.argmax(over > BEYOND))
            left = f", which it first leaves at sample {first + 1}" if first < worst else ""
            found.append(
                f"{names[i]} would have to reach {position(axes[worst, i], i)} "
                f"{at(worst)}, beyond its travel from {position(low, i)} to "
                f"{position(high, i)}{left}."
            )
    return found


def remarks(path: Run, process: Process, machine: Machine) -> list[Finding]:
    """What running the path will be like: its time, its rotary axes and its pole.

    Args:
        path: From `resolved.run`, and without obstacles.
        process: Its settings.
        machine: The machine.
    """
    sentences = [_duration(path, process, machine)]
    sentences += [_turning(path, machine, i) for i in (3, 4)]
    return [Finding(s) for s in (*sentences, _pole(path, process, machine))]


def _duration(path: Run, process: Process, machine: Machine) -> str:
    """How long it takes, and what makes it longer than the feed alone would."""
    time, arc = np.asarray(path.law.time), np.asarray(path.arc)
    total, passes, feed = float(time[-1]), float(process.passes), float(process.feed)
    sentence = f"One pass takes {total / 60:.2f} min at {60 * feed:.6g} mm/min programmed"
    spent = np.bincount(np.asarray(path.law.limiting)[1:], np.diff(time))
    spent[0] = 0.0
    worst = int(np.argmax(spent))
    lost = total - float(arc[-1]) / feed
    if lost > 1e-3 * total:
        name = limiting_name(worst, machine.names)
        sentence += f", {lost:.3g} s of it lost to the axes, most to {name}"
    if passes != 1.0:
        sentence += f"; {passes:.6g} passes take {passes * total / 60:.2f} min"
    return sentence + "."


def _turning(path: Run, machine: Machine, i: int) -> str:
    """How hard a rotary axis works."""
    name, axes = machine.names[i], np.asarray(path.axes)[:, i]
    step = np.diff(np.asarray(path.law.time))
    limit = float(np.asarray(machine.max_speed)[i])
    speed = np.abs(np.diff(axes)) / np.where(step > 0, step, np.inf)
    if np.ptp(axes) <= BEYOND:
        return f"{name} stands still at {position(axes[0], i)}."
    sentence = (
        f"{name} moves between {position(axes.min(), i)} and {position(axes.max(), i)}, at "
        f"up to {np.degrees(speed.max()):.3g}°/s"
    )
    if np.isfinite(limit):
        sentence += f", {100 * min(speed.max() / limit, 1.0):.0f} % of its speed limit"
    code = np.asarray(path.law.limiting)[1:]
    limits = [limiting_name(c, machine.names) for c in range(code.max() + 1)]
    own = np.array([limit.split()[0] == name for limit in limits])
    share = float(step[own[code]].sum() / step.sum())
    if share > 0:
        sentence += f"; it limits the feed for {100 * share:.2g} % of the time"
    return sentence + "."


def _pole(path: Run, process: Process, machine: Machine) -> str:
    """How near the tool axis comes to the direction of the rotary axis next to the part."""
    axes, arc = np.asarray(path.axes), np.asarray(path.arc)
    (sine,) = chunks(lambda ways: _pole_sine(ways, machine), np.asarray(path.posture.axis))
    angle, i = np.arcsin(np.minimum(sine, 1.0)), rotary_order(machine)[0]
    name = machine.names[i]
    nearest = int(np.argmin(angle))
    within = f"{np.degrees(angle[nearest]):.3g}°"
    chord, turn = np.diff(arc), np.abs(np.diff(axes[:, i]))
    asked = turn * float(process.feed) / np.where(chord > 0, chord, np.inf)
    limit = float(np.asarray(machine.max_speed)[i])
    fast = (asked > limit) & (np.minimum(angle[1:], angle[:-1]) < NEAR_POLE)
    if not fast.any():
        return f"The tool axis comes no nearer to the direction of {name} than {within}."
    count = int(np.count_nonzero(np.diff(fast.astype(int), prepend=0) == 1))
    feed = np.asarray(path.law.feed)[1:][fast]
    times = "once" if count == 1 else f"{count} times"
    return (
        f"The tool axis passes the pole, the direction of {name}, {times}: as near as "
        f"{within} at sample {nearest + 1} of {angle.size}. There {name} would have to "
        f"turn at up to {asked.max() / limit:.3g} times its speed limit, and the feed "
        f"falls to {60 * feed[feed > 0].min(initial=np.inf):.3g} mm/min."
    )


@seldom
def _pole_sine(ways, machine):
    """Sine of the angle between each tool axis and the pole."""
    return (jax.vmap(lambda way: pole_distance(way, machine))(ways),)
