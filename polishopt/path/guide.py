"""Guide: the plane curve along which the trochoid is rolled, by its arc length.

What the process needs of a guide, whatever its kind: the point at an arc length, without
a search; the length; nodes to integrate along it; how much of it bends how much, and how
much of it runs which way. `polyline` and `involute` are the two kinds that there are, and
`families` lays them out on a part.
"""

import abc
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..parts import Scalar, as_array, as_scalar


GOLDEN = (math.sqrt(5) - 1) / 2


class GuidePoint(eqx.Module):
    """A point of a plane curve that is known by its arc length."""

    position: Float[Array, "2"]
    """Where it is in the parameter plane, C [mm]."""
    heading: Scalar
    """Direction of travel from the x axis, continuous along the curve [rad]."""
    curvature: Scalar
    """Change of heading per length, positive to the left [1/mm]."""
    contact: Scalar = eqx.field(converter=as_scalar, default=1.0)
    """1 where the tool touches the part, 0 on a way back with the tool lifted [-]."""


@jax.custom_jvp
def by_arc_length(
    s: Scalar, position: Float[Array, "2"], heading: Scalar, curvature: Scalar
) -> tuple[Float[Array, "2"], Scalar]:
    r"""Position and heading of a curve as they are, with their derivatives by arc length.

    $C' = (\cos\vartheta, \sin\vartheta)$ and $\vartheta' = \kappa$, whatever formula gave
    them. Handed in for a constant s, they bring derivatives by everything else along, and
    the curvature, which is a function of s itself, brings those of higher order.

    Args:
        s: Arc length.
        position: Position at s, C; its unit is that of s.
        heading: Direction of travel there [rad].
        curvature: Change of heading per length there.

    Source: Frenet.
    """
    return position, heading


@by_arc_length.defjvp
def _by_arc_length_jvp(primals, tangents):
    position, heading = by_arc_length(*primals)
    curvature = primals[-1]
    ds, moved, turned, _ = tangents
    ahead = jnp.stack([jnp.cos(heading), jnp.sin(heading)])
    return (position, heading), (moved + ahead * ds, turned + curvature * ds)


class Bends(eqx.Module):
    """How much of a guide bends how much, for sums over it that ask nothing else.

    A way back with the tool lifted does not count.
    """

    curvature: Float[Array, " n"]
    """Size of the curvature [1/mm]."""
    aspect: Float[Array, " n"]
    """Heading, from the direction in which the tool axis leans [rad]."""
    share: Float[Array, " n"]
    """Share of the guide's length; they add up to one [-]."""


class Guide(eqx.Module):
    """A plane curve with a pitch, by arc length.

    `guide(s)` is its `GuidePoint` at the arc length s [mm]. Before the start and past the
    end it goes straight on. It can be differentiated in s and in `pitch`, which moves the
    whole curve.
    """

    pitch: eqx.AbstractVar[Scalar]
    """Distance between neighbouring lines, h [mm]."""
    panels: eqx.AbstractVar[Float[Array, " panels_and_1"]]
    """Arc lengths between which the curve is analytic, at most a pitch apart [pitch]."""

    @property
    @abc.abstractmethod
    def length(self) -> Scalar:
        """Arc length of the whole guide [mm]."""

    @property
    @abc.abstractmethod
    def contact_length(self) -> Scalar:
        """Arc length without the ways back that the tool is lifted on [mm]."""

    @property
    @abc.abstractmethod
    def edges(self) -> Float[Array, " n"]:
        """Length of each straight piece before its corners are rounded [mm]."""

    @abc.abstractmethod
    def __call__(self, s: Scalar) -> GuidePoint:
        """Point of the guide at the arc length `s` [mm]."""

    @abc.abstractmethod
    def bends(self) -> Bends:
        """The straight part and the bends, for a tool axis that leans along the guide."""

    @abc.abstractmethod
    def compass(self) -> Bends:
        """The directions of its lines, for a tool axis that always leans along x.

        The axis does not turn with the guide, so its corners count as straight.
        """

    def stations(
        self, per_panel: int, one_in: int = 1
    ) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
        """Nodes of a Gauss-Legendre quadrature along the guide.

        The panels end where the curve changes formula, and none is longer than a pitch,
        so that with rounded corners meeting each other a panel is a cell.

        Args:
            per_panel: Number of nodes in each panel.
            one_in: Of so many panels that follow each other one stands for all. Which one
                changes by the golden ratio, since in a Hilbert curve every fourth cell is
                alike; a long one is chosen the more often.

        Returns:
            Arc lengths of the nodes, ascending [mm], and their weights [mm], which add up
            to the length of the guide.
        """
        nodes, weights = np.polynomial.legendre.leggauss(per_panel)
        first = np.arange(0, self.panels.size - 1, one_in)
        after = np.minimum(first + one_in, self.panels.size - 1)
        width = self.panels[after] - self.panels[first]
        chosen = jnp.asarray(first)
        if one_in > 1:
            place = as_array(GOLDEN * np.arange(first.size) % 1)
            within = self.panels[first] + place * width
            chosen = jnp.searchsorted(self.panels, within, side="right").astype(int) - 1
            chosen = jnp.clip(chosen, first, after - 1)
        begin, end = self.panels[chosen], self.panels[chosen + 1]
        s = begin[:, None] + (end - begin)[:, None] * as_array((nodes + 1) / 2)[None, :]
        weight = width[:, None] * as_array(weights / 2)[None, :]
        return self.pitch * s.reshape(-1), self.pitch * weight.reshape(-1)


class Segments(eqx.Module):
    """What makes a path multidirectional: short straight pieces, many turns, all ways."""

    lengths: Float[Array, " edges"]
    """Length of each straight piece before its corners are rounded [mm]."""
    turned: Scalar
    """Angle turned through per length of path, to either side [rad/mm]."""
    directions: Float[Array, " bins"]
    """Share of the length that runs in each of equal bins of direction, from the x axis
    on; there and back are one direction [-]."""


def segments(guide: Guide, bins: int = 36) -> Segments:
    """Statistics of a guide by which paths for polishing are compared.

    Args:
        guide: Any guide.
        bins: Into how many bins the half turn of directions is divided.

    Source: S4 (Tam, Cheng et al. 2013), abstract: segments of one length, orthogonal at
    the turns, spread over the part.
    """
    s, weight = guide.stations(8)
    points = jax.vmap(guide)(s)
    share = weight / jnp.sum(weight)
    # lines that run along an axis fall into the middle of a bin
    place = jnp.round(points.heading / jnp.pi * bins).astype(int) % bins
    return Segments(
        lengths=guide.edges,
        turned=jnp.sum(share * jnp.abs(points.curvature)),
        directions=jnp.zeros(bins, share.dtype).at[place].add(share),
    )
