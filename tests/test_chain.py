"""Chain: the whole process against its times, its laws and its own derivatives.

Compiling `polish` takes seconds, so few functions are compiled, and shared.
"""

import functools
import itertools
import math
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.special
from helpers import assert_close
from polishopt.chain import polish
from polishopt.files.assemble import job
from polishopt.files.config import load
from polishopt.path.families import hilbert
from polishopt.setup import Sampling, Start
from polishopt.texture.areal import parameters_from_cumulants
from polishopt.texture.milling import MilledSurface, milled_cumulants, milled_map
from polishopt.texture.scratches import Population


CONFIGS = Path(__file__).parent.parent / "configs"
DEG = math.pi / 180
TUNED = ("tilt", "displacement", "step", "trochoid_radius")
WATCHED = ("Ssk", "Sku", "force", "time")
BATCH = 27

full = eqx.filter_jit(polish)
duration = eqx.filter_jit(lambda process, setup: polish(process, setup).time)


@functools.cache
def plane():
    return job(load(CONFIGS / "pessoles2009_plane.yaml").config)


@functools.cache
def cap():
    return job(load(CONFIGS / "pessoles2009_convex.yaml").config)


@functools.cache
def plane_outcome():
    return full(plane().process, plane().setup)


def changed(process, **values):
    values = {k: jnp.asarray(v, dtype=float) for k, v in values.items()}
    return eqx.tree_at(
        lambda p: [getattr(p, k) for k in values], process, list(values.values())
    )


def watched(x, process, setup):
    """What the optimiser looks at, as a function of what it moves; and once more."""
    moved = eqx.tree_at(lambda p: [getattr(p, k) for k in TUNED], process, list(x))
    out = polish(moved, setup)
    values = jnp.stack([getattr(out, k) for k in WATCHED])
    return values, values


@eqx.filter_jit
def forward(xs, process, setup):
    """Values and forward-mode Jacobians at BATCH points, nine at a time."""

    def at(x):
        slopes, values = jax.jacfwd(watched, has_aux=True)(x, process, setup)
        return values, slopes

    return jax.lax.map(at, xs, batch_size=9)


@eqx.filter_jit
def backward(xs, process, setup):
    return jax.lax.map(
        lambda x: jax.jacrev(watched, has_aux=True)(x, process, setup)[0], xs
    )


def ample(machine):
    """The same machine, so fast that it never limits the feed."""
    free = jnp.full(5, 1e9)
    return eqx.tree_at(
        lambda m: (m.max_speed, m.max_acceleration, m.max_jerk), machine, (free,) * 3
    )


@pytest.mark.parametrize(("order", "radius", "minutes"), [(3, 6.0, 14.85), (4, 3.0, 15.03)])
def test_both_readings_of_the_paper_take_fifteen_minutes(order, radius, minutes):
    """S0 Table 1: 15 min a step. An ellipse integral gives the length of a loop."""
    guide = hilbert(order, (50.0, 50.0), "sharp")
    setup = eqx.tree_at(
        lambda s: (s.guide, s.machine), plane().setup, (guide, ample(plane().setup.machine))
    )
    time = duration(changed(plane().process, trochoid_radius=radius), setup)
    assert_close(time / 60, minutes, rtol=0, atol=0.01)
    drift, swirl = 1.0, 2 * math.pi * radius
    m = 4 * drift * swirl / (drift + swirl) ** 2
    loop = 2 / math.pi * (drift + swirl) * scipy.special.ellipe(m)
    length = 50 * (2**order - 0.5**order) * loop
    assert_close(time, length / (1000 / 60), rtol=1e-9)


# S0's settings; just short of full contact, e = 2 R sin(tilt); just short of half the
# disc, e = R sin(tilt), where the chord is widest
POINTS = np.array(
    [
        [3 * DEG, 0.4, 1.0, 6.0],
        [2.5 * DEG, 18 * math.sin(2.5 * DEG) - 1e-3, 1.1, 5.0],
        [3 * DEG, 9 * math.sin(3 * DEG) - 1e-4, 0.9, 4.0],
    ]
)
STEP = 1e-5


def stencil(points):
    """Each point, then each of its settings a little larger, then a little smaller."""
    rows = []
    for x in points:
        rows += [x, *(x + STEP * np.diag(x)), *(x - STEP * np.diag(x))]
    return np.stack(rows)


