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
    from .files.assemble import job as assemble, plan_job
    from .results import write_plan_sensitivities, write_sensitivities

    if asked.loaded.steps:
        write_plan_sensitivities(plan_job(asked.loaded.steps), asked.target)
    else:
        job = assemble(asked.loaded.config)
        write_sensitivities(job, job.process, asked.target)
    if not asked.given.quiet:
        print(*(asked.target / f"sensitivity.{kind}" for kind in ("csv", "png")), sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
