r"""Coverage: how much path there is on each area of a part.

Length of path over area of part [1/mm]: at a constant feed it is the time spent on an
area, and for a Peano path of segments of length p it is 2/p. A path is a line, so the
local coverage is a mean, here under a Gaussian that is wider than the distance of lines.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .contact.removal import Grid, deposit
from .parts import Scalar
from .path.guide import Guide
from .path.surface import Surface, area_stretch, jacobian
from .texture.filters import gaussian_filter


def path_lengths(
    surface: Surface, guide: Guide, per_panel: int = 4
) -> tuple[Float[Array, "n 2"], Float[Array, " n"]]:
    """A guide in small pieces: where they lie, and how long each is on the part.

    Args:
        surface: The part.
        guide: The path, on the parameter plane.
        per_panel: Pieces of each panel of the guide.

    Returns:
        Places in the parameter plane [mm], and lengths [mm]; a way back with the tool
        lifted has none.
    """
    s, weight = guide.stations(per_panel)

    def piece(s, weight):
        at = guide(s)
        tangent = jnp.stack([jnp.cos(at.heading), jnp.sin(at.heading)])
        along = jacobian(surface, at.position) @ tangent
        return at.position, at.contact * weight * jnp.sqrt(jnp.sum(along**2))

    return jax.vmap(piece)(s, weight)


def coverage(
    surface: Surface, guide: Guide, grid: Grid, cutoff: Scalar | float
) -> Float[Array, "ny nx"]:
    """Length of path on an area of the part, about each pixel [1/mm].

    Both are smoothed by the same Gaussian before they are divided, so that nothing falls
    off towards the borders of the grid; the path itself may keep away from those of the
    part.

    Args:
        surface: The part.
        guide: The path, on the parameter plane.
        grid: The pixels, which should cover the whole guide.
        cutoff: Wavelength at half transmission of the Gaussian; four pitches hide single
            lines [mm].

    Source: C of S4 (Tam, Cheng et al. 2013), eq. (5), made local.
    """
    places, lengths = path_lengths(surface, guide)
    length = deposit(places, lengths, grid)  # on an area of the parameter plane
    pixels = jnp.stack(jnp.meshgrid(grid.x, grid.y), axis=-1).reshape(-1, 2)
    stretch = jax.vmap(lambda at: area_stretch(surface, at))(pixels).reshape(grid.shape)
    spacing = grid.spacing[::-1]
    return gaussian_filter(length, spacing, cutoff) / gaussian_filter(
        stretch, spacing, cutoff
    )
