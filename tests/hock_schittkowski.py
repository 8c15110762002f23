"""Forty problems of Hock & Schittkowski (1981), Test examples for nonlinear programming.

The book's constraints `g >= 0` stand here as `-g <= 0`, bounds are kept apart, and starts
are the book's. Its optima are given in closed form where there is one; HS106 and HS112 were
improved on later (the book prints 7049.33 and -47.7076), and these values are used. All of
them are checked against scipy's SLSQP in `test_hock_schittkowski`.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np


INF = float("inf")
R2, R3, R7 = 2**0.5, 3**0.5, 7**0.5
WIDE = 10  # unknowns of the largest problem


def at_least_0(*terms):
    """Inequalities as the book has them, turned round."""
    return -jnp.stack(terms)


def zero(*terms):
    return jnp.stack(terms)


class Problem(eqx.Module):
    objective: Callable
    inequality: Callable | None
    equality: Callable | None
    start: list
    lower: object
    upper: object
    best: float
    """Published optimum."""

    def ends(self):
        """Start and bounds as arrays."""
        start = np.array(self.start, dtype=float)
        bounds = (np.array(b, dtype=float) for b in (self.lower, self.upper))
        return start, *(np.broadcast_to(b, start.shape) for b in bounds)


def rosenbrock(x):
    return 100 * (x[1] - x[0] ** 2) ** 2 + (1 - x[0]) ** 2


def wood(x):
    a, b, c, d = x
    return (
        100 * (b - a**2) ** 2
        + (1 - a) ** 2
        + 90 * (d - c**2) ** 2
        + (1 - c) ** 2
        + 10.1 * ((b - 1) ** 2 + (d - 1) ** 2)
        + 19.8 * (b - 1) * (d - 1)
    )


def hs43(x):
    a, b, c, d = x
    return a**2 + b**2 + 2 * c**2 + d**2 - 5 * a - 5 * b - 21 * c + 7 * d


def hs43_limits(x):
    a, b, c, d = x
    return at_least_0(
        8 - a**2 - b**2 - c**2 - d**2 - a + b - c + d,
        10 - a**2 - 2 * b**2 - c**2 - 2 * d**2 + a + d,
        5 - 2 * a**2 - b**2 - c**2 - 2 * a + b + d,
    )


def hs62(x):
    a, b, c = x
    terms = (
        255 * jnp.log((a + b + c + 0.03) / (0.09 * a + b + c + 0.03)),
        280 * jnp.log((b + c + 0.03) / (0.07 * b + c + 0.03)),
        290 * jnp.log((c + 0.03) / (0.13 * c + 0.03)),
    )
    return -32.174 * sum(terms)


def hs73_limits(x):
    a, b, c, d = x
    spread = jnp.sqrt(0.28 * a**2 + 0.19 * b**2 + 20.5 * c**2 + 0.62 * d**2)
    return at_least_0(
        2.3 * a + 5.6 * b + 11.1 * c + 1.3 * d - 5,
        12 * a + 11.9 * b + 41.8 * c + 52.1 * d - 21 - 1.645 * spread,
    )


def hs74(x):
    a, b, _, _ = x
    return 3 * a + 1e-6 * a**3 + 2 * b + 2e-6 / 3 * b**3


def hs74_flows(x):
    a, b, c, d = x
    return zero(
        1000 * jnp.sin(-c - 0.25) + 1000 * jnp.sin(-d - 0.25) + 894.8 - a,
        1000 * jnp.sin(c - 0.25) + 1000 * jnp.sin(c - d - 0.25) + 894.8 - b,
        1000 * jnp.sin(d - 0.25) + 1000 * jnp.sin(d - c - 0.25) + 1294.8,
    )


def hs76(x):
    a, b, c, d = x
    square = a**2 + 0.5 * b**2 + c**2 + 0.5 * d**2
    return square - a * c + c * d - a - 3 * b + c - d


def hs78_equalities(x):
    a, b, c, d, e = x
    return zero(jnp.sum(x**2) - 10, b * c - 5 * d * e, a**3 + b**3 + 1)


def hs83_limits(x):
    a, b, c, d, e = x
    first = 85.334407 + 0.0056858 * b * e + 0.0006262 * a * d - 0.0022053 * c * e
    second = 80.51249 + 0.0071317 * b * e + 0.0029955 * a * b + 0.0021813 * c**2
    third = 9.300961 + 0.0047026 * c * e + 0.0012547 * a * c + 0.0019085 * c * d
    return at_least_0(first, 92 - first, second - 90, 110 - second, third - 20, 25 - third)


HS86_LINEAR = np.array([-15.0, -27, -36, -18, -12])
HS86_SQUARE = np.array(
    [
        [30.0, -20, -10, 32, -10],
        [-20, 39, -6, -31, 32],
        [-10, -6, 10, -6, -10],
        [32, -31, -6, 39, -20],
        [-10, 32, -10, -20, 30],
    ]
)
HS86_CUBE = np.array([4.0, 8, 10, 6, 2])
HS86_ROWS = np.array(
    [
        [-16, 2, 0, 1, 0],
        [0, -2, 0, 0.4, 2],
        [-3.5, 0, 2, 0, 0],
        [0, -2, 0, -4, -1],
        [0, -9, -2, 1, -2.8],
        [2, 0, -4, 0, 0],
        [-1, -1, -1, -1, -1],
        [-1, -2, -3, -2, -1],
        [1, 2, 3, 4, 5],
        [1, 1, 1, 1, 1],
    ]
)
HS86_LEAST = np.array([-40.0, -2, -0.25, -4, -4, -1, -40, -60, 5, 1])


def hs86(x):
    return HS86_LINEAR @ x + x @ (HS86_SQUARE @ x) + HS86_CUBE @ x**3


def hs93_parts(x):
    a, b, c, d, _, _ = x
    return a * d * (a + b + c), b * c * (a + 1.57 * b + d)


def hs93(x):
    first, second = hs93_parts(x)
    e, f = x[4] ** 2, x[5] ** 2
    fixed = 0.0204 * first + 0.0187 * second
    return fixed + 0.0607 * first * e + 0.0437 * second * f


def hs93_limits(x):
    first, second = hs93_parts(x)
    return at_least_0(
        0.001 * jnp.prod(x) - 2.07,
        1 - 0.00062 * first * x[4] ** 2 - 0.00058 * second * x[5] ** 2,
    )


def hs100(x):
    a, b, c, d, e, f, g = x
    squares = (a - 10) ** 2 + 5 * (b - 12) ** 2 + 3 * (d - 11) ** 2 + 7 * f**2
    return squares + c**4 + 10 * e**6 + g**4 - 4 * f * g - 10 * f - 8 * g


def hs100_limits(x):
    a, b, c, d, e, f, g = x
    return at_least_0(
        127 - 2 * a**2 - 3 * b**4 - c - 4 * d**2 - 5 * e,
        282 - 7 * a - 3 * b - 10 * c**2 - d + e,
        196 - 23 * a - b**2 - 6 * f**2 + 8 * g,
        -4 * a**2 - b**2 + 3 * a * b - 2 * c**2 - 5 * f + 11 * g,
    )


def hs104(x):
    first = 0.4 * (x[0] / x[6]) ** 0.67 + 0.4 * (x[1] / x[7]) ** 0.67
    return first + 10 - x[0] - x[1]


def hs104_limits(x):
    a, b, c, d, e, f, g, h = x
    value = hs104(x)
    return at_least_0(
        1 - 0.0588 * e * g - 0.1 * a,
        1 - 0.0588 * f * h - 0.1 * a - 0.1 * b,
        1 - 4 * c / e - 2 * c**-0.71 / e - 0.0588 * c**-1.3 * g,
        1 - 4 * d / f - 2 * d**-0.71 / f - 0.0588 * d**-1.3 * h,
        value - 1,
        4.2 - value,
    )


def hs106_limits(x):
    a, b, c, d, e, f, g, h = x
    return at_least_0(
        1 - 0.0025 * (d + f),
        1 - 0.0025 * (e + g - d),
        1 - 0.01 * (h - e),
        a * f - 833.33252 * d - 100 * a + 83333.333,
        b * g - 1250 * e - b * d + 1250 * d,
        c * h - 1250000 - c * e + 2500 * e,
    )


HS112_PULL = np.array(
    [-6.089, -17.164, -34.054, -5.914, -24.721, -14.986, -24.1, -10.708, -26.662, -22.179]
)


def hs113(x):
    a, b, c, d, e, f, g, h, i, j = x
    first = a**2 + b**2 + a * b - 14 * a - 16 * b + (c - 10) ** 2 + 4 * (d - 5) ** 2
    second = (e - 3) ** 2 + 2 * (f - 1) ** 2 + 5 * g**2 + 7 * (h - 11) ** 2
    return first + second + 2 * (i - 10) ** 2 + (j - 7) ** 2 + 45


def hs113_limits(x):
    a, b, c, d, e, f, g, h, i, j = x
    return at_least_0(
        105 - 4 * a - 5 * b + 3 * g - 9 * h,
        -10 * a + 8 * b + 17 * g - 2 * h,
        8 * a - 2 * b - 5 * i + 2 * j + 12,
        -3 * (a - 2) ** 2 - 4 * (b - 3) ** 2 - 2 * c**2 + 7 * d + 120,
        -5 * a**2 - 8 * b - (c - 6) ** 2 + 2 * d + 40,
        -0.5 * (a - 8) ** 2 - 2 * (b - 4) ** 2 - 3 * e**2 + f + 30,
        -(a**2) - 2 * (b - 2) ** 2 + 2 * a * b - 14 * e + 6 * f,
        3 * a - 6 * b - 12 * (i - 8) ** 2 + 7 * j,
    )


PROBLEMS = {
    "HS1": Problem(
        rosenbrock, None, None, [-2, 1], [-INF, -1.5], INF, 0.0,
    ),
    "HS4": Problem(
        lambda x: (x[0] + 1) ** 3 / 3 + x[1], None, None,
        [1.125, 0.125], [1, 0], INF, 8 / 3,
    ),
    "HS5": Problem(
        lambda x: jnp.sin(x[0] + x[1]) + (x[0] - x[1]) ** 2 - 1.5 * x[0] + 2.5 * x[1] + 1,
        None, None, [0, 0], [-1.5, -3], [4, 3], -R3 / 2 - np.pi / 3,
    ),
    "HS6": Problem(
        lambda x: (1 - x[0]) ** 2, None, lambda x: zero(10 * (x[1] - x[0] ** 2)),
        [-1.2, 1], -INF, INF, 0.0,
    ),
    "HS7": Problem(
        lambda x: jnp.log(1 + x[0] ** 2) - x[1], None,
        lambda x: zero((1 + x[0] ** 2) ** 2 + x[1] ** 2 - 4),
        [2, 2], -INF, INF, -R3,
    ),
    "HS9": Problem(
        lambda x: jnp.sin(np.pi * x[0] / 12) * jnp.cos(np.pi * x[1] / 16), None,
        lambda x: zero(4 * x[0] - 3 * x[1]), [0, 0], -INF, INF, -0.5,
    ),
    "HS10": Problem(
        lambda x: x[0] - x[1],
        lambda x: at_least_0(-3 * x[0] ** 2 + 2 * x[0] * x[1] - x[1] ** 2 + 1), None,
        [-10, 10], -INF, INF, -1.0,
    ),
    "HS11": Problem(
        lambda x: (x[0] - 5) ** 2 + x[1] ** 2 - 25,
        lambda x: at_least_0(x[1] - x[0] ** 2), None,
        [4.9, 0.1], -INF, INF, -8.498464223,
    ),
    "HS12": Problem(
        lambda x: 0.5 * x[0] ** 2 + x[1] ** 2 - x[0] * x[1] - 7 * x[0] - 7 * x[1],
        lambda x: at_least_0(25 - 4 * x[0] ** 2 - x[1] ** 2), None,
        [0, 0], -INF, INF, -30.0,
    ),
    "HS14": Problem(
        lambda x: (x[0] - 2) ** 2 + (x[1] - 1) ** 2,
        lambda x: at_least_0(1 - 0.25 * x[0] ** 2 - x[1] ** 2),
        lambda x: zero(x[0] - 2 * x[1] + 1), [2, 2], -INF, INF, 9 - 2.875 * R7,
    ),
    "HS15": Problem(
        rosenbrock, lambda x: at_least_0(x[0] * x[1] - 1, x[0] + x[1] ** 2), None,
        [-2, 1], -INF, [0.5, INF], 306.5,
    ),
    "HS18": Problem(
        lambda x: 0.01 * x[0] ** 2 + x[1] ** 2,
        lambda x: at_least_0(x[0] * x[1] - 25, x[0] ** 2 + x[1] ** 2 - 25), None,
        [2, 2], [2, 0], 50, 5.0,
    ),
    "HS19": Problem(
        lambda x: (x[0] - 10) ** 3 + (x[1] - 20) ** 3,
        lambda x: at_least_0(
            (x[0] - 5) ** 2 + (x[1] - 5) ** 2 - 100,
            82.81 - (x[1] - 5) ** 2 - (x[0] - 6) ** 2,
        ),
        None, [20.1, 5.84], [13, 0], 100, -6961.813876,
    ),
    "HS22": Problem(
        lambda x: (x[0] - 2) ** 2 + (x[1] - 1) ** 2,
        lambda x: at_least_0(2 - x[0] - x[1], x[1] - x[0] ** 2), None,
        [2, 2], -INF, INF, 1.0,
    ),
    "HS24": Problem(
        lambda x: ((x[0] - 3) ** 2 - 9) * x[1] ** 3 / (27 * R3),
        lambda x: at_least_0(
            x[0] / R3 - x[1], x[0] + R3 * x[1], 6 - x[0] - R3 * x[1]
        ),
        None, [1, 0.5], 0, INF, -1.0,
    ),
    "HS29": Problem(
        lambda x: -jnp.prod(x),
        lambda x: at_least_0(48 - x[0] ** 2 - 2 * x[1] ** 2 - 4 * x[2] ** 2), None,
        [1, 1, 1], -INF, INF, -16 * R2,
    ),
    "HS31": Problem(
        lambda x: 9 * x[0] ** 2 + x[1] ** 2 + 9 * x[2] ** 2,
        lambda x: at_least_0(x[0] * x[1] - 1), None,
        [1, 1, 1], [-10, 1, -10], [10, 10, 1], 6.0,
    ),
    "HS32": Problem(
        lambda x: (x[0] + 3 * x[1] + x[2]) ** 2 + 4 * (x[0] - x[1]) ** 2,
        lambda x: at_least_0(6 * x[1] + 4 * x[2] - x[0] ** 3 - 3),
        lambda x: zero(1 - jnp.sum(x)), [0.1, 0.7, 0.2], 0, INF, 1.0,
    ),
    "HS34": Problem(
        lambda x: -x[0],
        lambda x: at_least_0(x[1] - jnp.exp(x[0]), x[2] - jnp.exp(x[1])), None,
        [0, 1.05, 2.9], 0, [100, 100, 10], -np.log(np.log(10)),
    ),
    "HS35": Problem(
        lambda x: 9 - 8 * x[0] - 6 * x[1] - 4 * x[2] + 2 * x[0] ** 2 + 2 * x[1] ** 2
        + x[2] ** 2 + 2 * x[0] * x[1] + 2 * x[0] * x[2],
        lambda x: at_least_0(3 - x[0] - x[1] - 2 * x[2]), None,
        [0.5, 0.5, 0.5], 0, INF, 1 / 9,
    ),
    "HS36": Problem(
        lambda x: -jnp.prod(x),
        lambda x: at_least_0(72 - x[0] - 2 * x[1] - 2 * x[2]), None,
        [10, 10, 10], 0, [20, 11, 42], -3300.0,
    ),
    "HS37": Problem(
        lambda x: -jnp.prod(x),
        lambda x: at_least_0(
            72 - x[0] - 2 * x[1] - 2 * x[2], x[0] + 2 * x[1] + 2 * x[2]
        ),
        None, [10, 10, 10], 0, 42, -3456.0,
    ),
    "HS38": Problem(wood, None, None, [-3, -1, -3, -1], -10, 10, 0.0),
    "HS39": Problem(
        lambda x: -x[0], None,
        lambda x: zero(x[1] - x[0] ** 3 - x[2] ** 2, x[0] ** 2 - x[1] - x[3] ** 2),
        [2, 2, 2, 2], -INF, INF, -1.0,
    ),
    "HS40": Problem(
        lambda x: -jnp.prod(x), None,
        lambda x: zero(
            x[0] ** 3 + x[1] ** 2 - 1, x[0] ** 2 * x[3] - x[2], x[3] ** 2 - x[1]
        ),
        [0.8] * 4, -INF, INF, -0.25,
    ),
    "HS41": Problem(
        lambda x: 2 - x[0] * x[1] * x[2], None,
        lambda x: zero(x[0] + 2 * x[1] + 2 * x[2] - x[3]),
        [2] * 4, 0, [1, 1, 1, 2], 52 / 27,
    ),
    "HS43": Problem(hs43, hs43_limits, None, [0] * 4, -INF, INF, -44.0),
    "HS45": Problem(
        lambda x: 2 - jnp.prod(x) / 120, None, None, [2] * 5, 0, [1, 2, 3, 4, 5], 1.0,
    ),
    "HS52": Problem(
        lambda x: (4 * x[0] - x[1]) ** 2 + (x[1] + x[2] - 2) ** 2
        + (x[3] - 1) ** 2 + (x[4] - 1) ** 2,
        None,
        lambda x: zero(x[0] + 3 * x[1], x[2] + x[3] - 2 * x[4], x[1] - x[4]),
        [2] * 5, -INF, INF, 1859 / 349,
    ),
    "HS53": Problem(
        lambda x: (x[0] - x[1]) ** 2 + (x[1] + x[2] - 2) ** 2
        + (x[3] - 1) ** 2 + (x[4] - 1) ** 2,
        None,
        lambda x: zero(x[0] + 3 * x[1], x[2] + x[3] - 2 * x[4], x[1] - x[4]),
        [2] * 5, -10, 10, 176 / 43,
    ),
    "HS60": Problem(
        lambda x: (x[0] - 1) ** 2 + (x[0] - x[1]) ** 2 + (x[1] - x[2]) ** 4, None,
        lambda x: zero(x[0] * (1 + x[1] ** 2) + x[2] ** 4 - 4 - 3 * R2),
        [2] * 3, -10, 10, 0.03256820025,
    ),
    "HS62": Problem(
        hs62, None, lambda x: zero(jnp.sum(x) - 1), [0.7, 0.2, 0.1], 0, 1, -26272.51448,
    ),
    "HS63": Problem(
        lambda x: 1000 - x[0] ** 2 - 2 * x[1] ** 2 - x[2] ** 2 - x[0] * (x[1] + x[2]),
        None,
        lambda x: zero(8 * x[0] + 14 * x[1] + 7 * x[2] - 56, jnp.sum(x**2) - 25),
        [2] * 3, 0, INF, 961.7151721,
    ),
    "HS64": Problem(
        lambda x: 5 * x[0] + 5e4 / x[0] + 20 * x[1] + 7.2e4 / x[1] + 10 * x[2]
        + 1.44e5 / x[2],
        lambda x: at_least_0(1 - 4 / x[0] - 32 / x[1] - 120 / x[2]), None,
        [1] * 3, 1e-5, INF, 6299.842428,
    ),
    "HS65": Problem(
        lambda x: (x[0] - x[1]) ** 2 + (x[0] + x[1] - 10) ** 2 / 9 + (x[2] - 5) ** 2,
        lambda x: at_least_0(48 - jnp.sum(x**2)), None,
        [-5, 5, 0], [-4.5, -4.5, -5], [4.5, 4.5, 5], 0.9535288567,
    ),
    "HS66": Problem(
        lambda x: 0.2 * x[2] - 0.8 * x[0],
        lambda x: at_least_0(x[1] - jnp.exp(x[0]), x[2] - jnp.exp(x[1])), None,
        [0, 1.05, 2.9], 0, [100, 100, 10], 0.5181632741,
    ),
    "HS71": Problem(
        lambda x: x[0] * x[3] * (x[0] + x[1] + x[2]) + x[2],
        lambda x: at_least_0(jnp.prod(x) - 25), lambda x: zero(jnp.sum(x**2) - 40),
        [1, 5, 5, 1], 1, 5, 17.0140173,
    ),
    "HS72": Problem(
        lambda x: 1 + jnp.sum(x),
        lambda x: at_least_0(
            0.0401 - 4 / x[0] - 2.25 / x[1] - 1 / x[2] - 0.25 / x[3],
            0.010085 - 0.16 / x[0] - 0.36 / x[1] - 0.64 / x[2] - 0.64 / x[3],
        ),
        None, [1] * 4, 0.001, [4e5, 3e5, 2e5, 1e5], 727.67937,
    ),
    "HS73": Problem(
        lambda x: 24.55 * x[0] + 26.75 * x[1] + 39 * x[2] + 40.5 * x[3],
        hs73_limits, lambda x: zero(jnp.sum(x) - 1), [1] * 4, 0, INF, 29.894378,
    ),
    "HS74": Problem(
        hs74, lambda x: at_least_0(x[3] - x[2] + 0.55, x[2] - x[3] + 0.55), hs74_flows,
        [0] * 4, [0, 0, -0.55, -0.55], [1200, 1200, 0.55, 0.55], 5126.4981,
    ),
    "HS76": Problem(
        hs76,
        lambda x: at_least_0(
            5 - x[0] - 2 * x[1] - x[2] - x[3],
            4 - 3 * x[0] - x[1] - 2 * x[2] + x[3],
            x[1] + 4 * x[2] - 1.5,
        ),
        None, [0.5] * 4, 0, INF, -4.681818182,
    ),
    "HS77": Problem(
        lambda x: (x[0] - 1) ** 2 + (x[0] - x[1]) ** 2 + (x[2] - 1) ** 2
        + (x[3] - 1) ** 4 + (x[4] - 1) ** 6,
        None,
        lambda x: zero(
            x[0] ** 2 * x[3] + jnp.sin(x[3] - x[4]) - 2 * R2,
            x[1] + x[2] ** 4 * x[3] ** 2 - 8 - R2,
        ),
        [2] * 5, -INF, INF, 0.24150513,
    ),
    "HS78": Problem(
        lambda x: jnp.prod(x), None, hs78_equalities,
        [-2, 1.5, 2, -1, -1], -INF, INF, -2.91970041,
    ),
    "HS79": Problem(
        lambda x: (x[0] - 1) ** 2 + (x[0] - x[1]) ** 2 + (x[1] - x[2]) ** 2
        + (x[2] - x[3]) ** 4 + (x[3] - x[4]) ** 4,
        None,
        lambda x: zero(
            x[0] + x[1] ** 2 + x[2] ** 3 - 2 - 3 * R2,
            x[1] - x[2] ** 2 + x[3] + 2 - 2 * R2,
            x[0] * x[4] - 2,
        ),
        [2] * 5, -INF, INF, 0.0787768209,
    ),
    "HS80": Problem(
        lambda x: jnp.exp(jnp.prod(x)), None, hs78_equalities, [-2, 2, 2, -1, -1],
        [-2.3, -2.3, -3.2, -3.2, -3.2], [2.3, 2.3, 3.2, 3.2, 3.2], 0.0539498478,
    ),
    "HS83": Problem(
        lambda x: 5.3578547 * x[2] ** 2 + 0.8356891 * x[0] * x[4] + 37.293239 * x[0]
        - 40792.141,
        hs83_limits, None, [78, 33, 27, 27, 27], [78, 33, 27, 27, 27],
        [102, 45, 45, 45, 45], -30665.53867,
    ),
    "HS86": Problem(
        hs86, lambda x: HS86_LEAST - HS86_ROWS @ x, None,
        [0, 0, 0, 0, 1], 0, INF, -32.34867897,
    ),
    "HS93": Problem(
        hs93, hs93_limits, None, [5.54, 4.4, 12.02, 11.8, 0.702, 0.852], 0, INF, 135.075961,
    ),
    "HS100": Problem(
        hs100, hs100_limits, None, [1, 2, 0, 4, 0, 1, 1], -INF, INF, 680.6300573,
    ),
    "HS104": Problem(
        hs104, hs104_limits, None, [6, 3, 0.4, 0.2, 6, 6, 1, 0.5], 0.1, 10, 3.9511634396,
    ),
    "HS106": Problem(
        lambda x: x[0] + x[1] + x[2], hs106_limits, None,
        [5000, 5000, 5000, 200, 350, 150, 225, 425], [100, 1000, 1000, *[10] * 5],
        [10000, 10000, 10000, *[1000] * 5], 7049.24802,
    ),
    "HS110": Problem(
        lambda x: jnp.sum(jnp.log(x - 2) ** 2 + jnp.log(10 - x) ** 2) - jnp.prod(x) ** 0.2,
        None, None, [9] * 10, 2.001, 9.999, -45.77846971,
    ),
    "HS112": Problem(
        lambda x: x @ (HS112_PULL + jnp.log(x / jnp.sum(x))), None,
        lambda x: zero(
            x[0] + 2 * x[1] + 2 * x[2] + x[5] + x[9] - 2,
            x[3] + 2 * x[4] + x[5] + x[6] - 1,
            x[2] + x[6] + x[7] + 2 * x[8] + x[9] - 1,
        ),
        [0.1] * 10, 1e-6, INF, -47.76109026,
    ),
    "HS113": Problem(
        hs113, hs113_limits, None, [2, 3, 5, 5, 1, 2, 7, 3, 6, 10], -INF, INF, 24.3062091,
    ),
}  # fmt: skip

NAMES = tuple(PROBLEMS)
MOST = 10  # inequalities of the one with most of them, HS86
EQUAL = 3  # equalities


def padded(index, x):
    """Objective, inequalities and equalities of problem number `index`, all of one shape.

    Surplus unknowns are ignored, surplus limits hold: one compilation serves for all.
    """

    def branch(problem):
        count = len(problem.start)

        def values(x):
            x = x[:count]
            inequality, equality = jnp.full(MOST, -1.0), jnp.zeros(EQUAL)
            if problem.inequality is not None:
                g = problem.inequality(x)
                inequality = inequality.at[: g.size].set(g)
            if problem.equality is not None:
                h = problem.equality(x)
                equality = equality.at[: h.size].set(h)
            return problem.objective(x), inequality, equality

        return values

    return jax.lax.switch(index, [branch(p) for p in PROBLEMS.values()], x)


def padded_ends(problem):
    """Start and bounds with surplus unknowns that are fixed at 0."""
    return tuple(np.pad(a, (0, WIDE - a.size)) for a in problem.ends())
