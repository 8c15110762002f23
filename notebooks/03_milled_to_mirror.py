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
# # From milled to mirror
#
# What does each of the seven steps of Pessoles & Tournier (2009), Table 1, do to the
# texture of the part?
#
# The plan starts on a surface milled tooth by tooth (case 4 of Quinsat et al., 2011). Every
# step finds what the one before it left: the rest of the milled map, and the scratches and
# ripples of all earlier grades.

# %%
import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from IPython.display import Markdown
from matplotlib_inline.backend_inline import set_matplotlib_formats
from polishopt.files.assemble import plan_job
from polishopt.files.config import load
from polishopt.plan import follow
from polishopt.plan_report import picture
from polishopt.texture import height_parameters
from polishopt.texture.direction import slid_directions
from polishopt.texture.evolution import draw_patch
from polishopt.texture.scratches import groove_width


jax.config.update("jax_enable_x64", True)
set_matplotlib_formats("jpeg", pil_kwargs={"quality": 60})
plt.rcParams["figure.dpi"] = 60

job = plan_job(load("../configs/pessoles2009_plan.yaml").steps)
outcome = eqx.filter_jit(follow)(job.processes, job.plan)
names = job.plan.names

# %% [markdown]
# ## Step by step
#
# Each step removes more than the height Sz that it finds. That rule, and not a measurement,
# sets the Preston coefficients of this plan.

# %%
rows = [
    "| step | time [min] | force [N] | removal [µm] | Sa [nm] | Sq [nm] | Ssk | Sku |",
    "|---|---|---|---|---|---|---|---|",
]
rows += [
    f"| {name} | {s.time / 60:.1f} | {s.force:.2f} | {1e3 * s.mean_removal:.2f} "
    f"| {1e6 * s.Sa:.1f} | {1e6 * s.Sq:.1f} | {s.Ssk:.2f} | {s.Sku:.2f} |"
    for name, s in zip(names, outcome.steps, strict=True)
]
Markdown("\n".join(rows))

# %%
figure = picture(outcome)
figure.set_size_inches(11, 3.4)
plt.show()

# %% [markdown]
# The paper prints 15 min for every step. An order-3 Hilbert curve with sharp corners and a
# circle of 6 mm takes 14.9 min at the programmed feed; rounded corners, which the C axis
# can follow, save 1.8 min of that. Eight straight lines for pre-polishing take 14.3 min.
#
# ## Where the texture comes from
#
# Almost all of it is each grade's own scratches. The milled map and every earlier grade
# fade within a fraction of the removal; the ripple of the path is several times lower.

# %%
kinds = ("milled map", "earlier grades", "own scratches", "ripple")
share = np.asarray(
    [[1e6 * np.sqrt(max(float(p.k2), 0.0)) for p in s.parts] for s in outcome.steps]
)
figure, axes = plt.subplots(figsize=(7, 3.2), layout="constrained")
for kind, column, marker in zip(kinds, share.T, "os^d", strict=True):
    axes.plot(names, np.maximum(column, 1e-3), marker=marker, label=kind)
axes.set(yscale="log", ylabel="rms height of the part [nm]", xlabel="after the step")
axes.legend(ncols=2)
plt.show()

# %% [markdown]
# ## Pictures
#
# A drawn patch of each step's own scratches, forty groove widths wide. Their directions are
# those in which the disc slides over the part along the guide. Below, the histogram of
# heights beside the Gaussian of the same Sq: what is missing on the right are peaks, what
# is added on the left are scratches.

# %%
PIXELS = 192


@eqx.filter_jit
def drawn(key, process, setup, done):
    way = setup.guide.compass()
    directions = slid_directions(process, setup.tool, way.aspect, way.share)
    side = 40 * 2 * groove_width(setup.abrasive, done.pressure) * jnp.ones(2)
    heights = draw_patch(
        key,
        setup.abrasive,
        done.pressure,
        done.mean_removal,
        (PIXELS, PIXELS),
        side,
        4096,
        directions=directions,
    )
    return heights - jnp.mean(heights), side[0]


figure, axes = plt.subplots(2, 4, figsize=(11, 5), layout="constrained")
chosen = (0, 2, 4, 6)
for i, (above, below) in zip(chosen, axes.T, strict=True):
    heights, side = drawn(
        jax.random.key(i), job.processes[i], job.plan.setups[i], outcome.steps[i]
    )
    um, nm = 1e3 * float(side), 1e6 * np.asarray(heights)
    image = above.imshow(nm, extent=(0, um, 0, um), cmap="viridis")
    figure.colorbar(image, ax=above, label="height [nm]")
    above.set(title=names[i], xlabel="[µm]")
    found = height_parameters(heights)
    count, edges, _ = below.hist(nm.ravel(), 60, density=True, alpha=0.6)
    z, Sq = np.linspace(edges[0], edges[-1], 200), 1e6 * float(found.Sq)
    below.plot(z, np.exp(-0.5 * (z / Sq) ** 2) / (Sq * np.sqrt(2 * np.pi)), "k", lw=1)
    below.set(
        title=f"Ssk {found.Ssk:.2f}, Sku {found.Sku:.2f}", xlabel="height [nm]", yticks=[]
    )
plt.show()

# %% [markdown]
# One patch of forty grooves scatters: compare its Ssk and Sku with those of the table.
