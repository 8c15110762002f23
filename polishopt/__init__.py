"""polishopt: a differentiable process optimizer for automatic polishing.

    from polishopt import polish, tune

The public names load on first use, so that command lines can answer before JAX is there.
"""

import importlib
from typing import TYPE_CHECKING, Any


if TYPE_CHECKING:
    from . import (
        contact as contact,
        files as files,
        machine as machine,
        optimize as optimize,
        path as path,
        texture as texture,
    )
    from .chain import Outcome as Outcome, polish as polish
    from .optimize.sensitivity import (
        Sensitivity as Sensitivity,
        sensitivities as sensitivities,
    )
    from .optimize.tune import (
        Goal as Goal,
        Limits as Limits,
        Tuning as Tuning,
        tune as tune,
    )
    from .parts import (
        Abrasive as Abrasive,
        Machine as Machine,
        Process as Process,
        Tool as Tool,
    )
    from .setup import Sampling as Sampling, Setup as Setup, Start as Start

__version__ = "0.1.0"

_HOMES = {
    "polish": "chain",
    "Outcome": "chain",
    "Process": "parts",
    "Tool": "parts",
    "Abrasive": "parts",
    "Machine": "parts",
    "Setup": "setup",
    "Start": "setup",
    "Sampling": "setup",
    "tune": "optimize.tune",
    "Tuning": "optimize.tune",
    "Goal": "optimize.tune",
    "Limits": "optimize.tune",
    "Sensitivity": "optimize.sensitivity",
    "sensitivities": "optimize.sensitivity",
}
_CHAPTERS = ("path", "machine", "contact", "texture", "optimize", "files")

__all__ = [*_HOMES, *_CHAPTERS]


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(importlib.import_module(f".{_HOMES[name]}", __name__), name)
    if name in _CHAPTERS:
        return importlib.import_module(f".{name}", __name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
