"""Quantity: numbers in a config file, each with the range in which it makes sense.

Three shapes occur. A plain number must lie in an interval. A tunable is a number (it
stays fixed) or `{start, between: [low, high]}` (the optimiser moves it). A goal is a
number or `{value, tolerance, at}`. The interval is written once, as people write it, and
serves the check, the sentence that reports it and the JSON schema.
"""

import math
import re
from dataclasses import dataclass
from typing import Annotated, Any, Literal, NoReturn

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic_core import InitErrorDetails, PydanticCustomError, core_schema

from ..units import suffix, to_internal


BRIEF = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)


def sentence(said: str) -> PydanticCustomError:
    """An error that says just this."""
    # a sentence is no template: braces in it are braces
    return PydanticCustomError("sentence", "{said}", {"said": said})


def reject(*wrongs: tuple[tuple, str | PydanticCustomError, Any]) -> NoReturn:
    """Raises a validation error for each (keys below here, sentence, value typed)."""
    details = []
    for keys, why, value in wrongs:
        if isinstance(why, str):
            why = sentence(why)
        details.append(InitErrorDetails(type=why, loc=keys, input=value))
    raise ValidationError.from_exception_data("config", details)


@dataclass(frozen=True)
class Between:
    """An interval as people write it, `(0, 45]`; in `Annotated`, the range of a number."""

    interval: str

    def ends(self) -> tuple[str, float, float, str]:
        """The opening bracket, the two ends and the closing bracket."""
        parts = re.fullmatch(r"([\[(])(\S+), (\S+)([\])])", self.interval)
        if parts is None:
            raise ValueError(
                f"`Between({self.interval!r})` is no interval such as '(0, 45]'."
            )
        return parts[1], float(parts[2]), float(parts[3]), parts[4]

    def holds(self, value: float | int) -> bool:
        """Whether `value` lies in the interval."""
        left, low, high, right = self.ends()
        above = value > low if left == "(" else value >= low
        below = value < high if right == ")" else value <= high
        return above and below

    def check(self, value: Any) -> Any:
        """The value itself, if it lies in the interval."""
        if not self.holds(value):
            raise self.error()
        return value

    def error(self) -> PydanticCustomError:
        """The error for a value outside."""
        return PydanticCustomError(
            "interval", "must lie in {interval}", {"interval": self.interval}
        )

    def json(self) -> dict[str, Any]:
        """The interval in the words of JSON Schema."""
        left, low, high, right = self.ends()
        bounds = {
            "exclusiveMinimum" if left == "(" else "minimum": low,
            "exclusiveMaximum" if right == ")" else "maximum": high,
        }
        finite = {key: end for key, end in bounds.items() if math.isfinite(end)}
        return {"type": "number", **finite}

    def number(self) -> core_schema.CoreSchema:
        """A finite number of the interval; text and true/false are no numbers."""
        plain = core_schema.float_schema(strict=True, allow_inf_nan=False)
        return core_schema.no_info_after_validator_function(self.check, plain)

    def __get_pydantic_core_schema__(self, source: Any, handler: Any):
        if source is int:
            whole = core_schema.int_schema(strict=True)
            return core_schema.no_info_after_validator_function(self.check, whole)
        return self.number()

    def __get_pydantic_json_schema__(self, schema: Any, handler: Any):
        return {**self.json(), "type": handler(schema)["type"]}


# Any finite number: its range depends on where it stands, and is checked there.
ANY = Between("(-inf, inf)")


class Tuned(BaseModel):
    """A process value that the optimiser moves."""

    model_config = BRIEF

    start: Annotated[float, ANY]
    """Where the search begins."""
    between: tuple[Annotated[float, ANY], Annotated[float, ANY]]
    """The lowest and the highest value allowed."""


