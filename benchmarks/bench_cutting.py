"""Cutting: memory and time of a large map milled tooth by tooth.

Mills a saddle of 20 mm with narrow, yawed passes, cuts 2000 x 2000 lines with it, and
prints progress, time, the largest memory that the process ever held, and the height
parameters. Fails where that memory is 2 GB or more. Run as

    python benchmarks/bench_cutting.py [pixels along a side]
"""

import resource
import sys
import time

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from polishopt.path.surface import HyperbolicParaboloid
from polishopt.texture.areal import height_parameters
from polishopt.texture.cutter import (
    Cutter,
    Passings,
    arc_length,
    passing_count,
    passings,
    postures,
    several,
)
from polishopt.texture.cutting import topography


jax.config.update("jax_enable_x64", True)

SIDE, STEP, FEED, SPIN = 20.0, 0.46, 4000 / 60, 500 * np.pi
TILT, YAW = np.radians(10.0), np.radians(20.0)
SAMPLES = 601  # along a pass
ALLOWED = 2e9  # bytes


def resident() -> float:
    """Largest memory held so far [bytes]."""
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def teeth(surface, cutter) -> Passings:
    """Passings of all passes, from 2 mm before the part to 2 mm behind it."""
    along = jnp.linspace(-2.0, SIDE + 2.0, SAMPLES)
    count = passing_count((SIDE + 5.0) / FEED, SPIN, cutter)

    @jax.vmap
    def one(y, turned):
        xy = jnp.stack([along, jnp.full(SAMPLES, y)], axis=1)
        angles = (jnp.asarray(TILT), jnp.asarray(YAW))
        pass_ = postures(surface, xy, jnp.zeros(SAMPLES), cutter, *angles)
        feed = jnp.full(SAMPLES, FEED)
        moments = arc_length(pass_) / FEED
        return passings(pass_, moments, feed, jnp.asarray(SPIN), cutter, count, turned)

    y = jnp.arange(-1.0, SIDE + 1.0, STEP)
    # a spindle that nobody synchronises
    turned = jax.random.uniform(jax.random.key(0), y.shape, maxval=2 * jnp.pi)
    return several(one(y, turned))


def progress(done: int, total: int) -> None:
    """One line that is written over."""
    print(f"\r{100 * done / total:5.1f} % of {total} lines", end="", flush=True)


def main(pixels: int = 2000) -> int:
    surface, cutter = HyperbolicParaboloid([SIDE, SIDE], 0.01), Cutter(5.0, 1.5)
    before = resident()
    passes = eqx.filter_jit(teeth)(surface, cutter)
    grid = (jnp.arange(pixels) + 0.5) * (SIDE / pixels)
    side = min(32, max(1, int(0.32 / SIDE * pixels)))  # lines of a tile of 0.32 mm
    start = time.perf_counter()
    z = topography(surface, grid, grid, cutter, passes, progress, (side, side))
    seconds = time.perf_counter() - start
    p = height_parameters(jnp.asarray(z))
    print(
        f"\n{passes.tooth.size} passings   {seconds:.1f} s, "
        f"{1e6 * seconds / z.size:.2f} us a line   "
        f"memory {before / 1e6:.0f} MB before, {resident() / 1e6:.0f} MB at most\n"
        f"Sa {1e3 * p.Sa:.3f} um   Sz {1e3 * p.Sz:.2f} um   "
        f"Ssk {p.Ssk:+.2f}   Sku {p.Sku:.2f}"
    )
    if not np.isfinite(z).all():
        print("Some lines were not cut.")
        return 1
    return int(resident() >= ALLOWED)


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])))
