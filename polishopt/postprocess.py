"""Postprocess: a path as programs for controls, or the reasons why there can be none.

A program holds the moves of `blocks`, an approach and a retreat along the tool axis, and
the path as often as it is run. Every move has the time that the axes need for it. Nothing
is written unless all of it can be run, and then all at once.
"""

import os
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import equinox as eqx
import numpy as np

from . import evenness
from .blocks import Blocks, cut, poses_of
from .files.assemble import NAMES
from .files.ncode import DIALECTS, Header, Motion, Printed
from .files.programmed import Program
from .files.quantity import internal
from .files.schema import StepConfig
from .machine.kinematics import placed, sides
from .parts import Machine, Process
from .preflight import Finding, beyond, obstacles, remarks
from .resolved import Run, run, samples
from .setup import Setup
from .stored import stored
from .units import from_internal, label, suffix


# Travel of the driven point below which a feed is given for the rotary axes [mm].
STILL = 1e-6


@dataclass(frozen=True)
class Programs:
    """What a path is as programs."""

    findings: tuple[Finding, ...]
    """What the machine will make of it."""
    texts: dict[str, str]
    """Programs by their file names; empty where the path cannot be run."""
    names: tuple[str, ...]
    """All file names that programs of this path may have."""

    @property
    def prevented(self) -> list[str]:
        """Why it cannot be run; empty if it can."""
        return [one.sentence for one in self.findings if one.prevents]


@dataclass(frozen=True)
class Seen:
    """A path as a program's moves, and what the machine will make of it."""

    findings: list[Finding]
    printed: Printed | None = None
    """None where there is nothing to write."""
    duration: float = 0.0
    """Time of a pass [s]."""


def seen(path: Run, process: Process, setup: Setup, asked: Program) -> Seen:
    """Looks at a path, and cuts it into the moves of a program.

    Args:
        path: From `resolved.run` at phase zero.
        process: Its settings.
        setup: Its job.
        asked: How programs are to be.
    """
    machine, given = placed(setup.machine, process), internal(asked)
    blocked = obstacles(path, machine)
    if blocked:
        return Seen(blocked)
    findings = remarks(path, process, machine) + evenness.remarks(process, setup)
    if not asked.dialects:
        return Seen(findings)
    blocks = cut(path, process, setup, given["chord_tolerance"])
    motion, blocked = moves(blocks, process, machine, given)
    findings += [Finding(sentence, prevents=True) for sentence in blocked]
    findings.append(Finding(_lines(blocks, motion)))
    if blocked:
        return Seen(findings)
    printed = Printed(motion.rounded(asked.decimals), asked.decimals)
    return Seen(findings, printed, float(blocks.time[-1]))


def programs(
    path: Run, process: Process, setup: Setup, config: StepConfig, step: int = 0
) -> Programs:
    """A path as programs for the controls that its config names.

    Args:
        path: From `resolved.run` at phase zero.
        process: Its settings.
        setup: Its job.
        config: The config of both.
        step: Which step of a plan it is, from 1; 0 where there is but one.
    """
    return _written(
        seen(path, process, setup, config.program), process, setup, config, step
    )


def paths(jobs: Sequence[tuple[Process, Setup, StepConfig]]) -> list[Programs]:
    """Runs the path of every step of a config, and makes its programs.

    Args:
        jobs: Settings, job and config of each step, or of the only one.
    """
    made, last, look = [], None, Seen([])
    for i, (process, setup, config) in enumerate(jobs):
        # steps that differ in the abrasive alone take the same way
        way = (process, setup.surface, setup.guide, setup.tool.radius, setup.machine)
        way = (*way, setup.pulling, setup.lean, config.program)
        if not setup.flat:  # then how the disc presses is told, and may move it
            way = (*way, setup.hold, setup.tool)
        if last is None or not eqx.tree_equal(way, last):
            path = stored(run)(process, setup, samples(process, setup))
            look, last = seen(path, process, setup, config.program), way
        step = i + 1 if len(jobs) > 1 else 0
        made.append(_written(look, process, setup, config, step))
    return made


