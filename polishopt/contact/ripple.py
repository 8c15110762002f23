r"""Ripple: the periodic part of the removal, which the averaged map leaves out.

Along a straight guide the trochoid repeats after every step p, and so does the removal.
Its harmonics follow from the same footprint and the same loop as the average: a node of
the footprint at (xi, eta), carried by the loop at phase phi, leaves its volume at
x = s + o_x + xi, y = o_y + eta, and the n-th harmonic across the strip is

$h_n(y) = \langle g(\phi) \sum_i W_i e^{-in(\phi + 2\pi(o_x + \xi_i)/p)}
\delta(y - o_y - \eta_i)\rangle_\phi$

with the node's volume rate W and the dwell g per length of guide. The strips of a guide
that covers a part lie over each other with unrelated phases, so they add as independent
sines do. Ignored: the bend of the guide within one loop, and the few percent that the
feed adds to the speed under the spinning disc.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..parts import Scalar


# Resolution across the strip: converged to 0.5 % in the first harmonic and 2 % in the
# second. More waves would need more than 16 rows of nodes on each side.
WAVES = 16
# Width of the periodic domain across the strip, in units of its half-width; above 2 the
# strip does not meet its own image.
DOMAIN = 2.5


class Ripple(eqx.Module):
    """Harmonics of the removal along the guide, across one strip."""

    squares: Float[Array, "harmonics ny"]
    """Squared amplitude of each harmonic at each place across the strip [mm^2]."""
    wavelengths: Float[Array, " harmonics"]
    """Period of each harmonic along the guide, p / n [mm]."""
    spacing: Scalar
    """Distance between the places across the strip [mm]."""

    def moments(
        self, density: Scalar, transmission: Float[Array, " harmonics"] | None = None
    ) -> tuple[Scalar, Scalar]:
        r"""Second and fourth cumulant of the ripple on a covered part [mm^2, mm^4].

        $\kappa_2 = \lambda\int \sum a_n^2/2\,dy$ and
        $\kappa_4 = -\tfrac38 \lambda\int\sum a_n^4\,dy$: independent sines, of which
        $\lambda$ strips per length lie side by side.

        Args:
            density: Length of guide per area of part, lambda [1/mm].
            transmission: Share of each harmonic's amplitude that a roughness filter
                lets through [-]; None for all of it.
        """
        squares = self.squares
        if transmission is not None:
            squares = squares * (transmission**2)[:, None]
        weight = density * self.spacing
        return 0.5 * weight * jnp.sum(squares), -0.375 * weight * jnp.sum(squares**2)


def ripple(
    offsets: Float[Array, "rows columns 2"],
    rates: Float[Array, "rows columns"],
    dwell: Float[Array, " phases"],
    step: Scalar,
    trochoid_radius: Scalar,
    reach: Scalar,
    harmonics: int = 2,
) -> Ripple:
    """Harmonics of the removal of a trochoid on a straight guide.

    Args:
        offsets: Nodes of the footprint from the contact point, along and across the
            guide; the nodes of a row share their place across [mm].
        rates: Volume that each node removes per time [mm^3/s].
        dwell: Time per length of guide at evenly spaced phases of the loop; its mean is
            the time that the tool takes per length [s/mm].
        step: Step of the trochoid, p [mm].
        trochoid_radius: Radius of its circle, D_tr [mm].
        reach: Largest distance of a node across the guide [mm].
        harmonics: How many harmonics.

    Source: own derivation; the loop is S0 (Pessoles & Tournier 2009) eq. (5).
    """
    real = offsets.dtype
    wave = 2 * jnp.pi / step
    order = jnp.asarray(np.arange(1, harmonics + 1), dtype=real)
    phases = dwell.shape[0]
    phase = jnp.asarray(2 * np.pi * np.arange(phases) / phases, dtype=real)
    ahead = trochoid_radius * jnp.sin(phase)  # of the guide point, along the guide
    beside = trochoid_radius * jnp.cos(phase)
    domain = DOMAIN * (trochoid_radius + reach)
    across = jnp.asarray(np.fft.fftfreq(2 * WAVES) * 2 * WAVES, dtype=real)
    across = across * (2 * jnp.pi / domain)

    def turn(angle):  # exp(-i angle)
        return jax.lax.complex(jnp.cos(angle), -jnp.sin(angle))

    def complex_(x):
        return jax.lax.complex(x, jnp.zeros_like(x))

    lag = order[:, None] * (phase + wave * ahead)[None, :]
    loop = turn(lag) * complex_(dwell)[None, :]
    loop = loop @ turn(beside[:, None] * across[None, :]) / phases
    xi = offsets[None, :, :, 0]
    harmonic = turn(wave * order[:, None, None] * xi)
    rows = jnp.sum(complex_(rates)[None] * harmonic, axis=2)
    eta = offsets[:, 0, 1]
    footprint = rows @ turn(eta[:, None] * across[None, :])
    profile = jnp.fft.ifft(loop * footprint, axis=1) / complex_(domain / (2 * WAVES))
    return Ripple(
        squares=4 * (profile.real**2 + profile.imag**2),
        wavelengths=step / order,
        spacing=domain / (2 * WAVES),
    )