def agreement(values, slopes, points):
    """Largest disagreement of differences with slopes, in the row's largest entry.

    Slopes are per relative change of a setting, so that a row can be compared.
    """
    values, slopes = (np.asarray(a).reshape(-1, 9, *a.shape[1:]) for a in (values, slopes))
    differences = (values[:, 1:5] - values[:, 5:9]) / (2 * STEP)
    got = slopes[:, 0] * points[:, None, :]
    want = np.swapaxes(differences, 1, 2)
    largest = np.abs(got).max(axis=2)
    return got, np.abs(got - want).max(axis=2) / largest


def test_gradients_on_the_plane():
    """Forward = reverse = central differences, also just beside both clamps."""
    setup, process = plane().setup, plane().process
    values, slopes = forward(jnp.asarray(stencil(POINTS)), process, setup)
    got, error = agreement(values, slopes, POINTS)
    assert error.max() < 1e-5, error
    reverse = np.asarray(backward(jnp.asarray(POINTS), process, setup)) * POINTS[:, None]
    gap = np.abs(reverse - got).max(axis=2) / np.abs(got).max(axis=2)
    assert gap.max() < 1e-9, gap


@pytest.mark.slow
def test_gradients_on_the_convex_cap():
    setup, process = cap().setup, cap().process
    points = POINTS[:1]
    values, slopes = forward(jnp.asarray(stencil(points)), process, setup)
    got, error = agreement(values, slopes, points)
    assert error.max() < 1e-5, error
    reverse = np.asarray(backward(jnp.asarray(points), process, setup)) * points[:, None]
    gap = np.abs(reverse - got).max(axis=2) / np.abs(got).max(axis=2)
    assert gap.max() < 1e-9, gap


def test_nothing_is_nan_within_the_bounds():
    """Values and gradients on a grid of 4^4 points, corners of the box included."""
    bounds = [plane().between[name] for name in TUNED]
    axes = [np.linspace(low, high, 4) for low, high in bounds]
    points = np.array(list(itertools.product(*axes)))
    pad = -len(points) % BATCH
    points = np.concatenate([points, points[:pad]]).reshape(-1, BATCH, 4)
    for batch in points:
        values, slopes = forward(jnp.asarray(batch), plane().process, plane().setup)
        assert np.isfinite(values).all()
        assert np.isfinite(slopes).all()


def test_force_rises_with_displacement():
    x = np.tile(POINTS[0], (BATCH, 1))
    x[:, 1] = np.linspace(0.0, 1.2, BATCH)
    values, slopes = forward(jnp.asarray(x), plane().process, plane().setup)
    force = np.asarray(values)[:, WATCHED.index("force")]
    assert force[0] == 0
    assert (np.diff(force) > 0).all()
    # no contact is the first point
    assert np.isfinite(slopes).all()


def test_removal_is_linear_in_the_preston_coefficient():
    setup = plane().setup
    twice = eqx.tree_at(lambda s: s.abrasive.preston, setup, 2 * setup.abrasive.preston)
    one, two = plane_outcome(), full(plane().process, twice)
    assert_close(two.removal, 2 * one.removal, rtol=1e-12)
    assert_close(two.mean_removal, 2 * one.mean_removal, rtol=1e-12)
    assert_close(two.spread, one.spread, rtol=1e-10)
    assert_close(two.ripple, one.ripple, rtol=1e-10)


def test_passes_multiply_time_length_and_removal():
    one = plane_outcome()
    three = full(changed(plane().process, passes=3.0), plane().setup)
    for name in ("time", "path_length", "removal", "mean_removal"):
        assert_close(getattr(three, name), 3 * getattr(one, name), rtol=1e-12)
    for name in ("force", "feed", "spread", "ripple"):
        assert_close(getattr(three, name), getattr(one, name), rtol=1e-12)


