"""Loop: its feed, axes near the pole, and a time that does not follow the samples."""

import dataclasses
import functools
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close, assert_gradient
from polishopt.chain import polish
from polishopt.files.assemble import job as assemble
from polishopt.files.config import load
from polishopt.machine import Limits, inverse
from polishopt.machine.kinematics import rotary
from polishopt.machine.loop import DOUBLINGS, axis_slopes, largest, loop_rate, pole_pace
from polishopt.setup import Sampling


CONVEX = Path(__file__).parents[1] / "configs" / "pessoles2009_convex.yaml"
CELL = 0.02
ORDER = 2**DOUBLINGS
COUNT = 12
SPACING = 2 * np.pi / COUNT
PHASES = SPACING * np.arange(COUNT)
LIMITS = Limits(
    [500.0] * 3 + [1.6, 2.1], [2e3] * 3 + [5.0] * 2, jerk=[5e3] * 3 + [30.0] * 2
)


@functools.cache
def job():
    with jax.ensure_compile_time_eval():
        return assemble(load(CONVEX).config)


def test_smooth_maximum_lies_just_above_the_largest():
    values = np.abs(np.random.default_rng(0).standard_normal((200, 7)))
    values[0] = 2.0  # all alike: as far above as it gets
    values[1], values[2, 1:] = 0.0, 0.0
    got, hard = np.asarray(largest(jnp.asarray(values))), values.max(axis=1)
    assert (got >= hard * (1 - 1e-14)).all()
    assert (got <= hard * 7 ** (1 / ORDER) * (1 + 1e-14)).all()
    assert_close(got[0], 2 * 7 ** (1 / ORDER), rtol=1e-14)
    assert got[1] < 1e-300
    assert_close(got[2], values[2, 0], rtol=1e-14)
    assert_gradient(lambda x: largest(x)[None], np.array([1.0, -1.01, 0.0, 0.9]))
    assert_close(jax.grad(lambda x: largest(x))(jnp.zeros(3)), np.zeros(3), atol=0)
    assert jax.jvp(largest, (jnp.zeros(3),), (jnp.full(3, 5.0),))[1] == 0
    for size in (1e-30, 1e30):
        wide = jnp.asarray([1.0, 0.5, 1e-30], jnp.float32) * jnp.float32(size)
        assert_close(largest(wide), largest(jnp.asarray([1.0, 0.5])) * size, rtol=1e-6)


def harmonics(seed, axes=5):
    """Derivatives of axes that swing as loops of a trochoid do, the last one at rest."""
    waves = np.array([1.0, 2.0, 3.0])
    size = np.random.default_rng(seed).standard_normal((axes, 2, 3)) / waves**2
    size[-1] = 0.0
    turn = PHASES[:, None] * waves
    once = np.einsum("kj,nj->nk", size[:, 0] * waves, np.cos(turn))
    once -= np.einsum("kj,nj->nk", size[:, 1] * waves, np.sin(turn))
    twice = -np.einsum("kj,nj->nk", size[:, 0] * waves**2, np.sin(turn))
    twice -= np.einsum("kj,nj->nk", size[:, 1] * waves**2, np.cos(turn))
    return once, twice


fast = jax.jit(loop_rate)


def rate(dq, ddq, length, feed, limits, spacing=SPACING):
    return fast(*(jnp.asarray(x) for x in (dq, ddq, length, spacing, feed)), limits)


def relaxed(dq, ddq, length, limits, factor):
    """Largest squares of the rate that meet hard limits, by relaxation in plain NumPy.

    Every maximum over limits is taken `factor` times too large for each of its entries.
    """
    speed, most = np.asarray(limits.speed), np.asarray(limits.acceleration)
    bounds = np.concatenate([length[:, None] ** 2, (dq / speed) ** 2, abs(ddq) / most], 1)
    top = bounds.max(axis=1)
    w, k = abs(dq) / (2 * SPACING * most), abs(ddq) / most
    one = top * factor(bounds.shape[1])
    inverse = one.copy()
    for _ in range(10 * COUNT):
        # what either neighbour allows, as they stand by now
        near = [np.roll(inverse, shift)[:, None] for shift in (1, -1)]
        reached = [((w + k) / (1 + w / b)).max(axis=1) * factor(w.shape[1]) for b in near]
        inverse = np.max([inverse, one, *(r * factor(2) for r in reached)], axis=0)
    return 1 / inverse


