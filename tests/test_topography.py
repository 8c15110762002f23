"""Surface files: heights keep every bit, and bad files are answered with one sentence."""

import contextlib
import hashlib
import io
import shutil
import struct
import sys
import zipfile

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import x3pio
from helpers import assert_close
from polishopt.chain import polish
from polishopt.files import measured
from polishopt.files.answered import optimum
from polishopt.files.assemble import job
from polishopt.files.config import load
from polishopt.files.topography import NoSurface, Topography, TopographyError, read, write
from test_config import GOOD


FORMATS = ("x3p", "sdf")
NAN = np.nan


def random_heights(shape, holes=0.0, seed=0):
    rng = np.random.default_rng(seed)
    heights = rng.normal(scale=3e-4, size=shape)
    heights[rng.random(shape) < holes] = NAN
    return heights


MAPS = {
    "square": random_heights((40, 40)),
    "tall": random_heights((31, 7)),
    "holed": random_heights((30, 50), holes=0.2),
    "one row": random_heights((1, 200)),
    "one column": random_heights((9, 1)),
    "one point": np.array([[1.2345e-3]]),
    "huge and tiny": np.array([[900.0, 1e-300, -0.0, 5e-9]]),
}


# writing and reading


@pytest.mark.parametrize("kind", FORMATS)
@pytest.mark.parametrize("heights", MAPS.values(), ids=MAPS)
def test_heights_come_back_to_the_last_bit(tmp_path, heights, kind):
    """float64 as 64 bits, also where the metres of the file are not a round thousandth."""
    first = Topography(heights, (1.3e-3, 0.7e-3), "a title")
    path = tmp_path / f"surface.{kind}"
    write(path, first)
    again = read(path)
    np.testing.assert_array_equal(again.heights, first.heights)
    assert again.spacing == first.spacing
    assert again.title == "a title"
    # what was given is held to its last digit
    np.testing.assert_allclose(first.heights, heights, rtol=2.0**-51, atol=0)
    assert [one.name for one in tmp_path.iterdir()] == [path.name], "no half file is left"


def test_heights_are_moved_once_and_by_no_more_than_their_last_digit():
    """Where a thousandth, rounded, does not come back, a second time changes nothing."""
    given = random_heights((300, 300), seed=1)
    held = Topography(given, (1e-3, 1e-3)).heights
    moved = held != given
    assert 0.01 < moved.mean() < 0.04
    assert (np.abs(held - given) <= np.spacing(np.abs(given))).all()
    np.testing.assert_array_equal(Topography(held, (1e-3, 1e-3)).heights, held)
    np.testing.assert_array_equal(held / 1000 * 1000, held)


UNEQUAL = pytest.mark.filterwarnings("ignore:The surface has different pixel size")


@UNEQUAL
@pytest.mark.parametrize("kind", FORMATS)
@pytest.mark.parametrize("name", ["tall", "holed", "square"])
def test_surfalize_reads_the_same_array(tmp_path, name, kind):
    """Rows in the same order, µm as surfalize shows them, steps in x and y not swapped."""
    surfalize = pytest.importorskip("surfalize", reason="GPL: an oracle of tests only")
    path = tmp_path / f"surface.{kind}"
    write(path, Topography(MAPS[name], (1.3e-3, 0.7e-3)))
    other = surfalize.Surface.load(path)
    ours = read(path)
    np.testing.assert_allclose(other.data, ours.heights * 1e3, rtol=1e-15, atol=0)
    assert_close(other.step_y, ours.spacing[0] * 1e3, rtol=1e-14)
    assert_close(other.step_x, ours.spacing[1] * 1e3, rtol=1e-14)


@UNEQUAL
@pytest.mark.parametrize("kind", FORMATS)
def test_a_file_of_surfalize_is_read_as_it_was_meant(tmp_path, kind):
    surfalize = pytest.importorskip("surfalize", reason="GPL: an oracle of tests only")
    path = tmp_path / f"theirs.{kind}"
    theirs = surfalize.Surface(MAPS["tall"] * 1e3, 0.7, 1.3)  # µm, along x, along y
    theirs.save(path)
    ours = read(path)
    np.testing.assert_allclose(ours.heights, MAPS["tall"], rtol=1e-12)
    assert_close(np.array(ours.spacing), np.array([1.3e-3, 0.7e-3]), rtol=1e-12)


