"""Choices: every combination is checked, tuned and ranked, and the best is the answer."""

import csv
import dataclasses
import io
import itertools
import json
import math
import time
from pathlib import Path
from threading import Lock
from typing import Any

import jax.numpy as jnp
import pytest
import test_tune
from polishopt import (
    Goal,
    Outcome,
    Process,
    Setup,
    answer,
    fit as fit_module,
    postprocess,
    tune,
)
from polishopt.choice_plot import figure
from polishopt.choice_report import Row, notes, show, table as table_of
from polishopt.files.answered import optimum
from polishopt.files.assemble import job
from polishopt.files.config import ConfigError, check, load
from polishopt.files.schema import schema_text
from polishopt.files.summary import describe
from polishopt.optimize import kept as kept_module, tune as tune_module
from polishopt.optimize.choices import Alternative, choose, distance, ranking
from polishopt.optimize.tune import Verdict
from polishopt.session import arguments, begin
from rich.console import Console
from test_tune import BETWEEN, SETUP, START


CONFIGS = Path(__file__).parent.parent / "configs"
PLANE = (CONFIGS / "pessoles2009_plane.yaml").read_text()
PLAN = (CONFIGS / "pessoles2009_plan.yaml").read_text()
EXAMPLE = Path(__file__).parent / "jobs" / "which_guide.yaml"
TARGET = {"Ssk": Goal(-0.75, 0.05), "Sku": Goal(3.6, 0.1)}
LIMITS = job(load(CONFIGS / "pessoles2009_plane.yaml").config).limits
GRAIN = float(SETUP.abrasive.grain)


def stand_in(process: Process, setup: Setup) -> Outcome:
    """Closed forms: pulling takes longer, coarse grains too, and the coarsest miss."""
    plain = test_tune.toy(process, setup)
    coarse = setup.abrasive.grain / GRAIN
    slow = 1.25 if setup.pulling else 1.0
    return dataclasses.replace(
        plain,
        time=plain.time * slow * (1 + 0.1 * (coarse - 1)),
        force_max=plain.force_max * coarse**0.1 / slow,
        Sku=plain.Sku + 2 * jnp.maximum(coarse - 2, 0.0),
    )


def with_choices(lines, text=PLANE):
    return f"{text}\nchoices:\n{lines}\n"


def loaded(lines, text=PLANE, overrides=()):
    return check(with_choices(lines, text), CONFIGS / "bad.yaml", overrides)


def guide(config) -> Any:
    """Its section, whatever the family."""
    return config.guide


def mistakes(lines, text=PLANE, overrides=()):
    with pytest.raises(ConfigError) as caught:
        loaded(lines, text, overrides)
    assert "Traceback" not in str(caught.value)
    return caught.value.problems


# the config


def test_combinations_come_in_the_order_typed_with_the_own_values_first():
    found = loaded("  guide.order: [2, 3]\n  guide.mode: [pushing, pulling]")
    made = [(guide(one.config).order, guide(one.config).mode) for one in found.alternatives]
    assert made == [(3, "pulling"), (2, "pushing"), (2, "pulling"), (3, "pushing")]
    assert found.alternatives[1].name == "guide.order 2, guide.mode pushing"
    assert found.config == load(CONFIGS / "pessoles2009_plane.yaml").config
    away = loaded("  guide.order: [2, 4]")
    assert [guide(one.config).order for one in away.alternatives] == [2, 4]
    assert guide(away.config).order == 3


def test_sections_and_presets_are_replaced_and_parts_of_them_chosen():
    found = loaded(
        "  abrasive: [P600, {preset: P1200, preston_1_Pa: 1.0e-13}]\n"
        "  guide: [{family: lines, count: 8}, {family: hilbert, order: 2, mode: pushing}]\n"
        "  guide.corner: [arc, sharp]\n"
        "  abrasive.grain_um: [10]"
    )
    assert len(found.alternatives) == 8
    for one, (abrasive, family, corner) in zip(
        found.alternatives,
        itertools.product(("P600", "P1200"), ("lines", "hilbert"), ("arc", "sharp")),
        strict=True,
    ):
        assert one.config.abrasive.preset == abrasive
        assert one.config.abrasive.grain_um == 10.0
        assert guide(one.config).family == family
        assert guide(one.config).corner == corner
        assert guide(one.config).mode == ("pushing" if family == "hilbert" else "pulling")


