r"""Pressure: where the tilted disc touches the part, and how hard it presses.

The elastomer behind the disc is taken as a bed of independent springs (Winkler): each
point presses with k times the depth it would otherwise sink in, or a little more than in
proportion where the bed stiffens. On a plane everything
has a closed form (a cylindrical ungula); on a curved part the gap gains the local
curvature and a quadrature over the contact patch takes over. The tool frame has its
origin at the contact point, which is the lowest point of the rim: xi runs along the feed
direction, eta to its left.

Ignored: shear between neighbouring springs, and the time the elastomer takes to relax.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..parts import Process, Scalar, Tool


# Of `force_and_area`: rows on either side of a corner, nodes in each, exact for what a bed
# that stiffens presses, and steps of Newton's method to that corner.
LOAD_ROWS, LOAD_COLUMNS, NEWTON = 8, 3, 3
# Smallest rim angle at which a patch is drawn [-]: keeps arccos away from its corner.
TINY = 1e-12


def _tiny(x: Scalar) -> float:
    # in single precision 1 - TINY is 1, and arccos has no slope there
    return max(TINY, float(jnp.finfo(x.dtype).eps))


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


def _segment_angle(radius: Scalar, reach: Scalar) -> Scalar:
    # half the angle that the contact segment subtends; its corners at 0 and pi are cut
    cosine = 1 - reach / radius
    return jnp.arccos(jnp.clip(cosine, -1 + _tiny(cosine), 1 - _tiny(cosine)))


def flat_area(radius: Scalar, tilt: Scalar, displacement: Scalar) -> Scalar:
    r"""Contact area on a plane [mm^2].

    $A = \cos\theta\,R^2(\alpha - \sin\alpha\cos\alpha)$, $\cos\alpha = 1 - s/R$.

    Args:
        radius: Disc radius, $R$ [mm].
        tilt: Tilt, $\theta$ [rad].
        displacement: Displacement, $e$ [mm].

    Source: area of a circular segment.
    """
    angle = _segment_angle(radius, immersion(radius, tilt, displacement))
    return jnp.cos(tilt) * radius**2 * (angle - jnp.sin(angle) * jnp.cos(angle))


def bed_pressure(
    foundation: Scalar, stiffening: Scalar, depth: Float[Array, "*n"]
) -> Float[Array, "*n"]:
    r"""Pressure of the elastic bed where it is pressed in, $k(w + \beta w^2)$ [MPa].

    Zero where nothing is pressed in, and never a pull.

    Args:
        foundation: Stiffness of the bed, $k$ [N/mm^3].
        stiffening: Its relative growth per depth, $\beta$ [1/mm]. A bed that softens,
            $\beta < 0$, is described up to a depth of $-1/(2\beta)$.
        depth: How far the bed is pressed in, $w$ [mm].
    """
    pressed = jnp.maximum(depth, 0.0)
    return foundation * pressed * jnp.maximum(1.0 + stiffening * pressed, 0.0)


def flat_force(
    radius: Scalar,
    foundation: Scalar,
    tilt: Scalar,
    displacement: Scalar,
    stiffening: Scalar | float = 0.0,
) -> Scalar:
    r"""Force that presses a tilted disc on a plane [N].

    $F = k\sin\theta\cos\theta\,R^3[\sin\alpha - \tfrac13\sin^3\alpha - \alpha\cos\alpha]$
    while part of the disc touches; $F = k\cos\theta\,\pi R^2 (e - R\sin\theta)$ once all
    of it does. Both values and slopes agree where the cases meet. A bed that stiffens adds
    $k\beta\sin^2\theta\cos\theta\,R^4[\tfrac14\alpha - \tfrac1{16}\sin4\alpha
    - \tfrac43\cos\alpha\sin^3\alpha + \cos^2\alpha(\alpha - \tfrac12\sin2\alpha)]$,
    and $k\beta\cos\theta\,\pi R^2[(e - R\sin\theta)^2 + \tfrac14R^2\sin^2\theta]$.

    Args:
        radius: Disc radius, $R$ [mm].
        foundation: Stiffness of the elastic bed, $k$ [N/mm^3].
        tilt: Tilt, $\theta$ [rad].
        displacement: Displacement, $e$ [mm].
        stiffening: Relative growth of the bed's stiffness per depth, $\beta$ [1/mm].

    Source: own derivation, volume of a cylindrical ungula and its second moment.
    """
    angle = _segment_angle(radius, immersion(radius, tilt, displacement))
    sine, cosine = jnp.sin(angle), jnp.cos(angle)
    ungula = radius**3 * (sine - sine**3 / 3 - angle * cosine)
    slope, level = jnp.sin(tilt), foundation * jnp.cos(tilt)
    second = angle / 4 - jnp.sin(4 * angle) / 16 - 4 * cosine * sine**3 / 3
    second = second + cosine**2 * (angle - jnp.sin(2 * angle) / 2)
    part = level * slope * (ungula + stiffening * slope * radius**4 * second)
    excess = displacement - radius * slope
    square = excess**2 + (radius * slope) ** 2 / 4
    whole = level * jnp.pi * radius**2 * (excess + stiffening * square)
    return jnp.where(displacement >= 2 * radius * slope, whole, part)


class Patch(eqx.Module):
    """The contact patch as quadrature nodes, rows across the feed, columns along it."""

    offsets: Float[Array, "rows columns 2"]
    """Node positions (xi, eta) from the contact point [mm]."""
    arms: Float[Array, "rows columns 2"]
    """Node positions from the disc's centre, in the disc plane: towards the contact
    point, and along eta [mm]."""
    pressure: Float[Array, "rows columns"]
    """Contact pressure at each node [MPa]."""
    area: Float[Array, "rows columns"]
    """Area of part surface that each node stands for [mm^2]."""

    @property
    def force(self) -> Scalar:
        """Force normal to the part [N]."""
        return jnp.sum(self.pressure * self.area)

    @property
    def contact_area(self) -> Scalar:
        """Area under pressure [mm^2]."""
        return jnp.sum(jnp.where(self.pressure > 0, self.area, 0.0))


def _rim_angle(process, radius, curvature) -> Scalar:
    """Rim angle from the contact point beyond which no rim point touches [rad].

    With c = 1 - cos(angle) the depth along the rim is a quadratic in c. Twist is counted
    as relief on both sides, so that the patch is never cut short.
    """
    slope, level = jnp.sin(process.tilt), jnp.cos(process.tilt)
    twist = jnp.abs(curvature[0, 1])
    along = (curvature[0, 0] - twist) * level**2
    across = curvature[1, 1] - twist
    linear = radius * slope + across * radius**2
    square = 0.5 * radius**2 * (along - across)
    depth = jnp.maximum(process.displacement, 0.0)
    inside = linear**2 + 4 * square * depth
    root = jnp.sqrt(jnp.where(inside > 0, inside, 1.0))
    below = jnp.where(inside > 0, linear + root, 0.0)
    bounded = below > 2 * depth  # otherwise the rim touches a quarter turn or more
    rise = jnp.where(bounded, 2 * depth / jnp.where(bounded, below, 1.0), 1.0)
    return jnp.arccos(1 - jnp.clip(rise, _tiny(rise), 1.0))


def patch(
    process: Process,
    tool: Tool,
    curvature: Float[Array, "2 2"],
    lean: float = 1.0,
    rows: int = 6,
    columns: int = 4,
    panels: int = 1,
) -> Patch:
    r"""Contact patch of the tilted disc on a part of given local curvature.

    At the distance $x$ from the lowest rim point in the disc plane, and $\eta$ beside it,
    the depth is $w = e - x\sin\theta - \tfrac12 d^T \kappa\, d$ with
    $d = (\mp x\cos\theta, \eta)$, and the pressure $k(w_+ + \beta w_+^2)$. Each row of
    nodes covers just the part of the disc's chord where $w > 0$, by Gauss-Legendre
    quadrature, so the nodes move smoothly with the process.

    Args:
        process: Tilt and displacement are read.
        tool: Radius, foundation and stiffening are read.
        curvature: Normal curvature of the part in the frame (feed, left), positive where
            convex [1/mm].
        lean: +1 where the axis leans towards the feed (pulling), -1 away (pushing).
        rows: Rows on either side of the feed direction; the patch has twice as many.
        columns: Nodes along each row and panel.
        panels: 1 where the part is flat or convex; 2 on a concave part, where a row may
            touch near the rim and again beyond the disc's middle.

    Returns:
        The patch, with `2 * rows` rows and `panels * columns` columns. Without
        displacement all pressures are zero.

    Source: own derivation; flat case as `flat_force`.
    """
    half_angle = _rim_angle(process, tool.radius, curvature)
    nodes, weights = _gauss(rows, half_angle)
    angle, height = half_angle * nodes, half_angle * weights
    angle = jnp.concatenate([-angle[::-1], angle])
    height = jnp.concatenate([height[::-1], height])
    return _nodes(angle, height, process, tool, curvature, lean, columns, panels)


def _gauss(count: int, like: Array) -> tuple[Array, Array]:
    """Nodes and weights of Gauss and Legendre from 0 to 1, in the precision of `like`."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return jnp.asarray((nodes + 1.0) / 2, like.dtype), jnp.asarray(weights / 2, like.dtype)


