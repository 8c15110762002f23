r"""Flat: the tilted disc on a plane, where all has a closed form.

What touches is a segment of the disc, and what is pressed out of the bed a cylindrical
ungula. Every contact with a plane is as any other, so a flat part needs but one.
"""

import jax.numpy as jnp

from ..parts import Process, Scalar, Tool
from .pressure import Patch, columns_between, rows_within, tiny


def immersion(radius: Scalar, tilt: Scalar, displacement: Scalar) -> Scalar:
    r"""Length of the contact segment in the disc plane, s = min(e / sin(theta), 2R) [mm].

    At zero tilt the pressed disc touches as a whole and the value is 2R; without
    displacement it is 0.

    Args:
        radius: Disc radius, $R$ [mm].
        tilt: Tilt, $\theta$ [rad].
        displacement: Displacement, $e$ [mm].

    Source: own derivation; S0 (Pessoles & Tournier 2009) eq. (7) is its projection.
    """
    slope = jnp.sin(tilt)
    partial = (displacement < 2 * radius * slope) | (displacement <= 0)
    sloped = partial & (slope > 0)
    part = jnp.maximum(displacement, 0.0) / jnp.where(sloped, slope, 1.0)
    return jnp.where(partial, part, 2 * radius)


def effective_diameter(radius: Scalar, tilt: Scalar, displacement: Scalar) -> Scalar:
    r"""Width that the tilted disc wipes, D_eff [mm].

    $D_{eff} = 2\sqrt{R^2 - l^2}$ with the chord distance $l = R - e/\sin\theta$ measured
    in the disc plane. Once the contact reaches the disc's centre ($l \le 0$) the width is
    the full diameter; the printed formula would let it shrink again. At zero displacement
    it is 0, with a gradient of 0.

    Args:
        radius: Disc radius, $R$ [mm].
        tilt: Tilt, $\theta$ [rad].
        displacement: Displacement, $e$ [mm].

    Source: S0 (Pessoles & Tournier 2009) eqs. (6), (7), with l unprojected and clamped.
    """
    reach = jnp.minimum(immersion(radius, tilt, displacement), radius)
    square = reach * (2 * radius - reach)
    touching = square > 0
    return jnp.where(touching, 2 * jnp.sqrt(jnp.where(touching, square, 1.0)), 0.0)


def envelope(radius: Scalar, process: Process) -> Scalar:
    """Width of the strip that one trochoid polishes, E = 2 D_tr + D_eff [mm].

    Args:
        radius: Disc radius [mm].
        process: Tilt, displacement and trochoid radius.

    Source: S0 (Pessoles & Tournier 2009) eq. (8); D_tr acts as a radius.
    """
    width = effective_diameter(radius, process.tilt, process.displacement)
    return 2 * process.trochoid_radius + width


