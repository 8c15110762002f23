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
# # A first fit
#
# What does each of the four settings do to the texture, the force and the time of the
# P1200 step of Pessoles & Tournier (2009)?
#
# The whole process is one function, `polish(process, setup)`. We vary one setting at a
# time, look at the process as the paper ran it, and let `tune` find settings whose
# texture is the one we ask for.

# %%
import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
from IPython.display import Markdown
from matplotlib_inline.backend_inline import set_matplotlib_formats
from polishopt import plots, resolved
from polishopt.chain import polish
from polishopt.files.assemble import job
from polishopt.files.config import load
from polishopt.optimize.tune import Verdict, tune
from polishopt.texture.evolution import draw_patch
from polishopt.units import from_internal, label


jax.config.update("jax_enable_x64", True)
# small pictures: they are kept with the notebook
set_matplotlib_formats("jpeg", pil_kwargs={"quality": 60})
plt.rcParams["figure.dpi"] = 60

# %%
plane = job(load("../configs/pessoles2009_plane.yaml").config)
process, setup = plane.process, plane.setup

# %% [markdown]
# ## One setting at a time
#
# The dot is the process of the paper. More displacement or less tilt presses harder; a
# smaller step goes over the part more often. Each changes how much is removed and how
# deep the grains cut, and so the texture.

# %%
settings = {
    "tilt": "deg",
    "displacement": "mm",
    "step": "mm",
    "trochoid_radius": "mm",
}
outcomes = {"Ssk": "", "Sku": "", "Sq": "nm", "force": "N", "time": "min"}

outcome = eqx.filter_jit(polish)(process, setup)
values = {name: jnp.linspace(low, high, 25) for name, (low, high) in plane.between.items()}
# one process for each value of each setting: a single call for all of them
varied = [
    dataclasses.replace(
        jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (25,)), process), **{name: column}
    )
    for name, column in values.items()
]
batch = jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *varied)
answers = eqx.filter_jit(eqx.filter_vmap(polish, in_axes=(0, None)))(batch, setup)

figure, grid = plt.subplots(
    len(outcomes), len(settings), figsize=(10, 10), sharex="col", sharey="row"
)
for column, (name, unit) in enumerate(settings.items()):
    x = from_internal(values[name], unit)
    mine = slice(25 * list(values).index(name), 25 * (list(values).index(name) + 1))
    for row, (result, result_unit) in enumerate(outcomes.items()):
        axes = grid[row, column]
        axes.plot(x, from_internal(getattr(answers, result)[mine], result_unit))
        here = from_internal(getattr(process, name), unit)
        axes.plot(here, from_internal(getattr(outcome, result), result_unit), "o")
        if column == 0:
            axes.set_ylabel(f"{result} [{label(result_unit) or '-'}]")
    grid[-1, column].set_xlabel(f"{name.replace('_', ' ')} [{label(unit)}]")
figure.align_ylabels()
figure.tight_layout()

# %% [markdown]
# ## The process of the paper
#
# The averaged process above is what is tuned. One particular path, with all its loops, is
# what is run.

# %%
count = resolved.samples(process, setup, per_loop=48)
path = jax.jit(resolved.run, static_argnums=2)(process, setup, count)
plots.path(path, setup)

# %%
plots.contact(process, setup)

# %%
plots.removal(outcome.removal, setup.size)

# %%
extent = jnp.asarray([0.04, 0.04])
patch = draw_patch(
    jax.random.key(0),
    setup.abrasive,
    outcome.pressure,
    outcome.mean_removal,
    (160, 160),
    extent,
)
plots.texture(patch, extent, outcome)

# %% [markdown]
# ## A texture on order
#
# `tune` starts from the paper's settings and a few others, keeps within the bounds and
# limits of the config, and takes the least time among the processes that hit the target.
# Where none does, it gives the nearest texture that the limits allow, and the verdict
# under the table says so.

# %%
tuned = tune(
    setup, process, plane.between, plane.target, plane.limits, secondary="time", starts=4
)
lines = ["| | unit | paper | tuned |", "|---|---|---|---|"]
for name, unit in settings.items():
    numbers = [
        from_internal(float(getattr(p, name)), unit) for p in (process, tuned.process)
    ]
    lines.append(
        f"| {name.replace('_', ' ')} | {label(unit)} | "
        + " | ".join(f"{number:.3g}" for number in numbers)
        + " |"
    )
for name, unit in outcomes.items():
    numbers = [
        from_internal(float(getattr(o, name)), unit) for o in (outcome, tuned.outcome)
    ]
    lines.append(
        f"| {name} | {label(unit) or '-'} | "
        + " | ".join(f"{number:.3g}" for number in numbers)
        + " |"
    )
lines.append(f"\nVerdict: {Verdict(int(tuned.verdict)).name.lower().replace('_', ' ')}.")
Markdown("\n".join(lines))
