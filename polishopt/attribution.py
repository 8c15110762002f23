"""Attribution: `python -m polishopt.attribution first.yaml second.yaml` compares two jobs.

It runs both around their start values, tunes nothing, and splits the difference of their
outcomes into contact, stretch of area, true feed, and the path.
"""

import sys
from pathlib import Path

from .session import BAD_INPUT, arguments, folder, own_values, perform, prepare, read


def main(argv: list[str] | None = None) -> int:
    """Runs the command and returns its exit code."""
    parser = arguments(
        "python -m polishopt.attribution",
        "Splits the difference between two jobs, say on a plane and on a convex part, into "
        "contact force and area, area stretch, and true feed.",
    )
    parser.add_argument("second", type=Path, help="the YAML file of the other job")
    given = parser.parse_args(argv)
    both = [read(path, given.overrides) for path in (given.config, given.second)]
    if None in both:
        return BAD_INPUT
    loaded = [one for one in both if one is not None]
    plans = [str(one.path) for one in loaded if one.steps]
    if plans:
        print(
            f"{plans[0]}: has several steps, must have one: take a step of the plan.",
            file=sys.stderr,
        )
        return BAD_INPUT
    if not given.quiet:
        for one in loaded:
            own_values(one)
    if given.check:
        return 0
    name = f"{given.config.stem}-{given.second.stem}"
    target = given.output or Path("runs") / name
    if not folder(target):
        return BAD_INPUT
    prepare(not given.no_cache)

    from rich.console import Console

    from .files.assemble import job
    from .files.results import write_attribution
    from .optimize.attribution import attribution
    from .report import attribution_table
    from .results import INNER_UNITS

    first, second = (job(one.config) for one in loaded)
    split = attribution((first.process, first.setup), (second.process, second.setup))
    write_attribution(target / "attribution.csv", split, INNER_UNITS)
    if not given.quiet:
        titles = [one.config.title or one.path.stem for one in loaded]
        Console(markup=False).print(attribution_table(split, *titles))
        print(target / "attribution.csv")
    return 0


if __name__ == "__main__":
    perform(main)