def test_what_is_tuned_and_how_often_may_be_chosen():
    found = loaded("  process.passes: [1, 2]\n  process.tilt_deg: [5]")
    assert [one.config.process.passes for one in found.alternatives] == [1, 2]
    assert "tilt_deg" not in found.alternatives[0].config.tuned()


def test_an_answer_is_a_config_without_choices():
    best = loaded("  guide.order: [2, 4]\n  abrasive: [P600]").alternatives[1]
    text = optimum(best, {"tilt_deg": 4.0})
    assert "choices" not in text
    assert "# S0 Table 1" in text
    again = check(text, CONFIGS / "again.yaml")
    assert again.config.guide == best.config.guide
    assert again.config.abrasive.preset == "P600"
    assert again.config.tuned()["tilt_deg"].start == 4.0


def test_a_plan_names_its_steps_by_number_and_everything_at_the_top():
    tuned = PLAN.replace("{displacement_mm: 0.3}", "{displacement_mm: {start: 0.3, "
                         "between: [0.2, 0.4]}}", 1)  # fmt: skip
    tuned = tuned.replace("process: {displacement_mm", "target: {Ssk: 0, Sku: 3}\n"
                          "    process: {displacement_mm", 1)  # fmt: skip
    found = loaded(
        "  guide.count: [8, 10]\n  steps[0].abrasive: [P120, P240]\n"
        "  steps[4].guide: [{family: lines, count: 4}, {family: hilbert, order: 2}]",
        tuned,
    )
    assert len(found.alternatives) == 8
    last = found.alternatives[-1]
    steps = dict(last.steps)
    assert guide(steps["P120"]).count == 10
    assert steps["P120"].abrasive.preset == "P240"
    assert guide(steps["9 um"]).order == 2
    assert guide(steps["3 um"]).order == 3
    again = check(optimum(last, {"9 um displacement_mm": 0.3}), CONFIGS / "again.yaml")
    assert again.steps[4][1].guide == steps["9 um"].guide
    assert again.steps[6][1].guide == steps["1 um"].guide
    (wrong,) = mistakes(
        "  steps[0].abrasive: [P120]\n  steps[1].guide: [{order: 3}]", tuned
    )
    assert "guide lacks the key 'family'" in wrong.sentence
    assert "with steps[0].abrasive P120, steps[1].guide {order: 3}" in wrong.sentence
    assert wrong.source.strip().startswith("steps[1].guide")


LINES = PLANE.count("\n") + 3  # of the first choice

