"""Comparisons that several tests share."""

import jax
import jax.numpy as jnp
import numpy as np


def assert_close(got, want, rtol=1e-9, atol=0.0):
    """Equal within tolerance, of the same shape, and nowhere NaN."""
    got, want = np.asarray(got), np.asarray(want)
    assert np.isfinite(got).all(), f"not finite: {got}"
    np.testing.assert_allclose(got, np.broadcast_to(want, got.shape), rtol=rtol, atol=atol)


def assert_gradient(f, x, rtol=1e-5, atol=1e-9, step=1e-5):
    """Forward mode = reverse mode = central differences, for f of one 1-D array.

    `step` is relative to the size of each entry (or absolute for zeros).
    """
    f = jax.jit(f)
    forward, reverse = jax.jacfwd(f)(x), jax.jacrev(f)(x)
    assert_close(forward, reverse, rtol=1e-8, atol=atol)
    columns = []
    for i in range(x.size):
        h = step * (abs(float(x[i])) or 1.0)
        e = jnp.zeros_like(x).at[i].set(h)
        columns.append((np.asarray(f(x + e)) - np.asarray(f(x - e))) / (2 * h))
    assert_close(forward, np.stack(columns, axis=-1), rtol=rtol, atol=atol)
