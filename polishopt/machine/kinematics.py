r"""Kinematics: where the axes must stand for the tool to stand on the part as asked.

A machine is a chain of axes from the part to the tool, some of which carry the part and
some the tool (see `parts.Machine`). Walking along it gives the pose of the tool on the
part, its extremity (tip) and its axis, from axis positions.

The way back is in closed form. Of all axes only the two rotary ones turn, so with $e_1$
the one next to the part and $e_2$ the one next to the tool

$$v = W u = R(e_1, \varphi_1)\, R(e_2, \varphi_2)\, e_z, \qquad \varphi = \mp q,$$

minus for an axis under the part. $e_1 \cdot v$ does not know $\varphi_1$, which gives two
$\varphi_2$, and each of them one $\varphi_1$; then the linear axes solve three linear
equations. The axes need not be orthogonal: with a nutating one some orientations are out
of reach. Where $v$ lies along $e_1$ (the pole) any $\varphi_1$ will do. Travel and the
choice between solutions belong to `route`; collisions are not looked at.
"""

import dataclasses
import math
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..parts import Machine, Process, Scalar


Fixed = tuple[float, float, float]
# Coordinates; those that are known beforehand are plain numbers.
Triple = Sequence[Scalar | float]
# Coordinates, and as many derivatives of them by a path parameter as are asked for.
Motion = list[Triple]

UNITS: dict[str, Fixed] = {
    "X": (1.0, 0.0, 0.0),
    "Y": (0.0, 1.0, 0.0),
    "Z": (0.0, 0.0, 1.0),
}
SPINDLE = UNITS["Z"]


def placed(machine: Machine, process: Process) -> Machine:
    """The machine with the part where the process moves it on what carries it.

    Each shift adds to the offset along its direction, all axes at zero. Each wedge adds to
    the angle of the machine's own about the same direction, and the part is turned by the
    sums: about X, then Y, then Z, through its own origin, which a wedge does not move.

    Args:
        machine: The machine, as the part stands without these settings.
        process: Its shifts and wedges are read; None moves nothing.
    """
    sums = {}
    for name, word in (("offset", "shift"), ("wedge", "wedge")):
        more = [getattr(process, f"{word}_{way}") for way in "xyz"]
        if any(one is not None for one in more):
            own = getattr(machine, name)
            pairs = zip(own, more, strict=True)
            sums[name] = [a if b is None else b if a is None else a + b for a, b in pairs]
    return dataclasses.replace(machine, **sums) if sums else machine


def direction(machine: Machine, axis: int) -> Fixed:
    """Unit vector of an axis, by its number, in machine coordinates at zero [-]."""
    if machine.directions:
        given = np.asarray(machine.directions[axis], dtype=float)
        x, y, z = (float(c) for c in given / np.linalg.norm(given))
        return x, y, z
    return UNITS["XYZ"["XYZABC".index(machine.names[axis]) % 3]]


def sides(machine: Machine) -> tuple[list[int], list[int]]:
    """Numbers of the axes under the part and over the tool, those next to the bed last."""
    table, _, head = machine.chain.partition(" b ")
    number = machine.names.index
    return (
        [number(name) for name in table.split()[1:]],
        [number(name) for name in reversed(head.split()[:-1])],
    )


def rotary_order(machine: Machine) -> tuple[int, int]:
    """Numbers of the rotary axis next to the part and of the one next to the tool."""
    table, head = sides(machine)
    first, second = (axis for axis in (*table, *reversed(head)) if axis > 2)
    return first, second


def forward(
    axes: Float[Array, "5"], machine: Machine
) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    r"""Tip and axis of the tool on the part, for given axis positions.

    Args:
        axes: Positions of the linear [mm] and rotary axes [rad], as `machine.names`.
        machine: The machine.

    Returns:
        Tool tip [mm] and unit tool axis [-], in the part frame.

    Source: Own derivation.
    """
    table, head = sides(machine)
    one = jnp.ones_like(axes[0])
    tip: Triple = [jnp.zeros_like(one)] * 3
    way: Triple = [c * one for c in SPINDLE]
    for axis in head:
        along = direction(machine, axis)
        if axis > 2:
            tip = _about(machine, axis, axes[axis], tip)
            way = _turned(along, axes[axis], way)
        else:
            tip = _add(tip, [c * axes[axis] for c in along])
    for axis in reversed(table):
        along = direction(machine, axis)
        if axis > 2:
            tip = _about(machine, axis, -axes[axis], tip)
            way = _turned(along, -axes[axis], way)
        else:
            tip = _add(tip, [c * axes[axis] for c in along])
    tip = _add(tip, _origin(machine), -1.0)
    for about, angle in reversed(_wedge(machine)):
        tip, way = _turned(about, -angle, tip), _turned(about, -angle, way)
    return jnp.stack(tip), jnp.stack(way)


