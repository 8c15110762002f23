"""Resume: a search that is killed goes on where it was, and ends at the same answer."""

import json
import os
import random
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from polishopt import Goal, Limits, tune
from polishopt.files.searches import Searches
from polishopt.optimize import tune as module
from polishopt.optimize.kept import Kept, flat, whole
from test_tune import BETWEEN, SETUP, START, toy


STARTS = 64
TARGET = {"Ssk": Goal(-0.75, 0.05), "Sku": Goal(3.6, 0.1)}
CONFIG = Path(__file__).parent.parent / "configs" / "pessoles2009_plane.yaml"


def search(store=None, starts=STARTS, target=None, **more):
    limits = Limits(time=jnp.asarray(1200.0))
    asked = TARGET if target is None else target
    return tune(
        SETUP, START, BETWEEN, asked, limits, starts=starts, chain=toy, store=store, **more
    )


class Killed(BaseException):
    """Like `KeyboardInterrupt`, nothing that anyone would catch on the way."""


latest = {}
"""What the batch that each thread ran last started from."""


class Mortal(Searches):
    """A folder of searches whose process dies at the n-th batch: nothing is kept after."""

    finished: list[bytes] = []
    """What all batches that were kept had started from."""

    def __init__(self, folder, last):
        super().__init__(folder)
        self.left = last

    def __setitem__(self, name, arrays):
        self.left -= 1
        if self.left < 0:
            raise Killed
        super().__setitem__(name, arrays)
        self.finished.append(latest[threading.get_ident()])
        if self.left == 0:
            raise Killed


@pytest.fixture
def runs(monkeypatch):
    """Every batch of searches that is run, by the numbers it starts from."""
    made, real = [], module.searched

    def counted(places, *rest):
        made.append(np.stack([np.asarray(x) for x in places.values()]).tobytes())
        latest[threading.get_ident()] = made[-1]
        return real(places, *rest)

    monkeypatch.setattr(module, "searched", counted)
    return made


@pytest.fixture(scope="module")
def undisturbed():
    return search()


def same(one, other):
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        assert np.asarray(a).tobytes() == np.asarray(b).tobytes()
    assert jax.tree.structure(one) == jax.tree.structure(other)


def test_ten_kills_change_no_bit_and_repeat_no_finished_start(tmp_path, runs, undisturbed):
    """64 starts in 8 batches, and two more to the least cost: each is finished once."""
    finished, lives = set(), [0, 0, 0, 1, 1, 1, 1, 1, 2, 2]
    random.Random(7).shuffle(lives)
    for life in lives:
        mortal = Mortal(tmp_path, life)
        runs.clear()
        with pytest.raises(Killed):
            search(mortal)
        time.sleep(0.05)  # the other thread's batch, finished too late to be kept
        kept = {name for name in mortal if mortal.get(name)}
        assert finished <= kept
        # what was on disk when this run began was not run again
        assert len(runs) <= len(kept - finished) + 2
        finished = kept
    resumed = search(Searches(tmp_path))
    same(resumed, undisturbed)
    assert len(Searches(tmp_path)) == 10
    runs.clear()
    same(search(Searches(tmp_path)), undisturbed)
    assert not runs


def test_no_finished_batch_is_ever_run_again(tmp_path, runs, monkeypatch):
    """By what batches start from, over kills after each single one."""
    monkeypatch.setattr(Mortal, "finished", [])
    store = {}
    search(store, starts=8)
    total = len(runs)
    for _ in range(total):
        runs.clear()
        before = set(Mortal.finished)
        with pytest.raises(Killed):
            search(Mortal(tmp_path, 1), starts=8)
        time.sleep(0.05)  # the other thread's batch, which is not kept
        assert not before & set(runs)
        assert len(runs) <= 2
        assert len(Mortal.finished) == len(before) + 1
    runs.clear()
    search(Mortal(tmp_path, 1), starts=8)
    assert not runs


