"""Plots: one figure from each plain result, with the units that people use.

Every function draws one figure and returns it. Figures are made without pyplot, so
nothing is shared between them: they can be drawn in threads and need no display.
"""

import dataclasses
import math
import os
import tempfile
from collections.abc import Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize, TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from .chain import Outcome
from .contact.limits import body_clearance, unstick_force
from .contact.pressure import force_and_area, patch
from .parts import Process
from .path.surface import curvature, jacobian, normal
from .resolved import Run
from .setup import Setup
from .stored import seldom
from .texture.local import TextureMaps
from .units import from_internal, label


# Colours that colour-blind people can tell apart (Okabe and Ito), most legible first.
BLUE, ORANGE, GREEN, PINK = "#0072b2", "#d55e00", "#009e73", "#cc79a7"
SKY, AMBER, GREY = "#56b4e9", "#e69f00", "#8c8c8c"
SEVERAL = (BLUE, ORANGE, GREEN, PINK, SKY, AMBER)
# Lightness rises evenly, and the hues stay apart for colour-blind people.
MAP = "cividis"
DPI = 150


# each is one compilation where its operations one by one would be many
@seldom
def _margins(process, tool):
    return body_clearance(process, tool), unstick_force(process.tilt, tool)


@seldom
def _along(guide, s):
    return jax.vmap(guide)(s).position


# What is drawn may come from a calculation or from a file.
Numbers = Array | np.ndarray


def path(run: Run, setup: Setup) -> Figure:
    """The path on the part seen from above, and a few of its loops enlarged.

    Args:
        run: The resolved path.
        setup: The job.
    """
    xy, minutes = np.asarray(run.posture.xy), in_units(run.law.time, "min")
    guide = np.asarray(_along(setup.guide, run.s))
    middle = len(xy) // 2
    disc = _disc(run, middle, float(setup.tool.radius))
    turned = np.unwrap(np.arctan2(*(xy - guide).T[::-1]))
    few = np.abs(turned - turned[middle]) <= 3 * np.pi
    corner = [float(side) for side in setup.size]

    figure = Figure((11, 4.8), layout="constrained")
    whole, near = figure.subplots(1, 2)
    for axes in (whole, near):
        times = _coloured(axes, xy, minutes)
        axes.plot(*guide.T, color="black", linewidth=1.6, label="guide")
        axes.add_patch(Rectangle((0, 0), *corner, fill=False, edgecolor=GREY))
        axes.plot(*disc.T, color=ORANGE, linewidth=1.8, label="disc")
        axes.set_aspect("equal")
        named(axes, "x", "y", "mm", "mm")
    near.plot(*xy[few].T, color=PINK, linewidth=1.6, label="three loops")
    figure.colorbar(times, ax=[whole, near], label="time [min]", shrink=0.8)
    reach = 0.62 * np.ptp(disc, axis=0).max()
    centre = disc.mean(axis=0)
    near.set_xlim(centre[0] - reach, centre[0] + reach)
    near.set_ylim(centre[1] - reach, centre[1] + reach)
    around = (centre[0] - reach, centre[1] - reach)
    whole.add_patch(Rectangle(around, 2 * reach, 2 * reach, fill=False, linestyle=":"))
    near.legend(loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=3, frameon=False)
    length = float(run.arc[-1]) / 1000
    whole.set_title(f"The path is {length:.1f} m long and takes {minutes[-1]:.1f} min")
    near.set_title("The dotted square, enlarged")
    return figure


