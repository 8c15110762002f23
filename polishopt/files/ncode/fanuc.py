"""Fanuc: tool-centre-point control, G43.4 with rotary axes or G43.5 with vectors.

Coordinates are those of the part, which a turning table takes along (programming in the
part's own frame, parameter 19696 bit 5).
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


WORD = re.compile(rf"(?P<letter>[A-Z])(?P<number>{NUMBER})")
CODES = [
    "G17",
    "G21",
    "G40",
    "G80",
    "G90",
    "G94",
    "G5.1",
    "Q1",
    "Q0",
    "G49",
    "M5",
    "M6",
    "M30",
]


def write(printed: Printed, header: Header, vectors: bool) -> str:
    """A program.

    Args:
        printed: The moves.
        header: What it says before it moves.
        vectors: Whether the tool axis is a vector, or two rotary axes.
    """
    letters = ("I", "J", "K") if vectors else header.rotary
    ways = printed.axis if vectors else printed.rotary
    place = [words(*one) for one in zip("XYZ", printed.tip, strict=True)]
    way = [words(*one) for one in zip(letters, ways, strict=True)]
    columns = [*changing(place), *way] if vectors else changing([*place, *way])
    kind = modal(["G0" if fast else "G1" for fast in printed.rapid])
    return "\n".join(
        [
            "%",
            f"O{header.number} ({comment(header.name)})",
            *(f"({comment(f'{word}: {text}')})" for word, text in header.notes),
            "G17 G21 G40 G49 G80 G90 G94",
            f"G{53 + header.offset}",
            f"T{header.tool} M6",
            f"S{header.spindle:.0f} M{3 if header.clockwise else 4}",
            "G5.1 Q1",
            f"G43.{5 if vectors else 4} H{header.tool}",
            *lines(kind, *columns, words("F", printed.new_feed)),
            "G49",
            "G5.1 Q0",
            "M5",
            "M30",
            "%",
            "",
        ]
    )


def comment(text: str) -> str:
    """A comment as old controls can show it."""
    return plain(text, "()%;").upper()


def read(text: str) -> Read:
    """A program as `write` writes it.

    Raises:
        ValueError: with the line that is not understood.
    """
    vectors = "G43.5" in text
    rotary = sorted(set(re.findall(r"[ABC](?=[-\d])", re.sub(r"\(.*?\)", "", text))))
    found = Recorder(("X", "Y", "Z"), ("I", "J", "K") if vectors else rotary)
    for number, line in enumerate(text.splitlines(), 1):
        found.notes += re.findall(r"\((.*?)\)", line)
        block = re.sub(r"\(.*?\)", "", line).strip()
        if block == "%":
            continue
        moves = False
        for word in words_of(block, WORD, number):
            letter, value = word["letter"], float(word["number"])
            if letter in found.letters:
                found.state[letter] = value
                moves = True
            elif letter == "F":
                found.speed = value
            elif letter == "T":
                found.fact("tool", value)
            elif letter == "S":
                found.fact("spindle", value)
            elif letter not in "OH" and not mode(found, word[0]):
                raise ProgramError(number, f"{word[0]} is not used by these programs.")
        if moves:
            found.require(number, "G43.5" if vectors else "G43.4", "G21", "G90", "G94")
            found.move(number)
    return found.read()


def mode(found: Recorder, word: str) -> bool:
    """Takes a G, M or Q word; False if it is unknown."""
    if word in ("G0", "G1"):
        found.fast = word == "G0"
    elif word in ("M3", "M4"):
        found.fact("clockwise", word == "M3")
    elif re.fullmatch(r"G5[4-9]", word):
        found.fact("offset", int(word[1:]) - 53)
    elif word == "G49":
        found.modes -= {"G43.4", "G43.5"}
    elif word in CODES or word in ("G43.4", "G43.5"):
        found.modes.add(word)
    else:
        return False
    return True
