"""Even: how evenly material goes on the convex part, beside the plane, and what hinders it.

Prints the coefficient of variation of the removal map for S0's settings on the plane, and
on the cap of radius 100 mm with the guide laid out on its shadow and by area: on S0's
machine, with axes that have no limits, at half the feed, with the pole of C taken off the
part, and on other machines. Run as

    python benchmarks/bench_even.py
"""

import dataclasses
from pathlib import Path

import equinox as eqx
import jax
from polishopt.chain import polish
from polishopt.files.assemble import job as assemble
from polishopt.files.config import load
from polishopt.setup import FINE


jax.config.update("jax_enable_x64", True)
CONFIGS = Path(__file__).parent.parent / "configs"
EVEN, WEDGE = "guide.even=true", "process.wedge_y_deg=22"
ROWS = [
    ("plane", "plane", ["guide.corner=smooth"], False),
    ("cap, on its shadow", "convex", [], False),
    ("cap, by area", "convex", [EVEN], False),
    ("cap, on its shadow, axes without limits", "convex", [], True),
    ("cap, by area, axes without limits", "convex", [EVEN], True),
    ("cap, by area, half the feed", "convex", [EVEN, "process.feed_mm_min=500"], False),
    ("cap, by area, on a wedge of 22 deg", "convex", [EVEN, WEDGE], False),
    ("cap, by area, B-C table", "convex", [EVEN, "machine=table_table_bc"], False),
    ("cap, by area, head and table", "convex", [EVEN, "machine=head_table_bc"], False),
]


@eqx.filter_jit
def spread_of(process, setup):
    done = polish(process, setup)
    return done.spread, done.time


def main():
    print(f"{'':42}{'time [min]':>12}{'variation':>12}{'of the plane':>14}")
    plane = None
    for name, config, changes, ideal in ROWS:
        made = assemble(load(CONFIGS / f"pessoles2009_{config}.yaml", changes).config)
        left_out = ("feed",) if ideal else ()
        setup = dataclasses.replace(made.setup, sampling=FINE, idealised=left_out)
        spread, time = map(float, spread_of(made.process, setup))
        plane = plane or spread
        print(f"{name:42}{time / 60:12.2f}{spread:12.4f}{spread / plane:14.3f}", flush=True)


if __name__ == "__main__":
    main()
