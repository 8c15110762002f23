"""Section: what all parts of a config have in common.

Every physical key ends in its unit, and the docstring under each key is what an editor
shows.
"""

from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from . import library
from .quantity import BRIEF


class Section(BaseModel):
    """A part of the config: no unknown keys, no later change."""

    model_config = BRIEF


def shelf(name: str) -> ConfigDict:
    """A section whose keys may come from a preset: then none of them is required."""

    def loosen(schema: dict[str, Any]) -> None:
        schema["properties"]["preset"] = {
            "description": f"Take the keys that are not given from one of the {name}.",
            "enum": list(library.names(name)),
        }
        required = schema.pop("required", [])
        schema["anyOf"] = [{"required": ["preset"]}, {"required": required}]

    return {**BRIEF, "json_schema_extra": loosen}


def named(name: str) -> Any:
    """In the JSON schema of a key, the name of a preset beside the section itself."""

    def widen(schema: dict[str, Any]) -> None:
        section = {"$ref": schema.pop("$ref")}
        schema["anyOf"] = [{"enum": list(library.names(name))}, section]

    return Field(json_schema_extra=widen)
