"""Loop: axes near the pole, and a time that does not follow the samples."""

import dataclasses
import functools
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close
from polishopt.chain import polish
from polishopt.files.assemble import job as assemble
from polishopt.files.config import load
from polishopt.machine import inverse
from polishopt.machine.kinematics import rotary
from polishopt.machine.loop import axis_slopes, pole_pace
from polishopt.setup import Sampling


CONVEX = Path(__file__).parents[1] / "configs" / "pessoles2009_convex.yaml"
CELL = 0.02


@functools.cache
def job():
    with jax.ensure_compile_time_eval():
        return assemble(load(CONVEX).config)


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
