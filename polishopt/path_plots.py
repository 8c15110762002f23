"""Path_plots: paths on the part, how much they cover, and the spectra of what they leave.

As in `plots`, every function draws one figure and returns it.
"""

from collections.abc import Mapping

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Line3DCollection

from .contact.removal import Grid
from .path.surface import Surface
from .plots import BLUE, GREY, MAP, SEVERAL
from .stored import seldom
from .texture.spectrum import Spectrum, radial_mean
from .units import from_internal, label


# Lines of the part along either side.
MESH = 25
# Least height of a drawn part, over its longest side: flat parts are drawn taller.
LEAST_HEIGHT = 0.12


@seldom
def _points(surface, xy):
    return jax.vmap(jax.vmap(surface))(xy)


def path_on_part(
    surface: Surface,
    size: Float[Array, "2"],
    contact: Float[Array | np.ndarray, "n 3"],
    feed: Float[Array | np.ndarray, " n"] | None = None,
) -> Figure:
    """A path on the part in space.

    Args:
        surface: The part.
        size: Sides of its parameter plane [mm].
        contact: Points of the path, as `Posture.contact` has them [mm].
        feed: Feed at each of them, as colour; None for one colour [mm/s].
    """
    part, path = _mesh(surface, size), np.asarray(contact)
    figure = Figure((8, 6), layout="constrained")
    axes = figure.add_subplot(projection="3d")
    axes.plot_surface(
        *np.moveaxis(part, -1, 0), color=GREY, alpha=0.25, linewidth=0, shade=False
    )
    if feed is None:
        axes.plot(*path.T, color=BLUE, linewidth=0.7)
    else:
        shown = np.asarray(feed) * from_internal(1.0, "mm_min")
        scale = Normalize(0, max(float(shown.max()), 1e-9))
        pieces = np.stack([path[:-1], path[1:]], axis=1)
        lines = Line3DCollection(list(pieces), cmap=MAP, norm=scale, linewidth=0.7)
        lines.set_array((shown[:-1] + shown[1:]) / 2)
        axes.add_collection3d(lines)
        text = f"feed [{label('mm_min')}]"
        figure.colorbar(lines, ax=axes, label=text, shrink=0.6, pad=0.08)
    _in_proportion(axes, np.concatenate([part.reshape(-1, 3), path]))
    return figure


def _mesh(surface: Surface, size: Float[Array, "2"]) -> np.ndarray:
    """Points of a part on lines along its sides."""
    sides = [np.linspace(0.0, float(side), MESH) for side in size]
    sheet = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1)
    return np.asarray(_points(surface, jnp.asarray(sheet, dtype=jnp.asarray(size).dtype)))


def _in_proportion(axes, points: np.ndarray) -> None:
    """Names and scales the axes alike, but draws flat parts taller and says so."""
    low, high = points.min(axis=0), points.max(axis=0)
    span = np.maximum(high - low, 1e-9)
    shown = span / span.max()
    taller = max(1.0, LEAST_HEIGHT / shown[2])
    shown[2] *= taller
    axes.set_box_aspect(shown)
    axes.set(xlabel="x [mm]", ylabel="y [mm]", zlabel="z [mm]")
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    # a part without height still needs a scale
    axes.set_zlim(low[2], low[2] + span[2])
    for name, side in zip("xyz", shown / shown.max(), strict=True):
        axes.locator_params(axis=name, nbins=max(2, round(7 * side)))
    if 1.05 < taller < 1e4:
        axes.set_title(f"Heights are drawn {taller:.1f} times as large")


def coverages(maps: Mapping[str, np.ndarray | Array], grid: Grid) -> Figure:
    """Local coverages of several paths over the sheet, each against its mean.

    Args:
        maps: By name, each from `coverage` [1/mm]; NaN where it does not count.
        grid: Their pixels.
    """
    figure = Figure((3.6 * len(maps) + 1, 3.9), layout="constrained")
    across = figure.subplots(1, len(maps), squeeze=False)[0]
    (x, y), (wide, high) = np.asarray(grid.origin), np.asarray(grid.size)
    off, means = {}, {}
    for name, values in maps.items():
        means[name] = float(np.nanmean(values))
        off[name] = from_internal(1.0, "percent") * (np.asarray(values) / means[name] - 1)
    top = max(float(np.nanmax(np.abs(values))) for values in off.values())
    scale = Normalize(-max(top, 1e-9), max(top, 1e-9))
    extent = (x, x + wide, y, y + high)
    for axes, (name, values) in zip(across, off.items(), strict=True):
        axes.imshow(values, origin="lower", extent=extent, cmap=MAP, norm=scale)
        spread = float(np.nanstd(values))
        axes.set_title(f"{name}\nmean {means[name]:.3g}/mm, varies by {spread:.1f} %")
        axes.set_xlabel("x [mm]")
    across[0].set_ylabel("y [mm]")
    text = f"coverage off its mean [{label('percent')}]"
    figure.colorbar(ScalarMappable(scale, MAP), ax=list(across), label=text, shrink=0.8)
    return figure


def spectra(
    found: Mapping[str, Spectrum],
    marks: Mapping[str, float] | None = None,
    unit: str = "mm⁴",
    highest: float | None = None,
) -> Figure:
    """Areal spectra of several maps, and their means over all directions.

    Args:
        found: By name, each from `areal_spectrum`.
        marks: Frequencies to point out, by name [1/mm].
        unit: Of the density: the square of that of the map, times mm².
        highest: Highest frequency that is drawn [1/mm].
    """
    reach = highest or min(float(each.highest) for each in found.values())
    top = max(float(jnp.max(each.density)) for each in found.values())
    scale = LogNorm(1e-6 * top, top)
    figure = Figure((max(3.1 * len(found), 6.2), 6.6), layout="constrained")
    rows = figure.add_gridspec(2, len(found))
    maps = []
    for i, (name, each) in enumerate(found.items()):
        axes = figure.add_subplot(rows[0, i])
        maps.append(axes)
        edge = [np.asarray(f) for f in (each.fx, each.fy)]
        density = np.maximum(np.asarray(each.density), 1e-6 * top)
        axes.pcolormesh(*edge, density, cmap=MAP, norm=scale, rasterized=True)
        axes.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal", title=name)
        axes.set_xlabel("along x [1/mm]")
    maps[0].set_ylabel("along y [1/mm]")
    density = f"density [{unit}]"
    figure.colorbar(ScalarMappable(scale, MAP), ax=maps, label=density, shrink=0.9)
    axes = figure.add_subplot(rows[1, :])
    for i, (name, each) in enumerate(found.items()):
        frequency, mean = radial_mean(each)
        axes.semilogy(frequency, mean, color=SEVERAL[i % len(SEVERAL)], label=name)
    for name, at in (marks or {}).items():
        axes.axvline(at, color=GREY, linestyle=":", zorder=0)
        axes.text(at, 1.02, name, transform=axes.get_xaxis_transform(), ha="center")
    axes.set(xlim=(0, reach), ylim=(1e-7 * top, top))
    axes.set_xlabel("frequency, whatever its direction [1/mm]")
    axes.set_ylabel(f"mean {density}")
    axes.legend(loc="upper right", frameon=False)
    return figure
