"""Jerk: closed forms, steady circles, a check between samples, gradients and faults."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close
from polishopt.machine import (
    Limits,
    check,
    exact_jerk_law,
    jerk_law,
    jerk_law_from_derivatives,
    limiting_name,
    time_law,
    usage,
)
from test_feed import LEAN, milling_centre, trochoid_axes


run = jax.jit(jerk_law, static_argnames="rest")
run_derivatives = jax.jit(jerk_law_from_derivatives, static_argnames="rest")
run_exact = jax.jit(exact_jerk_law, static_argnums=0)
used_by = jax.jit(usage, static_argnames=("path", "finer"))
without_jerk = jax.jit(time_law)
FAST = 1e4


@pytest.fixture(scope="module")
def limits():
    return Limits.of(milling_centre())


@pytest.mark.parametrize(
    ("length", "feed", "acceleration", "jerk", "time"),
    [(1.0, 0.5, 1.0, 10.0, 2.6), (0.001, 1e3, 1e3, 10.0, 0.147361260)],
)
def test_straight_move_takes_the_closed_form_time(length, feed, acceleration, jerk, time):
    """Seven segments: d/v + v/a + a/J; where only jerk acts: the third root of 32 d/J."""
    arc = jnp.linspace(0.0, length, 2001)
    limits = Limits([1e6], [acceleration], ("X",), [jerk])
    law = run(arc[:, None], limits, arc, jnp.asarray(feed))
    check(law, limits)
    assert time < law.total < 1.005 * time
    assert_close(law.time[-1], law.total, rtol=1e-12)
    assert_close(law.feed[np.array([0, -1])], 0.0)
    used = used_by(arc[:, None], law, limits, arc, jnp.asarray(feed))
    assert used.programmed < 1.001
    assert used.acceleration[0] < 1.001
    assert 0.99 < used.jerk[0] < 1.02


@pytest.mark.parametrize("radius", [6.0, 3.0, 1.0])
@pytest.mark.parametrize(
    ("acceleration", "jerk"),
    [(2500.0, 1e9), (2500.0, 5000.0)],
    ids=["acceleration", "jerk"],
)
def test_steady_circle_runs_at_the_closed_form_feed(radius, acceleration, jerk):
    r"""$\min(\sqrt{A r}, \sqrt[3]{J r^2})$, where the path hardly lets the feed change."""
    n = 193
    phase = jnp.linspace(0.0, 4.0 * jnp.pi, n)
    c, s = jnp.cos(phase), jnp.sin(phase)
    dq = [jnp.stack(x, axis=1) for x in ((-s, c), (-c / radius, -s / radius))]
    length = jnp.stack([jnp.ones(n), jnp.zeros(n), jnp.zeros(n)], axis=1)
    limits = Limits(
        [1e6, 1e6],
        [acceleration, acceleration],
        ("X", "Y"),
        jerk=[jerk, jerk],
        path_acceleration=1e-3 * acceleration,
        path_jerk=1e9,
    )
    law = run_derivatives(
        *dq,
        -dq[0] / radius**2,
        limits,
        length,
        radius * phase,
        jnp.asarray(FAST),
        (False, False),
    )
    check(law, limits)
    want = min(math.sqrt(acceleration * radius), (jerk * radius**2) ** (1 / 3))
    known = {6.0: (7348, 3388), 3.0: (5196, 2134), 1.0: (3000, 1026)}[radius][jerk < 1e6]
    assert_close(60 * want, known, rtol=3e-3)
    assert_close(law.feed[n // 4 : -n // 4], want, rtol=0.02)
    names = {limiting_name(k, limits.names) for k in np.asarray(law.limiting)}
    assert any(name.endswith("jerk" if jerk < 1e6 else "acceleration") for name in names)


@pytest.mark.parametrize("tilt", [LEAN, math.radians(15.0)])
@pytest.mark.parametrize("feed", [1000 / 60, 8000 / 60])
@pytest.mark.slow
def test_limits_hold_between_the_samples(limits, tilt, feed):
    """On a 5-axis trochoid of 64 samples a loop, looked at ten times as closely."""
    axes, arc, s = trochoid_axes(tilt)
    feed = jnp.asarray(feed)
    law = run(axes, limits, arc, feed, s)
    check(law, limits)
    used = used_by(axes, law, limits, arc, feed, s)
    assert used.programmed < 1.001
    assert used.speed.max() < 1.001
    assert used.acceleration.max() < 1.02
    assert 0.98 < used.jerk.max() < 1.03
    # what jerk costs is not less than nothing, nor does it cost everything
    free = without_jerk(axes, limits, arc, feed, s).total
    assert 0.999 * free < law.total < 1.5 * free


def test_repeated_samples_cost_nothing(limits):
    """Whether they stand at the end, where they pad a path, or within it."""
    axes, arc, s = trochoid_axes()
    n, half = arc.size, arc.size // 2
    index = jnp.minimum(jnp.arange(n), half)
    want = run(axes[index], limits, arc[index], jnp.asarray(50.0), s[index])
    check(want, limits)
    within = jnp.concatenate([jnp.arange(50), jnp.full(30, 49), jnp.arange(49, n - 31)])
    within = jnp.minimum(within, half)
    got = run(axes[within], limits, arc[within], jnp.asarray(50.0), s[within])
    check(got, limits)
    assert_close(want.time[half], want.total, rtol=1e-12)
    assert_close(got.total, want.total, rtol=2e-3)
    assert_close(got.feed, want.feed[within], rtol=2e-2, atol=0.5)


def whip(s):
    """Past the pole, C turns by almost half a turn within a tenth of a millimetre."""
    return jnp.stack([s, jnp.arctan2(s - 5.0, 0.02)]), jnp.stack([s, 0.0 * s, 0.0 * s])


def whipped(s):
    """Its axes alone."""
    return whip(s)[0]


def test_limits_hold_between_samples_of_a_whip():
    """With the derivatives of the path itself, and by its motion put together by hand."""
    n, feed = 401, 50.0
    # closer together where C turns: 27 samples in a length of 0.02 mm
    even = jnp.linspace(-1.0, 1.0, n)
    sigma = 5.0 + 5.0 * jnp.sinh(6.0 * even) / jnp.sinh(6.0)
    limits = Limits([500.0, 2.0], [2500.0, 50.0], ("X", "C"), [5e3, 5e3])
    law = run_exact(whip, sigma, limits, jnp.asarray(feed))
    check(law, limits)
    used = used_by(
        jax.vmap(whip)(sigma)[0],
        law,
        limits,
        sigma,
        jnp.asarray(feed),
        path=whipped,
    )
    assert used.programmed <= 1.001
    assert used.speed.max() <= 1.001
    assert used.acceleration.max() <= 1.001
    assert used.jerk.max() <= 1.02
    # C is fastest at the pole itself: 1 / 0.02 of the feed
    assert_close(law.feed[n // 2], 2.0 * 0.02, rtol=0.02)


@pytest.mark.slow
def test_gradients_are_those_of_differences(limits):
    """By limits, programmed feed and the path itself, in one reverse pass."""
    axes, arc, s = trochoid_axes()
    bump = jnp.exp(-(((arc / arc[-1] - 0.5) / 0.1) ** 2))[:, None]
    bump = bump * jnp.asarray([[1.0, -1.0, 1.0, 0.1, 0.1]])

    def total(x):
        scaled = Limits(limits.speed, limits.acceleration * x[0], jerk=limits.jerk * x[1])
        return jerk_law(axes + x[3] * bump, scaled, arc, 30.0 * x[2], s).total

    start = jnp.asarray([1.0, 1.0, 0.6, 1.0])
    both = jax.jit(jax.value_and_grad(total))
    slope = both(start)[1]
    step = 1e-4
    for i in range(start.size):
        e = jnp.zeros_like(start).at[i].set(step)
        change = (both(start + e)[0] - both(start - e)[0]) / (2 * step)
        assert_close(slope[i], change, rtol=5e-3, atol=1e-4)


@functools.cache
def broken(what):
    axes, arc, s = trochoid_axes()
    limits, feed = Limits.of(milling_centre()), 50.0
    speed, jerk = limits.speed, limits.jerk
    if what == "speed":
        speed = speed.at[4].set(0.0)
    assert jerk is not None
    if what == "jerk":
        jerk = jerk.at[0].set(-1.0)
    if what == "path":
        axes = axes.at[100, 3].set(jnp.nan)
    if what == "feed":
        feed = 0.0
    limits = Limits(speed, limits.acceleration, jerk=jerk)
    return run(axes, limits, arc, jnp.asarray(feed), s), limits


@pytest.mark.parametrize(
    ("what", "words"),
    [
        ("speed", r"axis C has to move at sample 0, but its largest speed is 0"),
        ("jerk", r"axis X has to move at sample 0, but its largest jerk is -1"),
        ("path", r"not finite at sample (98|99|100).*axis A"),
        ("feed", "programmed feed must be a positive"),
    ],
)
def test_what_cannot_be_run_is_said_in_a_sentence(what, words):
    law, limits = broken(what)
    with pytest.raises(ValueError, match=words):
        check(law, limits)


def test_too_few_samples_have_no_third_derivative(limits):
    with pytest.raises(ValueError, match="at least 6"):
        jerk_law(jnp.zeros((5, 5)), limits, jnp.arange(5.0), jnp.asarray(1.0))
