"""Evolution: the texture after a polishing step, as a sum of independent parts.

What is left of the start topography, the scratches of this step and of earlier ones, and
the ripple of the tool path do not know of each other, so their cumulants add. A drawn
patch makes the same sum with actual grooves and waves, to look at and to check by.
"""

import functools
import math
import operator

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float, Key

from ..parts import Abrasive, Scalar
from .areal import Cumulants, Sa_estimate, parameters_from_cumulants
from .filters import gaussian_transmission
from .planarisation import decay_exponent
from .scratches import PARABOLA, Population, compression, groove_depth


class Texture(eqx.Module):
    """Height parameters of a finished surface, predicted from its cumulants."""

    Sa: Scalar
    """Mean absolute height, estimated [mm]."""
    Sq: Scalar
    """Root mean square height [mm]."""
    Ssk: Scalar
    """Skewness [-]."""
    Sku: Scalar
    """Kurtosis [-]."""


def ripple_cumulants(
    amplitudes: Float[Array, " n"],
    wavelengths: Float[Array, " n"],
    cutoff: Scalar | float = math.inf,
) -> Cumulants:
    r"""Cumulants of independent sine waves that pass the roughness filter.

    $\kappa_2 = \sum a^2/2$, $\kappa_3 = 0$, $\kappa_4 = -\frac38\sum a^4$ with amplitudes
    $a(1 - T(\lambda))$. Harmonics of one wave are not independent of each other; their
    $\kappa_3$ is left out.

    Args:
        amplitudes: Half the height of each wave, $a$ [mm].
        wavelengths: Length of each wave, $\lambda$ [mm].
        cutoff: Where the roughness filter halves a wave [mm]; infinite for no filter.
    """
    square = (amplitudes * (1.0 - gaussian_transmission(wavelengths, cutoff))) ** 2
    k2 = jnp.sum(square) / 2.0
    return Cumulants(k2, jnp.zeros_like(k2), -0.375 * jnp.sum(square**2))


def combine(*parts: Cumulants | Population) -> Texture:
    r"""Texture of a surface that is the sum of independent parts.

    $m_2 = \sum\kappa_2$, $m_3 = \sum\kappa_3$, $m_4 = \sum\kappa_4 + 3m_2^2$. With no
    height at all, Ssk = 0 and Sku = 3.

    Args:
        parts: Cumulants of each part; the width of scratches does not matter.
    """
    sums = [functools.reduce(operator.add, k) for k in zip(*parts, strict=True)]
    Sq, Ssk, Sku = parameters_from_cumulants(*sums)
    return Texture(Sa_estimate(Sq, Ssk, Sku), Sq, Ssk, Sku)


class _Grooves(eqx.Module):
    """Drawn grooves: straight lines x cos(angle) + y sin(angle) = offset."""

    angle: Float[Array, " n"]
    offset: Float[Array, " n"]
    depth: Float[Array, " n"]
    width: Float[Array, " n"]


