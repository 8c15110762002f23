"""Schema: a whole config file, and its JSON schema for editors.

Nothing in these modules computes physics, and nothing imports JAX: a mistake in a config
is reported before JAX is loaded.
"""

import json
import math
import re
import sys
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field, model_validator

from .asked import Chance, Limits, Process, Start, Target
from .guides import Family, Hatch, Hilbert, HilbertRectangle, Lines, Peano, PeanoRound
from .part import Part
from .programmed import Program
from .quantity import Between, Tuned, reject
from .section import Section, named
from .shop import Abrasive, Machine, Tool


# sections that a step of a plan may change key by key, and those that it may replace
MERGED = ("process", "limits", "program")
REPLACED = ("tool", "abrasive", "guide", "target", "texture", "sampling")

# the most cells of a guide: those of a Hilbert curve of the highest order
MAX_CELLS = 4**7
# where the constants stand that may have an error
ERRING = ("tool.", "abrasive.", "start.roughness.")
# those of them on which it depends whether the disc comes off
UNSTICKING = ("tool.diameter", "tool.foundation", "tool.stiffening", "tool.unstick")
SHEARING = ("tool.foundation", "tool.stiffening", "tool.friction", "tool.shear")


class Texture(Section):
    """How the texture is evaluated and drawn."""

    l_filter_mm: Annotated[float, Between("(0, 100]")] = 0.8
    """Cut-off of the roughness filter (L-filter): longer waves do not count."""
    margin_mm: Annotated[float, Between("[0, 1e4]")] | None = None
    """How far inside the edges of the part its worst place is looked for; left out, a
    tenth of the shorter side. Nearer to an edge the tool comes by less often."""
    patch_mm: Annotated[float, Between("(0, 100]")] | None = None
    """Side of the drawn patch of texture; left out, a mean groove is 8 pixels wide."""
    patch_pixels: Annotated[int, Between("[16, 4096]")] = 512
    """Pixels along each side of the drawn patch."""


class Solver(Section):
    """How the answer is searched for."""

    starts: Annotated[int, Between("[1, 4096]")] = 16
    """How many searches run side by side, from different places; the first from `start`."""
    seed: Annotated[int, Between("[0, 1e9]")] = 0
    """Seed of the other places."""
    tolerance: Annotated[float, Between("(0, 0.1]")] = 1e-6
    """How exactly the conditions of the optimum must hold."""


class Sampling(Section):
    """How finely the physics is sampled; for experts, to trade time for accuracy."""

    stations_per_cell: Annotated[int, Between("[1, 256]")] = 2
    """Nodes along each cell of the guide curve."""
    one_cell_in: Annotated[int, Between("[1, 4096]")] | None = None
    """How many cells that follow each other one stands for. By default as many as are a
    third of the disc's radius long, while 256 are looked at: a finer curve then takes time
    like its length, not like its cells."""
    phases: Annotated[int, Between("[4, 1024]")] = 12
    """Phases of the trochoid's loop at each of them."""
    rows: Annotated[int, Between("[1, 1024]")] = 3
    """Rows of the contact patch on either side of the feed."""
    columns: Annotated[int, Between("[1, 1024]")] = 2
    """Nodes along each of these rows."""
    grid: Annotated[int, Between("[8, 2048]")] = 32
    """Pixels along each side of the removal map."""
    planarisation: Annotated[int, Between("[1, 1024]")] = 16
    """Steps in which the wear of a height map is integrated."""
    start_points: Annotated[int, Between("[16, 1024]")] = 64
    """Most points along each side that are taken of a measured start surface."""


def erring(config: "StepConfig", name: str) -> str:
    """What is wrong with an error that is given for a key, or ''.

    Args:
        config: All sections.
        name: The key with its sections, `tool.unstick.force_N[0]`.
    """
    node: Any = config
    for key in re.sub(r"\[(\d+)\]", r".\1", name).split("."):
        if isinstance(node, tuple) and key.isdecimal() and int(key) < len(node):
            node = node[int(key)]
        elif isinstance(node, BaseModel) and key in type(node).model_fields:
            node = getattr(node, key)
        else:
            return "must stand under a key of this config, as tool.foundation_N_mm3"
    if not name.startswith(ERRING):
        return f"must stand under a key of {' or '.join(e[:-1] for e in ERRING)}"
    if isinstance(node, bool) or not isinstance(node, float):
        return "must stand under a key that is given as a number"
    return ""


