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
# # Paths and coverage
#
# Which curves can guide the tool, how evenly do they cover a part that is not flat, and
# what do they leave behind?
#
# A guide is laid out on the parameter plane, the sheet that a surface bends into the part.
# Everything below is a function of the guide, the surface, or both.

# %%
import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from IPython.display import Markdown
from matplotlib_inline.backend_inline import set_matplotlib_formats
from polishopt import path_plots
from polishopt.contact.removal import Grid
from polishopt.coverage import coverage, path_lengths
from polishopt.files.assemble import job
from polishopt.files.config import load
from polishopt.path import (
    Asphere,
    Plane,
    even,
    fit_nurbs,
    hatch,
    hilbert,
    hilbert_rectangle,
    lines,
    peano,
    peano_revolution,
    resolved,
    round_spiral,
    segments,
    spiral,
)
from polishopt.resolved import removal, run
from polishopt.texture.spectrum import (
    areal_spectrum,
    band_power,
    peak_to_median,
    radial_mean,
    strongest_wave,
)


jax.config.update("jax_enable_x64", True)
set_matplotlib_formats("jpeg", pil_kwargs={"quality": 60})
plt.rcParams["figure.dpi"] = 60


# %% [markdown]
# ## Guides
#
# All corners are rounded here with a curvature that changes gently; arcs and sharp corners
# are there too. S4 (Tam, Cheng et al. 2013) asks of a path for polishing that its segments
# be short, of one length and at right angles, so that the tool comes by from many
# directions. The table has the length of the segments, how much of the path runs in its
# commonest direction (of 36, there and back being one), and how much it turns.

# %%
SQUARE, SLENDER = (50.0, 50.0), (60.0, 15.0)
guides = {
    "Hilbert": (hilbert(4, SQUARE), SQUARE),
    "Hilbert, any rectangle": (hilbert_rectangle(4, SLENDER), SLENDER),
    "Peano": (peano(2, SQUARE), SQUARE),
    "lines": (lines(10, SQUARE), SQUARE),
    "lines, one way": (lines(5, SQUARE, one_way=True), SQUARE),
    "cross-hatch": (hatch(8, SQUARE, 2, np.radians(60)), SQUARE),
    "spiral": (spiral(5, SQUARE), SQUARE),
    "round spiral": (round_spiral(6, SQUARE), SQUARE),
    "Peano, round": (
        peano_revolution(Plane(jnp.asarray(SQUARE)), jnp.asarray(SQUARE), 5.0, 25.0),
        SQUARE,
    ),
}


@eqx.filter_jit
def drawn(guide):
    points = jax.vmap(guide)(guide.length * jnp.linspace(0.0, 1.0, 3000))
    return points.position, points.contact, segments(guide)


figure, grid = plt.subplots(3, 3, figsize=(9, 9), layout="constrained")
rows = ["| | length [mm] | segments [mm] | commonest direction [%] | turned [rad/mm] |"]
rows.append("|---|" + "---|" * 4)
for axes, (name, (guide, size)) in zip(grid.flat, guides.items(), strict=True):
    xy, contact, found = drawn(guide)
    axes.plot(*np.where(contact[:, None] > 0, xy, np.nan).T, linewidth=1)
    axes.plot(*np.where(contact[:, None] > 0, np.nan, xy).T, ":", linewidth=1)
    axes.set(title=name, xlim=(0, size[0]), ylim=(0, size[1]), aspect="equal")
    ends = sorted({f"{length:.3g}" for length in np.asarray(found.lengths)}, key=float)
    long = " … ".join(ends[:: max(1, len(ends) - 1)]) or "none straight"
    rows.append(
        f"| {name} | {float(guide.length):.0f} | {long} "
        f"| {100 * float(jnp.max(found.directions)):.0f} | {float(found.turned):.2f} |"
    )
for axes in grid[-1]:
    axes.set_xlabel("x [mm]")
for axes in grid[:, 0]:
    axes.set_ylabel("y [mm]")

# %%
Markdown("\n".join(rows))

# %% [markdown]
# ## Coverage of a plane
#
# Coverage C is the length of path on an area. A Peano path of segments p has $C = 2/p$
# (S4, Eq. 5), as many as parallel lines at $s = p/2$. Rounded corners are a short cut.

