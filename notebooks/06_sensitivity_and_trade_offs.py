# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Sensitivity and trade-offs
#
# Which setting does what, what does the target cost, and what can be reached at all? Five
# answers for the P1200 step on the plane part, from the nearest to the furthest look.
#
# The commands `python -m polishopt.sensitivity` and `python -m polishopt.front` write the
# same as tables and pictures.

# %%
import jax
import matplotlib.pyplot as plt
import numpy as np
from IPython.display import Markdown
from matplotlib_inline.backend_inline import set_matplotlib_formats
from polishopt import plots, shares_plot
from polishopt.files.assemble import job
from polishopt.files.config import load
from polishopt.front_plot import aims, front_figure, region_figure
from polishopt.optimize.explore import Explorer
from polishopt.optimize.front import front, region
from polishopt.optimize.sensitivity import sensitivities
from polishopt.optimize.tune import Verdict, tune
from polishopt.optimize.variance import variance_shares
from polishopt.stored import stored
from polishopt.units import from_internal, label


jax.config.update("jax_enable_x64", True)
# small pictures: they are kept with the notebook
set_matplotlib_formats("jpeg", pil_kwargs={"quality": 60})
plt.rcParams["figure.dpi"] = 60

# averages over the path taken a little more coarsely than usual, to save time
coarse = ["sampling.stations_per_cell=1", "sampling.phases=8"]
plane = job(load("../configs/pessoles2009_plane.yaml", coarse).config)
settings = {"tilt": "deg", "displacement": "mm", "step": "mm", "trochoid_radius": "mm"}
outcomes = ("Ssk", "Sku", "force", "time", "mean_removal")


def table(head, rows):
    """A table for the notebook."""
    lines = [head, *rows]
    lines.insert(1, ["---"] * len(head))
    return Markdown("\n".join(f"| {' | '.join(line)} |" for line in lines))


# %% [markdown]
# ## Near one process: elasticities
#
# What one percent more of a setting does, around the process of the paper. These are exact
# derivatives of the whole chain. Of Ssk and Sku the change itself is given, per relative
# change of the setting.

# %%
local = stored(sensitivities)(plane.process, plane.setup, outcomes, tuple(settings))
plots.sensitivities(np.asarray(local.elasticities), local.outcomes, local.settings)

# %% [markdown]
# ## Between the bounds: shares of the variance
#
# A derivative speaks of one place. If each setting may lie anywhere between its bounds,
# which of them makes the outcomes vary? A dark bar is what a setting does by itself, a
# light one what it takes part in together with others. Both are estimates: the thin lines
# are 95 % bounds, and shrink with the root of the number of samples.

# %%
shares = variance_shares(plane.process, plane.setup, plane.between, outcomes, samples=64)
shares_plot.variance_bars(shares)

# %% [markdown]
# ## At the optimum: what the target and the limits cost
#
# `tune` makes the time small among all settings that hit the target. Its multipliers are
# prices: what moving a goal by one tolerance, a limit by one unit, or a bound by a tenth
# of the room it leaves would do to the time. Only what is in the way has a price.

# %%
best = tune(plane.setup, plane.process, plane.between, plane.target, plane.limits, starts=4)
rows = [
    [f"{name}: goal up by one tolerance", f"{float(price):+.2f} s"]
    for name, price in best.goal_multipliers.items()
]
rows += [
    [f"limit on {name}: one unit more", f"{-float(price):+.2f} s"]
    for name, price in best.multipliers.items()
    if float(price) > 0
]
for name, price in best.bound_multipliers.items():
    low, high = plane.between[name]
    if float(price):
        side = "upper" if float(price) > 0 else "lower"
        room = 0.1 * (high - low)
        shown = f"{from_internal(room, settings[name]):.2g} {label(settings[name])}"
        rows.append(
            [
                f"{side} bound of {name.replace('_', ' ')}: {shown} wider",
                f"{-abs(float(price)) * room:+.2f} s",
            ]
        )
verdict = Verdict(int(best.verdict)).name.lower()
table([f"{verdict}, {float(best.outcome.time):.1f} s", "changes the time by"], rows)

# %% [markdown]
# ## Further away: what more removal costs
#
# At each point of the front neither outcome can become better without the other getting
# worse. Here the texture is left free, within the limits. The front is found by holding
# the removal above a level, making the time small there, and moving the level; the dots
# are settings drawn at random.

# %%
explorer = Explorer(
    plane.setup,
    plane.process,
    plane.between,
    plane.target,
    plane.limits,
    ("time", "mean_removal", "Ssk", "Sku"),
    drawn=64,
)
trade = front(explorer, ("time", "mean_removal"), 5)
front_figure(trade)

# %%
table(
    ["time [s]", "removal [µm]", *(f"{n.replace('_', ' ')}" for n in settings)],
    [
        [
            f"{point.values[0]:.0f}",
            f"{1000 * point.values[1]:.3g}",
            *(
                f"{from_internal(point.settings[name], unit):.3g} {label(unit)}"
                for name, unit in settings.items()
            ),
        ]
        for point in trade.points
    ],
)

# %% [markdown]
# ## At all: which textures can be reached
#
# Ssk is held at a value, and Sku made as small and as large as the limits allow; then for
# the next value. The region is a narrow, bent band: Ssk and Sku cannot be chosen apart, and
# a target beside the band cannot be met with these settings, whatever the search. This
# target lies inside.

# %%
reach = region(explorer, ("Ssk", "Sku"), 5)
answer = [float(best.outcome.Ssk), float(best.outcome.Sku)]
goals = aims(plane.target, reach.names)
region_figure(reach.names, reach.drawn, goals, answer, reach)
