"""Sensitivity: `python -m polishopt.sensitivity config.yaml` redraws the sensitivities.

The derivatives of all outcomes around the start of a config, without tuning anything.
"""

import sys

from .session import arguments, begin


def main(argv: list[str] | None = None) -> int:
    """Runs the command and returns its exit code."""
    parser = arguments(
        "python -m polishopt.sensitivity",
        "Draws how each outcome moves with each tuned setting, around the start values.",
    )
    asked = begin(parser, argv)
    if isinstance(asked, int):
        return asked
    if asked.loaded.steps:
        if not asked.given.quiet:
            print("A plan has no sensitivities of its own yet: take one of its steps.")
        return 0
    from .files.assemble import job as assemble
    from .results import write_sensitivities

    job = assemble(asked.loaded.config)
    write_sensitivities(job, job.process, asked.target)
    if not asked.given.quiet:
        print(*(asked.target / f"sensitivity.{kind}" for kind in ("csv", "png")), sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
