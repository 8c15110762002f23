"""Local: the texture at every place of a part, under maps of removal and pressure.

Scratches have closed forms, so they are worked out place by place. The start map has
none: the pad law is run once for each of a few pressures, seen at each of its steps, and
what a place is like is read between them. Between the nodes the logarithm of the variance,
the skewness and the kurtosis are followed by monotone cubics, whose slopes are continuous:
where everything touches, all three are straight lines.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..parts import Abrasive, Scalar
from .areal import Cumulants, cumulants, parameters_from_cumulants
from .evolution import Texture, combine
from .filters import Spacing, gaussian_transmission, transmit, wavelengths
from .planarisation import asperity_stiffness, planarised
from .scratches import Population, decay, decay_rate, groove_population


Map = Float[Array, "ny nx"]

# Pressures are tabulated this far beyond those that occur, so that their table never
# shrinks to a point, and down to this share of the largest.
BEYOND, LEAST = 1.02, 1e-3
# Heights that differ by this many roundings of the largest are one height.
ROUNDINGS = 4.0


def slopes(x: Float[Array, " n"], y: Float[Array, "n m"]) -> Float[Array, "n m"]:
    """Slopes at the nodes of the monotone cubic through values (PCHIP).

    Inside, the weighted harmonic mean of the slopes to either side, zero at an extremum;
    at the ends, that of the parabola through three nodes, kept from overshooting.

    Args:
        x: Nodes, ascending, three or more.
        y: Values there.

    Source: Fritsch & Butland, SIAM J. Sci. Stat. Comput. 5 (1984) 300-304.
    """
    h = jnp.diff(x)[:, None]
    d = jnp.diff(y, axis=0) / h
    w1, w2 = 2.0 * h[1:] + h[:-1], h[1:] + 2.0 * h[:-1]
    alike = d[1:] * d[:-1] > 0
    below, above = jnp.where(alike, d[:-1], 1.0), jnp.where(alike, d[1:], 1.0)
    inner = jnp.where(alike, (w1 + w2) / (w1 / below + w2 / above), 0.0)

    def end(h0, h1, d0, d1):
        slope = ((2.0 * h0 + h1) * d0 - h0 * d1) / (h0 + h1)
        slope = jnp.where(slope * d0 > 0, slope, 0.0)
        steep = (d0 * d1 <= 0) & (jnp.abs(slope) > 3.0 * jnp.abs(d0))
        return jnp.where(steep, 3.0 * d0, slope)

    first, last = end(h[0], h[1], d[0], d[1]), end(h[-1], h[-2], d[-1], d[-2])
    return jnp.concatenate([first[None], inner, last[None]])


def between(
    x: Float[Array, " n"], y: Float[Array, "n m"], slope: Float[Array, "n m"], at: Scalar
) -> Float[Array, " m"]:
    """Cubics through values and slopes, at a place; beyond the nodes, the last value.

    Args:
        x: Nodes, ascending.
        y: Values there.
        slope: Slopes there.
        at: Where to read them.
    """
    at = jnp.clip(at, x[0], x[-1])
    i = jnp.clip(jnp.searchsorted(x, at, side="right") - 1, 0, x.size - 2)
    h = x[i + 1] - x[i]
    t = (at - x[i]) / h
    rise, s = t * t * (3.0 - 2.0 * t), 1.0 - t
    bend = h * t * s * (s * slope[i] - t * slope[i + 1])
    return y[i] + rise * (y[i + 1] - y[i]) + bend


def rest_maps(
    heights: Float[Array, "my mx"],
    spacing: Spacing,
    abrasive: Abrasive,
    removal: Map,
    pressure: Map,
    cutoff: Scalar | float = jnp.inf,
    steps: int = 32,
    pressures: int = 4,
) -> Cumulants:
    r"""Maps of the cumulants of what is left of a start map [mm^2, mm^3, mm^4].

    The pad law is run to the largest removal in steps that grow evenly, from fine ones at
    the start, for pressures that are evenly spaced in their logarithm over those that
    occur. A place without removal keeps the cumulants of the start.

    Args:
        heights: Start map, periodic [mm].
        spacing: Distance of its points, or (along y, along x) [mm].
        abrasive: The abrasive and its pad.
        removal: Depth removed at each place [mm].
        pressure: Mean contact pressure at each place [MPa].
        cutoff: Where the roughness filter halves a wave [mm]; infinite for none.
        steps: Steps in which the pad law is integrated.
        pressures: Number of pressures for which it is, three or more.

    Returns:
        Cumulants whose fields are maps [y, x]. Derivatives are those of this
        interpolation, exactly; zero with respect to the pressure where there is none.

    Source: Own derivation.
    """
    stiffness = asperity_stiffness(abrasive)
    high = jnp.max(pressure)
    high = jnp.where(high > 0, high, 1.0)
    low = jnp.min(jnp.where(pressure > 0, pressure, high))
    low = jnp.maximum(low, LEAST * high)
    part = jnp.asarray(np.linspace(0.0, 1.0, pressures), heights.dtype)
    nodes_p = jnp.log(low / BEYOND) + part * jnp.log(high / low * BEYOND**2)
    deepest = jnp.max(removal)
    deepest = jnp.where(deepest > 0, deepest, high / stiffness)
    nodes_h = deepest * jnp.asarray(np.linspace(0.0, 1.0, steps + 1) ** 2, heights.dtype)

    rough = 1.0 - gaussian_transmission(wavelengths(heights, spacing), cutoff)
    largest = jnp.maximum(jnp.max(jnp.abs(heights)), deepest)
    least = (ROUNDINGS * jnp.finfo(heights.dtype).eps * largest) ** 2

    def look(z):
        k2, k3, k4 = cumulants(transmit(z, rough))
        floor = least.astype(k2.dtype)
        seen = k2 > floor
        k2, k3, k4 = (jnp.where(seen, k, c) for k, c in ((k2, floor), (k3, 0.0), (k4, 0.0)))
        _, Ssk, Sku = parameters_from_cumulants(k2, k3, k4)
        return jnp.stack([jnp.log(k2), Ssk, Sku]).astype(z.dtype)

    def run(log_pressure):
        return planarised(
            heights,
            nodes_h,
            jnp.exp(log_pressure),
            stiffness,
            look,
            abrasive.conformity,
            spacing,
        )

    table = jax.vmap(run)(nodes_p)
    slope = jax.vmap(slopes, in_axes=(None, 0))(nodes_h, table)

    def read(h, p):
        pressed = p > 0
        at = jnp.log(jnp.where(pressed, p, low))
        across = jax.vmap(between, in_axes=(None, 0, 0, None))(nodes_h, table, slope, h)
        log_k2, Ssk, Sku = between(nodes_p, across, slopes(nodes_p, across), at)
        k2 = jnp.exp(log_k2)
        return Cumulants(k2, Ssk * k2 * jnp.sqrt(k2), (Sku - 3.0) * k2 * k2)

    return jax.vmap(jax.vmap(read))(removal, pressure)


def scratch_maps(
    populations: tuple[Population, ...],
    abrasive: Abrasive,
    removal: Map,
    pressure: Map,
) -> tuple[Population, ...]:
    """Maps of the scratches of earlier grades, each by its own width, and of this one.

    Args:
        populations: Scratches of earlier grades; their fields are numbers or maps.
        abrasive: The abrasive, its pad and its work material.
        removal: Depth removed at each place [mm].
        pressure: Mean contact pressure at each place [MPa].

    Returns:
        As many populations and one more, their fields maps [y, x].
    """

    def at(h, p, before):
        rate = decay_rate(abrasive, p)
        left = tuple(decay(b, h, rate, abrasive.conformity) for b in before)
        return (*left, groove_population(abrasive, p, h))

    before = jax.tree.map(lambda k: jnp.broadcast_to(k, removal.shape), populations)
    return jax.vmap(jax.vmap(at))(removal, pressure, before)


class TextureMaps(eqx.Module):
    """Height parameters at every place of a part."""

    Sa: Map
    """Mean absolute height, estimated [mm]."""
    Sq: Map
    """Root mean square height [mm]."""
    Ssk: Map
    """Skewness [-]."""
    Sku: Map
    """Kurtosis [-]."""
    evaluated: Bool[Array, "ny nx"]
    """Which places count where the worst one is looked for."""


def texture_maps(shape: tuple[int, int], *parts: Cumulants | Population) -> Texture:
    """Maps of Sa, Sq, Ssk and Sku of a sum of independent parts.

    Args:
        shape: Places along y and x.
        parts: Cumulants of each part; their fields are maps, or numbers that hold
            everywhere.
    """
    spread = jax.tree.map(lambda k: jnp.broadcast_to(k, shape), parts)
    return jax.vmap(jax.vmap(lambda p: combine(*p)))(spread)


def extremes(values: Map, evaluated: Bool[Array, "ny nx"]) -> tuple[Scalar, Scalar]:
    """The lowest and the highest value of a map among the places that count.

    Args:
        values: Something at every place.
        evaluated: Which places count, one at least.
    """
    lowest = jnp.min(jnp.where(evaluated, values, jnp.inf))
    return lowest, jnp.max(jnp.where(evaluated, values, -jnp.inf))
