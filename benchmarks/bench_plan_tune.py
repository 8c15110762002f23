"""Plan: all 28 settings of seven steps tuned, beside SLSQP with finite differences.

The finished surface is to have a given skewness and kurtosis in the least time. Both get
the same jitted chain and the same starts. SLSQP runs from one after another, twice from
each: to the nearest texture under the limits, and where that is the target, on to the least
time; it is stopped after `PATIENCE` times what `tune` took. Compiling is left out. Run as

    python benchmarks/bench_plan_tune.py [starts]
"""

import math
import sys
import time

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from bench_differences import OPTIONS
from bench_tune import CONFIGS, FEASIBLE, HIT, Once, on_either_side
from polishopt.compiler import share_work
from polishopt.files.assemble import plan_job
from polishopt.files.config import load
from polishopt.optimize.goals import Goal, all_excesses, all_misses, applied, setting
from polishopt.optimize.starts import spread_starts
from polishopt.optimize.tune import tune
from polishopt.plan import follow
from scipy.optimize import minimize


share_work()
jax.config.update("jax_enable_x64", True)

BOUNDS = {
    "tilt": (math.radians(2.5), math.radians(8)),
    "displacement": (0.2, 0.8),
    "step": (0.5, 2.0),
    "trochoid_radius": (3.0, 8.0),
}
TARGET = {"1 um Ssk": Goal(-0.7, 0.05), "1 um Sku": Goal(3.72, 0.1)}
PATIENCE = 12


class OutOfTime(Exception):
    """SLSQP has had its share."""


def main():
    count = int(sys.argv[1]) if sys.argv[1:] else 4
    job = plan_job(load(CONFIGS / "pessoles2009_plan.yaml").steps)
    steps = job.plan.names
    between = {f"{step} {name}": b for step in steps for name, b in BOUNDS.items()}
    names = list(between)
    low = np.asarray([between[name][0] for name in names])
    width = np.asarray([between[name][1] for name in names]) - low
    first = {name: float(setting(job.processes, steps, name)) for name in names}
    places = spread_starts(first, between, count)
    starts = np.stack([np.asarray(places[name]) for name in names], axis=1)

    @eqx.filter_jit
    def values(t):
        x = dict(zip(names, low + width * t, strict=True))
        changed = applied(job.processes, steps, x)
        assert isinstance(changed, tuple)
        outcome = follow(changed, job.plan)
        return (
            jnp.stack(list(all_misses(outcome, TARGET).values())),
            jnp.stack(list(all_excesses(outcome, job.limits).values())),
            outcome.time / 60,
        )

    def ours():
        tuning = tune(
            job.plan, job.processes, between, TARGET, job.limits, "time", count,
            progress=lambda said: print("  ", said, flush=True),
        )  # fmt: skip
        point = [float(setting(tuning.process, steps, name)) for name in names]
        return (np.asarray(point) - low) / width, tuning.evaluations

    def judged(point):
        missed, over, cost = jax.device_get(values(jnp.asarray(np.clip(point, 0, 1))))
        fine = np.max(np.abs(missed)) <= HIT and np.max(over) <= FEASIBLE
        return fine, f"miss {np.max(np.abs(missed)):.1e}, limits {np.max(over):+.1e}", cost

    ours()
    began = time.perf_counter()
    point, evaluations = ours()
    took = time.perf_counter() - began
    fine, said, cost = judged(point)
    print(f"tune   {took:.1f} s: {said}, {cost:.3f} min; evaluations {evaluations}")

    judged(starts[0])
    stop = time.perf_counter() + PATIENCE * took
    best, calls = np.inf, 0

    def patient(t):
        nonlocal calls
        if time.perf_counter() > stop:
            raise OutOfTime
        calls += 1
        return values(t)

    once = Once(patient)
    box = [(0.0, 1.0)] * len(names)
    limits = {"type": "ineq", "fun": lambda t: -once(t)[1]}
    target = {"type": "ineq", "fun": lambda t: on_either_side(once(t)[0])}
    began = time.perf_counter()
    for i, start in enumerate((starts - low) / width):
        point = start
        try:
            near = minimize(
                lambda t: 0.5 * once(t)[0] @ once(t)[0], start, method="SLSQP", bounds=box,
                constraints=[limits], options=OPTIONS,
            )  # fmt: skip
            point = np.clip(near.x, 0, 1)
            if np.max(np.abs(once(point)[0])) <= HIT:
                point = minimize(
                    lambda t: once(t)[2], point, method="SLSQP", bounds=box,
                    constraints=[limits, target], options=OPTIONS,
                ).x  # fmt: skip
        except OutOfTime:
            print(f"SLSQP  stopped in start {i} after {PATIENCE} times as long")
        spent = time.perf_counter() - began
        fine, said, found = judged(point)
        best = min(best, found if fine else np.inf)
        print(f"SLSQP  start {i}, {spent:.1f} s: {said}, {found:.3f} min", flush=True)
        if time.perf_counter() > stop:
            break
    spent = time.perf_counter() - began
    print(f"SLSQP took {spent / took:.1f} times as long, {calls} evaluations; its best is")
    print(f"{best:.3f} min, ours {cost:.3f} min")


if __name__ == "__main__":
    main()
