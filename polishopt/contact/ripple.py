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
# second.
WAVES = 16
# Width of the periodic domain across the strip, in units of its half-width; above 2 the
# strip does not meet its own image.
DOMAIN = 2.5


# Nodes in a row: more would be no more accurate, see `_bessel`.
MOST_NODES = 8


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


def _bessel(orders: int, x: Float[Array, "*n"]) -> list[Float[Array, "*n"]]:
    """Spherical Bessel functions j_0, j_1 ... of the first few orders.

    By upward recurrence, which for eight orders loses at most seven digits of sixteen
    above the switch to the power series; each further order costs more.
    """
    small = jnp.abs(x) < 0.5
    far = jnp.where(small, 1.0, x)
    up = [jnp.sin(far) / far, jnp.sin(far) / far**2 - jnp.cos(far) / far]
    for l in range(1, orders - 1):
        up.append((2 * l + 1) / far * up[l] - up[l - 1])
    near = jnp.where(small, x, 0.0)
    result, double = [], 1.0
    for l in range(orders):
        double *= 2 * l + 1
        term, total = jnp.ones_like(near), jnp.ones_like(near)
        for k in range(1, 6):
            term = term * (-0.5 * near**2) / (k * (2 * l + 2 * k + 1))
            total = total + term
        result.append(jnp.where(small, near**l / double * total, up[l]))
    return result


def _filon(nodes: int, x: Float[Array, "*n"]) -> Array:
    r"""Factors that make a Gauss-Legendre rule exact for a polynomial times a wave.

    $\sum_q w_q F_q(x) f(t_q) = \int_{-1}^1 f(t) e^{-ixt} dt$ with
    $F_q = \sum_l (2l + 1)(-i)^l j_l(x) P_l(t_q)$: any wave number costs the same.
    """
    t = np.polynomial.legendre.leggauss(nodes)[0]
    bessel = _bessel(nodes, x)
    real, imaginary = jnp.zeros((*x.shape, nodes)), jnp.zeros((*x.shape, nodes))
    real, imaginary = real.astype(x.dtype), imaginary.astype(x.dtype)
    for l in range(nodes):
        legendre = np.polynomial.legendre.Legendre.basis(l)(t)
        row = jnp.asarray((2 * l + 1) * legendre, dtype=x.dtype)
        part = bessel[l][..., None] * row.reshape(*([1] * x.ndim), -1)
        sign = (1.0, -1.0, -1.0, 1.0)[l % 4]
        if l % 2:
            imaginary = imaginary + sign * part
        else:
            real = real + sign * part
    return jax.lax.complex(real, imaginary)


def ripple(
    offsets: Float[Array, "rows columns 2"],
    rates: Float[Array, "rows columns"],
    dwell: Float[Array, " phases"],
    step: Scalar,
    trochoid_radius: Scalar,
    reach: Scalar,
    harmonics: int = 2,
    panels: int = 1,
) -> Ripple:
    """Harmonics of the removal of a trochoid on a straight guide.

    Args:
        offsets: Nodes of the footprint from the contact point, along and across the
            guide, at least two in a row; the nodes of a row share their place across and
            are those of a Gauss-Legendre rule, as in `pressure.patch` [mm].
        rates: Volume that each node removes per time [mm^3/s].
        dwell: Time per length of guide at evenly spaced phases of the loop; its mean is
            the time that the tool takes per length [s/mm].
        step: Step of the trochoid, p [mm].
        trochoid_radius: Radius of its circle, D_tr [mm].
        reach: Largest distance of a node across the guide [mm].
        harmonics: How many harmonics.
        panels: How many such rules lie side by side in each row.

    Raises:
        ValueError: if a row has less than 2 or more than 8 nodes.

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
    rows = jnp.zeros((harmonics, offsets.shape[0]), dtype=lag.dtype)
    rows = complex_(rows)
    count = offsets.shape[1] // panels
    if not 2 <= count <= MOST_NODES:
        raise ValueError(
            f"`ripple(offsets=...)` has {count} nodes in a row, must have 2 to "
            f"{MOST_NODES}."
        )
    ends = np.polynomial.legendre.leggauss(count)[0]
    for part in range(panels):
        nodes = slice(part * count, (part + 1) * count)
        xi = offsets[:, nodes, 0]
        middle = 0.5 * (xi[:, 0] + xi[:, -1])
        half = (xi[:, -1] - xi[:, 0]) / (ends[-1] - ends[0])
        factor = _filon(count, wave * order[:, None] * half[None, :])
        panel = jnp.sum(complex_(rates[:, nodes])[None] * factor, axis=2)
        rows = rows + panel * turn(wave * order[:, None] * middle[None, :])
    eta = offsets[:, 0, 1]
    footprint = rows @ turn(eta[:, None] * across[None, :])
    profile = jnp.fft.ifft(loop * footprint, axis=1) / complex_(domain / (2 * WAVES))
    return Ripple(
        squares=4 * (profile.real**2 + profile.imag**2),
        wavelengths=step / order,
        spacing=domain / (2 * WAVES),
    )