@pytest.mark.parametrize("feed", [1.0, 0.3, 3.0])
def test_feed_lies_just_below_that_by_hard_limits(feed):
    """Nowhere above it; and below by no more than all smooth maxima can lose together."""
    limits = Limits([1.0, 1.2, 0.9, 2.0, 1.0], [2.0, 3.0, 1.5, jnp.inf, 1.0])
    for seed in range(20):
        dq, ddq = harmonics(seed)
        length = np.linalg.norm(dq[:, :2], axis=1) / feed
        got = np.asarray(rate(dq, ddq, length, 1.0, limits)) ** 2
        hard = relaxed(dq, ddq, length, limits, lambda _: 1.0)
        assert (got <= hard * (1 + 1e-12)).all()
        # the last norm takes in two neighbours, the laps' norms one each; and the sizes of
        # slopes are blunt
        least = relaxed(dq, ddq, length, limits, lambda n: (n + 2) ** (1 / ORDER))
        assert (got >= least * (1 - 1e-12)).all()


def test_a_round_loop_well_within_the_limits_keeps_its_feed():
    r, feed = 3.0, 10.0
    dq = r * jnp.stack([-jnp.sin(PHASES), jnp.cos(PHASES)], axis=1)
    ddq = -r * jnp.stack([jnp.cos(PHASES), jnp.sin(PHASES)], axis=1)
    # centripetal, and as much again for speeding up and for jerk
    ample = feed**2 / r
    limits = Limits([9 * feed] * 2, [20 * ample] * 2, jerk=[100 * ample * feed / r] * 2)
    got = rate(dq, ddq, r * np.ones(COUNT), feed, limits)
    assert_close(got, feed / r, rtol=1e-12)


@pytest.mark.parametrize("jerk", [None, jnp.inf, 4.0])
def test_feed_has_slopes_where_axes_turn_round_or_rest(jerk):
    """Of a sample at the turn of an axis, beside one at rest and one without a limit."""

    def total(x):
        wide, deep, shift, feed, swing, most = x
        turn = PHASES + shift
        still = jnp.zeros(COUNT)
        dq = [-wide * jnp.sin(turn), deep * jnp.cos(turn), swing * jnp.sin(2 * turn), still]
        ddq = [-wide * jnp.cos(turn), -deep * jnp.sin(turn)]
        ddq += [2 * swing * jnp.cos(2 * turn), still]
        limits = Limits(
            jnp.stack([2.0, 3.0, jnp.inf, 1.0]),
            jnp.stack([most, 1.3 * most, jnp.inf, 1.0]),
            jerk=None if jerk is None else jerk * jnp.ones(4),
        )
        dq, ddq = jnp.stack(dq, axis=1), jnp.stack(ddq, axis=1)
        length = jnp.sqrt(dq[:, 0] ** 2 + dq[:, 1] ** 2)
        return jnp.sum(1 / rate(dq, ddq, length, feed, limits))[None]

    # bound by the feed, by acceleration, and by both in turn
    for feed in (0.3, 8.0, 1.0):
        x = np.array([1.0, 1.2, 0.0, feed, 0.5, 2.0])
        assert_gradient(total, x, rtol=1e-4, atol=1e-6)


def test_without_limits_the_programmed_feed_holds():
    dq, ddq = harmonics(0)
    free, length = jnp.full(5, jnp.inf), jnp.asarray(np.linalg.norm(dq[:, :2], axis=1))

    def along(dq, ddq, spacing):
        return rate(dq, ddq, length, 2.0, Limits(free, free, jerk=free), spacing)

    given = (jnp.asarray(dq), jnp.asarray(ddq), jnp.asarray(SPACING))
    assert_close(along(*given), 2.0 / length, rtol=1e-12)
    slopes = jax.jit(jax.jacrev(along, (0, 1, 2)))(*given)
    assert all(not np.any(slope) for slope in slopes)
    # standing still altogether, as at a cusp, takes no time
    rest = rate(0 * dq, 0 * ddq, length.at[3].set(0.0), 2.0, Limits(free, free))
    assert 1 / rest[3] < 1e-9 / rest[4]
    assert_close(np.delete(rest, 3), np.delete(2.0 / length, 3), rtol=1e-12)