# choices: (line after the first, parts of the sentence)
BAD = {
    "order": (
        "  guide.mode: [pulling, pushing]\n  guide.order: [2, 12]", 1,
        ["guide.order is 12, must lie in [1, 7]",
         "with guide.mode pulling, guide.order 12 and 1 more combination"],
    ),
    "fillet": ("  guide.fillet: [0.5, 0.7]", 0, ["0.7, must lie in (0, 0.5]", "with gui"]),
    "section": (
        "  guide:\n    - {family: hilbert, order: 3}\n    - {family: lines, count: 1}", 2,
        ["guide.count is 1, must lie in [2, 500]", "with guide {family: lines, count: 1}"],
    ),
    "part": (
        "  part.size_mm: [[50, 50], [50, 40]]", None,
        ["must be 'hilbert_rectangle' here", "with part.size_mm [50, 40]"],
    ),
    "body": (
        "  tool: [disc_18mm, {preset: disc_18mm, diameter_mm: 4}]", 0,
        ["must be smaller than the disc's radius, 2 mm", "with tool {preset"],
    ),
    "preset": ("  abrasive: [P600, P60]", 0, ["no preset 'P60'; did you mean 'P600'?"]),
    "wrong_key": (
        "  guide.oder: [2, 3]", 0, ["unknown key 'oder'; did you mean 'order'?"],
    ),
    "wrong_section": ("  gide.order: [2]", 0, ["unknown key 'gide'; did you mean 'guide'"]),
    "beyond": ("  guide.order.x: [2]", 0, ["guide.order is 3, it holds no keys"]),
    "twice": ("  guide.order: [2, 3, 2]", 0, ["choices.guide.order has 2 twice"]),
    "same_key": (
        "  part.size_mm[0]: [50]\n  part.size_mm.0: [50]", 1, ["is the same key as"],
    ),
    "part_first": (
        "  guide.mode: [pushing]\n  guide: [{family: hilbert, order: 2}]", 1,
        ["choices.guide must stand above guide.mode, which is a part of it"],
    ),
    "empty": ("  guide.order: []", 0, ["is [], must be a list of alternatives"]),
    "no_list": ("  guide.order: 3", 0, ["is 3, must be a list of alternatives, such as"]),
    "no_value": ("  guide.order:", 0, ["choices.guide.order has no value"]),
    "null": ("  guide.order: [2, null]", 0, ["choices.guide.order[1] has no value"]),
    "list": ("  - guide.order", 0, ["choices must be a section with lists"]),
    "target": ("  target.Ssk: [0, 1]", 0, ["choices.target.Ssk: there can be no alternat"]),
    "secondary": ("  secondary: [time, force]", 0, ["what all of them have in common"]),
    "fixed": (
        "  process: [{tilt_deg: 3, displacement_mm: 0.4, step_mm: 1, feed_mm_min: 1000, "
        "spindle_rpm: 2000, trochoid_radius_mm: 6}]", -1,
        ["nothing is tuned"],
    ),
    "too_many": (
        "  guide.order: [1, 2, 3, 4, 5]\n  process.passes: [1, 2, 3, 4, 5, 6, 7]\n"
        "  guide.mode: [pulling, pushing]", -1,
        ["choices make 70 combinations, must make at most 64"],
    ),
}  # fmt: skip


@pytest.mark.parametrize(("lines", "row", "parts"), BAD.values(), ids=BAD.keys())
def test_mistakes_in_choices_are_sentences_with_their_place(lines, row, parts):
    problems = mistakes(lines)
    said = [one for one in problems if parts[0] in one.sentence]
    assert len(said) == len(problems) == 1, "\n".join(map(str, problems))
    for part in parts:
        assert part in said[0].sentence
    if row is not None:
        assert said[0].line == LINES + row
    assert said[0].where.endswith("bad.yaml")


def test_overrides_change_choices():
    narrowed = loaded("  guide.order: [2, 3]", overrides=["choices.guide.order=[4]"])
    assert [guide(one.config).order for one in narrowed.alternatives] == [4]
    wider = loaded("  guide.order: [2, 3]", overrides=["choices.guide.mode=[pushing]"])
    assert [guide(one.config).mode for one in wider.alternatives] == ["pushing"] * 2
    assert not loaded("  guide.order: [2, 3]", overrides=["choices={}"]).alternatives
    (wrong,) = mistakes("  guide.order: [2]", overrides=["choices.guide.order=[12]"])
    assert str(wrong).startswith("--set choices.guide.order=[12]: guide.order is 12")


def test_the_example_follows_the_schema_and_is_summed_up():
    jsonschema = pytest.importorskip("jsonschema", reason="comes with check-jsonschema")
    checker = jsonschema.Draft202012Validator(json.loads(schema_text()))
    found = load(EXAMPLE)
    data = json.loads(json.dumps(found.document))
    assert not list(checker.iter_errors(data))
    data["choices"]["guide.mode"] = "pulling"
    assert list(checker.iter_errors(data))
    assert len(found.alternatives) == 6
    summary = describe(found)
    assert "guide.mode pulling, pushing" in summary
    assert "tunes all 6 combinations" in summary
    assert "choices" not in describe(found.alternatives[0])


