"""Sensitivity: `python -m polishopt.sensitivity config.yaml` redraws the sensitivities.

The derivatives of all outcomes around the start of a config, without tuning anything; and
for a single step which settings make the outcomes vary between their bounds.
"""

import argparse

from .session import arguments, begin, perform


MOST = 2**16  # samples, as many as a night takes


def main(argv: list[str] | None = None) -> int:
    """Runs the command and returns its exit code."""
    parser = arguments(
        "python -m polishopt.sensitivity",
        "Draws how each outcome moves with each tuned setting, around the start values.",
    )
    parser.add_argument(
        "--samples",
        type=_power_of_two,
        default=256,
        metavar="N",
        help="points drawn between the bounds for the shares of variance, a power of two",
    )
    asked = begin(parser, argv)
    if isinstance(asked, int):
        return asked
    from .files.assemble import job as assemble, plan_job
    from .results import write_plan_sensitivities, write_sensitivities, write_variance

    made = ["sensitivity"]
    if asked.loaded.steps:
        write_plan_sensitivities(plan_job(asked.loaded.steps), asked.target)
    else:
        job = assemble(asked.loaded.config)
        write_sensitivities(job, job.process, asked.target)
        found = write_variance(job, asked.target, asked.given.samples)
        made += ["variance"] if found else []
    if not asked.given.quiet:
        kinds = ("csv", "png", "svg")
        print(*(asked.target / f"{one}.{kind}" for one in made for kind in kinds), sep="\n")
    return 0


def _power_of_two(text: str) -> int:
    number = int(text) if text.isdecimal() else 0
    if not 2 <= number <= MOST or number & (number - 1):
        sentence = f"is {text}, must be a power of two between 2 and {MOST}"
        raise argparse.ArgumentTypeError(sentence)
    return number


if __name__ == "__main__":
    perform(main)