def draw_patch(
    key: Key[Array, ""],
    abrasive: Abrasive,
    pressure: Scalar,
    removal: Scalar,
    shape: tuple[int, int],
    extent: Float[Array, "2"],
    grooves: int = 4096,
    amplitudes: Float[Array, " n"] | None = None,
    wavelengths: Float[Array, " n"] | None = None,
    start: Float[Array, "ny nx"] | None = None,
    directions: Float[Array, " bins"] | None = None,
) -> Float[Array, "ny nx"]:
    r"""A drawn height map of a polished surface [mm].

    Grooves are straight lines across the patch, with every offset equally likely, each
    worn down by $e^{-a/A}$ while $a$ was removed since. A point finds
    $\lambda$ lines per unit of distance from it and of removal, with
    $\lambda\,\frac43 E[wD] = 1$ and $w = D\tan\psi$, so a disc of radius $\varrho$ around
    the patch is met by $2\varrho\lambda$ per unit removal. The latest `grooves` are drawn;
    those left out have decayed the most. Heights are relative to the expected mean, which
    one patch need not have.

    Args:
        key: Random key; the same key draws the same patch.
        abrasive: The abrasive, its pad and its work material.
        pressure: Mean contact pressure, above zero [MPa].
        removal: Mean height removed in this step [mm].
        shape: Points along y and along x.
        extent: Length of the patch along y and along x [mm].
        grooves: Largest number of grooves to draw.
        amplitudes: Amplitudes of the ripple's waves [mm]; each runs in a random direction.
        wavelengths: Their lengths [mm].
        start: What is left of the start topography, on the same points [mm].
        directions: Share of the grooves in each of equal intervals of direction, from x
            towards y, over [0, pi), see `direction.slid_directions`; None if all are alike.
    """
    key_groove, key_wave = jr.split(key)
    wear = compression(abrasive, pressure)
    y = (jnp.arange(shape[0], dtype=extent.dtype) + 0.5) / shape[0] - 0.5
    x = (jnp.arange(shape[1], dtype=extent.dtype) + 0.5) / shape[1] - 0.5
    y, x = (y * extent[0])[:, None], (x * extent[1])[None, :]

    drawn = _draw_grooves(
        key_groove, abrasive, pressure, removal, extent, grooves, directions
    )

    def cut(z, groove: _Grooves):
        distance = x * jnp.cos(groove.angle) + y * jnp.sin(groove.angle) - groove.offset
        profile = jnp.maximum(1.0 - (distance / groove.width) ** 2, 0.0)
        return z - groove.depth * profile, None

    def roll(z, wave):
        amplitude, length, angle, phase = wave
        path = x * jnp.cos(angle) + y * jnp.sin(angle)
        return z + amplitude * jnp.sin(2.0 * math.pi * path / length + phase), None

    exponent, floored = decay_exponent(removal, wear)
    z = jnp.full(shape, floored * -jnp.expm1(-exponent))
    z, _ = jax.lax.scan(cut, z, drawn)

    if amplitudes is not None and wavelengths is not None:
        turn = jr.uniform(key_wave, (2, *amplitudes.shape), maxval=2.0 * math.pi)
        z, _ = jax.lax.scan(roll, z, (amplitudes, wavelengths, turn[0], turn[1]))
    return z if start is None else z + (start - jnp.mean(start))


def _draw_grooves(
    key: Key[Array, ""],
    abrasive: Abrasive,
    pressure: Scalar,
    removal: Scalar,
    extent: Float[Array, "2"],
    count: int,
    directions: Float[Array, " bins"] | None,
) -> _Grooves:
    """The latest `count` grooves on a patch; those older than the step have no depth."""
    keys = jr.split(key, 4)
    mean, variance = groove_depth(abrasive, pressure), abrasive.depth_variation**2
    varied = variance > 0
    order = 1.0 / jnp.where(varied, variance, 1.0)
    depth = jnp.where(varied, jr.gamma(keys[0], order, (count,)) / order, 1.0) * mean
    width = depth * jnp.tan(abrasive.half_angle)
    # 1/lambda, the cross-section of the mean groove
    section = PARABOLA[0] * jnp.tan(abrasive.half_angle) * mean**2 * (1.0 + variance)
    radius = jnp.linalg.norm(extent) / 2.0 + jnp.max(width)
    age = jnp.cumsum(jr.exponential(keys[1], (count,))) * section / (2.0 * radius)
    worn = jnp.exp(-age / compression(abrasive, pressure))
    chance = jr.uniform(keys[2], (count,))
    if directions is not None:
        # the normal that an offset is measured along is a right angle from the groove
        chance = _quantile(directions, chance) - 0.5
    return _Grooves(
        angle=math.pi * chance,
        offset=jr.uniform(keys[3], (count,), minval=-1.0, maxval=1.0) * radius,
        depth=jnp.where(age < removal, depth * worn, 0.0),
        width=width,
    )


def _quantile(
    weights: Float[Array, " bins"], chance: Float[Array, " n"]
) -> Float[Array, " n"]:
    """Where in [0, 1] a variable of given weights in equal intervals has these chances."""
    sums = jnp.concatenate([jnp.zeros(1, weights.dtype), jnp.cumsum(weights)])
    chance = chance * sums[-1]
    bin = jnp.clip(jnp.searchsorted(sums, chance, side="right") - 1, 0, weights.size - 1)
    inside = weights[bin] > 0
    part = (chance - sums[bin]) / jnp.where(inside, weights[bin], 1.0)
    return (bin.astype(weights.dtype) + jnp.clip(part, 0.0, 1.0)) / weights.size
