r"""NURBS: the free form of CAD, as a pytree, and its fit to measured points.

A point is $\sum N_i N_j w_{ij} P_{ij} / \sum N_i N_j w_{ij}$ with B-spline bases N. Only
the $(p + 1)(q + 1)$ control points of the knot span that holds the point count. All
derivatives follow by automatic differentiation, with the span held: they are exact, and at
a knot those of the span that begins there. Beyond the ends the last span goes on.
"""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..parts import Scalar, as_array


class Nurbs(eqx.Module):
    """A non-uniform rational B-spline surface over the parameter plane."""

    size: Float[Array, "2"] = eqx.field(converter=as_array)
    """Sides of the parameter plane, to which the ranges of u and v are stretched [mm]."""
    net: Float[Array, "n m 3"] = eqx.field(converter=as_array)
    """Control points, in the part frame [mm]."""
    weights: Float[Array, "n m"] = eqx.field(converter=as_array)
    """Their weights [-]."""
    u_knots: Float[Array, " k"] = eqx.field(converter=as_array)
    """Knots along the first index, which runs with x [-]."""
    v_knots: Float[Array, " l"] = eqx.field(converter=as_array)
    """Knots along the second index, which runs with y [-]."""
    degrees: tuple[int, int] = eqx.field(static=True)
    """Degrees along u and v."""

    def __call__(self, xy: Float[Array, "2"]) -> Float[Array, "3"]:
        """Point of the part at `xy` of the parameter plane [mm]."""
        i, u = basis(xy[0] / self.size[0], self.u_knots, self.degrees[0])
        j, v = basis(xy[1] / self.size[1], self.v_knots, self.degrees[1])
        many = (self.degrees[0] + 1, self.degrees[1] + 1)
        # one slice for each point: a look-up of single numbers takes many times as long
        points = jax.lax.dynamic_slice(self.net, (i, j, 0 * i), (*many, 3))
        weights = jax.lax.dynamic_slice(self.weights, (i, j), many)
        weights = weights * u[:, None] * v[None, :]
        return jnp.sum(weights[:, :, None] * points, axis=(0, 1)) / jnp.sum(weights)


def basis(
    t: Scalar, knots: Float[Array, " k"], degree: int
) -> tuple[Int[Array, ""], Float[Array, " degree_and_1"]]:
    """The B-spline bases that do not vanish at a parameter.

    Args:
        t: Place between the ends of the range of the knots, from 0 to 1 [-].
        knots: Not descending.
        degree: Degree of the spline.

    Returns:
        Index of the first of these bases, and their values.

    Source: Piegl & Tiller, The NURBS Book (1997), algorithms A2.1 and A2.2.
    """
    last = knots.size - degree - 2
    at = knots[degree] + t * (knots[last + 1] - knots[degree])
    span = jnp.clip(jnp.sum(knots <= at) - 1, degree, last)
    near = jax.lax.dynamic_slice(knots, (span - degree + 1,), (2 * degree,))
    values = [jnp.ones_like(at)]
    for k in range(1, degree + 1):
        # no denominator vanishes: each interval holds the span itself, which has a length
        ahead = [near[degree + r] for r in range(k)]
        behind = [near[degree + r - k] for r in range(k)]
        shares = [v / (a - b) for v, a, b in zip(values, ahead, behind, strict=True)]
        left = [(a - at) * s for a, s in zip(ahead, shares, strict=True)]
        right = [(at - b) * s for b, s in zip(behind, shares, strict=True)]
        values = [left[0], *(x + y for x, y in zip(left[1:], right[:-1], strict=True))]
        values.append(right[-1])
    return span - degree, jnp.stack(values)


