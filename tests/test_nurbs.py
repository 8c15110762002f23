"""NURBS: against two independent evaluations, derivatives, and the fit of point grids."""

import importlib.util

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close, assert_gradient
from polishopt.path.nurbs import Nurbs, fit_nurbs, nurbs
from scipy.interpolate import BSpline


def random_surface(seed):
    """Rational, uneven knots some of which repeat, degrees 1 to 5; odd sizes."""
    rng = np.random.default_rng(seed)
    degrees = [(1, 5), (2, 3), (3, 3), (5, 2), (4, 1)][seed % 5]
    counts = [degrees[0] + 4, degrees[1] + 3]  # few shapes: each is a compilation
    knots = []
    for p, n in zip(degrees, counts, strict=True):
        inner = np.sort(rng.uniform(0, 1, n - p - 1))
        if len(inner) > 1 and p > 1:
            inner[1] = inner[0]
        knots.append(np.concatenate([np.zeros(p + 1), inner, np.ones(p + 1)]))
    grid = np.stack(np.meshgrid(*[np.linspace(0, 9, n) for n in counts], indexing="ij"), -1)
    net = np.concatenate([grid, np.zeros((*counts, 1))], axis=-1)
    net += rng.normal(scale=0.3, size=net.shape)
    weights = rng.uniform(0.5, 2.0, counts)
    return nurbs(net, tuple(knots), degrees, (1.0, 1.0), weights), rng.uniform(0, 1, (8, 2))


SURFACES = [random_surface(seed) for seed in range(20)]


@eqx.filter_jit
def measured(net, weights, u_knots, v_knots, degrees, places):
    """Point, first and second derivatives at places."""
    surface = Nurbs(jnp.ones(2), net, weights, u_knots, v_knots, degrees)
    first = jax.jacfwd(surface)
    return jax.vmap(lambda xy: (surface(xy), first(xy), jax.jacfwd(first)(xy)))(places)


def measure(surface, places):
    fields = (surface.net, surface.weights, surface.u_knots, surface.v_knots)
    return measured(*fields, surface.degrees, jnp.asarray(places))


def by_scipy(surface, places, most=2):
    """Derivatives of the homogeneous surface by SciPy's splines, then the quotient rule."""
    net, weights = np.asarray(surface.net), np.asarray(surface.weights)
    lifted = np.concatenate([net * weights[:, :, None], weights[:, :, None]], axis=2)
    u, v = places.T

    def rows(knots, degree, count, t, order):
        return np.stack(
            [
                BSpline(knots, np.eye(count)[i], degree)(t, nu=order) if order <= degree
                else np.zeros_like(t)
                for i in range(count)
            ],
            axis=1,
        )  # fmt: skip

    a = {}
    for i in range(most + 1):
        for j in range(most + 1 - i):
            left = rows(surface.u_knots, surface.degrees[0], net.shape[0], u, i)
            right = rows(surface.v_knots, surface.degrees[1], net.shape[1], v, j)
            a[i, j] = np.einsum("kn,km,nmd->kd", left, right, lifted)
    w = {key: x[:, 3:] for key, x in a.items()}
    a = {key: x[:, :3] for key, x in a.items()}
    s = a[0, 0] / w[0, 0]
    su = (a[1, 0] - w[1, 0] * s) / w[0, 0]
    sv = (a[0, 1] - w[0, 1] * s) / w[0, 0]
    suu = (a[2, 0] - 2 * w[1, 0] * su - w[2, 0] * s) / w[0, 0]
    svv = (a[0, 2] - 2 * w[0, 1] * sv - w[0, 2] * s) / w[0, 0]
    suv = (a[1, 1] - w[1, 0] * sv - w[0, 1] * su - w[1, 1] * s) / w[0, 0]
    first = np.stack([su, sv], axis=-1)
    second = np.stack([np.stack([suu, suv], -1), np.stack([suv, svv], -1)], -1)
    return s, first, second


