"""Planarisation: how a pad wears the topography it is pressed on.

The pad is a bed of springs of stiffness K_a at the scale of the grains, which touches
what stands out and bends to follow everything longer than a conformity length. It wears
in proportion to its pressure (Preston). So peaks go first, heights skew downwards, and
once everything touches the rest decays exponentially. Removal, the mean height lost,
takes the place of time.
"""

import math
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PyTree

from ..parts import Abrasive, Scalar
from .filters import Spacing, gaussian_transmission, transmit, wavelengths


# Removal over pad compression beyond which a step is the limit of a rigid pad, to more
# digits than a double holds. It keeps derivatives finite as the pressure goes to zero.
RIGID = 1e6


def asperity_stiffness(abrasive: Abrasive) -> Scalar:
    r"""Stiffness of the pad at the scale of the grains, per area [N/mm^3].

    $K_a = \pi E^*/\ell_g$ with $\ell_g = d/\sqrt{c_a}$: an elastic half-space loaded at
    the spacing of its active grains. A calibrated number in the abrasive overrides it.

    Args:
        abrasive: The abrasive and its pad.
    """
    given = abrasive.asperity_stiffness
    known = ~jnp.isnan(given)
    spacing = abrasive.grain / jnp.sqrt(abrasive.active_fraction)
    return jnp.where(
        known, jnp.where(known, given, 0.0), math.pi * abrasive.pad_modulus / spacing
    )


def saturation(x: Float[Array, " *n"]) -> Float[Array, " *n"]:
    r"""$(1 - e^{-x})/x$ [-], which is 1 at zero, with its derivatives.

    Args:
        x: Any number from zero up [-].
    """
    small = jnp.abs(x) < 1e-3
    safe = jnp.where(small, jnp.ones_like(x), x)
    series = 1.0 - x / 2.0 * (1.0 - x / 3.0 * (1.0 - x / 4.0))
    return jnp.where(small, series, -jnp.expm1(-safe) / safe)


def decay_exponent(
    removal: Float[Array, "*n"], compression: Scalar
) -> tuple[Float[Array, "*n"], Float[Array, "*n"]]:
    r"""Removal in units of the pad's compression [-], and that compression [mm].

    $x = rh = h/A$, at most `RIGID`, where the compression is raised to match; 0 where
    nothing is removed and nothing presses.

    Args:
        removal: Mean height removed, $h$ [mm].
        compression: Mean compression of the pad, $A = \bar p/K_a$ [mm].
    """
    floored = jnp.maximum(compression, removal / RIGID)
    pressed = floored > 0
    return jnp.where(pressed, removal / jnp.where(pressed, floored, 1.0), 0.0), floored


def _contact(
    height: Float[Array, "ny nx"], excess: Scalar, start: Scalar
) -> tuple[Bool[Array, "ny nx"], Scalar]:
    """Points above the level over which the mean height is `excess`, and that level.

    Newton's method on a convex, piecewise linear function: after one step it is below
    the root, whence it rises and ends exactly, when no more points are let go.
    """
    lowest = jnp.mean(height) - excess

    def newton(level):
        above = height > level
        count = jnp.maximum(jnp.sum(above), 1)
        total = jnp.sum(jnp.where(above, height, 0.0)) - excess * height.size
        return jnp.maximum(total / count.astype(height.dtype), lowest)

    def rises(state):
        count, before, level = state
        return (count < 2) | (level > before)

    def climb(state):
        count, _, level = state
        return count + 1, level, newton(level)

    _, _, level = jax.lax.while_loop(rises, climb, (jnp.zeros((), int), start, start))
    return height >= level, level


