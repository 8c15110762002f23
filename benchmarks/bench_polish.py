"""Polish: what the process model and its gradient take to compile and to run.

Prints, for guides of two orders, the compile time and the run time (median of 30) of the
scalars of `polish`, of their Jacobian by the four settings, and of the value and gradient
of one scalar; and what that gradient costs beside the forward run. Run as

    python benchmarks/bench_polish.py
"""

import dataclasses
import datetime
import importlib.metadata
import os
import platform
import statistics
import time
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
from polishopt.chain import polish
from polishopt.files.assemble import job
from polishopt.files.config import load
from polishopt.path.families import hilbert


jax.config.update("jax_enable_x64", True)

CONFIG = Path(__file__).parents[1] / "configs" / "pessoles2009_plane.yaml"
# what a gradient may cost, in forward runs
MOST = 4.0


def machine():
    """Which computer and which versions the numbers belong to."""
    model = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        named = [line for line in info.read_text().splitlines() if "model name" in line]
        model = named[0].split(":", 1)[1].strip() if named else model
    packages = ("jax", "jaxlib", "equinox", "numpy")
    versions = ", ".join(f"{name} {importlib.metadata.version(name)}" for name in packages)
    today = datetime.date.today().isoformat()
    cores = (
        len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    )
    python = platform.python_version()
    return f"{today}, {model}, {cores} cores, Python {python}, {versions}"


def measure(f, *args, repeats=30):
    """Time to compile, and median time of a run [s]."""
    start = time.perf_counter()
    compiled = jax.jit(f).lower(*args).compile()
    compiling = time.perf_counter() - start
    jax.block_until_ready(compiled(*args))
    runs = []
    for _ in range(repeats):
        start = time.perf_counter()
        jax.block_until_ready(compiled(*args))
        runs.append(time.perf_counter() - start)
    return compiling, statistics.median(runs)


def bench(order):
    """One line of the table for each function, and the cost of the gradient."""
    plane = job(load(CONFIG).config)
    size = tuple(float(side) for side in plane.setup.size)
    setup = dataclasses.replace(plane.setup, guide=hilbert(order, size))
    settings = {name: getattr(plane.process, name) for name in plane.between}

    # the job is an argument, as it is to the optimiser: a constant would be folded away
    def scalars(settings, setup):
        outcome = polish(dataclasses.replace(plane.process, **settings), setup)
        return {
            field.name: value
            for field in dataclasses.fields(outcome)
            if eqx.is_array(value := getattr(outcome, field.name)) and value.ndim == 0
        }

    def scalar(settings, setup):
        found = scalars(settings, setup)
        return jnp.square(found["Ssk"] + 0.45) + 1e-3 * found["time"]

    cases = {
        "scalars": scalars,
        "jacfwd of scalars": jax.jacfwd(scalars),
        "one scalar": scalar,
        "value_and_grad of it": jax.value_and_grad(scalar),
    }
    runs = {}
    for name, f in cases.items():
        compiling, runs[name] = measure(f, settings, setup)
        print(
            f"| {order} | {name} | {compiling:.2f} | {1e3 * runs[name]:.2f} |", flush=True
        )
    return runs["value_and_grad of it"] / runs["one scalar"]


def main():
    print(machine(), end="\n\n")
    print("| order | function | compile [s] | run [ms] |")
    print("|---|---|---|---|")
    ratios = {order: bench(order) for order in (3, 5)}
    print()
    for order, ratio in ratios.items():
        verdict = "within" if ratio <= MOST else "ABOVE"
        print(f"order {order}: gradient / forward = {ratio:.2f}, {verdict} {MOST:g}")


if __name__ == "__main__":
    main()