@pytest.mark.parametrize("given", [plane, cap])
def test_mean_removal_is_the_mean_of_the_map_per_area(given):
    out, setup = full(given().process, given().setup), given().setup
    area = np.ones(setup.grid.shape)
    if given is cap:
        # area over its shadow: 1 / cos of the slope of a sphere
        x, y = np.meshgrid(np.asarray(setup.grid.x) - 25, np.asarray(setup.grid.y) - 25)
        area = 1 / np.sqrt(1 - (x**2 + y**2) / 100.0**2)
    assert_close(np.average(out.removal, weights=area), out.mean_removal, rtol=1e-10)
    spread = np.sqrt(np.average((out.removal - out.mean_removal) ** 2, weights=area))
    assert_close(out.spread, spread / out.mean_removal, rtol=1e-9)
    assert out.time >= out.path_length / given().process.feed * (1 - 1e-12)
    assert_close(out.feed, out.path_length / out.time, rtol=1e-12)
    assert out.force <= out.force_max * (1 + 1e-12)


def test_no_contact_leaves_the_start_texture():
    out = full(changed(plane().process, displacement=0.0), plane().setup)
    assert out.force == out.pressure == out.contact_area == 0
    assert out.mean_removal == out.spread == out.ripple == 0
    assert not np.any(out.removal)
    Sq, Ssk, Sku = parameters_from_cumulants(*plane().setup.start.scratches[0])
    assert_close([out.Sq, out.Ssk, out.Sku], [Sq, Ssk, Sku], rtol=1e-12)


def in_metres(process, setup):
    """The same job in m, N, s, Pa."""
    mm, per_area = 1e-3, 1e6
    process = eqx.tree_at(
        lambda p: (p.displacement, p.step, p.trochoid_radius, p.feed),
        process,
        replace_fn=lambda x: x * mm,
    )
    axes = jnp.asarray([mm, mm, mm, 1.0, 1.0])
    machine = eqx.tree_at(
        lambda m: (m.max_speed, m.max_acceleration, m.max_jerk),
        setup.machine,
        replace_fn=lambda x: x * axes,
    )
    setup = eqx.tree_at(
        lambda s: (
            s.size,
            s.surface.size,
            s.guide.pitch,
            s.tool.radius,
            s.tool.body_radius,
            s.tool.body_recess,
            s.abrasive.grain,
            s.abrasive.conformity,
            s.roughness_cutoff,
        ),
        setup,
        replace_fn=lambda x: x * mm,
    )
    setup = eqx.tree_at(
        lambda s: (s.abrasive.hardness, s.abrasive.pad_modulus, s.tool.shear_strength),
        setup,
        replace_fn=lambda x: x * per_area,
    )
    units = (Population(mm**2, mm**3, mm**4, mm),)
    start = jax.tree.map(lambda k, unit: k * unit, setup.start.scratches, units)
    return process, eqx.tree_at(
        lambda s: (s.machine, s.tool.foundation, s.abrasive.preston, s.start.scratches),
        setup,
        (
            machine,
            setup.tool.foundation * per_area / mm,
            setup.abrasive.preston / per_area,
            start,
        ),
    )


def test_no_hidden_units():
    mm, m = plane_outcome(), full(*in_metres(plane().process, plane().setup))
    for name in ("Ssk", "Sku", "time", "force", "force_max", "spread", "ripple"):
        assert_close(getattr(m, name), getattr(mm, name), rtol=1e-8)
    lengths = ("Sa", "Sq", "feed", "path_length", "mean_removal", "removal", "envelope")
    for name in (*lengths, "effective_diameter", "body_clearance"):
        assert_close(getattr(m, name), getattr(mm, name) * 1e-3, rtol=1e-8, atol=1e-18)
    assert_close(m.pressure, mm.pressure * 1e6, rtol=1e-9)
    assert_close(m.contact_area, mm.contact_area * 1e-6, rtol=1e-9)


def test_single_precision():
    """Nothing forces 64 bits; 32 of them hold every number to a few in ten thousand."""
    given = eqx.filter((plane().process, plane().setup), eqx.is_inexact_array, inverse=True)
    arrays = eqx.filter((plane().process, plane().setup), eqx.is_inexact_array)
    arrays = jax.tree.map(lambda x: np.asarray(x, np.float32), arrays)
    want = plane_outcome()
    with jax.enable_x64(False):
        process, setup = eqx.combine(jax.tree.map(jnp.asarray, arrays), given)
        got = full(process, setup)
        assert all(x.dtype == jnp.float32 for x in jax.tree.leaves(got))
    for name in ("Ssk", "Sku", "Sq", "force", "time", "mean_removal", "spread", "ripple"):
        assert_close(getattr(got, name), getattr(want, name), rtol=5e-4)