def inverse(
    tip: Float[Array, "3"],
    axis: Float[Array, "3"],
    machine: Machine,
    near: Float[Array, "5"] | None = None,
    branch: int | None = None,
) -> Float[Array, "5"]:
    r"""Axis positions that bring the tool onto a pose of the part [mm, rad].

    At the pole any angle of the rotary axis next to the part will do: it is that of
    `near`, or 0, and both rotary axes have zero gradient there. Near the pole the gradient
    grows as one over the distance from it: that is the machine, not the formula. An
    orientation out of reach (see `reach`) gives the nearest one.

    Args:
        tip: Tool tip on the part [mm].
        axis: Unit tool axis on the part, from the tip into the spindle [-].
        machine: The machine.
        near: Axis positions the machine comes from: rotary axes then stand at the equal
            angle nearest to theirs. Without it, at the one nearest to the middle of their
            travel, or to zero where that is unlimited.
        branch: 0 for the larger angle of the rotary axis next to the tool, 1 for the
            smaller one; the machine's own if not given.

    Returns:
        Positions of the linear and rotary axes, as `machine.names`.

    Source: Own derivation.
    """
    order = rotary_order(machine)
    turned, pole = rotary(axis, machine, branch)
    middle = _middle(machine) if near is None else jax.lax.stop_gradient(near)
    angles = []
    for number, angle, at in zip(order, turned, (pole, False), strict=True):
        held = 0.0 * angle if near is None else near[number]
        angle = jnp.where(at, held, angle)
        angles.append(angle - 2.0 * jnp.pi * turns(angle - middle[number]))
    return positions(tip, (angles[0], angles[1]), machine)


def inverse_path(
    tips: Float[Array, "n 3"],
    axes: Float[Array, "n 3"],
    machine: Machine,
    branch: int | None = None,
) -> Float[Array, "n 5"]:
    """Axis positions along a path, with rotary axes continuous [mm, rad].

    As `inverse`, but rotary axes never jump by whole turns from one sample to the next,
    and hold their last angle on samples at the pole (a path that begins there waits at the
    first angle it will need). A path that crosses the pole still turns the axis next to
    the part by up to half a turn between two samples, because the branch is kept: `route`
    chooses it.

    Args:
        tips: Tool tips on the part [mm].
        axes: Unit tool axes on the part [-].
        machine: The machine.
        branch: As in `inverse`.

    Returns:
        One row of positions a sample, as `machine.names`.

    Source: Own derivation.
    """
    (first, second), pole = jax.vmap(lambda axis: rotary(axis, machine, branch))(axes)
    order, middle = rotary_order(machine), _middle(machine)
    angles = [
        unwound(angle, middle[number])
        for angle, number in zip((first[held(pole)], second), order, strict=True)
    ]
    return jax.vmap(lambda tip, a, b: positions(tip, (a, b), machine))(tips, *angles)


