"""Corner: a right-angled turn with legs of length one, by arc length.

Every corner of every guide is this one, scaled, turned and mirrored, so it is worth
integrating once to full accuracy on the host. "smooth" turns by a quintic in arc length,
whose curvature and derivative of curvature vanish at both ends; "arc" is the circular
fillet of the paper; "sharp" turns on the spot.
"""

import math

import jax.numpy as jnp
import numpy as np

from ..parts import Scalar


def _series() -> tuple[list[float], list[float], float]:
    r"""Polynomials for the smooth corner, and half its chord.

    With $z \in [-1, 1]$ along the corner the heading is $\pi/4 + h(z)$,
    $h = \frac{\pi}{2} (15 z - 10 z^3 + 3 z^5)/16$. The integral of $\cos h$ is $z$ times
    a function of $z^2$ and the integral of $\sin h$ is $z^2$ times one. Both are smooth
    enough for degree 14 in $v = 2 z^2 - 1$ to be exact to 1e-14; a higher degree only
    collects rounding errors.
    """
    nodes, weights = np.polynomial.legendre.leggauss(40)

    def integral(function, v):
        z = np.sqrt((v + 1) / 2)
        x = z[:, None] * (nodes + 1) / 2
        h = np.pi / 2 * (15 * x - 10 * x**3 + 3 * x**5) / 16
        return z, z / 2 * (function(h) @ weights)

    def even(v):
        z, value = integral(np.cos, v)
        return value / z

    def odd(v):
        z, value = integral(np.sin, v)
        return value / z**2

    chebyshev = np.polynomial.chebyshev
    series = [chebyshev.cheb2poly(chebyshev.chebinterpolate(f, 14)) for f in (even, odd)]
    # python floats, so that they take the precision of what they multiply
    return series[0].tolist(), series[1].tolist(), float(even(np.ones(1))[0])


COSINE, SINE, HALF_CHORD = _series()
# arc length of each corner whose legs have length one; a sharp corner has no legs
LENGTH = {"smooth": math.sqrt(2.0) / HALF_CHORD, "arc": math.pi / 2, "sharp": 0.0}


def unit_corner(corner: str, t: Scalar) -> tuple[Scalar, Scalar, Scalar, Scalar]:
    """A corner to the left with legs of length one.

    Args:
        corner: "smooth", "arc" or "sharp", which has no legs at all.
        t: Arc length from its start over its whole arc length, in [0, 1].

    Returns:
        Position along the entry direction and across it, from its start [legs]; heading
        [rad]; and curvature [1/leg].
    """
    if corner == "sharp":
        zero = jnp.zeros_like(t)
        return zero, zero, jnp.pi / 2 * t, zero
    if corner == "arc":
        heading = jnp.pi / 2 * t
        return jnp.sin(heading), 1 - jnp.cos(heading), heading, jnp.ones_like(t)
    length = LENGTH[corner]
    z = 2 * t - 1
    square = z * z
    v = 2 * square - 1
    even = jnp.zeros_like(z)
    odd = jnp.zeros_like(z)
    for cosine, sine in zip(reversed(COSINE), reversed(SINE), strict=True):
        even = even * v + cosine
        odd = odd * v + sine
    # integrals from the start, where z = -1, of the cosine and the sine of h
    cosines = z * even + HALF_CHORD
    sines = square * odd - sum(SINE)
    scale = length / math.sqrt(8.0)
    heading = jnp.pi / 2 * t**3 * (10 - 15 * t + 6 * t * t)
    curvature = jnp.pi / 2 * 30 * (t * (1 - t)) ** 2 / length
    return scale * (cosines - sines), scale * (cosines + sines), heading, curvature
