"""Session: what every command line of polishopt does first.

A wrong config must be answered before JAX is loaded, and JAX must be told to compute in
double precision, and where to keep what it has compiled, before it makes its first array.
"""

import argparse
import gc
import importlib
import os
import platform
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, NoReturn

from .files.config import ConfigError, Loaded, load
from .files.schema import StepConfig
from .files.summary import describe


if TYPE_CHECKING:
    from rich.console import Console

BAD_INPUT = 2
INTERRUPTED = 130


def arguments(program: str, what: str) -> argparse.ArgumentParser:
    """A parser with what all commands understand.

    Args:
        program: How the command is called.
        what: What it does, in a sentence.
    """
    parser = argparse.ArgumentParser(prog=program, description=what)
    parser.add_argument("config", type=Path, help="the YAML file of the job")
    parser.add_argument(
        "-o", "--output", type=Path, metavar="DIR", help="folder for the results"
    )
    parser.add_argument(
        "--set",
        dest="overrides",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        help="replace a value of the config, say process.tilt_deg=7.5; may be repeated",
    )
    parser.add_argument(
        "--check", action="store_true", help="only check the config and sum it up"
    )
    parser.add_argument("--quiet", action="store_true", help="say nothing but errors")
    parser.add_argument(
        "--no-cache", action="store_true", help="do not keep what JAX has compiled"
    )
    return parser


def resumable(parser: argparse.ArgumentParser) -> None:
    """Adds the option to go on from the searches that an interrupted run has finished."""
    parser.add_argument(
        "--resume",
        action="store_true",
        help="go on from the searches that an interrupted run finished in DIR",
    )


def read(path: Path, overrides: list[str]) -> Loaded | None:
    """The config, or None after its mistakes were told."""
    try:
        return load(path, overrides)
    except ConfigError as error:
        print(error, file=sys.stderr)
        return None


def folder(path: Path) -> bool:
    """Makes a folder for results; False, after a sentence, if it cannot be."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        print(f"{path}: cannot be used as a folder for results: {error}", file=sys.stderr)
        return False
    return True


class Asked(NamedTuple):
    """What a command is to do."""

    given: argparse.Namespace
    """The arguments."""
    loaded: Loaded
    """The config."""
    target: Path
    """Folder for the results; exists."""


def begin(
    parser: argparse.ArgumentParser, argv: list[str] | None, chooses: bool = False
) -> Asked | int:
    """Reads arguments and config, makes the folder, and loads JAX.

    Args:
        parser: From `arguments`.
        argv: The arguments; None for those of the command line.
        chooses: Whether the command looks at the choices of a config.

    Returns:
        What to do; or the exit code, where that was all: a mistake, told, or a check.
    """
    given = parser.parse_args(argv)
    loaded = read(given.config, given.overrides)
    if loaded is None:
        return BAD_INPUT
    if given.check:
        if not given.quiet:
            print(describe(loaded))
        return 0
    target = given.output or Path("runs") / given.config.stem
    jobs = loaded.alternatives if chooses and loaded.alternatives else (loaded,)
    if any(only_shows_when_made(config) for job in jobs for config in job.configs):
        prepare(not given.no_cache)
        if wrong := ill_made(jobs):
            print(wrong, file=sys.stderr)
            return BAD_INPUT
    if not chooses and not given.quiet:
        own_values(loaded)
    if not folder(target):
        return BAD_INPUT
    prepare(not given.no_cache)
    return Asked(given, loaded, target)


def own_values(loaded: Loaded) -> None:
    """Says that a command takes no notice of the choices of a config, if it has any."""
    if loaded.alternatives:
        print(
            f"{loaded.path}: polishopt.fit compares the choices; this is about the "
            "config's own values",
            file=sys.stderr,
        )


def ill_made(jobs: Sequence[Loaded]) -> str:
    """What is wrong with a part or a guide that only shows when it is made, or ''.

    Args:
        jobs: Configs that passed all other checks.
    """
    from .files.assemble import geometry

    for job in jobs:
        steps = [f", step {name}" for name, _ in job.steps] or [""]
        for step, config in zip(steps, job.configs, strict=True):
            if only_shows_when_made(config) and (wrong := geometry(config)):
                ending = f"; with {job.name}" if job.chosen else ""
                return f"{job.path}{step}: {wrong}{ending}"
    return ""


def only_shows_when_made(config: StepConfig) -> bool:
    """Whether the part or the guide of a config may turn out wrong when they are made."""
    shaped = config.part.surface in ("asphere", "nurbs", "point_grid", "step")
    return shaped or config.guide.family != "hilbert" or config.guide.even


class Voice(NamedTuple):
    """How a command says things."""

    told: "Console"
    """Where progress goes."""
    console: "Console"
    """Where the answer goes."""
    say: Callable[[str], None]
    """Says a sentence with the time it is."""


def opening(loaded: Loaded, quiet: bool) -> Voice:
    """How to say what is going on, which begins here.

    Args:
        loaded: The config.
        quiet: Whether to say nothing.
    """
    from rich.console import Console
    from rich.text import Text

    # what people call their steps and folders may hold brackets
    told = Console(stderr=True, quiet=quiet, markup=False)
    console = Console(quiet=quiet, markup=False)
    began = time.monotonic()

    def say(sentence: str) -> None:
        now = f"{time.monotonic() - began:5.1f} s"
        told.print(Text.assemble((now, "dim"), f"  {sentence}"))

    say(f"reading {loaded.path}")
    if loaded.measured:
        say(f"starting from {loaded.measured}")
    return Voice(told, console, say)


def perform(main: Callable[[], int]) -> NoReturn:
    """Does what a command line asks, and ends the process.

    Args:
        main: The command; returns its exit code.
    """
    try:
        code = main()
    except KeyboardInterrupt:
        print("Interrupted.", file=sys.stderr)
        code = INTERRUPTED
    leave(code)


def leave(code: int) -> NoReturn:
    """Ends the process; after an interruption at once, whatever it still computes.

    Args:
        code: The exit code.
    """
    if code == INTERRUPTED:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    sys.exit(code)


@contextmanager
def stoppable() -> Iterator[None]:
    """Within it, being asked to end (SIGTERM) is the same as Ctrl-C."""

    def stop(*_):
        raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield  # signals are for the main thread only
        return
    before = signal.signal(signal.SIGTERM, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def preload(*modules: str) -> None:
    """Imports modules in the background, for when they are needed."""

    def work():
        for module in modules:
            importlib.import_module(module)

    threading.Thread(target=work, daemon=True).start()


def prepare(cache: bool = True) -> None:
    """Loads JAX for double precision, with its compilations kept in the user's cache.

    Args:
        cache: Whether to keep them; the environment variable POLISHOPT_CACHE may name a
            folder for them, or say `off`.
    """
    import jax

    from . import stored
    from .compiler import share_work

    share_work()
    jax.config.update("jax_enable_x64", True)
    # a third of the time that tracing takes: nobody reads where an operation came
    # from, and the many objects that tracing makes are hardly ever garbage
    jax.config.update("jax_traceback_in_locations_limit", 0)
    gc.set_threshold(200_000, 50, 1000)
    place = os.environ.get("POLISHOPT_CACHE", "")
    if not cache or place == "off":
        return
    # compiled programs depend on the compiler and on the processor
    name = f"jax-{version('jaxlib')}-{platform.machine()}"
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    target = Path(place) if place else home / "polishopt"
    stored.keep_in(target / "programs")
    jax.config.update("jax_compilation_cache_dir", str(target / name))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
