"""Direction: which way grains slide over a place, and the lay that they leave."""

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from helpers import assert_close, assert_gradient
from polishopt.parts import Abrasive, Process, Tool
from polishopt.texture.direction import slid_directions
from polishopt.texture.evolution import draw_patch
from polishopt.texture.scratches import compression, groove_depth
from polishopt.texture.spatial import spatial_parameters


S = jnp.asarray
TOOL = Tool(9.0, 0.3, 7.0, 2.0, [0.0, 0.2], [10.0, 10.0])
ABRASIVE = Abrasive(1e-8, 1e-3, 0.05, np.radians(60), 5490.0, 5.0, 0.0, 0.08)
BINS = 24


def process(tilt, displacement, **changes):
    given = {"step": 1.0, "trochoid_radius": 3.0, "feed": 16.7, "spin": 209.0}
    return Process(tilt=tilt, displacement=displacement, **(given | changes))


slid = jax.jit(slid_directions, static_argnames="lean")


def test_a_full_disc_cuts_in_all_directions_alike():
    weights = slid(process(1e-9, 0.4), TOOL)
    assert_close(jnp.sum(weights), 1.0)
    assert_close(weights, 1 / BINS, rtol=0.12)
    assert_close(weights, weights[::-1], rtol=1e-6)  # left and right of the guide


@pytest.mark.parametrize("heading", [0.0, 30.0, 120.0])
def test_a_rim_cuts_across_the_lean(heading):
    weights = slid(process(0.3, 0.05), TOOL, S([np.radians(heading)]))
    middle = (np.arange(BINS) + 0.5) * 180 / BINS
    mean = np.sum(np.asarray(weights) * np.exp(2j * np.radians(middle)))
    assert_close(np.degrees(np.angle(mean)) / 2 % 180, (heading + 90) % 180, atol=0.5)
    assert abs(mean) > 0.97


@pytest.mark.parametrize(
    ("tilt", "displacement", "changes", "lean"),
    [
        pytest.param(0.05, 0.4, {}, 1.0, id="half a disc"),
        pytest.param(0.15, 0.3, {"spin": 6.0, "step": 9.0}, 1.0, id="slow spindle"),
        pytest.param(0.15, 0.3, {"spin": 6.0, "step": 9.0}, -1.0, id="pushing"),
    ],
)
def test_directions_agree_with_monte_carlo(tilt, displacement, changes, lean):
    """A million grains anywhere on the disc at any moment, with vectors in space."""
    at = process(tilt, displacement, **changes)
    got = np.asarray(slid(at, TOOL, lean=lean))
    rng, n, radius = np.random.default_rng(0), 1_000_000, 9.0
    r, turn = radius * np.sqrt(rng.uniform(size=n)), rng.uniform(0, 2 * np.pi, n)
    # the disc's plane through its lowest point, which is ahead of the centre when pushing
    down = np.array([lean * np.cos(tilt), 0.0, -np.sin(tilt)])
    beside = np.array([0.0, 1.0, 0.0])
    arms = (r * np.cos(turn))[:, None] * down + (r * np.sin(turn))[:, None] * beside
    axis = np.array([lean * np.sin(tilt), 0.0, np.cos(tilt)])
    height = (arms - radius * down)[:, 2]
    pressure = np.maximum(displacement - height, 0.0)
    phase = rng.uniform(0, 2 * np.pi, n)
    swirl = 2 * np.pi * float(at.trochoid_radius / at.step)
    way = np.stack([1 + swirl * np.cos(phase), -swirl * np.sin(phase), 0 * phase], axis=1)
    length = np.linalg.norm(way, axis=1)
    velocity = float(at.feed) * way / length[:, None]
    velocity = velocity + np.cross(float(at.spin) * axis, arms)
    volume = pressure * np.linalg.norm(velocity, axis=1) * length
    angle = np.arctan2(velocity[:, 1], velocity[:, 0]) % np.pi
    want = np.histogram(angle, BINS, (0, np.pi), weights=volume)[0]
    want = want / want.sum()
    # sharing nodes between neighbours smooths by half an interval
    smooth = 0.75 * want + 0.125 * (np.roll(want, 1) + np.roll(want, -1))
    assert_close(got, smooth, atol=0.06 * want.max())


def test_turning_the_guide_turns_the_directions():
    at = process(0.05, 0.4)
    along, across = slid(at, TOOL), slid(at, TOOL, S([np.pi / 2]))
    assert_close(across, jnp.roll(along, BINS // 2), rtol=1e-6, atol=1e-12)
    both = slid(at, TOOL, S([0.0, np.pi / 2]), S([0.75, 0.25]))
    assert_close(both, 0.75 * along + 0.25 * across)


def test_gradients_of_directions():
    def f(x):
        at = process(x[0], x[1], step=x[2], trochoid_radius=x[3], feed=x[4], spin=x[5])
        weights = slid_directions(at, TOOL, rows=4, columns=3, phases=4)
        return weights @ jnp.sin(jnp.arange(float(BINS)))

    assert_gradient(f, S([0.1, 0.4, 2.0, 3.0, 16.7, 30.0]), step=1e-6, rtol=1e-4, atol=1e-8)
    slope = jax.jit(jax.grad(f))
    for corner in (
        [0.1, 0.0, 2.0, 3.0, 16.7, 30.0],
        [0.0, 0.0, 2.0, 0.0, 16.7, 0.0],
        [0.1, 0.4, 2.0, 3.0, 0.0, 0.0],
        [0.0, 0.4, 2.0, 0.0, 0.0, 30.0],
    ):
        assert np.isfinite(slope(S(corner))).all(), corner
    still = slid(process(0.1, 0.4, feed=0.0, spin=0.0), TOOL)
    assert_close(still, 1 / BINS)


POINTS, SIDE = 96, 160.0  # of a patch, in groove depths


@jax.jit
def lay_of(key, directions):
    pressure = S(0.05)
    depth, worn = groove_depth(ABRASIVE, pressure), compression(ABRASIVE, pressure)
    extent = jnp.full(2, SIDE) * depth
    z = draw_patch(
        key,
        ABRASIVE,
        pressure,
        3 * worn,
        (POINTS, POINTS),
        extent,
        768,
        directions=directions,
    )
    return spatial_parameters(z, SIDE / POINTS)


def test_the_lay_of_drawn_patches():
    one = jnp.zeros(BINS).at[5].set(1.0)  # from 37.5 to 45 degrees
    lay = lay_of(jr.key(1), one)
    # unbroken scratches: no decay along them within the map, or a long one
    assert jnp.isnan(lay.Str) or lay.Str < 0.1
    assert_close(jnp.degrees(lay.Std), 41.25, atol=1.5)
    even = [float(lay_of(jr.key(k), jnp.ones(BINS)).Str) for k in range(6)]
    assert np.mean(even) > 0.6

    rim = slid(process(0.3, 0.05), TOOL, S([np.radians(20)]))
    lay = lay_of(jr.key(2), rim)
    assert lay.Str < 0.25
    assert_close(jnp.degrees(lay.Std), 110.0, atol=4.0)
