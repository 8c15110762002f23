"""Evolution: the pad law, the scratches and the sum, against oracles and laws."""

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from helpers import abrasive, assert_close, assert_gradient
from polishopt.texture.areal import (
    Cumulants,
    height_parameters,
    parameters_from_cumulants,
)
from polishopt.texture.evolution import combine, draw_patch, ripple_cumulants
from polishopt.texture.filters import gaussian_transmission
from polishopt.texture.planarisation import (
    asperity_stiffness,
    pad_pressure,
    planarise,
    planarised,
    saturation,
)
from polishopt.texture.scratches import (
    Scratches,
    compression,
    decay,
    decay_rate,
    groove_cumulants,
    groove_depth,
)
from scipy import integrate, stats


S = jnp.asarray
wear = jax.jit(planarise, static_argnames="steps")
press = jax.jit(pad_pressure)
heights_of = jax.jit(height_parameters)


def gaussian_map(n=64, seed=0):
    """Exact normal quantiles with Sq = 1, shuffled: no sampling noise in the heights."""
    z = stats.norm.ppf((np.arange(n * n) + 0.5) / n**2)
    return S(np.random.default_rng(seed).permutation(z / z.std()).reshape(n, n))


def wavy_map(n=16, seed=0):
    """A smooth periodic map whose Sq is 1."""
    z = bend(6.0)(np.asarray(gaussian_map(n, seed)))
    return S((z - z.mean()) / z.std())


def bend(cutoff):
    """The Gaussian lowpass of a periodic map of unit spacing, in numpy."""

    def smooth(z):
        fy, fx = np.fft.fftfreq(z.shape[0]), np.fft.fftfreq(z.shape[1])
        passed = 0.5 ** ((fy[:, None] ** 2 + fx[None, :] ** 2) * cutoff**2)
        return np.fft.ifft2(passed * np.fft.fft2(z)).real

    return smooth


@pytest.mark.parametrize(
    ("pressure", "removal", "Sq", "Ssk", "Sku", "contact"),
    [
        (0.2, 0.2, 0.753, -0.89, 3.45, 0.50),
        (0.2, 0.4, 0.588, -1.57, 5.29, 0.64),
        (0.2, 0.6, 0.465, -2.21, 8.18, 0.74),
        (0.05, 0.1, 0.847, -0.65, 2.84, 0.25),
        (0.05, 0.3, 0.656, -1.34, 4.34, 0.46),
    ],
)
def test_known_planarisation(pressure, removal, Sq, Ssk, Sku, contact):
    # a map of 64 x 64 normal quantiles lacks 0.7 % of the last Sku, one of 128 x 128 0.2 %
    z = wear(gaussian_map(128), S(removal), S(pressure), S(1.0))
    p = heights_of(z)
    assert_close(jnp.stack([p.Sq, p.Ssk, p.Sku]), [Sq, Ssk, Sku], rtol=0.01)
    touching = press(z, S(pressure), S(1.0)) > 0
    assert_close(jnp.mean(touching), contact, rtol=0.01)


def wear_ode(z, removal, pressure, stiffness, smooth):
    """The pad law as an initial value problem; z_d by sorting, no polishopt in it."""

    def slope(_, flat):
        height = flat - smooth(flat.reshape(z.shape)).ravel()
        ranked = np.sort(height)[::-1]
        levels = (np.cumsum(ranked) - pressure / stiffness * z.size) / np.arange(
            1, z.size + 1
        )
        level = levels[np.nonzero(ranked > levels)[0][-1]]
        return -stiffness / pressure * np.maximum(height - level, 0)

    end = integrate.solve_ivp(slope, (0, removal), z.ravel(), rtol=1e-7, atol=1e-9)
    return end.y[:, -1].reshape(z.shape)


@pytest.mark.parametrize(("pressure", "removal"), [(0.2, 0.5), (0.02, 0.2), (3.0, 1.0)])
def test_planarisation_of_a_flat_pad_agrees_with_an_ode(pressure, removal):
    z = wavy_map()
    want = wear_ode(np.asarray(z), removal, pressure, 1.0, np.mean)
    error = [
        np.abs(wear(z, S(removal), S(pressure), S(1.0), steps=n) - want).max()
        for n in (8, 32)
    ]
    assert error[0] < 1e-2
    # first order would gain 4, second order gains 16
    assert error[1] < max(error[0] / 8, 1e-7)


