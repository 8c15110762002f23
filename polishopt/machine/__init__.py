"""Machine: which axis positions a tool path asks for, and how fast they can be run.

- kinematics   axis positions of a posture, and the posture of axis positions
- sweep        the fastest motion along a path whose derivatives are known
- feed         feed, time and what limits them along a sampled path
- exact        the same along a path known as a function, limits kept between samples too
- loop         the feed in one loop of the trochoid that is run again and again
"""

from .exact import exact_time_law as exact_time_law
from .feed import (
    Limits as Limits,
    TimeLaw as TimeLaw,
    Usage as Usage,
    derivatives as derivatives,
    limiting_name as limiting_name,
    time_law as time_law,
    time_law_from_derivatives as time_law_from_derivatives,
    usage as usage,
)
from .kinematics import (
    forward as forward,
    inverse as inverse,
    inverse_path as inverse_path,
)
from .loop import loop_rate as loop_rate
