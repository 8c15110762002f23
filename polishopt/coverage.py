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
from .path.surface import Plane, Surface, area_stretch, jacobian
from .texture.filters import gaussian_filter


# Pixels along either side, and pitches that the Gaussian is wide, in `uneven_coverage`.
PIXELS, PITCHES = 96, 2.0


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


def uneven_coverage(surface: Surface, guide: Guide, size: Float[Array, "2"]) -> Scalar:
    """How much the local coverage varies because the part is no plane [-].

    Standard deviation over mean of what is left of the coverage when that of the same
    guide on a plane is divided out, each length of path counting alike: lines, corners
    and borders of the guide do not count, and on a plane it is zero.

    Args:
        surface: The part.
        guide: The path, on the parameter plane.
        size: Sides of the parameter plane [mm].

    Source: Own derivation; C of S4 (Tam, Cheng et al. 2013), eq. (5), made local.
    """
    grid = Grid(jnp.zeros_like(size), size, (PIXELS, PIXELS))
    cutoff = PITCHES * guide.pitch
    flat = coverage(Plane(size), guide, grid, cutoff)
    share = coverage(surface, guide, grid, cutoff) / jnp.where(flat > 0, flat, 1.0)
    weight = flat / jnp.sum(flat)
    mean = jnp.sum(weight * share)
    square = jnp.sum(weight * (share - mean) ** 2) / mean**2
    some = square > 0
    return jnp.where(some, jnp.sqrt(jnp.where(some, square, 1.0)), 0.0)