def stuck(jobs: Sequence[tuple[Process, Setup, StepConfig]]) -> list[str]:
    """What clamped axes of machines would have to do, however long one searches.

    Args:
        jobs: Settings to start from, job and config of each step, or of the only one.

    Returns:
        Sentences; empty where no axis is clamped, or none of those has to move.
    """
    found = []
    for process, setup, _ in jobs:
        clamped = np.asarray(setup.machine.max_speed) == 0
        if clamped.any():
            path = stored(run)(process, setup, samples(process, setup))
            machine = placed(setup.machine, process)
            found += [one.sentence for one in obstacles(path, machine)]
    return found


def _written(
    look: Seen, process: Process, setup: Setup, config: StepConfig, step: int
) -> Programs:
    """The programs of a path that was looked at."""
    asked = config.program
    stem = f"{asked.name}_{step}" if step else asked.name
    names = tuple(stem + one.ending for one in DIALECTS.values())
    if look.printed is None:
        return Programs(tuple(look.findings), {}, names)
    letters = setup.machine.names
    header = Header(
        name=stem,
        number=1000 + step,
        notes=tuple(_notes(process, setup, config, look.duration)),
        tool=asked.tool_number or step or 1,
        spindle=round(from_internal(float(process.spin), "rpm"), 3),
        clockwise=asked.spindle_direction == "clockwise",
        offset=asked.work_offset,
        rotary=(letters[3], letters[4]),
        tolerance=asked.chord_tolerance_mm,
    )
    texts = {
        stem + DIALECTS[name].ending: DIALECTS[name].write(look.printed, header)
        for name in asked.dialects
    }
    return Programs(tuple(look.findings), texts, names)


def deliver(made: Sequence[Programs], folder: Path) -> list[Path]:
    """Puts programs into a folder, all or none, and takes away older ones of these names.

    Args:
        made: The programs of one path, or of the steps of a plan.
        folder: Where to; made if it is not there.

    Returns:
        The files, none if one of the paths cannot be run.
    """
    possible = not any(one.prevented for one in made)
    texts = {k: v for one in made for k, v in one.texts.items()} if possible else {}
    if texts:
        folder.mkdir(parents=True, exist_ok=True)
        beside = Path(tempfile.mkdtemp(prefix=".program-", dir=folder))
        try:
            for name, text in texts.items():
                (beside / name).write_text(text, encoding="ascii", newline="\n")
            for name in texts:
                os.replace(beside / name, folder / name)
        finally:
            shutil.rmtree(beside, ignore_errors=True)
    # a program left by an earlier run would be one of another path
    for old in {name for one in made for name in one.names} - set(texts):
        (folder / old).unlink(missing_ok=True)
    return [folder / name for name in texts]


def moves(
    blocks: Blocks, process: Process, machine: Machine, asked: dict
) -> tuple[Motion, list[str]]:
    """All moves of a program, and what keeps the machine from the first and last ones.

    The path is run a whole number of times, and slower by what is missing: 2.5 passes are
    two, each a quarter longer. Where a rotary axis has no ends, a further pass begins at
    the equal angle nearest to where the last one ended.

    Args:
        blocks: The moves along the path.
        process: For its passes.
        machine: The machine.
        asked: The config's section, in mm and s.
    """
    clearance = asked["clearance"]
    ends = blocks.poses[np.array([0, -1])]
    away = ends.axes.copy()
    away[:, :3] += np.stack(
        [_along(*row, clearance, machine) for row in zip(ends.axes, ends.axis, strict=True)]
    )
    words = ("on the approach", "on the retreat")
    blocked = [
        sentence
        for row, word in zip(away, words, strict=True)
        for sentence in beyond(row[None], machine, lambda _, word=word: word)
    ]
    off = ends.tip + clearance * ends.axis
    tip = np.concatenate([off[:1], blocks.poses.tip, off[1:]])
    axis = np.concatenate([ends.axis[:1], blocks.poses.axis, ends.axis[1:]])
    axes = np.concatenate([away[:1], blocks.poses.axes, away[1:]])
    passes = max(int(process.passes), 1)
    slow = clearance / asked["approach_feed"]
    step = np.diff(blocks.time) * float(process.passes) / passes
    seconds = np.concatenate([[np.nan, slow], step, [slow]])
    free = np.isinf(machine.lower) & np.isinf(machine.upper) & (np.arange(5) > 2)
    turns = np.round((axes[-1] - axes[0]) / (2 * np.pi)) * 2 * np.pi * free
    axes = np.concatenate([axes + k * turns for k in range(passes)])
    tip, axis = np.tile(tip, (passes, 1)), np.tile(axis, (passes, 1))
    seconds = np.tile(seconds, passes)
    way = np.linalg.norm(np.diff(tip, axis=0, prepend=tip[:1]), axis=1)
    turned = np.abs(np.diff(axes[:, 3:], axis=0, prepend=axes[:1, 3:])).max(axis=1)
    # without a way of the tip, a feed is that of the rotary axes [deg/min]
    way = np.where(way > STILL, way, np.degrees(turned))
    motion = Motion(
        rapid=np.isnan(seconds),
        tip=tip,
        axis=axis,
        linear=axes[:, :3],
        rotary=np.degrees(axes[:, 3:]),
        feed=60.0 * way / seconds,
        seconds=seconds,
    )
    return motion, blocked


