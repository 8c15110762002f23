"""Trochoid: loops rolled along the guide, as a hand polishes.

The phase is an argument of its own, not a function of arc length, because the averaged
removal integrates over all phases at one point of the guide.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..parts import Scalar
from .guide import GuidePoint


# the speed along a loop is analytic in the phase, so this many samples are exact to
# rounding unless the loop nearly has a cusp
PHASES = 128


def trochoid(
    point: GuidePoint, phase: Scalar, step: Scalar, radius: Scalar
) -> Float[Array, "2"]:
    r"""Point of the trochoid in the parameter plane [mm].

    $P = C + \frac{p}{2\pi} n + D_{tr} \begin{pmatrix} \cos\varphi & \sin\varphi \\
    -\sin\varphi & \cos\varphi \end{pmatrix} n$ with $n$ to the left of the guide and
    $\varphi = 2 \pi s/p$. The paper calls $D_{tr}$ a diameter, but it acts as the radius
    of the circle: the trochoid is $2 D_{tr}$ wide.

    Args:
        point: Point of the guide, C.
        phase: Angle of the circle, $\varphi$ [rad].
        step: Advance per loop, $p$ [mm].
        radius: Radius of the circle, $D_{tr}$ [mm].

    Source: S0 (Pessoles & Tournier 2009), eqs. (5) and (10).
    """
    # the left normals of the guide, and of its heading turned clockwise by the phase
    drift, swung = step / (2 * jnp.pi), point.heading - phase
    across = -drift * jnp.sin(point.heading) - radius * jnp.sin(swung)
    up = drift * jnp.cos(point.heading) + radius * jnp.cos(swung)
    # lifted, the tool goes straight back
    return point.position + point.contact * jnp.stack([across, up])


def length_per_loop(step: Scalar, radius: Scalar, curvature: Scalar) -> Scalar:
    r"""Length of one loop over a guide of constant curvature [mm].

    $\frac{p}{2\pi} \int_0^{2\pi} \sqrt{c^2 + 2 c a \cos\varphi + a^2}\, d\varphi$ with
    $c = 1 - \kappa p/2\pi$ and $a = (2\pi/p - \kappa) D_{tr}$, by the trapezoidal rule,
    which converges like $\min(a/c, c/a)^n$ in the number of phases n: to rounding where
    $a/c$ is below 0.75 or above 1.3, and to 1e-4 at worst, where the trochoid has cusps
    ($a = c$; on a straight guide $D_{tr} = p/2\pi$). Its gradient is finite everywhere,
    and zero where the loop shrinks to a point.

    Args:
        step: Advance per loop along the guide, $p$ [mm].
        radius: Radius of the circle, $D_{tr}$ [mm].
        curvature: Curvature of the guide, positive to the left, $\kappa$ [1/mm].

    Source: arc length of S0 (Pessoles & Tournier 2009), eq. (5); own derivation.
    """
    # half a sample off the axes of symmetry, so that none falls on a cusp
    phase = 2 * jnp.pi * (jnp.arange(PHASES, dtype=step.dtype) + 0.5) / PHASES
    drift = 1 - curvature * step / (2 * jnp.pi)
    swirl = (2 * jnp.pi / step - curvature) * radius
    square = (drift + swirl * jnp.cos(phase)) ** 2 + (swirl * jnp.sin(phase)) ** 2
    moving = square > 0
    speed = jnp.where(moving, jnp.sqrt(jnp.where(moving, square, 1)), 0)
    return step * jnp.mean(speed)
