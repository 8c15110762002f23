"""Feed: closed forms, an independent linear program, and a check between the samples."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
import scipy.sparse
from helpers import assert_close, assert_gradient
from polishopt.machine import (
    Limits,
    derivatives,
    inverse,
    inverse_path,
    limiting_name,
    time_law,
    time_law_from_derivatives,
    usage,
)
from polishopt.machine.feed import sweep
from polishopt.parts import AXES, Machine


run = jax.jit(time_law, static_argnames="rest")
run_derivatives = jax.jit(time_law_from_derivatives, static_argnames="rest")
check = jax.jit(usage, static_argnames="path")
FAST = 1e4
LEAN = math.radians(8.0)


@functools.cache
def milling_centre():
    return Machine(
        max_speed=[500.0, 500.0, 500.0, math.pi / 2, 2 * math.pi / 3],
        max_acceleration=[2500.0, 3000.0, 2100.0, 5.2, 5.2],
        max_jerk=[5e3, 5e3, 5e4, 31.0, 310.0],
        offset=[0.0, 0.0, 50.0],
    )


@pytest.fixture
def limits():
    return Limits.of(milling_centre())


def xy(acceleration, speed=1e6):
    return Limits(
        speed=[speed, speed], acceleration=[acceleration, acceleration], names=("X", "Y")
    )


def circle(radius, n):
    """Derivatives by arc length of X and Y on a circle, and the spacing."""
    phase = jnp.linspace(0.0, 2 * jnp.pi, n + 1)[:-1]
    dq = jnp.stack([-jnp.sin(phase), jnp.cos(phase)], axis=1)
    ddq = -jnp.stack([jnp.cos(phase), jnp.sin(phase)], axis=1) / radius
    return dq, ddq, jnp.full(n, 2 * math.pi * radius / n)


@jax.jit
def turns(dq, ddq, spacing, feed, limits):
    """Second of three turns on a closed loop: it knows nothing of how they start or end."""
    n = spacing.size
    dq, ddq, spacing = (jnp.concatenate([x, x, x]) for x in (dq, ddq, spacing))
    b = sweep(dq, ddq, jnp.ones(3 * n), spacing[:-1], feed, limits)
    return b[n : 2 * n]


def trochoid(loops, per_loop, tilt=LEAN, dome=100.0, radius=3.0, step=1.0):
    """Pose of a leant tool along a trochoid on a dome, by the guide's arc length."""
    bend = 20.0  # radius of the guide, a circle on the dome

    def pose(s):
        turn = s / bend
        along = jnp.stack([-jnp.sin(turn), jnp.cos(turn)])
        across = jnp.stack([jnp.cos(turn), jnp.sin(turn)])
        phase = 2 * jnp.pi * s / step
        flat = bend * across + radius * (jnp.cos(phase) * across + jnp.sin(phase) * along)
        height = jnp.sqrt(dome**2 - flat @ flat)
        normal = jnp.append(flat, height) / dome
        heading = jnp.append(along, 0.0)
        heading = heading - (heading @ normal) * normal
        heading = heading / jnp.sqrt(heading @ heading)
        axis = jnp.cos(tilt) * normal + jnp.sin(tilt) * heading
        return jnp.append(flat, height - dome), axis

    return pose, jnp.linspace(0.0, loops * step, loops * per_loop + 1)


@functools.cache
def trochoid_axes(tilt=LEAN, loops=5, per_loop=64):
    """Axis positions, contact length and guide length of that trochoid."""
    pose, s = trochoid(loops, per_loop, tilt=tilt)

    @jax.jit
    def sampled(s):
        tips, tools = jax.vmap(pose)(s)
        speed = jax.vmap(lambda s: jnp.linalg.norm(jax.jvp(pose, (s,), (1.0,))[1][0]))(s)
        steps = 0.5 * (s[1] - s[0]) * (speed[1:] + speed[:-1])
        arc = jnp.pad(jnp.cumsum(steps), (1, 0))
        return inverse_path(tips, tools, milling_centre()), arc

    return *sampled(s), s


@functools.cache
def trochoid_path():
    """Axis positions of that trochoid as a function of the guide's length."""
    pose, _ = trochoid(1, 1)
    start = trochoid_axes()[0][0]
    return lambda s: inverse(*pose(s), milling_centre(), near=start)