def rotary(
    axis: Float[Array, "3"], machine: Machine, branch: int | None = None
) -> tuple[tuple[Scalar, Scalar], Bool[Array, ""]]:
    r"""Angles of both rotary axes, next to the part first, and whether at the pole [rad].

    With $c = e_1 \cdot e_2$, $p = e_2 \cdot e_z$, $k = e_1 \cdot v$, and $\gamma$ the root
    of their Gram determinant $1 - c^2 - p^2 - k^2 + 2 c p k$, the two solutions are
    $\varphi_2 = \delta \pm \mathrm{atan2}(\gamma, k - c p)$, where
    $\delta = \mathrm{atan2}(e_1 \cdot e_2 \times e_z,\ e_1 \cdot e_z - c p)$.

    Args:
        axis: Unit tool axis on the part [-].
        machine: The machine.
        branch: As in `inverse`.

    Source: Own derivation; the second of Paden's subproblems.
    """
    branch = machine.branch if branch is None else branch
    (one, two), signs = _pair(machine)
    c, p = _constants(one, two)
    v = _seated(axis, machine)
    k, square, gram = _gram(v, one, c, p)
    pole = square <= jnp.finfo(square.dtype).tiny
    # double where: neither the root nor an angle sees the corner, even when differentiated
    edge = pole | (gram <= 0.0)
    root = jnp.where(edge, 0.0, jnp.sqrt(jnp.where(edge, 1.0, gram)))
    spread = _angle(root, k - c * p)
    delta = float(np.arctan2(np.dot(one, np.cross(two, SPINDLE)), one[2] - c * p))
    # the larger position of the second axis is the larger or the smaller angle
    upper = (signs[1] > 0) == (branch == 0)
    second = delta + spread if upper else delta - spread
    # how far the first axis turns e_z, as the second has leant it, onto v: their angles
    # about e_1, from the part of e_2 across it
    at = [
        _dot(way, v) for way in (np.subtract(two, np.multiply(c, one)), np.cross(one, two))
    ]
    found = _angle(jnp.where(pole, 0.0, at[1]), jnp.where(pole, 1.0, at[0]))
    if c == 0.0 == p:
        leant = -np.pi / 2 if upper else np.pi / 2
    else:
        side = jnp.where(pole, 0.0, -root if upper else root)
        leant = _angle(side, jnp.where(pole, 1.0, p - c * k))
    first = signs[0] * jnp.where(pole, 0.0, found - leant)
    return (first, signs[1] * second), pole


def reach(axis: Float[Array, "3"], machine: Machine) -> Scalar:
    r"""How far an orientation is within reach of the rotary axes, negative if out of it.

    The Gram determinant of `rotary`: the square of the pole's distance where the rotary
    axes are orthogonal to each other and the second one to the spindle [-].
    """
    one, two = _pair(machine)[0]
    return _gram(_seated(axis, machine), one, *_constants(one, two))[2]


def pole_distance(axis: Float[Array, "3"], machine: Machine) -> Scalar:
    """Sine of the angle between a tool axis and the pole; not for differentiation [-]."""
    across = beside_pole(jax.lax.stop_gradient(axis), machine)
    return jnp.sqrt(jnp.sum(across**2))


def beside_pole(axis: Float[Array, "3"], machine: Machine) -> Float[Array, "3"]:
    """Tool axis across the rotary axis next to the part, a quarter turn on [-].

    Zero at the pole, and linear in the axis: of a derivative it is the derivative.
    """
    (one, _), _ = _pair(machine)
    return jnp.stack(_cross(one, _seated(axis, machine)))


def positions(
    tip: Float[Array, "3"], angles: tuple[Scalar, Scalar], machine: Machine
) -> Float[Array, "5"]:
    """All five axes, once the rotary ones are chosen (next to the part first)."""
    return motion([tip], [angles], machine)[0]


def motion(
    tips: Sequence[Float[Array, "3"]],
    angles: Sequence[tuple[Scalar, Scalar]],
    machine: Machine,
) -> list[Float[Array, "5"]]:
    r"""All five axes, and their derivatives by a path parameter, as many as are given.

    A rotary axis takes x to $R y$ with $y = x$. What it carries moves as in a turning
    frame, with the first and second derivatives $\omega$ and $\alpha$ of its angle:
    $(R y)' = R\,(x' + \omega\, e \times x) = R y_1$ and
    $(R y)'' = R\,(x'' + \omega\, e \times (x' + y_1) + \alpha\, e \times x)$.

    Args:
        tips: Tool tip on the part [mm], and if asked for its first, and second derivative.
        angles: Angles of the rotary axes, next to the part first [rad], and the same.
        machine: The machine.

    Source: Own derivation; the terms are those of Coriolis, Euler, and the centripetal one.
    """
    table, head = sides(machine)
    numbers = rotary_order(machine)
    turned = dict(zip(numbers, zip(*angles, strict=True), strict=True))
    at: Motion = [_seated(tip, machine) for tip in tips]
    at[0] = _add(at[0], _origin(machine))
    ways: dict[int, Motion] = {}
    for axis in table:
        at, ways = _carried(machine, axis, turned, at, ways)
    tip_at: Motion = [[0.0] * 3 for _ in tips]
    over: dict[int, Motion] = {}
    for axis in head:
        tip_at, over = _carried(machine, axis, turned, tip_at, over)
    ways = ways | over
    gaps = [_add(a, b, -1.0) for a, b in zip(at, tip_at, strict=True)]
    linear = _solve([ways[i] for i in range(3)], gaps)
    first, second = sorted(turned)
    return [
        jnp.stack([*x, turned[first][k], turned[second][k]]) for k, x in enumerate(linear)
    ]