def _load(
    height: Float[Array, "ny nx"], excess: Scalar, start: Scalar
) -> tuple[Float[Array, "ny nx"], Scalar]:
    """Pressure over its mean at every point of a relative height map, and the pad's level.

    The contact set is found without derivatives; given the set, the level is linear in
    heights and excess, so its derivatives are exact.
    """
    frozen = jax.lax.stop_gradient(height)
    # below this the arithmetic cannot tell the highest point from its neighbours
    grain = 4.0 * jnp.finfo(height.dtype).eps * jnp.max(jnp.abs(frozen))
    excess = jnp.maximum(excess, grain)
    touching, start = _contact(frozen, jax.lax.stop_gradient(excess), start)
    share = jnp.mean(touching.astype(height.dtype))
    level = (jnp.mean(jnp.where(touching, height, 0.0)) - excess) / share
    depth = jnp.where(touching, jnp.maximum(height - level, 0.0), 0.0)
    mean = jnp.mean(depth)
    pressed = mean > 0
    load = jnp.where(pressed, depth / jnp.where(pressed, mean, 1.0), 1.0)
    return load, start


def pad_pressure(
    z: Float[Array, "ny nx"],
    pressure: Scalar,
    stiffness: Scalar,
    conformity: Scalar | float | None = None,
    spacing: Spacing = 1.0,
) -> Float[Array, "ny nx"]:
    r"""Pressure of the pad on each point of a periodic map [MPa]; zero where it hovers.

    $K_a(z_r - z_d)_+$ with $z_r = z - G(\ell_c) * z$, and $z_d$ such that the mean is
    $\bar p$.

    Args:
        z: Heights [mm].
        pressure: Mean contact pressure, $\bar p$ [MPa].
        stiffness: Stiffness of the pad at grain scale, $K_a$ [N/mm^3].
        conformity: Wavelength that the pad follows by half, $\ell_c$ [mm]; infinite, or
            None for speed, if it stays flat.
        spacing: Distance of neighbouring points, or (along y, along x) [mm].
    """
    height = z - jnp.mean(z)
    if conformity is not None:
        height = z - transmit(z, gaussian_transmission(wavelengths(z, spacing), conformity))
    load, _ = _load(height, pressure / stiffness, jnp.zeros((), z.dtype))
    return pressure * load


class _Bend(eqx.Module):
    """How the pad follows each wave on average over a step."""

    guess: Float[Array, "ny nf"]
    """Share of the wave at the start of the step, in full contact [-]."""
    start: Float[Array, "ny nf"]
    """The same without the half of it that the end of the step adds [-]."""
    end: Float[Array, "ny nf"]
    """That half, as a share of the wave at the end of the step [-]."""


class _Pace(eqx.Module):
    """What a step of given removal asks of the pad."""

    part: Scalar
    """Mean height removed [mm]."""
    excess: Scalar
    """Mean depth to which the pad is pressed in [mm]."""
    bend: _Bend | None
    """How it bends; None if it stays flat."""


def _pace(part: Scalar, compression: Scalar, passed: Float[Array, "ny nf"] | None) -> _Pace:
    """A step, for a pad that follows the share `passed` of each wave."""
    x, floored = decay_exponent(part, compression)
    excess = floored / saturation(x)
    if passed is None:
        return _Pace(part, excess, None)
    lifted, half = 1.0 - passed, 0.5 * passed
    # a wave that is lifted by so much decays by exp(-x lifted) in full contact
    guess = 1.0 - lifted * saturation(x * lifted) / saturation(x)
    return _Pace(part, excess, _Bend(guess, guess - half * jnp.exp(-x * lifted), half))


def _step(
    z: Float[Array, "ny nx"], level: Scalar, pace: _Pace
) -> tuple[Float[Array, "ny nx"], Scalar]:
    """The map after a step, and where to look for the pad's level in the next."""
    bend = pace.bend
    if bend is None:
        load, level = _load(z - jnp.mean(z), pace.excess, level)
        return z - pace.part * load, level

    def worn(shape, level):
        relative = z - jnp.fft.irfft2(shape, s=z.shape)
        load, level = _load(relative, pace.excess, level)
        return z - pace.part * load, level

    modes = jnp.fft.rfft2(z)
    end, level = worn(bend.guess.astype(modes.dtype) * modes, level)
    # the pad has followed what has been worn since, not what full contact would wear
    shape = bend.start.astype(modes.dtype) * modes
    return worn(shape + bend.end.astype(modes.dtype) * jnp.fft.rfft2(end), level)