def names_of(law, names=AXES):
    return [limiting_name(code, names) for code in np.asarray(law.limiting)]


@pytest.mark.parametrize("n", [11, 101, 1001])
@pytest.mark.parametrize(
    ("length", "feed"), [(100.0, 50.0), (100.0, 200.0), (20.0, 50.0), (1e-3, 50.0)]
)
def test_straight_move_takes_the_closed_form_time(n, length, feed):
    """Trapezoid d/v + v/a, or triangle 2 sqrt(d/a) where v is never reached.

    The corners of the trapezoid lie between samples, which costs up to one sample.
    """
    accel = 100.0
    limits = Limits(speed=[1e3], acceleration=[accel], names=("X",))
    arc = jnp.linspace(0.0, length, n)
    law = run(arc[:, None], limits, arc, feed)
    ramps = feed**2 / accel < length
    want = length / feed + feed / accel if ramps else 2 * math.sqrt(length / accel)
    assert law.time[-1] >= want * (1 - 1e-12)
    assert_close(law.time[-1], want, rtol=1e-9 if not ramps else 8.0 / n**2)
    assert_close(law.feed[np.array([0, -1])], 0.0)


def test_axis_speed_limits_a_straight_move():
    """Along (3, 4)/5 an X limit of 30 mm/s is a feed of 50 mm/s."""
    arc = jnp.linspace(0.0, 200.0, 101)
    axes = jnp.stack([0.6 * arc, 0.8 * arc], axis=1)
    limits = Limits(speed=[30.0, 1e3], acceleration=[60.0, 1e3], names=("X", "Y"))
    law = run(axes, limits, arc, FAST)
    assert_close(law.time[-1], 200 / 50 + 50 / 100, rtol=8.0 / 101**2)
    names = names_of(law, limits.names)
    assert names[0] == names[-1] == "start or end"
    assert names[1] == names[-2] == "X acceleration"
    assert names[50] == "X speed"


@pytest.mark.parametrize("radius", [6.0, 3.0, 1.0])
@pytest.mark.parametrize("n", [24, 64, 512])
def test_circle_is_slowest_where_one_axis_carries_it_all(radius, n):
    r"""On a circle the optimum dips to $\sqrt{A r}$ four times, and is known in between.

    Where one axis has all the centripetal acceleration (phases 0, 90, ... degrees) the
    feed is $\sqrt{A r}$: 7348, 5196, 3000 mm/min at 2.5 m/s^2. In between the limits are
    per axis, so the optimum is faster: with $y = b/(A r)$ the limit on X reads
    $(y'/2) \sin\phi + y \cos\phi = 1$, so $v = \sqrt{A r}/\cos(\phi/2)$ up to 45 degrees
    and one turn takes $16 \sin(\pi/8) \sqrt{r/A}$.
    """
    accel = 2500.0
    dq, ddq, h = circle(radius, n)
    b = turns(dq, ddq, h, FAST, xy(accel))
    slow = math.sqrt(accel * radius)
    assert_close(jnp.sqrt(b.min()), slow, rtol=1e-9)
    known = {6.0: 7348, 3.0: 5196, 1.0: 3000}[radius]
    assert_close(60 * jnp.sqrt(b.min()), known, rtol=2e-3)
    rate = jnp.sqrt(b)
    time = jnp.sum(2 * h / (rate + jnp.roll(rate, -1)))
    exact = 16 * math.sin(math.pi / 8) * math.sqrt(radius / accel)
    # limits hold over whole intervals, which near 45 degrees costs one sample of gain
    assert exact * (1 - 1e-6) < time < exact * (1 + 0.12 / n)
    phase = jnp.linspace(0.0, 2 * jnp.pi, n + 1)[:-1]
    to_axis = jnp.abs((phase + jnp.pi / 4) % (jnp.pi / 2) - jnp.pi / 4)
    assert_close(rate, slow / jnp.cos(to_axis / 2), rtol=0.4 / n)


def test_circle_at_a_programmed_feed_below_its_limit_keeps_that_feed():
    dq, ddq, h = circle(6.0, 24)
    b = turns(dq, ddq, h, 100.0, xy(2500.0))
    assert_close(jnp.sqrt(b), 100.0, rtol=1e-12)


