"""Program: `python -m polishopt.program config.yaml -o DIR` writes programs for controls.

The config is run as it stands, tuned values at their start: give it the `optimum.yaml` of
a fit for the answer of that fit. With `--check` the path is run and looked at, and nothing
is written.

Exit codes: 0 written, 2 bad input, 3 the machine cannot run the path.
"""

import sys
from pathlib import Path

from .files.config import Loaded
from .session import BAD_INPUT, arguments, folder, own_values, perform, prepare, read


def main(argv: list[str] | None = None) -> int:
    """Runs the command and returns its exit code."""
    parser = arguments(
        "python -m polishopt.program",
        "Writes a config's path as programs for the controls of milling machines, tuned "
        "values at their start, and says what the machine will make of it. With --check "
        "nothing is written. Exit codes: 0 written, 2 bad input, 3 the machine cannot run "
        "the path.",
    )
    given = parser.parse_args(argv)
    loaded = read(given.config, given.overrides)
    if loaded is None:
        return BAD_INPUT
    if not given.quiet:
        own_values(loaded)
    target = given.output or Path("runs") / given.config.stem
    if not given.check and not folder(target):
        return BAD_INPUT
    prepare(not given.no_cache)
    return program(loaded, None if given.check else target, given.quiet)


def program(loaded: Loaded, target: Path | None, quiet: bool = False) -> int:
    """Runs the paths of a config, says what it finds, and writes the programs.

    Args:
        loaded: The config.
        target: Folder for the programs; None to write none.
        quiet: Whether to print nothing but what is in the way.
    """
    from .files.assemble import job as assemble
    from .postprocess import deliver, paths

    steps = loaded.steps or (("", loaded.config),)
    jobs = [(assemble(config, first=False), config) for _, config in steps]
    made = paths([(one.process, one.setup, config) for one, config in jobs])
    for (name, _), one in zip(steps, made, strict=True):
        if name and not quiet:
            print(f"{name}:")
        for finding in one.findings:
            if finding.prevents:
                print(finding.sentence, file=sys.stderr)
            elif not quiet:
                print(finding.sentence)
    written = [] if target is None else deliver(made, target)
    if not quiet:
        for path in written:
            print(path)
    return 3 if any(one.prevented for one in made) else 0


def run() -> None:
    """The console script."""
    perform(main)


if __name__ == "__main__":
    run()
