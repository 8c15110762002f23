"""Kinematics: there and back is the identity, and the pole is harmless."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close, assert_gradient
from polishopt.machine import forward, inverse, inverse_path
from polishopt.parts import Machine


run_path = jax.jit(inverse_path)


@pytest.fixture
def machine():
    return Machine(
        max_speed=[500.0, 500.0, 500.0, 1.571, 2.094],
        max_acceleration=[2500.0, 3000.0, 2100.0, 5.2, 5.2],
        max_jerk=[5e3, 5e3, 5e4, 31.0, 310.0],
        tilt_pivot=[0.02, -0.05, 0.1],
        turn_pivot=[0.01, 0.03, 62.0],
    )


def axis_at(tilt, turn):
    """Tool axis that A = tilt and C = turn bring along the spindle."""
    return jnp.stack(
        [jnp.sin(tilt) * jnp.sin(turn), jnp.sin(tilt) * jnp.cos(turn), jnp.cos(tilt)],
        axis=-1,
    )


def poses(count, seed=0):
    """Random points and tool axes, over the whole sphere."""
    rng = np.random.default_rng(seed)
    axes = rng.normal(size=(count, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    return jnp.asarray(rng.uniform(-100, 100, (count, 3))), jnp.asarray(axes)


@pytest.mark.parametrize("branch", [0, 1])
def test_forward_undoes_inverse(machine, branch):
    tips, axes = poses(10_000)
    back = jax.jit(
        jax.vmap(lambda p, u: forward(inverse(p, u, machine, branch=branch), machine))
    )
    got_tips, got_axes = back(tips, axes)
    assert_close(got_tips, tips, rtol=0, atol=1e-10)
    assert_close(got_axes, axes, rtol=0, atol=1e-12)


@pytest.mark.parametrize("tilt", [0.0, 1e-12, 1e-9, 1e-6, 1e-3])
def test_forward_undoes_inverse_near_the_pole(machine, tilt):
    turns = jnp.linspace(-3.1, 3.1, 41)
    tips, _ = poses(41)
    axes = axis_at(jnp.full(41, tilt), turns)
    back = jax.jit(jax.vmap(lambda p, u: forward(inverse(p, u, machine), machine)))
    got_tips, got_axes = back(tips, axes)
    assert_close(got_tips, tips, rtol=0, atol=1e-10)
    assert_close(got_axes, axes, rtol=0, atol=1e-12)


@pytest.mark.parametrize("tilt", [0.0, 1e-12, 1e-6, 0.3, 2.0])
def test_inverse_undoes_forward(machine, tilt):
    """With the last position to hold on to, C comes back too, several turns away."""
    back = jax.jit(lambda q: inverse(*forward(q, machine), machine, near=q))
    for turn in (-9.0, 0.4, 14.0):
        position = jnp.asarray([12.0, -7.0, 3.0, tilt, turn])
        assert_close(back(position), position, rtol=0, atol=1e-9)


def test_tool_axis_is_brought_along_the_spindle(machine):
    """The rotations, written out by hand, turn the tool axis into machine Z."""
    tips, axes = poses(100)
    run = jax.jit(inverse)
    for tip, u in zip(np.asarray(tips), np.asarray(axes), strict=True):
        x, y, z, a, c = np.asarray(run(jnp.asarray(tip), jnp.asarray(u), machine))
        tilt = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
        turn = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
        np.testing.assert_allclose(tilt @ turn @ u, [0, 0, 1], atol=1e-12)
        at = np.asarray(machine.tilt_pivot) + tilt @ (
            np.asarray(machine.turn_pivot) + turn @ tip
        )
        np.testing.assert_allclose([x, y, z], at, atol=1e-10)


def test_gradients_at_the_pole_are_finite_and_zero(machine):
    tip, pole = jnp.asarray([3.0, 4.0, 5.0]), jnp.asarray([0.0, 0.0, 1.0])
    reverse = jax.jit(jax.jacrev(inverse, (0, 1)))
    for jacobian in (jax.jit(jax.jacfwd(inverse, (0, 1))), reverse):
        by_tip, by_axis = jacobian(tip, pole, machine)
        assert np.isfinite(by_tip).all()
        assert_close(by_axis[3:], jnp.zeros((2, 3)))
    # nor does an axis straight down, or one that underflows when squared, do any harm
    for axis in ([0.0, 0.0, -1.0], [1e-170, 0.0, 1.0], [1e-12, 1e-12, 1.0]):
        _, slope = reverse(tip, jnp.asarray(axis), machine)
        assert np.isfinite(slope).all()


def test_path_keeps_c_continuous_over_several_turns(machine):
    turns = jnp.linspace(0.5, 0.5 + 6 * np.pi, 200)
    axes = axis_at(jnp.full(200, 0.2), turns)
    got = run_path(jnp.zeros((200, 3)), axes, machine)
    assert_close(got[:, 4], turns, rtol=1e-12)
    assert_close(got[:, 3], 0.2)


def test_path_holds_c_at_the_pole(machine):
    """Before, between and after samples away from the pole, C waits."""
    tilts = jnp.asarray([0.0, 0.0, 0.1, 0.0, 0.0, 0.1, 0.0])
    turns = jnp.asarray([0.0, 0.0, 0.7, 0.0, 0.0, 1.1, 0.0])
    got = run_path(jnp.ones((7, 3)), axis_at(tilts, turns), machine)
    assert_close(got[:, 4], jnp.asarray([0.7, 0.7, 0.7, 0.7, 0.7, 1.1, 1.1]), rtol=1e-12)
    still = run_path(jnp.ones((7, 3)), axis_at(0 * tilts, turns), machine)
    assert_close(still[:, 3:], 0.0)


def test_path_agrees_with_single_poses(machine):
    """Up to whole turns of C, a path is its poses one by one, and it is differentiable."""
    tips, axes = poses(50, seed=3)
    path = run_path(tips, axes, machine)
    single = jax.jit(jax.vmap(lambda p, u: inverse(p, u, machine)))(tips, axes)
    assert_close(path[:, :4], single[:, :4], rtol=1e-10, atol=1e-9)
    assert_close(jnp.cos(path[:, 4] - single[:, 4]), 1.0, rtol=1e-12)
    square = jax.jit(jax.grad(lambda u: jnp.sum(inverse_path(tips, u, machine) ** 2)))
    slope = square(axes)
    assert np.isfinite(slope).all()


def test_gradient_is_that_of_differences(machine):
    pose = jnp.asarray([30.0, -20.0, 5.0, 0.1, 0.2, 0.9])
    assert_gradient(lambda x: inverse(x[:3], x[3:], machine), pose, rtol=1e-7, atol=1e-8)


def test_no_hidden_units(machine):
    """Restated in metres, linear axes scale and rotary ones do not change."""
    tips, axes = poses(20)
    small = Machine(
        max_speed=machine.max_speed,
        max_acceleration=machine.max_acceleration,
        max_jerk=machine.max_jerk,
        tilt_pivot=machine.tilt_pivot * 1e-3,
        turn_pivot=machine.turn_pivot * 1e-3,
    )
    got = run_path(tips * 1e-3, axes, small)
    want = run_path(tips, axes, machine)
    assert_close(got[:, :3], want[:, :3] * 1e-3, rtol=1e-9, atol=1e-12)
    assert_close(got[:, 3:], want[:, 3:])


def test_single_precision(machine):
    """Nothing forces 64 bits."""
    single = jax.tree.map(lambda x: x.astype(jnp.float32), machine)
    tips, axes = poses(20)
    got = run_path(tips.astype(jnp.float32), axes.astype(jnp.float32), single)
    assert got.dtype == jnp.float32
    assert_close(got, inverse_path(tips, axes, machine), rtol=1e-4, atol=1e-3)