def test_optimum_matches_a_linear_program():
    """A Lissajous figure in two axes against a sparse linear program.

    The oracle knows the path exactly, enforces its limits in the middle of each interval
    only, and asks HiGHS for the largest sum of b.
    """
    n = 1001
    s = np.linspace(0.0, 2.0, n)

    def place(s):
        return np.stack([30 * np.sin(2 * s), 20 * np.sin(3 * s + 0.4)], axis=1)

    def first(s):
        return np.stack([60 * np.cos(2 * s), 60 * np.cos(3 * s + 0.4)], axis=1)

    def second(s):
        return np.stack([-120 * np.sin(2 * s), -180 * np.sin(3 * s + 0.4)], axis=1)

    speed, accel = np.array([90.0, 110.0]), np.array([500.0, 400.0])

    h, mid = np.diff(s), 0.5 * (s[1:] + s[:-1])
    rows, bounds, step = [], np.full(n, np.inf), np.arange(n - 1)
    for axis in range(2):
        d1, d2 = first(mid)[:, axis], second(mid)[:, axis]
        left, right = d2 / 2 - d1 / (2 * h), d2 / 2 + d1 / (2 * h)
        entries = np.concatenate([left, right]) / accel[axis]
        place_of = (np.tile(step, 2), np.concatenate([step, step + 1]))
        half = scipy.sparse.coo_array((entries, place_of), shape=(n - 1, n))
        rows += [half, -half]
        bounds = np.minimum(bounds, (speed[axis] / np.abs(first(s)[:, axis])) ** 2)
    bounds[[0, -1]] = 0.0
    stack = scipy.sparse.vstack(rows).tocsr()
    answer = scipy.optimize.linprog(
        -np.ones(n), stack, np.ones(4 * (n - 1)), bounds=[(0.0, x) for x in bounds]
    )
    assert answer.x is not None
    rate = np.sqrt(np.maximum(answer.x, 0))
    want = np.sum(2 * h / (rate[1:] + rate[:-1]))

    limits = Limits(speed=speed, acceleration=accel, names=("X", "Y"))
    sigma = jnp.asarray(s)
    length = jnp.linalg.norm(jnp.asarray(first(s)), axis=1)
    exact = run_derivatives(
        jnp.asarray(first(s)), jnp.asarray(second(s)), limits, length, sigma, FAST
    )
    assert_close(exact.time[-1], want, rtol=1e-3)
    arc = jnp.pad(jnp.cumsum(0.5 * jnp.asarray(h) * (length[1:] + length[:-1])), (1, 0))
    sampled = run(jnp.asarray(place(s)), limits, arc, FAST)
    assert_close(sampled.time[-1], want, rtol=5e-3)
    # neither is the fastest by breaking a limit between the samples
    used = check(jnp.asarray(place(s)), sampled, limits, arc, FAST)
    assert max(used.speed.max(), used.acceleration.max()) < 1.001


@pytest.mark.parametrize("tilt", [LEAN, math.radians(15.0)])
def test_limits_hold_between_the_samples(limits, tilt):
    """On a 5-axis trochoid of 64 samples a loop, looked at ten times as closely."""
    axes, arc, s = trochoid_axes(tilt)
    for feed in (1000 / 60, 3000 / 60, 8000 / 60):
        for sigma in (None, s):
            law = run(axes, limits, arc, feed, sigma)
            used = check(axes, law, limits, arc, feed, sigma)
            shares = jnp.concatenate([used.programmed[None], used.speed, used.acceleration])
            assert 0.999 < shares.max() < 1.001


def test_limits_hold_on_the_true_path(limits):
    """The same against the path as a function, differentiated exactly."""
    axes, arc, s = trochoid_axes()
    for feed in (1000 / 60, 8000 / 60):
        law = run(axes, limits, arc, feed, s)
        used = check(axes, law, limits, arc, feed, s, trochoid_path())
        assert used.programmed < 1 + 1e-12
        assert max(used.speed.max(), used.acceleration.max()) < 1.001


def test_programmed_feed_is_never_exceeded_and_time_is_never_less(limits):
    axes, arc, s = trochoid_axes()
    for feed in (5.0, 20.0, 60.0):
        law = run(axes, limits, arc, jnp.asarray(feed), s)
        assert law.feed.max() <= feed * (1 + 1e-12)
        assert law.time[-1] >= arc[-1] / feed
        assert (jnp.diff(law.time) > 0).all()
        assert_close(law.total, law.time[-1], rtol=1e-12)