def _along(axes: np.ndarray, axis: np.ndarray, length: float, machine: Machine):
    """How far X, Y and Z go for the tip to move along the tool axis [mm]."""
    probes = np.tile(axes, (4, 1))
    probes[1:, :3] += np.eye(3)
    tips, _ = poses_of(probes, machine)
    return np.linalg.solve((tips[1:] - tips[:1]).T, length * axis)


def _lines(blocks: Blocks, motion: Motion) -> str:
    """How many lines there are, and how true they are."""
    sentence = (
        f"A program has {motion.rapid.size} moves and strays from the path by at most "
        f"{1000 * blocks.deviation:.3g} µm"
    )
    if blocks.jumps:
        times = "once" if blocks.jumps == 1 else f"{blocks.jumps} times"
        sentence += f"; the path jumps {times}, at sharp corners of the guide"
    return sentence + "."


def _notes(process: Process, setup: Setup, config: StepConfig, duration: float):
    """What people should know of a program: a word, and what it is."""
    part, tool, abrasive = config.part, config.tool, config.abrasive
    sides = " x ".join(f"{side:g}" for side in part.size_mm)
    letters = setup.machine.names
    yield "title", config.title or "untitled"
    yield "written by", f"polishopt {version('polishopt')}"
    yield "units", "mm, deg, mm/min"
    yield "part", f"{part.surface.replace('_', ' ')}, {sides} mm"
    yield "origin", "middle of the part, z out of the material"
    yield "axes resolved", f"{' '.join(letters)}; the origin as in the machine's pivots"
    yield "disc", f"{tool.preset or 'own'}, diameter {tool.diameter_mm:g} mm"
    yield "tool length", "to the middle of the disc's face"
    yield "abrasive", f"{abrasive.preset or 'own'}, grain {abrasive.grain_um:g} um"
    yield "machine", config.machine.preset or "own"
    yield from _standing(process, setup, config)
    for key in config.process.given():
        unit = suffix(key)
        word = key.removesuffix(f"_{unit}") if unit else key
        value = from_internal(float(getattr(process, NAMES.get(word, word))), unit)
        yield word.replace("_", " "), f"{value:.6g} {label(unit)}".strip()
    yield "chord tolerance", f"{config.program.chord_tolerance_mm:g} mm"
    yield "time of a pass", f"{duration / 60:.2f} min"


def _standing(process: Process, setup: Setup, config: StepConfig):
    """How the part stands on what carries it; nothing where it was not moved."""
    machine, places = placed(setup.machine, process), config.program.decimals
    offset = np.asarray(machine.offset)
    wedge = np.degrees([0.0 if angle is None else float(angle) for angle in machine.wedge])
    turned = [machine.names[axis] for axis in sides(machine)[0] if axis > 2]
    pivot = f"the pivot of {turned[0]}" if turned else "the machine's origin"
    told = (
        (offset, "mm", "part offset", "offset counts", f"from {pivot}, all axes at 0"),
        (wedge, "deg", "part wedge", "wedge turns", "about X, then Y, then Z"),
    )
    for values, unit, word, how, meaning in told:
        if values.any():
            sums = (
                f"{way} {round(value, places) + 0.0:.{places}f}"
                for way, value in zip("XYZ", values.tolist(), strict=True)
            )
            yield word, f"{' '.join(sums)} {unit}"
            yield how, meaning
