"""Choices: tunes every combination of a config's choices, and reports on the best one.

A combination whose path the machine cannot run is infeasible, whatever its texture: what
clamped axes forbid is known before its search, all else once there is an answer.
"""

import sys
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

from .files.config import Loaded
from .files.searches import Searches
from .session import INTERRUPTED, Asked, Voice, opening, preload


if TYPE_CHECKING:
    from .files.assemble import Job, PlanJob
    from .optimize.choices import Choice
    from .optimize.tune import Tuning


class Candidate(NamedTuple):
    """A combination, ready to be tuned."""

    loaded: Loaded
    """As typed."""
    job: "Job | PlanJob"
    """Assembled."""

    def asked(self):
        """Its arguments for `tune`."""
        from .files.assemble import PlanJob
        from .optimize.choices import Alternative

        job = self.job
        given = (job.between, job.target, job.limits)
        if isinstance(job, PlanJob):
            return Alternative(job.plan, job.processes, *given)
        return Alternative(job.setup, job.process, *given)

    def runs(self, settings) -> list:
        """Settings, setup and config of each step, or of the only one."""
        from .files.assemble import PlanJob

        if not isinstance(self.job, PlanJob):
            return [(settings, self.job.setup, self.loaded.config)]
        return list(zip(settings, self.job.plan.setups, self.loaded.configs, strict=True))

    def sentence(self, tuning: "Tuning") -> str:
        """How its tuning ended."""
        from . import plan_report, report
        from .files.assemble import PlanJob

        if not isinstance(self.job, PlanJob):
            return report.verdict(tuning)
        return plan_report.verdict(self.job, tuning.outcome, tuning)[1]


def compare(asked: Asked, store: Searches) -> int:
    """Tunes, prints and writes everything; the exit code is that of the best combination.

    Args:
        asked: What to do.
        store: Finished searches, which are not run again; new ones are added.
    """
    from .optimize.tune import Verdict

    voice = opening(asked.loaded, asked.given.quiet)
    preload("polishopt.plots", "xarray", "h5netcdf")
    candidates, cannot = _candidates(asked.loaded.alternatives)
    if not candidates:
        for name, sentence in cannot.items():
            print(f"{name}: {sentence}", file=sys.stderr)
        return int(Verdict.INFEASIBLE)
    tunings: dict[str, Tuning] = {}
    try:
        found = _choose(candidates, asked, store, voice, tunings)
        with voice.told.status("running the path of the best one"):
            order, hindered = _runnable(found, candidates)
        return _report(candidates, tunings, order, cannot | hindered, asked, voice)
    except KeyboardInterrupt:
        print(_interrupted(candidates, tunings, cannot, asked, store), file=sys.stderr)
        return INTERRUPTED


def _candidates(
    alternatives: Sequence[Loaded],
) -> tuple[dict[str, Candidate], dict[str, str]]:
    """What can be tuned, by name, and why the rest cannot be run on the machine."""
    from .files.assemble import job, plan_job
    from .postprocess import stuck

    candidates, cannot = {}, {}
    for one in alternatives:
        made = Candidate(one, plan_job(one.steps) if one.steps else job(one.config))
        if hindered := stuck(made.runs(made.asked().start)):
            cannot[one.name] = " ".join(hindered)
        else:
            candidates[one.name] = made
    return candidates, cannot


def _choose(
    candidates: Mapping[str, Candidate],
    asked: Asked,
    store: Searches,
    voice: Voice,
    tunings: dict[str, "Tuning"],
) -> "Choice":
    """Tunes all candidates; each tuning is in `tunings` as soon as it is finished."""
    from .choice_report import brief
    from .optimize.choices import choose

    solver, secondary = asked.loaded.config.solver, asked.loaded.config.secondary

    def ended(name: str, tuning: "Tuning") -> None:
        tunings[name] = tuning
        store.used.clear()  # what is used from now on belongs to the next one
        voice.say(brief(tuning, secondary))

    with voice.told.status("searching"):
        return choose(
            {name: one.asked() for name, one in candidates.items()},
            secondary,
            solver.starts,
            solver.seed,
            solver.tolerance,
            progress=voice.say,
            store=store,
            ended=ended,
        )


def _runnable(
    found: "Choice", candidates: Mapping[str, Candidate]
) -> tuple[list[str], dict[str, str]]:
    """The order with a best one that the machine can run, and why it cannot run others."""
    from .optimize.tune import Verdict
    from .postprocess import paths

    hindered = {}
    for name in found.ranking:
        tuning = found.tunings[name]
        if int(tuning.verdict) != Verdict.SOLVED:
            break
        made = paths(candidates[name].runs(tuning.process))
        prevented = [sentence for one in made for sentence in one.prevented]
        if not prevented:
            break
        hindered[name] = " ".join(prevented)
    return sorted(found.ranking, key=lambda name: name in hindered), hindered


def _report(
    candidates: Mapping[str, Candidate],
    tunings: Mapping[str, "Tuning"],
    order: Sequence[str],
    cannot: Mapping[str, str],
    asked: Asked,
    voice: Voice,
) -> int:
    """Writes and prints what became of all candidates, then everything about the best."""
    from . import answer, choice_plot, choice_report
    from .files.assemble import PlanJob
    from .plots import save

    best, secondary = candidates[order[0]], asked.loaded.config.secondary
    rows = _table(candidates, tunings, order, cannot, asked)
    for kind in (".png", ".svg"):
        save(choice_plot.figure(rows, secondary), asked.target / f"choices{kind}")
    choice_report.show(voice.console, rows, secondary)
    tuning, job = tunings[order[0]], best.job
    if isinstance(job, PlanJob):
        return answer.of_plan(tuning, tuning.outcome, job, best.loaded, asked.target, voice)
    return answer.of_step(tuning, job, best.loaded, asked.target, voice)


def _table(
    candidates: Mapping[str, Candidate],
    tunings: Mapping[str, "Tuning"],
    order: Sequence[str],
    cannot: Mapping[str, str],
    asked: Asked,
):
    """The rows of all combinations, which are then in `choices.csv`."""
    from . import choice_report

    said = {name: candidates[name].sentence(tuning) for name, tuning in tunings.items()}
    given = asked.loaded.alternatives
    rows = choice_report.rows(given, tunings, order, said, cannot)
    choice_report.write(rows, asked.target / choice_report.TABLE)
    return rows


def _interrupted(
    candidates: Mapping[str, Candidate],
    tunings: Mapping[str, "Tuning"],
    cannot: Mapping[str, str],
    asked: Asked,
    store: Searches,
) -> str:
    """How far it came, in a few sentences; what is finished is in `choices.csv`."""
    from .choice_report import TABLE
    from .interruption import interrupted
    from .optimize.choices import ranking

    said, left = [], [name for name in candidates if name not in tunings]
    if tunings:
        order = ranking(tunings, asked.loaded.config.secondary)
        _table(candidates, tunings, order, cannot, asked)
        where = asked.target / TABLE
        said.append(f"{len(tunings)} of {len(candidates)} choices are done, see {where}.")
    if left and (store.used or not tunings):
        now = asked._replace(loaded=candidates[left[0]].loaded)
        said.append(f"{left[0]}: {interrupted(now, store)}")
    else:
        said.append("Interrupted. The same command with --resume goes on from there.")
    return "\n".join(said)
