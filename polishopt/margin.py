r"""Margin: how well the force that is left before the disc comes off is known.

To first order a margin $m$ scatters with $\sigma_m^2 = \sum_i (\partial m/\partial c_i)^2
\sigma_i^2$ where the constants $c_i$ have independent errors. The margin is linear in the
bed's stiffness and in the measured unstick forces: for normal errors of these it is normal,
and $\sigma_m$ exact.
"""

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .constants import part, with_constants
from .contact.flat import flat_force
from .contact.limits import shear_margin, unstick_force
from .contact.pressure import force_and_area
from .parts import Process, Scalar
from .setup import Setup


def deviation(slopes: Float[Array, "*n"], errors: Float[Array, "*n"]) -> Scalar:
    """Standard deviation of a sum of independent errors; 0, flat, where there is none.

    Args:
        slopes: Change of the sum per unit of each error.
        errors: Their standard deviations.
    """
    square = jnp.sum((slopes * errors) ** 2)
    some = square > 0
    return jnp.where(some, jnp.sqrt(jnp.where(some, square, 1.0)), 0.0)


def margin_deviations(
    process: Process,
    setup: Setup,
    curvatures: Float[Array, "k 2 2"],
    forces: Float[Array, " k"],
    displacements: Float[Array, " k"] | None = None,
) -> tuple[Scalar, Scalar]:
    """Standard deviations of the unstick margin [N] and of the shear margin [MPa].

    Path and feed do not depend on the tool's constants, so only the one contact that
    presses hardest is differentiated. Both are 0 where no constant of the tool has an
    error.

    Args:
        process: Tilt and displacement are read.
        setup: The job; tool and errors are read.
        curvatures: Of the part along the path, averaged over each loop [1/mm].
        forces: Force there [N].
        displacements: Displacement there, if it is not that of the process [mm].

    Source: first-order propagation of errors, by forward-mode differentiation.
    """
    errors = {name: e for name, e in setup.errors.items() if name.startswith("tool.")}
    if not errors:
        zero = jnp.zeros_like(process.tilt)
        return zero, zero
    most = jnp.argmax(forces)
    hardest = curvatures[most]
    deepest = process
    if displacements is not None:
        deepest = dataclasses.replace(process, displacement=jnp.max(displacements))
        process = dataclasses.replace(process, displacement=displacements[most])

    def margins(values):
        tool = with_constants(setup, dict(zip(errors, values, strict=True))).tool
        pressed = process.tilt, process.displacement
        if setup.level:
            force = flat_force(tool.radius, tool.foundation, *pressed, tool.stiffening)
        else:
            force, _ = force_and_area(process, tool, hardest, setup.side, setup.panels)
        unstick = unstick_force(process.tilt, tool) - force
        return jnp.stack([unstick, shear_margin(deepest, tool)])

    values = jnp.stack([part(setup, name) for name in errors])
    unstick, shear = jax.jacfwd(margins)(values)
    given = jnp.stack(list(errors.values()))
    return deviation(unstick, given), deviation(shear, given)
