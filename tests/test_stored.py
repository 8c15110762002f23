"""Stored: a program that was kept is run again without tracing, and only where it fits."""

import os
import subprocess
import sys
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float
from polishopt import stored as module
from polishopt.stored import keep_in, remembered, seldom, stored


class Line(eqx.Module):
    slope: Array
    name: str = eqx.field(static=True)


class Answer(eqx.Module):
    value: Array
    line: Line
    word: str


traced = []


def along(line: Line, x: Float[Array, " n"], power: int = 1) -> Answer:
    traced.append(line.name)
    return Answer(line.slope * x**power, line, f"{line.name} {power}")


def apart(x):
    traced.append("apart")
    return jnp.linalg.solve(jnp.eye(3) * x, jnp.ones(3))


@pytest.fixture
def kept(tmp_path, monkeypatch):
    """A folder for programs; forgets those in memory, as a new process would."""
    monkeypatch.setattr(module, "_made", {})
    keep_in(tmp_path / "programs")
    traced.clear()
    yield tmp_path / "programs"
    keep_in(None)


def again():
    module._made.clear()
    jax.clear_caches()
    traced.clear()


LINE = Line(jnp.asarray(2.0), "steep")
X = jnp.arange(3.0)


def test_a_second_run_does_not_trace(kept):
    first = stored(along)(LINE, X, power=2)
    assert traced == ["steep"]
    again()
    second = stored(along)(LINE, X, power=2)
    assert traced == []
    assert second.word == first.word == "steep 2"
    np.testing.assert_array_equal(second.value, [0, 2, 8])
    assert second.line.name == "steep"
    # other numbers, same program
    np.testing.assert_array_equal(stored(along)(LINE, 2 * X, power=2).value, [0, 8, 32])
    assert traced == []


@pytest.mark.parametrize(
    "given",
    [
        ((LINE, X), {"power": 3}),
        ((LINE, jnp.arange(4.0)), {"power": 2}),
        ((Line(jnp.asarray(2.0), "flat"), X), {"power": 2}),
        ((LINE, X, 2), {}),
    ],
)
def test_another_call_is_another_program(kept, given):
    stored(along)(LINE, X, power=2)
    again()
    args, kwargs = given
    found = stored(along)(*args, **kwargs)
    assert traced == [args[0].name]
    expected = along(*args, **kwargs)
    np.testing.assert_allclose(found.value, expected.value)
    assert found.word == expected.word


def swapped(pair: tuple[Array | None, Array | None]) -> str:
    return "first" if pair[1] is None else "second"


def test_where_an_array_is_missing_is_part_of_the_program(kept):
    """Two limits that could be set, of which one is: another program for each."""
    assert stored(swapped)((X, None)) == "first"
    assert stored(swapped)((None, X)) == "second"
    again()
    assert stored(swapped)((None, X)) == "second"


def test_a_program_can_be_made_ahead(kept):
    """From shapes alone, traced once, also where it is read from disk."""
    shape = jax.ShapeDtypeStruct(X.shape, X.dtype)
    for _ in range(2):
        outline = stored(along).ahead(LINE, shape, power=2)
        assert outline.value.shape == (3,)
        assert outline.word == "steep 2"
        np.testing.assert_array_equal(stored(along)(LINE, X, power=2).value, [0, 2, 8])
        assert len(traced) <= 1
        again()


def test_a_program_can_be_made_meanwhile(kept):
    """Whoever needs it waits for it, and says what is wrong with it."""
    stored(along).meanwhile(LINE, X, power=2)
    np.testing.assert_array_equal(stored(along)(LINE, X, power=2).value, [0, 2, 8])
    assert len(traced) == 1
    wrong: dict[str, Any] = {"wrong": 2}
    stored(along).meanwhile(LINE, X, **wrong)
    with pytest.raises(TypeError, match="wrong"):
        stored(along)(LINE, X, **wrong)


def test_sharing_parts_makes_no_difference(kept):
    name = "".join(["sta", "tic"])
    stored(along)(Line(jnp.asarray(1.0), name), X, power=2)
    again()
    stored(along)(Line(jnp.asarray(1.0), "".join(["stat", "ic"])), X, power=2)
    assert traced == []


def test_another_package_is_another_program(kept, monkeypatch):
    stored(along)(LINE, X)
    again()
    monkeypatch.setattr(module, "surroundings", lambda: b"another version")
    stored(along)(LINE, X)
    assert traced == ["steep"]


def test_a_spoilt_file_is_written_anew(kept):
    stored(along)(LINE, X)
    (path,) = kept.iterdir()
    whole = path.read_bytes()
    for spoilt in (b"", whole[: len(whole) // 2], b"cposix\nabort\n"):
        path.write_bytes(spoilt)
        again()
        np.testing.assert_array_equal(stored(along)(LINE, X).value, [0, 2, 4])
        assert traced == ["steep"]
        assert path.stat().st_size > len(whole) // 2


def test_transformations_see_the_function_itself(kept):
    slope = jax.grad(lambda s: stored(along)(Line(s, "steep"), X).value.sum())(2.0)
    assert slope == 3.0
    both = jax.vmap(lambda x: stored(along)(LINE, x).value)(jnp.ones((2, 3)))
    np.testing.assert_array_equal(both, np.full((2, 3), 2.0))
    assert not kept.exists()


def test_functions_without_a_name_are_not_kept(kept):
    assert stored(lambda x: x + 1)(X)[0] == 1
    # nor are calls with such a function
    assert stored(eqx.Partial)(lambda x: x, X).args[0] is not None
    assert not kept.exists()


def test_nothing_is_kept_unasked(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "_made", {})
    monkeypatch.chdir(tmp_path)
    stored(along)(LINE, X)
    assert not list(tmp_path.iterdir())


def test_linear_algebra_in_a_new_process(kept):
    """Where LAPACK was not called before, a program that was read must find it."""
    # a command that ran in this process may have added to XLA_FLAGS since
    module.surroundings.cache_clear()
    stored(apart)(jnp.asarray(2.0))
    code = (
        "import jax, sys; jax.config.update('jax_enable_x64', True);"
        f"sys.path.insert(0, {os.path.dirname(__file__)!r}); import test_stored as t;"
        f"t.keep_in(__import__('pathlib').Path({str(kept)!r}));"
        "print(t.stored(t.apart)(t.jnp.asarray(2.0)), t.traced)"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert ran.stdout.strip() == "[0.5 0.5 0.5] []", ran.stderr


def test_what_is_seldom_run_has_a_program_of_its_own(kept):
    quick, slow = seldom(along), stored(along)
    assert (quick.level, slow.level) == (0, 1)
    np.testing.assert_array_equal(
        quick(LINE, X, power=2).value, slow(LINE, X, power=2).value
    )
    assert len(list(kept.iterdir())) == 2


def test_numbers_are_kept_and_made_again_where_they_cannot_be_read(kept):
    made = []

    def make():
        made.append(1)
        return np.arange(3.0)

    for _ in range(2):
        np.testing.assert_array_equal(remembered("three", ["1"], make), [0, 1, 2])
    assert len(made) == 1
    remembered("three", ["2"], make)  # made by another version
    assert len(made) == 2
    for file in kept.iterdir():
        file.write_bytes(b"cut off")
    np.testing.assert_array_equal(remembered("three", ["1"], make), [0, 1, 2])
    assert len(made) == 3