# the search


def alternatives():
    """Four with an answer, of two structures, and one too coarse for the target."""
    made = {}
    for pulling, coarse in (
        (True, 1.0),
        (False, 1.5),
        (False, 1.2),
        (True, 1.1),
        (True, 9),
    ):
        grade = dataclasses.replace(SETUP.abrasive, grain=coarse * GRAIN)
        setup = dataclasses.replace(SETUP, pulling=pulling, abrasive=grade)
        made[f"{pulling} {coarse}"] = Alternative(setup, START, BETWEEN, TARGET, LIMITS)
    return made


@pytest.fixture(scope="module")
def chosen():
    said, done = [], []
    jobs = alternatives()
    found = choose(
        jobs,
        starts=4,
        chain=stand_in,
        progress=said.append,
        ended=lambda name, tuning: done.append((name, float(tuning.outcome.time))),
    )
    return jobs, found, said, done


def test_the_winner_is_that_of_separate_tunings(chosen):
    jobs, found, said, done = chosen
    alone: Any = tune
    apart = {name: alone(*one, starts=4, chain=stand_in) for name, one in jobs.items()}
    times = {
        name: float(one.outcome.time)
        for name, one in apart.items()
        if int(one.verdict) == Verdict.SOLVED
    }
    assert len(times) == 4
    assert found.winner == min(times, key=times.__getitem__) == "False 1.2"
    assert found.ranking == (*sorted(times, key=times.__getitem__), "True 9")
    assert list(found.tunings) == list(jobs)
    assert dict(done) == {k: float(v.outcome.time) for k, v in apart.items()}
    started = [sentence for sentence in said if sentence.startswith("choice ")]
    assert started[1] == "choice 2 of 5: False 1.5"
    assert int(found.tunings["True 9"].verdict) == Verdict.INFEASIBLE


def test_tunings_rank_as_starts_do(chosen):
    """By force, by distance, and those out of reach by how far they are off."""
    _, found, _, _ = chosen
    solved = {k: v for k, v in found.tunings.items() if int(v.verdict) == Verdict.SOLVED}
    force = {name: float(one.outcome.force_max) for name, one in solved.items()}
    assert ranking(solved, "force") == tuple(sorted(force, key=force.__getitem__))
    far = {name: distance(one) for name, one in solved.items()}
    # to six digits, beyond which those that meet the target exactly are alike
    assert ranking(solved, "none") == tuple(
        sorted(far, key=lambda k: float(f"{far[k]:.6g}"))
    )
    missed = found.tunings["True 9"]
    assert distance(missed) == pytest.approx(
        math.hypot(*map(float, missed.misses.values())), rel=1e-12
    )

    def other(like, verdict, status, miss=0.0, **excesses):
        over = {name: jnp.asarray(value) for name, value in excesses.items()}
        return dataclasses.replace(
            like,
            verdict=jnp.asarray(verdict.value),
            statuses=jnp.full_like(like.statuses, status),
            misses={"Ssk": jnp.asarray(miss)},
            excesses=over,
        )

    stopped, no = Verdict.NOT_CONVERGED, Verdict.INFEASIBLE
    nan = math.nan
    mixed = {
        "lost": other(missed, stopped, 3, nan, force=0.1, time=0.1),
        "over": other(missed, no, 1, 1.0, force=0.2, time=-5.0),
        "slow": other(missed, no, 1, 0.5, force=-1.0, time=90.0),
        "far": other(missed, no, 0, 3.0, force=-1.0, time=-1.0),
        "near": other(missed, no, 0, 2.0, force=-1.0, time=0.0),
        "stopped": other(missed, stopped, 2, 0.1, force=-1.0, time=-1.0),
        "less": other(missed, no, 1, 9.0, force=0.1, time=30.0),
        "good": solved["True 1.0"],
    }
    order = ranking(mixed, "time")
    assert order == ("good", "near", "far", "stopped", "less", "slow", "over", "lost")