@dataclass(frozen=True)
class Tunable(Between):
    """The range of a value that is a number, or `{start, between: [low, high]}`."""

    def order(self, tuned: Tuned) -> Tuned:
        """The tuned value itself, if start and ends lie in the range and in order."""
        (low, high), start = tuned.between, tuned.start
        ends = {("start",): start, ("between", 0): low, ("between", 1): high}
        wrongs: list[tuple[tuple, str | PydanticCustomError, Any]] = [
            (keys, self.error(), value)
            for keys, value in ends.items()
            if not self.holds(value)
        ]
        if low >= high:
            wrongs.append(
                (
                    ("between",),
                    "must have the lower end first, then a higher one",
                    [low, high],
                )
            )
        elif not low <= start <= high:
            wrongs.append(
                (("start",), f"must lie in `between`, [{low:g}, {high:g}]", start)
            )
        if wrongs:
            reject(*wrongs)
        return tuned

    def __get_pydantic_core_schema__(self, source: Any, handler: Any):
        tuned = handler.generate_schema(Tuned)
        return core_schema.tagged_union_schema(
            {
                "fixed": self.number(),
                "tuned": core_schema.no_info_after_validator_function(self.order, tuned),
            },
            discriminator=lambda value: (
                "tuned" if isinstance(value, dict | Tuned) else "fixed"
            ),
        )

    def __get_pydantic_json_schema__(self, schema: Any, handler: Any):
        tuned = {
            "type": "object",
            "description": "The optimiser moves this value.",
            "properties": {
                "start": {**self.json(), "description": "Where the search begins."},
                "between": {
                    "type": "array",
                    "description": "The lowest and the highest value allowed.",
                    "prefixItems": [self.json(), self.json()],
                    "minItems": 2,
                    "maxItems": 2,
                },
            },
            "required": ["start", "between"],
            "additionalProperties": False,
        }
        return {"anyOf": [{**self.json(), "description": "Stays fixed."}, tuned]}


class Goal(BaseModel):
    """A texture parameter to reach."""

    model_config = BRIEF

    value: Annotated[float, ANY]
    """The value to reach."""
    tolerance: Annotated[float, Between("(0, 1e6]")]
    """How near is near enough; it also weighs this goal against the others."""
    at: Literal["mean", "worst"] = "mean"
    """Mean: the texture at the mean removal is to have the value. Worst: the worst place of
    the part is to lie within the tolerance."""


@dataclass(frozen=True)
class Aim(Between):
    """The range of a goal, and its tolerance: a number, or a share of the value."""

    tolerance: float | None = None
    share: float = 0.1

    def fill(self, typed: Any) -> Any:
        """`{value, tolerance}` from whatever was typed."""
        if isinstance(typed, Goal):
            return typed
        goal = dict(typed) if isinstance(typed, dict) else {"value": typed}
        if "tolerance" not in goal:
            value = goal.get("value")
            # a value that is no number fails its own check
            size = abs(value) if isinstance(value, float | int) and value else 1.0
            goal["tolerance"] = self.tolerance or self.share * size
        return goal

    def aimed(self, goal: Goal) -> Goal:
        """The goal itself, if its value lies in the range."""
        if not self.holds(goal.value):
            reject((("value",), self.error(), goal.value))
        return goal

    def __get_pydantic_core_schema__(self, source: Any, handler: Any):
        goal = handler.generate_schema(Goal)
        filled = core_schema.no_info_before_validator_function(self.fill, goal)
        return core_schema.no_info_after_validator_function(self.aimed, filled)

    def __get_pydantic_json_schema__(self, schema: Any, handler: Any):
        number = self.json()
        close = (
            f"{self.tolerance:g}" if self.tolerance else f"{self.share:.0%} of the value"
        )
        goal = {
            "type": "object",
            "properties": {
                "value": {**number, "description": "The value to reach."},
                "tolerance": {
                    **Between("(0, 1e6]").json(),
                    "description": f"How near is near enough; {close} if not given.",
                },
                "at": {
                    "enum": ["mean", "worst"],
                    "description": "Mean: the texture at the mean removal is to have the "
                    "value. Worst: all places are to lie within the tolerance.",
                },
            },
            "required": ["value"],
            "additionalProperties": False,
        }
        return {"anyOf": [number, goal]}


def internal(section: BaseModel) -> dict[str, Any]:
    """The numbers of a section in mm, N, s and rad, under names without units.

    `{"diameter": 18.0, ...}` for `diameter_mm: 18`. Numbers and lists of numbers are
    converted, everything else (words, sections, goals, tuned values) is left as it is.

    Args:
        section: A validated section of the config.
    """

    def convert(value: Any, unit: str) -> Any:
        if isinstance(value, float):
            return to_internal(value, unit)
        if isinstance(value, tuple):
            return tuple(convert(part, unit) for part in value)
        if isinstance(value, Tuned):
            low, high = value.between
            ends = (to_internal(low, unit), to_internal(high, unit))
            return Tuned(start=to_internal(value.start, unit), between=ends)
        if isinstance(value, Goal):
            near = to_internal(value.tolerance, unit)
            return Goal(value=to_internal(value.value, unit), tolerance=near, at=value.at)
        return value

    result = {}
    for key, value in section:
        unit = suffix(key)
        name = key.removesuffix("_" + unit) if unit else key
        result[name] = convert(value, unit)
    return result
