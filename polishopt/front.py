"""Front: `python -m polishopt.front config.yaml` draws what can be had, and at what price.

`front.csv`, `.png` and `.svg`: how far one outcome must give way for another, time and the
miss of the target unless asked otherwise. `region.csv`, `.png` and `.svg`: what Ssk and Sku
can be together within the limits, with the target in it.

Exit codes: 0 done, 2 bad input, 3 no settings keep the limits, 4 not converged, 130
interrupted; `--resume` goes on then.
"""

import sys
from collections.abc import Mapping
from pathlib import Path

from .session import (
    BAD_INPUT,
    INTERRUPTED,
    Asked,
    arguments,
    begin,
    opening,
    perform,
    resumable,
    stoppable,
)


POINTS = 12
FOLDER = "front_searches"


def main(argv: list[str] | None = None) -> int:
    """Runs the command and returns its exit code."""
    parser = arguments(
        "python -m polishopt.front",
        "Draws what two outcomes cost each other, and which textures can be reached. Exit "
        "codes: 0 done, 2 bad input, 3 no settings keep the limits, 4 not converged.",
    )
    parser.add_argument(
        "--points",
        type=int,
        default=POINTS,
        metavar="N",
        help=f"points of the front, and slices of the region ({POINTS})",
    )
    parser.add_argument(
        "--trade",
        nargs=2,
        metavar=("A", "B"),
        help="the outcomes of the front, as: time spread; 'miss' is the largest miss of a "
        "goal (the config's secondary objective, and miss)",
    )
    parser.add_argument(
        "--region",
        nargs=2,
        default=("Ssk", "Sku"),
        metavar=("A", "B"),
        help="the outcomes of the region (Ssk Sku)",
    )
    resumable(parser)
    asked = begin(parser, argv)
    if isinstance(asked, int):
        return asked
    if asked.given.points < 2:
        print(f"--points is {asked.given.points}, must be 2 or more", file=sys.stderr)
        return BAD_INPUT
    for pair in (asked.given.trade, asked.given.region):
        if pair and pair[0] == pair[1]:
            print(f"{pair[0]!r} is there twice, must be two outcomes", file=sys.stderr)
            return BAD_INPUT
    from .interruption import NOTHING_TUNED, finished, keys

    if not keys(asked.loaded):
        print(f"{asked.loaded.path}: {NOTHING_TUNED}", file=sys.stderr)
        return BAD_INPUT
    store = finished(asked, FOLDER)
    try:
        with stoppable():
            return draw(asked, store)
    except KeyboardInterrupt:
        print(
            "Interrupted: finished searches are kept, and the same command with --resume "
            "goes on from there.",
            file=sys.stderr,
        )
        return INTERRUPTED


def draw(asked: Asked, store) -> int:
    """Draws front and region; returns the exit code.

    Args:
        asked: What to do.
        store: Finished searches, which are not run again; new ones are added.
    """
    from .files.assemble import job, plan_job
    from .optimize.explore import MISS, Explorer
    from .optimize.front import front, region

    loaded, given = asked.loaded, asked.given
    told, console, say = opening(loaded, given.quiet)
    if loaded.steps:
        plan = plan_job(loaded.steps)
        made, setup, start, target = plan, plan.plan, plan.processes, plan.target
    else:
        one = job(loaded.config)
        made, setup, start, target = one, one.setup, one.process, one.target
    first = "force" if loaded.config.secondary == "force" else "time"
    one_of, other = given.trade or (first, MISS)
    across, up = given.region
    trade, names, solver = (one_of, other), (across, up), loaded.config.solver
    with told.status("searching"):
        try:
            explorer = Explorer(
                setup,
                start,
                made.between,
                target,
                made.limits,
                tuple(dict.fromkeys((*trade, *names))),
                seed=solver.seed,
                tolerance=solver.tolerance,
                progress=say,
                store=store,
            )
        except ValueError as error:
            print(f"{loaded.path}: {error}", file=sys.stderr)
            return BAD_INPUT
        line = front(explorer, trade, given.points)
        area = region(explorer, names, given.points)
        answer = None
        if line.points and line.names[1] == MISS:
            outcomes, _ = explorer.values(line.points[0].settings)
            answer = [outcomes[explorer.names.index(name)] for name in names]
    write(asked.target, loaded, target, line, area, answer)
    say(f"{explorer.searches} searches; results are in {asked.target}")
    if line.points and area.low:
        console.print(summary(line))
        return 0
    if (explorer.over <= 0).any():
        print("Not converged: no search ended within its work.", file=sys.stderr)
        return 4
    print(
        f"Infeasible: none of {len(explorer.drawn)} settings between the bounds keeps the "
        "limits, nor did any search find one that does.",
        file=sys.stderr,
    )
    return 3


def summary(line) -> str:
    """The two ends of a front, in a sentence."""
    from .front_plot import shown, title

    (a, b), (c, d) = (
        [f"{shown(name, v):.4g}" for name, v in zip(line.names, point.values, strict=True)]
        for point in (line.points[0], line.points[-1])
    )
    first, second = map(title, line.names)
    return f"From {first} {a} at {second} {b} to {c} at {d}, in {len(line.points)} points."


def write(target: Path, loaded, goals: Mapping, line, area, answer=None) -> None:
    """The tables and pictures of a front and a region.

    Args:
        target: The folder; exists.
        loaded: The config.
        goals: The target.
        line: The front.
        area: The region.
        answer: The region's outcomes where the front is nearest to the target.
    """
    from . import plots
    from .files.results import write_table
    from .front_plot import aims, bare, front_figure, region_figure, shown, title
    from .interruption import keys
    from .units import from_internal, suffix

    named = keys(loaded)

    def cells(names, point):
        both = zip(names, point.values, strict=True)
        return [
            *(float(shown(name, value)) for name, value in both),
            *(from_internal(point.settings[n], suffix(key)) for n, key in named.items()),
        ]

    first, second = line.names
    price = float(shown(first, 1.0) / shown(second, 1.0))
    write_table(
        target / "front.csv",
        [
            title(first),
            title(second),
            *named.values(),
            f"{first} saved per unit of {second} [{bare(first)}/{bare(second)}]",
        ],
        [[*cells(line.names, p), p.slope * price] for p in line.points],
    )
    write_table(
        target / "region.csv",
        ["end", *map(title, area.names), *named.values()],
        [
            [end, *cells(area.names, p)]
            for end, points in (("low", area.low), ("high", area.high))
            for p in points
        ],
    )
    last = f"{loaded.steps[-1][0]} " if loaded.steps else ""
    for figure, name in (
        (front_figure(line), "front"),
        (
            region_figure(
                area.names, area.drawn, aims(goals, area.names, last), answer, area
            ),
            "region",
        ),
    ):
        for kind in (".png", ".svg"):
            plots.save(figure, target / f"{name}{kind}")


if __name__ == "__main__":
    perform(main)