@pytest.mark.parametrize(("pressure", "removal"), [(0.2, 0.5), (0.05, 0.2)])
def test_planarisation_of_a_bending_pad_agrees_with_an_ode(pressure, removal):
    z, cutoff = wavy_map(), 5.0
    want = wear_ode(np.asarray(z), removal, pressure, 1.0, bend(cutoff))
    error = [
        np.abs(wear(z, S(removal), S(pressure), S(1.0), S(cutoff), 1.0, n) - want).max()
        for n in (8, 16, 32)
    ]
    assert error[0] < 3e-2
    # first order would gain 2 each time, second order gains 4
    assert error[2] < 0.4 * error[1] < 0.2 * error[0]


@pytest.mark.parametrize("steps", [1, 5])
def test_full_contact_decays_exponentially(steps):
    z, pressure, removal = wavy_map(), S(10.0), S(7.0)
    flat = wear(z, removal, pressure, S(1.0), steps=steps)
    assert_close(flat, z * np.exp(-0.7) - removal, rtol=1e-12)
    wave = S(np.sin(2 * np.pi * 2 * np.arange(16) / 16)[None, :] * np.ones((4, 1)))
    bent = wear(wave, removal, pressure, S(1.0), S(8.0), 1.0, steps)
    # the pad follows this wave by half, so it decays at half the rate
    assert_close(bent, wave * np.exp(-0.35) - removal, rtol=1e-12)


def test_rigid_pad_cuts_a_plane():
    z = gaussian_map(16)
    cut = wear(z, S(0.2), S(0.0), S(1.0), steps=3)
    assert_close(cut, jnp.minimum(z, jnp.max(cut)), atol=1e-12)
    assert_close(jnp.mean(cut), -0.2, rtol=1e-12)


@pytest.mark.parametrize("conformity", [None, 5.0])
def test_pressure_is_shared_out(conformity):
    pressure = press(wavy_map(), S(0.3), S(2.0), conformity)
    assert_close(jnp.mean(pressure), 0.3)
    assert jnp.min(pressure) == 0.0
    assert_close(press(wavy_map(), S(40.0), S(2.0), conformity) > 0, True)


@pytest.mark.parametrize("conformity", [None, jnp.inf, 5.0])
def test_laws_of_wear(conformity):
    z = wavy_map()
    for removal, pressure in ((0.4, 0.1), (1e4, 1.0), (1e-3, 1e-7), (2.0, 20.0)):
        after = wear(z, S(removal), S(pressure), S(1.0), conformity)
        assert_close(jnp.mean(z) - jnp.mean(after), removal, rtol=1e-11)
        assert jnp.all(after <= z)
    first = wear(z, S(0.02), S(0.02), S(1.0), conformity, steps=1)
    hovers = press(z, S(0.02), S(1.0), conformity) == 0
    # a step's own contact is a little larger than that at its start
    assert jnp.mean(first[hovers] == z[hovers]) > 0.9
    assert jnp.mean(first == z) > 0.5


def test_order_of_heights_is_kept():
    z = jnp.sort(gaussian_map(16).ravel())[:, None]
    for removal, pressure in ((0.4, 0.1), (1e4, 1.0), (1e-3, 1e-7)):
        after = wear(z, S(removal), S(pressure), S(1.0))
        tie = 1e-15 * max(removal, 1.0)
        assert jnp.all(jnp.diff(after[:, 0]) >= -tie)


def test_long_polishing_stays_finite():
    z = gaussian_map(16)
    after = wear(z, S(1e4), S(1.0), S(1.0))
    assert_close(after + 1e4, 0.0, atol=1e-9)
    bent = wear(z, S(1e4), S(1.0), S(1.0), S(5.0))
    assert_close(bent + 1e4, 0.0, atol=1e-9)


