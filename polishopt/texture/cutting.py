r"""Cutting: what the teeth of a milling cutter leave standing on the part.

Every point of a grid on the part carries a line along its normal, and each tooth that
passes cuts that line (the N-buffer method). A tooth does not sweep a torus: it passes
over the line at one moment, when its edge lies in one plane with it. That moment is found
together with the height by a fixed-point iteration, because the tool moves on by far less
than its radius while the tooth turns: no angular step is needed, and each round gains two
digits. The least of the heights is left. Cutting forces and burrs are left out.
"""

import functools
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..batched import in_batches
from ..parts import Scalar
from ..path.surface import Surface, area_stretch, curvature, jacobian, normal
from .cutter import Cutter, Passings


# An edge that meets a line at a flatter angle than this cosine is its flank, which does
# not cut.
FLANK = 0.1
# Pairs of a line and a passing that are held at a time, a few dozen numbers each.
AT_ONCE = 1 << 17
# Lines of a tile that look at all passings: its middle and its corners.
PROBES = 5


def cut(
    surface: Surface,
    x: Float[Array, " nx"],
    y: Float[Array, " ny"],
    cutter: Cutter,
    passings: Passings,
    candidates: int = 16,
    tile: tuple[int, int] = (32, 32),
    rounds: int = 3,
    width: Scalar | float | None = None,
    stock: Scalar | float = jnp.inf,
) -> Float[Array, "ny nx"]:
    r"""Heights that the teeth leave along the normals of a part [mm].

    Lines are taken tile by tile, and each tile looks only at the passings that come lowest
    over its middle. Differentiable in everything but the choice of these: with a hard
    minimum almost everywhere, with a `width` everywhere.

    Args:
        surface: The part as drawn.
        x: Grid of the lines along x of the parameter plane [mm].
        y: Grid of the lines along y [mm].
        cutter: The tool.
        passings: Where it stands whenever a tooth passes.
        candidates: Passings that each tile looks at. A tile holds as many as there are
            feeds along it, and two more, for each pass that it sees.
        tile: Lines of a tile along y and x.
        rounds: Rounds of the iteration for moment and height.
        width: Width of a smooth minimum, $-w\log\sum\exp(-h/w)$ [mm]; none for the least.
        stock: Height of the part before milling; infinite where all of it is cut [mm].

    Returns:
        The heights. They are infinite where nothing cuts and no `stock` is given, and NaN
        on tiles whose corners are cut by a passing that is not among their candidates.

    Source: S2 section 2 (N-buffer); the iteration is an own derivation.
    """
    count = passings.tooth.size
    candidates = min(candidates, count)
    ty, tx = min(tile[0], y.size), min(tile[1], x.size)
    ny, nx = -(-y.size // ty), -(-x.size // tx)
    # the last tile of a row repeats the last line
    columns = jnp.pad(x, (0, nx * tx - x.size), mode="edge").reshape(nx, tx)
    rows = jnp.pad(y, (0, ny * ty - y.size), mode="edge").reshape(ny, ty)
    ends = jnp.asarray([0, -1])

    def one(place: tuple[Float[Array, " ty"], Float[Array, " tx"]]):
        rows, columns = place
        middle = jnp.stack([jnp.mean(columns), jnp.mean(rows)])[None]
        corners = jnp.stack(jnp.meshgrid(columns[ends], rows[ends]), axis=-1)
        probes = jnp.concatenate([middle, corners.reshape(-1, 2)])
        first = _heights(*_lines(surface, probes), cutter, passings, 1)
        first = jax.lax.stop_gradient(first)
        _, chosen = jax.lax.top_k(-first[0], candidates)
        near = jax.tree.map(lambda leaf: leaf[chosen], passings)
        enough = jnp.all(jnp.min(first[:, chosen], axis=1) <= jnp.min(first, axis=1))
        xy = jnp.stack(jnp.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
        h = _heights(*_lines(surface, xy), cutter, near, rounds)
        least = jnp.where(enough, _least(h, width, stock), jnp.nan)
        return least.reshape(rows.size, columns.size)

    most = max(1, AT_ONCE // max(ty * tx * candidates, PROBES * count))
    # without a remainder, which would be compiled once more
    batch = max(n for n in range(1, most + 1) if nx * ny % n == 0)
    across, down = jnp.arange(nx), jnp.arange(ny)
    place = (jnp.repeat(down, nx), jnp.tile(across, ny))
    tiles = jax.lax.map(
        jax.checkpoint(lambda ij: one((rows[ij[0]], columns[ij[1]]))),
        place,
        batch_size=batch,
    )
    whole = tiles.reshape(ny, nx, ty, tx).transpose(0, 2, 1, 3)
    return whole.reshape(ny * ty, nx * tx)[: y.size, : x.size]


_cut = eqx.filter_jit(cut)


def topography(
    surface: Surface,
    x: Float[Array, " nx"],
    y: Float[Array, " ny"],
    cutter: Cutter,
    passings: Passings,
    progress: Callable[[int, int], None] | None = None,
    tile: tuple[int, int] = (32, 32),
    **settings,
) -> Float[np.ndarray, "ny nx"]:
    """Heights as from `cut`, band after band, for large maps; not for use under `jit`.

    Args:
        surface: The part as drawn.
        x: Grid of the lines along x of the parameter plane [mm].
        y: Grid of the lines along y [mm].
        cutter: The tool.
        passings: Where it stands whenever a tooth passes.
        progress: Called after each band with the number of lines done and of all lines.
        tile: Lines of a tile along y and x; a band is one tile wide.
        **settings: Other settings of `cut`.

    Raises:
        ValueError: if a tile has too few candidates.
    """
    heights = np.empty((y.size, x.size), dtype=x.dtype)
    band = min(tile[0], y.size)
    for start in range(0, y.size, band):
        # the last band overlaps the one before it, so that all have one shape
        begin = min(start, y.size - band)
        rows = y[begin : begin + band]
        heights[begin : begin + band] = _cut(
            surface, x, rows, cutter, passings, tile=(band, tile[1]), **settings
        )
        if np.isnan(heights[begin : begin + band]).any():
            size = tuple(float(abs(v[1] - v[0])) * n for v, n in ((y, band), (x, tile[1])))
            raise ValueError(
                f"Tiles of {size[0]:.3g} x {size[1]:.3g} mm see more passings than they "
                "have candidates: give a smaller `tile` or more `candidates`."
            )
        if progress is not None:
            progress((begin + band) * x.size, heights.size)
    return heights


def removed_volume(
    surface: Surface,
    x: Float[Array, " nx"],
    y: Float[Array, " ny"],
    heights: Float[Array, "ny nx"],
) -> Scalar:
    r"""Volume between the part as drawn and heights along its normals [mm^3].

    $V = -\int (h + \tfrac12 h^2 \mathrm{tr} K + \tfrac13 h^3 \det K)\, dA$: the normals of
    a curved part spread, so that a layer above it is larger than one below it. Positive
    where material is missing. Exact for each line; the sum is the midpoint rule.

    Args:
        surface: The part as drawn.
        x: Grid of the lines along x of the parameter plane, evenly spaced [mm].
        y: Grid of the lines along y, evenly spaced [mm].
        heights: Heights along the normals [mm].

    Source: Own derivation (Steiner's formula).
    """

    def column(xy: Float[Array, "2"], h: Scalar) -> Scalar:
        tangents, n = jacobian(surface, xy), normal(surface, xy)
        f = tangents[:, 0] / jnp.sqrt(jnp.sum(tangents[:, 0] ** 2))
        bend = curvature(surface, xy, f, jnp.cross(n, f))
        sum_, product = bend[0, 0] + bend[1, 1], jnp.linalg.det(bend)
        depth = -h * (1 + h * (sum_ / 2 + h * product / 3))
        return depth * area_stretch(surface, xy)

    xy = jnp.stack(jnp.meshgrid(x, y), axis=-1).reshape(-1, 2)
    depths = in_batches(lambda at: column(*at), (xy, heights.reshape(-1)), 4096)
    return jnp.sum(depths) * (x[1] - x[0]) * (y[1] - y[0])


def _lines(
    surface: Surface, xy: Float[Array, "n 2"]
) -> tuple[Float[Array, "3 n"], Float[Array, "3 n"]]:
    """Feet and directions of the lines, components first."""
    feet = jax.vmap(surface)(xy)
    return feet.T, jax.vmap(functools.partial(normal, surface))(xy).T


def _heights(
    feet: Float[Array, "3 n"],
    normals: Float[Array, "3 n"],
    cutter: Cutter,
    passings: Passings,
    rounds: int,
) -> Float[Array, "n m"]:
    """Height at which each passing tooth cuts each line; infinite where it does not.

    Newton's step towards the edge is never too long while the line is outside the tool,
    so that a line the tooth misses is never cut by mistake.
    """

    def each(x: Float[Array, "m 3"]) -> Float[Array, "3 1 m"]:
        return x.T[:, None, :]

    p, n = feet[:, :, None], normals[:, :, None]
    # vectors have their three components in front, and numbers one
    ring = (cutter.ring + cutter.runout[passings.tooth])[None, None, :]
    angle = h = jnp.zeros_like(p[:1] + ring)
    cuts = jnp.ones_like(h, dtype=bool)
    for _ in range(rounds):
        axis = each(passings.axis) + angle * each(passings.axis_slope)
        towards = each(passings.towards) + angle * each(passings.towards_slope)
        moved = angle * (each(passings.slope) + 0.5 * angle * each(passings.bend))
        q = p + h * n - each(passings.centre) - moved
        above = _dot(q, axis)
        out = q - above * axis
        square = _dot(out, out)
        # on the axis of a ball there is no direction: any will do, with no gradient
        off = square > 0
        radius = jnp.where(off, jnp.sqrt(jnp.where(off, square, 1.0)), 0.0)
        gap = radius - ring
        if cutter.flat:
            gap = jnp.maximum(gap, 0.0)
        distance = jnp.sqrt(gap**2 + above**2)
        outward = gap * _dot(out, n) / jnp.where(off, radius, 1.0) + above * _dot(axis, n)
        cuts = cuts & (outward < -FLANK * distance)
        fall = jnp.where(cuts, outward, -1.0)
        away = jnp.where(cuts, distance, 1.0)
        h = h - (away - cutter.corner_radius) * away / fall
        ahead = jnp.where(off, _dot(out, towards), 1.0)
        aside = jnp.where(off, _dot(out, _cross(axis, towards)), 0.0)
        angle = jnp.arctan2(aside, ahead)
    return jnp.where(cuts, h, jnp.inf)[0]


def _least(
    h: Float[Array, "n m"], width: Scalar | float | None, stock: Scalar | float
) -> Float[Array, " n"]:
    """The least height on each line, or a smooth one below it."""
    if width is None:
        return jnp.minimum(jnp.min(h, axis=1), stock)
    whole = jnp.concatenate([h, jnp.full_like(h[:, :1], stock)], axis=1)
    return -width * jax.nn.logsumexp(-whole / width, axis=1)


def _dot(a: Float[Array, "3 ..."], b: Float[Array, "3 ..."]) -> Float[Array, "1 ..."]:
    return a[:1] * b[:1] + a[1:2] * b[1:2] + a[2:] * b[2:]


def _cross(a: Float[Array, "3 ..."], b: Float[Array, "3 ..."]) -> Float[Array, "3 ..."]:
    x, y, z = a
    u, v, w = b
    return jnp.stack([y * w - z * v, z * u - x * w, x * v - y * u])