class StepConfig(Section):
    """One polishing step: what is given, what to reach, and what to keep."""

    version: Literal[1] = Field(alias="schema")
    """Version of this file format."""
    title: str = ""
    """A name for reports."""
    part: Part
    """The surface to polish."""
    tool: Annotated[Tool, named("tools")]
    """The disc: a preset by name, keys, or a preset with some keys replaced."""
    abrasive: Annotated[Abrasive, named("abrasives")]
    """The abrasive: a preset by name, keys, or a preset with some keys replaced."""
    machine: Annotated[Machine, named("machines")]
    """The machine: a preset by name, keys, or a preset with some keys replaced."""
    guide: Family
    """The curve that the trochoid runs along."""
    process: Process
    """What is set on the machine, and which of it is tuned."""
    start: Start
    """The surface before this step."""
    target: Target | None = None
    """The texture to reach; a step of a plan need not have one."""
    limits: Limits = Limits()
    """What the answer must not exceed."""
    secondary: Literal["time", "force", "none"] = "time"
    """What to make small among answers that reach the target equally well."""
    texture: Texture = Texture()
    """How the texture is evaluated and drawn."""
    solver: Solver = Solver()
    """How the answer is searched for."""
    sampling: Sampling = Sampling()
    """How finely the physics is sampled."""
    program: Program = Program()
    """How the answer is written as programs for controls."""
    errors: dict[str, Annotated[float, Between("(0, inf)")]] = {}
    """Standard errors of constants, as `tool.foundation_N_mm3: 0.01`, in the unit of the
    key; `polishopt.calibrate` writes them."""

    @model_validator(mode="after")
    def _chance_has_errors(self):
        tool, chance = self.tool, self.limits.unstick
        needs = UNSTICKING if tool.unstick else SHEARING
        held = tool.unstick or tool.shear_strength_MPa
        if isinstance(chance, Chance) and held:
            given = [name for name in self.errors if not erring(self, name)]
            if not any(name.startswith(needs) for name in given):
                sentence = (
                    "asks for a probability, but no constant that the force or the disc's "
                    "hold depends on has a standard error; write, say, "
                    "errors: {tool.foundation_N_mm3: 0.01}"
                )
                reject((("limits", "unstick"), sentence, ...))
        return self

    @model_validator(mode="after")
    def _guide_fits(self):
        x, y = self.part.size_mm
        guide, ratio = self.guide, max(x, y) / min(x, y)
        wrong = ""
        if isinstance(guide, Hilbert) and abs(x - y) > 1e-6 * x:
            wrong = (
                "must be 'hilbert_rectangle' here: a Hilbert curve needs a square part, "
                f"and this one is {x:g} mm x {y:g} mm"
            )
        elif isinstance(guide, Peano) and abs(ratio - round(ratio)) > 1e-6 * ratio:
            wrong = (
                "must be another one here: a Peano curve needs a whole number as the ratio "
                f"of the sides, and this part is {x:g} mm x {y:g} mm"
            )
        elif isinstance(guide, Lines | Hatch) and guide.count * x <= y:
            sentence = (
                f"must be above {y / x:.4g}: lines of {x:g} mm cannot turn in {y:g} mm"
            )
            reject((("guide", "count"), sentence, guide.count))
        elif isinstance(guide, HilbertRectangle) and guide.count**2 * ratio > MAX_CELLS:
            sentence = f"must be lower: there would be over {MAX_CELLS} cells"
            reject((("guide", "count"), sentence, guide.count))
        elif isinstance(guide, HilbertRectangle) and guide.count * round(ratio) < 2:
            reject((("guide", "count"), "must be 2 or more on this part", guide.count))
        elif isinstance(guide, Peano) and 9**guide.order * ratio > MAX_CELLS:
            sentence = f"must be lower: there would be over {MAX_CELLS} cells"
            reject((("guide", "order"), sentence, guide.order))
        elif isinstance(guide, PeanoRound):
            if self.part.surface not in ("plane", "sphere_cap", "asphere"):
                wrong = (
                    "must be another one here: this one needs a surface of revolution, a "
                    "plane, sphere_cap or asphere"
                )
            elif guide.even:
                reject(
                    (
                        ("guide", "even"),
                        "must be left out: this path is even as it is",
                        True,
                    )
                )
            elif math.pi * min(x, y) ** 2 / 2 / guide.segment_mm**2 > 2 * MAX_CELLS:
                sentence = f"must be longer: there would be over {MAX_CELLS} segments"
                reject((("guide", "segment_mm"), sentence, guide.segment_mm))
            elif guide.segment_mm > min(x, y) / 6:
                sentence = (
                    f"must be at most a sixth of the shorter side, {min(x, y) / 6:.4g} mm"
                )
                reject((("guide", "segment_mm"), sentence, guide.segment_mm))
        if wrong:
            reject((("guide", "family"), wrong, guide.family))
        return self

    @model_validator(mode="after")
    def _margin_leaves_a_part(self):
        margin, most = self.texture.margin_mm, 0.4 * min(self.part.size_mm)
        if margin is not None and margin > most:
            sentence = f"must not exceed two fifths of the shorter side, {most:g} mm"
            reject((("texture", "margin_mm"), sentence, margin))
        return self

    def tuned(self) -> dict[str, Tuned]:
        """The process values that the optimiser moves, by key."""
        return {key: value for key, value in self.process if isinstance(value, Tuned)}


