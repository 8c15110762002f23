"""Batched: the same as all places at once, whatever is left for the last batch."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close
from polishopt.batched import in_batches


@pytest.mark.parametrize("count", [1, 3, 4, 8, 10])
def test_every_place_is_worked_off_once(count):
    places = {"x": jnp.arange(1.0, count + 1), "y": jnp.ones((count, 2))}

    def total(scale):
        done = in_batches(
            lambda at: (jnp.sin(scale * at["x"]), scale * at["y"]), places, size=4
        )
        assert done[0].shape == (count,)
        assert done[1].shape == (count, 2)
        return jnp.sum(done[0]) + jnp.sum(done[1])

    x = np.arange(1.0, count + 1)
    got, slope = jax.jit(jax.value_and_grad(total))(jnp.asarray(0.7))
    assert_close(got, np.sin(0.7 * x).sum() + 1.4 * count)
    assert_close(slope, (x * np.cos(0.7 * x)).sum() + 2 * count)


def test_nothing_is_compiled_twice():
    """A remainder is no program of its own."""

    def traced(count):
        f = lambda x: in_batches(jnp.sin, x, size=4)  # noqa: E731
        return jax.jit(f).lower(jnp.ones(count)).as_text().count("stablehlo.sine")

    assert traced(8) == traced(10) == 1
