"""Marks: the pattern that the teeth of a mill leave on a plane, pass beside pass.

The pattern of a whole surface follows from one turn of the spindle and a few passes, so
that a small map stands for all of it, without a seam: a start for polishing, and what the
parameters of a milled surface are taken from.
"""

import math

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..parts import Scalar
from .cutter import Cutter, Passings, several
from .cutting import cut
from .milling import MilledSurface, Sz_analytic, envelope_curvature


def milled_marks(
    milled: MilledSurface,
    shape: tuple[int, int],
    passes: int = 5,
    reach: tuple[int, int] | None = None,
    cutter: Cutter | None = None,
    width: Scalar | float | None = None,
    candidates: int = 32,
) -> tuple[Float[Array, "ny nx"], Float[Array, "2"]]:
    r"""Height map of a plane milled tooth by tooth, and its spacing [mm].

    It holds one turn of the spindle along x, the feed, and `passes` parallel passes along
    y, and repeats itself without a seam. Nobody synchronises the spindle with the passes,
    so that marks of neighbouring passes are shifted by any part of the feed: the map has
    them by 0, 1/n, ... (n - 1)/n of it. That repeats after n passes where n is odd.

    Args:
        milled: How the surface is milled; its corner and outer radius where no cutter is
            given.
        shape: Points along y and along x.
        passes: Number of passes n, odd.
        reach: Passes on either side, and teeth before and after, that may cut the same
            line; static. By default from `milled`, which must then be known numbers.
        cutter: The tool; one with a single tooth by default.
        width: Width of a smooth minimum [mm]; none for the least.
        candidates: Passings that each tile of the map, a quarter of a pass, looks at.

    Returns:
        The heights above the plane as drawn (NaN as in `cut`), and the distances of
        neighbours along y and x.

    Raises:
        ValueError: if `passes` is even.

    Source: Own derivation, with the geometry of S2.
    """
    if passes % 2 == 0:
        raise ValueError(f"`passes` is {passes}, must be odd: shifts would not repeat.")
    if cutter is None:
        cutter = Cutter(milled.outer_radius, milled.corner_radius)
    if reach is None:
        reach = _reach(milled)
    return _marks(milled, cutter, shape, passes, reach, candidates, width)


@eqx.filter_jit
def _marks(
    milled: MilledSurface,
    cutter: Cutter,
    shape: tuple[int, int],
    passes: int,
    reach: tuple[int, int],
    candidates: int,
    width: Scalar | float | None,
) -> tuple[Float[Array, "ny nx"], Float[Array, "2"]]:
    turn = cutter.teeth * milled.feed_per_tooth
    period = jnp.stack([passes * milled.step, turn])
    spacing = period / jnp.asarray(shape, dtype=period.dtype)
    y, x = (
        (jnp.arange(n, dtype=period.dtype) + 0.5) * d
        for n, d in zip(shape, spacing, strict=True)
    )
    teeth = _lattice(milled, cutter, passes, reach)
    tile = (max(1, shape[0] // (4 * passes)), shape[1])
    return cut(_flat, x, y, cutter, teeth, candidates, tile, width=width), spacing


def _reach(milled: MilledSurface) -> tuple[int, int]:
    """Passes and teeth on either side whose groove dips below the highest cusp.

    A pass at the distance d is $d^2/2R_{app}$ higher than one straight above; teeth beyond
    the outer radius cannot reach the line at all.
    """
    outer, step = float(milled.outer_radius), float(milled.step)
    tool = (milled.outer_radius, milled.corner_radius, milled.tilt, milled.yaw)
    bend, highest = float(envelope_curvature(*tool)), float(Sz_analytic(milled))
    far = min(outer, math.sqrt(2 * highest / bend) if bend > 0 else outer)
    return 2 + int(far / step), 2 + int(outer / float(milled.feed_per_tooth))


def _lattice(
    milled: MilledSurface, cutter: Cutter, passes: int, reach: tuple[int, int]
) -> Passings:
    """Passings of parallel passes on a plane, shifted as `milled_marks` says."""
    n, (beyond, m) = passes, reach
    j = jnp.arange(-beyond, n + beyond)
    k = jnp.arange(-m, cutter.teeth + m)
    feed, dtype = milled.feed_per_tooth, milled.step.dtype
    # whole teeth are a pattern of their own: the remainder is all that matters
    shift = (j * (j - 1) // 2 % n).astype(dtype) / n * cutter.teeth
    along = (k.astype(dtype)[None, :] + shift[:, None]) * feed
    across = jnp.broadcast_to((j.astype(dtype) + 0.5)[:, None] * milled.step, along.shape)
    tilt, yaw = milled.tilt, milled.yaw
    zero, one = jnp.zeros_like(tilt), jnp.ones_like(tilt)
    n_, lean = jnp.stack([zero, zero, one]), jnp.stack([jnp.cos(yaw), jnp.sin(yaw), zero])
    axis = jnp.cos(tilt) * n_ + jnp.sin(tilt) * lean
    towards = jnp.cos(tilt) * lean - jnp.sin(tilt) * n_
    offset = cutter.corner_radius * n_ - cutter.ring * towards
    contact = jnp.stack([along, across, jnp.zeros_like(along)], axis=-1)

    def same(vector: Float[Array, "3"]) -> Float[Array, "j k 3"]:
        return jnp.broadcast_to(vector, contact.shape)

    per_angle = -feed * cutter.teeth / (2 * jnp.pi)  # clockwise
    still = jnp.zeros_like(contact)
    return several(
        Passings(
            centre=contact + same(offset),
            slope=same(per_angle * jnp.stack([one, zero, zero])),
            bend=still,
            axis=same(axis),
            axis_slope=still,
            towards=same(towards),
            towards_slope=still,
            tooth=jnp.broadcast_to(k % cutter.teeth, along.shape),
        )
    )


def _flat(xy: Float[Array, "2"]) -> Float[Array, "3"]:
    """The plane, in the precision of its points."""
    return jnp.concatenate([xy, jnp.zeros_like(xy[:1])])
