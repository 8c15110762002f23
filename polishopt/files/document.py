"""Document: a YAML file with the place of every key, and the errors that point at it.

YAML 1.2 is read (`1e-8` is a number, `no` is a word), a key that stands twice is an
error, and comments survive when an answer is written back into the file.
"""

import io
import os
import re
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.reader import ReaderError


# A config holds a few hundred values. Far more means YAML aliases that multiply.
MOST_VALUES = 20_000
# A longer text would take minutes to read, comments too.
MOST_LETTERS = 500_000
DEEPEST = 30
# The rest of a longer line helps nobody in an error message.
WIDEST = 200

Keys = tuple[str | int, ...]


@dataclass(frozen=True)
class Problem:
    """One mistake: where it stands, what is wrong, and the line itself."""

    where: str
    """A file name, or the override as it was typed."""
    sentence: str
    line: int = 0
    """Counted from 1; 0 if the mistake has no place in the file."""
    column: int = 0
    source: str = ""

    def __str__(self) -> str:
        place = f"{self.where}:{self.line}:{self.column}" if self.line else self.where
        text = f"{place}: {self.sentence}"
        if self.line and self.source.strip() and self.column <= WIDEST:
            text += f"\n    {self.source[:WIDEST].rstrip()}\n    {' ' * (self.column - 1)}^"
        return text


class ConfigError(ValueError):
    """All mistakes found in a config, in the order of the file."""

    def __init__(self, problems: list[Problem]):
        # what stands in no line of the file (an override) comes last
        self.problems = sorted(problems, key=lambda p: (p.line or 10**9, p.column))
        super().__init__("\n".join(str(problem) for problem in self.problems))


class Place(NamedTuple):
    """Line and column, counted from 1."""

    line: int
    column: int


@dataclass
class Survey:
    """The plain values of a document, and where each of them stands."""

    data: Any = None
    keys: dict[Keys, Place] = field(default_factory=dict)
    values: dict[Keys, Place] = field(default_factory=dict)
    empty: list[Keys] = field(default_factory=list)
    """Keys without a value."""


def lines(text: str) -> list[str]:
    """The lines of a text, as YAML counts them."""
    return re.split(r"\r\n|[\n\r\x85\u2028\u2029]", text)


def problem(name: str, text: str, place: Place, sentence: str) -> Problem:
    """A mistake at a place of a text."""
    rows = lines(text)
    source = rows[place.line - 1] if 0 < place.line <= len(rows) else ""
    return Problem(name, sentence, place.line, place.column, source)


def yaml() -> YAML:
    """A reader and writer that keeps comments, quotes and the style of lists."""
    tool = YAML(typ="rt")
    tool.preserve_quotes = True
    tool.width = 4096
    return tool


def read_text(path: Path) -> str:
    """The text of a file, or a `ConfigError` that says why it cannot be read."""
    try:
        raw = path.read_bytes()
    except FileNotFoundError:
        raise ConfigError([Problem(str(path), "there is no such file")]) from None
    except IsADirectoryError:
        sentence = "is a folder; name the file itself"
        raise ConfigError([Problem(str(path), sentence)]) from None
    except OSError as error:
        sentence = f"cannot be read: {error.strerror or error}"
        raise ConfigError([Problem(str(path), sentence)]) from None
    except ValueError:
        raise ConfigError([Problem(str(path), "is no file name")]) from None
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        before = raw[: error.start]
        column = len(before) - before.rfind(b"\n")
        sentence = "is not UTF-8 text here; save the file as UTF-8"
        wrong = Problem(str(path), sentence, before.count(b"\n") + 1, column)
        raise ConfigError([wrong]) from None


