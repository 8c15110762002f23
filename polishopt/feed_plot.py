"""Feed_plot: programmed against reached feed, over time and on the part."""

import numpy as np
from matplotlib.figure import Figure

from .machine.feed import limiting_name
from .parts import AXES, Process
from .plots import GREY, SEVERAL, SKY, in_units, named
from .resolved import Run
from .units import from_internal, label


def feed(run: Run, process: Process, names: tuple[str, ...] = AXES) -> Figure:
    """Programmed against reached feed over time and on the part, and what holds it back.

    Args:
        run: The resolved path.
        process: The programmed feed is read.
        names: What people call the axes.
    """
    unit = f"[{label('mm_min')}]"
    time, reached = np.asarray(run.law.time), in_units(run.law.feed, "mm_min")
    programmed = from_internal(float(process.feed), "mm_min")
    codes = np.asarray(run.law.limiting)
    spent = np.convolve(np.diff(time), [0.5, 0.5])
    share = {c: 100 * spent[codes == c].sum() / spent.sum() for c in np.unique(codes)}
    order = sorted(share, key=lambda c: -share[c])
    colour = {c: SEVERAL[i] if i < len(SEVERAL) else GREY for i, c in enumerate(order)}

    figure = Figure((13, 7.6), layout="constrained")
    grid = figure.add_gridspec(2, 3, width_ratios=(1.0, 1.3, 0.8), height_ratios=(2, 3))
    whole = figure.add_subplot(grid[0, :])
    part, near, bars = (figure.add_subplot(grid[1, i]) for i in range(3))

    edges = np.linspace(time[0], time[-1], 401)
    starts = np.minimum(np.searchsorted(time, edges[:-1]), time.size - 1)
    starts = np.unique(starts)
    low, high = np.minimum.reduceat(reached, starts), np.maximum.reduceat(reached, starts)
    at = in_units(time[starts], "min")
    whole.fill_between(
        at, low, high, step="post", color=SKY, linewidth=1.5, label="reached"
    )
    whole.set_xlim(0, from_internal(float(time[-1]), "min"))
    whole.axhline(programmed, color="black", linestyle="--", label="programmed")
    named(whole, "time", "feed of the contact point", "min", unit)
    whole.legend(loc="lower right", ncols=2)
    average = from_internal(float(run.arc[-1] / run.law.time[-1]), "mm_min")
    whole.set_title(
        f"The feed reaches {average:.0f} of {programmed:.0f} {label('mm_min')} on average"
    )

    xy = np.asarray(run.posture.xy)
    part.plot(*xy.T, color=GREY, linewidth=0.2, alpha=0.5)
    for code in order:
        if code != 0:  # where the programme holds there is nothing to show
            part.scatter(*xy[codes == code].T, s=3, color=colour[code], linewidths=0)
    part.set_aspect("equal")
    named(part, "x", "y", "mm", "mm")
    held = 100 - share.get(0, 0.0)
    part.set_title(f"Where something holds it back: {held:.1f} % of the time")

    loops = _window(run, process)
    near.plot(time[loops], reached[loops], color=GREY, linewidth=0.8)
    for code in order:
        chosen = loops[codes[loops] == code]
        near.scatter(time[chosen], reached[chosen], s=9, color=colour[code], zorder=3)
    near.axhline(programmed, color="black", linestyle="--")
    named(near, "time", "feed", "s", unit)
    near.set_title("A few loops, coloured by what holds the feed back")

    shown = order[: len(SEVERAL) + 2]
    places = np.arange(len(shown))
    bars.barh(places, [share[c] for c in shown], color=[colour[c] for c in shown])
    bars.set_yticks(places, [limiting_name(c, names) for c in shown])
    bars.invert_yaxis()
    bars.spines[["top", "right"]].set_visible(False)
    bars.set_xlabel(f"share of the time [{label('percent')}]")
    for axes in (whole, near):
        axes.set_ylim(0, 1.12 * max(programmed, reached.max()))
    return figure


def _window(run: Run, process: Process, loops: float = 4.0) -> np.ndarray:
    """Samples of a few loops half-way along the guide."""
    s = np.asarray(run.s)
    half = 0.5 * loops * float(process.step)
    return np.flatnonzero(np.abs(s - 0.5 * s[-1]) <= half)
