"""The calibrate command: tables of measurements, sentences, and what it writes."""

import subprocess
import sys
from pathlib import Path

import pytest
from polishopt.calibrate import main
from polishopt.files.calibrated import Constant, calibrated
from polishopt.files.config import check, load
from polishopt.files.document import ConfigError
from polishopt.files.measurements import measurements


CONFIGS = Path(__file__).parent.parent / "configs"
PLANE = CONFIGS / "pessoles2009_plane.yaml"
# F/k [mm^3] of a disc of 18 mm, from a table of closed forms: 3, 5 and 10 degrees
SPRINGS = {
    0.15: (1.59, 0.75, 0.27),
    0.30: (8.64, 4.14, 1.49),
    0.60: (44.63, 22.31, 8.22),
    0.90: (109.1, 58.2, 22.1),
}


def forces(error=""):
    """A bench test of springs of 0.25 N/mm3, in three figures."""
    rows = [
        "# bench of the test",
        f"tilt_deg, displacement_mm, force_N, unstuck{error and ', force_error_N'}",
    ]
    for displacement, row in SPRINGS.items():
        for tilt, force in zip((3, 5, 10), row, strict=True):
            rows.append(f"{tilt}, {displacement}, {0.25 * force}, 0{error}")
    return "\n".join([*rows, f"5, 1.1, 14, 1{error}", f"5, 1.1, 15, 1{error}"]) + "\n"


@pytest.fixture
def said(tmp_path):
    """The sentences about a table."""

    def read(text):
        path = tmp_path / "data.csv"
        path.write_text(text)
        with pytest.raises(ConfigError) as error:
            measurements(path)
        return str(error.value).replace(f"{path}", "data.csv")

    return read


HEAD = "tilt_deg,displacement_mm,force_N\n"
MISTAKES = {
    "": "holds no table",
    HEAD: "holds no row",
    "tilt_deg;force_N\n3;5\n": "must be separated by commas",
    "tilt_deg,displacement_mm,force_kN\n3,1,1\n": "use 'force_N', in N",
    "tilt_deg,displacment_mm,force_N\n3,1,1\n": "use 'displacement_mm', in mm",
    "force_N\n3\n": "'force_N' needs the column 'tilt_deg'",
    "removal_error_um\n3\n": "nothing is measured",
    "Sku,removal_error_um\n3,1\n": "'removal_error_um' needs the column 'removal_um'",
    "Sku,Sku\n3,3\n": "'Sku' stands twice",
    "Sku,start_Sku\n3,3\n": "'start_Sku' needs the column 'start_Sq_nm'",
    "Sku,unstuck\n3,1\n": "'unstuck' needs the column 'force_N'",
    HEAD + "3,nan,5\n": "data.csv:2: displacement_mm is nan, must be a finite number",
    HEAD + "3,inf,5\n": "displacement_mm is inf, must be a finite number",
    HEAD + "3,0.5 mm,5\n": "displacement_mm is '0.5 mm', must be a number",
    HEAD + "3,0,5,5\n": "the row has 4 cells, the header names 3 columns",
    HEAD + "95,1,5\n": "tilt_deg is 95, must lie in (0, 45] °",
    HEAD + "3,,5\n": "force_N needs displacement_mm in its row",
    HEAD + "3,1,\n": "nothing is measured in this row",
    HEAD + "3,1,5\n3,2,9\n": "force_N is measured in 2 rows, must be in at least 4",
    "removal_um\n1\n1\n": "removal_um is measured in 2 rows, must be in at least 3",
    "Sku\n3\n3\n": "Sku is measured in 2 rows, must be in at least 4",
    "Ssk,Sku\n2,3\n": "Sku is 3, must be at least 1 + Ssk^2 = 5",
    "Sa_nm,Sq_nm\n2,1\n": "must not exceed Sq_nm",
    "Sku,Sku_error\n3,0.1\n3,\n": "Sku has Sku_error in 1 of 2 rows",
    "Sku,Sku_error\n3,0\n": "Sku_error is 0, must lie in (0, inf)",
}


@pytest.mark.parametrize("text", MISTAKES)
def test_a_mistake_in_a_table_is_a_sentence(said, text):
    assert MISTAKES[text] in said(text)


def test_two_points_with_errors_still_fit_any_springs(said):
    text = "tilt_deg,displacement_mm,force_N,force_error_N\n3,0.4,5,1\n3,0.6,9,1\n"
    assert "2 rows, must be in at least 3" in said(text)


def test_all_mistakes_are_told_at_once(said):
    told = said(HEAD + "95,1,5\n3,nan,5\n").splitlines()
    assert [line.split(": ")[0] for line in told] == ["data.csv:2", "data.csv:3"]