def _nodes(
    angle: Float[Array, " rows"],
    height: Float[Array, " rows"],
    process: Process,
    tool: Tool,
    curvature: Float[Array, "2 2"],
    lean: float,
    columns: int,
    panels: int,
) -> Patch:
    """The patch by rows that leave the rim at some angles from the contact point.

    `height` is the angle that a row stands for; the rest is as in `patch`.
    """
    radius, slope, level = tool.radius, jnp.sin(process.tilt), jnp.cos(process.tilt)
    height = height * radius * jnp.cos(angle)
    eta = radius * jnp.sin(angle)

    # depth along a row: start - steep x - bend x^2 / 2
    start = process.displacement - 0.5 * curvature[1, 1] * eta**2
    steep = slope - lean * level * curvature[0, 1] * eta
    bend = level**2 * curvature[0, 0]
    near, far = radius * (1 - jnp.cos(angle)), radius * (1 + jnp.cos(angle))
    inside = steep**2 + 2 * bend * start
    real = inside > 0
    root = jnp.where(real, jnp.sqrt(jnp.where(real, inside, 1.0)), 0.0)
    below = steep + root
    concave = bend < 0
    turn = steep / jnp.where(concave, -bend, 1.0)  # where a concave row is shallowest
    falls = below > TINY
    first = jnp.where(falls, 2 * start / jnp.where(falls, below, 1.0), far)
    # no slope and no bend: the row touches as a whole or not at all
    level_row = jnp.where(start > 0, far, near)
    first = jnp.where(real, first, jnp.where(concave, turn, level_row))
    first = jnp.clip(first, near, far)
    ends = [(near, first)]
    if panels == 2:
        second = jnp.where(concave, below / jnp.where(concave, -bend, 1.0), far)
        ends.append((jnp.clip(second, first, far), far))

    nodes, weights = (w[None, :] for w in _gauss(columns, eta))
    x = jnp.concatenate([a[:, None] + (b - a)[:, None] * nodes for a, b in ends], axis=1)
    width = jnp.concatenate([(b - a)[:, None] * weights for a, b in ends], axis=1)
    depth = start[:, None] - steep[:, None] * x - 0.5 * bend * x**2
    across = jnp.broadcast_to(eta[:, None], x.shape)
    return Patch(
        offsets=jnp.stack([-lean * level * x, across], axis=-1),
        arms=jnp.stack([radius - x, across], axis=-1),
        pressure=bed_pressure(tool.foundation, tool.stiffening, depth),
        area=level * width * height[:, None],
    )


