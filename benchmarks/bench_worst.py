"""Worst: the convex part tuned for its mean texture, and for its worst place.

Prints both answers, what the maps of each say about the whole part inside its margin, and
how many places lie within the tolerance. Run as

    python benchmarks/bench_worst.py [starts [KEY=VALUE ...]]
"""

import dataclasses
import sys
import time
from pathlib import Path

import equinox as eqx
import jax
import numpy as np
from polishopt.chain import polish
from polishopt.files.assemble import job as assemble
from polishopt.files.config import load
from polishopt.optimize.goals import mapped
from polishopt.optimize.tune import Verdict, tune
from polishopt.setup import FINE


jax.config.update("jax_enable_x64", True)

CONFIG = Path(__file__).parents[1] / "configs" / "pessoles2009_convex.yaml"
outcome = eqx.filter_jit(polish)


def spread(maps, target):
    """Lowest and highest value of each goal, and the share of places within all bands."""
    inside, within, told = np.asarray(maps.evaluated), True, []
    for name, goal in target.items():
        values = np.asarray(getattr(maps, name))[inside]
        within = within & (abs(values - float(goal.value)) <= float(goal.tolerance) + 1e-6)
        told.append(f"{name} {values.min():.4f} to {values.max():.4f}")
    return f"{', '.join(told)}; {100 * np.mean(within):.1f} % of the places in the band"


def main(starts="8", *overrides):
    loaded = load(CONFIG, list(overrides))
    job = assemble(loaded.config)
    for worst in (False, True):
        target = {
            name: dataclasses.replace(goal, worst=worst)
            for name, goal in job.target.items()
        }
        began, used = time.perf_counter(), time.process_time()
        answer = tune(
            job.setup,
            job.process,
            job.between,
            target,
            job.limits,
            loaded.config.secondary,
            int(starts),
        )
        wall, cpu = time.perf_counter() - began, time.process_time() - used
        print(f"{'worst place' if worst else 'mean'}: {wall:.0f} s, {cpu:.0f} s of CPU")
        print(f"  {Verdict(int(answer.verdict)).name}", end="; ")
        print(*(f"{k} {float(m):+.3g}" for k, m in answer.misses.items()), sep=", ")
        tuned = {name: float(getattr(answer.process, name)) for name in job.between}
        print("  " + ", ".join(f"{name} {value:.4g}" for name, value in tuned.items()))
        out, every = (
            answer.outcome,
            {k: dataclasses.replace(g, worst=True) for k, g in target.items()},
        )
        print(
            f"  {float(out.time) / 60:.2f} min, removal {1e3 * float(out.mean_removal):.3f}"
            f" um, mean Ssk {float(out.Ssk):.4f}, Sku {float(out.Sku):.4f}"
        )
        setup = mapped(job.setup, every)
        fine = eqx.tree_at(lambda s: s.sampling, setup, FINE)
        for name, made in (("coarse", setup), ("fine", fine)):
            maps = outcome(answer.process, made).maps
            print(f"  {name} map: {spread(maps, target)}")


if __name__ == "__main__":
    main(*sys.argv[1:])
