"""Starts: where 64 searches end on the example configs, side by side and one by one.

How many end at a point that is stationary under the limits, or of least violation; then,
from those that reach the target, the same on the way to the least cost. Times are those of
the first stage, without compilation: in batches, as `tune` runs them, and one search after
another. Run as

    python benchmarks/bench_starts.py [config ...]
"""

import dataclasses
import sys
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from bench_tune import CONFIGS
from polishopt.chain import polish
from polishopt.files.assemble import job as assemble
from polishopt.files.config import load
from polishopt.optimize import tune as module
from polishopt.optimize.batches import in_batches
from polishopt.optimize.certificate import Status
from polishopt.optimize.goals import Limits, mapped
from polishopt.parts import as_scalar


jax.config.update("jax_enable_x64", True)
STARTS = 64


def ended(solution):
    """How many searches proved where they are."""
    found = np.asarray(solution.status)
    return int(np.isin(found, [Status.SOLVED, Status.INFEASIBLE]).sum())


def compare(path):
    loaded = load(path)
    job, secondary = assemble(loaded.config), loaded.config.secondary
    setup = mapped(job.setup, job.target)
    first = {name: float(getattr(job.process, name)) for name in job.between}
    places = module.spread_starts(first, job.between, STARTS)
    outcome = jax.jit(lambda p: polish(p, setup))(job.process)
    unit = jnp.maximum(outcome.force_max if secondary == "force" else outcome.time, 1e-12)
    reach = module._Stage(
        setup, job.process, dict(job.target), job.limits or Limits(), as_scalar(0.0), unit,
        as_scalar(module.AIM),
    )  # fmt: skip
    hold = dataclasses.replace(reach, weight=jnp.ones_like(unit))

    def search(size, stage):
        lower, upper = (
            {name: jnp.full(size, bounds[side]) for name, bounds in job.between.items()}
            for side in (0, 1)
        )

        def some(part):
            return module._search(part, lower, upper, stage, secondary, 1e-6, polish)

        return some

    def one_by_one(places):
        one, rows = search(1, reach), []
        for i in range(STARTS):
            at = {name: column[i : i + 1] for name, column in places.items()}
            rows.append(jax.device_get(one(at)))
        return jax.tree.map(lambda *leaves: np.concatenate(leaves), *rows)

    def batched(places, stage=reach):
        return in_batches(search(module.TOGETHER, stage), places, module.TOGETHER)

    few = {name: column[:4] for name, column in places.items()}
    batched(few), search(1, reach)({name: x[:1] for name, x in places.items()})
    took, answers = [], []
    for run in (batched, one_by_one):
        began = time.perf_counter()
        answers.append(run(places))
        took.append(time.perf_counter() - began)
    near, alone = answers
    apart = max(
        np.max(np.abs(np.asarray(near.x[n]) - np.asarray(alone.x[n])) / (high - low))
        for n, (low, high) in job.between.items()
    )
    missed = np.max(np.abs(np.asarray(near.residual[0])), axis=1)
    hit = (missed <= module.HIT - module.AIM) & (np.asarray(near.status) == Status.SOLVED)
    second = ""
    if hit.any():
        held = batched({name: np.asarray(x)[hit] for name, x in near.x.items()}, hold)
        second = f", on to the least {secondary} {ended(held)} of {hit.sum()}"
    print(
        f"{path.stem}: {ended(near)} of {STARTS} ended, one by one {ended(alone)}{second}; "
        f"{took[0]:.1f} s side by side, {took[1]:.1f} s one by one, "
        f"{took[1] / took[0]:.2f} times; answers {apart:.0e} of the box apart at most",
        flush=True,
    )


if __name__ == "__main__":
    tuned = [p for p in sorted(CONFIGS.glob("*.yaml")) if not load(p).steps]
    for given in sys.argv[1:] or tuned:
        compare(Path(given))