@pytest.mark.parametrize("conformity", [None, 5.0])
def test_a_stiff_pad_only_ever_takes_away(conformity):
    """From the first touch to r h = 1e4, in steps that grow a hundredthousandfold."""
    z, removals = wavy_map(), S(np.concatenate([[0.0], np.geomspace(1e-4, 10.0, 40)]))

    @jax.jit
    def course(z):
        return planarised(z, removals, S(1e-3), S(1.0), lambda z: z, conformity, 1.0)

    seen = np.asarray(course(z))
    assert np.isfinite(seen).all()
    assert_close(seen[0], z)
    assert (np.diff(seen, axis=0) <= 0).all()
    assert_close(np.mean(seen, axis=(1, 2)), np.mean(z) - removals, rtol=1e-9, atol=1e-12)
    lost = np.diff(seen.std(axis=(1, 2)))
    assert (lost < 1e-12).all()
    if conformity is None:
        # what the pad has not reached yet is as it was, to the last bit
        for level in seen[1:-10]:
            kept = level == z
            assert level[kept].max() < level[~kept].min()
        shares = (seen == np.asarray(z)).mean(axis=(1, 2))
        assert (np.diff(shares) <= 0).all()
        assert 0.3 < shares[30] < 0.98


def test_infinite_conformity_is_a_flat_pad():
    z = wavy_map()
    flat = wear(z, S(0.3), S(0.1), S(1.0))
    assert_close(wear(z, S(0.3), S(0.1), S(1.0), S(jnp.inf)), flat, rtol=1e-9)


def test_metres_wear_the_same():
    z, spacing = wavy_map(), S([0.9, 1.1])
    mm = wear(z, S(0.3), S(0.1), S(2.0), S(5.0), spacing)
    m = wear(1e-3 * z, S(0.3e-3), S(0.1e6), S(2e9), S(5e-3), 1e-3 * spacing)
    assert_close(m, 1e-3 * mm, rtol=1e-9, atol=1e-12)


def test_planarise_under_vmap_and_in_single_precision():
    z = wavy_map()
    removal = S([0.0, 0.1, 0.5, 30.0])
    many = jax.vmap(lambda h: wear(z, h, S(0.1), S(1.0), S(5.0)))(removal)
    for h, got in zip(removal, many, strict=True):
        assert_close(got, wear(z, h, S(0.1), S(1.0), S(5.0)), rtol=1e-9, atol=1e-12)
    single = wear(*(x.astype(jnp.float32) for x in (z, S(0.5), S(0.1), S(1.0), S(5.0))))
    assert single.dtype == jnp.float32
    assert_close(single, many[2], atol=1e-5)


@pytest.mark.parametrize("bending", [False, True])
def test_gradients_of_wear(bending):
    z = wavy_map(6, 1)

    def f(x):
        conformity = x[3] if bending else None
        return wear(z, x[0], x[1], x[2], conformity, 1.0, 4).ravel()

    def both(x):  # in partial and in full contact
        scale = S([[1.0, 1.0, 1.0, 1.0], [10.0, 45.0, 1.0, 1.0]])
        return jax.vmap(f)(scale * x[None, :])

    # differences over a small step, so that no point starts to touch within it
    assert_gradient(both, S([0.3, 0.2, 1.3, 4.0]), rtol=1e-5, atol=1e-8, step=1e-6)

    def of_heights(heights):
        conformity = S(4.0) if bending else None
        after = wear(heights.reshape(6, 6), S(0.3), S(0.2), S(1.0), conformity, steps=2)
        p = heights_of(after)
        return jnp.stack([p.Sq, p.Ssk, p.Sku])

    nudge = jnp.zeros(36)
    assert_gradient(
        lambda x: of_heights(z.ravel() + x), nudge, rtol=1e-5, atol=1e-8, step=1e-6
    )


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
@pytest.mark.parametrize("conformities", [(None,), (5.0, jnp.inf)], ids=["flat", "bent"])
def test_gradients_of_wear_are_finite_in_every_corner(conformities, dtype):
    def f(z, removal, pressure, stiffness, conformity):
        after = wear(z, removal, pressure, stiffness, conformity, 1.0, 3)
        p = heights_of(after)
        return jnp.stack([p.Sq, p.Ssk, p.Sku, jnp.mean(after)])

    wanted = (0, 1, 2, 3) if None in conformities else (0, 1, 2, 3, 4)
    derivative = jax.jit(jax.jacrev(f, wanted))
    maps = wavy_map(8), jnp.zeros((8, 8)), jnp.ones((8, 8))
    corners = [(0.0, 0.2), (0.3, 0.0), (0.0, 0.0), (1e4, 1.0)]
    for conformity in conformities:
        fixed = None if conformity is None else jnp.asarray(conformity, dtype)
        for removal, pressure in [*corners, (0.3, 1e-12), (1e-12, 0.1), (0.3, 50.0)]:
            for start in maps:
                given = (x.astype(dtype) for x in (start, S(removal), S(pressure), S(1.0)))
                for entry in derivative(*given, fixed):
                    assert np.isfinite(entry).all(), (conformity, removal, pressure)


