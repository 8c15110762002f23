"""Siemens: Sinumerik 840D with TRAORI, by vector (A3, B3, C3) or by rotary axes.

COMPCURV makes smooth curves of the short moves. With vectors the tool axis turns in the
frame of the part (ORIWKS), with angles the rotary axes run as they are told (ORIMKS).
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
    modal,
    plain,
    words,
    words_of,
)


VECTOR = ("A3=", "B3=", "C3=")
# what a Sinumerik can be told in this program, beside words with numbers
MODES = ("TRAORI", "TRAFOOF", "ORIWKS", "ORIMKS", "COMPCURV", "COMPOF", "SOFT")
CODES = ("G17", "G40", "G90", "G94", "G710", "M5", "M6", "M30")
WORD = re.compile(rf"(?P<letter>[ABC]3?=|[GMTDSFXYZ])(?P<number>{NUMBER})")


def write(printed: Printed, header: Header, vectors: bool) -> str:
    """A main program.

    Args:
        printed: The moves.
        header: What it says before it moves.
        vectors: Whether the tool axis is a vector, or two rotary axes.
    """
    letters = VECTOR if vectors else tuple(f"{letter}=" for letter in header.rotary)
    ways = printed.axis if vectors else printed.rotary
    place = [words(*one) for one in zip("XYZ", printed.tip, strict=True)]
    way = [words(*one) for one in zip(letters, ways, strict=True)]
    # components of a vector that are left out would count as zero
    columns = [*changing(place), *way] if vectors else changing([*place, *way])
    kind = modal(["G0" if fast else "G1" for fast in printed.rapid])
    body = lines(kind, *columns, words("F", printed.new_feed))
    return "\n".join(
        [
            f"; {header.name}",
            *(f"; {plain(f'{word}: {text}')}" for word, text in header.notes),
            "G17 G90 G94 G40 G710",
            f"T{header.tool} D1",
            "M6",
            f"G{53 + header.offset}" if header.offset < 5 else f"G{500 + header.offset}",
            "TRAORI",
            "ORIWKS" if vectors else "ORIMKS",
            "SOFT",
            f"S{header.spindle:.3f} M{3 if header.clockwise else 4}",
            "COMPCURV",
            *body,
            "COMPOF",
            "TRAFOOF",
            "M5",
            "M30",
            "",
        ]
    )


def read(text: str) -> Read:
    """A program as `write` writes it.

    Raises:
        ValueError: with the line that is not understood.
    """
    vectors = "A3=" in text
    turned = VECTOR if vectors else tuple(sorted(set(re.findall(r"\b[ABC]=", text))))
    found = Recorder(("X", "Y", "Z"), turned)
    for number, line in enumerate(text.splitlines(), 1):
        block, _, note = line.partition(";")
        if note:
            found.notes.append(note.strip())
        block = block.strip()
        if block in MODES:
            off = {"TRAFOOF": "TRAORI", "COMPOF": "COMPCURV"}.get(block)
            found.modes.discard(off) if off else found.modes.add(block)
            continue
        moves = False
        for word in words_of(block, WORD, number):
            letter, value = word["letter"], float(word["number"])
            if letter in "GM" and not _mode(found, word[0], number):
                raise ProgramError(number, f"{word[0]} is not used by these programs.")
            if letter in found.letters:
                found.state[letter] = value
                moves = True
            elif letter == "F":
                found.speed = value
            elif letter == "T":
                found.fact("tool", value)
            elif letter == "S":
                found.fact("spindle", value)
            elif letter not in "GMD":
                raise ProgramError(number, f"{word[0]} is not used by these programs.")
        if moves:
            found.require(
                number, "TRAORI", "ORIWKS" if vectors else "ORIMKS", "G710", "G90"
            )
            found.move(number)
    return found.read()


def _mode(found: Recorder, word: str, line: int) -> bool:
    """Takes a G or M word; False if it is unknown."""
    if word in ("G0", "G1"):
        found.fast = word == "G0"
    elif word in ("M3", "M4"):
        found.fact("clockwise", word == "M3")
    elif re.fullmatch(r"G5[4-7]", word):
        found.fact("offset", int(word[1:]) - 53)
    elif re.fullmatch(r"G50[5-9]", word):
        found.fact("offset", int(word[1:]) - 500)
    elif word in CODES:
        found.modes.add(word)
    else:
        return False
    return True