def flat_load(
    radius: Scalar,
    foundation: Scalar,
    tilt: Scalar,
    displacement: Scalar,
    stiffening: Scalar | float = 0.0,
) -> tuple[Scalar, Scalar]:
    r"""Force [N] and area [mm^2] of the contact on a plane.

    $F = k\sin\theta\cos\theta\,R^3[\sin\alpha - \tfrac13\sin^3\alpha - \alpha\cos\alpha]$
    while part of the disc touches; $F = k\cos\theta\,\pi R^2 (e - R\sin\theta)$ once all
    of it does. Both values and slopes agree where the cases meet. A bed that stiffens adds
    $k\beta\sin^2\theta\cos\theta\,R^4[\tfrac14\alpha - \tfrac1{16}\sin4\alpha
    - \tfrac43\cos\alpha\sin^3\alpha + \cos^2\alpha(\alpha - \tfrac12\sin2\alpha)]$,
    and $k\beta\cos\theta\,\pi R^2[(e - R\sin\theta)^2 + \tfrac14R^2\sin^2\theta]$.
    The area is $A = \cos\theta\,R^2(\alpha - \sin\alpha\cos\alpha)$, with
    $\cos\alpha = 1 - s/R$ and s from `immersion`.

    Args:
        radius: Disc radius, $R$ [mm].
        foundation: Stiffness of the elastic bed, $k$ [N/mm^3].
        tilt: Tilt, $\theta$ [rad].
        displacement: Displacement, $e$ [mm].
        stiffening: Relative growth of the bed's stiffness per depth, $\beta$ [1/mm].

    Source: own derivation, volume of a cylindrical ungula and its second moment;
        area of a circular segment.
    """
    # half the angle that the contact segment subtends; its corners at 0 and pi are cut
    cosine = 1 - immersion(radius, tilt, displacement) / radius
    cosine = jnp.clip(cosine, -1 + tiny(cosine), 1 - tiny(cosine))
    angle, sine = jnp.arccos(cosine), jnp.sqrt((1 - cosine) * (1 + cosine))
    ungula = radius**3 * (sine - sine**3 / 3 - angle * cosine)
    slope, level = jnp.sin(tilt), jnp.cos(tilt)
    # sines of 2 alpha and 4 alpha written out
    square, both = cosine**2, sine * cosine
    second = angle * (0.25 + square) - both * (13 / 12 + square / 6)
    part = slope * (ungula + stiffening * slope * radius**4 * second)
    excess = displacement - radius * slope
    spread = excess**2 + (radius * slope) ** 2 / 4
    whole = jnp.pi * radius**2 * (excess + stiffening * spread)
    volume = jnp.where(displacement >= 2 * radius * slope, whole, part)
    return foundation * level * volume, level * radius**2 * (angle - both)


def flat_area(radius: Scalar, tilt: Scalar, displacement: Scalar) -> Scalar:
    r"""Contact area on a plane [mm^2].

    $A = \cos\theta\,R^2(\alpha - \sin\alpha\cos\alpha)$, $\cos\alpha = 1 - s/R$.

    Args:
        radius: Disc radius, $R$ [mm].
        tilt: Tilt, $\theta$ [rad].
        displacement: Displacement, $e$ [mm].

    Source: area of a circular segment.
    """
    return flat_load(radius, jnp.ones_like(radius), tilt, displacement)[1]


def flat_force(
    radius: Scalar,
    foundation: Scalar,
    tilt: Scalar,
    displacement: Scalar,
    stiffening: Scalar | float = 0.0,
) -> Scalar:
    """Force that presses a tilted disc on a plane, as in `flat_load` [N].

    Args:
        radius: Disc radius [mm].
        foundation: Stiffness of the elastic bed [N/mm^3].
        tilt: Tilt [rad].
        displacement: Displacement [mm].
        stiffening: Relative growth of the bed's stiffness per depth [1/mm].
    """
    return flat_load(radius, foundation, tilt, displacement, stiffening)[0]


def flat_patch(
    process: Process, tool: Tool, lean: float = 1.0, rows: int = 6, columns: int = 4
) -> Patch:
    r"""Contact patch of the tilted disc on a plane.

    `pressure.patch` without curvature: the depth is $w = e - x\sin\theta$, and every row
    touches from the rim to the distance s of `immersion`.

    Args:
        process: Tilt and displacement are read.
        tool: Radius, foundation and stiffening are read.
        lean: As in `pressure.patch`.
        rows: As there.
        columns: As there.

    Source: own derivation.
    """
    radius, slope = tool.radius, jnp.sin(process.tilt)
    reach = immersion(radius, process.tilt, process.displacement)
    share = jnp.clip(reach / radius, tiny(reach), 1.0)
    angle, height = rows_within(jnp.arccos(1 - share), rows)
    eta, along = radius * jnp.sin(angle), radius * jnp.cos(angle)
    near, far = radius - along, radius + along
    ends = [(near, jnp.clip(reach, near, far))]

    def depth(x):
        return process.displacement - slope * x

    return columns_between(ends, eta, height * along, depth, process, tool, lean, columns)
