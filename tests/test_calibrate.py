"""Calibration: constants against closed forms, and from data that the model drew.

Compiling takes seconds, so few shapes of data occur.
"""

import functools
import math
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close
from polishopt.chain import polish
from polishopt.files import assemble
from polishopt.files.config import load
from polishopt.files.measurements import measurements
from polishopt.optimize.calibrate import (
    PRIORS,
    START,
    Data,
    calibrate,
    constants,
    intervals,
    part,
    predict,
    quantiles,
    rests_on,
    unknowns,
    unstick_table,
    with_constants,
)
from polishopt.optimize.identify import alike, left_open


CONFIGS = Path(__file__).parent.parent / "configs"
SMALL = ["guide.order=1", "part.size_mm=[40, 40]", "sampling.grid=12"]
SMALL += ["sampling.phases=8", "texture.l_filter_mm=8"]
REPEATS = 100
# where the constants of the draws lie, in standard deviations of the priors
TRUTH = (0.3, 0.6, 0.4, -0.7, 0.5, -0.4)
K = "tool.foundation"


@functools.cache
def job(config="plane", *overrides):
    return assemble.job(load(CONFIGS / f"pessoles2009_{config}.yaml", overrides).config)


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    """From the text of a table to data for a job."""
    path = tmp_path_factory.mktemp("data") / "data.csv"

    def read(text, made):
        path.write_text(text)
        return assemble.data(measurements(path), made)

    return read


@functools.cache
def bench(table):
    """Forces and runs from which every constant can be known, and what drew them."""
    rows = [
        "tilt_deg,displacement_mm,step_mm,passes,force_N,removal_um,Sa_nm,Sq_nm,Ssk,Sku"
    ]
    for tilt in (3, 5, 10, 15):
        rows += [f"{tilt},{e},,,1,,,,," for e in (0.3, 0.6, 0.9)]
    for tilt, e in ((3, 0.2), (3, 0.6), (8, 0.3), (8, 0.8)):
        for step, passes in ((1, 1), (1, 6), (5, 3)):
            rows.append(f"{tilt},{e},{step},{passes},,1,1,1,0,3")
    made = job("plane", *SMALL)
    data = table("\n".join(rows), made)
    names = unknowns(data, made.setup)
    point = jnp.asarray(TRUTH)
    middles = jnp.stack([part(made.setup, name) for name in names])
    values = constants(names, middles, point)
    return made.setup, data, names, values, with_constants(made.setup, values)


@functools.cache
def exact(table):
    _, data, _, _, truth = bench(table)
    return eqx.filter_jit(predict)(data, truth)


def test_a_run_followed_once_gives_what_polish_gives(table):
    """With constants that are not those it was followed with."""
    setup, data, _, _, truth = bench(table)
    predicted = exact(table)
    assert not eqx.tree_equal(truth.abrasive, setup.abrasive)
    process = jax.tree.map(lambda x: x[5], data.runs.process)
    names = ("Sa", "Sq", "Ssk", "Sku")

    @eqx.filter_jit
    def outcome(process, setup):
        made = polish(process, setup)
        texture = jnp.stack([getattr(made, name) for name in names])
        return made.mean_removal, texture, made.parts[-1].k2

    removal, texture, rippled = outcome(process, truth)
    assert_close(predicted["removal"][5], removal, rtol=1e-12)
    assert_close([predicted[name][5] for name in names], texture, rtol=1e-10)
    assert rippled > 0.01 * texture[1] ** 2, "the ripple counts in this run"


@pytest.fixture(scope="module")
def repeats(table):
    """A hundred calibrations of data with 3 % noise.

    Errors of half of the measurements are given, the others must be found.
    """
    setup, data, names, values, _ = bench(table)
    right, rng = exact(table), np.random.default_rng(7)
    noise = {
        k: jnp.asarray(rng.standard_normal((REPEATS, v.size))) for k, v in right.items()
    }
    errors = {k: 0.03 * jnp.abs(right[k]) for k in ("force", "Sq", "Ssk")}

    @eqx.filter_jit
    @jax.vmap
    def once(noise):
        measured = {k: v * (1 + 0.03 * noise[k]) for k, v in right.items()}
        seen = Data(data.tilt, data.displacement, data.runs, measured, errors)
        return calibrate(seen, setup, names)

    return once(noise), np.asarray([values[name] for name in names])


