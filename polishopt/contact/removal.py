r"""Removal: Preston's law under the disc, and what a footprint leaves along a path.

A footprint is a cloud of nodes, each of which removes volume at a certain rate. Moving it
along a path leaves volume wherever its nodes have been, for as long as they were there.
The volume is put on the pixels of a grid with a quadratic B-spline three pixels wide, so
that a map is smooth in everything that moves the nodes, and no volume is lost or made.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..parts import Scalar, as_array
from .pressure import Patch


class Footprint(eqx.Module):
    """A tool's influence: how fast it removes volume, node by node."""

    offsets: Float[Array, "m 2"]
    """Node positions in the tool frame [mm]."""
    rates: Float[Array, " m"]
    """Volume that each node removes per time [mm^3/s]."""

    @classmethod
    def measured(
        cls, depth_rates: Float[Array, "ny nx"], spacing: float | Scalar
    ) -> "Footprint":
        """A footprint from a measured or computed map, centred on the tool.

        Args:
            depth_rates: Removal rate on a square grid, rows along eta [mm/s].
            spacing: Distance between its points [mm].
        """
        ny, nx = depth_rates.shape
        x, y = np.arange(nx) - (nx - 1) / 2, np.arange(ny) - (ny - 1) / 2
        offsets = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        spacing = jnp.asarray(spacing, dtype=depth_rates.dtype)
        return cls(
            offsets=as_array(offsets) * spacing,
            rates=depth_rates.reshape(-1) * spacing**2,
        )

    @classmethod
    def sampled(
        cls,
        depth_rate: Callable[[Float[Array, "m 2"]], Float[Array, " m"]],
        half_width: float,
        count: int,
    ) -> "Footprint":
        """A footprint from a formula, sampled at `count` x `count` cell middles.

        Args:
            depth_rate: Removal rate [mm/s] at positions (m, 2) [mm].
            half_width: Half the side of the square that holds the footprint [mm].
            count: Samples along each side.
        """
        spacing = 2 * half_width / count
        line = (np.arange(count) + 0.5) * spacing - half_width
        offsets = as_array(np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2))
        return cls(offsets=offsets, rates=depth_rate(offsets) * spacing**2)


class Grid(eqx.Module):
    """Pixels that cover a rectangle of the parameter plane; arrays on it are [y, x]."""

    origin: Float[Array, "2"] = eqx.field(converter=as_array)
    """Lower left corner of the rectangle [mm]."""
    size: Float[Array, "2"] = eqx.field(converter=as_array)
    """Its sides along x and y [mm]."""
    shape: tuple[int, int] = eqx.field(static=True)
    """Number of pixels along y and x."""

    @property
    def spacing(self) -> Float[Array, "2"]:
        """Sides of a pixel along x and y [mm]."""
        return self.size / as_array(self.shape[::-1])

    @property
    def pixel_area(self) -> Scalar:
        """Area of a pixel in the parameter plane [mm^2]."""
        return jnp.prod(self.spacing)

    @property
    def x(self) -> Float[Array, " nx"]:
        """Pixel middles along x [mm]."""
        return self.origin[0] + self.spacing[0] * (as_array(np.arange(self.shape[1])) + 0.5)

    @property
    def y(self) -> Float[Array, " ny"]:
        """Pixel middles along y [mm]."""
        return self.origin[1] + self.spacing[1] * (as_array(np.arange(self.shape[0])) + 0.5)

    def pixels(self, points: Float[Array, "n 2"]) -> Float[Array, "n 2"]:
        """Positions in pixels: 0 is the middle of the first one [-]."""
        return (points - self.origin[None, :]) / self.spacing[None, :] - 0.5


def sliding(
    patch: Patch,
    tilt: Scalar,
    spin: Scalar,
    velocity: Float[Array, "2"],
    lean: float = 1.0,
) -> Float[Array, "3 rows columns"]:
    r"""Velocity of each node of the disc over the part along (feed, left, up) [mm/s].

    $\omega\times r + v_f$; the disc turns counter-clockwise seen from the spindle.

    Args:
        patch: Positions.
        tilt: Tilt of the disc [rad].
        spin: Spindle speed, $\omega$ [rad/s].
        velocity: Velocity of the contact point along (feed, left), $v_f$ [mm/s].
        lean: +1 pulling, -1 pushing, as in `patch`.

    Source: S0 (Pessoles & Tournier 2009) section 3.
    """
    towards, beside = patch.arms[..., 0], patch.arms[..., 1]
    along = -spin * beside * jnp.cos(tilt) + velocity[0]
    across = lean * spin * towards + velocity[1]
    return jnp.stack([along, across, spin * beside * jnp.sin(tilt)])


def preston_rates(
    patch: Patch,
    preston: Scalar,
    tilt: Scalar,
    spin: Scalar,
    velocity: Float[Array, "2"],
    lean: float = 1.0,
) -> Float[Array, "rows columns"]:
    r"""Volume that each node of a contact patch removes per time [mm^3/s].

    $\dot h = K_P\,p\,|\omega\times r + v_f|$ times the node's area. At a standstill the
    rate is 0, with a gradient of 0.

    Args:
        patch: Pressures and positions.
        preston: Preston coefficient, $K_P$ [1/MPa].
        tilt: Tilt of the disc [rad].
        spin: Spindle speed, $\omega$ [rad/s].
        velocity: Velocity of the contact point along (feed, left), $v_f$ [mm/s].
        lean: +1 pulling, -1 pushing, as in `patch`.

    Source: S0 (Pessoles & Tournier 2009) eq. (2), with K_P in 1/pressure.
    """
    along, across, upward = sliding(patch, tilt, spin, velocity, lean)
    square = along**2 + across**2 + upward**2
    moving = square > 0
    speed = jnp.where(moving, jnp.sqrt(jnp.where(moving, square, 1.0)), 0.0)
    return preston * patch.pressure * patch.area * speed