def test_no_alternative_is_no_question():
    with pytest.raises(ValueError, match="`alternatives` is empty"):
        choose({})


def test_what_another_version_finished_is_not_taken_in_silence(monkeypatch):
    jobs, store, said = dict(list(alternatives().items())[:1]), {}, []
    choose(jobs, starts=4, chain=stand_in, store=store)
    kept = len(store)
    choose(jobs, starts=4, chain=stand_in, store=store, progress=said.append)
    assert len(store) == kept
    assert not any("another" in sentence for sentence in said)
    monkeypatch.setattr(kept_module, "surroundings", lambda: b"another version")
    choose(jobs, starts=4, chain=stand_in, store=store, progress=said.append)
    assert len(store) == 2 * kept
    assert sum("another version" in sentence for sentence in said) == 1


# the command


@pytest.fixture
def cheap(monkeypatch):
    """The command with a stand-in for the chain, without the results of the winner."""
    told = {"runs": 0, "answers": [], "prevented": {}}
    real, alone = tune_module.searched, Lock()  # searches run side by side

    def counted(*given):
        with alone:
            told["runs"] += 1
            last = told["runs"] == told.get("last")
        if last:
            raise KeyboardInterrupt
        return real(*given)

    def of_step(tuning, job, loaded, target, voice):
        told["answers"].append(loaded)
        return int(tuning.verdict)

    def paths(runs):
        ((_, _, config),) = runs
        sentence = told["prevented"].get(config.abrasive.preset)
        finding = postprocess.Finding(sentence or "fine", prevents=sentence is not None)
        return [postprocess.Programs((finding,), {}, ())]

    monkeypatch.setattr(tune_module, "searched", counted)
    monkeypatch.setattr(tune_module, "polish", stand_in)
    monkeypatch.setattr(answer, "of_step", of_step)
    monkeypatch.setattr(postprocess, "paths", paths)
    return told


CHOICES = "  guide.mode: [pulling, pushing]\n  abrasive: [P1200, P600, P120]"
TOY = PLANE.replace("Ssk: -0.72", "Ssk: -0.75").replace("Sku: 3.68", "Sku: 3.6")


def run(folder, *more, lines=CHOICES, text=TOY):
    path = folder / "job.yaml"
    path.write_text(with_choices(lines, text))
    given = [str(path), "-o", str(folder / "out"), "--no-cache", "--set=solver.starts=4"]
    return fit_module.main([*given, *more])


def table(folder):
    text = (folder / "out" / "choices.csv").read_text(encoding="utf-8")
    return list(csv.DictReader(text.splitlines()))


def test_the_command_tunes_all_and_reports_on_the_best(tmp_path, cheap, capsys):
    """P120 is out of reach here, which does not keep the others from being tuned."""
    assert run(tmp_path) == 0
    rows = table(tmp_path)
    assert [row["choice"] for row in rows] == list("123456")
    assert [row["abrasive"] for row in rows] == ["P1200", "P600", "P120"] * 2
    verdicts = [row["verdict"] for row in rows]
    assert verdicts == ["solved", "solved", "infeasible"] * 2
    solved = [row for row in rows if row["verdict"] == "solved"]
    best = min(solved, key=lambda row: float(row["time [min]"]))
    assert best["rank"] == "1"
    assert (best["guide.mode"], best["abrasive"]) == ("pushing", "P1200")
    assert "cannot be met" in rows[2]["why"]
    assert float(rows[2]["distance [tolerances]"]) > 1
    (winner,) = cheap["answers"]
    assert winner.name == "guide.mode pushing, abrasive P1200"
    assert 2 <= float(best["tilt_deg"]) <= 15
    said = capsys.readouterr()
    assert "choice 5 of 6: guide.mode pushing, abrasive P600" in " ".join(said.err.split())
    assert "Best: guide.mode pushing, abrasive P1200." in said.out
    for kind in ("png", "svg"):
        assert (tmp_path / "out" / f"choices.{kind}").stat().st_size > 5000


