"""Config files: good ones load, bad ones are answered with a line and a remedy."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from polishopt.files import library
from polishopt.files.answered import optimum
from polishopt.files.config import ConfigError, Loaded, internal, load, write_text
from polishopt.files.quantity import Between, Tuned
from polishopt.files.schema import Config, schema_text
from polishopt.files.shop import Abrasive, Machine, Tool
from polishopt.files.summary import describe
from polishopt.units import UNITS, suffix


ROOT = Path(__file__).parents[1]
EXAMPLES = sorted((ROOT / "configs").glob("*.yaml"))

GOOD = """\
schema: 1
title: small
part:
  surface: sphere_cap
  size_mm: [50, 50]
  radius_mm: 100
tool: {preset: disc_18mm, friction: 0.3}
abrasive: P1200
machine: mikron_ucp710
guide:
  family: hilbert
  order: 3
process:
  tilt_deg: {start: 3, between: [2, 15]}  # keep me
  displacement_mm: 0.4
  step_mm: 1
  trochoid_radius_mm: 6
  feed_mm_min: 1000
  spindle_rpm: 2000
start:
  scratches: {abrasive: P600, pressure_MPa: 0.05}
target:
  Ssk: -0.45
  Sku: {value: 3.3, tolerance: 0.2}
limits:
  time_min: 20
solver:
  starts: 4