def test_every_constant_is_recovered(repeats):
    found, truth = repeats
    assert np.all(found.converged)
    away = np.abs(np.asarray(found.values) - truth) / np.asarray(found.errors)
    share = np.mean(away <= 2, axis=0)
    assert share.min() >= 0.90, dict(zip(found.names, share, strict=True))
    # and errors are not told too large either
    assert np.all(np.std(away, axis=0) > 0.3)


def test_intervals_hold_what_they_promise(repeats):
    found, truth = repeats
    one = jax.tree.map(lambda x: x[0], found)
    ends, reach = intervals(one), quantiles(one) * jnp.sqrt(jnp.diag(one.covariance))
    for i, sign in ((0, -1), (1, 1)):
        for k, name in enumerate(one.names):
            moved = one.point.at[k].add(sign * reach[k])
            value = constants(one.names, one.before, moved)[name]
            assert_close(ends[k, i], value, rtol=1e-12)
    assert rests_on(one) == ["data"] * len(one.names)
    assert not left_open(one)
    assert {(pair.first, pair.second) for pair in alike(one)} >= {
        ("abrasive.active_fraction", "abrasive.hardness"),
        ("abrasive.active_fraction", "abrasive.grain"),
    }
    # on the scale of the priors, where an interval is as long to either side
    away = np.abs(np.asarray(found.point) - np.asarray(TRUTH))
    error = np.sqrt(np.asarray(jnp.diagonal(found.covariance, axis1=1, axis2=2)))
    share = np.mean(away <= quantiles(found) * error, axis=0)
    assert share.min() >= 0.90, dict(zip(found.names, share, strict=True))


def test_the_scatter_that_is_not_given_is_found(repeats):
    found, _ = repeats
    for name, scatter in found.scatter.items():
        want = 1.0 if name in ("force", "Sq", "Ssk") else 0.03
        # a standard deviation from so many numbers is known to 1/sqrt(2 n)
        spread = want / math.sqrt(
            2 * float(jnp.mean(found.scatter_freedom[name])) * REPEATS
        )
        assert_close(jnp.mean(scatter**2) ** 0.5, want, rtol=0, atol=4 * spread)


def bed(force, error=None):
    """Forces at one place, as data."""
    force = jnp.asarray(force)
    spots = jnp.full(force.shape, 0.1), jnp.full(force.shape, 0.4)
    errors = {} if error is None else {"force": jnp.asarray(error)}
    return Data(*spots, None, {"force": force}, errors)


def test_known_errors_give_the_textbook_mean():
    """log F is linear in log k: the weighted mean of data and prior."""
    setup = job("plane", *SMALL).setup
    here = float(predict(bed([1.0]), setup)["force"][0])
    force, error = (
        here * np.array([1.1, 1.3, 1.2, 1.25]),
        here * np.array([0.05, 0.1, 0.1, 0.05]),
    )
    found = calibrate(bed(force, error), setup, (K,))
    weight = (force / error) ** 2
    total = weight.sum() + PRIORS[K].spread ** -2
    mean = (weight * np.log(force / here)).sum() / total
    assert_close(jnp.log(found.values[0] / found.before[0]), mean, rtol=1e-6)
    assert_close(found.errors[0] / found.values[0], total**-0.5, rtol=1e-6)
    assert math.isinf(float(found.freedom[0]))
    assert_close(quantiles(found)[0], 1.959964, rtol=1e-6)


def test_unknown_errors_give_students_t():
    """With a prior that hardly counts: mean, standard error and quantile of n numbers."""
    setup = job("plane", *SMALL).setup
    here = float(predict(bed([1.0]), setup)["force"][0])
    logs = np.array([0.010, 0.014, 0.007, 0.012])
    found = calibrate(bed(here * np.exp(logs)), setup, (K,))
    assert_close(jnp.log(found.values[0] / found.before[0]), logs.mean(), rtol=1e-3)
    standard = logs.std(ddof=1) / 2
    assert_close(found.errors[0] / found.values[0], standard, rtol=1e-3)
    assert_close(found.freedom[0], 3.0, rtol=1e-3)
    assert_close(quantiles(found)[0], 3.182446, rtol=1e-3)


def test_forces_at_one_displacement_cannot_tell_how_the_bed_stiffens():
    setup = job("plane", *SMALL).setup
    names = (K, "tool.stiffening")
    found = calibrate(bed([1.0, 1.1, 1.2, 1.1], [0.01] * 4), setup, names)
    (group,) = left_open(found)
    assert group.names == names
    assert group.known == 1


