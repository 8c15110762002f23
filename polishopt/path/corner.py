"""Corner: a turn with legs of length one, by arc length.

A corner of a guide is one of these, scaled, turned and mirrored. "smooth" turns by a
quintic in arc length, whose curvature and derivative of curvature vanish at both ends;
"arc" is the circular fillet of the paper, whose curvature jumps; "sharp" turns on the
spot. The quintic has no closed form in space, so it is integrated once, on the host and
to full accuracy, for each angle that a guide turns by.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..parts import as_array


CORNERS = ("smooth", "arc", "sharp")
# Both integrals are smooth enough for this degree in v = 2 z^2 - 1 to be exact to 1e-14 up
# to a right angle and to 1e-12 beyond; a higher degree only collects rounding errors.
DEGREE = 14


class Shapes(eqx.Module):
    """Corners with legs of length one, one an angle."""

    angle: Float[Array, "*n"]
    """By how much they turn, alpha [rad]."""
    length: Float[Array, "*n"]
    """Arc length [leg]; 0 for a sharp corner, which has no legs."""
    half_chord: Float[Array, "*n"]
    """Half the chord over half the arc length [-]."""
    cosines: Float[Array, "*n degree_and_1"]
    """Powers of v in the integral of the cosine [-]."""
    sines: Float[Array, "*n degree_and_1"]
    """Powers of v in the integral of the sine [-]."""


def shapes(corner: str, angles: np.ndarray) -> Shapes:
    r"""The corners that turn by given angles.

    With $z \in [-1, 1]$ along the corner the heading is that of the bisector plus
    $h = \frac{\alpha}{2} (15 z - 10 z^3 + 3 z^5)/8$. The integral of $\cos h$ is $z$ times
    a function of $z^2$ and the integral of $\sin h$ is $z^2$ times one.

    Args:
        corner: "smooth", "arc" or "sharp".
        angles: Turns, in (0, pi) [rad].

    Source: Own derivation.
    """
    angles = np.asarray(angles, dtype=float)
    chebyshev = np.polynomial.chebyshev
    v = chebyshev.chebpts1(DEGREE + 1)
    z = np.sqrt((v + 1) / 2)
    nodes, weights = np.polynomial.legendre.leggauss(40)
    x = np.append(z, 1.0)[:, None] * (nodes + 1) / 2
    h = angles[:, None, None] / 2 * (15 * x - 10 * x**3 + 3 * x**5) / 8
    even = np.cos(h) @ weights / 2
    odd = np.sin(h[:, :-1]) @ weights / 2 / z
    fit = np.linalg.inv(chebyshev.chebvander(v, DEGREE))
    powers = np.zeros((DEGREE + 1, DEGREE + 1))
    for i, row in enumerate(np.eye(DEGREE + 1)):
        powers[i, : i + 1] = chebyshev.cheb2poly(row[: i + 1])
    half = even[:, -1]
    lengths = {
        "smooth": 2 * np.cos(angles / 2) / half,
        "arc": angles / np.tan(angles / 2),
        "sharp": np.zeros_like(angles),
    }
    return Shapes(
        angle=as_array(angles),
        length=as_array(lengths[corner]),
        half_chord=as_array(half),
        cosines=as_array(even[:, :-1] @ fit.T @ powers),
        sines=as_array(odd @ fit.T @ powers),
    )


def unit_corner(
    corner: str, shape: Shapes, t: Float[Array, "*k"]
) -> tuple[Float[Array, "*k"], ...]:
    """A corner to the left with legs of length one.

    Args:
        corner: "smooth", "arc" or "sharp", which has no legs at all.
        shape: One of its `shapes`.
        t: Arc length from its start over its whole arc length, in [0, 1].

    Returns:
        Position along the entry direction and across it, from its start [legs]; and
        heading [rad].
    """
    angle = shape.angle
    if corner == "sharp":
        zero = jnp.zeros_like(t)
        return zero, zero, angle * t
    if corner == "arc":
        heading = angle * t
        radius = shape.length / angle
        return radius * jnp.sin(heading), radius * (1 - jnp.cos(heading)), heading
    z = 2 * t - 1
    square = z * z
    v = 2 * square - 1
    both = jnp.zeros((2, *v.shape), v.dtype)
    for powers in reversed(list(jnp.stack([shape.cosines, shape.sines], axis=1))):
        both = both * v[None] + jnp.expand_dims(powers, range(1, 1 + v.ndim))
    even, odd = both
    # integrals from the start, where z = -1, of the cosine and the sine of h
    cosines = z * even + shape.half_chord
    sines = square * odd - jnp.sum(shape.sines)
    scale, c, s = shape.length / 2, jnp.cos(angle / 2), jnp.sin(angle / 2)
    heading = angle * t**3 * (10 - 15 * t + 6 * t * t)
    return scale * (c * cosines - s * sines), scale * (s * cosines + c * sines), heading


def unit_curvature(corner: str, shape: Shapes, t: Float[Array, "*k"]) -> Float[Array, "*k"]:
    """Curvature of a `unit_corner` [1/leg].

    Args:
        corner: As there.
        shape: As there.
        t: As there.
    """
    if corner == "sharp":
        return jnp.zeros_like(t)
    if corner == "arc":
        return jnp.ones_like(t) * shape.angle / shape.length
    return shape.angle * 30 * (t * (1 - t)) ** 2 / shape.length
