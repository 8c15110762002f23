"""Config: from a YAML file to a checked config, and back with the answer written in.

All mistakes of a file are reported at once, each with its line, the value as typed, what
is allowed and its unit. Neither JAX nor NumPy is imported.
"""

import copy
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError
from ruamel.yaml.comments import CommentedMap

from ..units import label, suffix
from .asked import Chance
from .choices import combinations, named, title
from .document import (
    ConfigError as ConfigError,
    Keys,
    Problem,
    dump,
    parse,
    read_text,
    survey,
    write_text as write_text,
)
from .given import Lines, Nurbs, PointGrid, StepFace
from .library import SHELVES, filled, names
from .override import CHOICES, override
from .place import Located, problems_in
from .point_grid import PointGridError, read_points
from .quantity import Tuned, internal as internal
from .schema import Config, StepConfig, erring, json_schema as json_schema
from .sentence import did_you_mean, shown, typed
from .step_face import StepFaceError, read_face
from .steps import split


# By what factor the sides of a sheet may differ from the lengths of a face on it.
MISMATCH = 2.0


@dataclass(frozen=True)
class Loaded:
    """A config that passed every check."""

    config: StepConfig
    """The values, presets filled in; in a plan, those of its last step."""
    document: CommentedMap
    """The YAML document as typed, overrides written in, presets not filled in."""
    path: Path
    """The file it came from."""
    text: str
    """That file's text, without overrides."""
    measured: str = ""
    """What was measured as the start surface, and what is done to it."""
    steps: tuple[tuple[str, StepConfig], ...] = ()
    """Name and values of each step of a plan; empty for a step alone."""
    alternatives: "tuple[Loaded, ...]" = ()
    """The config with each combination of its choices, its own values first if they are
    one; empty for a config without choices."""
    chosen: Mapping[str, str] = field(default_factory=dict)
    """In one of them, the alternatives by key, as tables show them."""

    @property
    def name(self) -> str:
        """What a combination of choices is called: `guide.order 2, abrasive P600`."""
        return title(self.chosen)

    @property
    def configs(self) -> tuple[StepConfig, ...]:
        """The values of each step, or of the only one."""
        return tuple(config for _, config in self.steps) or (self.config,)


def load(path: str | Path, overrides: Sequence[str] = ()) -> Loaded:
    """A config file, read, overridden and checked.

    Args:
        path: The YAML file.
        overrides: Each as `key.key=value`, written into the document before the checks.

    Raises:
        ConfigError: with every mistake found, as lines to print.
    """
    path = Path(path)
    return check(read_text(path), path, overrides)


def check(text: str, path: Path, overrides: Sequence[str] = ()) -> Loaded:
    """The text of a config, overridden and checked.

    Args:
        text: What the file holds, or is about to.
        path: The file; a relative path of a start surface starts at its folder.
        overrides: As in `load`.

    Raises:
        ConfigError: with every mistake found, as lines to print.
    """
    document = parse(text, str(path))
    origin = override(document, overrides)
    place = Located(str(path), text, survey(document, str(path)), origin)
    made, wrong = combinations(document, place)
    loaded, problems = whole(document, place, path)
    if loaded is None or wrong:
        raise ConfigError(unique([*problems, *wrong]))
    alternatives, wrongs = [], {}
    for one in made:
        alternative, problems = whole(one.document, one.place, path, one.chosen)
        if alternative is None:
            wrongs[title(one.chosen)] = problems
        elif not any(step.tuned() for step in alternative.configs):
            sentence = "choices are compared by what tuning makes of them: nothing is tuned"
            wrongs[title(one.chosen)] = [place.problem((CHOICES,), sentence, at_key=True)]
        else:
            alternatives.append(alternative)
    if wrongs:
        raise ConfigError(named(wrongs))
    own = (loaded.config, loaded.steps)
    alternatives.sort(key=lambda one: (one.config, one.steps) != own)
    return replace(loaded, alternatives=tuple(alternatives))


