"""Banded: linear systems whose unknowns meet only their two neighbours on either side."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


class Band(eqx.Module):
    """A symmetric positive definite matrix with two diagonals on either side."""

    diagonal: Float[Array, " n"]
    """Entries (i, i)."""
    first: Float[Array, " n"]
    """Entries (i, i + 1); the last one is not looked at."""
    second: Float[Array, " n"]
    """Entries (i, i + 2); the last two are not looked at."""


def solve(band: Band, right: Float[Array, " n"]) -> Float[Array, " n"]:
    r"""The x with band x = right, by Cholesky's method ($L D L^T$).

    Derivatives by the right side cost one more such system; those by the matrix are taken
    as zero.

    Args:
        band: The matrix.
        right: The right side.

    Returns:
        The solution.
    """
    band = jax.lax.stop_gradient(band)
    return jax.lax.custom_linear_solve(
        functools.partial(_times, band), right, lambda _, r: _solve(band, r), symmetric=True
    )


def _times(band: Band, x: Float[Array, " n"]) -> Float[Array, " n"]:
    """The matrix times x."""
    one, two = band.first[:-1], band.second[:-2]
    out = band.diagonal * x
    out = out + jnp.pad(one * x[1:], (0, 1)) + jnp.pad(one * x[:-1], (1, 0))
    return out + jnp.pad(two * x[2:], (0, 2)) + jnp.pad(two * x[:-2], (2, 0))


def _solve(band: Band, right: Float[Array, " n"]) -> Float[Array, " n"]:
    """Factor and substitute in one sweep forward, and substitute in one backward."""
    zero = jnp.zeros_like(right[0])

    def forward(carry, row):
        # of the row before: what it takes from this pivot, its multiplier into this row
        # and into the next one, and its right side; of the row before that, the same
        a, b, c, r = row
        lost, mix, take, two, push = carry
        pivot = a - lost
        beside = b - mix
        rest = r - take
        l1, l2 = beside / pivot, c / pivot
        # next row: pivot loses l1 beside and what `two` holds; see the module's algebra
        carry = (l1 * beside + two, l1 * c, l1 * rest + push, l2 * c, l2 * rest)
        return carry, (rest / pivot, l1, l2)

    def backward(carry, row):
        after, later = carry
        z, l1, l2 = row
        x = z - l1 * after - l2 * later
        return (x, after), x

    rows = (band.diagonal, band.first, band.second, right)
    _, factored = jax.lax.scan(forward, (zero,) * 5, rows)
    return jax.lax.scan(backward, (zero, zero), factored, reverse=True)[1]