def test_path_that_nothing_limits_takes_length_over_feed(limits):
    axes, arc, _ = trochoid_axes(math.radians(20))
    feed = 2.0
    free = run(axes, limits, arc, feed, rest=(False, False))
    assert_close(free.time[-1], arc[-1] / feed, rtol=1e-12)
    assert (free.limiting == 0).all()
    at_rest = run(axes, limits, arc, feed)
    # from rest, b takes at least one sample to reach the feed: that sample counts twice
    ends = (arc[1] + arc[-1] - arc[-2]) / feed
    assert arc[-1] / feed < at_rest.time[-1] < arc[-1] / feed + 1.01 * ends


def test_limiting_codes_name_the_axis_that_limits(limits):
    """Slow: the programme limits. Small tilt, fast: C does; without C's limits, X or Y."""
    axes, arc, _ = trochoid_axes()
    slow = names_of(run(axes, limits, arc, 3.0))
    assert slow.count("programmed feed") > 0.9 * len(slow)
    fast = names_of(run(axes, limits, arc, FAST))
    assert sum(name.startswith("C ") for name in fast) > 0.9 * len(fast)
    assert fast[0] == fast[-1] == "start or end"
    no_rotary = Limits(
        speed=limits.speed.at[3:].set(jnp.inf),
        acceleration=limits.acceleration.at[3:].set(jnp.inf),
    )
    linear = names_of(run(axes, no_rotary, arc, FAST))
    assert not any(name.startswith(("A", "C")) for name in linear)
    assert {name.split()[1] for name in linear[1:-1]} == {"acceleration"}


def test_repeated_samples_cost_nothing(limits):
    """A tail that pads the path, and a sample given twice, change neither time nor feed."""
    axes, arc, _ = trochoid_axes()
    # the last loop is cut off, so that the padded path has as many samples as all others
    want = run(axes[:281], limits, arc[:281], 50.0)
    index = jnp.concatenate([jnp.arange(50), jnp.arange(49, 281), jnp.full(39, 280)])
    got = run(axes[index], limits, arc[index], 50.0)
    assert_close(got.time, want.time[index], rtol=1e-9)
    assert_close(got.feed, want.feed[index], rtol=1e-9, atol=1e-12)

    def total(axes):
        return time_law(axes, limits, arc[index], jnp.asarray(50.0)).total

    assert np.isfinite(jax.jit(jax.grad(total))(axes[index])).all()


def test_total_time_gradients(limits):
    """Forward = reverse = differences, for limits, programmed feed and the path itself."""
    axes, arc, s = trochoid_axes()
    bump = jnp.exp(-(((arc / arc[-1] - 0.5) / 0.1) ** 2))[:, None]
    bump = bump * jnp.asarray([[1.0, -1.0, 1.0, 0.1, 0.1]])

    def total(x):
        scaled = Limits(limits.speed * x[:5], limits.acceleration * x[:5])
        return time_law(axes + x[6] * bump, scaled, arc, 30.0 * x[5], s).total

    start = jnp.asarray([1.0, 1.0, 1.0, 0.8, 0.9, 1.1, 1.0])
    assert_gradient(total, start, rtol=1e-4, atol=1e-7, step=1e-6)


def test_gradients_are_finite_at_every_corner():
    """Axes that stand still, rest, ties between axes, and a limit that is infinite."""
    arc = jnp.linspace(0.0, 30.0, 61)

    def total(axes, speed, accel, feed):
        limits = Limits(speed, accel, ("X", "Y", "C"))
        return time_law(axes, limits, arc, feed).total

    slope = jax.jit(jax.value_and_grad(total, (0, 1, 2, 3)))
    flat = jnp.zeros_like(arc)
    cases = {
        "one axis": jnp.stack([arc, flat, flat], axis=1),
        "tie": jnp.stack([arc, arc, flat], axis=1),
        "no axis moves": jnp.stack([flat, flat, flat], axis=1),
        "there and back": jnp.stack([jnp.minimum(arc, 30 - arc), flat, flat], axis=1),
    }
    for name, axes in cases.items():
        for limit in (100.0, jnp.inf):
            three = jnp.asarray([100.0, 100.0, limit])
            value, parts = slope(axes, three, three, jnp.asarray(40.0))
            assert np.isfinite(value), name
            assert all(np.isfinite(part).all() for part in parts[:1]), name
            assert np.isfinite(parts[1][:2]).all(), name
            assert np.isfinite(parts[3]), name