# %%
lengths = eqx.filter_jit(path_lengths)
plane = Plane(jnp.asarray(SQUARE))
rows = [
    "| order | p [mm] | 2/p [1/mm] | C, sharp corners | C, rounded |",
    "|---|" + "---|" * 4,
]
for order in (1, 2, 3):
    guide = {corner: peano(order, SQUARE, corner) for corner in ("sharp", "smooth")}
    C = {k: float(jnp.sum(lengths(plane, g)[1])) / 50**2 for k, g in guide.items()}
    p = float(guide["sharp"].pitch)
    rows.append(
        f"| {order} | {p:.3f} | {2 / p:.5f} | {C['sharp']:.5f} | {C['smooth']:.5f} |"
    )
Markdown("\n".join(rows))

# %% [markdown]
# ## Coverage of a mirror
#
# A paraboloid with a focal length of 25 mm, 45° steep at the rim. A Peano path that is laid
# out on its shadow covers the steep part less. The same path on an even sheet, one with
# equal areas for equal areas, and S4's path on the surface of revolution make up for that.
# Coverage is local here: length over area under a Gaussian some segments wide. Borders,
# which no path reaches, are left out, and so is the vertex cap of the path of S4, which is
# filled with squares in another order.

# %%
SIZE = jnp.asarray([100.0, 100.0])
mirror = Asphere(SIZE, -50.0, -1.0)
sheet = even(mirror, SIZE)
peano_81 = peano(3, (100.0, 100.0), "sharp")
p = float(peano_81.pitch)
paths = {
    "Peano, laid out on the shadow": (mirror, peano_81),
    "Peano, on an even sheet": (sheet, peano_81),
    "S4, on the surface of revolution": (
        mirror,
        peano_revolution(mirror, SIZE, p, 50.0, corner="sharp"),
    ),
}
pixels = Grid(jnp.zeros(2), SIZE, (80, 80))
covered = eqx.filter_jit(coverage)
spot = jnp.stack(jnp.meshgrid(pixels.x, pixels.y), axis=-1)
maps = {}
for name, (surface, guide) in paths.items():
    found = covered(surface, guide, pixels, jnp.asarray(5 * p))
    radius = jnp.hypot(*jnp.moveaxis(jax.vmap(jax.vmap(surface))(spot)[..., :2], -1, 0))
    maps[name] = jnp.where((radius > 12) & (radius < 37), found, jnp.nan)
print(f"2/p = {2 / p:.4f}/mm")
path_plots.coverages(maps, pixels)

# %% [markdown]
# ## On the part
#
# The path of S4 on the mirror, and a trochoid along a Hilbert curve on a slender insert: a
# NURBS fitted to a grid of points of its crown.

# %%
guide = paths["S4, on the surface of revolution"][1]
along = eqx.filter_jit(
    lambda surface, guide: jax.vmap(lambda s: surface(guide(s).position))(
        guide.length * jnp.linspace(0.0, 1.0, 12000)
    )
)
path_plots.path_on_part(mirror, SIZE, along(mirror, guide))

# %%
x, y = np.meshgrid(np.linspace(-30, 30, 13), np.linspace(-7.5, 7.5, 7), indexing="ij")
insert = fit_nurbs(
    np.stack([x, y, -(x**2) / 400 - y**2 / 60], axis=-1), (6, 5), size=SLENDER
)
diamond = job(load("../configs/pessoles2009_diamond.yaml").config)
guide = guides["Hilbert, any rectangle"][0]
loops = eqx.tree_at(
    lambda p: (p.step, p.trochoid_radius),
    diamond.process,
    (jnp.asarray(1.0), jnp.asarray(2.0)),
)
s = guide.length * jnp.linspace(0.0, 1.0, 9000)
posture = eqx.filter_jit(resolved)(insert, guide, loops, diamond.setup.tool.radius, s)
path_plots.path_on_part(insert, jnp.asarray(SLENDER), posture.contact)

# %% [markdown]
# ## What paths leave behind
#
# Each path below takes the 6 mm felt over the 50 mm square of S0, with 13 lines' worth of
# path: lines $s = 50/13$ mm apart, a Hilbert curve with cells as wide, and the Peano path
# whose segments are nearly $2 s$. The fourth rolls a trochoid of radius $s/2$ and step 2 mm
# along the Hilbert curve, and so has more path. Removal maps are those of one run, with all
# its ripple, over their mean; 6 mm along the borders are left out. The feed is constant
# first, and then what the axes of the machine reach with their speeds and accelerations.
#
# A spectrum shows what the ripple consists of. Its peak over its median, between the
# frequencies $0.3/s$ and $2.5/s$, says whether the power is in a few lines or spread out.

