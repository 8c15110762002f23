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
# # Where polishing starts
#
# Does a simulation of every single tooth give the milled surfaces that Quinsat, Lavernhe &
# Lartigue (2011) measured and simulated?
#
# Their mill has an outer radius of 5 mm, corners of 1.5 mm and one tooth at 15 000 rpm. It
# is tilted by $\theta_t$ and turned by the yaw $\theta_n$ from the feed. Every point of the
# part carries a line along its normal, and each passing of the tooth cuts it.

# %%
import itertools

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from IPython.display import Markdown
from matplotlib_inline.backend_inline import set_matplotlib_formats
from polishopt.files.assemble import job
from polishopt.files.config import load
from polishopt.path.surface import HyperbolicParaboloid
from polishopt.texture import (
    Cutter,
    MilledSurface,
    Sz_analytic,
    cut,
    equivalent_radius,
    height_parameters,
    milled_marks,
    passing_count,
    passings,
    postures,
    true_feed,
)


jax.config.update("jax_enable_x64", True)
set_matplotlib_formats("jpeg", pil_kwargs={"quality": 60})
plt.rcParams["figure.dpi"] = 60

OUTER, CORNER, SPINDLE = 5.0, 1.5, 15000.0


def surface(yaw, tilt, feed, step):
    """A case of the paper: angles in degrees, feed in mm/min, step in mm."""
    angles = (np.radians(tilt), np.radians(yaw))
    return MilledSurface(OUTER, CORNER, *angles, step, feed / SPINDLE)


# %% [markdown]
# ## Table 2
#
# The paper gives each number twice, measured and simulated; steps are those of its first
# column. It does not say how the marks of neighbouring passes are shifted against each
# other: the spindle turns freely, so here seven passes have all shifts once. In the fourth
# case, with its narrow passes, Sa lies between 0.97 and 1.3 µm from one shift to another.

# %%
# neighbouring passes and teeth that may cut the same line, enough for all of this page
PASSES, SHAPE, REACH = 7, (140, 40), (4, 40)
cases = {
    1: ((0, 1, 2000, 2.76), (6.99, 5.58), (1.27, 1.21)),
    2: ((0, 1, 4000, 2.71), (9.17, 9.24), (1.46, 1.66)),
    3: ((0, 10, 4000, 1.21), (14.10, 15.7), (2.47, 2.56)),
    4: ((20, 10, 4000, 0.46), (6.54, 5.63), (0.96, 1.05)),
}
maps, lines = {}, []
lines.append(
    "| case | yaw, tilt [deg] | feed [m/min] | Sz [µm]: measured | simulated | **ours** "
    "| analytic | Sa [µm]: measured | simulated | **ours** | Ssk | Sku |"
)
lines.append("|---|" + "---|" * 11)
for number, (case, Sz, Sa) in cases.items():
    milled = surface(*case)
    z, _ = maps[number] = milled_marks(milled, SHAPE, PASSES, REACH)
    p = height_parameters(z)
    lines.append(
        f"| {number} | {case[0]}, {case[1]} | {case[2] / 1000:g} | {Sz[0]} | {Sz[1]} "
        f"| **{1e3 * p.Sz:.2f}** | {1e3 * Sz_analytic(milled):.2f} | {Sa[0]} | {Sa[1]} "
        f"| **{1e3 * p.Sa:.2f}** | {p.Ssk:+.2f} | {p.Sku:.2f} |"
    )
Markdown("\n".join(lines))

# %% [markdown]
# ## The patterns of Figure 8
#
# The yaw of the fourth case turns the marks, and its cusps no longer line up along the
# passes. Each picture is as wide as four feeds and as high as two steps or so.

# %%
figure, grid = plt.subplots(1, 4, figsize=(12, 3.4), layout="constrained")
for axes, (number, (z, spacing)) in zip(grid, maps.items(), strict=True):
    rows = 2 * SHAPE[0] // PASSES
    seen = np.tile(1e3 * np.asarray(z[:rows] - z.min()), (1, 4))
    high, wide = np.asarray(spacing) * seen.shape
    picture = axes.imshow(
        seen, origin="lower", extent=(0, wide, 0, high), aspect="auto", cmap="cividis"
    )
    axes.set_title(f"case {number}")
    axes.set_xlabel("along the feed [mm]")
    figure.colorbar(picture, ax=axes, label="height [µm]" if number == 4 else None)
grid[0].set_ylabel("across [mm]")
# %% [markdown]
# ## The effects of Table 3
#
# All 24 settings: yaw 0, 20 and 40°, tilt 1 and 10°, scallop height 5 and 10 µm, feed 2 and
# 4 m/min. An effect is half the difference between the means at the highest and the
# lowest level (Eq. 10). Three things are ours: the step $\sqrt{8 h_c R_{eq}}$ with the
# corrected $R_{eq}$, where the CAM system of the paper took another in the yawed case; the
# second scallop height, which Table 1 prints as 1 µm and Table 2 as 10; and the shifts of
# the passes.