def whole(
    document: CommentedMap,
    place: Located,
    path: Path,
    chosen: Mapping[str, str] | None = None,
) -> tuple[Loaded | None, list[Problem]]:
    """A document as a config, or None and what is wrong with it; choices are not read.

    Args:
        document: Overrides written in.
        place: Where everything was typed.
        path: The file.
        chosen: Which alternatives stand in the document.
    """
    data, unknown = filled(place.found.data)
    data.pop(CHOICES, None)
    name = root_file(data, "start", path.parent)
    root_file(data, "part", path.parent)

    problems = [
        place.problem(keys, f"{shown(keys)} has no value", at_key=True)
        for keys in place.found.empty
    ]
    problems += no_such_presets(unknown, place)
    excused = [at for at, _ in unknown]
    steps: list[tuple[str, StepConfig]] = []
    config = None
    if "steps" in data:
        listed, wrong = split(data, place)
        problems += wrong
        for step in listed:
            problems += no_such_presets(step.unknown, step.place)
            lost = [*excused, *(at for at, _ in step.unknown)]
            one, wrong = checked(StepConfig, step.data, step.place, lost)
            problems += wrong
            if one is not None:
                steps.append((step.name, one))
                config = one
        if not problems and all(one.target is None for _, one in steps):
            tuned = any(one.tuned() for _, one in steps)
            if tuned:
                sentence = "a plan that tunes settings needs a `target`"
                problems.append(place.problem(("steps",), sentence, at_key=True))
        if not problems:
            problems += uneven(steps, place)
        for name in config.errors if config is not None and not problems else ():
            wrongs = [erring(one, name) for _, one in steps]
            if all(wrongs):
                sentence = f"errors.{name} {wrongs[-1]}, in at least one step"
                problems.append(place.problem(("errors", name), sentence))
    else:
        config, wrong = checked(Config, data, place, excused)
        problems += wrong
    if config is None:
        return None, problems
    measured = ""
    if config.start.file is not None:
        from .measured import TopographyError, sample  # brings NumPy along

        try:
            *_, sentence = sample(config.start.file, config.sampling.start_points)
            measured = f"{name}: {sentence}"
        except TopographyError as error:
            problems.append(place.problem(("start", "file"), f"start.file: {error}"))
    part = config.part
    if isinstance(part, PointGrid):
        try:
            rows = len(read_points(part.file, part.columns))
            if part.control_points[0] > rows or part.control_points[1] > part.columns:
                sentence = (
                    f"part.control_points must not exceed the points, {rows} rows of "
                    f"{part.columns}"
                )
                problems.append(place.problem(("part", "control_points"), sentence))
        except PointGridError as error:
            problems.append(place.problem(("part", "file"), f"part.file: {error}"))
    if isinstance(part, StepFace):
        problems += step_problems(part, place)
    if problems:
        return None, problems
    loaded = Loaded(config, document, path, place.text, measured, tuple(steps))
    return replace(loaded, chosen=chosen or {}), []


Kind = TypeVar("Kind", bound=StepConfig)


def checked(
    kind: type[Kind], data: Any, place: Located, excused: Sequence[Keys]
) -> tuple[Kind | None, list[Problem]]:
    """The values as a config, or None and what is wrong with them.

    Args:
        kind: What they are to be.
        data: The plain values, presets filled in.
        place: Where they were typed.
        excused: Sections whose missing keys are not worth a word.
    """
    try:
        return kind.model_validate(data), []
    except ValidationError as error:
        # a section whose preset is unknown lacks its keys for that reason alone
        return None, problems_in(error, data, place, excused)


def step_problems(part: StepFace, place: Located) -> list[Problem]:
    """What is wrong with a face of a STEP file, in a sentence."""
    try:
        found = read_face(part.file, part.face)
    except StepFaceError as error:
        prefix = "part.file: " if error.key == "file" else ""
        return [place.problem(("part", error.key), f"{prefix}{error}")]
    pairs = zip(part.size_mm, found.lengths, strict=True)
    if all(1 / MISMATCH < side / length < MISMATCH for side, length in pairs):
        return []
    typed_sides = ", ".join(f"{side:g}" for side in part.size_mm)
    lengths = " mm along u and ".join(f"{length:.4g}" for length in found.lengths)
    sentence = (
        f"part.size_mm is [{typed_sides}], must be near the lengths of the face, "
        f"{lengths} mm along v"
    )
    return [place.problem(("part", "size_mm"), sentence)]


