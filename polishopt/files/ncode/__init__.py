"""NC code: programs for the controls of milling machines, written and read back.

- motion      what a program holds, whatever its language
- words       what the languages share
- apt         APT CL and a table: the master
- siemens, heidenhain, fanuc, linuxcnc   the languages of controls
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from . import apt, fanuc, heidenhain, linuxcnc, siemens
from .motion import Header as Header, Motion as Motion, Read as Read
from .words import Printed as Printed, ProgramError as ProgramError


@dataclass(frozen=True)
class Dialect:
    """A language of programs."""

    ending: str
    """What its files end in, after the name of the program."""
    write: Callable[[Printed, Header], str]
    """Writes a program."""
    read: Callable[[str], Read]
    """Reads it back."""


DIALECTS = {
    "apt": Dialect(".apt", apt.write_cl, apt.read_cl),
    "csv": Dialect(".csv", apt.write_csv, apt.read_csv),
    "siemens_vector": Dialect(
        "_vector.mpf", partial(siemens.write, vectors=True), siemens.read
    ),
    "siemens_angles": Dialect(
        "_angles.mpf", partial(siemens.write, vectors=False), siemens.read
    ),
    "heidenhain_tcpm": Dialect(
        "_tcpm.h", partial(heidenhain.write, vectors=False), heidenhain.read
    ),
    "heidenhain_m128": Dialect(
        "_m128.h", partial(heidenhain.write, vectors=True), heidenhain.read
    ),
    "fanuc_g43_4": Dialect("_g43_4.nc", partial(fanuc.write, vectors=False), fanuc.read),
    "fanuc_g43_5": Dialect("_g43_5.nc", partial(fanuc.write, vectors=True), fanuc.read),
    "linuxcnc": Dialect(".ngc", linuxcnc.write, linuxcnc.read),
}