def test_what_the_machine_cannot_run_is_infeasible_for_itself(
    tmp_path, cheap, monkeypatch, capsys
):
    """Of three one is stuck before its search, and of the rest the better one after it."""

    def stuck(runs):
        ((_, _, config),) = runs
        return ["C is clamped."] if config.abrasive.preset == "P1200" else []

    monkeypatch.setattr(postprocess, "stuck", stuck)
    cheap["prevented"] = {"P600": "X would leave its travel."}
    lines = (
        "  guide.mode: [pushing]\n  abrasive: [P1200, P600, {preset: P600, grain_um: 27}]"
    )
    lines = lines.replace("27}", "27, preset: P240}").replace("preset: P600, g", "g")
    assert run(tmp_path, lines=lines) == 0
    rows = table(tmp_path)
    assert [row["verdict"] for row in rows] == ["infeasible", "infeasible", "solved"]
    assert [row["rank"] for row in rows] == ["", "2", "1"]
    assert (rows[0]["why"], rows[1]["why"]) == (
        "C is clamped.",
        "X would leave its travel.",
    )
    assert rows[0]["time [min]"] == ""
    assert cheap["answers"][0].config.abrasive.preset == "P240"
    assert "1: C is clamped." in capsys.readouterr().out
    monkeypatch.setattr(postprocess, "stuck", lambda runs: ["C is clamped."])
    assert run(tmp_path, "--quiet", lines=lines) == 3
    assert "abrasive P600: C is clamped." in capsys.readouterr().err


def test_a_bad_combination_ends_before_any_search(tmp_path, cheap, capsys):
    assert run(tmp_path, lines="  guide.order: [3, 12]") == 2
    said = capsys.readouterr().err
    assert f"job.yaml:{LINES}:20: guide.order is 12, must lie in [1, 7]" in said
    assert "with guide.order 12" in said
    assert not (tmp_path / "out").exists()
    assert cheap["runs"] == 0


def test_a_guide_that_cannot_be_made_ends_before_any_search(tmp_path, cheap, capsys):
    sparse = "{family: hatch, count: 2, angle_deg: 45}"
    assert run(tmp_path, lines=f"  guide: [{{family: hilbert, order: 3}}, {sparse}]") == 2
    said = capsys.readouterr().err
    assert "no line at 45° fits" in said
    assert "with guide {family: hatch, count: 2, angle_deg: 45}" in said
    assert "Traceback" not in said
    assert not (tmp_path / "out").exists()
    assert cheap["runs"] == 0