def uneven(steps: Sequence[tuple[str, StepConfig]], place: Located) -> list[Problem]:
    """A sentence where maps of texture could not be handed from step to step."""
    goals = [goal for _, one in steps for _, goal in one.target or () if goal is not None]
    grids = {one.sampling.grid for _, one in steps}
    if len(grids) == 1 or all(goal.at == "mean" for goal in goals):
        return []
    sentence = "a goal at the worst place needs the same `sampling.grid` in all steps"
    return [place.problem(("steps",), sentence, at_key=True)]


def no_such_presets(unknown: Sequence[tuple[Keys, Any]], place: Located) -> list[Problem]:
    """A sentence for each preset that does not exist."""
    problems = []
    for at, name in unknown:
        known = names(SHELVES[at])  # pyright: ignore[reportArgumentType]
        sentence = f"{shown(at)}: there is no preset {typed(name)}"
        sentence += f"{did_you_mean(name, known) or ';'} there are {', '.join(known)}"
        spelt = (*at, "preset")
        problems.append(
            place.problem(spelt if spelt in place.found.values else at, sentence)
        )
    return problems


def unique(problems: Sequence[Problem]) -> list[Problem]:
    """Each problem once: what stands at the top of a plan is wrong for every step."""
    return list(dict.fromkeys(problems))


def root_file(data: Any, section: str, folder: Path) -> str:
    """Makes the path of a file in a section start at a folder; returns it as typed.

    Args:
        data: The plain values of a config, changed in place.
        section: The section that may name a file.
        folder: Where a relative path starts.
    """
    inside = data.get(section)
    name = inside.get("file") if isinstance(inside, dict) else None
    if not isinstance(name, str):
        return ""
    inside["file"] = str(folder / name)
    return name


def optimum(
    loaded: Loaded, answers: Mapping[str, float], folder: str | Path | None = None
) -> str:
    """The config with an answer written in as the new `start` of each tuned value.

    Comments and layout are kept. Values are rounded to six digits, and rounding never
    leaves the range given in `between`.

    Args:
        loaded: The config that was solved.
        answers: The answer by key and in the unit of the key: `{"tilt_deg": 7.5}`; in a
            plan by step and key, `{"P600 tilt_deg": 7.5}`.
        folder: Where the text will lie, if elsewhere: then the path of a start surface is
            written as seen from there.

    Raises:
        ValueError: if a key is not tuned in this config.
    """
    document = copy.deepcopy(loaded.document)
    steps = loaded.steps or (("", loaded.config),)
    for name, value in answers.items():
        step, _, key = name.rpartition(" ")
        index = [known for known, _ in steps].index(step)
        tuned = steps[index][1].tuned()
        if key not in tuned:
            raise ValueError(f"`process.{key}` is not tuned in {loaded.path}.")
        low, high = tuned[key].between
        rounded = min(max(float(f"{value:.6g}"), low), high)
        section = document["steps"][index] if loaded.steps else document
        if key in section.get("process", {}):
            section["process"][key]["start"] = rounded
        else:
            # tuned for every step at the top, but each step has an answer of its own
            own = section.setdefault("process", CommentedMap())
            own[key] = CommentedMap({"start": rounded, "between": [low, high]})
    surface = loaded.config.start.file
    if folder is not None and surface is not None:
        document["start"]["file"] = seen_from(surface, folder)
    if folder is not None and isinstance(loaded.config.part, PointGrid | StepFace):
        document["part"]["file"] = seen_from(loaded.config.part.file, folder)
    return dump(document)


def seen_from(path: str, folder: str | Path) -> str:
    """A path relative to a folder, or whole where there is no way between their drives."""
    try:
        return Path(os.path.relpath(path, folder)).as_posix()
    except ValueError:
        return str(Path(path).absolute())


def describe(loaded: Loaded) -> str:
    """A summary of a config for people: what is given, tuned, wanted and limited.

    Args:
        loaded: A checked config; of a plan, every step is summed up.
    """
    parts = [
        f"step {i + 1}, {name}\n{described(config, loaded.measured if i == 0 else '')}"
        for i, (name, config) in enumerate(loaded.steps)
    ]
    parts = parts or [described(loaded.config, loaded.measured)]
    if loaded.alternatives:
        parts.append(compared(loaded))
    return "\n\n".join(parts)


