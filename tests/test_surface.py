"""Surfaces: normals, areas and curvatures against closed forms."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close, assert_gradient
from polishopt.path import (
    Asphere,
    HyperbolicParaboloid,
    Plane,
    SphereCap,
    area_stretch,
    check_surface,
    curvature,
    jacobian,
    metric,
    normal,
    tangent_to_parameter,
)


SIZE = (50.0, 40.0)
SURFACES = {
    "plane": Plane(SIZE),
    "convex": SphereCap(SIZE, 100.0),
    "concave": SphereCap(SIZE, -80.0),
    "saddle": HyperbolicParaboloid(SIZE, 5e-3),
    "asphere": Asphere(SIZE, -120.0, -1.3, [2e-7, -3e-10]),
}
POINTS = jnp.asarray(np.random.default_rng(0).uniform((0, 0), SIZE, (4, 2)))


@eqx.filter_jit
def measure(surface, xy, angle=0.7):
    """Point, some orthonormal tangent frame, curvature, stretch and so on at a point."""
    n = normal(surface, xy)
    f = jacobian(surface, xy) @ jnp.stack([jnp.cos(angle), jnp.sin(angle)])
    f = f / jnp.linalg.norm(f)
    b = jnp.cross(n, f)
    return {
        "point": surface(xy),
        "n": n,
        "f": f,
        "b": b,
        "k": curvature(surface, xy, f, b),
        "stretch": area_stretch(surface, xy),
        "metric": metric(surface, xy),
        "jacobian": jacobian(surface, xy),
        "to_parameter": tangent_to_parameter(surface, xy, f, b),
    }


@pytest.mark.parametrize("surface", SURFACES.values(), ids=SURFACES.keys())
def test_the_middle_of_the_part_is_the_origin(surface):
    assert_close(surface(jnp.asarray(SIZE) / 2), np.zeros(3), atol=1e-15)


def test_plane_is_flat_and_faces_up():
    at = measure(SURFACES["plane"], POINTS[0])
    assert_close(at["n"], [0, 0, 1])
    assert_close(at["metric"], np.eye(2))
    assert_close(at["stretch"], 1.0)
    assert_close(at["k"], np.zeros((2, 2)))


def test_plane_stays_unbatched():
    """Over a batch of points, what is constant on a plane is computed once."""
    plane = SURFACES["plane"]
    f, b = jnp.asarray([1.0, 0, 0]), jnp.asarray([0, 1.0, 0])
    once = jax.vmap(
        lambda xy: (normal(plane, xy), curvature(plane, xy, f, b)), out_axes=None
    )
    n, k = once(POINTS)
    assert n.shape == (3,)
    assert k.shape == (2, 2)


@pytest.mark.parametrize("radius", [100.0, -80.0])
def test_sphere(radius):
    surface = SphereCap(SIZE, radius)
    centre = jnp.asarray([0, 0, -radius])
    for xy in POINTS:
        at = measure(surface, xy)
        outward = (at["point"] - centre) / radius
        assert_close(jnp.linalg.norm(outward), 1.0, rtol=1e-14)
        assert_close(at["n"], outward, atol=1e-14)
        assert_close(at["k"], np.eye(2) / radius, atol=1e-15)
        assert_close(at["stretch"], 1 / at["n"][2], rtol=1e-13)


def test_stretch_of_the_patch_of_radius_100():
    """2.2 % more area than its 50 x 50 mm shadow, and 6.9 % at the corner."""
    surface = SphereCap((50.0, 50.0), 100.0)
    corner = area_stretch(surface, jnp.zeros(2))
    assert_close(corner, 1 / np.sqrt(1 - 2 * 25.0**2 / 100.0**2), rtol=1e-13)
    assert_close(corner, 1.069, atol=5e-4)
    x, w = np.polynomial.legendre.leggauss(20)
    xy = jnp.asarray(np.stack(np.meshgrid(x, x), -1).reshape(-1, 2) * 25 + 25)
    stretch = jax.jit(jax.vmap(lambda xy: area_stretch(surface, xy)))(xy)
    mean = np.sum(np.outer(w, w).ravel() / 4 * np.asarray(stretch))
    assert_close(mean, 1.022, atol=5e-4)


def test_saddle():
    """Closed forms for z = w x y: principal curvatures -w and +w in the middle."""
    twist = 5e-3
    surface = HyperbolicParaboloid(SIZE, twist)
    middle = jnp.asarray(SIZE) / 2
    f, b = jnp.asarray([1.0, 1, 0]) / np.sqrt(2), jnp.asarray([-1.0, 1, 0]) / np.sqrt(2)
    # it rises along the diagonal, so it is concave there
    assert_close(curvature(surface, middle, f, b), np.diag([-twist, twist]), atol=1e-17)
    for xy in POINTS:
        at = measure(surface, xy)
        x, y = np.asarray(xy) - np.asarray(SIZE) / 2
        area = np.sqrt(1 + twist**2 * (x**2 + y**2))
        n = np.array([-twist * y, -twist * x, 1]) / area
        assert_close(at["n"], n, rtol=1e-12, atol=1e-15)
        assert_close(at["stretch"], area, rtol=1e-13)
        k = np.asarray(at["k"])
        gauss, mean = -(twist**2) / area**4, twist**3 * x * y / area**3
        assert_close(np.linalg.det(k), gauss, rtol=1e-11)
        assert_close(np.trace(k) / 2, mean, rtol=1e-9, atol=1e-16)
        assert_close(k, k.T, atol=1e-17)


@pytest.mark.parametrize("surface", SURFACES.values(), ids=SURFACES.keys())
def test_sag_below_the_tangent_plane(surface):
    """The part lies d K d / 2 below its tangent plane, to third order."""
    xy = POINTS[3]
    at = measure(surface, xy)
    for direction in ([1.0, 0.0], [0.0, 1.0], [0.6, -0.8]):
        offset = 1e-2 * jnp.asarray(direction)
        delta = surface(xy + at["to_parameter"] @ offset) - at["point"]
        # the third order is 1e-2/50 of the second
        assert_close(-delta @ at["n"], offset @ at["k"] @ offset / 2, rtol=1e-3, atol=1e-13)


@pytest.mark.parametrize("surface", SURFACES.values(), ids=SURFACES.keys())
def test_tangent_to_parameter_inverts_the_jacobian(surface):
    for xy in POINTS:
        at = measure(surface, xy)
        back = at["jacobian"] @ at["to_parameter"]
        assert_close(back, jnp.stack([at["f"], at["b"]], 1), atol=1e-14)
        assert_close(at["n"] @ back, np.zeros(2), atol=1e-14)


def test_no_hidden_units():
    """In metres, curvature grows a thousandfold and directions stay."""
    mm = measure(SURFACES["convex"], POINTS[1])
    m = measure(SphereCap((0.05, 0.04), 0.1), POINTS[1] * 1e-3)
    assert_close(m["point"], mm["point"] * 1e-3, rtol=1e-13)
    assert_close(m["k"], mm["k"] * 1e3, rtol=1e-12, atol=1e-11)
    for name in ("n", "stretch", "metric", "to_parameter"):
        assert_close(m[name], mm[name], rtol=1e-12, atol=1e-15)


def test_gradient_through_everything():
    f, b = jnp.asarray([0.8, 0.6, 0.0]), jnp.asarray([-0.6, 0.8, 0.0])

    def measures(x):
        surface = SphereCap(SIZE, x[2])
        k = curvature(surface, x[:2], f, b)
        return jnp.append(k, area_stretch(surface, x[:2]))

    assert_gradient(measures, jnp.asarray([10.0, 33.0, 90.0]))


def test_asphere():
    """A sphere for k = 0; a paraboloid's curvatures in closed form for k = -1."""
    for xy in POINTS:
        assert_close(Asphere(SIZE, 100.0)(xy), SURFACES["convex"](xy), atol=1e-13)
    bowl = Asphere(SIZE, -80.0, -1.0)
    for xy in POINTS:
        at = measure(bowl, xy)
        square = np.sum((np.asarray(xy) - np.asarray(SIZE) / 2) ** 2)
        assert_close(at["point"][2], square / 160, rtol=1e-13)
        steep = 1 + square / 80**2
        assert_close(np.linalg.det(at["k"]), 1 / (80 * steep) ** 2, rtol=1e-10)
        assert_close(bowl.slope(jnp.sqrt(square)), np.sqrt(square) / 80, rtol=1e-12)
    r = 17.0
    terms = Asphere(SIZE, 1e9, 0.0, [2e-6, -3e-9])
    at = jnp.asarray([25.0 + r, 20.0])
    assert_close(terms(at)[2], -(2e-6 * r**4 - 3e-9 * r**6) - r**2 / 2e9, rtol=1e-9)


def torn(xy):
    return jnp.append(xy, jnp.where(xy[0] > 40, jnp.nan, 0.0))


@pytest.mark.parametrize(
    ("surface", "says"),
    [
        (torn, "no value at"),
        (lambda xy: jnp.stack([xy[0], xy[0], 0 * xy[1]]), "no area at"),
        (lambda xy: jnp.stack([(xy[0] - 23.3) ** 2, xy[1], 0 * xy[1]]), "folds over"),
        (SphereCap(SIZE, 30.0), "no value at"),
    ],
)
def test_surfaces_that_cannot_be_polished_are_refused(surface, says):
    with pytest.raises(ValueError, match=says):
        check_surface(surface, SIZE)


def test_sound_surfaces_are_not_refused():
    for surface in SURFACES.values():
        check_surface(surface, SIZE)
    with pytest.raises(ValueError, match="two sides above 0"):
        check_surface(SURFACES["plane"], (50.0, 0.0))
