"""Feed, side by side with toppra: both know the fastest motion within acceleration."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from polishopt.machine import Limits, time_law


reason = "toppra is not installed: no second opinion on the fastest motion"
toppra = pytest.importorskip("toppra", reason=reason)

run = jax.jit(time_law)
SPEED, ACCELERATION = (
    [500.0, 500.0, 500.0, 1.571, 2.094],
    [2500.0, 3000.0, 2100.0, 5.2, 5.2],
)
SIZE = np.array([100.0, 100.0, 50.0, 0.5, 1.5])


def times(knots):
    """Our time on 1001 samples of a cubic spline, and toppra's on 10 001."""
    from toppra.algorithm import TOPPRA
    from toppra.constraint import JointAccelerationConstraint, JointVelocityConstraint

    toppra.setup_logging("ERROR")
    path = toppra.SplineInterpolator(np.linspace(0, 1, len(knots)), knots)
    held = [
        JointVelocityConstraint(np.asarray(SPEED)),
        JointAccelerationConstraint(np.asarray(ACCELERATION)),
    ]
    grid = np.linspace(0, 1, 10_001)
    rate = np.asarray(TOPPRA(held, path, gridpoints=grid).compute_parameterization(0, 0)[1])
    want = float(np.sum(2 * np.diff(grid) / (rate[1:] + rate[:-1])))
    sigma = jnp.linspace(0.0, 1.0, 1001)
    axes = jnp.asarray(path(np.asarray(sigma)))
    law = run(axes, Limits(SPEED, ACCELERATION), sigma, jnp.asarray(1e6))
    return float(law.total), want


@pytest.mark.parametrize("seed", range(12))
def test_a_spline_takes_the_least_time(seed):
    rng = np.random.default_rng(seed)
    got, want = times(rng.uniform(-1, 1, (7, 5)) * SIZE)
    assert got == pytest.approx(want, rel=5e-3)


def test_a_straight_move_takes_the_least_time():
    """From rest to rest, where one axis alone needs two times the root of d / a."""
    got, want = times(np.array([np.zeros(5), [100.0, 0.0, 0.0, 0.0, 0.0]]))
    exact = 2 * np.sqrt(100.0 / 2500.0)
    assert got == pytest.approx(exact, rel=5e-3)
    assert want == pytest.approx(exact, rel=5e-3)