def contact(process: Process, setup: Setup) -> Figure:
    """Pressure under the tilted disc, and its force against the displacement.

    On a curved part it is the contact in the middle of the part, with the feed along x.

    Args:
        process: Tilt and displacement are read.
        setup: The job.
    """
    tool, lean = setup.tool, setup.side
    bend = _bend(setup)
    draw = seldom(patch)
    footing = draw(process, tool, bend, lean, 48, 48, setup.panels)

    figure = Figure((11, 5), layout="constrained")
    under, against = figure.subplots(1, 2, width_ratios=(1.15, 1))
    pressure = np.asarray(footing.pressure)
    scale = Normalize(0, max(float(pressure.max()), 1e-9))
    for columns in np.split(np.arange(pressure.shape[1]), setup.panels):
        under.pcolormesh(
            *np.moveaxis(np.asarray(footing.offsets)[:, columns], -1, 0),
            pressure[:, columns],
            shading="gouraud",
            cmap=MAP,
            norm=scale,
        )
    figure.colorbar(
        ScalarMappable(scale, MAP), ax=under, label="pressure [MPa]", shrink=0.85
    )
    angle, radius = np.linspace(0, 2 * np.pi, 181), float(tool.radius)
    level = math.cos(float(process.tilt))
    under.plot(
        -lean * level * radius * (1 - np.cos(angle)),
        radius * np.sin(angle),
        color="black",
        label="disc",
    )
    under.plot(0, 0, "+", color=ORANGE, markersize=10, label="contact point")
    under.set_aspect("equal")
    under.legend(loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=2, frameon=False)
    named(under, "along the feed, ξ", "to its left, η", "mm", "mm")
    force, area = float(footing.force), float(footing.contact_area)
    under.set_title(f"The disc presses with {force:.1f} N on {area:.0f} mm²")

    here = float(process.displacement)
    clearance, limit = (float(x) for x in _margins(process, tool))
    critical = here + clearance
    reach = max(1.5 * here, 1.1 * critical)

    displacements = np.linspace(0.0, reach, 61)
    forces = np.asarray(_forces(displacements, process, tool, bend, lean, setup.panels))
    against.plot(displacements, forces, color=BLUE, label="force")
    against.plot(here, force, "o", color=BLUE, markersize=8, label="this process")
    if np.isfinite(limit):
        against.axhline(limit, color=ORANGE, linestyle="--", label="disc comes unstuck")
    against.axvline(critical, color=GREY, linestyle=":", label="rigid body touches")
    against.set_xlim(0, reach)
    against.set_ylim(0, 1.4 * float(forces[-1]))
    against.legend(loc="upper left")
    named(against, "displacement", "force", "mm", "N")
    tilt = from_internal(float(process.tilt), "deg")
    against.set_title(f"Force at a tilt of {tilt:.1f}{label('deg')}")
    return figure


