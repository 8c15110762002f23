r"""Pressure: where the tilted disc touches the part, and how hard it presses.

The elastomer behind the disc is taken as a bed of independent springs (Winkler): each
point presses with k times the depth it would otherwise sink in, or a little more than in
proportion where the bed stiffens. On a curved part the gap gains the local curvature, and
what the disc does is a quadrature over the contact patch; for planes see `flat`. The tool
frame has its origin at the contact point, which is the lowest point of the rim: xi runs
along the feed direction, eta to its left.

Ignored: shear between neighbouring springs, and the time the elastomer takes to relax.
"""

from collections.abc import Callable, Sequence

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


def tiny(x: Scalar) -> float:
    """`TINY` in the precision of a number."""
    # in single precision 1 - TINY is 1, and arccos has no slope there
    return max(TINY, float(jnp.finfo(x.dtype).eps))


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
    return jnp.arccos(1 - jnp.clip(rise, tiny(rise), 1.0))


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

    Source: own derivation; flat case as `flat.flat_load`.
    """
    angle, height = rows_within(_rim_angle(process, tool.radius, curvature), rows)
    return _nodes(angle, height, process, tool, curvature, lean, columns, panels)


def rows_within(
    half_angle: Scalar, rows: int
) -> tuple[Float[Array, " rows"], Float[Array, " rows"]]:
    """Rim angles at which the rows of a patch begin, and what each stands for [rad].

    Args:
        half_angle: Rim angle from the contact point beyond which nothing touches [rad].
        rows: Rows on either side; there are twice as many.
    """
    nodes, weights = _gauss(rows, half_angle)
    angle, height = half_angle * nodes, half_angle * weights
    angle = jnp.concatenate([-angle[::-1], angle])
    return angle, jnp.concatenate([height[::-1], height])


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

    def depth(x):
        return start[:, None] - steep[:, None] * x - 0.5 * bend * x**2

    return columns_between(ends, eta, height, depth, process, tool, lean, columns)


def columns_between(
    ends: Sequence[tuple[Float[Array, " rows"], Float[Array, " rows"]]],
    eta: Float[Array, " rows"],
    height: Float[Array, " rows"],
    depth: Callable[[Float[Array, "rows n"]], Float[Array, "rows n"]],
    process: Process,
    tool: Tool,
    lean: float,
    columns: int,
) -> Patch:
    """The patch whose rows touch between given distances in the disc plane.

    Args:
        ends: From where to where each row touches, in one panel or several [mm].
        eta: Where the rows lie [mm].
        height: How much of eta each stands for [mm].
        depth: How deep the disc is pressed in, of the distance along each row [mm].
        process: Tilt is read.
        tool: Radius, foundation and stiffening are read.
        lean: As in `patch`.
        columns: Nodes in each panel of a row.
    """
    radius, level = tool.radius, jnp.cos(process.tilt)
    nodes, weights = (w[None, :] for w in _gauss(columns, eta))
    x = jnp.concatenate([a[:, None] + (b - a)[:, None] * nodes for a, b in ends], axis=1)
    width = jnp.concatenate([(b - a)[:, None] * weights for a, b in ends], axis=1)
    across = jnp.broadcast_to(eta[:, None], x.shape)
    return Patch(
        offsets=jnp.stack([-lean * level * x, across], axis=-1),
        arms=jnp.stack([radius - x, across], axis=-1),
        pressure=bed_pressure(tool.foundation, tool.stiffening, depth(x)),
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

    Source: own derivation; on a plane `flat.flat_load`.
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
    rise = jnp.clip(rise, tiny(rise), 2 - tiny(rise))
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