def test_derivatives_are_of_fourth_order():
    """Halving even spacing divides the error by 16; uneven ones stay accurate."""
    both = jax.jit(derivatives)
    errors = []
    for n in (65, 129):
        s = jnp.linspace(0.0, 6.0, n)
        first, second = both(jnp.stack([jnp.sin(s), jnp.cos(1.3 * s)], axis=1), s)
        inner = slice(3, -3)
        errors.append(
            [
                jnp.abs(first[inner, 0] - jnp.cos(s)[inner]).max(),
                jnp.abs(second[inner, 0] + jnp.sin(s)[inner]).max(),
            ]
        )
    ratio = np.asarray(errors[0]) / np.asarray(errors[1])
    assert_close(ratio, 16.0, rtol=0.1)
    s = jnp.linspace(0.0, 2.4, 101) ** 2
    quartic = jnp.stack([s**4 - s, s**2], axis=1)
    first, second = both(quartic, s)
    assert_close(first[:, 0], 4 * s**3 - 1, rtol=1e-9, atol=1e-8)
    assert_close(second[:, 0], 12 * s**2, rtol=1e-7, atol=1e-6)


def test_no_hidden_units(limits):
    """In metres every time is the same and every feed a thousandth."""
    axes, arc, _ = trochoid_axes()
    to_m = jnp.asarray([1e-3, 1e-3, 1e-3, 1.0, 1.0])
    small = Limits(limits.speed * to_m, limits.acceleration * to_m)
    mm = run(axes, limits, arc, 50.0)
    m = run(axes * to_m[None], small, arc * 1e-3, 50e-3)
    assert_close(m.time, mm.time, rtol=1e-9)
    assert_close(m.feed * 1e3, mm.feed, rtol=1e-9, atol=1e-12)
    # and the answer does not depend on the path parameter's unit either
    sigma = run(axes, limits, arc, 50.0, arc * 7.0)
    assert_close(sigma.time, mm.time, rtol=1e-9)


def test_faster_axes_never_take_longer(limits):
    axes, arc, _ = trochoid_axes()
    times = [
        run(axes, Limits(limits.speed * k, limits.acceleration * k), arc, FAST).time[-1]
        for k in (0.5, 1.0, 2.0, 4.0)
    ]
    assert (np.diff(times) < 0).all()


def test_single_precision(limits):
    """Nothing forces 64 bits; 32 of them hold the time to a few in a hundred."""
    axes, arc, s = trochoid_axes()
    want = run(axes, limits, arc, 50.0, s)
    axes, arc, s = (np.asarray(x, np.float32) for x in (axes, arc, s))
    speed, accel = np.asarray(limits.speed), np.asarray(limits.acceleration)
    with jax.enable_x64(False):
        got = run(*(jnp.asarray(axes), Limits(speed, accel), jnp.asarray(arc)), 50.0)
        assert got.time.dtype == jnp.float32
    assert_close(got.time[-1], want.time[-1], rtol=3e-2)


def test_sweep_maps_and_differentiates_over_many_loops():
    """200 loops of 24 phases at once, forward mode, as the averaged model runs it."""
    dq, ddq, h = circle(3.0, 24)
    scale, fast = jnp.linspace(0.5, 2.0, 200), jnp.asarray(FAST)

    def mean_rate(accel, scale):
        limits = xy(accel * scale)
        return jnp.sqrt(turns(dq, ddq, h, fast, limits)).mean()

    rates = jax.vmap(mean_rate, (None, 0))

    @jax.jit
    def forward_mode(accel):
        return jax.jvp(lambda a: rates(a, scale), (accel,), (jnp.ones_like(accel),))

    value, slope = forward_mode(jnp.asarray(2500.0))
    # the feed goes with the root of the acceleration
    assert_close(value / jnp.sqrt(scale), value[0] / jnp.sqrt(scale[0]), rtol=1e-9)
    assert_close(slope, value / 5000.0, rtol=1e-9)
