"""Starts: where 64 searches end on the example configs, side by side and one by one.

How many end at a point that is stationary under the limits, or of least violation; then,
from those that reach the target, the same on the way to the least cost. Times are without
compilation: of the searches for the target, in batches as `tune` runs them and one after
another; and of `tune` with 64 starts beside 64 times `tune` with one of them, which each go
on to the least cost. With `--quick`, one by one is left out. Run as

    python benchmarks/bench_starts.py [--quick] [config ...]
"""

import dataclasses
import math
import sys
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from bench_tune import CONFIGS
from polishopt.chain import polish
from polishopt.compiler import share_work
from polishopt.files.assemble import job as assemble
from polishopt.files.config import load
from polishopt.optimize.batches import in_batches
from polishopt.optimize.certificate import Status
from polishopt.optimize.goals import Limits, mapped
from polishopt.optimize.stage import Stage, searched
from polishopt.optimize.starts import spread_starts
from polishopt.optimize.tune import AIM, HIT, TOGETHER, TOLERANCE, tune
from polishopt.parts import as_scalar


share_work()
jax.config.update("jax_enable_x64", True)
STARTS, TURNS = 64, 5


def timed(work, *given):
    """What comes out, and how long it took."""
    began = time.perf_counter()
    return work(*given), time.perf_counter() - began


def ended(solution):
    """How many searches proved where they are."""
    found = np.asarray(solution.status)
    return int(np.isin(found, [Status.SOLVED, Status.INFEASIBLE]).sum())


def compare(path, quick):
    loaded = load(path)
    job, secondary = assemble(loaded.config), loaded.config.secondary
    setup = mapped(job.setup, job.target)
    first = {name: float(getattr(job.process, name)) for name in job.between}
    places = spread_starts(first, job.between, STARTS)
    outcome = jax.jit(lambda p: polish(p, setup))(job.process)
    unit = jnp.maximum(outcome.force_max if secondary == "force" else outcome.time, 1e-12)
    reach = Stage(
        setup, job.process, dict(job.target), job.limits or Limits(), as_scalar(0.0), unit,
        as_scalar(AIM), secondary, polish,
    )  # fmt: skip
    hold = dataclasses.replace(reach, weight=jnp.ones_like(unit))

    def search(size, stage):
        lower, upper = (
            {name: jnp.full(size, bounds[side]) for name, bounds in job.between.items()}
            for side in (0, 1)
        )

        def some(part, vacant=None):
            return searched(part, lower, upper, stage, TOLERANCE, vacant)

        return some

    def one_by_one(places):
        one, rows = search(1, reach), []
        for i in range(STARTS):
            at = {name: column[i : i + 1] for name, column in places.items()}
            rows.append(jax.device_get(one(at)))
        return jax.tree.map(lambda *leaves: np.concatenate(leaves), *rows)

    def batched(places, stage=reach):
        return in_batches(search(TOGETHER, stage), places, TOGETHER)

    few = {name: column[:TOGETHER] for name, column in places.items()}
    batched(few)
    near, took = timed(batched, places)
    missed = np.max(np.abs(np.asarray(near.residual[0])), axis=1)
    hit = (missed <= HIT - AIM) & (np.asarray(near.status) == Status.SOLVED)
    second = ""
    if hit.any():
        held = batched({name: np.asarray(x)[hit] for name, x in near.x.items()}, hold)
        second = f", on to the least {secondary} {ended(held)} of {hit.sum()}"
    print(f"{path.stem}: {ended(near)} of {STARTS} ended{second}; {took:.1f} s", flush=True)
    if quick:
        return
    search(1, reach)({name: x[:1] for name, x in places.items()})
    alone, pairs = near, []
    for _ in range(TURNS):
        alone, longer = timed(one_by_one, places)
        pairs.append((longer, timed(batched, places)[1]))
    longer, took = np.median(pairs, axis=0)
    ratios = sorted(slow / fast for slow, fast in pairs)
    apart = max(
        np.max(np.abs(np.asarray(near.x[n]) - np.asarray(alone.x[n])) / (high - low))
        for n, (low, high) in job.between.items()
    )
    print(
        f"   one by one {ended(alone)}; {longer:.1f} s beside {took:.1f} s, "
        f"{ratios[0]:.2f} to {ratios[-1]:.2f}, median {np.median(ratios):.2f} times as "
        f"long; answers {apart:.0e} of the box apart at most",
        flush=True,
    )

    def tuned(count, starts):
        """How long a `tune` from each of some starts takes, and the least it finds [s]."""

        def one(i):
            at = {name: column[i] for name, column in places.items()}
            process = dataclasses.replace(job.process, **at)
            found = tune(
                job.setup, process, job.between, job.target, job.limits, secondary, count
            )
            return float(found.outcome.time) if int(found.verdict) == 0 else math.inf

        one(0)  # compiles
        began = time.perf_counter()
        least = min(one(i) for i in starts)
        return time.perf_counter() - began, least

    together, best = tuned(STARTS, [0])
    apiece, least = tuned(1, range(STARTS))
    print(
        f"   tune with {STARTS} starts {together:.1f} s, {STARTS} times with one "
        f"{apiece:.1f} s, {apiece / together:.2f} times as long; {best:.4f} and "
        f"{least:.4f} s on target",
        flush=True,
    )


if __name__ == "__main__":
    steps = [p for p in sorted(CONFIGS.glob("*.yaml")) if not load(p).steps]
    quick = "--quick" in sys.argv
    for given in [arg for arg in sys.argv[1:] if arg != "--quick"] or steps:
        compare(Path(given), quick)
