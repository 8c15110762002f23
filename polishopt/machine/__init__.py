"""Machine: which axis positions a tool path asks for, and how fast they can be run."""

from .feed import (
    Limits,
    TimeLaw,
    Usage,
    derivatives,
    limiting_name,
    sweep,
    sweep_periodic,
    time_law,
    time_law_from_derivatives,
    usage,
)
from .kinematics import forward, inverse, inverse_path


__all__ = [
    "Limits",
    "TimeLaw",
    "Usage",
    "derivatives",
    "forward",
    "inverse",
    "inverse_path",
    "limiting_name",
    "sweep",
    "sweep_periodic",
    "time_law",
    "time_law_from_derivatives",
    "usage",
]
