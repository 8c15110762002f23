"""Feed: how long the time law of a five-axis path takes to compile and to run.

Prints, for several numbers of samples, the compile time, the run time (median of 20)
and what a gradient costs beside it, with speeds and accelerations limited and then with
jerk too; then the averaged model's feed in many loops at
once; then toppra on the same path, where it is installed. Run as

    python benchmarks/bench_feed.py
"""

import importlib.util
import statistics
import time

import jax
import jax.numpy as jnp
import numpy as np
from polishopt.machine import Limits, jerk_law, loop_rate, time_law


jax.config.update("jax_enable_x64", True)

LIMITS = Limits(
    speed=[500.0, 500.0, 500.0, 1.571, 2.094],
    acceleration=[2500.0, 3000.0, 2100.0, 5.2, 5.2],
    jerk=[5e3, 5e3, 5e4, 31.0, 310.0],
)
FEED = jnp.asarray(100.0)
PER_LOOP = 64


def trochoid(n):
    """Axis positions like those of a trochoid on a dome, and its contact length."""
    phase = np.arange(n) * 2 * np.pi / PER_LOOP
    slow = phase / 40
    axes = np.stack(
        [
            40 * np.cos(slow) + 3 * np.cos(phase),
            40 * np.sin(slow) + 3 * np.sin(phase),
            0.3 * np.cos(phase + slow),
            0.2 + 0.03 * np.cos(phase - slow),
            slow + 0.3 * np.sin(phase - slow),
        ],
        axis=1,
    )
    steps = np.linalg.norm(np.diff(axes[:, :3], axis=0), axis=1)
    return jnp.asarray(axes), jnp.asarray(np.concatenate([[0.0], np.cumsum(steps)]))


def measure(f, *args, repeats=20):
    """Time of the first call and median time of the next ones [s]."""
    start = time.perf_counter()
    jax.block_until_ready(f(*args))
    first = time.perf_counter() - start
    runs = []
    for _ in range(repeats):
        start = time.perf_counter()
        jax.block_until_ready(f(*args))
        runs.append(time.perf_counter() - start)
    return first, statistics.median(runs)


def total(axes, arc, acceleration, feed):
    limits = Limits(LIMITS.speed, acceleration)
    return time_law(axes, limits, arc, feed).total


def total_with_jerk(axes, arc, acceleration, feed):
    limits = Limits(LIMITS.speed, acceleration, jerk=LIMITS.jerk)
    return jerk_law(axes, limits, arc, feed).total


def bench_path(n, total, name):
    axes, arc = trochoid(n)
    args = (axes, arc, LIMITS.acceleration, FEED)
    compiling, forward = measure(jax.jit(total), *args)
    compiling_back, back = measure(jax.jit(jax.value_and_grad(total, (0, 2, 3))), *args)
    print(
        f"{n:>9} samples {name:>12}   compile {compiling:5.2f} s   "
        f"run {forward * 1e3:8.2f} ms   "
        f"with gradient: compile {compiling_back:5.2f} s   run {back * 1e3:8.2f} ms   "
        f"ratio {back / forward:4.2f}"
    )


def bench_loops(loops=200, phases=24):
    phase = jnp.linspace(0.0, 2 * jnp.pi, phases + 1)[:-1]
    swing = jnp.linspace(0.0, 0.5, loops)

    def loop(swing):
        place = [3 * jnp.cos(phase), 3 * jnp.sin(phase), 0.1 * jnp.cos(phase)]
        turn = [0.03 * jnp.cos(phase), swing * jnp.sin(phase)]
        slope = [-3 * jnp.sin(phase), 3 * jnp.cos(phase), -0.1 * jnp.sin(phase)]
        slope += [-0.03 * jnp.sin(phase), swing * jnp.cos(phase)]
        bend = [-x for x in place + turn]
        h = jnp.asarray(2 * np.pi / phases)
        dq, ddq = jnp.stack(slope, axis=1), jnp.stack(bend, axis=1)
        return loop_rate(dq, ddq, 3 * jnp.ones(phases), h, FEED, LIMITS)

    compiling, run = measure(jax.jit(jax.vmap(loop)), swing)
    print(
        f"{loops} loops of {phases} phases   compile {compiling:5.2f} s   "
        f"run {run * 1e3:8.2f} ms"
    )


def bench_toppra(n, points):
    """toppra on the same path, at the gridpoints it is asked for."""
    import toppra
    from toppra.algorithm import TOPPRA
    from toppra.constraint import JointAccelerationConstraint, JointVelocityConstraint

    toppra.setup_logging("ERROR")
    axes, arc = trochoid(n)
    path = toppra.SplineInterpolator(np.asarray(arc), np.asarray(axes))
    limits = [
        JointVelocityConstraint(np.asarray(LIMITS.speed)),
        JointAccelerationConstraint(np.asarray(LIMITS.acceleration)),
    ]
    grid = np.linspace(0.0, float(arc[-1]), points)

    def run():
        return TOPPRA(limits, path, gridpoints=grid).compute_parameterization(0, 0)

    _, middle = measure(run, repeats=5)
    print(f"{points:>9} points    toppra {middle * 1e3:8.2f} ms")


if __name__ == "__main__":
    for samples in (1_000, 10_000, 100_000, 1_000_000):
        bench_path(samples, total, "acceleration")
        bench_path(samples, total_with_jerk, "jerk")
    bench_loops()
    if importlib.util.find_spec("toppra"):
        for points in (1_000, 10_000):
            bench_toppra(10_000, points)
    else:
        print("toppra is not installed: no comparison")