def test_units_of_a_table(tmp_path):
    path = tmp_path / "data.csv"
    path.write_text("spindle_rpm,removal_um,removal_error_um\n\n# why\n60, 2, 0.1\n")
    table = measurements(path)
    (row,) = table.rows
    assert row["spindle"] == pytest.approx(6.283185307)
    assert row["removal"] == pytest.approx(2e-3)
    assert row["removal_error"] == pytest.approx(1e-4)
    assert table.lines == (4,)
    assert table.runs == [row]


@pytest.mark.parametrize("arguments", [["--help"], [str(PLANE), "--data", "none.csv"]])
def test_help_and_bad_input_load_no_jax(arguments):
    code = (
        "import sys; from polishopt.calibrate import main\n"
        f"try: code = main({arguments!r})\n"
        "except SystemExit as end: code = end.code\n"
        "print('jax' in sys.modules, file=sys.stderr); sys.exit(code)"
    )
    ran = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    assert ran.returncode == (0 if arguments == ["--help"] else 2)
    assert ran.stderr.splitlines()[-1] == "False"
    if arguments == ["--help"]:
        assert "force_error_N" in ran.stdout
    else:
        assert "none.csv: there is no such file" in ran.stderr


def test_the_command_writes_constants_with_errors(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("POLISHOPT_CACHE", "off")
    data, target = tmp_path / "data.csv", tmp_path / "new" / "calibrated.yaml"
    data.write_text(forces())
    assert main([str(PLANE), "--data", str(data), "-o", str(target)]) == 0
    told = capsys.readouterr().out
    for expected in (
        "foundation",
        "stiffening",
        "data",
        "Student",
        "Unstick force",
        "14.5",
    ):
        assert expected in told
    text = target.read_text()
    assert "# S0 Table 1" in text, "comments are kept"
    written = load(target).config
    assert written.tool.foundation_N_mm3 == pytest.approx(0.25, rel=0.01)
    assert written.tool.stiffening_1_mm == pytest.approx(0.0, abs=0.02)
    assert written.tool.preset == "disc_18mm"
    assert written.tool.unstick is not None
    assert written.tool.unstick.force_N == (14.5,)
    assert set(written.errors) == {
        "tool.foundation_N_mm3",
        "tool.stiffening_1_mm",
        "tool.unstick.force_N[0]",
    }
    assert 0 < written.errors["tool.foundation_N_mm3"] < 0.005
    assert [path.name for path in target.parent.iterdir()] == [target.name]


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (forces(), "needs a measured texture"),
        ("Sku,Sku_error,start_Sq_nm,start_Ssk,start_Sku\n3,1,5,0,3\n", "must be left out"),
    ],
)
def test_a_start_that_cannot_be_free_is_a_sentence(tmp_path, capsys, text, sentence):
    data = tmp_path / "data.csv"
    data.write_text(text)
    arguments = [str(PLANE), "--data", str(data), "-o", str(tmp_path / "x.yaml")]
    assert main([*arguments, "--free-start"]) == 2
    assert sentence in capsys.readouterr().err
    assert main([*arguments[:-1], str(tmp_path)]) == 2
    assert "is a folder" in capsys.readouterr().err


def test_constants_go_into_any_config():
    """Also twice, over errors that are there, and in place of scratches of before."""
    loaded = load(PLANE)
    nan = float("nan")
    constants = [
        Constant("abrasive.preston_1_Pa", 1.23456789e-13, 4.5678e-15, "rests on data"),
        Constant("start.roughness.Sq_nm", 100.0, 3.0, "rests on data"),
        Constant("tool.unstick.force_N[0]", 9.0, nan, "data"),
    ]
    table = {"tilt_deg": [4.0], "force_N": [9.0]}
    text = calibrated(loaded, constants, table, PLANE.parent)
    again = check(text, PLANE)
    assert again.config.abrasive.preston_1_Pa == 1.23457e-13
    assert again.config.abrasive.grain_um == 15.3, "the preset fills the rest"
    assert again.config.start.roughness is not None
    assert again.config.start.roughness.Sq_nm == 100
    assert again.config.start.scratches is None
    assert again.config.errors == {
        "abrasive.preston_1_Pa": 4.57e-15,
        "start.roughness.Sq_nm": 3.0,
    }
    assert calibrated(again, constants, table, PLANE.parent).count("preston_1_Pa") == 2


@pytest.mark.parametrize(
    ("errors", "sentence"),
    [
        ("{tool.fundation_N_mm3: 0.01}", "must stand under a key of this config"),
        ("{tool.foundation_N_mm3: -1}", "must lie in (0, inf) N/mm³"),
        ("{tool.foundation_N_mm3: .nan}", "must be a finite number"),
        ("{process.passes: 1}", "must stand under a key of tool or abrasive"),
        ("{abrasive.asperity_stiffness_N_mm3: 1}", "must stand under a key that is given"),
    ],
)
def test_an_error_of_nothing_is_a_sentence(errors, sentence):
    with pytest.raises(ConfigError, match="errors") as error:
        load(PLANE, [f"errors={errors}"])
    assert sentence in str(error.value)
