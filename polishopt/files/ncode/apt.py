"""APT: the master that every post-processor reads, as a CL file and as a table.

The CL file has poses on the part alone; the table has everything.
"""

import csv
import io
import re

import numpy as np

from .motion import Header, Read
from .words import Printed, ProgramError, Recorder, plain


COLUMNS = (
    "move,tip_x_mm,tip_y_mm,tip_z_mm,axis_i,axis_j,axis_k,"
    "X_mm,Y_mm,Z_mm,{0}_deg,{1}_deg,feed_mm_min,time_s"
)


def write_cl(printed: Printed, header: Header) -> str:
    """A CL file.

    Args:
        printed: The moves.
        header: What it says before it moves.
    """
    poses = [",".join(row) for row in zip(*printed.tip, *printed.axis, strict=True)]
    rapid = ["RAPID\n" if fast else "" for fast in printed.rapid]
    speeds = [f"FEDRAT/{x},MMPM\n" if x else "" for x in printed.new_feed]
    rows = zip(rapid, speeds, poses, strict=True)
    turn = "CLW" if header.clockwise else "CCLW"
    head = [
        f"PARTNO/{header.name}",
        *(f"PPRINT/{plain(f'{word}: {text}')}" for word, text in header.notes),
        f"PPRINT/work offset: {header.offset}",
        "UNITS/MM",
        "MULTAX/ON",
        f"LOADTL/{header.tool}",
        f"SPINDL/{header.spindle:.3f},RPM,{turn}",
    ]
    body = [f"{fast}{speed}GOTO/{pose}" for fast, speed, pose in rows]
    return "\n".join([*head, *body, "SPINDL/OFF", "END", "FINI", ""])


def read_cl(text: str) -> Read:
    """A CL file as `write_cl` writes it.

    Raises:
        ValueError: with the line that is not understood.
    """
    found = Recorder(("X", "Y", "Z"), ("I", "J", "K"))
    for number, line in enumerate(text.splitlines(), 1):
        word, _, rest = line.partition("/")
        if word == "PPRINT":
            found.notes.append(rest)
            if rest.startswith("work offset: "):
                found.fact("offset", int(rest.removeprefix("work offset: ")))
        elif word == "GOTO":
            values = [float(x) for x in rest.split(",")]
            if len(values) != 6:
                raise ProgramError(number, "GOTO needs a place and a direction.")
            found.state = dict(zip("XYZIJK", values, strict=True))
            found.move(number)
            found.fast = False
        elif word == "RAPID":
            found.fast = True
        elif word == "FEDRAT" and rest.endswith(",MMPM"):
            found.speed = float(rest.removesuffix(",MMPM"))
        elif word == "LOADTL":
            found.fact("tool", int(rest))
        elif word == "SPINDL" and rest != "OFF":
            speed, unit, turn = rest.split(",")
            if unit != "RPM" or turn not in ("CLW", "CCLW"):
                raise ProgramError(number, f"{rest!r} is no spindle speed.")
            found.fact("spindle", float(speed))
            found.fact("clockwise", turn == "CLW")
        elif line not in ("UNITS/MM", "MULTAX/ON", "SPINDL/OFF", "END", "FINI") and (
            word != "PARTNO"
        ):
            raise ProgramError(number, f"{line!r} is no word of this language.")
    return found.read()


def write_csv(printed: Printed, header: Header) -> str:
    """A table with the poses, the axis positions, the feed and the time."""
    kind = ["rapid" if fast else "feed" for fast in printed.rapid]
    poses = (*printed.tip, *printed.axis, *printed.linear, *printed.rotary)
    turn = "clockwise" if header.clockwise else "counter-clockwise"
    head = [
        *(f"# {plain(f'{word}: {text}')}" for word, text in header.notes),
        f"# work offset: {header.offset}",
        f"# tool number: {header.tool}",
        f"# spindle: {header.spindle:.3f} rpm {turn}",
        COLUMNS.format(*header.rotary),
    ]
    rows = [
        ",".join(row)
        for row in zip(kind, *poses, printed.feed, printed.seconds, strict=True)
    ]
    return "\n".join([*head, *rows, ""])


def read_csv(text: str) -> Read:
    """A table as `write_csv` writes it: poses, axis positions, feeds and times.

    Raises:
        ValueError: if it is no such table.
    """
    notes = tuple(line[2:] for line in text.splitlines() if line.startswith("#"))
    said = dict(note.split(": ", 1) for note in notes if ": " in note)
    table = csv.reader(io.StringIO(text))
    rows = [row for row in table if row and not row[0].startswith("#")]
    letters = re.findall(r"([ABC])_deg", ",".join(rows[0]))
    if len(letters) != 2 or ",".join(rows[0]) != COLUMNS.format(*letters):
        raise ValueError("The table has other columns than a program.")
    cells = [[float(cell or "nan") for cell in row[1:]] for row in rows[1:]]
    values = np.array(cells)
    speed, _, turn = said["spindle"].partition(" rpm ")
    return Read(
        rapid=np.array([row[0] == "rapid" for row in rows[1:]]),
        tip=values[:, :3],
        axis=values[:, 3:6],
        linear=values[:, 6:9],
        rotary=values[:, 9:11],
        feed=values[:, 11],
        seconds=values[:, 12],
        tool=int(said["tool number"]),
        spindle=float(speed),
        clockwise=turn == "clockwise",
        offset=int(said["work offset"]),
        notes=notes,
    )
