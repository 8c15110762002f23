r"""Exact: derivatives of axes and contact length along a path that is known as a function.

Differences of samples are blind to what happens between them, and a rotary axis that
whips past the pole does most of it there. Where the path is a function of its parameter,
forward differentiation gives its derivatives at the samples without error.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


class Derivatives(NamedTuple):
    """First, second and third derivatives by the path parameter at each sample."""

    dq: Float[Array, "n m"]
    """Of the axis positions."""
    ddq: Float[Array, "n m"]
    """The same twice."""
    dddq: Float[Array, "n m"]
    """And three times."""
    length: Float[Array, "n 3"]
    """Of the contact path's length [mm/parameter^k]."""


def exact(
    path: Callable[[Float[Array, " n"]], tuple[Float[Array, "n m"], Float[Array, "n 3"]]],
    sigma: Float[Array, " n"],
) -> Derivatives:
    r"""Derivatives of a path for `jerk_law_from_derivatives` and its like.

    With $X$ the contact point, $L' = |X'|$, $L'' = X' \cdot X'' / L'$ and
    $L''' = (X'' \cdot X'' + X' \cdot X''' - L''^2) / L'$.

    Args:
        path: Axis positions and contact points [mm] at given values of the parameter, each
            sample by itself (whole turns apart, see `inverse_path`).
        sigma: The parameter at the samples. The contact point must move at each.

    Source: Own derivation.
    """
    one = jnp.ones_like(sigma)

    def once(s):
        return jax.jvp(path, (s,), (one,))[1]

    def twice(s):
        first, second = jax.jvp(once, (s,), (one,))
        return first, second

    (first, second), (_, third) = jax.jvp(twice, (sigma,), (one,))
    (dq, x1), (ddq, x2), (dddq, x3) = first, second, third

    def dot(a, b):
        return jnp.sum(a * b, axis=1)

    rate = jnp.sqrt(dot(x1, x1))
    bend = dot(x1, x2) / rate
    twist = (dot(x2, x2) + dot(x1, x3) - bend**2) / rate
    return Derivatives(dq, ddq, dddq, jnp.stack([rate, bend, twist], axis=1))
