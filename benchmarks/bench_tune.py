"""Tune: the answers to the example configs beside those of scipy's SLSQP.

Both get the same jitted chain and its exact derivatives, in units of the box's widths.
SLSQP runs twice from each start, as `tune` does: to the least squared misses under the
limits, and where those vanish on to the least cost. Prints what each found, and whether
SLSQP found a better feasible point. Run as

    python benchmarks/bench_tune.py [config ...]
"""

import dataclasses
import sys
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from polishopt.chain import polish
from polishopt.compiler import share_work
from polishopt.files.assemble import job as assemble
from polishopt.files.config import load
from polishopt.optimize.starts import spread_starts
from polishopt.optimize.tune import (
    AIM,
    HIT,
    Verdict,
    excesses,
    misses,
    tune,
)
from scipy.optimize import minimize


share_work()
jax.config.update("jax_enable_x64", True)

CONFIGS = Path(__file__).parents[1] / "configs"
STARTS = 8
FEASIBLE = 1e-6  # violation, in units of the limit over its own size


def model(job, secondary):
    """Names, lower bounds, widths; misses, excesses and cost as a function of box units."""
    names = list(job.between)
    low = jnp.asarray([job.between[name][0] for name in names])
    width = jnp.asarray([job.between[name][1] for name in names]) - low

    @jax.jit
    def values(t):
        x = dict(zip(names, low + width * t, strict=True))
        outcome = polish(dataclasses.replace(job.process, **x), job.setup)
        cost = outcome.force_max if secondary == "force" else outcome.time / 60
        return (
            jnp.stack(list(misses(outcome, job.target).values())),
            jnp.stack(list(excesses(outcome, job.limits).values())),
            cost,
        )

    return names, low, width, values


def problem(job, secondary):
    """The same with its Jacobian."""
    names, low, width, values = model(job, secondary)

    def both(t):
        tangents = jax.jacfwd(lambda t: (values(t),) * 2, has_aux=True)
        slopes, value = tangents(t)
        return value, slopes

    return names, low, width, jax.jit(both)


class Once:
    """The same point is asked for its misses, its limits and their slopes in turn."""

    def __init__(self, function):
        self.function, self.point, self.count = function, None, 0

    def __call__(self, t):
        if self.point is None or not np.array_equal(t, self.point):
            self.point, self.count = np.array(t), self.count + 1
            self.answer = jax.device_get(self.function(jnp.asarray(t)))
        return self.answer


def on_either_side(missed):
    """What each goal has left of the band that `tune` allows it too."""
    return AIM - np.concatenate([missed, -missed])


def slsqp(once, start):
    """Misses, excesses and cost where SLSQP ends, by way of the nearest texture."""
    limits = {
        "type": "ineq",
        "fun": lambda t: -once(t)[0][1],
        "jac": lambda t: -once(t)[1][1],
    }
    box = [(0.0, 1.0)] * len(start)
    options = {"maxiter": 200, "ftol": 1e-14}

    def half_square(t):
        (missed, _, _), (slope, _, _) = once(t)
        return 0.5 * missed @ missed, missed @ slope

    near = minimize(
        half_square, start, jac=True, method="SLSQP", bounds=box, constraints=[limits],
        options=options,
    )  # fmt: skip
    point = np.clip(near.x, 0, 1)
    if np.max(np.abs(once(point)[0][0])) > HIT:
        return point
    on_target = {
        "type": "ineq",
        "fun": lambda t: on_either_side(once(t)[0][0]),
        "jac": lambda t: np.concatenate([-once(t)[1][0], once(t)[1][0]]),
    }
    cheap = minimize(
        lambda t: (once(t)[0][2], once(t)[1][2]),
        point,
        jac=True,
        method="SLSQP",
        bounds=box,
        constraints=[limits, on_target],
        options=options,
    )
    last = np.clip(cheap.x, 0, 1)
    (missed, over, cost), _ = once(last)
    fine = np.all(over <= FEASIBLE) and np.max(np.abs(missed)) <= HIT
    return last if fine and cost <= once(point)[0][2] else point


def compare(path):
    loaded = load(path)
    job = assemble(loaded.config)
    names, low, width, both = problem(job, loaded.config.secondary)
    once = Once(both)
    once(np.full(len(names), 0.5))
    began = time.perf_counter()
    tuning = tune(
        job.setup, job.process, job.between, job.target, job.limits, loaded.config.secondary
    )
    compiled = time.perf_counter() - began
    began = time.perf_counter()
    tuning = tune(
        job.setup, job.process, job.between, job.target, job.limits, loaded.config.secondary
    )
    took = time.perf_counter() - began
    point = (jnp.stack([getattr(tuning.process, n) for n in names]) - low) / width
    (missed, over, cost), _ = once(np.asarray(point))
    ours = 0.5 * missed @ missed
    solved = int(tuning.verdict) == Verdict.SOLVED
    print(f"\n{path.name}: {Verdict(int(tuning.verdict)).name.lower()}", flush=True)
    print(
        f"  tune   half squared miss {ours:.3e}, cost {cost:.6f}, limits {over.max():+.1e}"
        f", {took:.1f} s ({compiled:.1f} s with compiling)"
    )
    first = {name: float(getattr(job.process, name)) for name in names}
    places = spread_starts(first, job.between, STARTS, 1)
    better = False
    began, once.count = time.perf_counter(), 0
    for i in range(STARTS):
        start = (jnp.stack([places[n][i] for n in names]) - low) / width
        (m, g, c), _ = once(slsqp(once, np.asarray(start)))
        theirs, kept = 0.5 * m @ m, np.all(g <= FEASIBLE)
        print(
            f"  SLSQP  half squared miss {theirs:.3e}, cost {c:.6f}, limits {g.max():+.1e}"
        )
        if not kept:
            continue
        if solved:
            better |= np.max(np.abs(m)) <= HIT and c < cost * (1 - 1e-4)
        else:
            better |= theirs < ours * (1 - 1e-4)
    print(
        f"  SLSQP took {time.perf_counter() - began:.1f} s for {STARTS} starts and "
        f"{once.count} evaluations; found a better feasible point: {better}",
        flush=True,
    )


if __name__ == "__main__":
    parts = ("plane", "convex", "diamond")
    single = [CONFIGS / f"pessoles2009_{part}.yaml" for part in parts]
    for given in sys.argv[1:] or single:
        compare(Path(given))