def compared(loaded: Loaded) -> str:
    """The choices of a config in a sentence or two.

    Args:
        loaded: A checked config with choices.
    """
    words: dict[str, list[str]] = {}
    for one in loaded.alternatives:
        for key, word in one.chosen.items():
            if word not in words.setdefault(key, []):
                words[key].append(word)
    listed = "; ".join(f"{key} {', '.join(found)}" for key, found in words.items())
    return (
        f"choices: {listed}\npolishopt.fit tunes all {len(loaded.alternatives)} "
        "combinations, and all of them pass this check; above are the config's own values"
    )


def described(config: StepConfig, measured: str = "") -> str:
    """A summary of one step.

    Args:
        config: A checked config.
        measured: What is known of a measured start surface.
    """

    def quantity(key: str, value: Any) -> str:
        unit = label(suffix(key))
        if isinstance(value, Tuned):
            low, high = value.between
            return f"tuned in [{low:g}, {high:g}] {unit}, from {value.start:g}".replace(
                " ,", ","
            )
        return f"{value:g} {unit}".rstrip()

    def word(key: str) -> str:
        unit = suffix(key)
        return (key.removesuffix("_" + unit) if unit else key).replace("_", " ")

    part, tool, guide = config.part, config.tool, config.guide
    sides = " x ".join(f"{side:g}" for side in part.size_mm)
    kind = part.surface.replace("_", " ")
    for key in ("radius_mm", "conic", "twist_1_mm"):
        if hasattr(part, key):
            kind += f", {word(key)} {quantity(key, getattr(part, key))}"
    if isinstance(part, Nurbs):
        kind += f", {len(part.net_mm)} x {len(part.net_mm[0])} control points"
    if isinstance(part, PointGrid | StepFace):
        kind += f" {part.file}"
    if isinstance(part, StepFace) and part.face is not None:
        kind += f", face {part.face}"
    keys = ("order", "count", "turns", "repeats", "angle_deg", "segment_mm")
    density = ", ".join(
        f"{word(key)} {quantity(key, getattr(guide, key))}"
        for key in keys
        if hasattr(guide, key)
    )
    if isinstance(guide, Lines):
        density = f"{guide.count} lines" + (" one way" if guide.one_way else "")
    density += ", even by area" if guide.even else ""
    family = guide.family.replace("_", " ")
    start = [key for key, value in config.start if value is not None]
    goals = [
        f"{word(key)} {goal.value:g} ± {goal.tolerance:g} {label(suffix(key))}".rstrip()
        + (" at the worst place" if goal.at == "worst" else "")
        for key, goal in config.target or ()
        if goal is not None
    ]
    holds = {"unstick": tool.unstick or tool.shear_strength_MPa}

    def likely(key: str, value: Any) -> str:
        if isinstance(value, Chance):
            odds = quantity("probability_percent", value.probability_percent)
            return f"{word(key)} with a chance of at most {odds}"
        return word(key) if value is True else f"{word(key)} {quantity(key, value)}"

    limits = [
        likely(key, value) + ("" if holds.get(key, True) else " (this tool has no table)")
        for key, value in config.limits
        if value is not None and value is not False
    ]
    errors = [(key, e) for key, e in config.errors.items() if not erring(config, key)]
    grain = quantity("grain_um", config.abrasive.grain_um)
    rows = [
        ("title", config.title),
        ("part", f"{kind}, {sides} mm"),
        (
            "tool",
            f"{tool.preset or 'own'}, diameter {quantity('diameter_mm', tool.diameter_mm)}",
        ),
        ("abrasive", f"{config.abrasive.preset or 'own'}, grain {grain}"),
        ("machine", config.machine.preset or "own"),
        ("guide", f"{family}, {density}, {guide.corner} corners, {guide.mode}"),
        *(
            (word(key), quantity(key, value))
            for key, value in config.process.given().items()
        ),
        ("start", measured or ", ".join(start)),
        ("target", ", ".join(goals) or "none"),
        ("limits", ", ".join(limits) or "none"),
        ("errors", ", ".join(f"{key} ± {e:g}" for key, e in errors)),
        ("secondary", config.secondary),
        ("program", ", ".join(config.program.dialects) or "none"),
        ("pre-flight", "python -m polishopt.program --check runs the path and looks at it"),
    ]
    width = max(len(name) for name, _ in rows)
    return "\n".join(f"{name:<{width}}  {text}" for name, text in rows if text)
