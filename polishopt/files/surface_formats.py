"""Surface formats: the bytes of x3p, SDF and other surface files, by way of their packages.

Before a package allocates what a file claims to hold, the claim is compared with the size
of the file.
"""

import io
import struct
import zipfile
from importlib.metadata import version
from pathlib import Path

import numpy as np
import sdfio
import x3pio

from .topography import MILLIMETRES, MOST_POINTS, Topography, TopographyError


# Text takes far more memory than its bytes while it is parsed.
MOST_TEXT = 64 * 2**20
MOST_BYTES = 16 * MOST_POINTS
# Binary SDF: where the numbers of points along x and y stand, and how, by version.
SDF_COUNTS = 42
SDF_COUNT_FORMATS = {b"ISO-1.0": "<HH", b"BCR-1.0": "<HH", b"ISO-2.0": "<II"}


def read_x3p(path: Path) -> Topography:
    """The surface in an x3p file (ISO 25178-72)."""
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
        _fits(path, sum(member.file_size for member in members), False, "unpacks to")
        for member in members:
            if member.filename.lower().endswith(".xml"):
                _fits(path, member.file_size, True, f"unpacks '{member.filename}' to")
    file = x3pio.read(path)
    if isinstance(file, x3pio.PointCloud):
        raise TopographyError(path, "holds a cloud of points, must hold a surface")
    if len(file.layers) != 1:
        raise TopographyError(
            path, f"holds {len(file.layers)} layers, must hold one surface"
        )
    layer = file.layers[0]
    if not layer.is_regular_grid:
        raise TopographyError(path, "holds an irregular grid, must hold a regular one")
    if isinstance(layer, x3pio.SurfaceLayer):
        dx, dy = layer.spacing
    else:
        dx = dy = layer.header.x.increment  # a profile: one row
    about, instrument = file.metadata, ""
    if about is not None:
        made = about.instrument
        instrument = " ".join(filter(None, dict.fromkeys((made.manufacturer, made.model))))
    return Topography(
        _in_millimetres(np.atleast_2d(layer.z)),
        (dy * MILLIMETRES, dx * MILLIMETRES),
        (about.comment or "").strip() if about else "",
        instrument,
    )


def x3p_bytes(topography: Topography) -> bytes:
    """A topography as the content of an x3p file."""
    metadata = x3pio.Metadata.for_software("polishopt", version("polishopt"))
    metadata.comment = topography.title
    dy, dx = (step / MILLIMETRES for step in topography.spacing)
    return x3pio.Surface.from_array(
        topography.heights / MILLIMETRES,
        x_scale=dx,
        y_scale=dy,
        metadata=metadata,
        revision=x3pio.Revision.ISO5436_2000,
    ).dumps()


def read_sdf(path: Path) -> Topography:
    """The surface in an SDF file (ISO 25178-71), binary or text."""
    with path.open("rb") as stream:
        start = stream.read(64)
        size = stream.seek(0, io.SEEK_END)
    text = start[:1].lower() != b"b"
    _fits(path, size, text, "has")
    layout = SDF_COUNT_FORMATS.get(start[1:8])
    if layout and not text and len(start) == 64:
        columns, rows = struct.unpack_from(layout, start, SDF_COUNTS)
        if columns * rows > size:
            sentence = (
                f"claims {columns} x {rows} points in its {size} bytes, must hold them; "
                "it is cut off, or its bytes are in another order"
            )
            raise TopographyError(path, sentence)
    file = sdfio.read(path)
    fields = file.trailer_fields
    title = next((fields[name] for name in fields if name.lower() == "title"), "")
    header = file.header
    return Topography(
        _in_millimetres(file.data),
        (header.y_scale * MILLIMETRES, header.x_scale * MILLIMETRES),
        title,
        header.manufacturer_id,
    )


def sdf_bytes(topography: Topography) -> bytes:
    """A topography as the content of a binary SDF file."""
    dy, dx = (step / MILLIMETRES for step in topography.spacing)
    words = " ".join(topography.title.split())
    title = words.encode("ascii", errors="replace").decode("ascii")
    most = sdfio.Revision.ISO_1_0.rules.max_binary_count
    wide = max(topography.heights.shape) > most
    revision = sdfio.Revision.ISO_2_0 if wide else sdfio.Revision.ISO_1_0
    return sdfio.SdfFile.from_array(
        topography.heights / MILLIMETRES,
        x_scale=dx,
        y_scale=dy,
        metadata=sdfio.Metadata(revision=revision, manufacturer_id="polishopt"),
        trailer=sdfio.format_tagged_fields({"Title": title}) if title else "",
    ).dumps()


def read_other(path: Path) -> Topography:
    """The surface in a file of an instrument maker, by way of SurfaceTopography."""
    if not path.exists():
        raise FileNotFoundError(path)
    kind = path.suffix.lower()
    ends = f"ends in '{kind}'" if kind else "has no suffix"
    try:
        from SurfaceTopography import open_topography
    except ImportError:
        sentence = (
            f"{ends}, must end in '.x3p' or '.sdf'; other formats need the "
            "package SurfaceTopography: pip install 'polishopt[metrology]'"
        )
        raise TopographyError(path, sentence) from None
    try:
        with open_topography(str(path)) as file:
            surface = file.topography()
    except Exception:
        # it lists what every one of its forty readers had to say
        sentence = "is in no format that SurfaceTopography reads, or damaged"
        raise TopographyError(path, sentence) from None
    if surface.dim != 2 or not surface.is_uniform:
        raise TopographyError(path, "holds no surface on a regular grid")
    if surface.unit is None:
        raise TopographyError(path, "does not say its unit of length, which it must")
    surface = surface.to_unit("mm")
    # it keeps x along the first axis
    heights = np.ma.filled(np.ma.asarray(surface.heights(), dtype=float), np.nan).T
    dx, dy = surface.pixel_size
    maker = surface.info.get("instrument", {}).get("name", "")
    return Topography(heights, (float(dy), float(dx)), path.stem, maker)


def _in_millimetres(metres: np.ndarray) -> np.ndarray:
    # what is too large for a double is no height, and told as such
    with np.errstate(over="ignore"):
        return metres * MILLIMETRES


def _fits(path: Path, size: int, text: bool, does: str) -> None:
    most = MOST_TEXT if text else MOST_BYTES
    if size > most:
        raise TopographyError(
            path, f"{does} {size / 1e6:.0f} MB, must be at most {most / 1e6:.0f} MB"
        )
