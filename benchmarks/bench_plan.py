"""Plan: seven steps, and their gradient by all 28 tilts, displacements, steps and radii.

On a start map of 256 x 256 points: time of a run and of a gradient, memory of the
gradient, and its difference from central differences, setting by setting
(of fourth order). Run as

    python benchmarks/bench_plan.py
"""

import resource
import time
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from polishopt.files.assemble import plan_job
from polishopt.files.config import load
from polishopt.plan import Plan, follow


jax.config.update("jax_enable_x64", True)

CONFIG = Path(__file__).parents[1] / "configs" / "pessoles2009_plan.yaml"
SETTINGS = ("tilt", "displacement", "step", "trochoid_radius")
STEP = 1e-4


def main():
    job = plan_job(load(CONFIG).steps)
    heights = jnp.asarray(np.random.default_rng(0).normal(0, 1e-3, (256, 256)))
    first = eqx.tree_at(
        lambda s: (s.start.heights, s.start.spacing),
        job.plan.setups[0],
        (heights, jnp.full(2, 2e-3)),
    )
    plan = Plan(job.plan.names, (first, *job.plan.setups[1:]))
    x = np.asarray([[float(getattr(p, n)) for n in SETTINGS] for p in job.processes])

    def last(x):
        changed = tuple(
            eqx.tree_at(lambda p: tuple(getattr(p, n) for n in SETTINGS), p, tuple(row))
            for p, row in zip(job.processes, x, strict=True)
        )
        outcome = follow(changed, plan)
        end = outcome.last
        return 1e5 * end.Sq + end.Ssk + end.Sku + outcome.time / 1e4

    def timed(f):
        began = time.perf_counter()
        compiled = jax.jit(f).lower(jnp.asarray(x)).compile()
        built = time.perf_counter() - began
        runs, result = [], None
        for _ in range(3):
            began = time.perf_counter()
            result = jax.block_until_ready(compiled(jnp.asarray(x)))
            runs.append(time.perf_counter() - began)
        return compiled, result, built, float(np.median(runs))

    forward, _, built, run = timed(last)
    print(f"forward: compile {built:.1f} s, run {run:.3f} s")
    gradient: Any
    compiled, gradient, built, slope = timed(jax.grad(last))
    memory: Any = compiled.memory_analysis()
    set_aside = memory.temp_size_in_bytes / 1e6
    print(f"gradient: compile {built:.1f} s, run {slope:.3f} s, {slope / run:.2f} runs")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    print(f"gradient: {set_aside:.0f} MB set aside; process at most {peak:.0f} MB")
    worst = 0.0
    for place in np.ndindex(*x.shape):
        step = STEP * x[place]
        found = []
        for width in (step, 2 * step):
            ends = [x.copy(), x.copy()]
            ends[0][place] += width
            ends[1][place] -= width
            above, below = (float(forward(jnp.asarray(end))) for end in ends)
            found.append((above - below) / (2 * width))
        difference = (4 * found[0] - found[1]) / 3
        size = max(abs(difference), 1e-6 * float(np.max(np.abs(gradient))))
        worst = max(worst, abs(float(gradient[place]) - difference) / size)
    print(f"{x.size} derivatives, at worst {worst:.1e} from central differences")


if __name__ == "__main__":
    main()
