"""Soundness: whether a surface is one that a tool can polish."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .surface import Surface, tangent_plane


# Places along each side at which a surface is looked at.
LOOKS = 33


def check_surface(surface: Surface, size: Float[Array, "2"] | tuple[float, float]) -> None:
    """Refuses a surface that has no value, no area or a fold; not for use under `jit`.

    Args:
        surface: The part.
        size: Sides of the parameter plane [mm].

    Raises:
        ValueError: with the place in the parameter plane.
    """
    sides = np.asarray(size, dtype=float)
    if not (np.isfinite(sides) & (sides > 0)).all():
        raise ValueError(
            f"the part is {sides.tolist()} mm, must have two sides above 0 mm."
        )
    share = (np.arange(LOOKS) + 0.5) / LOOKS
    places = np.stack(np.meshgrid(*sides[:, None] * share), axis=-1).reshape(-1, 2)
    points, columns = map(np.asarray, _tangents(surface, jnp.asarray(places)))

    def at(bad):
        x, y = places[np.argmax(bad)]
        return f"at ({x:.4g}, {y:.4g}) mm of its {sides[0]:g} x {sides[1]:g} mm"

    lost = ~(np.isfinite(columns).all(axis=(1, 2)) & np.isfinite(points).all(axis=1))
    if lost.any():
        raise ValueError(f"the surface has no value {at(lost)}.")
    outward = np.cross(columns[:, :, 0], columns[:, :, 1])
    stretch = np.linalg.norm(outward, axis=1)
    empty = stretch < 1e-9 * max(1.0, stretch.max())
    if empty.any():
        raise ValueError(f"the surface has no area {at(empty)}.")
    normals = outward / stretch[:, None]
    folded = normals @ normals.sum(axis=0) <= 0
    if folded.any():
        raise ValueError(
            f"the surface folds over, or turns by more than 90°, {at(folded)}; split it."
        )


@eqx.filter_jit
def _tangents(surface, places):
    return jax.vmap(lambda xy: tangent_plane(surface, xy))(places)