def force_and_area(
    process: Process,
    tool: Tool,
    curvature: Float[Array, "2 2"],
    lean: float = 1.0,
    panels: int = 1,
) -> tuple[Scalar, Scalar]:
    r"""Force [N] and area [mm^2] of the contact on a part of given local curvature.

    The integral of `patch`, with slopes that have no corners. A row of the patch either
    ends where the disc lifts off, or reaches across it; with rows at fixed places, the
    area has a corner whenever one of them goes over from one to the other. So the rows are
    laid on either side of the place where that happens: where the edge of the contact
    meets the far half of the rim, at the angle $\varphi$ from the contact point with
    $e = R\sin\theta\,c + \tfrac12\kappa_{\xi\xi}\cos^2\theta R^2 c^2
    + \tfrac12\kappa_{\eta\eta} R^2 \sin^2\varphi
    \mp \kappa_{\xi\eta}\cos\theta R^2 c\sin\varphi$, $c = 1 - \cos\varphi$.

    Args:
        process: As in `patch`.
        tool: As in `patch`.
        curvature: As in `patch`.
        lean: As in `patch`.
        panels: As in `patch`.

    Source: own derivation; on a plane `flat_force` and `flat_area`.
    """
    nodes, weights = (w[None, None, :] for w in _gauss(LOAD_ROWS, process.tilt))
    sides = jnp.asarray([-1.0, 1.0], process.tilt.dtype)
    edge = _edge_angle(process, tool.radius, curvature, lean * sides)
    lifts = jnp.minimum(edge, jnp.pi - edge)
    widest = jnp.minimum(edge, 0.5 * jnp.pi)
    begins = jnp.stack([jnp.zeros_like(edge), lifts])[..., None]
    widths = jnp.stack([lifts, widest - lifts])[..., None]
    angle = (sides[None, :, None] * (begins + widths * nodes)).reshape(-1)
    height = (widths * weights).reshape(-1)
    found = _nodes(angle, height, process, tool, curvature, lean, LOAD_COLUMNS, panels)
    return found.force, found.contact_area