class Config(StepConfig):
    """A config file with one polishing step."""

    target: Target  # pyright: ignore[reportGeneralTypeIssues, reportIncompatibleVariableOverride]
    """The texture to reach."""

    @model_validator(mode="after")
    def _errors_have_keys(self):
        wrongs = [
            (("errors", name), f"{sentence}", value)
            for name, value in self.errors.items()
            if (sentence := erring(self, name))
        ]
        if wrongs:
            reject(*wrongs)
        return self


def brief(node: Any) -> Any:
    """A JSON schema without made-up titles and without null for what may be left out."""
    if isinstance(node, list):
        return [brief(part) for part in node]
    if not isinstance(node, dict):
        return node
    kept = {
        k: brief(v) for k, v in node.items() if not (k == "title" and isinstance(v, str))
    }
    if kept.get("default", ...) is None:
        del kept["default"]
    choices = [one for one in kept.get("anyOf", []) if one != {"type": "null"}]
    if len(choices) == 1:
        del kept["anyOf"]
        kept = {**choices[0], **kept}
    return kept


def json_schema() -> dict[str, Any]:
    """The JSON schema of a config file, presets not yet filled in.

    In a plan keys may stand at the top or in the steps, so there it asks for less than the
    check of the file does.
    """
    whole = brief(Config.model_json_schema(by_alias=True))
    sections = whole["properties"]
    partial = {key: f"Step{key.title()}" for key in MERGED}
    for key, name in partial.items():
        section = dict(whole["$defs"][key.title()])
        section.pop("required", None)
        whole["$defs"][name] = section
    step = {
        "name": {"type": "string", "description": "What the step is called."},
        **{k: {"$ref": f"#/$defs/{name}"} for k, name in partial.items()},
        **{k: sections[k] for k in REPLACED},
    }
    sections["steps"] = {
        "description": "Several steps one after another; each says what is different.",
        "type": "array",
        "minItems": 1,
        "items": {
            "type": "object",
            "additionalProperties": False,
            "properties": step,
            "required": ["name"],
        },
    }
    sections["choices"] = {
        "description": "Alternatives by key, as guide.order: [2, 3]; each combination is "
        "tuned, and the best one is the answer.",
        "type": "object",
        "additionalProperties": {"type": "array", "minItems": 1, "uniqueItems": True},
    }
    alone = whole.pop("required")
    shared = ["schema", "part", "machine", "start", "steps"]
    single = {"required": alone, "not": {"required": ["steps"]}}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "polishopt config",
        **whole,
        "anyOf": [single, {"required": shared}],
    }


def schema_text() -> str:
    """The JSON schema as `configs/schema.json` holds it."""
    return json.dumps(json_schema(), indent=2, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    # python -m polishopt.files.schema > configs/schema.json
    sys.stdout.write(schema_text())
