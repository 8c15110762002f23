"""LinuxCNC: axes resolved, in inverse time.

It has no tool-centre control of its own, so the five axes are told where to go, and how
long they may take (G93): the feed on the part is then right whatever the axes do.
"""

import re

from .fanuc import WORD
from .motion import Header, Read
from .words import (
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


CODES = ["G17", "G21", "G40", "G49", "G64", "G80", "G90", "M2", "M5", "M6"]


def write(printed: Printed, header: Header) -> str:
    """A program.

    Args:
        printed: The moves.
        header: What it says before it moves.
    """
    letters, numbers = (*"XYZ", *header.rotary), (*printed.linear, *printed.rotary)
    columns = changing([words(*one) for one in zip(letters, numbers, strict=True)])
    kind = modal(["G0" if fast else "G93 G1" for fast in printed.rapid])
    return "\n".join(
        [
            "%",
            f"({comment(header.name)})",
            *(f"({comment(f'{word}: {text}')})" for word, text in header.notes),
            "G17 G21 G40 G49 G80 G90",
            f"G{53 + header.offset}",
            f"T{header.tool} M6",
            f"G43 H{header.tool}",
            f"S{header.spindle:.3f} M{3 if header.clockwise else 4}",
            # P: how far the control may round corners off; Q0: it drops no point
            f"G64 P{header.tolerance:.4f} Q0",
            *lines(kind, *columns, words("F", printed.per_minute)),
            "G94",
            "M5",
            "M2",
            "%",
            "",
        ]
    )


def comment(text: str) -> str:
    """A comment that the interpreter does not take for a command."""
    return plain(text, "()%;")


def read(text: str) -> Read:
    """A program as `write` writes it.

    Raises:
        ValueError: with the line that is not understood.
    """
    rotary = sorted(set(re.findall(r"[ABC](?=[-\d])", re.sub(r"\(.*?\)", "", text))))
    found = Recorder(("X", "Y", "Z"), rotary, resolved=True)
    for number, line in enumerate(text.splitlines(), 1):
        found.notes += re.findall(r"\((.*?)\)", line)
        block = re.sub(r"\(.*?\)", "", line).strip()
        if block == "%":
            continue
        moves, fed = False, False
        for word in words_of(block, WORD, number):
            letter, value = word["letter"], float(word["number"])
            if letter in found.letters:
                found.state[letter] = value
                moves = True
            elif letter == "F":
                found.speed, fed = value, True
            elif letter == "T":
                found.fact("tool", value)
            elif letter == "S":
                found.fact("spindle", value)
            elif letter not in "HPQ" and not mode(found, word[0]):
                raise ProgramError(number, f"{word[0]} is not used by these programs.")
        if moves:
            found.require(number, "G21", "G90", *(() if found.fast else ("G93",)))
            if not found.fast and not fed:
                raise ProgramError(number, "a move in inverse time without F.")
            found.move(number, inverse=not found.fast)
    return found.read()


def mode(found: Recorder, word: str) -> bool:
    """Takes a G or M word; False if it is unknown."""
    if word in ("G0", "G1"):
        found.fast = word == "G0"
    elif word in ("M3", "M4"):
        found.fact("clockwise", word == "M3")
    elif re.fullmatch(r"G5[4-9]", word):
        found.fact("offset", int(word[1:]) - 53)
    elif word in ("G93", "G94"):
        found.modes -= {"G93", "G94"}
        found.modes.add(word)
    elif word in CODES or word == "G43":
        found.modes.add(word)
    else:
        return False
    return True