def _edge_angle(process, radius, curvature, side) -> Float[Array, " sides"]:
    """Rim angles from the contact point at which the contact ends, on either side [rad].

    `side` is the sign of eta there, times the lean.

    Depth along the rim is zero at a root of a quartic in u = cot(angle / 2), which without
    twist is a quadratic in its square. From that root, or near the far end of the rim from
    a quadratic in u that has it too, Newton's method goes on to the twisted one.
    """
    slope, level = jnp.sin(process.tilt), jnp.cos(process.tilt)
    depth = jnp.maximum(process.displacement, 0.0)
    linear = radius * slope + curvature[1, 1] * radius**2
    square = 0.5 * radius**2 * (curvature[0, 0] * level**2 - curvature[1, 1])
    twist = 4 * side * level * curvature[0, 1] * radius**2
    # depth (u^2 + 1)^2 - 2 linear (u^2 + 1) - 4 square + twist u
    middle, farthest = 2 * (depth - linear), depth - 2 * linear - 4 * square

    inside = linear**2 + 4 * square * depth
    root = jnp.sqrt(jnp.where(inside > 0, inside, 1.0))
    below = jnp.where(inside > 0, linear + root, 0.0)
    ends = below > depth  # otherwise the whole rim would touch
    rise = jnp.where(ends, 2 * depth / jnp.where(ends, below, 1.0), 2.0)
    rise = jnp.clip(rise, _tiny(rise), 2 - _tiny(rise))
    u = jnp.sqrt((2 - rise) / rise)

    lead = jnp.where(farthest < 0, -farthest / u**2, middle)
    inside = twist**2 - 4 * lead * farthest
    some = (inside > 0) & (lead > 0) & ((farthest < 0) | (twist < 0))
    root = jnp.sqrt(jnp.where(some, inside, 1.0)) + jnp.abs(twist)
    twisted = jnp.where(
        twist > 0, -2 * farthest / root, root / jnp.where(some, 2 * lead, 1.0)
    )
    far = some & ((u < 1) | ~ends)
    u = jnp.where(far, twisted, u)
    for _ in range(NEWTON):
        left = (depth * u**2 + middle) * u**2 + twist * u + farthest
        rises = (4 * depth * u**2 + 2 * middle) * u + twist
        good = (ends | far) & (rises > 0)
        step = jnp.where(good, left / jnp.where(good, rises, 1.0), 0.0)
        u = jnp.maximum(u - step, 0.5 * u)
    return 2 * jnp.arctan2(jnp.ones_like(u), u)


