"""NC code: what is read back is what was written, in every language."""

import dataclasses
import re
import shutil
import subprocess
from typing import get_args

import numpy as np
import pytest
from polishopt.files.ncode import DIALECTS, Header, Motion, Printed, ProgramError
from polishopt.files.programmed import ALL, Language


NASTY = "µm & 25 °: (a; b) 50 %\n[é] / " + "long " * 40
HEADER = Header(
    name="polish",
    number=1000,
    notes=(("title", NASTY), ("units", "mm, deg, mm/min"), ("title", "S2000 M4 T9")),
    tool=7,
    spindle=1834.567,
    clockwise=False,
    offset=2,
    rotary=("A", "C"),
    tolerance=0.01,
)
VECTORS = {"apt", "csv", "siemens_vector", "heidenhain_m128", "fanuc_g43_5"}


def motion(decimals, n=300):
    """Two approaches, moves that repeat words and whole poses, large and tiny numbers."""
    rng = np.random.default_rng(5)
    rapid = np.isin(np.arange(n), (0, 150))
    tip = np.cumsum(rng.normal(0, 0.3, (n, 3)), axis=0)
    tip[20:40, 2] = -0.00001
    axis = rng.normal(0, 0.1, (n, 3)) + [0, 0, 1]
    axis /= np.linalg.norm(axis, axis=1)[:, None]
    linear, rotary = 3.0 * tip + 7.0, np.cumsum(rng.normal(0, 40, (n, 2)), axis=0)
    rotary[50:70, 0] = 3.0
    for one in (tip, axis, linear, rotary):
        one[100:103] = one[99]
    seconds, feed = rng.uniform(0.01, 0.1, n), rng.uniform(200, 1200, n)
    feed[60:90] = 1000.0
    seconds[rapid] = feed[rapid] = np.nan
    feed[95], seconds[96] = 0.001, 1e-9
    return Motion(rapid, tip, axis, linear, rotary, feed, seconds).rounded(decimals)


@pytest.mark.parametrize(("decimals", "letters"), [(3, "AC"), (4, "BC"), (6, "AB")])
@pytest.mark.parametrize("name", DIALECTS)
def test_what_is_read_is_what_was_written(name, decimals, letters):
    written = motion(decimals)
    text = DIALECTS[name].write(
        Printed(written, decimals), dataclasses.replace(HEADER, rotary=tuple(letters))
    )
    found = DIALECTS[name].read(text)
    np.testing.assert_array_equal(found.rapid, written.rapid)
    for field in ("tip", "axis", "linear", "rotary", "feed"):
        read = getattr(found, field)
        if read is not None:
            np.testing.assert_array_equal(read, getattr(written, field), err_msg=field)
    assert (found.axis is not None) == (name in VECTORS)
    if name == "linuxcnc":
        assert found.tip is None
        assert found.linear is not None
        assert found.feed is None
        assert found.seconds is not None
        rate = np.round(60.0 / written.seconds, 4)
        np.testing.assert_allclose(60.0 / found.seconds, rate, rtol=1e-14)
    spindle = 1835.0 if name.startswith("fanuc") else 1834.567
    assert (found.tool, found.spindle) == (7, spindle)
    assert (found.clockwise, found.offset) == (False, 2)


@pytest.mark.parametrize("name", DIALECTS)
def test_a_program_is_text_that_every_control_can_hold(name):
    text = DIALECTS[name].write(Printed(motion(4), 4), HEADER)
    assert text.isascii()
    assert text.endswith("\n")
    assert "nan" not in text
    assert re.search(r"-0\.0+\b", text) is None, "a negative nothing"
    assert max(map(len, text.splitlines())) <= 128
    noted = " ".join(DIALECTS[name].read(text).notes).lower()
    for word in ("title: um & 25 deg", "units: mm, deg, mm/min"):
        assert word.lower() in noted
    if name.startswith("fanuc"):
        comments = [line for line in text.splitlines() if "(" in line]
        assert all(line.count("(") == line.count(")") == 1 for line in comments)
        assert all(line == line.upper() for line in comments)
    if name.startswith("heidenhain"):
        numbers = [line.split()[0] for line in text.splitlines() if line[0] != " "]
        assert numbers == [str(i) for i in range(len(numbers))]


@pytest.mark.parametrize(
    ("name", "word"),
    [
        ("apt", "MULTAX/ON"),
        ("siemens_vector", "TRAORI ORIWKS COMPCURV A3= B3= C3= G710 G55"),
        ("siemens_angles", "TRAORI ORIMKS COMPCURV A= C= G710 G55"),
        ("heidenhain_tcpm", "FUNCTION TCPM F TCP Q339=+2 FMAX"),
        ("heidenhain_m128", "LN M128 M129 TX TY TZ Q339=+2"),
        ("fanuc_g43_4", "G43.4 H7 G49 G21 G55"),
        ("fanuc_g43_5", "G43.5 H7 G49 G21 G55 I J K"),
        ("linuxcnc", "G93 G64 G43 G21 G55"),
    ],
)
def test_a_program_has_the_words_of_its_control(name, word):
    text = DIALECTS[name].write(Printed(motion(4), 4), HEADER)
    assert not [one for one in word.split() if one not in text]


def test_words_that_repeat_are_left_out():
    """Rows 20 to 39 have the same z, rows 50 to 69 the same A."""
    text = DIALECTS["siemens_angles"].write(Printed(motion(4), 4), HEADER)
    rows = [line for line in text.splitlines() if re.search(r"\bX|\bY|\bZ", line)]
    assert len(rows) == 300
    assert not any("Z" in row for row in rows[21:40])
    assert not any("A=" in row for row in rows[51:70])
    assert not any("F" in row for row in rows[61:90])
    # a pose that repeats as a whole keeps one word
    assert all(re.fullmatch(r"X\S+( F\S+)?", row) for row in rows[100:103])


