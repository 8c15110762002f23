"""What XLA is told: as much as was asked for, and what the caller said stays."""

import os
import subprocess
import sys

import jax
import pytest
from polishopt.compiler import (
    ALONE,
    EXTRA,
    LEVEL,
    LONG,
    SHARED,
    STAGES,
    WITHOUT,
    longest_loop,
    options,
    share_work,
)


# Two results that need the same sum.
COUNTED = """
import sys, jax, jax.numpy as jnp
from polishopt.compiler import share_work
if "share" in sys.argv:
    share_work()
def both(x):
    a = x + 1
    return a * x, a - 2 * x
text = jax.jit(both).lower(jnp.ones((7, 9))).compile().as_text()
print(text.count(" add("))
"""


# A loop whose turns hand out two things that need the same sum.
LOOPED = """
import re, jax, jax.numpy as jnp
from polishopt.compiler import options, share_work
share_work()
def step(c, a):
    d = jnp.sin(c) + a
    return d, (d * a, d + 2 * a)
looped = jax.jit(lambda x: jax.lax.scan(step, x[0], x))
traced = looped.trace(jnp.ones(999))
for told in ({}, options(traced.jaxpr.jaxpr, 1)):
    text = traced.lower().compile(told).as_text()
    print(bool(re.search(r"= [(][^)]*[[]999[]][^)]*[[]999[]][^)]*[)] fusion[(]", text)))
"""


def turns(count):
    """A program with a loop of that many turns, within another one."""

    def turn(x, _):
        return x + 1, x

    def both(x):
        once = jax.jit(lambda x: jax.lax.scan(turn, x, length=count))
        return jax.lax.cond(x > 0, once, once, x)

    return jax.make_jaxpr(both)(1.0).jaxpr


@pytest.mark.parametrize(("flags", "level"), [("", 1), (f"--{LEVEL}=0", 0)])
def test_no_program_is_optimised_more_than_the_environment_asks_for(
    flags, level, monkeypatch
):
    monkeypatch.setenv("XLA_FLAGS", flags)
    assert options(turns(3), 1)[LEVEL] == level
    assert options(turns(3), 0)[LEVEL] == 0


def test_programs_with_long_loops_go_without_sharing():
    assert longest_loop(turns(3)) == 3
    assert longest_loop(turns(1000)) == 1000
    assert ALONE not in options(turns(LONG), 1)[WITHOUT].split(",")
    assert ALONE in options(turns(LONG + 1), 1)[WITHOUT].split(",")
    # and where nobody knows
    assert ALONE in options(None, 1)[WITHOUT].split(",")


def test_sums_of_double_precision_are_in_one_stage():
    with jax.enable_x64(True):
        summed = jax.jit(lambda x: jax.numpy.sum(jax.numpy.sin(x)))
        traced = summed.trace(jax.numpy.ones((4, 128)))
        told = options(traced.jaxpr.jaxpr, 1)
        texts = [
            traced.lower().compile(told | {WITHOUT: passes}).as_text()
            for passes in ("", told[WITHOUT])
        ]
        assert ["reduce-window" in str(text) for text in texts] == [True, False]
    with jax.enable_x64(False):
        assert STAGES not in options(traced.jaxpr.jaxpr, 1)[WITHOUT]


@pytest.mark.parametrize(("before", "after"), [
    (None, f"--{EXTRA}={SHARED}"),
    ("", f"--{EXTRA}={SHARED}"),
    (f"--{LEVEL}=0", f"--{LEVEL}=0 --{EXTRA}={SHARED}"),
    (f"--{EXTRA}=mine", f"--{EXTRA}=mine"),
    (f"--{EXTRA}={SHARED}", f"--{EXTRA}={SHARED}"),
])  # fmt: skip
def test_what_the_caller_says_stays(before, after, monkeypatch):
    if before is None:
        monkeypatch.delenv("XLA_FLAGS", raising=False)
    else:
        monkeypatch.setenv("XLA_FLAGS", before)
    share_work()
    assert os.environ["XLA_FLAGS"] == after


@pytest.mark.parametrize(("word", "count"), [("share", 1), ("alone", 2)])
def test_what_two_results_need_is_worked_out_once(word, count):
    """The second case says that there is something to ask XLA for; if it fails, there is
    no more need to."""
    bare = {name: said for name, said in os.environ.items() if name != "XLA_FLAGS"}
    ran = subprocess.run(
        [sys.executable, "-c", COUNTED, word], capture_output=True, text=True, env=bare
    )
    assert ran.stdout.strip() == str(count), ran.stderr


def test_a_long_loop_is_written_in_place_all_the_same():
    """What a turn adds must not make XLA copy what all others did: a fusion of the loop's
    body that hands out two whole arrays would."""
    bare = {name: said for name, said in os.environ.items() if name != "XLA_FLAGS"}
    ran = subprocess.run(
        [sys.executable, "-c", LOOPED], capture_output=True, text=True, env=bare
    )
    assert ran.stdout.split() == ["True", "False"], ran.stderr
