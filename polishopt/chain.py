r"""Chain: the whole process as one function, from tilt and displacement to Ssk and Sku.

A step is mechanics first, which no texture changes, and then texture: what it makes of the
surface it finds. So a plan of several steps hands nothing on but the surface.
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .mechanics import Mechanics, mechanics
from .parts import Process, Scalar
from .setup import Setup, Start
from .texture.areal import Cumulants, cumulants
from .texture.evolution import Texture, combine
from .texture.filters import gaussian_transmission, transmit, wavelengths
from .texture.local import TextureMaps, rest_maps, scratch_maps, texture_maps
from .texture.planarisation import asperity_stiffness, planarise
from .texture.scratches import Population, decay, decay_rate, groove_population


class Outcome(Mechanics):
    """What one polishing step does, to the part and to its texture."""

    Sa: Scalar
    """Mean absolute height of the finished texture, estimated from the others [mm]."""
    Sq: Scalar
    """Root mean square height [mm]."""
    Ssk: Scalar
    """Skewness [-]."""
    Sku: Scalar
    """Kurtosis [-]."""
    Sz: Scalar
    """Height from the deepest pit to the highest peak, estimated without filter [mm]."""
    Sz_before: Scalar
    """The same of the surface that the step finds [mm]."""
    parts: tuple[Cumulants, ...]
    """Cumulants of what is left of the start map, of earlier scratches and ripples, of
    this step's scratches, and of its ripple [mm^2, mm^3, mm^4]."""
    left: Start
    """The surface as the next step finds it."""
    maps: TextureMaps | None = None
    """The texture at every place, `[y, x]`; None unless the setup asks for it."""


class Worn(NamedTuple):
    """What a step leaves of a height map."""

    heights: Float[Array, "ny nx"]
    """The map [mm]."""
    rest: Cumulants
    """Cumulants of what the roughness filter lets through [mm^2, mm^3, mm^4]."""


def worn(
    setup: Setup,
    heights: Float[Array, "ny nx"],
    spacing: Float[Array, "2"],
    pressure: Scalar,
    removal: Scalar,
) -> Worn:
    """What a step leaves of a height map.

    Args:
        setup: Abrasive, roughness filter and sampling are read.
        heights: The map as the step finds it, periodic [mm].
        spacing: Distance of its points along y and x [mm].
        pressure: Mean contact pressure [MPa].
        removal: Mean height removed [mm].
    """
    abrasive = setup.abrasive
    heights = planarise(
        heights,
        removal,
        pressure,
        asperity_stiffness(abrasive),
        abrasive.conformity,
        spacing,
        setup.sampling.planarisation,
    )
    waves = wavelengths(heights, spacing)
    passed = 1 - gaussian_transmission(waves, setup.roughness_cutoff)
    return Worn(heights, cumulants(transmit(heights, passed)))


def polish(process: Process, setup: Setup) -> Outcome:
    """What one polishing step does: force, time, removal and the finished texture.

    Pure and differentiable in everything physical; `jit` and `vmap` it as you like. What
    is not used of the outcome costs nothing under `jit`: the removal map most of all.

    Args:
        process: Tilt, displacement, step, trochoid radius, feed, spindle speed, passes.
        setup: The job: part, guide, tool, abrasive, machine, start texture, sampling.

    Returns:
        The outcome. Its gradients are finite wherever step, feed and passes are positive,
        also where the disc does not touch (no removal, and the start texture stays) or
        touches as a whole.

    Source: S0 (Pessoles & Tournier 2009) for the process; the texture model is our own.
    """
    return finish(mechanics(process, setup), setup, setup.start)