def test_saturation():
    x = np.array([0.0, 1e-9, 0.99e-3, 1.01e-3, 0.5, 30.0, 1e5])
    want = np.where(x > 0, -np.expm1(-x) / np.where(x > 0, x, 1), 1.0)
    assert_close(saturation(S(x)), want, rtol=1e-13)
    slope = jax.vmap(jax.grad(saturation))(S(x[:5]))
    exact = [integrate.quad(lambda t, y=y: -t * np.exp(-y * t), 0, 1)[0] for y in x[:5]]
    assert_close(slope, exact, rtol=1e-9)


def test_asperity_stiffness():
    assert_close(asperity_stiffness(abrasive()), np.pi * 5.0 * np.sqrt(0.05) / 1e-3)
    assert_close(asperity_stiffness(abrasive(asperity_stiffness=7.0)), 7.0)
    for part in (abrasive(), abrasive(asperity_stiffness=7.0)):
        grads = jax.tree.leaves(eqx.filter_grad(asperity_stiffness)(part))
        assert np.isfinite(grads).all()
    calibrated = eqx.filter_grad(asperity_stiffness)(abrasive(asperity_stiffness=7.0))
    assert calibrated.asperity_stiffness == 1.0
    assert calibrated.pad_modulus == 0.0


def test_known_groove_depths():
    # one micron: 6.2 nm; the depth goes with the grain
    for grain, depth in ((125e-3, 777e-6), (58.5e-3, 364e-6), (1e-3, 6.2e-6)):
        assert_close(groove_depth(abrasive(grain=grain), S(0.05)), depth, rtol=5e-3)
    assert_gradient(lambda p: groove_depth(abrasive(), p[0]) * 1e6, S([0.05]))
    assert groove_depth(abrasive(), S(0.0)) == 0.0
    assert jax.grad(lambda p: groove_depth(abrasive(), p))(S(0.0)) == 0.0


def parameters(part):
    return jnp.stack(parameters_from_cumulants(*part))


def test_stationary_grooves_of_one_depth():
    part, pressure = abrasive(), S(0.05)
    ratio = groove_depth(part, pressure) / compression(part, pressure)
    _, Ssk, Sku = parameters(groove_cumulants(part, pressure, S(1.0)))
    # 0.9035 = (24/35)/3 / 0.4^1.5 and 0.9524 = (64/105)/4 / 0.4^2
    assert_close(Ssk, -0.9035 * jnp.sqrt(ratio), rtol=1e-4)
    assert_close(Sku - 3, 0.95238 * ratio, rtol=1e-5)
    assert_close(Ssk, -0.60, rtol=5e-3)
    # neither depends on the grain
    coarse = groove_cumulants(abrasive(grain=0.125), pressure, S(100.0))
    assert_close(parameters(coarse)[1:], jnp.stack([Ssk, Sku]), rtol=1e-10)


def shot_noise(rng, points, rate, width, decay_rate, time, depths):
    """Heights at independent points under parabolic grooves that come and decay."""
    count = rng.poisson(rate * 2 * width * time, points)
    owner = np.repeat(np.arange(points), count)
    place, age = rng.uniform(-1, 1, owner.size), rng.uniform(0, time, owner.size)
    cut = depths(owner.size) * (1 - place**2) * np.exp(-decay_rate * age)
    return -np.bincount(owner, cut, minlength=points)


@pytest.mark.parametrize(
    ("rate", "width", "decay_rate", "time"),
    [
        pytest.param(0.3, 0.5, 0.1, 80.0, id="stationary"),
        pytest.param(0.3, 0.5, 0.1, 8.0, id="growing"),
        pytest.param(1.0, 1.0, 1e-9, 1.0, id="static"),
    ],
)
def test_grooves_of_one_depth_by_monte_carlo(rate, width, decay_rate, time):
    rng = np.random.default_rng(1)
    z = shot_noise(rng, 1_000_000, rate, width, decay_rate, time, np.ones)
    # removal is what the grooves carry away; A is the removal in one decay time
    per_time = rate * width * 4 / 3
    part = unit_depth_abrasive(per_time / decay_rate)
    got = groove_cumulants(part, S(1.0), S(per_time * time))
    # a million points know Sq, Ssk and Sku to 0.1, 0.7 and 0.6 %, three standard errors
    want = [z.std(), stats.skew(z), stats.kurtosis(z, fisher=False)]
    assert_close(parameters(got), want, rtol=0.02)