def test_feed_in_single_precision():
    """With rates of the rotary axes as large as beside the pole."""
    dq, ddq = harmonics(1)
    dq[:, 3], ddq[:, 3] = 1e3 * dq[:, 3], 1e5 * ddq[:, 3]
    want = rate(dq, ddq, np.ones(COUNT), 1.0, LIMITS)
    with jax.enable_x64(False):
        given = [jnp.asarray(x, jnp.float32) for x in (dq, ddq, np.ones(COUNT), SPACING)]
        limits = jax.tree.map(lambda x: jnp.asarray(np.asarray(x), jnp.float32), LIMITS)

        def single(dq, ddq, length, spacing):
            return rate(dq, ddq, length, jnp.float32(1.0), limits, spacing)

        got, slopes = single(*given), jax.jit(jax.jacrev(single, (0, 1, 2, 3)))(*given)
        assert got.dtype == jnp.float32
        assert all(np.isfinite(slope).all() for slope in slopes)
    assert_close(got, want, rtol=1e-5)


def leant(sigma, alpha):
    """Tool axis at a distance from the pole, in a direction."""
    across = sigma * jnp.stack([jnp.cos(alpha), jnp.sin(alpha)])
    return jnp.append(across, jnp.sqrt(1 - sigma**2))


def pace(sigma, alpha):
    cell = CELL * jnp.eye(3)[:2]
    return pole_pace(leant(sigma, alpha), cell, job().setup.machine)


def test_blurred_pole_keeps_the_time_it_costs():
    """A rate of one over the distance, over the area around the pole: 2 pi per length."""
    sigma = jnp.linspace(0.0, 0.8, 8001)
    rates = jax.jit(jax.vmap(pace, in_axes=(0, None)))
    for alpha in (0.0, 0.4, 1.3):
        missing = jnp.trapezoid(1 - rates(sigma, alpha), sigma)
        # the width of the kernel varies a little; a plain 1/(1 + x) would miss 0.6 cells
        assert abs(missing) < 0.12 * CELL
    assert_close(rates(sigma[-1:], 0.0)[0], 1.0, rtol=1e-4)


def test_blurred_pole_is_met_smoothly():
    across = jax.jacfwd(lambda v: pole_pace(v, CELL * jnp.eye(3)[:2], job().setup.machine))
    assert pace(0.0, 0.0) == 0.0
    assert_close(across(jnp.array([0.0, 0.0, 1.0])), np.zeros(3), atol=0)
    assert np.isfinite(across(jnp.array([1e-9, 1e-9, 1.0]))).all()


def test_cells_that_lie_along_a_circle_about_the_pole_are_not_blurred():
    axis, around = leant(0.1, 0.0), jnp.array([[0.0, 0.02, 0.0], [0.0, 0.01, 0.0]])
    assert_close(pole_pace(axis, around, job().setup.machine), 1.0, rtol=1e-4)


def test_axes_move_as_the_inverse_does():
    machine = job().setup.machine

    def pose(t):
        tip = jnp.stack([3 * t, jnp.sin(t), t**2])
        return tip, leant(0.2 + 0.1 * jnp.sin(2 * t), t)

    def apart(t):
        tip, axis = pose(t)
        return tip, rotary(axis, machine)[0]

    def along(f):
        return jax.jacfwd(f), jax.jacfwd(jax.jacfwd(f))

    at = jnp.asarray(0.3)
    first, second = (d(at) for d in along(apart))
    got = axis_slopes(apart(at), first, second, jnp.asarray(1.0), machine)
    want = [d(at) for d in along(lambda t: inverse(*pose(t), machine))]
    assert_close(got[0], want[0], rtol=1e-10, atol=1e-10)
    assert_close(got[1], want[1], rtol=1e-10, atol=1e-10)


@pytest.mark.slow
def test_time_does_not_follow_the_samples():
    """Samples that fell onto the pole made 10 % of the time, and slopes of 40 per rad."""
    tilts = jnp.radians(jnp.linspace(3.0, 13.0, 81))

    def times(setup, radius):
        process = dataclasses.replace(job().process, trochoid_radius=jnp.asarray(radius))
        return jax.lax.map(
            lambda tilt: polish(dataclasses.replace(process, tilt=tilt), setup).time, tilts
        )

    run = eqx.filter_jit(times)
    fine = Sampling(stations=8, phases=48)
    finer = eqx.tree_at(lambda s: s.sampling, job().setup, fine)
    for radius in (3.0, 6.0):
        coarse, want = run(job().setup, radius), run(finer, radius)
        assert_close(coarse, want, rtol=0.03)
        slopes = jnp.abs(jnp.diff(coarse)) / (tilts[1] - tilts[0]) / want[1:]
        assert slopes.max() < 4.0
