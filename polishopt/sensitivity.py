"""Sensitivity: `python -m polishopt.sensitivity config.yaml` redraws the sensitivities.

The derivatives of all outcomes around the start of a config, without tuning anything.
"""

import sys
from pathlib import Path

from .files.config import describe
from .session import BAD_INPUT, arguments, folder, prepare, read


def main(argv: list[str] | None = None) -> int:
    """Runs the command and returns its exit code."""
    parser = arguments(
        "python -m polishopt.sensitivity",
        "Draws how each outcome moves with each tuned setting, around the start values.",
    )
    given = parser.parse_args(argv)
    loaded = read(given.config, given.overrides)
    if loaded is None:
        return BAD_INPUT
    if given.check:
        if not given.quiet:
            print(describe(loaded.config, loaded.measured))
        return 0
    target = given.output or Path("runs") / given.config.stem
    if not folder(target):
        return BAD_INPUT
    prepare(not given.no_cache)

    from .files.assemble import job as assemble
    from .results import write_sensitivities

    job = assemble(loaded.config)
    write_sensitivities(job, job.process, target)
    if not given.quiet:
        print(f"{target / 'sensitivity.csv'}\n{target / 'sensitivity.png'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