def finish(
    done: Mechanics, setup: Setup, start: Start, wear: Worn | None = None
) -> Outcome:
    """The texture that a step leaves, given what it does to the part.

    Args:
        done: From `mechanics`.
        setup: Abrasive, roughness filter and sampling are read.
        start: The surface that the step finds.
        wear: What is left of its height map, if that is known already.
    """
    rest, left = evolved(setup, start, done.pressure, done.mean_removal, wear)
    *earlier, own = left.scratches
    old = Start(tuple(earlier), spacing=left.spacing).total
    parts = (rest, old, own.cumulants, done.waves.cumulants)
    texture: Texture = combine(*parts)
    maps, places = local_texture(done, setup, start) if setup.local else (None, ())
    left = Start((*left.scratches, done.waves), left.heights, left.spacing, places)
    return Outcome(
        **vars(done),
        Sa=texture.Sa,
        Sq=texture.Sq,
        Ssk=texture.Ssk,
        Sku=texture.Sku,
        Sz=left.Sz,
        Sz_before=start.Sz,
        parts=parts,
        left=left,
        maps=maps,
    )


def local_texture(
    done: Mechanics, setup: Setup, start: Start
) -> tuple[TextureMaps, tuple[Population, ...]]:
    """The texture that a step leaves at every place of the part.

    Each place has its own removal and pressure, its own scratches of all grades, and as
    much of the ripple as the tool comes by there, for which its removal stands. A height
    map is worn place by place within one step; the next step of a plan finds it
    everywhere as the mean place of this one leaves it.

    Args:
        done: From `mechanics`.
        setup: The job.
        start: The surface that the step finds.

    Returns:
        The maps, and the maps of all scratches and ripples that the next step finds.

    Raises:
        ValueError: if the step before had maps of another size.
    """
    abrasive, removal = setup.abrasive, done.removal
    before = start.places or start.scratches
    if start.places and start.places[0].k2.shape != removal.shape:
        raise ValueError(
            f"`sampling.pixels` is {removal.shape}, must be "
            f"{start.places[0].k2.shape} as in the step before, for maps of texture."
        )
    scratches = scratch_maps(before, abrasive, removal, done.load)
    some = done.mean_removal > 0
    often = jnp.where(some, removal / jnp.where(some, done.mean_removal, 1.0), 0.0)
    k2, k3, k4 = (k * often for k in done.waves)
    width = jnp.broadcast_to(done.waves.width, removal.shape)
    waves = eqx.tree_at(
        lambda p: (p.k2, p.k3, p.k4, p.width), done.waves, (k2, k3, k4, width)
    )
    rest = ()
    if start.heights is not None:
        cutoff = setup.roughness_cutoff
        rest = (
            rest_maps(start.heights, start.spacing, abrasive, removal, done.load, cutoff),
        )
    found = texture_maps(setup.sampling.pixels, *rest, *scratches, waves)
    return TextureMaps(**vars(found), evaluated=setup.evaluated), (*scratches, waves)


def evolved(
    setup: Setup,
    start: Start,
    pressure: Scalar,
    removal: Scalar,
    wear: Worn | None = None,
) -> tuple[Cumulants, Start]:
    """What a step makes of a surface, ripple apart.

    Args:
        setup: Abrasive, roughness filter and sampling are read.
        start: The surface that the step finds.
        pressure: Mean contact pressure [MPa].
        removal: Mean height removed [mm].
        wear: What is left of its height map, if that is known already.

    Returns:
        Cumulants of what the roughness filter lets through of the start map's rest, and
        the surface after the step; its last population are the step's own scratches.
    """
    abrasive = setup.abrasive
    rate = decay_rate(abrasive, pressure)
    scratches = (
        *(decay(old, removal, rate, abrasive.conformity) for old in start.scratches),
        groove_population(abrasive, pressure, removal),
    )
    if start.heights is None:
        zero = jnp.zeros_like(removal)
        return Cumulants(zero, zero, zero), Start(scratches, spacing=start.spacing)
    if wear is None:
        wear = worn(setup, start.heights, start.spacing, pressure, removal)
    return wear.rest, Start(scratches, wear.heights, start.spacing)