def _weights(
    position: Float[Array, " n"],
) -> tuple[Int[Array, " n"], Float[Array, "n 3"]]:
    """The first of the three pixels around each position, and its weights on them [-].

    The weights are those of a quadratic B-spline: the same from either side, slopes too,
    where a position passes from three pixels to the next three.
    """
    middle = jnp.round(position)
    t = position - middle
    weights = [0.5 * (0.5 - t) ** 2, 0.75 - t**2, 0.5 * (0.5 + t) ** 2]
    return middle.astype(jnp.int32) - 1, jnp.stack(weights, axis=-1)


def deposit(
    points: Float[Array, "n 2"], volumes: Float[Array, " n"], grid: Grid
) -> Float[Array, "ny nx"]:
    """Mean removal depth in each pixel, from volumes taken at points [mm].

    Each volume is spread by a quadratic B-spline over 3 x 3 pixels; what falls beyond
    the grid is gone. The depth is per area of the parameter plane: on a curved part,
    divide by its area stretch.

    Args:
        points: Where the volumes were, in the parameter plane [mm].
        volumes: How much was removed there [mm^3].
        grid: The pixels.
    """
    position = grid.pixels(points)
    column, across = _weights(position[:, 0])
    row, along = _weights(position[:, 1])
    spread = (volumes[:, None] * along)[:, :, None] * across[:, None, :]
    # three pixels that overlap the grid lie within two of it; all others are dropped
    wide = jnp.zeros([count + 4 for count in grid.shape], spread.dtype)
    windows = jax.lax.ScatterDimensionNumbers(
        update_window_dims=(1, 2),
        inserted_window_dims=(),
        scatter_dims_to_operand_dims=(0, 1),
    )
    mode = jax.lax.GatherScatterMode.FILL_OR_DROP
    places = jnp.stack([row, column], axis=-1) + 2
    wide = jax.lax.scatter_add(wide, places, spread, windows, mode=mode)
    return wide[2:-2, 2:-2] / grid.pixel_area


def fraction_inside(points: Float[Array, "n 2"], grid: Grid) -> Float[Array, " n"]:
    """Share of a volume taken at each point that `deposit` puts on the grid [-].

    The sum of its B-spline weights over the grid's pixels, in closed form, so that
    `sum(volumes * fraction_inside)` is the volume of the deposited map.

    Args:
        points: Positions in the parameter plane [mm].
        grid: The pixels.
    """

    def ramp(u):  # integral of the hat function on [-1, 1]
        u = jnp.clip(u, -1.0, 1.0)
        return jnp.where(u < 0, 0.5 * (1 + u) ** 2, 1 - 0.5 * (1 - u) ** 2)

    edge = grid.pixels(points) + 0.5
    count = jnp.asarray(grid.shape[::-1], dtype=edge.dtype)[None, :]
    return jnp.prod(ramp(edge) - ramp(edge - count), axis=1)


def superpose(
    footprint: Footprint,
    points: Float[Array, "n 2"],
    dwell: Float[Array, " n"],
    grid: Grid,
    frames: Float[Array, "n 2 2"] | None = None,
    block: int = 1 << 15,
) -> Float[Array, "ny nx"]:
    """Removal depth that a footprint leaves after dwelling at a list of points [mm].

    Any tool influence function works: see `Footprint.measured` and `Footprint.sampled`.

    Args:
        footprint: What the tool removes per time, around its own origin.
        points: Where the tool's origin dwells, in the parameter plane [mm].
        dwell: How long it dwells at each point [s].
        grid: The pixels of the map.
        frames: For each point, the matrix that takes an offset in the tool frame to one
            in the parameter plane: a rotation on a plane. None leaves the tool unturned.
        block: About how many node positions are held in memory at a time.

    Returns:
        Depth per area of the parameter plane, `[y, x]`. Volume beyond the grid is lost;
        all other volume is kept to rounding.

    Source: linear superposition of dwell, S0 (Pessoles & Tournier 2009) eq. (2).
    """
    if frames is None:
        frames = jnp.broadcast_to(jnp.eye(2, dtype=points.dtype), (points.shape[0], 2, 2))
    count, nodes = points.shape[0], footprint.rates.shape[0]
    size = max(1, min(count, block // max(nodes, 1)))
    chunks = -(-count // size)
    pad = chunks * size - count

    def chunk(total, part):
        centre, time, frame = part
        moved = jnp.einsum("nij,mj->nmi", frame, footprint.offsets) + centre[:, None, :]
        volumes = time[:, None] * footprint.rates[None, :]
        return total + deposit(moved.reshape(-1, 2), volumes.reshape(-1), grid), None

    def blocks(a):
        padded = jnp.concatenate([a, jnp.zeros((pad, *a.shape[1:]), dtype=a.dtype)])
        return padded.reshape(chunks, size, *a.shape[1:])

    start = jnp.zeros(grid.shape, dtype=points.dtype)
    return jax.lax.scan(chunk, start, (blocks(points), blocks(dwell), blocks(frames)))[0]
