"""Fit: `python -m polishopt.fit config.yaml` tunes a polishing step and reports on it.

Of a config with `choices` every combination is tuned, and the best one is the answer.

Exit codes: 0 solved, 2 bad input, 3 the target cannot be met within the limits, 4 not
converged, 130 interrupted. Results are written in all cases but bad input, so that a
failure can be looked at. Finished searches are kept in `searches` as they end: `--resume`
goes on from there.
"""

import contextlib
import sys
import threading
from collections.abc import Callable
from pathlib import Path

from .files.config import Loaded
from .files.searches import Searches
from .session import (
    BAD_INPUT,
    INTERRUPTED,
    arguments,
    begin,
    opening,
    perform,
    preload,
    resumable,
    stoppable,
)


def main(argv: list[str] | None = None) -> int:
    """Runs the command and returns its exit code."""
    parser = arguments(
        "python -m polishopt.fit",
        "Tunes a polishing step so that its texture hits the target within the limits. "
        "Exit codes: 0 solved, 2 bad input, 3 infeasible, 4 not converged.",
    )
    resumable(parser)
    asked = begin(parser, argv, chooses=True)
    if isinstance(asked, int):
        return asked
    from .choices import compare
    from .interruption import NOTHING_TUNED, finished, interrupted, keys

    # a plan is run as it stands then, and of choices it is known already
    lone = not asked.loaded.steps and not asked.loaded.alternatives
    if lone and not keys(asked.loaded):
        print(f"{asked.loaded.path}: {NOTHING_TUNED}", file=sys.stderr)
        return BAD_INPUT
    work = fit_plan if asked.loaded.steps else fit
    store = finished(asked)
    try:
        with stoppable():
            if asked.loaded.alternatives:
                return compare(asked, store)
            return work(asked.loaded, asked.target, asked.given.quiet, store)
    except KeyboardInterrupt:
        print(interrupted(asked, store), file=sys.stderr)
        return INTERRUPTED


def fit(
    loaded: Loaded, target: Path, quiet: bool = False, store: Searches | None = None
) -> int:
    """Tunes, prints and writes everything; the exit code says how it ended.

    Args:
        loaded: The config.
        target: Folder for the results; exists.
        quiet: Whether to print nothing.
        store: Finished searches, which are not run again; new ones are added.
    """
    from . import report
    from .chain import polish
    from .files.assemble import job as assemble
    from .optimize.tune import tune
    from .postprocess import stuck
    from .stored import seldom

    voice = told, _, say = opening(loaded, quiet)
    job = assemble(loaded.config)
    solver = loaded.config.solver
    if hindered := stuck([(job.process, job.setup, loaded.config)]):
        return _cannot(hindered)
    begin = seldom(polish)(job.process, job.setup)
    say(f"the start gives {report.summary(begin, job)}")
    with told.status("searching"):
        tuning = tune(
            job.setup,
            job.process,
            job.between,
            job.target,
            job.limits,
            loaded.config.secondary,
            solver.starts,
            solver.seed,
            solver.tolerance,
            progress=_meanwhile(say, lambda: _rehearse(job)),
            store=store,
        )
    from .answer import of_step

    return of_step(tuning, job, loaded, target, voice)


def fit_plan(
    loaded: Loaded, target: Path, quiet: bool = False, store: Searches | None = None
) -> int:
    """The same for a config with several steps; runs it as it stands if nothing is tuned.

    Args:
        loaded: The config.
        target: Folder for the results; exists.
        quiet: Whether to print nothing.
        store: Finished searches, which are not run again; new ones are added.
    """
    from .files.assemble import plan_job
    from .optimize.tune import tune
    from .plan import follow
    from .postprocess import stuck
    from .stored import seldom

    voice = told, _, say = opening(loaded, quiet)
    job = plan_job(loaded.steps)
    tuning, solver = None, loaded.config.solver
    begun = list(zip(job.processes, job.plan.setups, loaded.configs, strict=True))
    if hindered := stuck(begun):
        return _cannot(hindered)
    if job.between:
        with told.status("searching"):
            tuning = tune(
                job.plan,
                job.processes,
                job.between,
                job.target,
                job.limits,
                loaded.config.secondary,
                solver.starts,
                solver.seed,
                solver.tolerance,
                progress=say,
                store=store,
            )
        outcome = tuning.outcome
    else:
        with told.status(f"following {len(loaded.steps)} steps"):
            outcome = seldom(follow)(job.processes, job.plan)
    from .answer import of_plan

    return of_plan(tuning, outcome, job, loaded, target, voice)


def _cannot(sentences: list[str]) -> int:
    """Says why no settings can be run; nothing is written then."""
    from .optimize.tune import Verdict

    print("\n".join(sentences), file=sys.stderr)
    return int(Verdict.INFEASIBLE)


def _meanwhile(
    say: Callable[[str], None], work: Callable[[], None]
) -> Callable[[str], None]:
    """The same voice; with its first word, work begins in the background.

    Until a search says something, it compiles, and nothing should be in its way.
    """
    worker = threading.Thread(target=work, daemon=True)

    def speak(sentence: str) -> None:
        say(sentence)
        if worker.ident is None:
            worker.start()

    return speak


def _rehearse(job) -> None:
    from .results import rehearse

    preload("polishopt.plots", "xarray", "h5netcdf")

    # whatever is wrong will be said when it is needed
    with contextlib.suppress(Exception):
        rehearse(job)


def run() -> None:
    """The console script."""
    perform(main)


if __name__ == "__main__":
    run()