def unit_depth_abrasive(worn, **changes):
    """An abrasive with groove depth 1 and compression `worn` at pressure 1."""
    part = abrasive(grain=1.0, asperity_stiffness=1.0 / worn, **changes)
    return eqx.tree_at(lambda a: a.grain, part, 1.0 / groove_depth(part, S(1.0)))


def test_gamma_distributed_grooves_by_monte_carlo():
    v, worn, time = 0.5, 2.0, 10.0
    rng, points = np.random.default_rng(2), 400_000
    shape = 1 / v**2
    # a point meets wide grooves more often: depths at a point are weighted by width ~ D
    depths = lambda n: rng.gamma(shape + 1, v**2, n)  # noqa: E731
    # unit mean depth, w = D: removal rate is rate * 4/3 E[D^2], hits per time rate * 2 E[D]
    rate = 1 / (4 / 3 * (1 + v**2))
    z = shot_noise(rng, points, rate, 1.0, 1 / worn, time, depths)
    got = groove_cumulants(unit_depth_abrasive(worn, depth_variation=v), S(1.0), S(time))
    want = [z.std(), stats.skew(z), stats.kurtosis(z, fisher=False)]
    assert_close(parameters(got), want, rtol=0.03)


def test_grooves_of_two_steps_are_those_of_one():
    part, pressure = abrasive(depth_variation=0.4), S(0.05)
    first, second = S(1e-5), S(2e-5)
    early = decay(
        groove_cumulants(part, pressure, first), second, decay_rate(part, pressure)
    )
    late = groove_cumulants(part, pressure, second)
    once = groove_cumulants(part, pressure, first + second)
    for a, b, want in zip(early, late, once, strict=True):
        assert_close(a + b, want, rtol=1e-12)


def test_gradients_of_grooves():
    def f(x):
        part = abrasive(depth_variation=x[2], hardness=x[3], pad_modulus=x[4])
        k2, k3, k4 = groove_cumulants(part, x[0], x[1])
        return jnp.stack([1e10 * k2, 1e15 * k3, 1e20 * k4])

    assert_gradient(f, S([0.05, 2e-5, 0.5, 5490.0, 5.0]), atol=1e-7)
    # at no variation the slope is zero, at any removal
    assert_gradient(f, S([0.05, 2e-5, 0.0, 5490.0, 5.0]), atol=1e-4)
    assert_gradient(f, S([0.05, 2e-9, 0.5, 5490.0, 5.0]), atol=1e-9)
    assert_gradient(f, S([0.05, 1.0, 0.5, 5490.0, 5.0]), atol=1e-7)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_gradients_of_grooves_are_finite_in_every_corner(dtype):
    def f(pressure, removal, part, before):
        rate = decay_rate(part, pressure)
        texture = combine(
            groove_cumulants(part, pressure, removal), decay(before, removal, rate)
        )
        return texture.Sa + texture.Sq + texture.Ssk + texture.Sku

    def cast(tree):
        return jax.tree.map(lambda x: jnp.asarray(x).astype(dtype), tree)

    derivative = jax.jit(jax.grad(f, (0, 1, 2, 3)))
    # fourth powers of less than a thousandth of a nanometre leave the range of float32
    small = 1e-10 if dtype == jnp.float64 else 1e-5
    for part in (abrasive(), abrasive(asperity_stiffness=3000.0, depth_variation=0.5)):
        for pressure in (0.0, small, 0.05, 5.0):
            for removal in (0.0, small, 1e-4, 1.0):
                for before in (Scratches(), Scratches(1e-10, -1e-16, 1e-20)):
                    args = cast((S(pressure), S(removal), part, before))
                    grads = jax.tree.leaves(derivative(*args))
                    assert all(np.isfinite(g).all() for g in grads), (pressure, removal)


def test_ripple_of_one_wave():
    texture = combine(ripple_cumulants(S([3.0]), S([1.0])))
    assert_close(jnp.stack([texture.Sq, texture.Ssk, texture.Sku]), [3 / 2**0.5, 0.0, 1.5])


