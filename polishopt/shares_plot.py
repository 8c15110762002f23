"""Shares_plot: Sobol indices as bars, one group for each outcome."""

import numpy as np
from matplotlib.figure import Figure

from .optimize.variance import Variance
from .plots import GREY, SEVERAL


def variance_bars(found: Variance) -> Figure:
    """What each setting makes of an outcome's variance, by itself and with others.

    Args:
        found: The indices, with their confidence bounds.
    """
    rows, columns = found.first.shape
    figure = Figure((8.0, 1.6 + 0.2 * rows * (columns + 1)), layout="constrained")
    axes = figure.subplots()
    thick = 1 / (columns + 1)
    base = np.arange(rows)[:, None] + thick * (np.arange(columns)[None] - (columns - 1) / 2)
    for j, name in enumerate(found.settings):
        colour = SEVERAL[j % len(SEVERAL)]
        total, first = (np.nan_to_num(each[:, j]) for each in (found.total, found.first))
        axes.barh(base[:, j], total, thick, color=colour, alpha=0.35)
        axes.barh(
            base[:, j], first, 0.55 * thick, color=colour, label=name.replace("_", " ")
        )
        low, high = found.total_between[:, :, j]
        axes.hlines(base[:, j], low, high, color=GREY, linewidth=1)
    axes.set_yticks(np.arange(rows), [name.replace("_", " ") for name in found.outcomes])
    axes.invert_yaxis()
    axes.set_xlim(0, 1.25)  # bounds of few samples may reach further than any share
    axes.set_xlabel("share of the variance [-]: dark by itself, light with others too")
    axes.set_title(f"What makes outcomes vary between the bounds ({found.samples} samples)")
    figure.legend(loc="outside right upper", frameon=False)
    return figure
