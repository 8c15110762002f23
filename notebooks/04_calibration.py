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
# # Constants from your own measurements
#
# The presets hold placeholders. Which measurements replace them, and what can they not
# tell?
#
# A table of measurements has one row for each; a unit ends each column's name, and empty
# cells were not measured. The same table serves the command
# `python -m polishopt.calibrate config.yaml --data data.csv -o calibrated.yaml`.

# %%
import tempfile
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from IPython.display import Markdown
from matplotlib_inline.backend_inline import set_matplotlib_formats
from polishopt.calibrate import WORDS, remarks
from polishopt.contact.flat import flat_force
from polishopt.files import assemble
from polishopt.files.calibrated import key_of
from polishopt.files.config import load
from polishopt.files.measurements import measurements
from polishopt.optimize.calibrate import calibrate, intervals, rests_on, unknowns
from polishopt.units import from_internal, label, suffix


jax.config.update("jax_enable_x64", True)
set_matplotlib_formats("jpeg", pil_kwargs={"quality": 60})
plt.rcParams["figure.dpi"] = 60


def data_of(text, job):
    """Data for a job, from the text of a table."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "data.csv"
        path.write_text(text)
        return assemble.data(measurements(path), job)


def answer(found, data):
    """Constants as a table, and what there is to say of them."""
    lines = ["| | unit | before | estimate | ± | 95 % | rests on |", "|---|" + "---|" * 6]
    rests, ends = rests_on(found), intervals(found)
    for i, name in enumerate(found.names):
        unit = suffix(key_of(name))
        before, value, error, low, high = (
            from_internal(float(x), unit)
            for x in (found.before[i], found.values[i], found.errors[i], *ends[i])
        )
        lines.append(
            f"| {' '.join(WORDS[name])} | {label(unit)} | {before:.3g} | **{value:.3g}** "
            f"| {error:.2g} | {low:.3g} … {high:.3g} | {rests[i]} |"
        )
    return "\n".join([*lines, "", *(f"* {sentence}" for sentence in remarks(found, data))])


# %% [markdown]
# ## Force against displacement and tilt
#
# No points of S0 Fig. 4 are printed, so this bench is made up: a disc whose bed stiffens,
# $k = 0.25$ N/mm³ and $\beta = 0.4$/mm, read with errors of 3 %. No errors are written in
# the table: they are estimated from the scatter, and intervals are those of Student's t.

# %%
disc = assemble.job(load("../configs/pessoles2009_plane.yaml").config)
rng = np.random.default_rng(4)
tilts, depths = (3, 5, 10, 15), (0.2, 0.4, 0.6, 0.8, 1.0)


def force(tilt, depth, k=0.25, beta=0.4):
    """Force of the made-up disc [N]."""
    return flat_force(*map(jnp.asarray, (9.0, k, np.radians(tilt), depth, beta)))


rows = [
    (t, e, float(force(t, e)) * (1 + 0.03 * rng.standard_normal()))
    for t in tilts
    for e in depths
]
bench = "tilt_deg,displacement_mm,force_N\n"
bench += "".join(f"{t},{e},{f:.4g}\n" for t, e, f in rows)
data = data_of(bench, disc)
found = calibrate(data, disc.setup, unknowns(data, disc.setup))
Markdown(answer(found, data))

# %%
figure, axes = plt.subplots(figsize=(6, 3.4), layout="constrained")
line = np.linspace(0.02, 1.05, 60)
for t in tilts:
    seen = [(e, f) for tilt, e, f in rows if tilt == t]
    (points,) = axes.plot(*zip(*seen, strict=True), "o", label=f"{t}°")
    k, beta = map(float, found.values)
    model = [float(force(t, e, k, beta)) for e in line]
    axes.plot(line, model, color=points.get_color())
axes.set_xlabel("displacement [mm]")
axes.set_ylabel("force [N]")
_ = axes.legend(title="tilt")

# %% [markdown]
# The two errors are strongly correlated: a softer bed that stiffens more gives nearly the
# same forces. Forces at one displacement could not tell them apart at all.
#
# ## What does one measured texture know?
#
# S0 Table 2 prints Sa, Sq, Ssk and Sku of three finished parts. Sa follows from the other
# three for any texture near a Gaussian one, so a row holds three numbers, and seven
# constants answer to them: Preston coefficient, active grains, stiffness of the asperities,
# ripple gain, and what the step before had left, which the paper does not say. The priors
# are wide: a factor of 3 for $K_P$, 5 for $c_a$ and for Sq before, 10 for $K_a$ (from
# rubber to the fibre of a felt), 2 for the ripple gain. In the middle for Sq before stand
# 3.8 nm, a fifth of the depth of the grooves of 3 µm diamond.
#
# The search is for the most probable set of constants, with errors of a third of what it
# may miss (3 % of Sa and Sq, 0.02 of Ssk, 2 % of Sku). The part polished by hand has no
# path, and is taken as if the felt had done it.

# %%
table = {
    "convex, automatic": ("convex", 7.619, 9.543, -0.2314, 2.92),
    "plane, automatic": ("plane", 1.085, 1.346, 0.103, 2.713),
    "plane, by hand": ("plane", 1.014, 1.307, -0.5941, 3.748),
}
start = "start={roughness: {Sq_nm: 3.8}}"
convex = "part={surface: sphere_cap, size_mm: [50, 50], radius_mm: 100}"
last = {
    "plane": assemble.job(load("../configs/pessoles2009_diamond.yaml", [start]).config),
    "convex": assemble.job(
        load("../configs/pessoles2009_diamond.yaml", [start, convex]).config
    ),
}
head = "Sa_nm,Sa_error_nm,Sq_nm,Sq_error_nm,Ssk,Ssk_error,Sku,Sku_error\n"
answers, texts, lines = (
    {},
    [],
    ["| | | Sa [nm] | Sq [nm] | Ssk | Sku |", "|---|" + "---|" * 5],
)
for name, (part, Sa, Sq, Ssk, Sku) in table.items():
    text = f"{Sa},{0.01 * Sa},{Sq},{0.01 * Sq},{Ssk},0.0067,{Sku},{0.0067 * Sku}\n"
    data = data_of(head + text, last[part])
    found = calibrate(data, last[part].setup, unknowns(data, last[part].setup, True))
    p = {k: float(v[0]) for k, v in found.predicted.items()}
    lines.append(f"| {name} | S0 | {Sa} | {Sq} | {Ssk:+.3f} | {Sku:.3f} |")
    lines.append(
        f"| | found | {1e6 * p['Sa']:.3f} | {1e6 * p['Sq']:.3f} | {p['Ssk']:+.3f} "
        f"| {p['Sku']:.3f} |"
    )
    texts.append(f"### {name}\n\n{answer(found, data)}")
    answers[name] = found
Markdown("\n".join(lines))

# %%
Markdown("\n\n".join(texts))

# %% [markdown]
# ### Which constants each row determines
#
# In all three rows the data determine three numbers of seven. The ripple gain is never
# among them: with the settings of this step the felt leaves a ripple of a hundredth of a
# nanometre through the roughness filter, and fifty times as much would begin to show.
#
# * **Convex.** The row determines Sq, Ssk and Sku before, given that little was taken off
#   them. It says nothing of the constants of the abrasive: the step hardly matters, so the
#   texture is still that of the step before.
# * **Plane.** Ssk > 0 cannot come from grooves, nor Sku < 3 from grooves or a Gaussian
#   rest. So the step's own grooves must be shallow or few (more active grains, less
#   removal, a stiffer ground), and Ssk before must be positive and Sku before near 2.2, as
#   milled and lapped waves have it. How shallow, how few and how fast they fade only shows
#   in combination.
# * **By hand.** Ssk and Sku lie beyond what grooves alone can reach: (Sku - 3)/Ssk² is
#   2.12, and grooves of one depth have 1.17, gamma-distributed depths at most 1.56. Part of
#   the variance must be something without much skew: here what was left from before, about
#   two thirds of it. How large a part it is depends on how much the depths of grooves
#   vary, which is held at the config's value.
#
# The number of active grains is only ever known as its product with the hardness, with the
# square of the tangent of the half-angle, and over the square of the grain size: all of
# them set the depth of a groove, and nothing else.

# %%
figure, axes = plt.subplots(figsize=(7, 3.2), layout="constrained")
for shift, (name, found) in zip((-0.2, 0.0, 0.2), answers.items(), strict=True):
    place = np.arange(len(found.names)) + shift
    spread = np.sqrt(np.diag(np.asarray(found.covariance)))
    axes.errorbar(place, found.point, 1.96 * spread, fmt="o", label=name)
axes.axhspan(-2, 2, color="0.92")
axes.set_xticks(range(len(found.names)), [" ".join(WORDS[n]) for n in found.names])
axes.tick_params(axis="x", rotation=25)
axes.set_ylabel("from the middle of the prior\n[its standard deviations]")
_ = axes.legend()
