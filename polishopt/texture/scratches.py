"""Scratches: the grooves that grains cut, as a random population.

Grains cut grooves all the time and the pad wears them down again, so the texture of a
long polishing step is a balance: shot noise whose pulses decay. The cumulants of such a
population are known in closed form, and they are all that is kept of it. Grooves are
parabolic, as wide as the grain's tip is at their depth, and carry away all that is
removed; ploughed-up ridges are left out.
"""

import math

import jax.numpy as jnp

from ..parts import Abrasive, Scalar
from .areal import Cumulants
from .planarisation import asperity_stiffness, decay_exponent, saturation


# The scratches on a surface, as far as its heights know them.
Scratches = Cumulants

# Integrals of the powers 1 to 4 of a parabola of height one, over its half-width.
PARABOLA = (4.0 / 3.0, 16.0 / 15.0, 32.0 / 35.0, 256.0 / 315.0)


def compression(abrasive: Abrasive, pressure: Scalar) -> Scalar:
    r"""Mean compression of the pad at grain scale, $A = \bar p/K_a$ [mm].

    Scratches decay e-fold while this much is removed.

    Args:
        abrasive: The abrasive and its pad.
        pressure: Mean contact pressure, $\bar p$ [MPa].
    """
    return pressure / asperity_stiffness(abrasive)


def decay_rate(abrasive: Abrasive, pressure: Scalar) -> Scalar:
    r"""Decay of heights per unit removal in full contact, $r = K_a/\bar p$ [1/mm].

    Zero, with zero gradient, at zero pressure: nothing touches and nothing decays.

    Args:
        abrasive: The abrasive and its pad.
        pressure: Mean contact pressure, $\bar p$ [MPa].
    """
    pressed = pressure > 0
    return jnp.where(
        pressed, asperity_stiffness(abrasive) / jnp.where(pressed, pressure, 1.0), 0.0
    )


def groove_depth(abrasive: Abrasive, pressure: Scalar) -> Scalar:
    r"""Mean depth of a groove [mm].

    $\delta = d\sqrt{2\bar p/(\pi c_a H\tan^2\psi)}$: a cone of half-angle $\psi$, in
    contact over its front half while it slides, carries the pressure on an area
    $d^2/c_a$. Zero, with zero gradient, at zero pressure.

    Args:
        abrasive: The abrasive, on its work material.
        pressure: Mean contact pressure, $\bar p$ [MPa].

    Source: Own derivation.
    """
    scale = math.pi * abrasive.active_fraction * abrasive.hardness
    square = 2.0 * pressure / (scale * jnp.tan(abrasive.half_angle) ** 2)
    pressed = square > 0
    root = jnp.sqrt(jnp.where(pressed, square, 1.0))
    return abrasive.grain * jnp.where(pressed, root, 0.0)


def groove_cumulants(abrasive: Abrasive, pressure: Scalar, removal: Scalar) -> Scratches:
    r"""Scratches that one step leaves on a surface that had none.

    $\kappa_n = (-1)^n\,\lambda m_n\,(1 - e^{-nrh})/(nr)$, where grooves arrive at the rate
    $\lambda$ that carries the removal, $\lambda m_1 = 1$, and
    $m_n = c_n E[wD^n]$ with half-width $w \propto D$ and $c_n$ of the parabola. For
    gamma-distributed depths of mean $\delta$ and relative deviation $v$,
    $E[D^{n+1}]/E[D^2] = \delta^{n-1}\prod_{j=2}^{n}(1 + jv^2)$. Grooves of one depth tend
    to $S_{sk} = -0.904\sqrt{\delta/A}$, $S_{ku} = 3 + 0.952\,\delta/A$ with $A = 1/r$.
    All cumulants vanish with removal and with pressure.

    Args:
        abrasive: The abrasive, its pad and its work material.
        pressure: Mean contact pressure, $\bar p$ [MPa].
        removal: Mean height removed in this step, $h$ [mm].

    Source: Own derivation (Campbell's theorem).
    """
    depth = groove_depth(abrasive, pressure)
    wear = compression(abrasive, pressure)
    variance = abrasive.depth_variation**2
    moment, kappa = jnp.ones_like(depth), []
    for n in (2, 3, 4):
        moment = moment * depth * (1.0 + n * variance)
        x, floored = decay_exponent(n * removal, wear)
        # what arrived and has not decayed, h (1 - e^-x)/x; where the exponent is capped it
        # is A/n
        capped = floored > wear
        kept = jnp.where(capped, wear / n, removal * saturation(x))
        kappa.append((-1.0) ** n * PARABOLA[n - 1] / PARABOLA[0] * moment * kept)
    return Scratches(*kappa)


def decay(scratches: Scratches, removal: Scalar, rate: Scalar) -> Scratches:
    r"""Scratches of earlier steps after a further removal: $\kappa_n e^{-nrh}$.

    Args:
        scratches: What was there.
        removal: Mean height removed since, $h$ [mm].
        rate: Decay of heights per unit removal, $r$ [1/mm].
    """
    left = jnp.exp(-rate * removal)
    return Scratches(scratches.k2 * left**2, scratches.k3 * left**3, scratches.k4 * left**4)
