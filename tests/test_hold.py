"""Hold: force or pressure that stay the same on a part whose curvature changes."""

import dataclasses
import functools
import math
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close, assert_gradient
from polishopt.contact.limits import most_displacement, shear_margin
from polishopt.contact.pressure import force_and_area, patch
from polishopt.files.assemble import job
from polishopt.files.config import load
from polishopt.hold import held_displacement, loop_bend, schedule
from polishopt.mechanics import mechanics
from polishopt.path.families import hilbert
from polishopt.path.surface import curvature
from polishopt.path.toolpath import resolved
from polishopt.setup import Sampling


CONFIG = Path(__file__).parent.parent / "configs" / "pessoles2009_diamond.yaml"
SIDES = (24.0, 24.0)
# flat, convex, a groove, a saddle with twist, and a hollow that is wider than the disc
BENDS = [
    [[0.0, 0.0], [0.0, 0.0]],
    [[0.02, 0.0], [0.0, 0.02]],
    [[0.0, 0.0], [0.0, 0.03]],
    [[0.01, 0.012], [0.012, -0.01]],
    [[-0.004, 0.0], [0.0, -0.003]],
]


def crown(xy):
    """Bends four times as much across as along, and less further out."""
    x, y = xy[0] - SIDES[0] / 2, xy[1] - SIDES[1] / 2
    return jnp.stack([x, y, -(x**2) / 240 - y**2 / 60 + y**4 / 140**3])


@functools.cache
def felt(hold="force"):
    """Felt on that crown."""
    made, size = job(load(CONFIG).config), jnp.asarray(SIDES)
    sampling = Sampling(stations=2, phases=8, rows=6, columns=6, pixels=(8, 8))
    setup = dataclasses.replace(
        made.setup,
        surface=crown,
        size=size,
        guide=hilbert(2, SIDES),
        sampling=sampling,
        hold=hold,
        concave=True,
    )
    values = [jnp.asarray(x) for x in (1.0, 1.5, 0.2, math.radians(6))]
    process = eqx.tree_at(
        lambda p: (p.step, p.trochoid_radius, p.displacement, p.tilt), made.process, values
    )
    return process, setup


@eqx.filter_jit
def contacts(process, setup, bends):
    """Force, mean pressure and displacement at each bend; and the force by a patch."""

    def at(bend):
        e = held_displacement(process, setup, bend)
        given = (
            dataclasses.replace(process, displacement=e),
            setup.tool,
            bend,
            setup.side,
        )
        force, area = force_and_area(*given, setup.panels)
        return force, force / area, e, patch(*given, 64, 4, setup.panels).force

    return jax.vmap(at)(bends)


@pytest.mark.parametrize("hold", ["force", "pressure"])
def test_every_contact_is_as_on_a_plane(hold):
    process, setup = felt(hold)
    force, pressure, e, again = contacts(process, setup, jnp.asarray(BENDS))
    held = force if hold == "force" else pressure
    assert_close(held, held[0], rtol=1e-9)
    assert_close(again, force, rtol=1e-5)
    assert_close(e[0], process.displacement)
    # what bends away from the disc has to be pressed in deeper for the same force
    if hold == "force":
        assert e[1] > e[0]
        assert e[4] < e[0]


def test_displacement_ends_at_the_rigid_body_and_at_the_adhesive():
    process, setup = felt()
    bends = jnp.asarray(BENDS)
    _, _, free, _ = contacts(process, setup, bends)
    most = 0.5 * (free.max() + free.min())
    body = setup.tool.body_recess + most - most_displacement(process, setup.tool)
    low = eqx.tree_at(lambda s: s.tool.body_recess, setup, body)
    top = most_displacement(process, low.tool)
    assert_close(contacts(process, low, bends)[2], np.minimum(free, top), rtol=1e-8)
    assert np.any(free > top)
    weak = eqx.tree_at(
        lambda s: (s.tool.shear_strength, s.tool.friction, s.tool.stiffening),
        setup,
        (jnp.asarray(0.02), jnp.asarray(0.3), jnp.asarray(0.4)),
    )
    end = most_displacement(process, weak.tool)
    at_end = dataclasses.replace(process, displacement=end)
    assert_close(shear_margin(at_end, weak.tool), 0.0, atol=1e-12)


def test_gradients_are_those_of_the_solution():
    process, setup = felt()
    bend = jnp.asarray(BENDS[3])

    def f(x):
        here = dataclasses.replace(process, tilt=x[0], displacement=x[1])
        return held_displacement(here, setup, x[2] * bend)

    assert_gradient(f, [math.radians(6), 0.2, 1.0], rtol=1e-5)


def test_without_a_displacement_nothing_is_held():
    process, setup = felt()
    bend = jnp.asarray(BENDS[1])

    def f(e):
        here = dataclasses.replace(process, displacement=e)
        return held_displacement(here, setup, bend)

    value, slope = jax.jit(jax.value_and_grad(f))(jnp.asarray(0.0))
    assert value == 0.0
    assert np.isfinite(slope)


@eqx.filter_jit
def along_the_path(process, setup, s):
    """Force in every loop, by what bends under the disc there; and how deep its tip is."""
    held = schedule(process, setup)
    assert held is not None
    radius, lean = setup.tool.radius, (setup.pulling, setup.lean)
    path = resolved(
        setup.surface, setup.guide, process, radius, s, *lean, displacement=held
    )
    plain = resolved(setup.surface, setup.guide, process, radius, s, *lean)

    def force(e, bend):
        pressed = dataclasses.replace(process, displacement=e)
        return force_and_area(pressed, setup.tool, bend, setup.side, setup.panels)[0]

    def at(xy, f, b, e):
        return force(e, curvature(setup.surface, xy, f, b))

    e = jax.vmap(held)(s)
    forces = jax.vmap(at)(path.xy, path.feed_direction, path.side, e)
    deeper = jnp.sum((plain.tip - path.tip) * path.normal, axis=1)
    exact = jax.vmap(
        lambda s: held_displacement(process, setup, loop_bend(process, setup, s))
    )(s)
    flat = force(process.displacement, jnp.zeros((2, 2)))
    return forces, e, deeper, exact, flat


def test_force_is_constant_along_the_path():
    """To 1 %, in every loop."""
    process, setup = felt()
    s = jnp.linspace(0.0, setup.guide.length, 1501)
    forces, e, deeper, exact, flat = along_the_path(process, setup, s)
    assert_close(forces, flat, rtol=0.01)
    assert_close(e, exact, rtol=2e-3)
    assert_close(deeper, e - process.displacement, atol=1e-12)
    bend = np.diff(e, 2) / float(s[1] - s[0]) ** 2  # smooth: no jumps in its slope
    assert np.abs(np.diff(bend)).max() < 0.2 * np.ptp(bend)
    assert np.ptp(e) > 0.01 * process.displacement
    done = eqx.filter_jit(mechanics)(process, setup)
    assert_close(done.force_min, flat, rtol=1e-6)
    assert_close(done.force_max, flat, rtol=1e-6)
    most = most_displacement(process, setup.tool)
    assert_close(done.body_clearance, most - done.displacement_max)
    assert done.displacement_max > process.displacement


def test_the_switch_is_a_key_of_the_config():
    assert job(load(CONFIG, ["guide.hold=force"]).config).setup.hold == "force"
    assert not job(load(CONFIG, ["guide.hold=force"]).config).setup.holds  # a plane
