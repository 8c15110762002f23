"""Summary: what a config gives, tunes, wants and limits, for people to check."""

from typing import Any

from ..units import label, suffix
from .asked import Chance
from .config import Loaded
from .guides import Lines
from .part import Nurbs, PointGrid, StepFace
from .quantity import Tuned
from .schema import StepConfig, erring


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
