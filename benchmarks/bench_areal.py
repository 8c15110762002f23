"""Areal: what the height parameters of a map of 1 Mpx take, next to surfalize.

Prints, for Sa, Sq, Ssk and Sku of 1024 x 1024 heights in float64, the time to compile and
the median time of a warm run, of the values alone and of the values with the gradient of
their sum; then what surfalize takes for the same four on the same map, one by one and as
one call, and the ratio, which a busy machine disturbs less than the times: the runs take
turns. Then the same of the other families. Run as

    python benchmarks/bench_areal.py
"""

import functools
import statistics
import time

import jax
import jax.numpy as jnp
import numpy as np
from bench_polish import machine
from polishopt.texture import (
    areal_parameters,
    functional_parameters,
    height_parameters,
    hybrid_parameters,
    spatial_parameters,
    standard_errors,
)


jax.config.update("jax_enable_x64", True)

SIDE = 1024
# marks for a warm run of the four values, and with their gradient [ms]
MARKS = {"Sa Sq Ssk Sku": 10.0, "with gradient": 25.0}
SHORT = ("surfalize, one by one", "surfalize, one call")
OTHERS = {
    "spatial": ("Sal", "Str", "Std"),
    "hybrid": ("Sdq", "Sdr"),
    "functional": ("Sk", "Spk", "Svk", "Smr1", "Smr2", "Sxp", "Vmp", "Vmc", "Vvv", "Vvc"),
}


def heights():
    """A skewed map with some correlation, as polished surfaces have."""
    noise = np.random.default_rng(0).normal(size=(SIDE, SIDE))
    smooth = sum(np.roll(noise, (i, j), (0, 1)) for i in range(4) for j in range(4)) / 4.0
    return smooth - 0.1 * smooth**2


def four(z):
    p = height_parameters(z)
    return jnp.stack([p.Sa, p.Sq, p.Ssk, p.Sku])


def compiled(f, *args):
    """A function compiled for its arguments, and what that took [s]."""
    start = time.perf_counter()
    made = jax.jit(f).lower(*args).compile()
    return made, time.perf_counter() - start


def take_turns(runs, repeats):
    """Median times of functions that are run in turns [ms]."""
    taken = {name: [] for name in runs}
    for _ in range(repeats):
        for name, run in runs.items():
            start = time.perf_counter()
            jax.block_until_ready(run())
            taken[name].append(1e3 * (time.perf_counter() - start))
    return {name: statistics.median(times) for name, times in taken.items()}


def surfalize_of(z):
    """How to ask surfalize for parameters of the map anew; nothing if it is absent."""
    try:
        import surfalize
    except ImportError:
        return None

    def ask(*names):
        # a new surface each time: it remembers what it has been asked for
        surface = surfalize.Surface(z, 1.0, 1.0)
        return [getattr(surface, name)() for name in names]

    return ask


def main():
    print(machine(), end="\n\n")
    z = heights()
    ask = surfalize_of(z)
    map = jnp.asarray(z)
    made, compiling = {}, {}
    cases = {
        "Sa Sq Ssk Sku": four,
        "with gradient": jax.value_and_grad(lambda z: jnp.sum(four(z))),
        "spatial": lambda z: spatial_parameters(z, 1.0),
        "hybrid": lambda z: hybrid_parameters(z, 1.0),
        "functional": functional_parameters,
        "all parameters": lambda z: areal_parameters(z, 1.0),
        "standard errors": standard_errors,
    }
    for name, f in cases.items():
        made[name], compiling[name] = compiled(f, map)
        jax.block_until_ready(made[name](map))

    runs = {name: functools.partial(f, map) for name, f in made.items()}
    if ask:
        runs["surfalize, one by one"] = functools.partial(ask, "Sa", "Sq", "Ssk", "Sku")
        runs["surfalize, one call"] = functools.partial(ask, "height_parameters")
        for name, asked in OTHERS.items():
            runs[f"surfalize, {name}"] = functools.partial(ask, *asked)
    for run in runs.values():
        run()
    fast = {name: run for name, run in runs.items() if name in (*MARKS, *SHORT)}
    slow = {name: run for name, run in runs.items() if name not in fast}
    runs = take_turns(fast, 30) | take_turns(slow, 3)

    print("| 1 Mpx, float64 | compile [s] | run [ms] |")
    print("|---|---|---|")
    for name, run in runs.items():
        made_in = f"{compiling[name]:.2f}" if name in compiling else ""
        print(f"| {name} | {made_in} | {run:.2f} |")
    print()
    for name, mark in MARKS.items():
        verdict = "within" if runs[name] <= mark else "ABOVE"
        print(f"{name}: {runs[name]:.2f} ms, {verdict} {mark:g} ms")
        if ask:
            for other in ("one by one", "one call"):
                ratio = runs[f"surfalize, {other}"] / runs[name]
                print(f"  surfalize, {other}, takes {ratio:.1f} times as long")


if __name__ == "__main__":
    main()
