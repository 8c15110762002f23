r"""Involute: the round spiral whose turns keep one distance everywhere.

Neighbouring turns of the involute of a circle of radius a are parallel curves, $2\pi a$
apart along their common normals; an Archimedean spiral is only nearly so. And its arc
length is $a\varphi^2/2$ at the heading $\varphi$, so that a point by arc length is a square
root and no search.
"""

import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..parts import Scalar, as_array, as_scalar
from .guide import Bends, Guide, GuidePoint


# Heading at the start, half a pitch from the middle [rad]: before it the curve bends hard.
FIRST = math.pi
# Curvatures, and directions, that stand for all of them.
BENDS, DIRECTIONS = 12, 16


class Involute(Guide):
    """The involute of a circle, outwards, by arc length; see `Guide`."""

    pitch: Scalar = eqx.field(converter=as_scalar)
    """Distance between neighbouring turns, h [mm]."""
    centre: Float[Array, "2"] = eqx.field(converter=as_array)
    """The middle of the spiral [mm]."""
    panels: Float[Array, " panels_and_1"]
    """Arc lengths of equal panels, at most a pitch apart [pitch]."""
    last: float = eqx.field(static=True)
    """Heading at the end [rad]."""

    @property
    def length(self) -> Scalar:
        """Arc length of the whole guide [mm]."""
        return self.pitch * self.panels[-1]

    @property
    def contact_length(self) -> Scalar:
        """Arc length along which the tool touches, which is all of it [mm]."""
        return self.length

    @property
    def edges(self) -> Float[Array, " n"]:
        """It has no straight pieces [mm]."""
        return self.panels[:0]

    def __call__(self, s: Scalar) -> GuidePoint:
        """Point of the guide at the arc length `s` [mm]."""
        within = (s >= 0) & (s < self.length)
        on = jnp.where(within, s, jnp.where(s < 0, 0.0, self.length))
        a = self.pitch / (2 * jnp.pi)
        heading = jnp.sqrt(FIRST**2 + 2 * on / a)
        cosine, sine = jnp.cos(heading), jnp.sin(heading)
        tangent, left = jnp.stack([cosine, sine]), jnp.stack([-sine, cosine])
        # tangent and normal of the curve at a point of its circle
        position = self.centre + a * (tangent - heading * left)
        return GuidePoint(
            position=position + (s - on) * tangent,
            heading=heading,
            curvature=jnp.where(within, 1 / (a * heading), 0.0),
            contact=jnp.ones_like(s),
        )

    def bends(self) -> Bends:
        """Its bends, for a tool axis that leans along the guide."""
        nodes, weights = np.polynomial.legendre.leggauss(BENDS)
        square = FIRST**2 + (self.last**2 - FIRST**2) * (nodes + 1) / 2
        return Bends(
            curvature=as_array(2 * np.pi / np.sqrt(square)) / self.pitch,
            aspect=jnp.zeros(BENDS, dtype=self.panels.dtype),
            share=as_array(weights / 2),
        )

    def compass(self) -> Bends:
        """All directions alike, for a tool axis that always leans along x."""
        return Bends(
            curvature=jnp.zeros(DIRECTIONS, dtype=self.panels.dtype),
            aspect=as_array(2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS),
            share=as_array(np.full(DIRECTIONS, 1 / DIRECTIONS)),
        )


def involute(turns: int, centre: Float[Array, "2"], radius: Scalar) -> Involute:
    """Guide along the involute of a circle, from near its middle to near a border.

    Args:
        turns: How many pitches make the radius, 2 or more.
        centre: The middle of the spiral; may be traced [mm].
        radius: Radius of the round region, half a pitch beyond the end [mm].

    Raises:
        ValueError: if there are too few turns.
    """
    if turns < 2:
        raise ValueError(f"`turns` is {turns}, must be 2 or more for a round spiral.")
    # a sqrt(1 + last^2) = radius - pitch/2
    last = math.sqrt((2 * math.pi * (turns - 0.5)) ** 2 - 1)
    total = (last**2 - FIRST**2) / (4 * math.pi)
    panels = np.linspace(0.0, total, math.ceil(total) + 1)
    return Involute(pitch=radius / turns, centre=centre, panels=as_array(panels), last=last)