def turns(angle: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Whole turns in an angle, a constant as far as gradients are concerned."""
    return jax.lax.stop_gradient(jnp.round(angle / (2.0 * jnp.pi)))


def unwound(angle: Float[Array, " n"], middle: Scalar) -> Float[Array, " n"]:
    """Equal angles without jumps by whole turns, the first one nearest to `middle`."""
    whole = jnp.cumsum(turns(jnp.diff(angle)))
    start = turns(angle[0] - middle)
    return angle - 2.0 * jnp.pi * (start + jnp.pad(whole, (1, 0)))


def held(pole: Bool[Array, " n"]) -> Int[Array, " n"]:
    """For every sample, the last one not at the pole (or, before any, the first one)."""
    index = jnp.arange(pole.size)
    last = jax.lax.cummax(jnp.where(pole, -1, index))
    return jnp.where(last < 0, jnp.argmin(pole), last)


@jax.custom_jvp
def _angle(y: Scalar, x: Scalar) -> Scalar:
    """Angle of (x, y), with a derivative that is cheaper to differentiate again [rad]."""
    return jnp.arctan2(y, x)


@_angle.defjvp
def _angle_jvp(primals, tangents):
    (y, x), (dy, dx) = primals, tangents
    return _angle(y, x), (x * dy - y * dx) / (x * x + y * y)


def _pair(machine: Machine) -> tuple[tuple[Fixed, Fixed], tuple[float, float]]:
    """Directions of both rotary axes, next to the part first, and signs of their angles."""
    table, _ = sides(machine)
    one, two = rotary_order(machine)
    signs = [-1.0 if axis in table else 1.0 for axis in (one, two)]
    return (direction(machine, one), direction(machine, two)), (signs[0], signs[1])


def _constants(one: Fixed, two: Fixed) -> tuple[float, float]:
    """Cosines between both rotary axes, and between the second one and the spindle."""
    return float(np.dot(one, two)), two[2]


def _gram(v: Triple, one: Fixed, c: float, p: float) -> tuple[Scalar, Scalar, Scalar]:
    """Of `rotary`: k, the square of the sine to it, and the Gram determinant."""
    k = jnp.asarray(_dot(one, v))
    across = _cross(one, v)
    square = jnp.asarray(sum(c**2 for c in across))
    if c == 0.0 == p:
        return k, square, square
    # c - k p, without a difference of nearly equal numbers at the pole
    up = (c - p) + p * square / (1.0 + jnp.abs(k))
    down = (c + p) - p * square / (1.0 + jnp.abs(k))
    return k, square, square * (1.0 - p**2) - jnp.where(k < 0.0, down, up) ** 2


def _wedge(machine: Machine) -> list[tuple[Fixed, Scalar]]:
    """The turns of the part on what carries it, in their order, without those of none."""
    turns = zip(UNITS.values(), machine.wedge, strict=True)
    return [(about, angle) for about, angle in turns if angle is not None]


def _seated(vector: Float[Array, "3"], machine: Machine) -> Triple:
    """A vector of the part as the wedge under it turns it."""
    way: Triple = list(vector)
    for about, angle in _wedge(machine):
        way = _turned(about, angle, way)
    return way


def _middle(machine: Machine) -> Float[Array, "5"]:
    """Middle of each travel, zero where it is unlimited."""
    limited = jnp.isfinite(machine.lower) & jnp.isfinite(machine.upper)
    ends = [jnp.where(limited, end, 0.0) for end in (machine.lower, machine.upper)]
    return jax.lax.stop_gradient(0.5 * (ends[0] + ends[1]))


def _origin(machine: Machine) -> Triple:
    """Origin of the part in machine coordinates, all axes at zero."""
    table = [axis for axis in sides(machine)[0] if axis > 2]
    return list(machine.offset + machine.pivots[table[0] - 3] if table else machine.offset)


def _carried(
    machine: Machine, axis: int, turned: dict, at: Motion, ways: dict[int, Motion]
) -> tuple[Motion, dict[int, Motion]]:
    """What an axis carries, moved on by it: a place, and directions of linear axes.

    A linear axis only adds its direction: how far it moves is still unknown.
    """
    along = direction(machine, axis)
    if axis < 3:
        return at, ways | {axis: [along, *([0.0] * 3 for _ in at[1:])]}
    ways = {k: _swung(along, turned[axis], way) for k, way in ways.items()}
    pivot = list(machine.pivots[axis - 3])
    at = _swung(along, turned[axis], [_add(at[0], pivot, -1.0), *at[1:]])
    return [_add(at[0], pivot), *at[1:]], ways


def _swung(about: Fixed, angle: Sequence[Scalar], x: Motion) -> Motion:
    """What moves, as seen from where a turning axis carries it; see `motion`."""
    y = list(x)
    if len(x) > 1:
        y[1] = _whirled(about, angle[1], x[0], x[1])
    if len(x) > 2:
        y[2] = _whirled(about, angle[1], _add(x[1], y[1]), x[2])
        y[2] = _whirled(about, angle[2], x[0], y[2])
    return _turned_all(about, angle[0], y)


def _whirled(about: Fixed, rate: Scalar, v: Triple, to: Triple) -> Triple:
    """A rate times the vector product with a fixed direction, added to something."""
    return [
        b if isinstance(a, float) and a == 0.0 else b + rate * a
        for a, b in zip(_cross(about, v), to, strict=True)
    ]


def _solve(ways: Sequence[Motion], right: Motion) -> Motion:
    """The x with the sum of x_i ways_i = right."""
    if all(isinstance(c, float) for way in ways for order in way for c in order):
        inverse = np.linalg.inv(np.asarray([way[0] for way in ways], dtype=float).T)
        return [[_dot(row, r) for row in inverse] for r in right]
    columns = [[[jnp.asarray(c) for c in v] for v in way] for way in ways]
    one, two, three = (way[0] for way in columns)
    over = [_crossed(two, three), _crossed(three, one), _crossed(one, two)]
    volume = _scalar(one, over[0])
    found: Motion = []
    # by the product rule, what the ways' own derivatives leave to the next x
    for order, rest in enumerate(right):
        for k, x in enumerate(found):
            times = math.comb(order, k)
            for way, along in zip(columns, x, strict=True):
                rest = _add(rest, [times * along * c for c in way[order - k]], -1.0)
        found.append([_scalar(row, rest) / volume for row in over])
    return found


def _about(machine: Machine, axis: int, angle: Scalar, at: Triple) -> Triple:
    """A place turned about a rotary axis."""
    pivot = list(machine.pivots[axis - 3])
    return _add(_turned(direction(machine, axis), angle, _add(at, pivot, -1.0)), pivot)


def _turned(about: Fixed, angle: Scalar, v: Triple) -> Triple:
    """A vector turned about a fixed direction."""
    return _turned_all(about, angle, [v])[0]


def _turned_all(about: Fixed, angle: Scalar, vectors: Sequence[Triple]) -> list[Triple]:
    """Vectors turned about a fixed direction."""
    c, s = jnp.cos(angle), jnp.sin(angle)
    on = [i for i in range(3) if about[i] != 0.0]
    out = []
    for v in vectors:
        if len(on) == 1:  # written out: far less to differentiate
            i, j, k = on[0], (on[0] + 1) % 3, (on[0] + 2) % 3
            way = s if about[i] > 0.0 else -s
            w = list(v)
            if not all(isinstance(x, float) and x == 0.0 for x in (v[j], v[k])):
                w[j], w[k] = c * v[j] - way * v[k], way * v[j] + c * v[k]
        else:
            along, aside = _dot(about, v), _cross(about, v)
            w = [c * v[i] + s * aside[i] + (1.0 - c) * along * about[i] for i in range(3)]
        out.append(w)
    return out


def _add(a: Triple, b, sign: float = 1.0) -> Triple:
    """Sum, or difference."""
    return [x + y if sign > 0.0 else x - y for x, y in zip(a, b, strict=True)]


def _dot(fixed, v: Triple) -> Scalar | float:
    """Product with a fixed vector, without its zeros."""
    total = None
    for f, x in zip(fixed, v, strict=True):
        if f != 0.0:
            term = x if f == 1.0 else float(f) * x
            total = term if total is None else total + term
    return 0.0 if total is None else total


def _cross(fixed: Fixed, v: Triple) -> Triple:
    """Vector product of a fixed vector and another one."""
    x, y, z = fixed
    return [_dot(row, v) for row in ((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0))]


def _crossed(a: Triple, b: Triple) -> Triple:
    """Vector product."""
    return [a[i - 2] * b[i - 1] - a[i - 1] * b[i - 2] for i in range(3)]


def _scalar(a: Triple, b: Triple) -> Scalar:
    """Scalar product."""
    return jnp.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])