def test_an_interrupted_comparison_keeps_what_is_finished(tmp_path, cheap, capsys):
    assert run(tmp_path) == 0
    whole, total = table(tmp_path), cheap["runs"]
    cheap |= {"runs": 0, "last": total // 2}
    assert run(tmp_path) == 130
    time.sleep(0.1)
    done = table(tmp_path)
    said = " ".join(capsys.readouterr().err.split())
    finished = [row for row in done if row["verdict"] != "not tuned"]
    assert 0 < len(finished) < 6
    for row, later in zip(finished, whole, strict=False):
        assert {**row, "rank": later["rank"]} == later
    assert f"{len(finished)} of 6 choices are done, see" in said
    assert "--resume goes on from there" in said
    before = cheap["runs"] - 1
    cheap |= {"runs": 0, "last": None}
    assert run(tmp_path, "--resume") == 0
    assert cheap["runs"] == total - before
    assert table(tmp_path) == whole
    assert "another config" not in capsys.readouterr().err


def test_other_commands_say_that_they_take_the_own_values(tmp_path, capsys):
    path = tmp_path / "job.yaml"
    path.write_text(with_choices("  guide.order: [2]"))
    given = [str(path), "-o", str(tmp_path), "--no-cache"]
    asked = begin(arguments("polishopt.some", "does something"), given)
    assert not isinstance(asked, int)
    assert guide(asked.loaded.config).order == 3
    said = capsys.readouterr().err
    assert (
        "polishopt.fit compares the choices; this is about the config's own values" in said
    )
    assert not isinstance(begin(arguments("x", "y"), [*given, "--quiet"]), int)
    assert not capsys.readouterr().err


def test_the_picture_and_the_notes_name_every_choice():
    nan = math.nan
    rows = [
        Row(1, 2, {"a": "x"}, "infeasible", 2.0, 60.0, 1.0, {"tilt_deg": 3.0}, "too hard"),
        Row(2, 1, {"a": "$y_"}, "solved", 1e-6, 120.0, 2.0, {"tilt_deg": 4.0}, ""),
        Row(3, 3, {"a": "z"}, "not converged", 3.0, 30.0, 1.0, {}, "too hard"),
        Row(5, 4, {"a": "z"}, "not converged", 3.01, 31.0, 1.0, {}, ""),
        Row(4, 0, {"a": "w"}, "infeasible", nan, nan, nan, {}, "clamped"),
    ]
    assert notes(rows) == ["1, 3: too hard", "4: clamped"]
    axes, beside = figure(rows, "time").axes
    assert axes.get_ylabel() == "time [min]"
    numbers = [text.get_text() for text in axes.texts]
    assert sorted(numbers) == ["1", "2", "3, 5"]
    assert axes.get_xlabel() == "distance from the target [tolerances]"
    (key,) = beside.texts
    assert key.get_text().splitlines()[4] == "4: a w (infeasible)"
    assert figure(rows, "force").axes[0].get_ylabel() == "largest force [N]"


@pytest.mark.parametrize(
    ("width", "heads"),
    [
        (80, ["", "a", "ended", "distance\ntolerances", "time\nmin", "θ\n°"]),
        (41, ["", "a", "ended", "distance\ntolerances", "time\nmin"]),
        (38, ["", "ended", "distance\ntolerances", "time\nmin", "θ\n°"]),
        (34, ["", "ended", "distance\ntolerances", "time\nmin"]),
    ],
)
def test_the_table_leaves_out_what_has_no_room(width, heads):
    rows = [
        Row(1, 2, {"a": "long"}, "solved", 2.0, 60.0, 1.0, {"tilt_deg": 3.0}, ""),
        Row(2, 0, {"a": "word"}, "infeasible", math.nan, math.nan, math.nan, {}, "stuck"),
        Row(3, 1, {"a": "w"}, "solved", 2.0, 60.0, 1.0, {"tilt_deg": 3.0}, ""),
    ]
    made = table_of(rows, "time", width)
    assert [column.header for column in made.columns] == heads
    assert list(made.columns[0].cells) == ["3", "1", "2"]
    told = io.StringIO()
    show(Console(file=told, width=width, markup=False), rows, "time")
    assert ("2: a word" in told.getvalue()) == ("a" not in heads)
    assert "Best: a w. As good to 0.1 %: 1. All" in " ".join(told.getvalue().split())


@pytest.mark.slow
def test_the_real_chain_end_to_end(tmp_path):
    lines = "  guide.order: [1, 2]\n  guide.mode: [pulling, pushing]"
    small = [
        "--set=sampling.grid=12",
        "--set=texture.patch_pixels=48",
        "--set=process.step_mm.between=[1, 3]",
    ]
    code = run(tmp_path, *small, lines=lines, text=PLANE)
    assert code in (0, 3)
    rows = table(tmp_path)
    assert len(rows) == 4
    best = next(row for row in rows if row["rank"] == "1")
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert result["choice"]["guide.order"] == best["guide.order"]
    assert result["verdict"] == best["verdict"]
    again = load(tmp_path / "out" / "optimum.yaml")
    assert not again.alternatives
    assert str(guide(again.config).order) == best["guide.order"]
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"choices.csv", "choices.png", "choices.svg", "optimum.yaml"} <= names
