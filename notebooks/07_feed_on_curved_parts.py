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
# # Feed on curved parts
#
# Pessoles & Tournier (2009) advise a small tilt, because the rotary axes then move less.
# Is a small tilt faster on a convex part?

# %%
import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from IPython.display import Markdown
from matplotlib_inline.backend_inline import set_matplotlib_formats
from polishopt import feed_plot
from polishopt.chain import polish
from polishopt.files.assemble import job
from polishopt.files.config import load
from polishopt.resolved import run, samples


jax.config.update("jax_enable_x64", True)
set_matplotlib_formats("jpeg", pil_kwargs={"quality": 60})
plt.rcParams["figure.dpi"] = 60

part = job(load("../configs/pessoles2009_convex.yaml").config)


def changed(tilt, radius):
    """The job with another tilt [rad] and another radius of the part [mm]."""
    setup = eqx.tree_at(lambda s: s.surface.radius, part.setup, radius)
    return dataclasses.replace(part.process, tilt=tilt), setup


# %% [markdown]
# ## Time by tilt
#
# The averaged process, which is what a fit tunes: one loop of the trochoid at each station
# of the guide, run as fast as the axes allow. The dots are the same path with every loop,
# one by one.


# %%
@jax.jit
@jax.vmap
def minutes(tilt, radius):
    return polish(*changed(tilt, radius)).time / 60


COUNT = samples(part.process, part.setup)


@jax.jit
def true_path(tilt, radius):
    return run(*changed(tilt, radius), COUNT, jerk=False)


tilts, radii = np.radians(np.linspace(2, 15, 27)), (100.0, 200.0, 500.0)
few = np.radians([3.0, 7.0, 15.0])
for radius, colour in zip(radii, ("#0072b2", "#d55e00", "#009e73"), strict=True):
    times = minutes(jnp.asarray(tilts), jnp.full(tilts.size, radius))
    plt.plot(np.degrees(tilts), times, color=colour, label=f"R = {radius:g} mm")
    if radius < 500:
        paths = [true_path(jnp.asarray(tilt), jnp.asarray(radius)) for tilt in few]
        dots = [path.law.total / 60 for path in paths]
        plt.plot(np.degrees(few), dots, "o", color=colour)
plt.xlabel("tilt [°]")
plt.ylabel("time [min]")
plt.ylim(12.9, None)
plt.legend(frameon=False)
plt.gca().spines[["top", "right"]].set_visible(False)

# %% [markdown]
# It is the other way round. Each loop swings the normal of the part by up to D_tr/R. Where
# the tilt is no larger than that, the tool axis passes near the direction of C, the pole,
# and C has to whip round: the path takes longer. With a larger tilt than the swing, and
# than the slope of the part, C only sways.
#
# ## Where it happens

# %%
path = true_path(jnp.asarray(np.radians(3.0)), jnp.asarray(100.0))
feed_plot.feed(path, part.process)

# %%
share = 100 * (1 - float(path.arc[-1] / part.process.feed / path.law.total))
Markdown(
    f"At 3° on R = 100 mm the axes take {share:.1f} % of the time; all of it in the middle "
    "of the part, where the slope is less than the tilt and the swing. A wedge under the "
    "part (`machine.placement.wedge_deg`) keeps it off the pole."
)