def test_default_sampling_is_fine_enough():
    fine = Sampling(stations=4, phases=24, rows=6, columns=5)
    want = full(plane().process, eqx.tree_at(lambda s: s.sampling, plane().setup, fine))
    got = plane_outcome()
    assert_close(got.time, want.time, rtol=3e-3)
    assert_close(got.mean_removal, want.mean_removal, rtol=5e-3)
    assert_close(got.Ssk, want.Ssk, rtol=0, atol=1e-3)
    assert_close(got.Sku, want.Sku, rtol=0, atol=1e-3)


@pytest.mark.parametrize(
    ("order", "side", "one_in"), [(4, 50, 1), (5, 50, 2), (7, 50, 8), (4, 8, 1), (6, 8, 16)]
)
def test_how_many_cells_one_stands_for(order, side, one_in):
    """A third of the disc's radius of 9 mm; but 256 are looked at in any case."""
    size = f"part.size_mm=[{side}, {side}]"
    given = load(CONFIGS / "pessoles2009_plane.yaml", [f"guide.order={order}", size])
    assert job(given.config).setup.sampling.one_cell_in == one_in


@pytest.mark.slow
@pytest.mark.parametrize("part", ["plane", "convex"])
def test_a_fine_curve_is_looked_at_here_and_there(part):
    """Below a third of the disc's radius, work grows with the length, not the cells."""
    path, fine = CONFIGS / f"pessoles2009_{part}.yaml", "guide.order=6"
    some = job(load(path, [fine]).config)
    whole = job(load(path, [fine, "sampling.one_cell_in=1"]).config)
    assert some.setup.sampling.one_cell_in == 4
    got, want = (full(one.process, one.setup) for one in (some, whole))
    for name in ("time", "path_length", "mean_removal", "Sq", "ripple"):
        assert_close(getattr(got, name), getattr(want, name), rtol=0.01)
    assert_close(got.spread, want.spread, rtol=0.03)


def test_milled_start():
    """Unpolished it is two families of cusps; polishing takes their tops off."""
    mill = MilledSurface(5.0, 1.0, 5 * DEG, 0.0, 0.3, 0.2)
    heights, spacing = milled_map(mill, (64, 64))
    bare = eqx.tree_at(
        lambda s: (s.start, s.roughness_cutoff),
        plane().setup,
        (Start(heights=heights, spacing=spacing), jnp.asarray(jnp.inf)),
    )
    texture = eqx.filter_jit(
        lambda p, s: (lambda o: (o.Sq, o.Ssk, o.Sku, o.parts[0].k3))(polish(p, s))
    )
    untouched = texture(changed(plane().process, displacement=0.0), bare)
    want = parameters_from_cumulants(*milled_cumulants(mill))
    # 64 points to a period sample a parabola to some 1/64^2
    assert_close(untouched[:3], want, rtol=5e-3)
    z = np.asarray(heights - heights.mean())
    Sq = np.sqrt(np.mean(z**2))
    assert_close(untouched[:3], [Sq, np.mean(z**3) / Sq**3, np.mean(z**4) / Sq**4])
    polished = texture(plane().process, bare)
    assert polished[3] < untouched[3]


def test_no_corner_where_a_row_of_the_patch_comes_to_reach_across_the_disc():
    """Slopes of force and texture on either side of the displacements at which it does."""
    process, setup = plane().process, plane().setup
    nodes, _ = np.polynomial.legendre.leggauss(setup.sampling.rows)
    across = 1 + np.cos(np.pi / 4 * (nodes + 1))
    met = float(setup.tool.radius) * math.sin(float(process.tilt)) * across
    sides = np.sort(np.concatenate([met * (1 - 1e-7), met * (1 + 1e-7)]))
    at = np.tile([float(getattr(process, name)) for name in TUNED], (BATCH, 1))
    at[: sides.size, 1] = sides
    _, slopes = forward(jnp.asarray(at), process, setup)
    slopes = np.asarray(slopes)[: sides.size]
    # what is left, of the nodes' places at the part's edges, was a tenth of the slope
    assert_close(slopes[::2, :3], slopes[1::2, :3], rtol=1e-3, atol=1e-9)