def nurbs(
    net: np.ndarray,
    knots: tuple[np.ndarray, np.ndarray],
    degrees: tuple[int, int],
    size: np.ndarray | Sequence[float | int],
    weights: np.ndarray | None = None,
) -> Nurbs:
    """A NURBS surface, checked.

    Args:
        net: Control points, `[u, v, xyz]`, in the part frame [mm].
        knots: Knots along u and v, as many as control points, the degree and one [-].
        degrees: Degrees along u and v.
        size: Sides of the parameter plane [mm].
        weights: Weights of the control points; all one if None [-].

    Raises:
        ValueError: if these do not fit together, or hold what no surface can have.
    """
    net = np.asarray(net, dtype=float)
    weights = np.ones(net.shape[:2]) if weights is None else np.asarray(weights, float)
    if net.ndim != 3 or net.shape[2] != 3:
        raise ValueError(
            f"`net` has the shape {net.shape}, must be rows of points (x, y, z)."
        )
    if not np.isfinite(net).all():
        i, j, _ = np.argwhere(~np.isfinite(net))[0]
        raise ValueError(f"`net[{i}][{j}]` is not a number, must be a point in mm.")
    if weights.shape != net.shape[:2]:
        raise ValueError(
            f"`weights` has the shape {weights.shape}, must be {net.shape[:2]} as `net`."
        )
    if not (np.isfinite(weights) & (weights > 0)).all():
        i, j = np.argwhere(~(weights > 0) | ~np.isfinite(weights))[0]
        raise ValueError(f"`weights[{i}][{j}]` is {weights[i, j]}, must be above 0.")
    sides = np.asarray(size, dtype=float)
    if not (np.isfinite(sides) & (sides > 0)).all():
        raise ValueError(f"`size` is {sides.tolist()} mm, must be two sides above 0 mm.")
    for name, degree, knot, count in zip("uv", degrees, knots, net.shape, strict=False):
        knot = np.asarray(knot, dtype=float)
        if not 1 <= degree < count:
            raise ValueError(
                f"the degree along {name} is {degree}, must lie in 1..{count - 1} with "
                f"{count} control points."
            )
        if len(knot) != count + degree + 1:
            raise ValueError(
                f"there are {len(knot)} knots along {name}, must be {count + degree + 1}: "
                "the control points, the degree and one."
            )
        if not np.isfinite(knot).all() or np.any(np.diff(knot) < 0):
            raise ValueError(f"the knots along {name} must be numbers that never descend.")
        runs = knot[degree + 1 : -1] - knot[1 : -degree - 1]
        if knot[degree] >= knot[degree + 1] or knot[-degree - 2] >= knot[-degree - 1]:
            raise ValueError(
                f"the knots along {name} repeat more than {degree + 1} times at an end."
            )
        if np.any(runs <= 0):
            raise ValueError(
                f"the knots along {name} repeat more than {degree} times in between."
            )
    return Nurbs(sides, net, weights, *knots, degrees)


def fit_nurbs(
    points: np.ndarray,
    counts: tuple[int, int],
    degrees: tuple[int, int] = (3, 3),
    size: np.ndarray | Sequence[float | int] | None = None,
) -> Nurbs:
    """The B-spline surface nearest to a grid of measured points, by least squares.

    The parameters of rows and columns follow the mean distance of the points along them,
    and the knots follow the parameters. With as many control points as points the
    surface goes through all of them.

    Args:
        points: Measured points, `[i, j, xyz]`, i along x and j along y [mm].
        counts: Number of control points along i and j.
        degrees: Degrees along i and j.
        size: Sides of the parameter plane; None for the mean lengths of the grid's
            lines [mm].

    Raises:
        ValueError: if a point has no value, points coincide, or the numbers do not fit.

    Source: Piegl & Tiller, The NURBS Book (1997), section 9.4, eqs. (9.5), (9.68), (9.69).
    """
    points = np.asarray(points, dtype=float)
    if points.ndim != 3 or points.shape[2] != 3:
        raise ValueError(
            f"`points` has the shape {points.shape}, must be rows of points (x, y, z)."
        )
    if not np.isfinite(points).all():
        i, j, axis = np.argwhere(~np.isfinite(points))[0]
        raise ValueError(
            f"the point grid has no {'xyz'[axis]} at row {i + 1}, column {j + 1}; fill "
            "gaps before a fit."
        )
    from scipy.interpolate import make_lsq_spline  # long to import, and rarely needed

    found, knots, net = [], [], points
    for axis, (name, count, degree) in enumerate(
        zip(("along x", "along y"), counts, degrees, strict=True)
    ):
        have = points.shape[axis]
        if not 1 <= degree < count <= have:
            raise ValueError(
                f"there are {count} control points of degree {degree} {name} for {have} "
                "points; there must be more than the degree, and no more than points."
            )
        steps = np.linalg.norm(np.diff(points, axis=axis), axis=2).mean(axis=1 - axis)
        if steps.min() <= 0:
            raise ValueError(
                f"points {np.argmin(steps) + 1} and {np.argmin(steps) + 2} {name} coincide."
            )
        found.append(steps.sum())
        t = np.append(0.0, np.cumsum(steps)) / steps.sum()
        t[-1] = 1.0
        knots.append(_knots(t, count, degree))
        spline = make_lsq_spline(t, np.moveaxis(net, axis, 0), knots[-1], degree)
        net = np.moveaxis(spline.c, 0, axis)
    sides = np.array(found) if size is None else np.asarray(size, dtype=float)
    return nurbs(net, (knots[0], knots[1]), degrees, sides)


def _knots(t: np.ndarray, count: int, degree: int) -> np.ndarray:
    """Knots between which the parameters are shared out evenly."""
    inner = count - degree - 1
    if count == len(t):
        # as many as points: each knot the mean of the parameters that its basis spans
        middle = [t[k + 1 : k + degree + 1].mean() for k in range(inner)]
    else:
        place = (np.arange(inner) + 1) * len(t) / (inner + 1)
        below = place.astype(int)
        share = place - below
        middle = (1 - share) * t[below - 1] + share * t[below]
    return np.concatenate([np.zeros(degree + 1), middle, np.ones(degree + 1)])
