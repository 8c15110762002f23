"""Orders: how the time of an evaluation grows with the length of the path.

The same part under Hilbert curves of order 3 to 7, each twice as long as the one before and
of four times as many cells. Prints length, the median of five runs, the time per metre, and
how far machine time and spread are from those with every cell looked at. Run as

    python benchmarks/bench_orders.py [config]
"""

import statistics
import sys
import time
from pathlib import Path

import equinox as eqx
import jax
from polishopt.files.assemble import job as assemble
from polishopt.files.config import load
from polishopt.mechanics import mechanics


jax.config.update("jax_enable_x64", True)

CONFIGS = Path(__file__).parents[1] / "configs"
ORDERS, RUNS = range(3, 8), 5


def evaluated(path, *overrides):
    """What comes out, how long that takes, and one in how many cells is looked at."""
    job = assemble(load(path, overrides).config)
    run = eqx.filter_jit(mechanics)
    outcome = jax.block_until_ready(run(job.process, job.setup))
    took = []
    for _ in range(RUNS):
        began = time.perf_counter()
        jax.block_until_ready(run(job.process, job.setup))
        took.append(time.perf_counter() - began)
    return outcome, statistics.median(took), job.setup.sampling.one_cell_in


def main():
    path = Path(sys.argv[1]) if sys.argv[1:] else CONFIGS / "pessoles2009_convex.yaml"
    heads = ("order", "path [m]", "one cell in", "run [ms]", "ms/m", "every cell [ms]")
    print("|", " | ".join((*heads, "time", "spread")), "|")
    print("|---" * (len(heads) + 2) + "|")
    for order in ORDERS:
        got, took, one_in = evaluated(path, f"guide.order={order}")
        want, whole, _ = evaluated(path, f"guide.order={order}", "sampling.one_cell_in=1")
        metres = float(got.path_length) / 1e3
        off = [float(getattr(got, n) / getattr(want, n)) - 1 for n in ("time", "spread")]
        print(
            f"| {order} | {metres:.1f} | {one_in} | {1e3 * took:.0f} | "
            f"{1e3 * took / metres:.2f} | {1e3 * whole:.0f} | "
            f"{off[0]:+.2%} | {off[1]:+.2%} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