def test_an_x3p_file_is_of_the_revision_that_the_most_programs_read(tmp_path):
    path = tmp_path / "surface.X3P"
    write(path, Topography(MAPS["tall"], (1e-3, 1e-3)))
    about = x3pio.info(path)
    assert about.revision is x3pio.Revision.ISO5436_2000
    assert about.header.z.increment == 1.0, "metres as such: some programs pass over this"
    assert about.metadata is not None
    assert about.metadata.instrument.manufacturer == "polishopt"


def test_a_profile_is_a_surface_of_one_row(tmp_path):
    x3pio.write(tmp_path / "profile.x3p", np.arange(5) * 1e-6, x_scale=2e-6)
    profile = read(tmp_path / "profile.x3p")
    np.testing.assert_allclose(profile.heights, np.arange(5)[None, :] * 1e-3)
    assert profile.spacing == pytest.approx((2e-3, 2e-3))


@pytest.mark.parametrize("kind", FORMATS)
def test_integer_heights_with_holes_are_read(tmp_path, kind):
    """As instruments write them: 16 bits, a scale, and a mark for what was not measured."""
    heights = np.array([[0.0, 1e-6, NAN], [-2e-6, 3e-6, 4e-6]])
    path = tmp_path / f"surface.{kind}"
    if kind == "x3p":
        x3pio.write(path, heights, x_scale=1e-6, y_scale=2e-6, z_type=x3pio.DataType.INT16)
    else:
        sdfio = pytest.importorskip("sdfio")
        kinds = sdfio.Metadata(data_type=sdfio.DataType.INT16)
        text = sdfio.FileFormat.ASCII
        sdfio.write(path, heights, x_scale=1e-6, y_scale=2e-6, metadata=kinds, format=text)
    ours = read(path)
    np.testing.assert_allclose(ours.heights, heights * 1e3, atol=1e-7)
    assert ours.spacing == pytest.approx((2e-3, 1e-3))


# bad files: SDF


def sdf(columns=4, rows=3, dx=1e-6, counts="<HH", floats="<d", heights=None):
    """A binary SDF file, as the standard lays it out, with freely chosen claims."""
    head = b"bISO-1.0" + b"test".ljust(10) + b"010120261200" * 2
    scales = (dx, 1e-6, 1.0, -1.0)
    data = np.arange(12) * 1e-7 if heights is None else heights
    return b"".join(
        [
            head,
            struct.pack(counts, columns, rows),
            *(struct.pack(floats, value) for value in scales),
            bytes([0, 7, 0]),
            np.asarray(data, dtype="f8").astype(floats.replace("d", "f8")).tobytes(),
        ]
    )


TEXT_SDF = (
    b"aISO-1.0\r\nManufacID = x\r\nCreateDate = 010120261200\r\nModDate = 010120261200\r\n"
    b"NumPoints = 1000000000\r\nNumProfiles = 1000000000\r\nXscale = 1e-6\r\n"
    b"Yscale = 1e-6\r\nZscale = 1\r\nZresolution = -1\r\nCompression = 0\r\n"
    b"DataType = 7\r\nCheckType = 0\r\n*\r\n1 2 3\r\n*\r\n*\r\n"
)
BAD_SDF = {
    "empty": (b"", "Not an SDF file"),
    "cut in the header": (sdf()[:50], "too short to contain an SDF header"),
    "cut in the heights": (sdf()[:-5], "Unexpected end of file"),
    "huge header": (
        sdf().replace(b"ISO-1.0", b"ISO-2.0")[:42] + struct.pack("<II", 10**9, 10**9),
        "Not",
    ),
    "huge text header": (TEXT_SDF, "Expected 1000000000000000000 data values, found 3"),
    "other byte order": (sdf(counts=">HH", floats=">d"), "claims 1024 x 768 points"),
    "heights in other byte order": (
        sdf(heights=(np.arange(12) * 1e-7).byteswap()),
        "must span at most 1000 mm; are unit and byte order right?",
    ),
    "garbage": (bytes(range(256)) * 4, "Not an SDF file"),
    "zero points": (sdf(columns=0), "holds 0 x 3 points, must hold at least one"),
    "no spacing": (sdf(dx=0.0), "has points 0 mm apart along x, must lie in (0, 10000] mm"),
    "negative spacing": (sdf(dx=-1e-6), "has points -0.001 mm apart along x"),
    "spacing is not a number": (sdf(dx=NAN), "has points nan mm apart along x"),
    "all NaN": (sdf(heights=np.full(12, NAN)), "has no measured point among 12"),
}
BAD_SDF["huge header"] = (
    BAD_SDF["huge header"][0] + sdf()[46:],
    "claims 1000000000 x 1000000000 points in its 181 bytes",
)


