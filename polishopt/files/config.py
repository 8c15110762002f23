"""Config: from a YAML file to a checked config.

All mistakes of a file are reported at once, each with its line, the value as typed, what
is allowed and its unit. Neither JAX nor NumPy is imported.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError
from ruamel.yaml.comments import CommentedMap

from .choices import combinations, named, title
from .document import (
    ConfigError as ConfigError,
    Keys,
    Problem,
    parse,
    read_text,
    survey,
    write_text as write_text,
)
from .library import SHELVES, filled, names
from .override import CHOICES, override
from .part import PointGrid, StepFace
from .place import Located, problems_in
from .point_grid import PointGridError, read_points
from .quantity import internal as internal
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
