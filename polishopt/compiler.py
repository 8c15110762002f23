"""Compiler: what XLA is told so that programs are quick to make, and quick to run.

Options of one program go with it. What XLA only takes for a whole process is for the
caller to choose, as all global settings are: commands do, the library never.
"""

import functools
import os
import re
from typing import Any

import jax
from jax.extend.core import ClosedJaxpr, Jaxpr


LEVEL = "xla_backend_optimization_level"
# What else XLA is told so that it compiles fast rather than makes fast code: a search
# spends a third of the time on compilation then, and as long as before on its work.
PLAIN = {
    "xla_llvm_disable_expensive_passes": True,
    "xla_cpu_use_fusion_emitters": False,
    "xla_cpu_enable_concurrency_optimized_scheduler": False,
}
# XLA takes this from the environment only, and passes over names that it does not know.
EXTRA, SHARED = "xla_backend_extra_options", "xla_cpu_use_multi_output_fusion"
# Passes of XLA that a program goes without: that one, where it has long loops; and sums in
# two stages, which help single precision, but make a kernel more of every sum.
WITHOUT = "xla_disable_hlo_passes"
ALONE, STAGES = "cpu_multi_output_fusion", "tree_reduction_rewriter"
# A loop of more turns than this is long.
LONG = 64
PROGRAMS = Jaxpr, ClosedJaxpr


def options(program: Jaxpr | None, level: int) -> dict[str, Any]:
    """Options of one program, as far as the compiler at hand knows them.

    Args:
        program: What it does; None where that is not known.
        level: How much XLA does for its speed, from 0 to 3; less, if the environment asks
            for less of all programs.
    """
    asked = re.search(rf"--{LEVEL}=(\d)", os.environ.get("XLA_FLAGS", ""))
    level = min(level, int(asked[1])) if asked else level
    without = [STAGES] if jax.config.read("jax_enable_x64") else []
    if program is None or longest_loop(program) > LONG:
        without.append(ALONE)
    wanted = {LEVEL: level, **PLAIN, WITHOUT: ",".join(without)}
    return {name: value for name, value in wanted.items() if _known(name, value)}


def share_work() -> None:
    """Has a processor work out once what several results of a program need.

    Else XLA writes a loop for each result, and all that leads to it once more: a
    function and its slopes hold the same sums many times over. With this, programs of
    the process model take some half of the time to run and three quarters to compile.

    But in a loop, what a turn adds to an array is no longer written into it: all of it is
    copied in every turn. So programs with long loops go without, if they are `stored`;
    others, which nobody looks at, may take a hundred times as long, so this is for
    commands, which know what they run. Call it before JAX makes its first array: XLA
    reads the environment but once. `XLA_FLAGS` that already hold extra options stay.
    """
    said = os.environ.get("XLA_FLAGS", "")
    if EXTRA not in said:
        os.environ["XLA_FLAGS"] = f"{said} --{EXTRA}={SHARED}".strip()


def longest_loop(program: Jaxpr) -> int:
    """Most turns of any loop over arrays in a program, or in what it calls.

    Args:
        program: What it does.
    """
    longest = 0
    for equation in program.eqns:
        if equation.primitive.name == "scan":
            longest = max(longest, equation.params["length"])
        for inner in jax.tree.leaves(
            list(equation.params.values()), is_leaf=lambda x: isinstance(x, PROGRAMS)
        ):
            if isinstance(inner, PROGRAMS):
                inside = inner.jaxpr if isinstance(inner, ClosedJaxpr) else inner
                longest = max(longest, longest_loop(inside))
    return longest


@functools.cache
def _known(name: str, value: Any) -> bool:
    try:
        jax.jit(lambda: 0, compiler_options={name: value}).lower().compile()
    except (jax.errors.JaxRuntimeError, ValueError):
        return False
    return True
