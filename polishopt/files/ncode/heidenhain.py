"""Heidenhain: conversational programs with tool-centre control.

With rotary axes under FUNCTION TCPM, or with vectors (LN ... TX TY TZ) under M128. Every
block has a number, every number its sign.
"""

import re

from .motion import Header, Read
from .words import (
    NUMBER,
    Printed,
    ProgramError,
    Recorder,
    changing,
    lines,
    plain,
    words,
    words_of,
)


TCPM = "FUNCTION TCPM F TCP AXIS POS PATHCTRL AXIS"
WORD = re.compile(rf"(?P<letter>T[XYZ]|[XYZABCFS])(?P<number>{NUMBER})|FMAX|M(?P<code>\d+)")
CALL = re.compile(rf"TOOL CALL (\d+) Z S({NUMBER})")
DATUM = re.compile(r"Q339=\+(\d+)")
CODES = ("3", "4", "5", "30", "126", "127", "128", "129")


def write(printed: Printed, header: Header, vectors: bool) -> str:
    """A program.

    Args:
        printed: The moves.
        header: What it says before it moves.
        vectors: Whether the tool axis is a vector, or two rotary axes.
    """
    letters = ("TX", "TY", "TZ") if vectors else header.rotary
    numbers = (*printed.tip, *(printed.axis if vectors else printed.rotary))
    columns = [words(*one, True) for one in zip((*"XYZ", *letters), numbers, strict=True)]
    columns = columns if vectors else changing(columns)
    kind = ["LN" if vectors else "L"] * len(printed.rapid)
    speed = [
        "FMAX" if fast else word
        for fast, word in zip(printed.rapid, words("F", printed.new_feed), strict=True)
    ]
    # the control wants it called as its file is
    name = f"{header.name}_{'m128' if vectors else 'tcpm'}".upper()
    on, off = ("L M128", "L M129") if vectors else (TCPM, "FUNCTION RESET TCPM")
    rows = [
        f"BEGIN PGM {name} MM",
        *(f"; {plain(f'{word}: {text}')}" for word, text in header.notes),
        f"TOOL CALL {header.tool} Z S{header.spindle:.3f}",
        f"CYCL DEF 247 DATUM SETTING ~\n    Q339=+{header.offset} ;DATUM NUMBER",
        f"L M{3 if header.clockwise else 4}",
        # rotary axes take the shorter way
        "L M126",
        on,
        *lines(kind, *columns, speed),
        off,
        "L M127",
        "L M5",
        "L M30",
        f"END PGM {name} MM",
    ]
    return "".join(f"{i} {row}\n" for i, row in enumerate(rows))


def read(text: str) -> Read:
    """A program as `write` writes it.

    Raises:
        ValueError: with the line that is not understood.
    """
    vectors = "\n" in text and re.search(r"^\d+ LN ", text, re.MULTILINE) is not None
    angles = sorted(set(re.findall(r" ([ABC])[+-]\d", re.sub(r";.*", "", text))))
    found = Recorder(("X", "Y", "Z"), ("TX", "TY", "TZ") if vectors else angles)
    expected = 0
    for number, line in enumerate(text.splitlines(), 1):
        block, _, note = line.partition(";")
        if note and note != "DATUM NUMBER":
            found.notes.append(note.strip())
        datum = DATUM.fullmatch(block.strip())
        if datum:
            found.fact("offset", int(datum[1]))
            continue
        count, _, block = block.strip().partition(" ")
        if count != str(expected):
            raise ProgramError(number, f"block {count} stands where {expected} should.")
        expected += 1
        call = CALL.fullmatch(block)
        if call:
            found.fact("tool", int(call[1]))
            found.fact("spindle", float(call[2]))
        elif block == TCPM:
            found.modes.add("TCPM")
        elif block == "FUNCTION RESET TCPM":
            found.modes.discard("TCPM")
        elif re.match(r"LN? ", block):
            _line(found, block.partition(" ")[2], number, "128" if vectors else "TCPM")
        elif block and not re.fullmatch(
            r"(BEGIN|END) PGM \w+ MM|CYCL DEF 247 DATUM SETTING ~", block
        ):
            raise ProgramError(number, f"{block!r} is not used by these programs.")
    return found.read()


def _line(found: Recorder, block: str, number: int, mode: str) -> None:
    """A straight line, or a lone M function."""
    moves, fast = False, False
    for word in words_of(block, WORD, number):
        letter, code = word["letter"], word["code"]
        if code is not None:
            if code not in CODES:
                raise ProgramError(number, f"M{code} is not used by these programs.")
            found.modes -= {"128"} if code == "129" else set()
            found.modes.add(code)
            if code in ("3", "4"):
                found.fact("clockwise", code == "3")
        elif letter in found.letters:
            found.state[letter] = float(word["number"])
            moves = True
        elif letter == "F":
            found.speed = float(word["number"])
        elif word[0] == "FMAX":
            fast = True
        else:
            raise ProgramError(number, f"{word[0]} is not used by these programs.")
    if moves:
        found.require(number, mode)
        found.fast = fast
        found.move(number)