# %%
levels = {
    "yaw": (0, 20, 40),
    "tilt": (1, 10),
    "scallop height": (0.005, 0.010),
    "feed": (2000, 4000),
}
design = np.array(list(itertools.product(*levels.values())))
results = []
for yaw, tilt, scallop, feed in design:
    radius = equivalent_radius(
        *map(jnp.asarray, (OUTER, CORNER, np.radians(tilt), np.radians(yaw)))
    )
    milled = surface(yaw, tilt, feed, jnp.sqrt(8 * scallop * radius))
    p = height_parameters(milled_marks(milled, SHAPE, PASSES, REACH)[0])
    results.append([1e3 * p.Sz, 1e3 * p.Sa, 1e3 * p.Sq, p.Sku, p.Ssk, 1e3 * p.Sv])
results = np.array(results)

# mean and effects as printed: yaw, tilt, scallop height, feed
printed = {
    "Sz [µm]": (4.79, -2.34, 0.56, -0.82, 1.27),
    "Sa [µm]": (0.92, -0.45, 0.19, 0.10, 0.16),
    "Sq [µm]": (1.10, -0.32, -0.57, 0.12, 0.24),
    "Sku": (2.33, 0.01, -0.04, -0.17, 0.06),
    "Ssk": (0.47, 0.00, -0.07, -0.05, -0.02),
    "Sv [µm]": (1.71, -0.81, 0.25, -0.28, 0.47),
}
lines = ["| | mean: paper | ours | " + " | ".join(f"{k}: paper | ours" for k in levels)]
lines[0] += " |"
lines.append("|---|" + "---|" * 10)
for column, (name, paper) in enumerate(printed.items()):
    ours = [results[:, column].mean()]
    for factor, ends in enumerate(levels.values()):
        high, low = (
            results[design[:, factor] == end, column].mean() for end in (ends[-1], ends[0])
        )
        ours.append((high - low) / 2)
    pairs = [f"{paper[0]:.2f} | {ours[0]:.2f}"]
    for a, b in zip(paper[1:], ours[1:], strict=True):
        # an effect of a hundredth or less has no sign
        same = a * b > 0 or min(abs(a), abs(b)) < 0.015
        pairs.append(f"{a:+.2f} | {b:+.2f}{'' if same else ' ⚠'}")
    lines.append(f"| {name} | " + " | ".join(pairs) + " |")
Markdown("\n".join(lines) + "\n\n⚠ marks an effect of the other sign.")

# %% [markdown]
# Yaw lowers all heights and the feed raises them, as in the paper. Where signs differ, the
# table of the paper is at odds with itself: with its effects of the tilt, Sq at 10° would
# be 0.53 µm and Sa 1.11 µm, but no surface has Sa above Sq; and its scallop height raises
# Sa and Sq while it lowers Sz and Sv. (With 1 µm for the second scallop height, as in
# Table 1, its effect on Sz comes out at -0.82 here too, but those on Sa and Sq turn
# negative as well.) Skewness hardly depends on anything, near +0.5; kurtosis stays near
# 2.4: milled surfaces start with peaks and bounded heights.

# %% [markdown]
# ## A saddle, at the feed that the machine can keep
#
# On a hyperbolic paraboloid, programmed at 5 m/min, the feed of the paper falls to half in
# the middle (Fig. 2), and the marks close up there (Fig. 7). With 1° of tilt the tool axis
# passes close to the C axis of the machine, which must turn by twist/tilt per length: its
# speed limit alone makes the feed $C_{max}\tan\theta_t/w$ in the middle of the rule. The
# paper prints neither the size nor the twist $w$ of its part; 50 mm and
# $w = 8.8\cdot10^{-4}$/mm bring half the feed with the limits of the `mikron_ucp710`
# preset. The pass neither starts nor stops on the part.

# %%
machine = job(load("../configs/quinsat2011.yaml").config).setup.machine
side, samples, programmed = 50.0, 1001, 5000 / 60
saddle, cutter = HyperbolicParaboloid([side, side], 8.8e-4), Cutter(OUTER, CORNER)
x = jnp.linspace(0.0, side, samples)
middle = jnp.stack([x, jnp.full(samples, side / 2)], axis=1)
tilt, yaw = jnp.asarray(np.radians(1.0)), jnp.asarray(0.0)
pass_ = postures(saddle, middle, jnp.zeros(samples), cutter, tilt, yaw)
law = true_feed(pass_, cutter, machine, jnp.asarray(programmed))
spin = jnp.asarray(SPINDLE * 2 * np.pi / 60)
teeth = passings(
    pass_, law.time, law.feed, spin, cutter, passing_count(law.total, spin, cutter)
)

figure, grid = plt.subplots(1, 3, figsize=(12, 3.2), layout="constrained")
grid[0].plot(x, 60 / 1000 * law.feed)
grid[0].set_ylim(0, 5.5)
grid[0].set_xlabel("along the rule [mm]")
grid[0].set_ylabel("feed [m/min]")
for axes, start in zip(grid[1:], (1.0, side / 2 - 1.0), strict=True):
    along = jnp.linspace(start, start + 2.0, 200)
    across = side / 2 + jnp.linspace(-1.0, 1.0, 100)
    z = cut(saddle, along, across, cutter, teeth, tile=(20, 20))
    extent = (start, start + 2, -1, 1)
    picture = axes.imshow(
        1e3 * z, origin="lower", extent=extent, cmap="cividis", vmin=0.0, vmax=5.0
    )
    axes.set_xlabel("along the rule [mm]")
grid[1].set_ylabel("across [mm]")
figure.colorbar(picture, ax=grid[2], label="height [µm]")
