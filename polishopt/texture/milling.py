"""Milling: the surface a filleted end mill leaves, where polishing starts.

The tool is a torus: its outer radius R and corner radius r leave a tube of radius r
around a circle of radius R_c = R - r. It touches the part at one point, tilted by theta_t
in the plane of the tool axis and the normal, and that plane is turned by theta_n (yaw)
from the feed. Near the contact the tool is a paraboloid, so each pass leaves a parabolic
groove across the feed and each tooth a parabolic cup along it: two crossed families of
cusps. Runout, deflection and the tooth's own path are left out.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..parts import Scalar, as_scalar
from .areal import Cumulants


class MilledSurface(eqx.Module):
    """A plane milled with a tilted filleted end mill."""

    outer_radius: Scalar = eqx.field(converter=as_scalar)
    """Outer radius of the mill, R [mm]."""
    corner_radius: Scalar = eqx.field(converter=as_scalar)
    """Radius of its rounded corner, r [mm]; equal to R for a ball-end mill."""
    tilt: Scalar = eqx.field(converter=as_scalar)
    """Angle between tool axis and surface normal, theta_t [rad]."""
    yaw: Scalar = eqx.field(converter=as_scalar)
    """Angle between the tilt plane and the feed, about the normal, theta_n [rad]."""
    step: Scalar = eqx.field(converter=as_scalar)
    """Distance between neighbouring passes, p [mm]."""
    feed_per_tooth: Scalar = eqx.field(converter=as_scalar)
    """Advance per tooth, f_z [mm]."""


def _principal(
    outer_radius: Scalar, corner_radius: Scalar, tilt: Scalar
) -> tuple[Scalar, Scalar]:
    """Curvatures of the torus at the contact, in the tilt plane and across it [1/mm]."""
    major = outer_radius - corner_radius
    ring = major + corner_radius * jnp.sin(tilt)
    ball = ring > 0
    # an untilted ball-end mill is the limit of a tilted one
    across = jnp.where(
        ball, jnp.sin(tilt) / jnp.where(ball, ring, 1.0), 1.0 / corner_radius
    )
    return 1.0 / corner_radius, across


def equivalent_radius(
    outer_radius: Scalar, corner_radius: Scalar, tilt: Scalar, yaw: Scalar
) -> Scalar:
    r"""Radius of the tool's normal section across the feed [mm].

    $R_{eq} = r\rho/(r\sin\theta_t\cos^2\theta_n + \rho\sin^2\theta_n)$ with
    $\rho = R_c + r\sin\theta_t$ and $R_c = R - r$ (Euler). As printed, the denominator
    has R_c in place of r and a second cosine in place of the sine. Infinite for an
    untilted flat-bottomed tool without yaw.

    Args:
        outer_radius: Outer radius of the mill, $R$ [mm].
        corner_radius: Corner radius, $r$ [mm].
        tilt: Tilt of the tool, $\theta_t$ [rad].
        yaw: Turn of the tilt plane from the feed, $\theta_n$ [rad].

    Source: S2 eq. (8), corrected.
    """
    along, across = _principal(outer_radius, corner_radius, tilt)
    return 1.0 / (across * jnp.cos(yaw) ** 2 + along * jnp.sin(yaw) ** 2)


def feed_curvature(
    outer_radius: Scalar, corner_radius: Scalar, tilt: Scalar, yaw: Scalar
) -> Scalar:
    r"""Curvature of the tool's normal section along the feed [1/mm].

    $1/R_f = \cos^2\theta_n/r + \sin^2\theta_n\sin\theta_t/\rho$ (Euler).

    Args:
        outer_radius: Outer radius of the mill, $R$ [mm].
        corner_radius: Corner radius, $r$ [mm].
        tilt: Tilt of the tool, $\theta_t$ [rad].
        yaw: Turn of the tilt plane from the feed, $\theta_n$ [rad].

    Source: Own derivation.
    """
    along, across = _principal(outer_radius, corner_radius, tilt)
    return along * jnp.cos(yaw) ** 2 + across * jnp.sin(yaw) ** 2


def envelope_curvature(
    outer_radius: Scalar, corner_radius: Scalar, tilt: Scalar, yaw: Scalar
) -> Scalar:
    r"""Curvature, across the feed, of the groove that one pass leaves [1/mm].

    $\kappa_{app} = \kappa_1\kappa_2/\kappa_f$: a swept tool leaves the profile of its
    silhouette along the feed, which is wider than its normal section as soon as it yaws.
    Zero for an untilted flat-bottomed tool.

    Args:
        outer_radius: Outer radius of the mill, $R$ [mm].
        corner_radius: Corner radius, $r$ [mm].
        tilt: Tilt of the tool, $\theta_t$ [rad].
        yaw: Turn of the tilt plane from the feed, $\theta_n$ [rad].

    Source: Own derivation.
    """
    along, across = _principal(outer_radius, corner_radius, tilt)
    feed = feed_curvature(outer_radius, corner_radius, tilt, yaw)
    cuts = feed > 0
    return jnp.where(cuts, along * across / jnp.where(cuts, feed, 1.0), along)


def envelope_radius(
    outer_radius: Scalar, corner_radius: Scalar, tilt: Scalar, yaw: Scalar
) -> Scalar:
    r"""Radius, across the feed, of the groove that one pass leaves [mm].

    $R_{app} = R_c\cos^2\theta_n/\sin\theta_t + r$. Infinite for an untilted flat-bottomed
    tool: `envelope_curvature` is finite there.

    Args:
        outer_radius: Outer radius of the mill, $R$ [mm].
        corner_radius: Corner radius, $r$ [mm].
        tilt: Tilt of the tool, $\theta_t$ [rad].
        yaw: Turn of the tilt plane from the feed, $\theta_n$ [rad].

    Source: Own derivation.
    """
    return 1.0 / envelope_curvature(outer_radius, corner_radius, tilt, yaw)


def feed_radius(
    outer_radius: Scalar, corner_radius: Scalar, tilt: Scalar, yaw: Scalar
) -> Scalar:
    """Radius of the tool's normal section along the feed, R_f [mm].

    Args:
        outer_radius: Outer radius of the mill, R [mm].
        corner_radius: Corner radius, r [mm].
        tilt: Tilt of the tool, theta_t [rad].
        yaw: Turn of the tilt plane from the feed, theta_n [rad].

    Source: Own derivation.
    """
    return 1.0 / feed_curvature(outer_radius, corner_radius, tilt, yaw)


def cusp_heights(milled: MilledSurface) -> tuple[Scalar, Scalar]:
    r"""Heights of the cusps between passes and between teeth [mm].

    $a = p^2/(8R_{app})$ and $b = f_z^2/(8R_f)$.

    Args:
        milled: How the surface was milled.
    """
    tool = (milled.outer_radius, milled.corner_radius, milled.tilt, milled.yaw)
    return (
        milled.step**2 * envelope_curvature(*tool) / 8.0,
        milled.feed_per_tooth**2 * feed_curvature(*tool) / 8.0,
    )


def Sz_analytic(milled: MilledSurface) -> Scalar:
    r"""Peak to pit of a milled surface [mm].

    $S_z = p^2/(8R_{app}) + f_z^2/(8R_f)$: both cusps meet somewhere on the surface.
    With $f_z = V_f/N$ and the first of the two steps listed, it is within 1.4 µm of all
    four measured values of S2 Table 2.

    Args:
        milled: How the surface was milled.

    Source: Own derivation, in place of S2 eq. (9).
    """
    between_passes, between_teeth = cusp_heights(milled)
    return between_passes + between_teeth


def Sz_as_printed(
    scallop_height: Scalar,
    feed_per_tooth: Scalar,
    corner_radius: Scalar,
    equivalent: Scalar,
) -> Scalar:
    r"""Peak to pit by the paper's rule, kept for the record [mm].

    $S_z = f_z^2/8r$ if $r > \sqrt{8 h_c R_{eq}}$, else $h_c + f_z^2/8r$. The switch
    compares a radius with a step, and with the right $R_{eq}$ it loses the scallops of
    the paper's third case; `Sz_analytic` is what this package uses.

    Args:
        scallop_height: Largest scallop allowed, $h_c$ [mm].
        feed_per_tooth: Advance per tooth, $f_z$ [mm].
        corner_radius: Corner radius, $r$ [mm].
        equivalent: Equivalent radius, $R_{eq}$ [mm].

    Source: S2 eq. (9).
    """
    teeth = feed_per_tooth**2 / (8.0 * corner_radius)
    narrow = corner_radius**2 > 8.0 * scallop_height * equivalent
    return jnp.where(narrow, teeth, scallop_height + teeth)


def scallops(
    between_passes: Scalar,
    between_teeth: Scalar,
    step: Scalar,
    feed_per_tooth: Scalar,
    shape: tuple[int, int],
    extent: Float[Array, "2"] | None = None,
) -> tuple[Float[Array, "ny nx"], Float[Array, "2"]]:
    r"""Height map of two crossed families of parabolic cusps, and its spacing [mm].

    $z = a(2y/p)^2 + b(2x/f_z)^2$ for $|y| \le p/2$, $|x| \le f_z/2$, repeated: feed along
    x, passes side by side along y. Points lie at the middle of their cells, so over whole
    periods the map can be continued without a seam.

    Args:
        between_passes: Height of the cusps between passes, $a$ [mm].
        between_teeth: Height of the cusps between teeth, $b$ [mm].
        step: Distance between passes, $p$ [mm].
        feed_per_tooth: Advance per tooth, $f_z$ [mm].
        shape: Points along y and along x.
        extent: Length of the map along y and along x [mm]; one period each if left out.

    Returns:
        The heights above the lowest point, and the distances of neighbours along y and x.
    """
    period = jnp.stack([step, feed_per_tooth])
    count = jnp.asarray(shape, dtype=period.dtype)
    spacing = (period if extent is None else extent) / count
    y = (jnp.arange(shape[0], dtype=period.dtype) + 0.5) * spacing[0] / step
    x = (jnp.arange(shape[1], dtype=period.dtype) + 0.5) * spacing[1] / feed_per_tooth
    # the lowest lines run through the middle of each period
    y, x = 2.0 * (y - jnp.floor(y)) - 1.0, 2.0 * (x - jnp.floor(x)) - 1.0
    z = between_passes * (y**2)[:, None] + between_teeth * (x**2)[None, :]
    return z, spacing


def scallop_cumulants(between_passes: Scalar, between_teeth: Scalar) -> Cumulants:
    r"""Cumulants of two crossed families of parabolic cusps.

    $\kappa_2 = \frac{4}{45}(a^2 + b^2)$, $\kappa_3 = \frac{16}{945}(a^3 + b^3)$,
    $\kappa_4 = -\frac{32}{4725}(a^4 + b^4)$. One family alone has Ssk = 2 sqrt(5)/7 and
    Sku = 15/7: milled surfaces start out skewed upwards and bounded.

    Args:
        between_passes: Height of the cusps between passes, $a$ [mm].
        between_teeth: Height of the cusps between teeth, $b$ [mm].

    Source: Own derivation.
    """
    a, b = between_passes, between_teeth
    return Cumulants(
        4.0 / 45.0 * (a**2 + b**2),
        16.0 / 945.0 * (a**3 + b**3),
        -32.0 / 4725.0 * (a**4 + b**4),
    )


def milled_map(
    milled: MilledSurface,
    shape: tuple[int, int],
    extent: Float[Array, "2"] | None = None,
) -> tuple[Float[Array, "ny nx"], Float[Array, "2"]]:
    """Height map of a milled surface, and its spacing [mm].

    Args:
        milled: How the surface was milled.
        shape: Points along y (across the feed) and along x (along it).
        extent: Length of the map along y and along x [mm]; one period each if left out.
    """
    heights = cusp_heights(milled)
    return scallops(*heights, milled.step, milled.feed_per_tooth, shape, extent)


def milled_cumulants(milled: MilledSurface) -> Cumulants:
    """Cumulants of a milled surface, in closed form.

    Args:
        milled: How the surface was milled.
    """
    return scallop_cumulants(*cusp_heights(milled))
