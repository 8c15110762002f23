"""Kinematics: there and back is the identity, and the pole is harmless."""

import dataclasses
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close, assert_gradient
from polishopt.files import library
from polishopt.files.assemble import machine as assembled
from polishopt.files.shop import Machine as Section
from polishopt.machine import Kind, faults, forward, inverse, inverse_path, reasons, route
from polishopt.machine.kinematics import (
    _angle,
    direction,
    motion,
    positions,
    reach,
    sides,
)
from polishopt.parts import Machine


run_path = jax.jit(inverse_path)
run_route = eqx.filter_jit(route)
PRESETS = library.names("machines")
# chains and directions that no preset has: an oblique table, a linear axis that a rotary
# one carries, and an axis of turned sign
ODD = {
    "oblique": ("w C B b X Y Z t", {4 - 1: (0.0, 1.0, 1.0)}),
    "carried": ("w C X A b Y Z t", {}),
    "quill": ("w b X Y C Z A t", {}),
    "sign": ("w X Y C b Z B t", {4: (0.0, 0.0, -1.0), 0: (-1.0, 0.0, 0.0)}),
}


def limited(**changes):
    """A machine with numbers everywhere, so that nothing is there by chance."""
    given = {
        "max_speed": [500.0, 500.0, 500.0, 1.571, 2.094],
        "max_acceleration": [2500.0, 3000.0, 2100.0, 5.2, 5.2],
        "max_jerk": [5e3, 5e3, 5e4, 31.0, 310.0],
        "pivots": [[0.02, -0.05, 0.1], [0.03, -0.02, 62.1]],
    }
    return Machine(**(given | changes))


@pytest.fixture
def machine():
    return limited()


def of(name, **changes):
    """A preset, or an odd machine, with pivots, and a part that stands aside."""
    changes = {
        "pivots": [[1.0, -2.0, 250.0], [12.0, 3.0, -40.0]],
        "offset": [5.0, -7.0, 11.0],
        "wedge": [0.1, -0.2, 0.3],
    } | changes
    if name in ODD:
        chain, turned = ODD[name]
        plain = limited(chain=chain)
        ways = tuple(turned.get(k, direction(plain, k)) for k in range(5))
        return limited(chain=chain, directions=ways, **changes)
    made = assembled(
        Section.model_validate({"preset": name, **library.preset("machines", name)})
    )
    return dataclasses.replace(made, **changes)


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


@eqx.filter_jit
def there_and_back(tips, axes, machine):
    """Positions by both solutions, and the poses that they give."""

    def one(tip, axis, branch):
        found = inverse(tip, axis, machine, branch=branch)
        return found, *forward(found, machine)

    return [
        jax.vmap(functools.partial(one, branch=branch))(tips, axes) for branch in (0, 1)
    ]


@pytest.mark.parametrize("name", [*PRESETS, "carried", "quill", "sign"])
def test_forward_undoes_inverse(name):
    """On a hundred thousand poses, by either solution."""
    tips, axes = poses(100_000)
    both = there_and_back(tips, axes, of(name))
    for _, got_tips, got_axes in both:
        assert_close(got_tips, tips, rtol=0, atol=1e-10)
        assert_close(got_axes, axes, rtol=0, atol=1e-12)
    # and they are two
    apart = jnp.sin(0.5 * (both[0][0] - both[1][0])[:, 3:])
    assert jnp.max(jnp.abs(apart)) > 0.1


@pytest.mark.parametrize("name", ["mikron_ucp710", "head_head_ca", *ODD])
def test_motion_is_the_derivatives_of_the_positions(name):
    """Once and twice along a path, and by what the path is made of, in reverse too."""
    rng = np.random.default_rng(4)
    tips, angles = (jnp.asarray(rng.normal(size=(3, n))) for n in (3, 2))
    machine = of(name)

    def known(tips, angles):
        return jnp.stack(motion(list(tips), [tuple(a) for a in angles], machine))

    def plain(tips, angles):
        def at(t):
            tip, turned = (x[0] + t * x[1] + t**2 / 2 * x[2] for x in (tips, angles))
            return positions(tip, tuple(turned), machine)

        slope, bend = jax.jacfwd(at), jax.jacfwd(jax.jacfwd(at))
        return jnp.stack([f(jnp.zeros(())) for f in (at, slope, bend)])

    for take in (lambda f: f, lambda f: jax.jacfwd(f, (0, 1)), lambda f: jax.jacrev(f, 1)):
        got, want = (jax.jit(take(f))(tips, angles) for f in (known, plain))
        for a, b in zip(jax.tree.leaves(got), jax.tree.leaves(want), strict=True):
            assert_close(a, b, rtol=1e-10, atol=1e-9)


