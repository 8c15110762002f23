"""Ripple: the closed form against the removal of the true path, every loop of it.

Prints, for the plane part of the paper at steps of 1, 2 and 4 mm, the rms of the removal
over four starting phases of the trochoid beside the predicted one, and what each takes.
Pixels hide ripple at small steps, and too few samples or nodes in the contact patch make
some of their own: samples along a loop must lie about a pixel apart. Takes half an hour.
Run as

    python benchmarks/bench_ripple.py
"""

import time
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from polishopt.chain import polish
from polishopt.contact.removal import Grid
from polishopt.files.assemble import job
from polishopt.files.config import load
from polishopt.resolved import removal, run, samples


jax.config.update("jax_enable_x64", True)

CONFIG = Path(__file__).parents[1] / "configs" / "pessoles2009_plane.yaml"
PHASES = 4
# step [mm], pixels, samples a loop, rows and columns of the contact patch
CASES = ((4.0, 128, 48, 16, 32), (2.0, 192, 48, 24, 40), (1.0, 160, 96, 24, 40))


@eqx.filter_jit
def resolved(process, setup, grid, count, rows, columns):
    def at(phase):
        path = run(process, setup, count, phase)
        return removal(path, process, setup, grid, rows, columns)

    return jax.lax.map(at, jnp.asarray(2 * np.pi * np.arange(PHASES) / PHASES))


def main():
    given = job(load(CONFIG).config)
    setup = given.setup
    average = eqx.filter_jit(polish)
    print("| step [mm] | true rms [%] | predicted [%] | ratio | true [s] |")
    print("|---|---|---|---|---|")
    for step, pixels, per_loop, rows, columns in CASES:
        process = eqx.tree_at(
            lambda p: (p.step, p.trochoid_radius),
            given.process,
            (jnp.asarray(step), jnp.asarray(3.0)),
        )
        began = time.perf_counter()
        grid = Grid((0.0, 0.0), tuple(np.asarray(setup.size)), (pixels, pixels))
        count = samples(process, setup, per_loop)
        maps = np.asarray(resolved(process, setup, grid, count, rows, columns))
        took = time.perf_counter() - began
        outcome = average(process, setup)
        true = np.sqrt(np.mean(maps.var(axis=0))) / float(outcome.mean_removal)
        predicted = float(outcome.ripple)
        print(
            f"| {step:g} | {100 * true:.2f} | {100 * predicted:.2f} "
            f"| {predicted / true:.3f} | {took:.0f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
