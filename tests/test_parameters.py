"""All parameters of ten surfaces, next to surfalize and, where needed, a third opinion."""

import functools
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close
from polishopt.texture.areal import HeightParameters
from polishopt.texture.parameters import areal_parameters
from scipy import interpolate, signal


SHAPE, OBLONG = (96, 120), (64, 180)
parameters_of = jax.jit(areal_parameters)


def field(lengths, angle=0.0, shape=SHAPE, seed=0):
    """Gaussian field of unit variance with an oblique Gaussian correlation."""
    fy, fx = (np.fft.fftfreq(2 * n) for n in shape)
    c, s = np.cos(angle), np.sin(angle)
    along = c * fx[None, :] + s * fy[:, None]
    across = c * fy[:, None] - s * fx[None, :]
    root = np.exp(
        -(np.pi**2) / 2 * ((along * lengths[1]) ** 2 + (across * lengths[0]) ** 2)
    )
    noise = np.random.default_rng(seed).normal(size=(2 * shape[0], 2 * shape[1]))
    z = np.fft.ifft2(np.fft.fft2(noise) * root).real[: shape[0], : shape[1]]
    return (z - z.mean()) / z.std()


def milled(seed=6):
    """Cusps of passes and of teeth, and a little noise."""
    y, x = (np.arange(n) for n in SHAPE)
    cusps = ((y / 31.7) % 1 - 0.5)[:, None] ** 2 + 0.3 * ((x / 9.3) % 1 - 0.5)[None, :] ** 2
    return cusps + 0.01 * field((2.0, 2.0), seed=seed)


def scratched(seed=7):
    """Straight grooves in two directions on a smooth ground."""
    rng = np.random.default_rng(seed)
    y, x = np.meshgrid(*(np.arange(n) for n in SHAPE), indexing="ij")
    z = 0.5 * field((5.0, 5.0), seed=seed)
    for angle in rng.choice([0.6, 0.6, 0.6, 2.2], 60) + 0.03 * rng.normal(size=60):
        off = np.cos(angle) * (y - rng.uniform(0, 96)) - np.sin(angle) * (
            x - rng.uniform(0, 120)
        )
        z -= np.maximum(rng.gamma(3.0) * (1 - (off / 2.5) ** 2), 0.0)
    return z


# name: heights, distances of points along y and along x
SURFACES = {
    "isotropic": lambda: (field((4.0, 4.0)), (1.0, 1.0)),
    "fine": lambda: (field((3.0, 3.0), seed=1), (0.25, 0.25)),
    "anisotropic": lambda: (field((3.0, 9.0), seed=2), (1.0, 1.0)),
    "oblique": lambda: (field((3.0, 9.0), 0.6, seed=3), (1.0, 1.0)),
    "skewed": lambda: (np.exp(0.5 * field((4.0, 4.0), seed=4)), (1.0, 1.0)),
    "plateau": lambda: (-np.exp(0.8 * field((3.0, 5.0), 2.0, seed=5)), (1.0, 1.0)),
    "milled": lambda: (milled(), (1.0, 1.0)),
    "scratched": lambda: (scratched(), (1.0, 1.0)),
    "oblong": lambda: (field((4.0, 4.0), shape=OBLONG, seed=8), (1.0, 1.0)),
    "stretched": lambda: (field((5.0, 5.0), shape=OBLONG, seed=9), (0.5, 0.8)),
}


@functools.cache
def both(name):
    """Our parameters, surfalize's surface, heights and spacing."""
    surfalize = pytest.importorskip("surfalize", reason="surfalize is not installed")
    z, (dy, dx) = SURFACES[name]()
    ours = parameters_of(jnp.asarray(z), jnp.asarray([dy, dx]))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        theirs = surfalize.Surface(z, dx, dy)
    return ours, theirs, z, (dy, dx)


