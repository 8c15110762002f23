"""The command line: exit codes, sentences, and the folder of results."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from polishopt.files.config import load
from polishopt.files.ncode import DIALECTS
from polishopt.files.topography import read
from polishopt.fit import main
from polishopt.session import opening
from ruamel.yaml import YAML


CONFIGS = Path(__file__).parent.parent / "configs"
# a small part, a coarse guide and few starts: the same road, faster
SMALL = [
    "--set=guide.order=1",
    "--set=solver.starts=4",
    "--set=sampling.grid=12",
    "--set=texture.patch_pixels=48",
    "--set=process.step_mm.between=[1, 3]",
]


def command(module, *arguments, **environment):
    return subprocess.run(
        [sys.executable, "-m", module, *map(str, arguments)],
        capture_output=True,
        text=True,
        env={**os.environ, "POLISHOPT_CACHE": "off", **environment},
        check=False,
    )


@pytest.mark.parametrize("module", ["polishopt.fit", "polishopt.sensitivity"])
def test_a_wrong_config_is_answered_with_its_place_before_jax_is_loaded(module, tmp_path):
    path = tmp_path / "bad.yaml"
    text = (CONFIGS / "pessoles2009_plane.yaml").read_text()
    path.write_text(text.replace("{start: 3, between", "{start: 95, between"))
    code = (
        f"import sys; from {module} import main; code = main([{str(path)!r}]); "
        "print('jax' in sys.modules); sys.exit(code)"
    )
    ran = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    assert ran.returncode == 2
    assert ran.stdout.strip() == "False"
    assert "bad.yaml:" in ran.stderr
    assert "tilt_deg" in ran.stderr
    assert "Traceback" not in ran.stderr
    assert list(tmp_path.iterdir()) == [path]


def test_check_and_help_load_no_jax():
    config = str(CONFIGS / "pessoles2009_plane.yaml")
    code = (
        "import sys; from polishopt.fit import main; main([{!r}, '--check']); "
        "sys.exit('jax' in sys.modules)"
    )
    ran = subprocess.run(
        [sys.executable, "-c", code.format(config)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.returncode == 0
    assert "hilbert" in ran.stdout
    assert command("polishopt.fit", "--help").returncode == 0


def test_a_folder_that_cannot_be_made_is_a_sentence(tmp_path):
    occupied = tmp_path / "file"
    occupied.write_text("")
    ran = command("polishopt.fit", CONFIGS / "pessoles2009_plane.yaml", "-o", occupied)
    assert ran.returncode == 2
    assert "cannot be used as a folder" in ran.stderr
    assert "Traceback" not in ran.stderr


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    """What one command has compiled, for the next one: empty at first."""
    return str(tmp_path_factory.mktemp("cache"))


@pytest.fixture(scope="module")
def fitted(tmp_path_factory, cache):
    target = tmp_path_factory.mktemp("run")
    config = CONFIGS / "pessoles2009_plane.yaml"
    ran = command("polishopt.fit", config, "-o", target, *SMALL, POLISHOPT_CACHE=cache)
    return target, ran


def test_fit_ends_with_an_honest_exit_code(fitted):
    target, ran = fitted
    assert "Traceback" not in ran.stderr, ran.stderr
    assert ran.returncode in (0, 3), ran.stderr
    result = json.loads((target / "result.json").read_text())
    assert result["verdict"] == {0: "solved", 3: "infeasible"}[ran.returncode]
    for word in ("Settings", "Texture", "Limits", "Certificate", "tilt", "θ"):
        assert word in ran.stdout
    assert result["sentence"].split(":")[0] in ran.stdout.replace("\n", " ")


def test_fit_leaves_every_file_and_no_half_ones(fitted):
    target, ran = fitted
    names = {path.name for path in target.iterdir()}
    pictured = {"region.png"} if "cannot be met" in ran.stdout else set()
    assert names == pictured | {
        "result.json",
        "optimum.yaml",
        "maps.nc",
        "texture.x3p",
        "sensitivity.csv",
        "sensitivity.png",
        "sensitivity.svg",
        "path.png",
        "feed.png",
        "contact.png",
        "removal.png",
        "texture.png",
        "texture_maps.png",
        "program",
        "searches",
    }
    programs = {f"polish{one.ending}" for one in DIALECTS.values()}
    assert {path.name for path in (target / "program").iterdir()} == programs


def test_fit_says_what_the_machine_will_make_of_the_path(fitted):
    target, ran = fitted
    said = json.loads((target / "result.json").read_text())["preflight"]
    assert "Pre-flight" in ran.stdout
    shown = " ".join(ran.stdout.split())
    for sentence in said:
        assert sentence in shown
    assert any(sentence.startswith("One pass takes ") for sentence in said)
    table = DIALECTS["csv"].read((target / "program" / "polish.csv").read_text())
    assert table.seconds is not None
    minutes = next(float(s.split()[3]) for s in said if s.startswith("One pass"))
    approach = 2 * 20 / 500
    assert np.nansum(table.seconds) / 60 == pytest.approx(minutes + approach, rel=5e-3)


def test_optimum_is_a_config_that_starts_at_the_answer(fitted):
    target, _ = fitted
    text = (target / "optimum.yaml").read_text()
    assert "# S0 Table 1" in text, "comments are kept"
    written = YAML().load(text)["process"]["tilt_deg"]["start"]
    result = json.loads((target / "result.json").read_text())
    assert written == pytest.approx(result["answers"]["tilt_deg"], rel=1e-5)


def test_a_metrologist_can_open_the_texture(fitted):
    """The drawn patch in a surface file, in the units of that file."""
    xarray = pytest.importorskip("xarray")
    target, _ = fitted
    patch = read(target / "texture.x3p")
    assert "drawn by polishopt" in patch.title
    with xarray.open_dataset(target / "maps.nc", engine="h5netcdf") as maps:
        heights, along_x = maps["texture"].to_numpy(), maps["patch_x"].to_numpy()
    np.testing.assert_allclose(patch.heights, heights, rtol=1e-15)
    np.testing.assert_allclose(patch.spacing[1], along_x[1] - along_x[0], rtol=1e-9)


def test_maps_carry_units(fitted):
    xarray = pytest.importorskip("xarray")
    target, _ = fitted
    with xarray.open_dataset(target / "maps.nc", engine="h5netcdf") as maps:
        assert maps["removal"].dims == ("y", "x")
        assert all("units" in maps[name].attrs for name in maps.variables)
        assert "surface: plane" in maps.attrs["config"]
        result = json.loads((target / "result.json").read_text())
        mean = result["outcome"]["mean_removal"]
        np.testing.assert_allclose(float(maps["removal"].mean()), mean, rtol=0.02)
        time = maps["time"].to_numpy()
        assert (np.diff(time) >= 0).all()


@pytest.mark.slow
def test_sensitivity_command_draws_again(tmp_path, cache):
    config = CONFIGS / "pessoles2009_plane.yaml"
    ran = command(
        "polishopt.sensitivity",
        config,
        "-o",
        tmp_path,
        "--samples=8",
        *SMALL,
        POLISHOPT_CACHE=cache,
    )
    assert ran.returncode == 0, ran.stderr
    lines = (tmp_path / "sensitivity.csv").read_text().splitlines()
    assert lines[0].startswith("outcome,setting")
    assert any(line.startswith("Ssk,tilt,") for line in lines)
    assert (tmp_path / "sensitivity.png").stat().st_size > 10_000
    lines = (tmp_path / "variance.csv").read_text().splitlines()
    assert len(lines) == 1 + 10 * 4
    assert lines[1].startswith("Ssk,1,tilt,")
    assert lines[1].endswith(",8")
    for name in ("sensitivity", "variance"):
        assert (tmp_path / f"{name}.svg").read_text().startswith("<?xml")


def test_a_step_without_a_tuned_setting_is_refused(tmp_path, capsys):
    fixed = ["tilt_deg=3", "displacement_mm=0.4", "step_mm=1", "trochoid_radius_mm=6"]
    changes = [f"--set=process.{one}" for one in fixed]
    plane = str(CONFIGS / "pessoles2009_plane.yaml")
    assert main([plane, "-o", str(tmp_path), "--no-cache", *changes]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"{plane}: nothing is tuned: write {{start: ")
    assert said.count("\n") == 1
    assert not list(tmp_path.iterdir())


COMMANDS = ("fit", "program", "sensitivity", "front", "attribution", "calibrate", "texture")


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_can_be_interrupted_at_any_time(command):
    """A word and exit code 130, no traceback."""
    code = (
        "import argparse, runpy\n"
        "def stop(*_): raise KeyboardInterrupt\n"
        "argparse.ArgumentParser.parse_args = stop\n"
        f"runpy.run_module('polishopt.{command}', run_name='__main__')"
    )
    ran = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (ran.returncode, ran.stdout, ran.stderr) == (130, "", "Interrupted.\n")


def test_brackets_in_names_are_printed(capsys):
    """As the names of steps and folders may hold them."""
    voice = opening(load(CONFIGS / "pessoles2009_plane.yaml"), False)
    voice.console.print("P600 [fine]")
    voice.say("results are in out [x]")
    printed = capsys.readouterr()
    assert "P600 [fine]" in printed.out
    assert "results are in out [x]" in printed.err
