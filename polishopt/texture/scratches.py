"""Scratches: the grooves that grains cut, as a random population.

Grains cut grooves all the time and the pad wears them down again, so the texture of a
long polishing step is a balance: shot noise whose pulses decay. The cumulants of such a
population are known in closed form, and they are all that is kept of it. Grooves are
parabolic, as wide as the grain's tip is at their depth, and carry away all that is
removed; ploughed-up ridges are left out.
"""

import math
from collections.abc import Iterator
from typing import TypeVar

import equinox as eqx
import jax.numpy as jnp

from ..parts import Abrasive, Scalar, as_scalar
from .areal import Cumulants
from .filters import ALPHA
from .planarisation import asperity_stiffness, decay_exponent, saturation


# The scratches on a surface, as far as its heights know them.
Scratches = Cumulants

# Those of the cumulants that make up Sq, Ssk and Sku.
ORDERS = (2, 3, 4)

# Integrals of the powers 1 to 4 of a parabola of height one, over its half-width.
PARABOLA = (4.0 / 3.0, 16.0 / 15.0, 32.0 / 35.0, 256.0 / 315.0)

# Mean square slope over mean square height of such a parabola, times its half-width
# squared: the integral of (2u)^2 over that of (1 - u^2)^2.
STEEPNESS = 5.0 / 2.0


class Population(eqx.Module):
    """Scratches of one grade: what the heights know of them, and how wide they are."""

    k2: Scalar = eqx.field(converter=as_scalar, default=0.0)
    """Variance [mm^2]."""
    k3: Scalar = eqx.field(converter=as_scalar, default=0.0)
    """Third central moment [mm^3]."""
    k4: Scalar = eqx.field(converter=as_scalar, default=0.0)
    """Fourth central moment less 3 k2^2 [mm^4]."""
    width: Scalar = eqx.field(converter=as_scalar, default=0.0)
    """Mean half-width of the grooves [mm]; 0 where unknown, as if no pad could follow."""

    def __iter__(self) -> Iterator[Scalar]:
        return iter((self.k2, self.k3, self.k4))

    @property
    def cumulants(self) -> Cumulants:
        """The same scratches without their width."""
        return Cumulants(self.k2, self.k3, self.k4)


SomeScratches = TypeVar("SomeScratches", Cumulants, Population)


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


def groove_width(abrasive: Abrasive, pressure: Scalar) -> Scalar:
    r"""Mean half-width of the grooves, each weighted by its share of the variance [mm].

    $E[w^2D^2]/E[wD^2] = \delta\tan\psi\,(1 + 3v^2)$ for half-widths $w = D\tan\psi$
    of gamma-distributed depths of mean $\delta$ and relative deviation $v$.

    Args:
        abrasive: The abrasive, on its work material.
        pressure: Mean contact pressure, $\bar p$ [MPa].

    Source: Own derivation.
    """
    spread = 1.0 + 3.0 * abrasive.depth_variation**2
    return groove_depth(abrasive, pressure) * jnp.tan(abrasive.half_angle) * spread


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
    moment, moments = jnp.ones_like(depth), []
    for n in ORDERS:
        moment = -moment * depth * (1.0 + n * variance)
        moments.append(-PARABOLA[n - 1] / PARABOLA[0] * moment)
    # one axis for the orders: their decays are one program then, not three
    order = jnp.asarray(ORDERS, removal.dtype)
    x, floored = decay_exponent(order * removal, wear)
    # what arrived and has not decayed, h (1 - e^-x)/x; where the exponent is capped it is
    # A/n
    kept = jnp.where(floored > wear, wear / order, removal * saturation(x))
    kappa = (moment * one for moment, one in zip(moments, kept, strict=True))
    return Scratches(*kappa)