def test_an_angle_has_the_derivatives_of_the_arctangent():
    """Up to the third order."""
    x = jnp.asarray([0.3, -0.4])

    def third(f):
        return jax.jacfwd(jax.jacfwd(jax.jacrev(lambda x: f(x[0], x[1]))))(x)

    assert_close(third(_angle), third(jnp.arctan2), rtol=1e-12, atol=1e-12)


def test_an_oblique_axis_reaches_half_the_sphere():
    """Turned about an axis at 45 degrees, the tool gets as far as the horizontal."""
    tips, axes = poses(2000)
    machine = of("oblique", wedge=[0.0, 0.0, 0.0])
    within = np.asarray(jax.jit(jax.vmap(lambda u: reach(u, machine)))(axes)) >= 0.0
    np.testing.assert_array_equal(within, np.asarray(axes)[:, 2] >= 0.0)
    for found, got_tips, got_axes in there_and_back(tips, axes, machine):
        assert np.isfinite(found).all()
        assert_close(got_tips, tips, rtol=0, atol=1e-10)
        assert_close(got_axes[within], axes[within], rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", [*PRESETS, "carried", "quill", "sign"])
def test_forward_is_the_chain_as_matrices(name):
    """The links one by one as 4 x 4 matrices: tool and part meet where they should."""
    machine = of(name)

    def matrix(way, angle=0.0, move=0.0, pivot=(0.0, 0.0, 0.0)):
        x, y, z = way
        skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        out = np.eye(4)
        out[:3, :3] += np.sin(angle) * skew + (1 - np.cos(angle)) * skew @ skew
        out[:3, 3] = move * np.asarray(way) + pivot - out[:3, :3] @ pivot
        return out

    rng = np.random.default_rng(1)
    q = rng.uniform(-2, 2, 5).tolist()
    back = [np.asarray(x) for x in jax.jit(forward)(jnp.asarray(q), machine)]
    table, head = sides(machine)

    def link(axis, sign):
        if axis > 2:
            return matrix(direction(machine, axis), q[axis], 0, machine.pivots[axis - 3])
        return matrix(direction(machine, axis), move=sign * q[axis])

    tool = np.linalg.multi_dot(
        [np.eye(4), np.eye(4), *[link(a, 1) for a in reversed(head)]]
    )
    part = np.linalg.multi_dot(
        [np.eye(4), np.eye(4), *[link(a, -1) for a in reversed(table)]]
    )
    origin = np.asarray(machine.offset)
    rotary = [axis for axis in table if axis > 2]
    if rotary:
        origin = origin + np.asarray(machine.pivots)[rotary[0] - 3]
    placed = matrix((0, 0, 1), move=0)
    for way, angle in zip(np.eye(3), machine.wedge, strict=True):
        placed = matrix(way, float(0.0 if angle is None else angle)) @ placed
    placed[:3, 3] = origin
    tip = part @ placed @ [*back[0], 1.0]
    np.testing.assert_allclose(tip, tool @ [0, 0, 0, 1], atol=1e-10)
    way = part @ placed @ [*back[1], 0.0]
    np.testing.assert_allclose(way, tool @ [0, 0, 1, 0], atol=1e-12)


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
        tilts, turns = np.asarray(machine.pivots)
        at = tilts + tilt @ (turns - tilts + turn @ tip)
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
    small = eqx.tree_at(lambda m: m.pivots, machine, machine.pivots * 1e-3)
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


def crossing(miss, n=201):
    """A tool axis that leans from one side to the other, `miss` beside the pole."""
    lean = jnp.linspace(-0.2, 0.2, n)
    axes = jnp.stack([jnp.full(n, miss), lean, jnp.ones(n)], axis=1)
    return jnp.zeros((n, 3)), axes / jnp.linalg.norm(axes, axis=1, keepdims=True)


@pytest.mark.parametrize("name", PRESETS)
@pytest.mark.parametrize("miss", [0.0, 1e-6])
def test_a_route_across_the_pole_is_continuous(name, miss):
    """It changes to the other solution, says so, and gradients stay finite."""
    machine = of(name, wedge=[0.0, 0.0, 0.0])
    free = eqx.tree_at(
        lambda m: (m.lower, m.upper), machine, (jnp.full(5, -jnp.inf), jnp.full(5, jnp.inf))
    )
    tips, axes = crossing(miss)
    found = run_route(tips, axes, free)
    steps = np.abs(np.diff(found.axes[:, 3:], axis=0)).max()
    assert steps < 0.02
    assert np.ptp(found.branch) == 1
    assert not faults(found, free)
    assert any("crosses the pole" in reason for reason in reasons(found, free))
    back = jax.jit(jax.vmap(forward, in_axes=(0, None)))(found.axes, free)
    assert_close(back[1], axes, rtol=0, atol=1e-5)
    # with the branch kept, the rotary axis next to the part turns by half a turn
    kept = run_path(tips, axes, free)
    assert np.abs(np.diff(kept[:, 3:], axis=0)).max() > 1.0
    slope = eqx.filter_jit(jax.grad(lambda u: jnp.sum(route(tips, u, free).axes)))(axes)
    assert np.isfinite(slope).all()


def test_a_route_stays_within_travel():
    """By the solution and the whole turns it takes, and the reasons name them."""
    turn = jnp.linspace(2.0, 7.0, 40)
    tips, axes = jnp.zeros((40, 3)), axis_at(jnp.full(40, 0.5), turn)
    low, high = [-jnp.inf] * 3, [jnp.inf] * 3
    one_way = limited(lower=[*low, -2.0, -8.0], upper=[*high, 0.1, 3.0])
    found = run_route(tips, axes, one_way)
    assert_close(found.axes[:, 3], -0.5)
    assert_close(found.axes[:, 4], turn - 3 * np.pi)
    assert not faults(found, one_way)
    said = " ".join(reasons(found, one_way))
    assert "with the other one C or A leaves its travel" in said
    assert "C begins 1 turn lower, to stay within its travel" in said


def test_what_cannot_be_run_is_a_sentence():
    turn = jnp.linspace(0.0, 7.0, 40)
    tips, axes = jnp.zeros((40, 3)), axis_at(jnp.linspace(0.1, 0.5, 40), turn)
    low, high = [-jnp.inf] * 3, [jnp.inf] * 3
    narrow = limited(
        lower=[*low, -0.3, -3.0],
        upper=[*high, 0.3, 3.0],
        max_speed=[1.0, 1.0, 1.0, 1.0, 0.0],
    )
    got = faults(run_route(tips, axes, narrow), narrow)
    assert [(fault.kind, fault.axis) for fault in got] == [
        (Kind.TRAVEL, "A"),
        (Kind.TRAVEL, "C"),
        (Kind.SPEED, "C"),
    ]
    assert got[0].sample == 20
    assert "axis A leaves its travel at sample 20 of 40" in got[0].sentence
    assert "28.6479 °, must lie in [-17.1887, 17.1887] °" in got[0].sentence
    assert "axis C has to move at sample 0, but its largest speed is 0" in got[2].sentence
    oblique = of("oblique", wedge=[0.0, 0.0, 0.0])
    _, axes = poses(30)
    (got, *_) = faults(run_route(jnp.zeros((30, 3)), axes, oblique), oblique)
    assert (got.kind, got.sample) == (
        Kind.REACH,
        int(np.argmax(np.asarray(axes)[:, 2] < 0)),
    )
    assert "do not reach this orientation" in got.sentence
