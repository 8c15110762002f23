"""NURBS: what a million points of a surface take.

Prints the run time (median of 9) of 10^6 points of bicubic surfaces, worked off in blocks
that stay in the processor's cache. Run as

    python benchmarks/bench_nurbs.py
"""

import statistics
import time

import jax
import jax.numpy as jnp
import numpy as np
from polishopt.path import fit_nurbs


jax.config.update("jax_enable_x64", True)

POINTS, BLOCK = 1_000_000, 4096


def main():
    """Prints one line for each size of the net."""
    x, y = np.meshgrid(np.linspace(-30, 30, 60), np.linspace(-30, 30, 60), indexing="ij")
    measured = np.stack([x, y, -(x**2) / 400 - y**2 / 300], axis=-1)
    share = np.random.default_rng(0).uniform(size=(POINTS, 2))
    for count in (8, 40):
        surface = fit_nurbs(measured, (count, count))
        places = jnp.asarray(share * np.asarray(surface.size))
        run = jax.jit(lambda s, p: jax.lax.map(s, p, batch_size=BLOCK))
        run(surface, places).block_until_ready()
        times = []
        for _ in range(9):
            begin = time.perf_counter()
            run(surface, places).block_until_ready()
            times.append(time.perf_counter() - begin)
        print(f"{count:3d} x {count} control points: {statistics.median(times):.3f} s")


if __name__ == "__main__":
    main()