@pytest.mark.parametrize("seed", range(20))
def test_against_scipy(seed):
    surface, places = SURFACES[seed]
    for got, want in zip(measure(surface, places), by_scipy(surface, places), strict=True):
        assert_close(got, want, rtol=1e-10, atol=1e-10 * np.abs(want).max())


HAS_GEOMDL = importlib.util.find_spec("geomdl") is not None


@pytest.mark.skipif(not HAS_GEOMDL, reason="geomdl, the oracle, is not installed")
@pytest.mark.parametrize("seed", range(20))
def test_against_geomdl(seed):
    from geomdl import NURBS  # pyright: ignore[reportMissingImports]

    surface, places = SURFACES[seed]
    theirs = NURBS.Surface(normalize_kv=False)
    theirs.degree_u, theirs.degree_v = surface.degrees
    lifted = np.concatenate([surface.net, np.ones((*surface.weights.shape, 1))], axis=2)
    lifted = lifted * np.asarray(surface.weights)[:, :, None]
    theirs.set_ctrlpts(lifted.reshape(-1, 4).tolist(), *surface.weights.shape)
    theirs.knotvector_u = np.asarray(surface.u_knots).tolist()
    theirs.knotvector_v = np.asarray(surface.v_knots).tolist()
    point, first, second = measure(surface, places)
    for k, (u, v) in enumerate(places.tolist()):
        d = theirs.derivatives(u, v, 2)
        pairs = [
            (point[k], d[0][0]),
            (first[k, :, 0], d[1][0]),
            (first[k, :, 1], d[0][1]),
            (second[k, :, 0, 0], d[2][0]),
            (second[k, :, 0, 1], d[1][1]),
            (second[k, :, 1, 1], d[0][2]),
        ]
        for got, want in pairs:
            want = np.array(want)
            assert_close(got, want, rtol=1e-10, atol=1e-10 * max(1, np.abs(want).max()))


def quarter_cylinder(size=(1.0, 1.0)):
    """A quarter of a cylinder of radius 10 about y, exact as only a rational one is."""
    x, z, w = [0.0, 10.0, 10.0], [10.0, 10.0, 0.0], [1.0, np.sqrt(0.5), 1.0]
    net = np.array([[[a, y, b] for y in (0.0, 5.0)] for a, b in zip(x, z, strict=True)])
    knots = (np.array([0, 0, 0, 1, 1, 1.0]), np.array([0, 0, 1, 1.0]))
    return nurbs(net, knots, (2, 1), size, np.array(w)[:, None] * np.ones((1, 2)))


def test_a_cylinder_is_exact_to_its_ends():
    surface = quarter_cylinder()
    places = np.array([[0, 0], [0.3, 0.7], [1.0, 1.0], [0.5, 0.0]])
    point, first, _ = measure(surface, places)
    assert_close(point[:, 0] ** 2 + point[:, 2] ** 2, 100.0, rtol=1e-14)
    assert_close(point[2], [10, 5, 0], atol=1e-13)
    outward = np.cross(first[:, :, 0], first[:, :, 1])
    outward /= np.linalg.norm(outward, axis=1)[:, None]
    assert_close(outward, np.stack([point[:, 0], 0 * point[:, 0], point[:, 2]], 1) / 10,
                 atol=1e-13)  # fmt: skip


def test_gradients_with_respect_to_the_net_and_the_weights():
    surface = quarter_cylinder()

    def height(x):
        net = surface.net.at[1, 0].set(x[:3])
        changed = Nurbs(
            surface.size, net, surface.weights.at[1, 1].set(x[3]),
            surface.u_knots, surface.v_knots, surface.degrees,
        )  # fmt: skip
        return changed(x[4:])

    assert_gradient(height, jnp.asarray([10.0, 0.1, 9.0, 0.8, 0.4, 0.6]))


def test_single_precision():
    surface, places = SURFACES[7]
    single = jax.tree.map(lambda x: x.astype(jnp.float32), surface)
    got = jax.vmap(single)(jnp.asarray(places, jnp.float32))
    assert got.dtype == jnp.float32
    assert_close(got, measure(surface, places)[0], atol=2e-5)