def removal(depth: Float[Numbers, "ny nx"], size: Float[Numbers, "2"]) -> Figure:
    """Map of the depth removed, and the profile through its middle.

    Args:
        depth: Depth removed, rows along y [mm].
        size: Sides of the part along x and y [mm].
    """
    unit, values = label("um"), in_units(depth, "um")
    width, height = (float(side) for side in size)
    mean, spread = values.mean(), values.std()

    figure = Figure((11, 5), layout="constrained")
    over, through = figure.subplots(1, 2, width_ratios=(1.1, 1))
    image = over.imshow(
        values, origin="lower", extent=(0, width, 0, height), cmap=MAP, vmin=0
    )
    figure.colorbar(image, ax=over, label=f"depth removed [{unit}]", shrink=0.85)
    over.axhline(height / 2, color="white", linestyle="--", linewidth=1)
    named(over, "x", "y", "mm", "mm")
    share = f", ± {100 * spread / mean:.0f} % over the part" if mean > 0 else ""
    over.set_title(f"The mean removal is {mean:.3g} {unit}{share}")

    # an even number of rows has its middle between two of them
    ny, nx = values.shape
    profile = values[(ny - 1) // 2 : ny // 2 + 1].mean(axis=0)
    x = (np.arange(nx) + 0.5) * width / nx
    through.plot(x, profile, color=BLUE, label=f"at y = {height / 2:g} mm")
    through.axhline(mean, color="black", linestyle="--", label="mean of the part")
    through.axhspan(
        mean - spread, mean + spread, color=GREY, alpha=0.2, label="± standard deviation"
    )
    through.set_xlim(0, width)
    through.set_ylim(0, 1.25 * max(values.max(), 1e-9))
    through.legend(loc="upper right")
    named(through, "x", "depth removed", "mm", unit)
    through.set_title("Profile along the dashed line")
    return figure


def texture_maps(
    depth: Float[Numbers, "ny nx"],
    maps: TextureMaps,
    size: Float[Numbers, "2"],
    margin: float,
) -> Figure:
    """Maps of removal, Sq, Ssk and Sku over the part.

    Args:
        depth: Depth removed, rows along y [mm].
        maps: The texture at the same places.
        size: Sides of the part along x and y [mm].
        margin: How far inside the edges the worst place is looked for [mm].
    """
    width, height = (float(side) for side in size)
    counts = np.asarray(maps.evaluated)
    figure = Figure((11, 9.4), layout="constrained")
    panels = figure.subplots(2, 2)
    shown = (
        ("depth removed", depth, "um"),
        ("Sq", maps.Sq, "nm"),
        ("Ssk", maps.Ssk, ""),
        ("Sku", maps.Sku, ""),
    )
    for axes, (name, values, unit) in zip(panels.flat, shown, strict=True):
        values = in_units(values, unit) if unit else np.asarray(values)
        inside = values[counts]
        image = axes.imshow(
            values,
            origin="lower",
            extent=(0, width, 0, height),
            cmap=MAP,
            norm=Normalize(inside.min(), inside.max()),
        )
        axes.add_patch(
            Rectangle(
                (margin, margin),
                width - 2 * margin,
                height - 2 * margin,
                fill=False,
                edgecolor="white",
                linestyle="--",
            )
        )
        bracket = f"[{label(unit) or '-'}]"
        figure.colorbar(
            image, ax=axes, label=f"{name} {bracket}", shrink=0.85, extend="both"
        )
        named(axes, "x", "y", "mm", "mm")
        ends = f"{inside.min():.3g} to {inside.max():.3g} {label(unit)}".rstrip()
        axes.set_title(f"{name}: {ends}\ninside the dashed line".replace("-", "−"))
    return figure


def texture(
    heights: Float[Numbers, "ny nx"],
    extent: Float[Numbers, "2"],
    outcome: Outcome,
    log: bool = True,
) -> Figure:
    """A drawn patch of the finished texture, and how its heights are distributed.

    Args:
        heights: The patch, rows along y [mm].
        extent: Its sides along y and x [mm].
        outcome: The texture that is predicted is read.
        log: Whether the counts are on a logarithmic scale, which shows the valleys.
    """
    values = in_units(heights, "nm")
    values = values - values.mean()
    tall, wide = (from_internal(float(side), "um") for side in extent)

    figure = Figure((11, 5), layout="constrained")
    over, counts = figure.subplots(1, 2, width_ratios=(1.1, 1))
    low, high = np.quantile(values, (0.002, 0.998))
    image = over.imshow(
        values, origin="lower", extent=(0, wide, 0, tall), cmap=MAP, vmin=low, vmax=high
    )
    figure.colorbar(image, ax=over, label="height [nm]", shrink=0.85, extend="both")
    named(over, "x", "y", label("um"), label("um"))
    over.set_title("A patch of the finished texture, drawn at random")

    Sq = float(np.sqrt(np.mean(values**2)))
    unit = values / (Sq if Sq > 0 else 1.0)
    drawn = f"drawn: {_height_parameters(Sq, (unit**3).mean(), (unit**4).mean())}"
    predicted = from_internal(float(outcome.Sq), "nm")
    density, edges = np.histogram(values, bins=80, density=True)
    counts.stairs(density, edges, fill=True, color=SKY, label=drawn)
    z = np.linspace(edges[0], edges[-1], 201)
    if predicted > 0:
        bell = np.exp(-0.5 * (z / predicted) ** 2) / (predicted * np.sqrt(2 * np.pi))
        counts.plot(z, bell, color="black", linestyle="--", label="normal, of predicted Sq")
    if log:
        counts.set_yscale("log")
        some = density[density > 0]
        counts.set_ylim(0.5 * some.min(), 30 * density.max())
    counts.legend(loc="upper left")
    named(counts, "height", "probability density", "nm", "1/nm")
    told = _height_parameters(predicted, float(outcome.Ssk), float(outcome.Sku))
    counts.set_title(f"Predicted: {told}")
    return figure


def topography(
    heights: Float[Numbers, "ny nx"], extent: Float[Numbers, "2"], title: str = ""
) -> Figure:
    """A measured surface, and the profile along its middle row.

    Colours span all but the outer 0.4 % of the heights, so that a spike does not wash out
    the rest; points without a height are white.

    Args:
        heights: Heights, rows along y, NaN where not measured, not everywhere [mm].
        extent: Sides along y and x [mm].
        title: What it is.
    """
    unit, values = label("um"), in_units(heights, "um")
    values = values - np.nanmean(values)
    tall, wide = (float(side) for side in extent)
    low, high = np.nanquantile(values, (0.002, 0.998))

    figure = Figure((11, 5), layout="constrained")
    over, through = figure.subplots(1, 2, width_ratios=(1.1, 1))
    image = over.imshow(
        values, origin="lower", extent=(0, wide, 0, tall), cmap=MAP, vmin=low, vmax=high
    )
    figure.colorbar(image, ax=over, label=f"height [{unit}]", shrink=0.85, extend="both")
    ny, nx = values.shape
    middle = (ny // 2 + 0.5) * tall / ny
    over.axhline(middle, color="white", linestyle="--", linewidth=1)
    named(over, "x", "y", "mm", "mm")
    over.set_title(title)

    through.plot(
        (np.arange(nx) + 0.5) * wide / nx, values[ny // 2], color=BLUE, linewidth=0.8
    )
    through.set_xlim(0, wide)
    named(through, "x", "height", "mm", unit)
    through.set_title("Profile along the dashed line")
    return figure


def sensitivities(
    matrix: Float[Numbers, "rows columns"], rows: Sequence[str], columns: Sequence[str]
) -> Figure:
    """Elasticities of outcomes with respect to settings, as a table in colour.

    Args:
        matrix: Percent of change of each outcome per percent of each setting [-].
        rows: Names of the outcomes.
        columns: Names of the settings.
    """
    values = np.asarray(matrix, dtype=float)
    ny, nx = values.shape
    figure = Figure((3 + 1.05 * nx, 1.8 + 0.42 * ny), layout="constrained")
    axes = figure.subplots()
    # one huge number must not wash out all the others
    finite = np.abs(values[np.isfinite(values)])
    reach = max(float(np.quantile(finite, 0.9)) if finite.size else 1.0, 1e-3)
    image = axes.imshow(
        values, cmap="PuOr", norm=TwoSlopeNorm(0, -reach, reach), aspect="auto"
    )
    for i in range(ny):
        for j in range(nx):
            strong = abs(values[i, j]) > 0.65 * reach
            axes.text(
                j,
                i,
                _signed(values[i, j]),
                ha="center",
                va="center",
                color="white" if strong else "black",
            )
    slanted = {"rotation": 35, "ha": "right"} if nx > 7 else {}
    axes.set_xticks(np.arange(nx), [n.replace("_", " ") for n in columns], **slanted)
    axes.set_yticks(np.arange(ny), [name.replace("_", " ") for name in rows])
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    axes.set_xlabel("one percent more of this setting [%]")
    axes.set_ylabel("changes this outcome [%]")
    figure.colorbar(image, ax=axes, label="elasticity [% per %]", extend="both")
    axes.set_title("What one percent of each setting does")
    return figure


def save(figure: Figure, path: str | os.PathLike[str]) -> Path:
    """The figure as a PNG or SVG file, written whole or not at all.

    The same figure gives the same bytes: the file holds no date and no version.

    Args:
        figure: The figure.
        path: Where to put it, `.png` or `.svg`; its folder is made if need be.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, beside = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            if path.suffix == ".svg":
                with rc_context({"svg.hashsalt": "polishopt"}):
                    figure.savefig(file, format="svg", metadata={"Date": None})
            else:
                figure.savefig(
                    file,
                    format="png",
                    dpi=DPI,
                    metadata={"Software": None},
                    pil_kwargs={"compress_level": 3},  # a third of the time of the usual 6
                )
        # a temporary file is for its owner's eyes only; a picture is not
        os.chmod(beside, 0o644)
        os.replace(beside, path)
    except BaseException:
        Path(beside).unlink(missing_ok=True)
        raise
    return path


def in_units(values, unit: str) -> np.ndarray:
    """Values in a unit for people."""
    return np.asarray(values) * from_internal(1.0, unit)


def named(axes: Axes, x: str, y: str, x_unit: str, y_unit: str) -> None:
    """Labels with units, and no more frame than needed."""
    axes.set_xlabel(f"{x} [{x_unit}]")
    axes.set_ylabel(f"{y} [{y_unit.strip('[]')}]")
    axes.spines[["top", "right"]].set_visible(False)


def _signed(value: float) -> str:
    """Two decimals with a true minus sign, and no sign on what rounds to zero."""
    text = f"{value:+.2f}".replace("-", "\N{MINUS SIGN}")
    return text if text.strip("+\N{MINUS SIGN}0.") else "0.00"


def _height_parameters(Sq: float, Ssk: float, Sku: float) -> str:
    return f"Sq = {Sq:.3g} nm, Ssk = {_signed(Ssk)}, Sku = {Sku:.2f}"


def _coloured(axes: Axes, xy: np.ndarray, minutes: np.ndarray) -> LineCollection:
    """The path in pieces, each in the colour of its time."""
    cuts = np.unique(np.linspace(0, len(xy) - 1, 301).astype(int))
    pieces = [xy[a : b + 1] for a, b in zip(cuts[:-1], cuts[1:], strict=True)]
    lines = LineCollection(pieces, cmap="viridis", linewidths=0.5)
    lines.set_array(minutes[cuts[:-1]])
    axes.add_collection(lines)
    return lines


def _disc(run: Run, i: int, radius: float) -> np.ndarray:
    """Outline of the disc at sample i, seen from above, in the parameter plane [mm]."""
    at = jax.tree.map(lambda column: np.asarray(column)[i], run.posture)
    angle = np.linspace(0, 2 * np.pi, 121)[:, None]
    side = np.asarray(at.side)
    rim = np.cos(angle) * np.cross(side, at.axis) + np.sin(angle) * side
    return at.xy + (at.tip - at.contact + radius * rim)[:, :2]


@seldom
def _forces(displacements, process: Process, tool, bend, lean, panels):
    """Force at each of several displacements [N]."""

    def at(displacement):
        pressed = dataclasses.replace(process, displacement=displacement)
        return force_and_area(pressed, tool, bend, lean, panels)[0]

    return jax.vmap(at)(jnp.asarray(displacements))


@seldom
def _bend(setup: Setup):
    """Curvature in the middle of the part, with the feed along x [1/mm]."""
    middle = setup.size / 2
    along = jacobian(setup.surface, middle)[:, 0]
    f = along / jnp.sqrt(jnp.sum(along**2))
    b = jnp.cross(normal(setup.surface, middle), f)
    return curvature(setup.surface, middle, f, b)