def test_ripple_of_independent_waves_through_the_filter():
    amplitude, wavelength, cutoff = S([1.0, 2.0]), S([0.5, 2.0]), S(0.8)
    left = np.asarray(amplitude * (1 - gaussian_transmission(wavelength, cutoff)))
    phase = 2 * np.pi * (np.arange(200) + 0.5) / 200
    z = left[0] * np.sin(phase)[:, None] + left[1] * np.sin(phase)[None, :]
    want = [z.std(), 0.0, np.mean(z**4) / z.std() ** 4]
    got = parameters(ripple_cumulants(amplitude, wavelength, cutoff))
    assert_close(got, want, rtol=1e-10, atol=1e-12)
    assert_gradient(
        lambda x: jnp.stack(list(ripple_cumulants(x[:2], x[2:4], x[4]))),
        S([1.0, 2.0, 0.5, 2.0, 0.8]),
    )


def test_combination_of_known_parts():
    rng = np.random.default_rng(0)
    # a discrete skewed part and a wave, every pair once
    skewed, wave = rng.exponential(size=50), np.sin(2 * np.pi * (np.arange(40) + 0.5) / 40)
    z = skewed[:, None] + 2 * wave[None, :]
    m2, m3 = skewed.var(), np.mean((skewed - skewed.mean()) ** 3)
    m4 = np.mean((skewed - skewed.mean()) ** 4)
    texture = combine(
        Cumulants(m2, m3, m4 - 3 * m2**2), ripple_cumulants(S([2.0]), S([1.0]))
    )
    p = heights_of(S(z))
    got = jnp.stack([texture.Sq, texture.Ssk, texture.Sku])
    assert_close(got, jnp.stack([p.Sq, p.Ssk, p.Sku]), rtol=1e-10)
    assert_close(texture.Sa, p.Sa, rtol=0.03)


def test_no_height_at_all():
    texture = combine(Cumulants(), Cumulants())
    assert_close(jnp.stack(jax.tree.leaves(texture)), [0.0, 0.0, 0.0, 3.0])


@jax.jit
def patch_moments(keys, part, pressure, removal, extent, waves):
    def draw(key):
        z = draw_patch(key, part, pressure, removal, (12, 16), extent, 384, *waves)
        return jnp.stack([jnp.mean(z), jnp.mean(z**2), jnp.mean(z**3), jnp.mean(z**4)])

    return jax.lax.map(draw, keys, batch_size=100)


def test_patches_with_ripple_agree_with_the_cumulants():
    part, pressure = abrasive(depth_variation=0.5), S(0.05)
    depth, worn = groove_depth(part, pressure), compression(part, pressure)
    removal, extent = 1.5 * worn, jnp.stack([60.0, 80.0]) * depth
    waves = (jnp.stack([0.4 * depth]), jnp.stack([7.3 * depth]))

    patches = patch_moments(
        jr.split(jr.key(3), 900), part, pressure, removal, extent, waves
    )
    patches = np.asarray(patches) / np.asarray(depth) ** np.arange(1, 5)
    groove, ripple = groove_cumulants(part, pressure, removal), ripple_cumulants(*waves)
    k2, k3, k4 = (
        float((a + b) / depth**n) for n, a, b in zip((2, 3, 4), groove, ripple, strict=True)
    )
    # about the expected mean the moments of patches are unbiased, however small they are
    want = np.array([0.0, k2, k3, k4 + 3 * k2**2])
    error = patches.std(axis=0) / 30
    assert (error[1:] < 0.08 * abs(want[1:])).all()
    assert (abs(patches.mean(axis=0) - want) < 4 * error).all()


def test_patch_of_latest_grooves_and_its_start():
    part, pressure = abrasive(), S(0.05)
    worn, depth = compression(part, pressure), groove_depth(part, pressure)
    extent = jnp.full(2, 20.0) * depth

    @jax.jit
    def draw(removal, start):
        key = jr.key(0)
        return draw_patch(key, part, pressure, removal, (16, 16), extent, 512, start=start)

    flat, start = jnp.zeros((16, 16)), wavy_map() * depth
    bare = draw(9 * worn, flat)
    assert_close(draw(9 * worn, start) - bare, start, atol=1e-9 * float(depth))
    assert_close(draw(9 * worn, flat), bare, rtol=0)
    # the 512 latest grooves reach back to all that matters, so more removal adds nothing
    assert_close(draw(12 * worn, flat), bare, atol=5e-3 * float(depth))
    assert_close(draw(S(0.0), flat), 0.0)