def parse(text: str, name: str) -> CommentedMap:
    """The document in a text, or a `ConfigError` with line and column."""

    def fail(place: Place, sentence: str) -> ConfigError:
        return ConfigError([problem(name, text, place, sentence)])

    if len(text) > MOST_LETTERS:
        sentence = f"holds {len(text)} characters, a config at most {MOST_LETTERS}"
        raise ConfigError([Problem(name, sentence)])
    try:
        with warnings.catch_warnings():
            # an anchor used twice is no mistake of YAML 1.2
            warnings.simplefilter("ignore")
            document = yaml().load(text)
    except ReaderError as error:
        before = text[: error.position]
        place = Place(before.count("\n") + 1, len(before) - before.rfind("\n"))
        code = ord(error.character) if isinstance(error.character, str) else error.character
        raise fail(place, f"the character U+{code:04X} is not allowed in YAML") from None
    except MarkedYAMLError as error:
        marks = (error.problem_mark, error.context_mark)
        # YAML notices a key without ':' only further down
        mark = next(
            filter(None, reversed(marks) if "simple key" in str(error.context) else marks),
            None,
        )
        place = Place(mark.line + 1, mark.column + 1) if mark else Place(1, 1)
        raise fail(place, syntax(error)) from None
    except (YAMLError, ValueError, RecursionError) as error:
        reason = str(error).partition("\n")[0] or type(error).__name__
        raise ConfigError([Problem(name, f"is not valid YAML: {reason}")]) from None
    if document is None:
        raise ConfigError([Problem(name, "the file is empty")])
    if not isinstance(document, CommentedMap):
        kind = "a list" if isinstance(document, CommentedSeq) else "a single value"
        raise fail(Place(1, 1), f"must be sections (`key: value` lines), is {kind}")
    return document


def syntax(error: MarkedYAMLError) -> str:
    """A YAML error as a sentence."""
    reason = (error.problem or "is not valid YAML").partition("\n")[0]
    twice = re.match(r'found duplicate key "(.*?)" with value', reason)
    if twice:
        return f"the key '{twice[1]}' stands twice in this section"
    if (
        "could not find expected ':'" in reason
        or "mapping values are not allowed" in reason
    ):
        return f"{reason}; is the indentation right, with a space after each ':'?"
    if "found character '\\t'" in reason:
        return "indent with spaces: YAML allows no tabs here"
    return f"{error.context}, {reason}" if error.context else reason


def survey(document: Any, name: str) -> Survey:
    """Plain values and places of a document.

    Args:
        document: As `parse` returns it, overrides included.
        name: The file name for errors.
    """
    found = Survey()
    count = 0

    def walk(node: Any, at: Keys) -> Any:
        nonlocal count
        count += 1
        if count > MOST_VALUES or len(at) > DEEPEST:
            sentence = (
                f"holds more than {MOST_VALUES} values, or is nested too deeply; do its "
                "aliases multiply?"
            )
            raise ConfigError([Problem(name, sentence)])
        if isinstance(node, CommentedMap):
            result = {}
            for key, value in node.items():
                inner = (*at, str(key))
                # a key merged in by `<<` has no place of its own
                if node.lc.data and key in node.lc.data:
                    row, column, value_row, value_column = node.lc.data[key]
                    found.keys[inner] = Place(row + 1, column + 1)
                    found.values[inner] = Place(value_row + 1, value_column + 1)
                result[str(key)] = walk(value, inner)
            return result
        if isinstance(node, CommentedSeq):
            for index in range(len(node)):
                if node.lc.data and index in node.lc.data:
                    row, column = node.lc.data[index][:2]
                    found.values[(*at, index)] = Place(row + 1, column + 1)
            return [walk(value, (*at, index)) for index, value in enumerate(node)]
        return scalar(node, at)

    def scalar(node: Any, at: Keys) -> Any:
        if node is None:
            found.empty.append(at)
            # an empty value starts nowhere: point at its key
            found.values[at] = found.keys.get(at, found.values.get(at, Place(1, 1)))
        for kind in (bool, int, float, str):
            if isinstance(node, kind):
                return kind(node)
        return None if node is None else str(node)

    found.data = walk(document, ())
    return found


def dump(document: Any) -> str:
    """A document as YAML text, comments included."""
    stream = io.StringIO()
    yaml().dump(document, stream)
    return stream.getvalue()


def write_text(path: str | Path, text: str) -> None:
    """Writes a file at once: a reader sees the old text or the new, never a half.

    Args:
        path: The file; its folder must exist.
        text: What it holds from now on.
    """
    path = Path(path)
    beside = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        beside.write_text(text, encoding="utf-8", newline="\n")
        os.replace(beside, path)
    finally:
        beside.unlink(missing_ok=True)