def sentence(path):
    with pytest.raises(TopographyError) as caught:
        read(path)
    told = str(caught.value)
    assert told.startswith(f"{path}: ")
    assert "\n" not in told
    return told


@pytest.mark.parametrize(("content", "said"), BAD_SDF.values(), ids=BAD_SDF)
def test_a_bad_sdf_file_is_one_sentence(tmp_path, content, said):
    path = tmp_path / "bad.sdf"
    path.write_bytes(content)
    assert said in sentence(path)


def test_the_sdf_file_that_the_bad_ones_are_made_of_is_good(tmp_path):
    path = tmp_path / "good.sdf"
    path.write_bytes(sdf())
    assert read(path).heights.shape == (3, 4)
    assert read(path).spacing == pytest.approx((1e-3, 1e-3))


# bad files: x3p


def x3p(changes=(), heights=None, **members):
    """An x3p file whose main.xml, with a right checksum, claims something else."""
    buffer = io.BytesIO()
    values = np.arange(12).reshape(3, 4) * 1e-7 if heights is None else heights
    x3pio.write(buffer, values, x_scale=1e-6, y_scale=2e-6)
    with zipfile.ZipFile(buffer) as archive:
        held = {name: archive.read(name) for name in archive.namelist()}
    main = held["main.xml"]
    for old, new in changes:
        assert old in main
        main = main.replace(old, new)
    if "data" in members:
        before = hashlib.md5(held["bindata/data.bin"]).hexdigest()
        after = hashlib.md5(members["data"]).hexdigest()
        main = main.replace(before.encode(), after.encode())
        held["bindata/data.bin"] = members["data"]
    held["main.xml"] = main
    held["md5checksum.hex"] = f"{hashlib.md5(main).hexdigest()} *main.xml".encode()
    result = io.BytesIO()
    with zipfile.ZipFile(result, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in held.items():
            archive.writestr(name, content)
    return result.getvalue()


HUGE = [
    (b"<SizeX>4<", b"<SizeX>1000000000<"),
    (b"<SizeY>3<", b"<SizeY>1000000000<"),
]
BAD_X3P = {
    "empty": (b"", "not a zip archive"),
    "cut": (x3p()[:-30], "not a zip archive"),
    "garbage": (bytes(range(256)) * 4, "not a zip archive"),
    "huge header": (x3p(HUGE), "need 8000000000000000000"),
    "unequal sizes": (x3p([(b"<SizeX>4<", b"<SizeX>5<")]), "holds 96 bytes, but"),
    "zero points": (
        x3p([(b"<SizeX>4<", b"<SizeX>0<")], data=b""),
        "0",
    ),
    "no spacing": (
        x3p([(b"<Increment>2e-06<", b"<Increment>0<")]),
        "Increment must not be zero",
    ),
    "negative spacing": (
        x3p([(b"<Increment>1e-06<", b"<Increment>-1e-06<")]),
        "has points -0.001 mm apart along x",
    ),
    "all NaN": (x3p(heights=np.full((3, 4), NAN)), "has no measured point among 12"),
    "other byte order": (
        x3p(data=(np.arange(12) * 1e-7).byteswap().tobytes()),
        "are unit and byte order right?",
    ),
    "two layers": (x3p(heights=np.zeros((2, 3, 4))), "holds 2 layers, must hold one"),
    "entities that multiply": (
        x3p([(b"?>", b'?><!DOCTYPE a [<!ENTITY a "a"><!ENTITY b "&a;&a;">]>')]),
        "not valid XML",
    ),
}


@pytest.mark.parametrize(("content", "said"), BAD_X3P.values(), ids=BAD_X3P)
def test_a_bad_x3p_file_is_one_sentence(tmp_path, content, said):
    path = tmp_path / "bad.x3p"
    path.write_bytes(content)
    assert said in sentence(path)


def test_a_file_that_unpacks_to_too_much_is_not_unpacked(tmp_path, monkeypatch):
    from polishopt.files import surface_formats

    path = tmp_path / "bomb.x3p"
    path.write_bytes(x3p(data=bytes(3_000_000)))
    assert path.stat().st_size < 10_000
    monkeypatch.setattr(surface_formats, "MOST_BYTES", 2_000_000)
    monkeypatch.setattr(x3pio, "read", lambda path: pytest.fail("it was unpacked"))
    assert "unpacks to 3 MB, must be at most 2 MB" in sentence(path)


def test_bytes_in_any_state_of_decay_are_a_sentence(tmp_path):
    """Every cut and many flipped bytes: an error of the right type, or a surface."""
    rng = np.random.default_rng(3)
    for kind, content in (("sdf", sdf()), ("x3p", x3p())):
        path = tmp_path / f"bad.{kind}"
        for trial in range(150):
            broken = bytearray(
                content[: rng.integers(len(content))] if trial % 2 else content
            )
            for place in rng.integers(max(len(broken), 1), size=3 if broken else 0):
                broken[place] = rng.integers(256)
            path.write_bytes(bytes(broken))
            with contextlib.suppress(TopographyError):
                assert read(path).heights.size


# other bad requests


@pytest.mark.parametrize("kind", ["x3p", "sdf", "plu"])
def test_a_missing_file_and_a_folder_are_sentences(tmp_path, kind):
    assert sentence(tmp_path / f"none.{kind}").endswith("there is no such file")
    (tmp_path / f"folder.{kind}").mkdir()
    assert "is a folder" in sentence(tmp_path / f"folder.{kind}")


def test_other_formats_say_which_package_reads_them(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "SurfaceTopography", None)
    path = tmp_path / "surface.plu"
    path.write_bytes(b"x")
    told = sentence(path)
    assert "ends in '.plu', must end in '.x3p' or '.sdf'" in told
    assert "pip install 'polishopt[metrology]'" in told


def test_other_formats_are_read_by_surfacetopography(tmp_path):
    """By a copy of an x3p file whose suffix we do not know."""
    pytest.importorskip("SurfaceTopography", reason="the optional extra `metrology`")
    write(tmp_path / "surface.x3p", Topography(MAPS["holed"], (1.3e-3, 0.7e-3)))
    shutil.copy(tmp_path / "surface.x3p", tmp_path / "surface.sur")
    other = read(tmp_path / "surface.sur")
    np.testing.assert_allclose(other.heights, MAPS["holed"], rtol=1e-14)
    assert other.spacing == pytest.approx((1.3e-3, 0.7e-3))


def test_what_cannot_be_written_is_said(tmp_path):
    surface = Topography(MAPS["tall"], (1e-3, 1e-3))
    with pytest.raises(TopographyError, match="ends in '.txt', must end in '.x3p' or"):
        write(tmp_path / "surface.txt", surface)
    with pytest.raises(TopographyError, match="cannot be written: No such file"):
        write(tmp_path / "none" / "surface.x3p", surface)
    assert not list(tmp_path.iterdir())


def test_a_topography_has_rows_and_columns():
    with pytest.raises(NoSurface, match=r"shape \(3,\), must hold rows and columns"):
        Topography(np.zeros(3), (1.0, 1.0))


# a measured start surface


def test_a_plane_is_taken_out_and_nothing_else():
    y, x = np.mgrid[:9, :12].astype(float)
    rough = random_heights((9, 12))
    rough[2, 3] = NAN
    level = measured.without_plane(rough + 0.3 + 0.02 * x - 0.05 * y)
    for weight in (np.ones_like(x), x, y):
        assert abs(np.nansum(level * weight)) < 1e-11
    # what a least-squares plane leaves does not depend on the plane that was added
    np.testing.assert_allclose(level, measured.without_plane(rough), atol=1e-14)
    np.testing.assert_allclose(measured.without_plane(np.full((1, 5), 2.0)), 0, atol=1e-15)


def test_holes_are_filled_by_the_smoothest_surface():
    """A harmonic surface, the sum of x^2 - y^2, xy and a plane, is filled exactly."""
    y, x = np.mgrid[:30, :40] / 10.0
    harmonic = x**2 - y**2 + 0.5 * x * y + x - 3
    holed = harmonic.copy()
    holed[4:9, 5:25] = NAN
    holed[20, 20] = NAN
    np.testing.assert_allclose(measured.filled(holed), harmonic, atol=1e-13)
    # at the border, where nothing pulls, the slope across it is zero
    corner = np.ones((5, 5))
    corner[:2, :2] = NAN
    np.testing.assert_allclose(measured.filled(corner), 1.0, atol=1e-14)


def start_surface(path, shape=(40, 50), holes=0.0):
    heights = random_heights(shape, holes)
    x = np.arange(shape[1])
    write(path, Topography(heights + 1e-3 * np.sin(x / 5) + 0.02 * x, (2e-3, 3e-3)))
    return path


def test_a_start_map_has_the_heights_of_the_measurement(tmp_path):
    path = start_surface(tmp_path / "surface.sdf")
    start = measured.start_map(str(path), 64)
    level = measured.without_plane(read(path).heights)
    assert start.heights.shape == (80, 100)
    assert start.spacing == read(path).spacing
    np.testing.assert_array_equal(start.heights[:40, :50], level)
    # periodic without a jump: neighbours across the border are the same point
    for axis in (0, 1):
        first, last = np.take(start.heights, 0, axis), np.take(start.heights, -1, axis)
        np.testing.assert_array_equal(first, last)
    np.testing.assert_array_equal(
        np.sort(start.heights.ravel())[::4], np.sort(level.ravel())
    )


def test_a_large_map_is_thinned_evenly(tmp_path):
    path = start_surface(tmp_path / "surface.x3p", (40, 100), holes=0.02)
    thin, spacing, said = measured.sample(str(path), 32)
    level = measured.without_plane(read(path).heights)
    np.testing.assert_array_equal(thin, level[::2, 1::4])
    assert spacing == pytest.approx((4e-3, 12e-3))
    holes = np.isnan(thin).sum()
    assert said == (
        "100 x 40 points on 0.3 x 0.08 mm, plane taken out, thinned to 25 x 20 points, "
        f"{holes} of them filled, mirrored"
    )


@pytest.mark.parametrize(
    ("shape", "holes", "said"),
    [
        ((8, 50), 0.0, "holds 50 x 8 points, a start surface must have at least 16"),
        ((40, 50), 0.3, "of its points, a start surface may lack at most 10%"),
    ],
)
def test_too_small_or_too_holed_a_start_is_a_sentence(tmp_path, shape, holes, said):
    path = start_surface(tmp_path / "surface.sdf", shape, holes)
    with pytest.raises(TopographyError, match=said):
        measured.sample(str(path), 64)


CONFIG = GOOD.replace("scratches: {abrasive: P600, pressure_MPa: 0.05}", "file: in/a.x3p")
CONFIG = CONFIG.replace("[50, 40]", "[50, 50]").replace("sphere_cap", "plane")
CONFIG = CONFIG.replace("  radius_mm: 100\n", "")


@pytest.fixture
def with_start(tmp_path):
    """A config beside a folder with its start surface."""
    (tmp_path / "in").mkdir()
    start_surface(tmp_path / "in" / "a.x3p")
    (tmp_path / "job.yaml").write_text(CONFIG)
    return tmp_path / "job.yaml"


def test_a_measured_start_runs_through_the_chain(with_start, monkeypatch, tmp_path_factory):
    """From any folder: the path of the surface starts at the config."""
    monkeypatch.chdir(tmp_path_factory.mktemp("elsewhere"))
    loaded = load(with_start, ["guide.order=1", "sampling.start_points=16"])
    assert loaded.measured.startswith("in/a.x3p: 50 x 40 points on 0.15 x 0.08 mm")
    ready = job(loaded.config)
    heights = ready.setup.start.heights
    assert heights is not None
    assert heights.shape == (26, 26)  # every 3rd of 40, every 4th of 50, mirrored
    assert_close(ready.setup.start.spacing, np.array([6e-3, 12e-3]))

    @eqx.filter_jit
    def finished(process, setup):
        result = polish(process, setup)
        return result.parts[0], jnp.stack([result.Ssk, result.Sku])

    rest, texture = finished(ready.process, ready.setup)
    before = jnp.var(heights)
    assert 0 < float(rest.k2) < float(before), "polished, not gone"
    assert np.isfinite(texture).all()


def test_an_answer_elsewhere_still_finds_its_start_surface(with_start, tmp_path):
    folder = tmp_path / "runs" / "one"
    folder.mkdir(parents=True)
    loaded = load(with_start)
    (folder / "optimum.yaml").write_text(optimum(loaded, {"tilt_deg": 4.0}, folder))
    again = load(folder / "optimum.yaml")
    assert again.measured.startswith("../../in/a.x3p: 50 x 40 points")
    assert job(again.config).setup.start.heights is not None
    assert "file: in/a.x3p" in optimum(loaded, {}), "in place, the path stays as typed"


def test_a_bad_start_surface_is_told_with_its_line(with_start):
    (with_start.parent / "in" / "a.x3p").write_bytes(x3p(HUGE))
    with pytest.raises(ValueError, match="need 8000000000000000000") as caught:
        load(with_start)
    assert str(caught.value).startswith(f"{with_start}:20:9: start.file: ")