def groove_population(abrasive: Abrasive, pressure: Scalar, removal: Scalar) -> Population:
    """Scratches that one step leaves on a surface that had none, with their width.

    Args:
        abrasive: The abrasive, its pad and its work material.
        pressure: Mean contact pressure [MPa].
        removal: Mean height removed in this step [mm].
    """
    cumulants = groove_cumulants(abrasive, pressure, removal)
    return Population(*cumulants, width=groove_width(abrasive, pressure))


def followed_share(width: Scalar, conformity: Scalar | float) -> Scalar:
    r"""Share of a groove that the pad bends to follow, and so does not wear [-].

    The pad follows waves by the Gaussian transmission $T = e^{-2\pi^2\sigma^2/\lambda^2}$,
    $\sigma = \alpha\ell_c/\sqrt{2\pi}$, and the variance of a groove starts to decay at
    the mean of $1 - T$ over its power spectrum. For a Gaussian spectrum that is closed:
    $\bar T = (1 + c\,\sigma^2/w^2)^{-1/2}$, with c from the mean square slope over the
    mean square height, 5/2 for a parabola of half-width w. Wide grooves thus act like a
    wave of length $2\pi w\sqrt{2/5} = 3.97\,w$; of narrow ones the pad follows the
    few waves longer than $\ell_c$ that they have, $0.63\,w/\sigma$ (the parabola itself
    $0.66\,w/\sigma$). Zero where the width is.

    Args:
        width: Half-width of the groove, $w$ [mm].
        conformity: Wavelength that the pad follows by half, $\ell_c$ [mm]; infinite for a
            flat pad.

    Source: Own derivation.
    """
    width = jnp.asarray(width)
    conformity = jnp.asarray(conformity, dtype=width.dtype)
    bends = jnp.isfinite(conformity) & (width > 0)
    reach = ALPHA * jnp.where(bends, conformity, 0.0) / jnp.where(bends, width, 1.0)
    share = 1.0 / jnp.sqrt(1.0 + STEEPNESS / (2.0 * math.pi) * reach**2)
    return jnp.where(bends, share, 0.0)


def survival(
    removal: Scalar,
    rate: Scalar,
    width: Scalar | float = 0.0,
    conformity: Scalar | float = math.inf,
) -> Scalar:
    r"""Share of the height of a groove that a further removal leaves [-].

    $e^{-rh(1 - \bar T)}$ with the share $\bar T$ that the pad follows.

    Args:
        removal: Mean height removed since, $h$ [mm].
        rate: Decay of heights per unit removal in full contact, $r$ [1/mm].
        width: Half-width of the groove [mm]; 0 decays at the full rate.
        conformity: Wavelength that the pad follows by half [mm].
    """
    given = jnp.asarray(width, dtype=removal.dtype)
    return jnp.exp(-rate * removal * (1.0 - followed_share(given, conformity)))


def decay(
    scratches: SomeScratches,
    removal: Scalar,
    rate: Scalar,
    conformity: Scalar | float = math.inf,
) -> SomeScratches:
    r"""Scratches of earlier steps after a further removal.

    $\kappa_n \to \kappa_n e^{-nrh(1 - \bar T)}$ by their own width, see
    `followed_share`; scratches that do not know their width decay at the full rate. The
    few waves of narrow grooves that are longer than the conformity length, which stay as
    waviness, are counted as if they went with the rest: taking them out is the business
    of the roughness filter.

    Args:
        scratches: What was there.
        removal: Mean height removed since, $h$ [mm].
        rate: Decay of heights per unit removal in full contact, $r$ [1/mm].
        conformity: Wavelength that the pad follows by half, $\ell_c$ [mm].
    """
    width = scratches.width if isinstance(scratches, Population) else 0.0
    left = survival(removal, rate, width, conformity)
    k2, k3, k4 = (k * left**n for n, k in zip(ORDERS, scratches, strict=True))
    if isinstance(scratches, Population):
        return Population(k2, k3, k4, scratches.width)
    return Cumulants(k2, k3, k4)