# what is wrong with a program, by language: a piece of it and what stands there instead
WRONGS = [
    ("apt", "MULTAX/ON", "MULTAX/OFF", "MULTAX/OFF"),
    ("apt", ",MMPM", ",IPM", "FEDRAT"),
    ("siemens_vector", "TRAORI", "TRAANG", "TRAANG"),
    ("siemens_vector", "TRAORI\n", "", "without TRAORI"),
    ("siemens_angles", "ORIMKS\n", "", "without ORIMKS"),
    ("siemens_angles", "G710", "G700", "G700"),
    ("heidenhain_tcpm", " FMAX", " FMIN", "FMIN"),
    ("heidenhain_m128", "L M128", "L M120", "M120"),
    ("heidenhain_tcpm", "\n12 ", "\n13 ", "block 13"),
    ("fanuc_g43_4", "G43.4", "G43.1", "G43.1"),
    ("fanuc_g43_5", "G43.5", "G43", "G43"),
    ("linuxcnc", "G93 G1", "G94 G1", "without G93"),
    ("linuxcnc", "G90", "G91", "G91"),
    ("linuxcnc", "G0 X", "G0 Q", "lacks X"),
]


@pytest.mark.parametrize(("name", "piece", "instead", "said"), WRONGS)
def test_a_reader_refuses_what_it_does_not_know(name, piece, instead, said):
    text = DIALECTS[name].write(Printed(motion(4), 4), HEADER)
    assert piece in text
    with pytest.raises(ProgramError, match=re.escape(said)) as error:
        DIALECTS[name].read(text.replace(piece, instead, 1))
    assert re.match(r"line \d+: ", str(error.value))


@pytest.mark.parametrize("name", DIALECTS)
def test_a_changed_digit_is_seen(name):
    """The comparison above can fail."""
    written = motion(4)
    text = DIALECTS[name].write(Printed(written, 4), HEADER)
    lines = text.splitlines(keepends=True)
    for row in (len(lines) // 2, len(lines) // 2 + 1):
        last = re.compile(r"\d(?=\D*$)")
        lines[row] = last.sub(lambda digit: str((int(digit[0]) + 1) % 10), lines[row])
    found = DIALECTS[name].read("".join(lines))
    names = ("tip", "axis", "linear", "rotary", "feed")
    pairs = [(getattr(found, n), getattr(written, n)) for n in names]
    if name == "csv":
        pairs.append((found.seconds, written.seconds))
    if name == "linuxcnc":
        assert found.seconds is not None
        pairs.append((60.0 / found.seconds, np.round(60.0 / written.seconds, 4)))
    assert not all(np.allclose(a, b, 1e-13, 0, True) for a, b in pairs if a is not None)


def test_the_config_knows_the_same_languages():
    assert set(get_args(Language)) == set(ALL) == set(DIALECTS)
    endings = [one.ending for one in DIALECTS.values()]
    assert len(set(endings)) == len(endings)


def canonical(path, folder):
    """Where LinuxCNC's own interpreter goes: X Y Z A B C of every move."""
    table = "".join(f"T{n} P{n} Z0 D18.0 ;disc\n" for n in range(1, 10))
    (folder / "tool.tbl").write_text(table)
    (folder / "par.var").write_text("")
    given = ["-t", folder / "tool.tbl", "-v", folder / "par.var", "-g", path]
    ran = subprocess.run(
        ["rs274", *map(str, given)], capture_output=True, text=True, check=False
    )
    assert ran.returncode == 0, ran.stderr
    moves = re.findall(r"STRAIGHT_(?:FEED|TRAVERSE)\((.*?)\)", ran.stdout)
    return np.array([[float(x) for x in move.split(",")] for move in moves])


@pytest.mark.skipif(not shutil.which("rs274"), reason="needs rs274 of linuxcnc-uspace")
def test_linuxcnc_goes_where_it_is_told(tmp_path):
    written = motion(4)
    path = tmp_path / "polish.ngc"
    path.write_text(DIALECTS["linuxcnc"].write(Printed(written, 4), HEADER))
    found = canonical(path, tmp_path)
    np.testing.assert_allclose(found[:, :3], written.linear, rtol=0, atol=1e-4)
    np.testing.assert_allclose(found[:, [3, 5]], written.rotary, rtol=0, atol=1e-4)
    assert not found[:, 4].any()


def test_an_interpreter_of_sinumerik_reads_the_angles():
    reader = pytest.importorskip("nc_gcode_interpreter")
    if not hasattr(reader, "nc_to_rows"):
        pytest.skip("needs nc-gcode-interpreter 0.2 or newer")
    written = motion(4)
    text = DIALECTS["siemens_angles"].write(Printed(written, 4), HEADER)
    table, _ = reader.nc_to_dataframe(text, extra_axes=["A", "C"])
    rows = table.filter(table["gg30_nc_compress"] == "COMPCURV")
    rows = rows.filter(rows["X"].is_not_null())[:300]
    assert set(rows["gg25_tool_orient_ref"]) == {"ORIMKS"}
    for column, values in zip("XYZ", written.tip.T, strict=True):
        np.testing.assert_array_equal(rows[column].to_numpy(), values)
    for column, values in zip("AC", written.rotary.T, strict=True):
        np.testing.assert_array_equal(rows[column].to_numpy(), values)
