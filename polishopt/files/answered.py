"""Answered: a config with the answer of a tuning written in, comments and layout kept."""

import copy
import os
from collections.abc import Mapping
from pathlib import Path

from ruamel.yaml.comments import CommentedMap

from .config import Loaded
from .document import dump
from .part import PointGrid, StepFace


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
