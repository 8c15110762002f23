r"""Ripple: the periodic part of the removal, which the averaged map leaves out.

Loop after loop the disc passes a step further on, and what its passes leave is a wave. A
smooth footprint would leave next to none: ripple comes from the rim, where the pressure
ends abruptly. Its strength follows in Fourier space. At the phase $\varphi = 2\pi s/p$ of
the trochoid the removal has the harmonics

$H_n(k) = \int e^{in 2\pi s/p - ik\cdot Q(s)}\, G_n(k)\, L_n(k)\, ds$

with Q the way of the disc's centre as the guide alone would lead it, G the transform of
the footprint about that centre and L that of the loop. The integral is stationary where
the wave, seen from the centre, keeps step with the loops: $k \cdot V = 2\pi n/p$ with
$V = dQ/ds$. Each length of guide then adds

$\frac{2}{2\pi |V|} \int |G(k)|^2 |L_n(k)|^2\, dk_\perp$

to the variance over the part. The centre hangs behind the contact point by the disc's
radius, so wherever the guide bends by $\kappa$ the centre swings round and moves
$|V| = \sqrt{1 + \kappa^2 R^2}$ times as fast. There neighbouring passes lie further apart,
and most of the ripple of a guide with tight corners comes from its corners.

Left out: that a turn adds or takes a part of a loop, which left and right turns undo; that
the tool starts and stops somewhere; the few percent that the feed adds to the speed under
the spinning disc. All of it counts where a corner holds no more than a loop or two.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..parts import Process, Scalar, Tool
from ..path.guide import Bends
from .flat import envelope
from .pressure import bed_pressure


HARMONICS = 3
# Directions of the waves, and intervals in which the phase of a loop is averaged.
WAVES, INTERVALS = 24, 32
# Sizes of a loop, in waves times 2 pi, between which its exact transform gives way to the
# mean over a period of it: the exact one needs more intervals the larger the loop.
EXACT, SMOOTH = 24.0, 48.0


class Ripple(eqx.Module):
    """Waves that the loops leave: by bend of the guide, harmonic, and direction."""

    variances: Float[Array, "bends harmonics waves"]
    """Variance of each wave, integrated across the strip of one pass [mm^3]."""
    wavelengths: Float[Array, "bends harmonics waves"]
    """Length of each wave [mm]."""
    shares: Float[Array, " bends"]
    """Share of the guide that bends like this [-]."""
    width: Scalar
    """Width of the strip, E [mm]."""

    def moments(
        self,
        density: Scalar,
        transmission: Float[Array, "bends harmonics waves"] | None = None,
    ) -> tuple[Scalar, Scalar]:
        r"""Second and fourth cumulant of the ripple on a covered part [mm^2, mm^4].

        $\kappa_2 = \lambda \int a^2/2\,dy$ for a density $\lambda$ of strips that lie over
        each other with unrelated phases, and $\kappa_4 = -\tfrac38\lambda\int a^4\,dy$ as
        if each harmonic were one sine, evenly strong over its strip.

        Args:
            density: Length of guide per area of part, lambda [1/mm].
            transmission: Share of each wave's amplitude that a roughness filter lets
                through [-]; None for all of it.
        """
        variances = self.variances
        if transmission is not None:
            variances = variances * transmission**2
        harmonics = jnp.sum(variances, axis=2)
        second = jnp.sum(self.shares * jnp.sum(harmonics, axis=1))
        fourth = jnp.sum(self.shares * jnp.sum(harmonics**2, axis=1)) / self.width
        return density * second, -1.5 * density * fourth


class Rims(eqx.Module):
    """The two places of the rim that make each wave, as far as the path knows them."""

    depths: Float[Array, "*n 2 bends waves"]
    """How deep these places are pressed in; negative where they hover [mm]."""
    speed: Float[Array, "*n"]
    """Speed of the rim under the spindle [mm/s]."""
    edges: Float[Array, "*n bends harmonics waves"]
    """Squared transform of the footprint per squared removal rate at the rim [mm^4]."""
    weights: Float[Array, "*n bends harmonics waves"]
    """Variance across the strip per squared transform of the footprint [s^2/mm^3]."""
    wavelengths: Float[Array, "*n bends harmonics waves"]
    """Length of each wave [mm]."""
    shares: Float[Array, "*n bends"]
    """Share of the guide that bends like this [-]."""
    width: Float[Array, "*n"]
    """Width of the strip, E [mm]."""


def ripple(
    process: Process,
    tool: Tool,
    preston: Scalar,
    bends: Bends,
    curvature: Float[Array, "2 2"],
    pace: Scalar,
    volume: Scalar,
    lean: float = 1.0,
) -> Ripple:
    r"""Waves that one run of a trochoid leaves.

    Args:
        process: Tilt, displacement, step, trochoid radius and spindle speed are read.
        tool: Radius, foundation and stiffening are read.
        preston: Preston coefficient, $K_P$ [1/MPa].
        bends: How the guide bends, and which way it runs from the lean of the axis.
        curvature: Normal curvature of the part along (feed, left), convex positive [1/mm].
        pace: Time per length of guide, rms over the loop [s/mm].
        volume: Volume that the footprint removes per time [mm^3/s].
        lean: +1 where the axis leans towards the feed (pulling), -1 away (pushing).

    Source: own derivation, stationary phase; the loop is S0 (Pessoles & Tournier 2009)
        eq. (5).
    """
    made = rims(process, tool.radius, bends, curvature, pace, lean)
    return waves(made, tool.foundation, tool.stiffening, preston, volume)


def waves(
    rims: Rims, foundation: Scalar, stiffening: Scalar, preston: Scalar, volume: Scalar
) -> Ripple:
    r"""Waves that a bed and a Preston coefficient make of the rims of one run.

    The rim is an ellipse in the tangent plane, and the transform of the footprint there is
    that of its abrupt edges: $|G|^2 = \sum 2\pi\rho\, w^2/k^3$ over the two places where
    the rim runs along the crests, with its radius of curvature $\rho$ and the removal rate
    w at the edge. No wave can be larger than the footprint's whole volume.

    Args:
        rims: Of one run, by `rims`.
        foundation: Stiffness of the elastic bed, $k$ [N/mm^3].
        stiffening: Its relative growth per depth, $\beta$ [1/mm].
        preston: Preston coefficient, $K_P$ [1/MPa].
        volume: Volume that the footprint removes per time [mm^3/s].
    """
    pressure = bed_pressure(foundation, stiffening, rims.depths)
    rates = jnp.sum((preston * rims.speed * pressure) ** 2, axis=0)
    edge = rims.edges * rates[:, None, :]
    whole = edge + volume**2
    some = whole > 0
    footprint = jnp.where(some, edge * volume**2 / jnp.where(some, whole, 1.0), 0.0)
    return Ripple(rims.weights * footprint, rims.wavelengths, rims.shares, rims.width)


def rims(
    process: Process,
    radius: Scalar,
    bends: Bends,
    curvature: Float[Array, "2 2"],
    pace: Scalar,
    lean: float = 1.0,
) -> Rims:
    """Where the rim makes the waves of one run: all that its path knows of the ripple.

    Args:
        process: Tilt, displacement, step, trochoid radius and spindle speed are read.
        radius: Radius of the disc [mm].
        bends: As in `ripple`.
        curvature: As in `ripple` [1/mm].
        pace: As in `ripple` [s/mm].
        lean: As in `ripple`.
    """
    level, slope = jnp.cos(process.tilt), jnp.sin(process.tilt)
    real = radius.dtype
    nodes, weights = np.polynomial.legendre.leggauss(WAVES)
    angle = np.pi / 2 * nodes  # of a wave, from V
    order = jnp.asarray(np.arange(1, HARMONICS + 1), dtype=real)
    secant = jnp.asarray(1 / np.cos(angle), dtype=real)

    # V from the guide's tangent: the centre lies a radius behind the contact point
    swing = -lean * bends.curvature * radius * level
    swift = jnp.sqrt(1 + swing**2)
    along = 2 * jnp.pi / process.step * order[None, :] / swift[:, None]
    k = along[:, :, None] * secant[None, None, :]
    # the wave from where the axis leans: the guide's tangent turns by arctan(swing) to V
    aspect = bends.aspect[:, None] + jnp.asarray(angle, dtype=real)[None, :]
    cosine, sine = jnp.cos(aspect), jnp.sin(aspect)
    ahead = level * (cosine - swing[:, None] * sine) / swift[:, None]
    aside = (sine + swing[:, None] * cosine) / swift[:, None]

    # the rim's normal points where the wave runs, or back
    reach = jnp.sqrt(ahead**2 + aside**2)
    signs = jnp.asarray([1.0, -1.0], dtype=real)[:, None, None]
    # from the contact point to the rim, in the disc
    x = radius * (1 - signs * lean * (ahead / reach)[None])
    d = -lean * level * x, signs * radius * (aside / reach)[None]
    sunk = curvature[0, 0] * d[0] ** 2 + curvature[1, 1] * d[1] ** 2
    sunk = sunk + (curvature[0, 1] + curvature[1, 0]) * d[0] * d[1]
    rim_radius = radius * level**2 / reach**3

    loop = _loop(process.trochoid_radius * k)
    # dk across V, over 2 pi |V|; both signs of n
    share = jnp.asarray(weights / 2 / np.cos(angle), dtype=real)
    measure = k * share[None, None, :] / swift[:, None, None]
    return Rims(
        depths=process.displacement - slope * x - 0.5 * sunk,
        speed=process.spin * radius,
        edges=(2 * jnp.pi * rim_radius)[:, None, :] / k**3,
        weights=pace**2 * loop * measure,
        wavelengths=2 * jnp.pi / k,
        shares=bends.share,
        width=envelope(radius, process),
    )


def _loop(
    x: Float[Array, "bends harmonics waves"],
) -> Float[Array, "bends harmonics waves"]:
    r"""Squared transform of a circle run through once, $J_n(x)^2$; its mean for large x.

    The mean over a period is $1/(\pi\sqrt{x^2 - n^2})$.
    """
    order = np.arange(1, x.shape[1] + 1)[None, :, None]
    phase = np.pi / INTERVALS * np.arange(INTERVALS + 1)[None, None, None, :]
    ends = np.where(np.arange(INTERVALS + 1) % INTERVALS == 0, 0.5, 1.0) / INTERVALS
    lag = jnp.minimum(x, SMOOTH)[..., None] * jnp.asarray(np.sin(phase), dtype=x.dtype)
    turned = jnp.asarray(order[..., None] * phase, dtype=x.dtype) - lag
    bessel = jnp.cos(turned) @ jnp.asarray(ends, dtype=x.dtype)
    mean = 1 / (
        jnp.pi * jnp.sqrt(jnp.maximum(x, EXACT) ** 2 - jnp.asarray(order**2, dtype=x.dtype))
    )
    t = jnp.clip((x - EXACT) / (SMOOTH - EXACT), 0.0, 1.0)
    share = t * t * (3 - 2 * t)
    return (1 - share) * bessel**2 + share * mean