def crown(x, y):
    return -(x**2) / 2000 - y**2 / 400 + 0.02 * np.sin(x / 12)


def measured_grid(rows=25, columns=11):
    x, y = np.linspace(-30, 30, rows), np.linspace(-7.5, 7.5, columns)
    x, y = np.meshgrid(x, y, indexing="ij")
    return np.stack([x, y, crown(x, y)], axis=-1)


def test_a_fit_goes_through_all_points_where_it_can():
    points = measured_grid(12, 8)
    surface = fit_nurbs(points, (12, 8))
    assert_close(surface.size, [60.0, 15.0], rtol=2e-3)
    # the parameters of the rows are their chord lengths, nearly even here
    steps = np.linalg.norm(np.diff(points, axis=0), axis=2).mean(axis=1)
    t = np.append(0, np.cumsum(steps)) / steps.sum()
    places = np.stack([t * np.asarray(surface.size)[0], np.zeros(12)], axis=1)
    got = jax.jit(jax.vmap(surface))(jnp.asarray(places))
    assert_close(got, points[:, 0], atol=1e-10)


def test_a_fit_smooths_noise_and_finds_the_crown():
    """With 9 x 5 control points for 275 points the crown comes out under 1 um of noise."""
    points = measured_grid()
    noise = np.random.default_rng(3).normal(scale=1e-3, size=points.shape[:2])
    points[:, :, 2] += noise
    surface = fit_nurbs(points, (9, 5))
    places = np.random.default_rng(4).uniform(0.1, 0.9, (50, 2)) * np.asarray(surface.size)
    got = np.asarray(jax.jit(jax.vmap(surface))(jnp.asarray(places)))
    error = got[:, 2] - crown(got[:, 0], got[:, 1])
    assert np.sqrt(np.mean(error**2)) < 0.8e-3


KNOTS = (np.array([0, 0, 1, 1.0]), np.array([0, 0, 1, 1.0]))
NET = np.array([[[0, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0.0]]])


def broken(array, place, value):
    array = np.array(array)
    array[place] = value
    return array


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: nurbs(NET[0], KNOTS, (1, 1), (1, 1)), "must be rows of points"),
        (
            lambda: nurbs(broken(NET, (1, 0, 2), np.nan), KNOTS, (1, 1), (1, 1)),
            r"\[1\]\[0\]",
        ),
        (lambda: nurbs(NET, KNOTS, (2, 1), (1, 1)), "degree along u is 2"),
        (lambda: nurbs(NET, (KNOTS[0][1:], KNOTS[1]), (1, 1), (1, 1)), "must be 4"),
        (lambda: nurbs(NET, (KNOTS[0][::-1], KNOTS[1]), (1, 1), (1, 1)), "never descend"),
        (lambda: nurbs(NET, (np.zeros(4), KNOTS[1]), (1, 1), (1, 1)), "at an end"),
        (lambda: nurbs(NET, KNOTS, (1, 1), (0, 1)), "two sides above 0"),
        (lambda: nurbs(NET, KNOTS, (1, 1), (1, 1), np.ones(4)), "`weights` has the shape"),
        (
            lambda: nurbs(NET, KNOTS, (1, 1), (1, 1), np.diag([1.0, 1])),
            r"weights\[0\]\[1\]",
        ),
        (
            lambda: fit_nurbs(broken(measured_grid(), (2, 4, 2), np.nan), (5, 5)),
            "no z at row 3, column 5",
        ),
        (lambda: fit_nurbs(measured_grid(), (5, 12)), "12 control points"),
        (lambda: fit_nurbs(measured_grid()[[0, 1, 1, 2, 3, 4]], (4, 5)), "2 and 3 along x"),
        (lambda: fit_nurbs(measured_grid()[0], (5, 5)), "must be rows of points"),
    ],
)
def test_errors_are_sentences(make, says):
    with pytest.raises(ValueError, match=says):
        make()