"""


def written(folder: Path, text: str | bytes) -> Path:
    path = folder / "bad.yaml"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def mistakes(path: Path, overrides=()) -> list:
    with pytest.raises(ConfigError) as caught:
        load(path, overrides)
    assert "Traceback" not in str(caught.value)
    return caught.value.problems


# name: (what to replace, by what, line, column, a part of the sentence)
# fmt: off
BAD = {
    "above_range": (
        "displacement_mm: 0.4", "displacement_mm: 95", 15, 20,
        "process.displacement_mm is 95, must lie in (0, 20] mm",
    ),
    "angle_range": (
        "{start: 3, between: [2, 15]}", "95", 14, 13,
        "process.tilt_deg is 95, must lie in (0, 45] °",
    ),
    "zero": ("step_mm: 1", "step_mm: 0", 16, 12, "is 0, must lie in (0, 50] mm"),
    "negative": ("time_min: 20", "time_min: -1", 26, 13, "limits.time_min is -1, must lie"),
    "misspelt_key": (
        "spindle_rpm", "spindel_rpm", 19, 3,
        "unknown key 'spindel_rpm'; did you mean 'spindle_rpm'?",
    ),
    "misspelt_section": ("target:", "tagret:", 22, 1, "did you mean 'target'?"),
    "wrong_unit": (
        "displacement_mm: 0.4", "displacement_um: 400", 15, 3,
        "unknown key 'displacement_um'; use 'displacement_mm', in mm",
    ),
    "no_unit": ("feed_mm_min", "feed", 18, 3, "use 'feed_mm_min', in mm/min"),
    "radians": ("tilt_deg", "tilt_rad", 14, 3, "use 'tilt_deg', in °"),
    "wrong_section": (
        "title: small", "tilt_deg: 3", 2, 1,
        "belongs in the section 'process'",
    ),
    "strange_key": ("  starts: 4", "  zebra: 4", 28, 3, "known here: starts, seed"),
    "number_as_key": ("  starts: 4", "  4: 4", 28, 3, "unknown key '4'"),
    "missing_key": ("  step_mm: 1\n", "", 13, 1, "process lacks the key 'step_mm'"),
    "missing_keys": (
        "  step_mm: 1\n  trochoid_radius_mm: 6\n", "", 13, 1,
        "process lacks the keys 'step_mm', 'trochoid_radius_mm'",
    ),
    "missing_section": (
        "target:\n  Ssk: -0.45\n  Sku: {value: 3.3, tolerance: 0.2}\n", "", 1, 1,
        "the config lacks the key 'target'",
    ),
    "decimal_comma": (
        "displacement_mm: 0.4", "displacement_mm: 0,4", 15, 20,
        "use a decimal point",
    ),
    "comma_in_list": ("[50, 50]", "[50,0, 40,0]", 5, 12, "holds 4 values, must hold 2"),
    "short_list": ("[50, 50]", "[50]", 5, 12, "part.size_mm holds too few values, only 1"),
    "no_list": ("[50, 50]", "50", 5, 12, "part.size_mm is 50, must be a list"),
    "in_list": (
        "[50, 50]", "[50, -40]", 5, 17,
        "part.size_mm[1] is -40, must lie in (0, 2000]",
    ),
    "unit_in_value": (
        "displacement_mm: 0.4", "displacement_mm: 400 um", 15, 20,
        "the key says the unit, write 0.4",
    ),
    "same_unit_in_value": ("step_mm: 1", "step_mm: 1 mm", 16, 12, "write 1"),
    "foreign_unit": ("step_mm: 1", "step_mm: 1 kg", 16, 12, "is '1 kg', must be a number"),
    "quotes": ("step_mm: 1", "step_mm: '1.5'", 16, 12, "remove the quotes"),
    "word": ("step_mm: 1", "step_mm: one", 16, 12, "is 'one', must be a number"),
    "truth_for_number": (
        "step_mm: 1", "step_mm: true", 16, 12,
        "is true, must be a number",
    ),
    "list_for_number": ("step_mm: 1", "step_mm: [1]", 16, 12, "is [1], must be a number"),
    "number_for_truth": (
        "time_min: 20", "unstick: 1", 26, 12,
        "limits.unstick is 1, must be true or false",
    ),
    "yes_for_truth": (
        "time_min: 20", "unstick: yes", 26, 12,
        "is 'yes', must be true or false",
    ),
    "fraction_for_count": ("order: 3", "order: 3.5", 12, 10, "must be a whole number"),
    "order_range": ("order: 3", "order: 9", 12, 10, "guide.order is 9, must lie in [1, 7]"),
    "nan": ("step_mm: 1", "step_mm: .nan", 16, 12, "is .nan, must be a finite number"),
    "infinity": ("step_mm: 1", "step_mm: .inf", 16, 12, "is .inf, must be a finite number"),
    "overflow": (
        "step_mm: 1", "step_mm: 1e999", 16, 12,
        "is .inf, must be a finite number",
    ),
    "huge_integer": ("step_mm: 1", "step_mm: 1" + "0" * 400, 16, 12, "process.step_mm is"),
    "no_value": ("step_mm: 1", "step_mm:", 16, 3, "process.step_mm has no value"),
    "null_limit": ("time_min: 20", "force_N:", 26, 3, "limits.force_N has no value"),
    "section_without_keys": ("  starts: 4\n", "", 27, 1, "solver has no value"),
    "section_is_number": (
        "limits:\n  time_min: 20", "limits: 20", 25, 9,
        "must be a section",
    ),
    "section_is_list": (
        "limits:\n  time_min: 20", "limits:\n  - time_min: 20", 26, 3,
        "must be a section",
    ),
    "title_is_number": ("title: small", "title: 5", 2, 8, "title is 5, must be text"),
    "tuned_start_outside": (
        "{start: 3,", "{start: 1,", 14, 21,
        "process.tilt_deg.start is 1, must lie in `between`, [2, 15]",
    ),
    "tuned_ends_swapped": ("[2, 15]}", "[15, 2]}", 14, 33, "lower end first"),
    "tuned_end_outside": (
        "[2, 15]}", "[2, 50]}", 14, 37,
        "process.tilt_deg.between[1] is 50, must lie in (0, 45] °",
    ),
    "tuned_without_start": ("{start: 3, ", "{", 14, 3, "lacks the key 'start'"),
    "tuned_misspelt": ("start: 3", "begin: 3", 14, 14, "known here: start, between"),
    "tuned_word": ("{start: 3,", "{start: low,", 14, 21, "is 'low', must be a number"),
    "tuned_one_end": ("[2, 15]}", "[2]}", 14, 33, "holds too few values"),
    "unknown_preset": (
        "abrasive: P1200\n", "abrasive: P1201\n", 8, 11,
        "abrasive: there is no preset 'P1201'; did you mean 'P120'? there are P120, P1200,",
    ),
    "unknown_preset_key": (
        "preset: disc_18mm", "preset: xyz", 7, 16,
        "there are disc_18mm, felt_6mm",
    ),
    "unknown_preset_within": (
        "{abrasive: P600,", "{abrasive: P60,", 21, 25,
        "start.scratches.abrasive: there is no",
    ),
    "preset_is_number": ("abrasive: P1200", "abrasive: 1200", 8, 11, "must be a section"),
    "beside_preset": (
        "friction: 0.3", "friction: 3", 7, 37,
        "tool.friction is 3, must lie in [0, 2]",
    ),
    "unknown_beside_preset": (
        "friction: 0.3", "frictoin: 0.3", 7, 27,
        "did you mean 'friction'?",
    ),
    "preset_does_not_fit": (
        "friction: 0.3", "diameter_mm: 9", 7, 16,
        "tool.body_radius_mm is 5, must be smaller than the disc's radius, 4.5 mm",
    ),
    "no_preset": (
        "{preset: disc_18mm, friction", "{diameter_mm: 18, friction", 7, 1,
        "or name a preset, 'disc_18mm' or 'felt_6mm'",
    ),
    "unstick_lengths": (
        "friction: 0.3", "unstick: {force_N: [1, 2]}", 7, 46,
        "one force for each of the 4 tilts",
    ),
    "unstick_order": (
        "friction: 0.3", "unstick: {tilt_deg: [5, 3, 10, 15]}", 7, 47,
        "ascending order",
    ),
    "surface_unknown": (
        "sphere_cap", "sphere", 4, 12,
        "part.surface is 'sphere', must be 'asphere', 'hyperbolic_paraboloid', 'nurbs',"
    ),
    "surface_missing": (
        "  surface: sphere_cap\n", "", 3, 1,
        "part lacks the key 'surface'",
    ),
    "key_of_another_surface": ("sphere_cap", "plane", 6, 3, "unknown key 'radius_mm'"),
    "sphere_too_small": (
        "radius_mm: 100", "radius_mm: -32", 6, 14,
        "half the diagonal of the patch, 35.3553 mm",
    ),
    "hilbert_on_a_rectangle": (
        "size_mm: [50, 50]", "size_mm: [50, 40]", 11, 11,
        "guide.family is 'hilbert', must be 'hilbert_rectangle' here: a Hilbert curve",
    ),
    "family_unknown": ("hilbert", "hilbrt", 11, 11, "did you mean 'hilbert'?"),
    "corner_unknown": (
        "order: 3", "order: 3\n  corner: round", 13, 11,
        "guide.corner is 'round', must be 'smooth', 'arc' or 'sharp'",
    ),
    "fillet_unused": (
        "order: 3", "order: 3\n  corner: sharp\n  fillet: 0.2", 14, 11,
        "must be left out",
    ),
    "version": ("schema: 1", "schema: 2", 1, 9, "schema is 2, must be 1"),
    "impossible_goal": (
        "{value: 3.3,", "{value: 1.1,", 24, 16,
        "must be at least 1 + Ssk^2 = 1.203",
    ),
    "impossible_plain_goal": ("Ssk: -0.45", "Ssk: -2", 24, 16, "at least 1 + Ssk^2 = 5"),
    "goal_range": (
        "Ssk: -0.45", "Ssk: -99", 23, 8,
        "target.Ssk is -99, must lie in [-20, 20]",
    ),
    "goal_word": ("Ssk: -0.45", "Ssk: low", 23, 8, "target.Ssk is 'low', must be a number"),
    "goal_without_value": ("{value: 3.3, ", "{", 24, 3, "target.Sku lacks the key 'value'"),
    "tolerance_range": ("tolerance: 0.2", "tolerance: 0", 24, 32, "must lie in (0, 1e6]"),
    "heights_impossible": (
        "Ssk: -0.45", "Ssk: -0.45\n  Sa_nm: 9\n  Sq_nm: 8", 24, 10,
        "must not exceed Sq, 8 nm",
    ),
    "nothing_at_start": (
        "  scratches: {abrasive: P600, pressure_MPa: 0.05}", "  {}", 20, 1,
        "start must hold 'file' or at least one of 'milled', 'scratches' and 'roughness'",
    ),
    "start_measured_and_more": (
        "target:", "  file: surface.x3p\ntarget:", 22, 9,
        "must stand alone: a measured surface holds everything",
    ),
    "start_file_missing": (
        "scratches: {abrasive: P600, pressure_MPa: 0.05}", "file: none.x3p", 21, 9,
        "none.x3p: there is no such file",
    ),
    "start_file_is_no_text": (
        "scratches: {abrasive: P600, pressure_MPa: 0.05}", "file: 3", 21, 9,
        "start.file is 3, must be text",
    ),
    "start_said_twice": (
        "target:", "  roughness: {Sq_nm: 30}\ntarget:", 22, 3,
        "both say the same",
    ),
    "milled_corner": (
        "target:",
        "  milled: {outer_radius_mm: 1, corner_radius_mm: 2, tilt_deg: 5,"
        " step_mm: 0.1, feed_per_tooth_mm: 0.05}\ntarget:",
        22, 50,
        "must not exceed the outer radius, 1 mm",
    ),
    "removal_order": (
        "time_min: 20", "least_removal_um: 5\n  most_removal_um: 4", 27, 20,
        "must be larger than least_removal_um, 5 µm",
    ),
    "machine_axis_missing": (
        "machine: mikron_ucp710", "machine: {axes: {}}", 9, 11,
        "machine.axes lacks the keys 'X', 'Y', 'Z'",
    ),
    "axis": (
        "machine: mikron_ucp710",
        "machine: {preset: mikron_ucp710, axes: {A: {speed_rpm: -1}}}",
        9, 56,
        "machine.axes.A.speed_rpm is -1, must lie in [0, 1e4] rpm",
    ),
    "axis_missing": (
        "machine: mikron_ucp710",
        "machine: {preset: mikron_ucp710, chain: w C B b X Y Z t}",
        9, 41,
        "must name X, Y, Z and two of A, B, C, once each, and just those that `axes` "
        "describes: X, Y, Z, A, C",
    ),
    "chain": (
        "machine: mikron_ucp710",
        "machine: {preset: mikron_ucp710, chain: C A X Y Z}",
        9, 41,
        "must name the axes from w, the part, by b, the bed, to t, the tool",
    ),
    "rotary_parallel": (
        "machine: mikron_ucp710",
        "machine: {preset: mikron_ucp710, axes: {A: {direction: [0, 0, 1]}}}",
        9, 19,
        "must not have two rotary axes that are parallel",
    ),
    "travel": (
        "machine: mikron_ucp710",
        "machine: {preset: mikron_ucp710, axes: {A: {travel_deg: [30, -30]}}}",
        9, 57,
        "must have the lower end first, then a higher one",
    ),
    "axis_unit": (
        "machine: mikron_ucp710",
        "machine: {preset: mikron_ucp710, axes: {A: {speed_deg_s: 90}}}",
        9, 45,
        "use 'speed_rpm', in rpm",
    ),
    "alias_loop": ("title: small", "title: &x [*x]", 2, 8, "must be text"),
    "duplicate_key": (
        "  step_mm: 1\n", "  step_mm: 1\n  step_mm: 2\n", 17, 3,
        "'step_mm' stands twice",
    ),
    "open_bracket": ("[50, 50]", "[50, 50", 6, 12, "expected ',' or ']'"),
    "tab": ("  order: 3", "\torder: 3", 12, 1, "indent with spaces"),
    "no_space": ("order: 3", "order:3", 12, 3, "indentation right"),
    "two_documents": ("target:", "---\ntarget:", 22, 1, "single document"),
    "control_character": ("small", "sm\u0007all", 2, 10, "U+0007 is not allowed"),
    "date": ("step_mm: 1", "step_mm: 2009-11-01", 16, 12, "must be a number"),
}
# fmt: on


@pytest.mark.parametrize("name", BAD)
def test_a_mistake_is_located_and_explained(name, tmp_path):
    old, new, line, column, fragment = BAD[name]
    assert old in GOOD
    path = written(tmp_path, GOOD.replace(old, new, 1))
    problems = mistakes(path)
    said = [problem for problem in problems if fragment in problem.sentence]
    assert len(said) == 1, "\n".join(map(str, problems))
    assert (said[0].line, said[0].column) == (line, column), str(said[0])
    head, source, caret = str(said[0]).split("\n")
    assert head.startswith(f"{path}:{line}:{column}: ")
    assert source.strip()
    assert f"    {path.read_text().split(chr(10))[line - 1]}".startswith(source)
    assert caret.index("^") == 4 + column - 1


def test_all_mistakes_are_said_at_once_in_the_order_of_the_file(tmp_path):
    text = GOOD.replace("friction: 0.3", "friction: -1").replace("order: 3", "order: 0")
    text = text.replace("step_mm: 1", "step_mm: 0,5").replace("Ssk: -0.45", "Ssk: none")
    problems = mistakes(written(tmp_path, text), ["solver.starts=0"])
    assert [problem.line for problem in problems] == [7, 12, 16, 23, 0]


def test_an_unknown_preset_is_not_followed_by_its_missing_keys(tmp_path):
    text = GOOD.replace("disc_18mm", "disc")
    (problem,) = mistakes(written(tmp_path, text))
    assert "there is no preset 'disc'" in problem.sentence


@pytest.mark.parametrize(
    ("content", "where", "fragment"),
    [
        ("", "", "the file is empty"),
        ("# nothing here\n", "", "the file is empty"),
        ("- a\n- b\n", ":1:1", "is a list"),
        ("just words\n", ":1:1", "is a single value"),
        (b"schema: 1\ntitle: caf\xe9\n", ":2:11", "save the file as UTF-8"),
        (b"\x00\x01", ":1:1", "U+0000 is not allowed"),
        (b"PK\x03\x04\xff\xfe", ":1:5", "not UTF-8"),
        ("&a [" * 1000, ":", "is not valid YAML"),
        ("a: &x {b: *x}\n", ":1:1", "unknown key"),
        ("%YAML 3.0\n---\na: 1\n", ":", ""),
        ("? [1, 2]\n: 3\n", ":", "unknown key"),
        ("a: !!float abc\n", ":", ""),
        ("a: !!binary x\n", ":", ""),
        ("{a: 1, b: 2}", ":", "unknown key 'a'"),
    ],
)
def test_a_file_that_is_no_config(content, where, fragment, tmp_path):
    path = written(tmp_path, content)
    problems = mistakes(path)
    assert any(fragment in str(problem) for problem in problems)
    assert str(problems[0]).startswith(f"{path}{where}")


def test_aliases_that_multiply_are_stopped(tmp_path):
    rows = ["a: &a [1, 2, 3, 4, 5, 6, 7, 8, 9]"]
    rows += [
        f"{b}: &{b} [{', '.join(['*' + a] * 9)}]"
        for a, b in zip("abcdef", "bcdefg", strict=True)
    ]
    (problem,) = mistakes(written(tmp_path, "\n".join(rows)))
    assert "nested too deeply" in problem.sentence
    many = "\n".join(f"key{i}: 1" for i in range(20_001))
    (problem,) = mistakes(written(tmp_path, many))
    assert "holds more than 20000 values" in problem.sentence


def test_a_text_too_long_for_a_config_is_not_read(tmp_path):
    """A million lines of comments would take minutes."""
    (problem,) = mistakes(written(tmp_path, "a: 1\n" + 1_000_000 * "#\n"))
    assert problem.sentence == "holds 2000005 characters, a config at most 500000"


def test_files_that_cannot_be_read(tmp_path):
    missing = tmp_path / "nowhere.yaml"
    assert str(mistakes(missing)[0]) == f"{missing}: there is no such file"
    assert "is a folder" in mistakes(tmp_path)[0].sentence
    assert "no file name" in mistakes(Path("a\0b"))[0].sentence


def test_windows_files_load(tmp_path):
    config = load(
        written(tmp_path, b"\xef\xbb\xbf" + GOOD.replace("\n", "\r\n").encode())
    ).config
    assert config.title == "small"
    wrong = GOOD.replace("step_mm: 1", "step_mm: 0").replace("\n", "\r\n")
    (problem,) = mistakes(written(tmp_path, wrong))
    assert (problem.line, problem.source) == (16, "  step_mm: 0")


# overrides


@pytest.mark.parametrize(
    ("override", "fragment"),
    [
        ("process.tilt_deg=95", "process.tilt_deg is 95, must lie in (0, 45] °"),
        ("process.tilt_deg.start=1", "process.tilt_deg.start is 1, must lie in `between`"),
        ("process.spindel_rpm=1", "did you mean 'spindle_rpm'?"),
        ("process.tilt_deg", "write an override as key=value"),
        ("=3", "write an override as key=value"),
        ("process..tilt_deg=3", "write an override as key=value"),
        ("process.tilt_deg=[1", "the value is not valid YAML"),
        pytest.param(f"title={3000 * '['}", "the value is not valid YAML", id="deep"),
        ("process.step_mm=", "process.step_mm has no value"),
        ("process.step_mm.start=1", "process.step_mm is 1, it holds no keys"),
        ("part.size_mm[2]=1", "part.size_mm is a list of 2"),
        ("part.size_mm.first=1", "part.size_mm is a list of 2"),
        ("part.size_mm[0]=-5", "part.size_mm[0] is -5, must lie in (0, 2000] mm"),
        ("tool=disc", "there is no preset 'disc'"),
        ("abrasive.grain_um=0", "abrasive.grain_um is 0, must lie in (0, 2000] µm"),
        ("limits={time_min: 0}", "limits.time_min is 0"),
        ("target={Ssk: 0}", "target lacks the key 'Sku'"),
        ("1=2", "unknown key '1'"),
    ],
)
def test_a_mistake_in_an_override_names_the_override(override, fragment, tmp_path):
    (problem,) = mistakes(written(tmp_path, GOOD), [override])
    assert str(problem).startswith(f"--set {override}: ")
    assert fragment in problem.sentence


def test_overrides_edit_the_document(tmp_path):
    path = written(tmp_path, GOOD)
    overrides = [
        "process.tilt_deg=7.5",
        "process.step_mm={start: 1, between: [0.5, 2]}",
        "part.size_mm[1]=60",
        "part.size_mm.0=60",
        "abrasive.grain_um=14",
        "sampling.grid=32",
        "title='a: b'",
    ]
    loaded = load(path, overrides)
    config = loaded.config
    assert config.process.tilt_deg == 7.5
    assert config.process.step_mm == Tuned(start=1.0, between=(0.5, 2.0))
    assert config.part.size_mm == (60.0, 60.0)
    assert config.abrasive.grain_um == 14.0
    assert config.abrasive.hardness_GPa == load(path).config.abrasive.hardness_GPa
    assert config.sampling.grid == 32
    assert config.title == "a: b"
    assert loaded.text == GOOD
    # what the answer file says is what was solved
    again = load(written(tmp_path, optimum(loaded, {})))
    assert again.config == config


def test_an_override_can_mend_a_file(tmp_path):
    path = written(tmp_path, GOOD.replace("step_mm: 1", "step_mm: 0"))
    assert load(path, ["process.step_mm=1"]).config.process.step_mm == 1.0


# good configs


def test_presets_lie_under_typed_keys(tmp_path):
    config = load(written(tmp_path, GOOD)).config
    given = library.preset("tools", "disc_18mm")
    assert config.tool.friction == 0.3
    assert config.tool.foundation_N_mm3 == given["foundation_N_mm3"]
    assert config.start.scratches is not None
    assert config.start.scratches.abrasive.grain_um == 25.8
    deep = load(
        written(tmp_path, GOOD), ["machine.axes.A.speed_rpm=10"]
    ).config.machine.axes
    assert deep.A is not None
    assert deep.C is not None
    assert (deep.A.speed_rpm, deep.A.jerk_rev_s3, deep.C.speed_rpm) == (10.0, 5.0, 20.0)


def test_a_config_without_presets(tmp_path):
    """Every key typed, and the same values as with the presets."""
    text = GOOD
    for key, shelf, name in (
        ("tool: {preset: disc_18mm, friction: 0.3}", "tools", "disc_18mm"),
        ("abrasive: P1200", "abrasives", "P1200"),
        ("machine: mikron_ucp710", "machines", "mikron_ucp710"),
    ):
        rows = library.text(shelf, name).splitlines()
        section = key.partition(":")[0] + ":\n" + "\n".join("  " + row for row in rows)
        text = text.replace(key, section)
    plain = load(written(tmp_path, text)).config
    named = load(written(tmp_path, GOOD), ["tool.friction=0.4"]).config
    assert plain.tool.model_dump(exclude={"preset"}) == named.tool.model_dump(
        exclude={"preset"}
    )
    assert plain.abrasive.grain_um == named.abrasive.grain_um
    assert plain.machine.axes == named.machine.axes


@pytest.mark.parametrize(
    ("shelf", "section"), [("tools", Tool), ("abrasives", Abrasive), ("machines", Machine)]
)
def test_presets_are_whole(shelf, section):
    assert library.names(shelf)
    for name in library.names(shelf):
        section.model_validate(library.preset(shelf, name))


def test_the_disc_body_touches_as_the_papers_figure_implies():
    """Between 5 and 10 degrees the limit passes the 1.2 mm at which S0 Fig. 4 ends."""
    import math

    tool = Tool.model_validate(library.preset("tools", "disc_18mm"))

    def deepest(tilt):
        reach = tool.diameter_mm / 2 - tool.body_radius_mm
        tilt = math.radians(tilt)
        return tool.body_recess_mm * math.cos(tilt) + reach * math.sin(tilt)

    assert deepest(5) < 1.2 < deepest(10) < deepest(15)
    # the paper's own setting is allowed
    assert deepest(3) > 0.4


def test_goals_have_tolerances(tmp_path):
    text = GOOD.replace("Ssk: -0.45", "Ssk: -0.45\n  Sq_nm: 50")
    target = load(written(tmp_path, text)).config.target
    assert target is not None
    assert (target.Ssk.value, target.Ssk.tolerance) == (-0.45, 0.05)
    assert (target.Sku.value, target.Sku.tolerance) == (3.3, 0.2)
    assert target.Sq_nm is not None
    assert target.Sq_nm.tolerance == pytest.approx(5.0)
    assert target.Sa_nm is None


def test_numbers_go_inside_in_mm_N_s_and_rad(tmp_path):
    config = load(written(tmp_path, GOOD), ["target.Sq_nm=50"]).config
    process = internal(config.process)
    assert process["feed"] == pytest.approx(1000 / 60)
    assert process["spindle"] == pytest.approx(209.4395102)
    assert process["tilt"].between == pytest.approx((0.0349065850, 0.2617993878))
    assert internal(config.abrasive)["preston"] == pytest.approx(4e-7)
    assert internal(config.abrasive)["grain"] == pytest.approx(0.0153)
    assert internal(config.part)["size"] == (50.0, 50.0)
    assert config.tool.unstick is not None
    assert internal(config.tool.unstick)["force"] == (12.0, 14.0, 17.0, 18.0)
    assert config.machine.axes.A is not None
    assert internal(config.machine.axes.A)["speed"] == pytest.approx(1.5707963268)
    assert config.target is not None
    assert internal(config.target)["Sq"].value == pytest.approx(50e-6)
    assert internal(config.limits)["time"] == pytest.approx(1200)


def test_a_config_is_frozen(tmp_path):
    config = load(written(tmp_path, GOOD)).config
    with pytest.raises(ValueError, match="frozen"):
        config.process.step_mm = 2.0


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_examples_load_and_say_which_schema_they_follow(path):
    loaded = load(path)
    assert isinstance(loaded, Loaded)
    assert loaded.text.startswith("# yaml-language-server: $schema=schema.json\n")
    assert loaded.config.title
    summary = describe(loaded)
    if loaded.steps:
        assert summary.count("tilt  ") == len(loaded.steps)
    else:
        assert "tuned in [2, 15] °, from 3" in summary


def test_the_manual_polishers_texture_is_the_papers():
    target = load(ROOT / "configs/pessoles2009_diamond.yaml").config.target
    assert target is not None
    assert (target.Ssk.value, target.Sku.value) == (-0.5941, 3.748)


def test_a_summary_names_everything_that_matters(tmp_path):
    text = GOOD.replace(
        "time_min: 20", "time_min: 20\n  spread_percent: 15\n  unstick: false"
    )
    summary = describe(load(written(tmp_path, text)))
    for fragment in (
        "sphere cap, radius 100 mm, 50 x 50 mm",
        "disc_18mm, diameter 18 mm",
        "hilbert, order 3",
        "tuned in [2, 15] °, from 3",
        "1000 mm/min",
        "Ssk -0.45 ± 0.05, Sku 3.3 ± 0.2",
        "time 20 min, rigid body, spread",
    ):
        assert fragment in summary
    felt = load(ROOT / "configs/pessoles2009_diamond.yaml")
    assert "unstick (this tool has no table)" in describe(felt)


# the answer


def test_an_answer_keeps_comments_and_layout(tmp_path):
    loaded = load(written(tmp_path, GOOD))
    answer = optimum(loaded, {"tilt_deg": 7.123456789})
    assert answer == GOOD.replace("start: 3,", "start: 7.12346,").replace(
        "  # keep", " # keep"
    )
    assert load(written(tmp_path, answer)).config.tuned()["tilt_deg"].start == 7.12346
    # the loaded document is not touched
    assert optimum(loaded, {}) == GOOD


def test_an_answer_never_leaves_its_range(tmp_path):
    text = GOOD.replace("[2, 15]", "[2, 14.12345678]")
    loaded = load(written(tmp_path, text))
    answer = load(written(tmp_path, optimum(loaded, {"tilt_deg": 14.12345678}))).config
    assert answer.tuned()["tilt_deg"].start <= 14.12345678
    low = load(written(tmp_path, optimum(loaded, {"tilt_deg": 2 - 1e-9}))).config
    assert low.tuned()["tilt_deg"].start == 2.0


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_examples_round_trip(path):
    loaded = load(path)
    starts = {key: value.start for key, value in loaded.config.tuned().items()}
    rows = zip(loaded.text.splitlines(), optimum(loaded, starts).splitlines(), strict=True)
    for old, new in rows:
        # 3 comes back as 3.0, nothing else changes
        assert re.sub(r"start: ([\d.]+?)(\.0)?,", r"start: \1,", new).split() == old.split()


def test_a_fixed_value_has_no_answer(tmp_path):
    with pytest.raises(ValueError, match="`process.step_mm` is not tuned"):
        optimum(load(written(tmp_path, GOOD)), {"step_mm": 1.0})


def test_files_are_replaced_at_once(tmp_path):
    path = tmp_path / "answer.yaml"
    write_text(path, "old")
    write_text(path, "µ\n")
    assert path.read_bytes() == "µ\n".encode()
    assert os.listdir(tmp_path) == ["answer.yaml"]


# schema and imports


def test_the_committed_schema_is_current():
    """Rewrite it: python -m polishopt.files.schema > configs/schema.json"""
    assert (ROOT / "configs/schema.json").read_text(encoding="utf-8") == schema_text()


def test_examples_follow_the_json_schema():
    jsonschema = pytest.importorskip("jsonschema", reason="comes with check-jsonschema")
    checker = jsonschema.Draft202012Validator(json.loads(schema_text()))
    checker.check_schema(checker.schema)
    for path in EXAMPLES:
        data = json.loads(json.dumps(load(path).document))
        assert not list(checker.iter_errors(data))
        if "steps" in data:
            data["steps"][0]["limits"] = {"time_min": -1}
        else:
            data["process"]["tilt_deg"]["between"] = [2, 50]
        assert list(checker.iter_errors(data))


def test_every_key_is_described_and_every_unit_known():
    def visit(section, name):
        for key, field in section.model_fields.items():
            if key not in ("preset", "surface", "family", *"XYZABC"):
                assert field.description, f"{name}.{key}"
            for inner in sections(field.annotation):
                visit(inner, f"{name}.{key}")

    def sections(annotation):
        if isinstance(annotation, type) and hasattr(annotation, "model_fields"):
            yield annotation
        for part in getattr(annotation, "__args__", ()):
            yield from sections(part)

    visit(Config, "config")
    for shelf in ("tools", "abrasives"):
        for key in library.preset(shelf, library.names(shelf)[0]):
            if key not in ("friction", "unstick", "active_fraction", "depth_variation"):
                assert suffix(key) in UNITS


@pytest.mark.parametrize("interval", ["0, 1", "(0; 1]", "(0, 1"])
def test_an_interval_is_written_as_people_do(interval):
    with pytest.raises(ValueError, match="is no interval"):
        Between(interval).holds(0.5)


def test_reading_a_config_imports_neither_jax_nor_numpy():
    code = (
        "import sys; from polishopt.files.config import load;"
        "from polishopt.files.summary import describe;"
        f"describe(load({str(EXAMPLES[0])!r}));"
        "print([m for m in ('jax', 'equinox', 'numpy', 'matplotlib') if m in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=True
    )
    assert done.stdout.strip() == "[]"
