r"""Kinematics: where the axes must stand for the tool to stand on the part as asked.

The machine is a table-table one: A tilts about X and carries C, which turns about Z and
carries the part; the spindle stays along machine Z. A pose of the tool on the part is
its extremity (tip) and its axis, both in the part frame; the axis positions are
$(X, Y, Z, A, C)$, where $X, Y, Z$ are the machine coordinates of the tip. Every position
of the tool axis has two solutions, and the one along the C axis (the pole) has infinitely
many. Travel limits and collisions are not looked at.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..parts import Machine, Scalar


def about_x(angle: Scalar) -> Float[Array, "3 3"]:
    """Rotation by `angle` [rad] about X, as a matrix."""
    c, s = jnp.cos(angle), jnp.sin(angle)
    one, zero = jnp.ones_like(c), jnp.zeros_like(c)
    return jnp.array([[one, zero, zero], [zero, c, -s], [zero, s, c]])


def about_z(angle: Scalar) -> Float[Array, "3 3"]:
    """Rotation by `angle` [rad] about Z, as a matrix."""
    c, s = jnp.cos(angle), jnp.sin(angle)
    one, zero = jnp.ones_like(c), jnp.zeros_like(c)
    return jnp.array([[c, -s, zero], [s, c, zero], [zero, zero, one]])


def forward(
    axes: Float[Array, "5"], machine: Machine
) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    r"""Tip and axis of the tool on the part, for given axis positions.

    $P = R_z(-C)\,[R_x(-A)(X - T_A) - T_C]$ and $u = R_z(-C) R_x(-A) e_z$.

    Args:
        axes: Axis positions $X, Y, Z$ [mm], $A, C$ [rad].
        machine: The machine, for its pivots.

    Returns:
        Tool tip [mm] and unit tool axis [-], in the part frame.

    Source: Own derivation.
    """
    tilt, turn = about_x(-axes[3]), about_z(-axes[4])
    tip = turn @ (tilt @ (axes[:3] - machine.tilt_pivot) - machine.turn_pivot)
    return tip, turn @ tilt[:, 2]


def inverse(
    tip: Float[Array, "3"],
    axis: Float[Array, "3"],
    machine: Machine,
    near: Float[Array, "5"] | None = None,
    branch: int = 0,
) -> Float[Array, "5"]:
    r"""Axis positions that bring the tool onto a pose of the part [mm, rad].

    $C = \mathrm{atan2}(i, j)$, $A = \mathrm{atan2}(\sqrt{i^2 + j^2}, k)$ and
    $X = T_A + R_x(A)[T_C + R_z(C) P]$. At the pole ($i = j = 0$) any C will do: it is that
    of `near`, or 0, and $A$ and $C$ have zero gradient there. Near the pole the gradient
    of $C$ grows as $1/\sin A$: that is the machine, not the formula.

    Args:
        tip: Tool tip on the part, $P$ [mm].
        axis: Unit tool axis on the part, from the tip into the spindle, $(i, j, k)$ [-].
        machine: The machine, for its pivots.
        near: Axis positions the machine comes from: C is then the equal angle nearest to
            theirs, so that it does not unwind by whole turns.
        branch: 0 for $A \ge 0$; 1 for the other solution, $(-A, C + \pi)$.

    Returns:
        $X, Y, Z$ [mm], $A, C$ [rad].

    Source: Own derivation.
    """
    tilt, turn, pole = _rotary(axis, branch)
    if near is not None:
        turn = jnp.where(pole, near[4], turn)
        turn = turn - 2.0 * jnp.pi * _turns(turn - near[4])
    return _axes(tip, tilt, turn, machine)


def inverse_path(
    tips: Float[Array, "n 3"],
    axes: Float[Array, "n 3"],
    machine: Machine,
    branch: int = 0,
) -> Float[Array, "n 5"]:
    """Axis positions along a path, with C continuous [mm, rad].

    As `inverse`, but C never jumps by whole turns from one sample to the next, and holds
    its last angle on samples at the pole (a path that begins there waits at the first
    angle it will need). A path that crosses the pole still turns C by up to half a turn
    between two samples, because `branch` is kept.

    Args:
        tips: Tool tips on the part [mm].
        axes: Unit tool axes on the part [-].
        machine: The machine, for its pivots.
        branch: 0 for A >= 0, 1 for A <= 0.

    Returns:
        One row of X, Y, Z [mm], A, C [rad] a sample.

    Source: Own derivation.
    """
    tilt, turn, pole = jax.vmap(lambda axis: _rotary(axis, branch))(axes)
    turn = turn[_held(pole)]
    whole = jnp.cumsum(_turns(jnp.diff(turn)))
    turn = turn - 2.0 * jnp.pi * jnp.pad(whole, (1, 0))
    return jax.vmap(lambda tip, a, c: _axes(tip, a, c, machine))(tips, tilt, turn)


def _rotary(axis: Float[Array, "3"], branch: int) -> tuple[Scalar, Scalar, Bool[Array, ""]]:
    """A and C for a tool axis, and whether it lies at the pole (where C is 0)."""
    i, j, k = axis
    square = i * i + j * j
    pole = square <= jnp.finfo(square.dtype).tiny
    # double where: neither the root nor atan2 sees the corner, even when differentiated
    sine = jnp.where(pole, 0.0, jnp.sqrt(jnp.where(pole, 1.0, square)))
    tilt = jnp.where(pole, jnp.where(k < 0.0, jnp.pi, 0.0), jnp.arctan2(sine, k))
    turn = jnp.arctan2(jnp.where(pole, 0.0, i), jnp.where(pole, 1.0, j))
    return (-tilt, turn + jnp.pi, pole) if branch else (tilt, turn, pole)


def _axes(
    tip: Float[Array, "3"], tilt: Scalar, turn: Scalar, machine: Machine
) -> Float[Array, "5"]:
    """All five axes, once the rotary ones are chosen."""
    # the products with `about_z` and `about_x`, written out: far less to differentiate
    x, y = _rotated(turn, tip[0], tip[1])
    x, y, z = jnp.stack([x, y, tip[2]]) + machine.turn_pivot
    y, z = _rotated(tilt, y, z)
    linear = jnp.stack([x, y, z]) + machine.tilt_pivot
    return jnp.concatenate([linear, jnp.stack([tilt, turn])])


def _rotated(angle: Scalar, first: Scalar, second: Scalar) -> tuple[Scalar, Scalar]:
    """Two coordinates, turned from the first axis towards the second."""
    c, s = jnp.cos(angle), jnp.sin(angle)
    return c * first - s * second, s * first + c * second


def _turns(angle: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Whole turns in an angle, a constant as far as gradients are concerned."""
    return jax.lax.stop_gradient(jnp.round(angle / (2.0 * jnp.pi)))


def _held(pole: Bool[Array, " n"]) -> Int[Array, " n"]:
    """For every sample, the last one not at the pole (or, before any, the first one)."""
    index = jnp.arange(pole.size)
    last = jax.lax.cummax(jnp.where(pole, -1, index))
    return jnp.where(last < 0, jnp.argmin(pole), last)
