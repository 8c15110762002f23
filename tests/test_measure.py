"""The command that measures a surface: known numbers, and sentences for bad input."""

import contextlib
import csv
import io
import json
import re
import subprocess
import sys

import numpy as np
import pytest
from polishopt.files.topography import Topography, write
from polishopt.measure import main
from test_topography import HUGE, sdf, x3p


AMPLITUDE = 0.5e-3  # mm


def wave(path, tilt=0.0, shape=(96, 128), holes=False):
    """Two whole waves along x, even about the middle, so that no plane fits them."""
    x = (np.arange(shape[1]) + 0.5) / shape[1]
    heights = np.tile(AMPLITUDE * np.cos(4 * np.pi * x) + tilt * x, (shape[0], 1))
    if holes:
        heights[40:50, 10] = np.nan
    write(path, Topography(heights, (2e-3, 1e-3), "a wave", "a test"))
    return path


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    folder = tmp_path_factory.mktemp("measured")
    surface = wave(folder / "wave.x3p", tilt=0.3)
    said = io.StringIO()
    with pytest.MonkeyPatch.context() as patched, contextlib.redirect_stdout(said):
        patched.setenv("POLISHOPT_CACHE", "off")
        patched.setenv("COLUMNS", "200")
        code = main([str(surface), "-o", str(folder / "out")])
    assert code == 0
    return folder / "out", said.getvalue()


def test_the_printed_numbers_are_those_of_a_wave(measured):
    """Sa = 2A/pi, Sq = A/sqrt 2, Ssk = 0, Sku = 3/2, Sz = 2A; the tilt is gone."""
    _, said = measured
    printed = dict(re.findall(r"^ (S\w+) +(?:nm +)?(-?[\d.e-]+)", said, re.MULTILINE))
    nm = AMPLITUDE * 1e6
    known = {
        "Sa": 2 * nm / np.pi,
        "Sq": nm / np.sqrt(2),
        "Sku": 1.5,
        "Sz": 2 * nm,
        "Sp": nm,
    }
    for name, value in known.items():
        assert float(printed[name]) == pytest.approx(value, rel=2e-3), name
    assert abs(float(printed["Ssk"])) < 1e-6
    assert "128 x 96 points on 0.128 x 0.192 mm, 0 % of them not measured" in said
    assert "S-filter none, form plane, L-filter none" in said
    assert "standard error" in said


def test_the_files_hold_the_same_numbers_with_units(measured):
    folder, _ = measured
    assert {path.name for path in folder.iterdir()} == {
        "parameters.json",
        "parameters.csv",
        "surface.png",
    }
    told = json.loads((folder / "parameters.json").read_text())
    with (folder / "parameters.csv").open(encoding="utf-8", newline="") as stream:
        rows = {row["parameter"]: row for row in csv.DictReader(stream)}
    assert (told["title"], told["form"], told["l_filter_mm"]) == ("a wave", "plane", None)
    assert told["spacing_y_x_mm"] == pytest.approx([2e-3, 1e-3])
    for name, row in rows.items():
        held = told["parameters"][name]["value"]
        assert (held is None) == (row["value"] == "")
        if held is not None:
            assert float(row["value"]) == pytest.approx(held, rel=1e-8, abs=1e-12)
    assert rows["Sq"]["unit"] == "nm"
    assert float(rows["Sq"]["standard_error"]) > 0
    # slope of the wave, A 4 pi/L/sqrt 2
    slope = AMPLITUDE * 4 * np.pi / 0.128 / np.sqrt(2)
    assert float(rows["Sdq"]["value"]) == pytest.approx(slope, rel=5e-3)
    assert (folder / "surface.png").stat().st_size > 10_000


