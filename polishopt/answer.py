"""Answer: what a fit makes of a tuning, every file of its results and the report on it."""

from pathlib import Path

from . import relax, report
from .basin_report import basin_table, left_over
from .files.assemble import Job, PlanJob
from .files.config import Loaded
from .optimize.basins import basins
from .optimize.tune import Tuning
from .plan import PlanOutcome
from .session import Voice


def of_step(tuning: Tuning, job: Job, loaded: Loaded, target: Path, voice: Voice) -> int:
    """Writes and prints everything about one step; returns the exit code.

    Args:
        tuning: The answer.
        job: What was asked, assembled.
        loaded: What was asked, as typed.
        target: Folder for the results; exists.
        voice: How to say things.
    """
    from . import results

    told, console, say = voice
    with told.status("drawing"):
        spread = results.spread_of(tuning.process, job)
        scatter, programs = results.write(tuning, job, loaded, target, say, spread)
        if relax.missed(tuning):
            relax.draw_reach(tuning, job, target)
    say(f"results are in {target}")
    found = basins(tuning, job.between)
    if found:
        console.print(basin_table(found, tuning, loaded))
    if rest := left_over(found, tuning):
        console.print(rest)
    report.show(console, tuning, job, loaded, scatter, spread, programs)
    if to_relax := relax.relax_table(tuning, job, loaded):
        console.print(to_relax)
    if relax.missed(tuning):
        console.print(relax.pointer(loaded, target), highlight=False)
    return int(report.ended(tuning, programs))


def of_plan(
    tuning: Tuning | None,
    outcome: PlanOutcome,
    job: PlanJob,
    loaded: Loaded,
    target: Path,
    voice: Voice,
) -> int:
    """The same for a plan.

    Args:
        tuning: The answer, if anything was tuned.
        outcome: What the steps do.
        job: What was asked, assembled.
        loaded: What was asked, as typed.
        target: Folder for the results; exists.
        voice: How to say things.
    """
    from . import plan_report
    from .optimize.uncertainty import plan_spread
    from .postprocess import deliver, paths

    told, console, say = voice
    settings = job.processes if tuning is None else tuning.process
    spreads = ()
    if any(job.errors):
        with told.status("carrying the errors of the constants"):
            spreads = plan_spread(settings, job.plan)
    with told.status("running the path of every step"):
        made = paths(list(zip(settings, job.plan.setups, loaded.configs, strict=True)))
        deliver(made, target / "program")
    with told.status("writing"):
        plan_report.write(target, job, outcome, loaded, tuning, spreads, made)
    say(f"results are in {target}")
    plan_report.show(console, job, outcome, loaded, tuning, spreads, made)
    if tuning is not None and relax.missed(tuning):
        text = relax.pointer(loaded, target, drawn=False)
        console.print(text, highlight=False)
    return plan_report.verdict(job, outcome, tuning, made)[0]