def _passed(
    z: Float[Array, "ny nx"], conformity: Scalar | float | None, spacing: Spacing
) -> Float[Array, "ny nf"] | None:
    """Share of each wave that the pad follows [-]."""
    if conformity is None:
        return None
    return gaussian_transmission(wavelengths(z, spacing), conformity)


def planarise(
    z: Float[Array, "ny nx"],
    removal: Scalar,
    pressure: Scalar,
    stiffness: Scalar,
    conformity: Scalar | float | None = None,
    spacing: Spacing = 1.0,
    steps: int = 24,
) -> Float[Array, "ny nx"]:
    r"""Heights of a periodic map after the pad has removed a mean height [mm].

    $\partial z/\partial h = -r\,(z_r - z_d)_+$ with $r = K_a/\bar p$: the pressure law of
    `pad_pressure`. Each step holds $z_d$ at the one value for which the exact solution
    of what touches, $(z_r - z_d)_+\,e^{-rh}$, removes just its share of `removal`. So a
    step of any size is stable, keeps the order of the heights, takes nothing where the
    pad hovers, is exact in full contact, and becomes a plane cut when the pad is rigid.
    What the pad follows within a step is taken from a first guess of its end, such that
    full contact stays exact. The error is of second order in the size of the steps.

    Derivatives are those of these steps, exactly, wherever no point is just about to
    touch. At zero pressure they are those of a rigid pad.

    Args:
        z: Heights [mm]; the map is taken to repeat beyond its border.
        removal: Mean height to remove, $h$ [mm].
        pressure: Mean contact pressure, $\bar p$ [MPa].
        stiffness: Stiffness of the pad at grain scale, $K_a$ [N/mm^3], above zero.
        conformity: Wavelength that the pad follows by half, $\ell_c$ [mm]; infinite, or
            None for speed, if it stays flat.
        spacing: Distance of neighbouring points, or (along y, along x) [mm].
        steps: Number of equal steps.

    Returns:
        The heights, on average `removal` lower than before.

    Source: Own derivation.
    """
    passed = _passed(z, conformity, spacing)
    pace = _pace(removal / steps, pressure / stiffness, passed)

    def step(carry, _):
        z, level = carry
        return _step(z, level, pace), None

    # a gradient keeps the map of each step and works out the rest again: a quarter of
    # the memory, for a tenth of the time
    step = jax.checkpoint(step, prevent_cse=False)
    (z, _), _ = jax.lax.scan(step, (z, jnp.zeros((), z.dtype)), length=steps)
    return z


def planarised(
    z: Float[Array, "ny nx"],
    removals: Float[Array, " n"],
    pressure: Scalar,
    stiffness: Scalar,
    look: Callable[[Float[Array, "ny nx"]], PyTree],
    conformity: Scalar | float | None = None,
    spacing: Spacing = 1.0,
) -> PyTree:
    """What is seen of a map on its way, whenever so much has been removed.

    The steps of `planarise`, from one removal to the next.

    Args:
        z: Heights [mm]; the map is taken to repeat beyond its border.
        removals: Mean heights removed since the start, ascending [mm].
        pressure: Mean contact pressure [MPa].
        stiffness: Stiffness of the pad at grain scale [N/mm^3], above zero.
        look: What to keep of a map.
        conformity: Wavelength that the pad follows by half [mm]; infinite, or None for
            speed, if it stays flat.
        spacing: Distance of neighbouring points, or (along y, along x) [mm].

    Returns:
        What `look` returns, with an axis of `n` in front.
    """
    passed, compression = _passed(z, conformity, spacing), pressure / stiffness

    def step(carry, part):
        z, level = carry
        z, level = _step(z, level, _pace(part, compression, passed))
        return (z, level), look(z)

    step = jax.checkpoint(step, prevent_cse=False)
    parts = jnp.diff(removals, prepend=0.0)
    return jax.lax.scan(step, (z, jnp.zeros((), z.dtype)), parts)[1]