def test_removal_alone_knows_the_product_of_preston_and_foundation(table):
    made = job("plane", *SMALL)
    rows = [f"{e},5,0.1" for e in np.linspace(0.2, 0.8, 12)]
    data = table("displacement_mm,removal_um,removal_error_um\n" + "\n".join(rows), made)
    assert unknowns(data, made.setup) == ("abrasive.preston",)
    found = calibrate(data, made.setup, ("abrasive.preston",))
    pairs = [pair for pair in alike(found) if pair.second == K]
    assert [pair.held for pair in pairs] == [True]
    assert_close(pairs[0].power, 1.0, rtol=1e-9)


# S0 Table 2: Sa, Sq [nm], Ssk, Sku
TABLE_2 = {
    "convex": (7.619, 9.543, -0.2314, 2.92),
    "plane": (1.085, 1.346, 0.103, 2.713),
    "manual": (1.014, 1.307, -0.5941, 3.748),
}
# how far a set of constants may miss each
NEAR = {"Sa": 0.03, "Sq": 0.03, "Ssk": 0.02, "Sku": 0.02}


@functools.cache
def last_step(table):
    """The last step of the paper, before which the texture is not known.

    Science: 3 µm diamond leaves 0.2 of its grooves' depth of 19 nm, if it was that.
    """
    made = job("diamond", "start={roughness: {Sq_nm: 3.8}}")
    head = "Sa_nm,Sa_error_nm,Sq_nm,Sq_error_nm,Ssk,Ssk_error,Sku,Sku_error\n"
    return made, table(head + "1,0.01,1.3,0.01,0,0.007,3,0.02", made)


@pytest.mark.parametrize("row", TABLE_2)
def test_table_2_of_the_paper(table, row):
    """One set of constants inside the priors for each row.

    The convex part differs from the plane by its path alone, which four numbers of a
    texture cannot see: all rows are taken as a plane.
    """
    made, data = last_step(table)
    want = dict(zip(NEAR, TABLE_2[row], strict=True))
    scale = {"Sa": 1e-6, "Sq": 1e-6, "Ssk": 1.0, "Sku": 1.0}
    measured = {k: jnp.asarray([v * scale[k]]) for k, v in want.items()}
    # a third of what may be missed
    size = {k: 1.0 if k == "Ssk" else abs(v) * scale[k] for k, v in want.items()}
    errors = {k: jnp.asarray([NEAR[k] * size[k] / 3]) for k in want}
    data = Data(data.tilt, data.displacement, data.runs, measured, errors)
    found = calibrate(data, made.setup, unknowns(data, made.setup, free_start=True))
    assert bool(found.converged)
    for name in want:
        assert_close(
            found.predicted[name][0],
            measured[name][0],
            rtol=0,
            atol=NEAR[name] * size[name],
        )
    assert np.all(np.abs(found.point) < 2), dict(zip(found.names, found.point, strict=True))
    # four numbers, of which Sa follows from the others
    known = len(found.names) - float(jnp.trace(found.covariance))
    assert 2 < known < 4
    before = dict(zip(found.names, found.values, strict=True))
    if want["Sku"] < 3:
        assert before[START[2]] < 3, "something before was flatter than Gaussian"
    skewed = (want["Sku"] - 3) / want["Ssk"] ** 2 < 1.556
    assert skewed == (row != "manual"), "grooves alone reach 1.556"


def test_unstick_forces_of_each_tilt():
    tilt, nan = np.array([0.2, 0.1, 0.1, 0.2]), np.full(4, np.nan)
    force = np.array([20.0, 10.0, 11.0, 22.0])
    tilts, mean, error = unstick_table(tilt, force, nan)
    assert_close(tilts, [0.1, 0.2])
    assert_close(mean, [10.5, 21.0])
    # four deviations of 1/21, two degrees of freedom, two numbers in each mean
    assert_close(error / mean, math.sqrt(4 / 21**2 / 2 / 2))
    _, mean, error = unstick_table(tilt, force, np.array([1.0, 1.0, 2.0, 1.0]))
    assert_close(mean[0], (10.0 + 11.0 / 4) / 1.25)
    assert_close(error[0], 1 / math.sqrt(1.25))
    assert np.isnan(unstick_table(tilt[:2], force[:2], nan[:2])[2]).all()
