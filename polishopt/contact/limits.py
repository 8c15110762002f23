r"""Limits: how far and how hard the disc may be pressed before something of it fails.

The stiff body behind the disc may touch the part, the disc may come unstuck from it, and
the adhesive may shear.
"""

import jax.numpy as jnp

from ..parts import Process, Scalar, Tool
from .pressure import bed_pressure


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