def test_filters_and_holes(tmp_path, monkeypatch, capsys):
    """Far above and far below the wave, filters change nothing; quiet says nothing."""
    monkeypatch.setenv("POLISHOPT_CACHE", "off")
    surface = wave(tmp_path / "wave.sdf", holes=True)
    asked = ["--quiet", "--form", "none", "--s-filter-mm", "2e-3", "--l-filter-mm", "100"]
    assert main([str(surface), "-o", str(tmp_path), *asked]) == 0
    assert capsys.readouterr() == ("", "")
    told = json.loads((tmp_path / "parameters.json").read_text())
    assert told["unmeasured_percent"] == pytest.approx(100 * 10 / (96 * 128))
    known = AMPLITUDE * 1e6 / np.sqrt(2)
    assert told["parameters"]["Sq"]["value"] == pytest.approx(known, rel=5e-3)
    assert (told["s_filter_mm"], told["l_filter_mm"]) == (2e-3, 100)


BAD = {
    "truncated.sdf": (sdf()[:-5], "Unexpected end of file"),
    "truncated.x3p": (x3p()[:-30], "not a zip archive"),
    "huge.sdf": (
        sdf().replace(b"ISO-1.0", b"ISO-2.0")[:42] + b"\x00\xca\x9a\x3b" * 2 + sdf()[46:],
        "claims 1000000000 x 1000000000 points",
    ),
    "huge.x3p": (x3p(HUGE), "need 8000000000000000000"),
    "endian.sdf": (sdf(counts=">HH", floats=">d"), "claims 1024 x 768 points"),
    "endian.x3p": (
        x3p(data=(np.arange(12) * 1e-7).byteswap().tobytes()),
        "are unit and byte order right?",
    ),
    "small.sdf": (sdf(), "holds 4 x 3 points, must hold at least 8 along each side"),
    "missing.x3p": (None, "there is no such file"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_surface_is_one_sentence_and_exit_code_2(name, tmp_path, capsys):
    content, said = BAD[name]
    if content is not None:
        (tmp_path / name).write_bytes(content)
    assert main([str(tmp_path / name), "-o", str(tmp_path / "out")]) == 2
    out, told = capsys.readouterr()
    assert out == ""
    assert told.startswith(f"{tmp_path / name}: ")
    assert said in told
    assert told.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_the_command_is_polishopt_texture(tmp_path):
    ran = subprocess.run(
        [sys.executable, "-m", "polishopt.texture", tmp_path / "none.sdf"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.returncode == 2
    assert ran.stderr == f"{tmp_path / 'none.sdf'}: there is no such file\n"


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        (["--l-filter-mm", "-1"], "--l-filter-mm: is -1, must lie in (0, 1000] mm"),
        (["--s-filter-mm", "nan"], "--s-filter-mm: is nan, must lie in (0, 1000] mm"),
        (["--s-filter-mm", "0,8"], "--s-filter-mm: is 0,8, must lie in"),
        (["--form", "sphere"], "invalid choice: 'sphere'"),
        (["--s-filter-mm", "1", "--l-filter-mm", "0.5"], "must lie below --l-filter-mm"),
        (["--s-filter-mm", "0.2"], "must lie below the longer side, 0.192 mm"),
        (["--l-filter-mm", "0.002"], "must lie above two spacings, 0.002 mm"),
    ],
)
def test_bad_arguments_are_told_with_what_is_allowed(asked, said, tmp_path, capsys):
    surface = wave(tmp_path / "wave.sdf")
    try:
        code = main([str(surface), *asked])
    except SystemExit as left:
        code = left.code
    assert code == 2
    assert said in capsys.readouterr().err


@pytest.mark.parametrize(
    "place", [(slice(40, 41), slice(40, 41)), (slice(40, 45), slice(0, 96))]
)
def test_few_measured_points_hold_no_texture(place, tmp_path, capsys):
    """One point, and five rows of them: no numbers, and no warnings of numpy."""
    heights = np.full((96, 96), np.nan)
    heights[place] = 1e-4
    write(tmp_path / "few.x3p", Topography(heights, (1e-3, 1e-3)))
    assert main([str(tmp_path / "few.x3p"), "-o", str(tmp_path / "out")]) == 2
    count = int((~np.isnan(heights)).sum())
    assert f"has heights at {count} of its 96 x 96 points" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