def quietly(ask):
    """What surfalize says, without its warnings of missing values and of oblong points."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        warnings.simplefilter("ignore", UserWarning)
        return ask()


@pytest.mark.parametrize("name", SURFACES)
def test_heights_and_slopes(name):
    ours, theirs, _, _ = both(name)
    for part in HeightParameters.__dataclass_fields__:
        want = getattr(theirs, part)()
        assert_close(getattr(ours.height, part), want, rtol=1e-9, atol=1e-12)
    assert_close(ours.hybrid.Sdq, theirs.Sdq(), rtol=1e-9)
    assert_close(ours.hybrid.Sdr, theirs.Sdr() / 100, rtol=1e-9)


@pytest.mark.parametrize("name", SURFACES)
def test_material_ratio(name):
    ours, theirs, z, _ = both(name)
    p = ours.functional
    for part, unit in {"Sk": 1, "Smr1": 100, "Smr2": 100, "Sxp": 1}.items():
        assert_close(unit * getattr(p, part), getattr(theirs, part)(), rtol=1e-6)

    # surfalize ends its areas at the class next to a limit, and cuts the curve straight
    # between classes; here the same areas point by point, between its own limits
    def over(c):
        return np.mean(np.maximum(z - c, 0.0))

    def under(c):
        return np.mean(np.maximum(c - z, 0.0))

    upper, lower = (theirs.Smc(getattr(theirs, part)()) for part in ("Smr1", "Smr2"))
    high, low = theirs.Smc(10), theirs.Smc(80)
    exact = {
        "Spk": 2 * over(upper) / (theirs.Smr1() / 100) if theirs.Smr1() else 0.0,
        "Svk": 2 * under(lower) / (1 - theirs.Smr2() / 100) if theirs.Smr2() < 100 else 0.0,
        "Vmp": over(high),
        "Vmc": over(low) - over(high),
        "Vvv": under(low),
        "Vvc": under(high) - under(low),
    }
    for part, want in exact.items():
        assert_close(getattr(p, part), want, rtol=1e-6)
        theirs_too = getattr(theirs, part)()
        assert_close(getattr(p, part), theirs_too, rtol=0.01, atol=2e-3 * float(p.Sk))


def decay_by_splines(z, spacing):
    """Shortest and longest decay by a dense fan of rays over a spline of the ACF."""
    z = z - z.mean()
    ny, nx = z.shape
    ones = np.ones(z.shape)
    product = signal.correlate(z, z, method="fft")
    acf = product / signal.correlate(ones, ones, method="fft") / np.mean(z**2)
    y, x = (d * np.arange(1 - n, n) for n, d in zip(z.shape, spacing, strict=True))
    spline = interpolate.RectBivariateSpline(y, x, acf, kx=5, ky=5)
    lengths = []
    step = 0.05 * min(spacing)
    for angle in np.linspace(0, np.pi, 1441)[:-1]:
        with np.errstate(divide="ignore"):
            reach = min(y[-1] / abs(np.sin(angle)), x[-1] / abs(np.cos(angle)))
        r = np.arange(0, reach, step)
        value = spline.ev(r * np.sin(angle), r * np.cos(angle))
        fallen = np.flatnonzero(value <= 0.2)
        lengths.append(r[fallen[0]] - 0.5 * step if fallen.size else np.nan)
    return np.nanmin(lengths), np.max(lengths)


@pytest.mark.parametrize("name", SURFACES)
def test_decay(name):
    ours, theirs, z, spacing = both(name)
    shortest, longest = decay_by_splines(z, spacing)
    Sal, Str = (float(v) for v in (ours.spatial.Sal, ours.spatial.Str))
    assert_close(Sal, shortest, rtol=0.01)
    # Surfalize takes the point of a ray nearest to the level, on rays to the points beside
    # the decayed region only: within one per cent, or farther from the spline.
    for got, want, third in (
        (Sal, quietly(theirs.Sal), shortest),
        (Str, quietly(theirs.Str), shortest / longest),
    ):
        assert np.isnan(got) == np.isnan(want) == np.isnan(third)
        if not np.isnan(got):
            assert_close(got, third, rtol=0.01)
            assert abs(got / want - 1) < 0.01 or abs(got - third) < abs(want - third)
            assert_close(got, want, rtol=0.02)


def lay_by_scan(z, spacing):
    """Lay at right angles to the sector with most power, every mode weighed by itself."""
    window = np.multiply.outer(*(np.hanning(n + 2)[1:-1] for n in z.shape))
    z = z - np.sum(window * z) / np.sum(window)
    size = [2 * n for n in z.shape]
    power = np.abs(np.fft.fft2(window * z, s=size)) ** 2
    fy, fx = (np.fft.fftfreq(n, d) for n, d in zip(size, spacing, strict=True))
    angle = np.arctan2(fy[:, None], fx[None, :])
    power[np.hypot(fy[:, None], fx[None, :]) > 0.5 / max(spacing)] = 0.0
    sums = []
    tries = np.radians(np.arange(0, 180, 0.5))
    for t in tries:
        off = (angle - t + np.pi / 2) % np.pi - np.pi / 2
        near = np.abs(off) < np.radians(10)
        sums.append(np.sum(power[near] * np.cos(9 * off[near]) ** 2))
    return (np.degrees(tries[np.argmax(sums)]) + 90) % 180


@pytest.mark.parametrize("name", SURFACES)
def test_lay(name):
    ours, theirs, z, spacing = both(name)
    got, scanned = np.degrees(ours.spatial.Std), lay_by_scan(z, spacing)

    def off(a, b):
        return abs((a - b + 90) % 180 - 90)

    assert off(got, scanned) < 0.6
    # Surfalize gives the direction of the waves, in a map with y upwards. Without a window
    # it sees the borders as waves along the axes, and it takes the strongest sector of
    # half a degree: one per cent of 180 degrees apart, or farther from the truth.
    waves = quietly(theirs.Std)
    known = {"oblique": 0.6, "plateau": 2.0, "scratched": 0.6, "milled": 0.0}
    if name in known:
        lay, truth = (90 - waves) % 180, np.degrees(known[name])
        assert off(got, truth) < 2.0
        assert off(got, lay) < 1.8 or off(got, truth) < off(lay, truth)


@pytest.mark.parametrize("name", SURFACES)
def test_peaks(name):
    ours, theirs, z, _ = both(name)
    assert_close(ours.Spd, theirs.Spd(exclude_edge=False), rtol=1e-9)


def test_units():
    """In metres everything scales by its unit."""
    ours, _, z, spacing = both("oblique")
    metres = parameters_of(1e-3 * jnp.asarray(z), 1e-3 * jnp.asarray(spacing))
    for family, powers in {
        "height": {"Ssk": 0, "Sku": 0},
        "hybrid": {"Sdq": 0, "Sdr": 0},
        "spatial": {"Str": 0, "Std": 0},
        "functional": {"Smr1": 0, "Smr2": 0},
    }.items():
        for part, value in vars(getattr(ours, family)).items():
            got = getattr(getattr(metres, family), part)
            assert_close(got, value * 1e-3 ** powers.get(part, 1), rtol=1e-6, atol=1e-12)
    assert_close(metres.Spd, 1e6 * ours.Spd, rtol=1e-9)


def test_gaps_and_gradient():
    z, spacing = SURFACES["isotropic"]()
    whole = both("isotropic")[0]
    z[np.random.default_rng(0).random(z.shape) < 0.05] = np.nan
    holed = parameters_of(jnp.asarray(z), jnp.asarray(spacing))
    for family in ("height", "hybrid", "functional"):
        for part, value in vars(getattr(whole, family)).items():
            got = getattr(getattr(holed, family), part)
            assert_close(got, value, rtol=0.1, atol=0.05)

    def height_and_slope(z):
        p = areal_parameters(z, 1.0)
        return p.height.Sq + p.hybrid.Sdq + p.hybrid.Sdr + p.Spd

    slope = jax.jit(jax.grad(height_and_slope))(jnp.full((8, 9), 2.0))
    assert_close(slope, 0.0, atol=1e-15)


def test_single_precision():
    z, spacing = SURFACES["oblique"]()
    got = parameters_of(
        jnp.asarray(1e-4 * z, jnp.float32), jnp.asarray(spacing, jnp.float32)
    )
    want = parameters_of(jnp.asarray(1e-4 * z), jnp.asarray(spacing))
    for a, b in zip(jax.tree.leaves(got), jax.tree.leaves(want), strict=True):
        assert a.dtype == jnp.float32
        assert_close(a, b, rtol=2e-3)