def test_what_another_search_finished_is_not_taken(runs):
    store, told = {}, []
    search(store, starts=4)
    other = {**TARGET, "Sku": Goal(3.61, 0.1)}
    runs.clear()
    fresh = search(starts=4, target=other)
    alone = len(runs)
    same(search(store, starts=4, target=other, progress=told.append), fresh)
    assert len(runs) == 2 * alone
    assert any("of another config" in sentence for sentence in told)


def test_what_another_version_finished_is_not_taken(runs, monkeypatch):
    store, told = {}, []
    search(store, starts=4)
    first = len(runs)
    from polishopt.optimize import kept

    monkeypatch.setattr(kept, "surroundings", lambda: b"another version")
    search(store, starts=4, progress=told.append)
    assert len(runs) == 2 * first
    assert any("another version of polishopt" in sentence for sentence in told)


def test_more_starts_take_over_those_that_are_finished(runs):
    store = {}
    search(store, starts=8)
    runs.clear()
    search(store, starts=16)
    assert len(runs) == 2 + 2  # eight new starts, and the eight cheapest of all


@pytest.mark.parametrize("harm", ["cut", "empty", "flip", "other"])
def test_a_damaged_file_is_searched_again(tmp_path, harm, runs):
    whole_answer = search(Searches(tmp_path), starts=4)
    done = len(runs)
    path = sorted(tmp_path.iterdir())[0]
    content = bytearray(path.read_bytes())
    if harm == "flip":
        middle = content.index(b"kkt.npy") + 60
        content[middle] ^= 0xFF
    if harm == "other":
        np.savez(path, something=np.arange(3))
    else:
        path.write_bytes({"cut": content[:200], "empty": b""}.get(harm, bytes(content)))
    same(search(Searches(tmp_path), starts=4), whole_answer)
    assert len(runs) == done + 1


def test_a_chain_without_a_name_is_refused():
    with pytest.raises(ValueError, match="no name outside this run"):
        tune(SETUP, START, BETWEEN, TARGET, chain=lambda p, s: toy(p, s), store={})


def test_a_solution_comes_back_as_it_was(undisturbed):
    store = {}
    search(store, starts=4)
    arrays = next(iter(store.values()))
    again = flat(whole(arrays))
    assert again.keys() == arrays.keys() - {"start", "stage"}
    for name, array in again.items():
        assert array.tobytes() == arrays[name].tobytes()
        assert array.dtype == arrays[name].dtype
    assert Kept(store, 1).strange()


def command(folder, *arguments):
    return subprocess.Popen(
        [sys.executable, "-m", "polishopt.fit", str(CONFIG), "-o", str(folder), *arguments],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "POLISHOPT_CACHE": str(folder.parent / "cache")},
    )


SMALL = [
    "--set=guide.order=1",
    "--set=sampling.grid=12",
    "--set=texture.patch_pixels=48",
    "--set=process.step_mm.between=[1, 3]",
    "--set=solver.starts=64",
]


@pytest.mark.slow
def test_the_command_survives_ten_kills(tmp_path):
    """SIGKILL at random moments; the answer is that of a run left in peace."""
    random.seed(3)
    calm = command(tmp_path / "calm", *SMALL)
    assert calm.wait(600) in (0, 3)
    killed = 0
    while killed < 10:
        run = command(tmp_path / "killed", *SMALL, *(["--resume"] if killed else []))
        try:
            run.wait(random.uniform(3.0, 9.0))
            break
        except subprocess.TimeoutExpired:
            os.kill(run.pid, signal.SIGKILL)
            run.wait()
            killed += 1
    run = command(tmp_path / "killed", *SMALL, "--resume")
    assert run.wait(600) == calm.returncode
    results = [
        json.loads((tmp_path / name / "result.json").read_text())
        for name in ("calm", "killed")
    ]
    assert results[0] == results[1]
