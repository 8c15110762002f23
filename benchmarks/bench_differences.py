"""Tune beside what one would do otherwise: SLSQP with finite differences.

Both get the same jitted chain. SLSQP starts from one place after another, twice from each:
to the nearest texture under the limits, and where that is the target, on to the least
cost. Its derivatives are scipy's forward differences. Compiling is left out for both. Run

    python benchmarks/bench_differences.py [config] [starts]
"""

import statistics
import sys
import time
from pathlib import Path

import jax
import numpy as np
from bench_tune import CONFIGS, FEASIBLE, HIT, Once, model, on_either_side
from polishopt.compiler import share_work
from polishopt.files.assemble import job as assemble
from polishopt.files.config import load
from polishopt.optimize.starts import spread_starts
from polishopt.optimize.tune import tune
from scipy.optimize import minimize


share_work()
jax.config.update("jax_enable_x64", True)
OPTIONS = {"maxiter": 200, "ftol": 1e-12}
RUNS = 3


def slsqp(once, start):
    """Where SLSQP ends, by way of the nearest texture."""
    box = [(0.0, 1.0)] * len(start)
    limits = {"type": "ineq", "fun": lambda t: -once(t)[1]}
    target = {"type": "ineq", "fun": lambda t: on_either_side(once(t)[0])}
    near = minimize(
        lambda t: 0.5 * once(t)[0] @ once(t)[0], start, method="SLSQP", bounds=box,
        constraints=[limits], options=OPTIONS,
    )  # fmt: skip
    point = np.clip(near.x, 0, 1)
    if np.max(np.abs(once(point)[0])) > HIT:
        return point
    cheap = minimize(
        lambda t: once(t)[2], point, method="SLSQP", bounds=box,
        constraints=[limits, target], options=OPTIONS,
    )  # fmt: skip
    return np.clip(cheap.x, 0, 1)


def main():
    path = Path(sys.argv[1]) if sys.argv[1:] else CONFIGS / "pessoles2009_plane.yaml"
    count = int(sys.argv[2]) if sys.argv[2:] else 16
    loaded = load(path)
    job, secondary = assemble(loaded.config), loaded.config.secondary
    names, low, width, values = model(job, secondary)
    once, low, width = Once(values), np.asarray(low), np.asarray(width)
    first = {name: float(getattr(job.process, name)) for name in names}
    places = spread_starts(first, job.between, count)
    starts = np.stack([np.asarray(places[n]) for n in names], axis=1)

    def ours():
        tuning = tune(
            job.setup, job.process, job.between, job.target, job.limits, secondary, count
        )
        outcome = tuning.outcome
        cost = outcome.force_max if secondary == "force" else outcome.time / 60
        return float(cost), int(tuning.verdict), int(tuning.evaluations.sum())

    def theirs():
        once.count, best = 0, np.inf
        for start in starts:
            missed, over, cost = once(slsqp(once, (start - low) / width))
            if np.max(np.abs(missed)) <= HIT and np.max(over) <= FEASIBLE:
                best = min(best, float(cost))
        return best, once.count

    ours(), once((starts[0] - low) / width)
    took = {"ours": [], "SLSQP": []}
    for _ in range(RUNS):
        for name, run in (("ours", ours), ("SLSQP", theirs)):
            began = time.perf_counter()
            result = run()
            took[name].append(time.perf_counter() - began)
            print(f"{name:6}", result, f"{took[name][-1]:.2f} s", flush=True)
    median = {name: statistics.median(each) for name, each in took.items()}
    print(
        f"{path.name}, {count} starts: {median['SLSQP'] / median['ours']:.2f} times faster"
    )


if __name__ == "__main__":
    main()