# %%
count = 13
step = 50 / count
ripple = {
    "raster": (lines(count, SQUARE), 0.0, 3000),
    "Peano": (peano(2, SQUARE), 0.0, 3000),
    "Hilbert": (hilbert_rectangle(count, SQUARE), 0.0, 8000),
    "trochoid on Hilbert": (hilbert_rectangle(count, SQUARE), step / 2, 8000),
}
inner = Grid(jnp.full(2, 6.0), jnp.full(2, 38.0), (80, 80))
followed, removed = eqx.filter_jit(run), eqx.filter_jit(removal)
measured = eqx.filter_jit(
    lambda z: (
        (found := areal_spectrum(z, inner.spacing[::-1])),
        peak_to_median(found, *band),
        jnp.sqrt(band_power(found, *band)),
        strongest_wave(found, *band),
        radial_mean(found),
    )
)
band = (0.3 / step, 2.5 / step)


def limits(setup):
    """What the axes of the machine can do."""
    machine = setup.machine
    return machine.max_speed, machine.max_acceleration, machine.max_jerk


own = limits(diamond.setup)
none = tuple(jnp.full_like(limit, 1e9) for limit in own)


def left_by(guide, radius, samples, limit):
    """Removal over its mean of one run, its time [min] and its path on an area [1/mm]."""
    mine = eqx.tree_at(lambda s: (s.guide, *limits(s)), diamond.setup, (guide, *limit))
    process = eqx.tree_at(
        lambda p: (p.step, p.trochoid_radius),
        loops,
        (jnp.asarray(2.0), jnp.asarray(radius)),
    )
    path = followed(process, mine, samples, jerk=False)  # jerk takes ten times as long
    depth = removed(path, process, mine, inner, 8, 8)
    return depth / depth.mean(), float(path.law.total) / 60, float(path.arc[-1]) / 50**2


head = (
    "| feed | path | path on area [1/mm] | time [min] | ripple rms [%] "
    "| strongest wave, in 1/s | its density [mm²] | peak/median "
    "| the same of the mean over directions |"
)
rows, spectra, seen = [head, "|---|" + "---|" * 8], {}, {}
for feed, limit in (("constant", none), ("the machine's", own)):
    for name, (guide, radius, samples) in ripple.items():
        z, minutes, density = left_by(guide, radius, samples, limit)
        found, ratio, rms, wave, (frequency, mean) = measured(z)
        counts = (found.frequency >= band[0]) & (found.frequency <= band[1])
        top = float(jnp.max(jnp.where(counts, found.density, 0)))
        ring = mean[(frequency >= band[0]) & (frequency <= band[1])]
        rows.append(
            f"| {feed} | {name} | {density:.2f} | {minutes:.2f} | {100 * float(rms):.1f} "
            f"| {step * float(jnp.hypot(*wave)):.2f} | {top:.2g} | **{float(ratio):.1e}** "
            f"| {float(jnp.max(ring) / jnp.median(ring)):.0f} |"
        )
        if feed == "constant":
            spectra[name], seen[name] = found, z
Markdown("\n".join(rows))

# %%
figure, grid = plt.subplots(1, 4, figsize=(13, 3.6), layout="constrained")
for axes, (name, z) in zip(grid, seen.items(), strict=True):
    picture = axes.imshow(
        z, origin="lower", extent=(6, 44, 6, 44), cmap="cividis", vmin=0, vmax=2
    )
    axes.set(title=name, xlabel="x [mm]")
grid[0].set_ylabel("y [mm]")
_ = figure.colorbar(picture, ax=grid, label="removal over its mean [-]", shrink=0.8)

# %%
path_plots.spectra(spectra, {"1/s": 1 / step, "1/(2 s)": 0.5 / step}, "mm²", 0.8)

# %% [markdown]
# * **Raster.** The power stands in lines at $1/s$ and its multiples, and at $1/2s$, since
#   the tool leans along its travel and so differs there and back. There is next to nothing
#   in between, and the peak is many powers of ten above the median.
# * **Peano, Hilbert, trochoid on Hilbert.** Their power is spread over directions and
#   waves: the strongest wave is weaker than the raster's, and only some hundred to some
#   thousand times the median. This is what S4 argues with the spectra of its Figs. 24 and
#   26, of which no more than the captions is public.
# * **Spread is not less.** With the same path on an area a Peano path leaves more ripple
#   than the raster: its parallel segments lie $2 s$ apart, the tool smooths such long waves
#   less, and rounded corners leave gaps. A Hilbert curve leaves about as much as the
#   raster. What lowers the ripple here is more path, as the trochoid has it.
# * **Time.** The tool leans along the guide, so the C axis turns at every corner, and the
#   machine takes several times as long along the curves with many turns.