def body_clearance(process: Process, tool: Tool) -> Scalar:
    r"""Displacement left before the rigid body touches the part [mm]; negative: it does.

    $e_{crit} - e$, $e_{crit} = h_b\cos\theta + (R - R_b)\sin\theta$: the disc comes
    unstuck when the stiff support behind it reaches the part, sooner at low tilt.

    Args:
        process: Tilt and displacement are read.
        tool: Radius, body radius and recess are read.

    Source: own derivation of the mechanism described in S0 (Pessoles & Tournier 2009)
    section 2.1.
    """
    lift = (tool.radius - tool.body_radius) * jnp.sin(process.tilt)
    return tool.body_recess * jnp.cos(process.tilt) + lift - process.displacement


def most_displacement(process: Process, tool: Tool) -> Scalar:
    r"""Largest displacement that rigid body and adhesive allow [mm].

    The body touches at $e_{crit}$, see `body_clearance`; the adhesive fails where
    $\mu k(e + \beta e^2) = \tau$, at $e = 2q/(1 + \sqrt{1 + 4\beta q})$ with
    $q = \tau/(\mu k)$. A bed that softens ($\beta < 0$) may never press so hard.

    Args:
        process: Tilt is read.
        tool: Radius, body radius and recess, friction, foundation, stiffening and shear
            strength are read.

    Source: own derivation.
    """
    touching = body_clearance(process, tool) + process.displacement
    rubs = jnp.isfinite(tool.shear_strength) & (tool.friction > 0)
    load = jnp.where(rubs, tool.friction * tool.foundation, 1.0)
    load = jnp.where(rubs, tool.shear_strength, 1.0) / load
    inside = 1 + 4 * tool.stiffening * load
    fails = rubs & (inside >= 0)
    failing = 2 * load / (1 + jnp.sqrt(jnp.where(fails, inside, 1.0)))
    return jnp.where(fails, jnp.minimum(touching, failing), touching)


def unstick_force(tilt: Scalar, tool: Tool) -> Scalar:
    """Force at which the disc comes unstuck at this tilt [N].

    Linear between the measured tilts; beyond them the nearest measurement holds.

    Args:
        tilt: Tilt [rad].
        tool: The table `unstick_tilts`, `unstick_forces` is read.
    """
    return jnp.interp(tilt, tool.unstick_tilts, tool.unstick_forces)


def shear_margin(process: Process, tool: Tool) -> Scalar:
    r"""Shear stress left before the adhesive fails [MPa]; infinite where not given.

    $\tau - \mu k(e + \beta e^2)$: friction under the deepest point.

    Args:
        process: Displacement is read.
        tool: Friction, foundation, stiffening and shear strength are read.

    Source: own derivation, Coulomb friction under a Winkler bed.
    """
    deepest = bed_pressure(tool.foundation, tool.stiffening, process.displacement)
    return tool.shear_strength - tool.friction * deepest
