"""Evaluations and time of the constrained solver, beside what else there is.

Three tables: bounds through a map under optimistix's own Levenberg-Marquardt against steps
that stay in the box; the problems of `tests/test_auglag.py` against scipy's SLSQP, which
shares the problems and exact Jacobians but runs on the host; and many starts under `vmap`.
Run it as `python benchmarks/bench_auglag.py`.
"""

import pathlib
import sys
import time
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import scipy.optimize


sys.path.insert(0, str(pathlib.Path(__file__).parents[1] / "tests"))
jax.config.update("jax_enable_x64", True)

from polishopt.optimize import BoxLevenbergMarquardt, Status, solve  # noqa: E402
from test_auglag import CASES  # noqa: E402


def rosenbrock(x):
    return jnp.stack([10 * (x[1] - x[0] ** 2), 1 - x[0]])


def corner(x):
    return jnp.stack([x[0] - 2, x[1] + 2, x[0] + x[1] - 0.3, x[2] - 0.5])


def powell(x):
    a, b, c, d = x
    terms = [a + 10 * b, 5**0.5 * (c - d), (b - 2 * c) ** 2, 10**0.5 * (a - d) ** 2]
    return jnp.stack(terms)


BOUNDED = {
    "rosenbrock, x <= 0.5": (rosenbrock, [-1.2, 1.0], [-2.0, -2.0], [0.5, 2.0]),
    "linear, two bounds": (corner, [0.5, 0.5, 0.2], [0.0] * 3, [1.0] * 3),
    "powell, x >= 0.3": (powell, [1.0, 0.9, 0.8, 1.0], [0.3, -4.0, -4.0, -4.0], [4.0] * 4),
}

# from the unit interval's middle outwards: (from free to [0, 1], and back)
MAPS = {
    "sine": (lambda y: 0.5 + 0.5 * jnp.sin(y), lambda t: jnp.arcsin(2 * t - 1)),
    "logistic": (jax.nn.sigmoid, lambda t: jnp.log(t / (1 - t))),
}


def bounds():
    print("bounds: steps, and the projected gradient at the end (at most 500 steps)")
    for name, (residual, start, lower, upper) in BOUNDED.items():
        start, lower, upper = (jnp.array(a) for a in (start, lower, upper))
        width = upper - lower

        def kkt(x, residual=residual, lower=lower, width=width):
            slope = jax.grad(lambda x: 0.5 * jnp.sum(residual(x) ** 2))(x) * width
            t = (x - lower) / width
            return float(jnp.max(jnp.abs(jnp.clip(t - slope, 0, 1) - t)))

        row = [f"{name:22s}"]
        for label, (out, back) in MAPS.items():
            answer = optx.least_squares(
                lambda y, _, out=out, low=lower, w=width, r=residual: r(low + w * out(y)),
                optx.LevenbergMarquardt(rtol=1e-10, atol=1e-10),
                back((start - lower) / width),
                max_steps=500,
                throw=False,
            )
            x = lower + width * out(answer.value)
            row.append(f"{label} {int(answer.stats['num_steps']):4d} {kkt(x):.0e}")
        answer = optx.least_squares(
            lambda x, _, r=residual: r(x),
            BoxLevenbergMarquardt(rtol=1e-10, atol=1e-10),
            start,
            options={"lower": lower, "upper": upper},
            max_steps=500,
            throw=False,
        )
        steps, x = int(answer.stats["num_steps"]), answer.value
        print("   ".join([*row, f"box {steps:4d} {kkt(x):.0e}"]))


def slsqp(case):
    """Evaluations and objective of SLSQP on a case of the tests."""

    def host(f, sign=1.0) -> dict[str, Any]:
        value, slope = jax.jit(f), jax.jit(jax.jacfwd(f))
        return {
            "fun": lambda x: sign * np.asarray(value(jnp.asarray(x))),
            "jac": lambda x: sign * np.asarray(slope(jnp.asarray(x))),
        }

    constraints = []
    if case.equality is not None:
        constraints.append({"type": "eq", **host(case.equality)})
    if case.inequality is not None:
        constraints.append({"type": "ineq", **host(case.inequality, -1.0)})
    start = np.array(case.start)
    low, high = (np.broadcast_to(b, start.shape) for b in (case.lower, case.upper))
    answer = scipy.optimize.minimize(
        x0=start,
        **host(lambda x: 0.5 * jnp.sum(case.residual(x) ** 2)),
        bounds=list(zip(low, high, strict=True)),
        constraints=constraints,
        method="SLSQP",
        options={"ftol": 1e-14, "maxiter": 500},
    )
    return answer.nfev, answer.fun


def problems():
    print("\nproblem              evaluations outer    kkt  violation   f - f*  | SLSQP")
    total = 0
    for name, case in CASES.items():
        got = case.solve()
        total += int(got.evaluations)
        nfev, fun = slsqp(case)
        print(
            f"{name:20s} {int(got.evaluations):11d} {int(got.outer_steps):5d} "
            f"{float(got.kkt):6.0e} {float(got.violation):10.0e} "
            f"{float(got.objective) - case.objective:8.0e}  | {nfev:5d} "
            f"{fun - case.objective:7.0e}  {Status(int(got.status)).name.lower()}"
        )
    print(f"{'all':20s} {total:11d}")


def starts(number=16):
    print(f"\n{number} starts under vmap: evaluations, compile and run time")
    for name in ("HS65", "HS71", "HS43"):
        case = CASES[name]
        low, high = (np.broadcast_to(b, len(case.start)) for b in (case.lower, case.upper))
        inside = np.clip(low, -6, None), np.clip(high, None, 6)
        points = np.random.default_rng(0).uniform(*inside, (number, len(case.start)))

        def run(start, case=case, low=low, high=high):
            return solve(
                case.residual, case.inequality, start, low, high, equality=case.equality
            )

        begin = time.perf_counter()
        program = jax.jit(jax.vmap(run)).lower(jnp.asarray(points)).compile()
        compiled = time.perf_counter()
        got = jax.block_until_ready(program(jnp.asarray(points)))
        begun = time.perf_counter()
        got = jax.block_until_ready(program(jnp.asarray(points)))
        ended = time.perf_counter()
        print(
            f"{name:20s} median {int(jnp.median(got.evaluations)):3d} "
            f"most {int(jnp.max(got.evaluations)):3d}, solved "
            f"{int(jnp.sum(got.status == Status.SOLVED))}, "
            f"compile {compiled - begin:.1f} s, run {1e3 * (ended - begun):.1f} ms"
        )


if __name__ == "__main__":
    bounds()
    problems()
    starts()
