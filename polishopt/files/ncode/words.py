"""Words: what the languages of controls share, for writing and for reading.

Numbers of a column are printed at once, which takes a tenth of the time of one at a time.
Readers know what the writers write and nothing else: a word they do not know is an error
with its line.
"""

import math
import re
from collections.abc import Iterator, Sequence
from functools import cached_property

import numpy as np

from .motion import Motion, Read


NUMBER = r"[+-]?\d+(?:\.\d*)?"
WIDEST = 72  # characters of a comment


def column(values: np.ndarray, decimals: int) -> list[str]:
    """Numbers as texts with a fixed number of decimals."""
    return (f"%.{decimals}f\n" * values.size % tuple(values.tolist())).split("\n")[:-1]


class Printed:
    """A motion as texts, each column printed once for all languages.

    Args:
        motion: The moves, rounded to the printed digits.
        decimals: Printed places of lengths [mm] and angles [deg].
    """

    def __init__(self, motion: Motion, decimals: int):
        self.motion, self.decimals = motion, decimals
        self.rapid: list[bool] = motion.rapid.tolist()

    @cached_property
    def tip(self) -> list[list[str]]:
        """Places on the part."""
        return [column(x, self.decimals) for x in self.motion.tip.T]

    @cached_property
    def axis(self) -> list[list[str]]:
        """Tool axes, with two decimals more than lengths."""
        return [column(x, self.decimals + 2) for x in self.motion.axis.T]

    @cached_property
    def linear(self) -> list[list[str]]:
        """Positions of X, Y and Z."""
        return [column(x, self.decimals) for x in self.motion.linear.T]

    @cached_property
    def rotary(self) -> list[list[str]]:
        """Positions of the rotary axes."""
        return [column(x, self.decimals) for x in self.motion.rotary.T]

    @cached_property
    def feed(self) -> list[str]:
        """Feeds, '' on rapid moves."""
        return self._slow(self.motion.feed, 1)

    @cached_property
    def seconds(self) -> list[str]:
        """Durations, '' of rapid moves."""
        return self._slow(self.motion.seconds, 6)

    @cached_property
    def per_minute(self) -> list[str]:
        """How often each move goes into a minute, '' for rapid moves."""
        return self._slow(60.0 / self.motion.seconds, 4)

    @cached_property
    def new_feed(self) -> list[str]:
        """Feeds where they change, '' elsewhere."""
        found, last = [], ""
        for text in self.feed:
            found.append("" if text == last else text)
            last = text or last
        return found

    def _slow(self, values: np.ndarray, places: int) -> list[str]:
        texts = column(np.where(self.motion.rapid, 0.0, values), places)
        return ["" if fast else x for fast, x in zip(self.rapid, texts, strict=True)]


def words(letter: str, texts: list[str], sign: bool = False) -> list[str]:
    """The texts as words, `X` and `1.5` as `X1.5`; all with their signs if asked."""
    if not sign:
        return [letter + text if text else "" for text in texts]
    plus = letter + "+"
    return [letter + text if text[0] == "-" else plus + text for text in texts]


def modal(texts: list[str]) -> list[str]:
    """Texts with '' in place of those that repeat the one before."""
    before = ["", *texts]
    return ["" if text == old else text for text, old in zip(texts, before, strict=False)]


def changing(columns: list[list[str]]) -> list[list[str]]:
    """Columns of words side by side, those that repeat left out.

    A row in which nothing changes keeps its first word, so that it stays a move.
    """
    short = [modal(one) for one in columns]
    for i, row in enumerate(zip(*short, strict=True)):
        if not any(row):
            short[0][i] = columns[0][i]
    return short


def lines(*columns: list[str]) -> list[str]:
    """Each row of words as a line, without those that are ''."""
    return [" ".join(filter(None, row)) for row in zip(*columns, strict=True)]


def plain(text: str, forbidden: str = "") -> str:
    """A comment that every control can hold: one line of ASCII, none of `forbidden`."""
    for known, spelt in (("µ", "u"), ("°", " deg"), ("²", "2"), ("³", "3"), ("±", "+-")):
        text = text.replace(known, spelt)
    text = " ".join(text.encode("ascii", "replace").decode().split())
    text = "".join(" " if c in forbidden or not c.isprintable() else c for c in text)
    return text[:WIDEST].rstrip()


class ProgramError(ValueError):
    """A program that is not what it should be, with the line."""

    def __init__(self, line: int, sentence: str):
        super().__init__(f"line {line}: {sentence}")


def words_of(text: str, pattern: re.Pattern, line: int) -> Iterator[re.Match]:
    """The words of a block, from its first to its last character."""
    at = 0
    while at < len(text):
        word = pattern.match(text, at)
        if word is None:
            raise ProgramError(line, f"{text[at:]!r} is no word of this language.")
        yield word
        at = word.end()
        while at < len(text) and text[at] == " ":
            at += 1


class Recorder:
    """Collects what a reader finds, and remembers what is modal.

    Args:
        places: Letters of the three lengths.
        ways: Letters of the direction (three) or of the rotary axes (two).
        resolved: Whether the lengths are positions of the machine's axes.
    """

    def __init__(self, places: Sequence[str], ways: Sequence[str], resolved: bool = False):
        self.letters = (*places, *ways)
        self.resolved = resolved
        self.state: dict[str, float] = {}
        self.rows: list[tuple[float, ...]] = []
        self.rapid: list[bool] = []
        self.speeds: list[float] = []
        self.inverse: list[bool] = []
        self.facts: dict[str, float] = {}
        self.notes: list[str] = []
        self.modes: set[str] = set()
        self.fast = False
        self.speed = math.nan

    def fact(self, name: str, value: float | int) -> None:
        """Keeps tool, spindle, clockwise or offset."""
        self.facts[name] = value

    def require(self, line: int, *modes: str) -> None:
        """An error unless these modes are on."""
        lacking = [mode for mode in modes if mode not in self.modes]
        if lacking:
            raise ProgramError(line, f"a move without {', '.join(lacking)}.")

    def move(self, line: int, inverse: bool = False) -> None:
        """A move to wherever the state now is."""
        lacking = [letter for letter in self.letters if letter not in self.state]
        if lacking:
            raise ProgramError(line, f"the first move lacks {', '.join(lacking)}.")
        if not self.fast and not self.speed > 0:
            raise ProgramError(line, "a move without a feed.")
        self.rows.append(tuple(self.state[letter] for letter in self.letters))
        self.rapid.append(self.fast)
        self.speeds.append(math.nan if self.fast else self.speed)
        self.inverse.append(inverse)

    def read(self) -> Read:
        """All of it."""
        if not self.rows:
            raise ValueError("The program holds no move.")
        for name in ("tool", "spindle", "clockwise", "offset"):
            if name not in self.facts:
                raise ValueError(f"The program does not say its {name}.")
        rows, speeds = np.array(self.rows), np.array(self.speeds)
        place, way = rows[:, :3], rows[:, 3:]
        vectors, timed = way.shape[1] == 3, np.array(self.inverse)
        return Read(
            rapid=np.array(self.rapid),
            tip=None if self.resolved else place,
            axis=way if vectors else None,
            linear=place if self.resolved else None,
            rotary=None if vectors else way,
            feed=None if timed.any() else speeds,
            seconds=np.where(timed, 60.0 / speeds, math.nan) if timed.any() else None,
            tool=int(self.facts["tool"]),
            spindle=self.facts["spindle"],
            clockwise=bool(self.facts["clockwise"]),
            offset=int(self.facts["offset"]),
            notes=tuple(self.notes),
        )
