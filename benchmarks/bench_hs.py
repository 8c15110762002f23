"""The problems of Hock & Schittkowski: `minimise` beside scipy's SLSQP.

Both start from the book's start with the same exact slopes. A row says how far the end is
from the published optimum (relative, above 1), how much it violates, the largest entry of
the Lagrangian's projected gradient in the user's units (ours), and how many points were
evaluated. What misses 1e-6, 1e-8 and 1e-6 is marked. Run it as
`python benchmarks/bench_hs.py [HS71 ...]`.
"""

import pathlib
import sys


sys.path.insert(0, str(pathlib.Path(__file__).parents[1] / "tests"))

import jax  # noqa: E402
import numpy as np  # noqa: E402


jax.config.update("jax_enable_x64", True)

from hock_schittkowski import NAMES, PROBLEMS  # noqa: E402
from polishopt.optimize import Status  # noqa: E402
from test_hock_schittkowski import answer, at, slsqp  # noqa: E402


def row(name):
    """One problem under both solvers; whether ours passes, whether SLSQP does."""
    problem, got = PROBLEMS[name], answer(name)
    size = max(1.0, abs(problem.best))
    count = len(problem.start)
    (value, g, h), (slope, dg, dh) = at(name, got.x)
    rest = slope + got.inequality_multipliers @ dg + got.equality_multipliers @ dh
    kkt = np.abs((rest + got.bound_multipliers)[:count]).max()
    violation = max(g.max(), np.abs(h).max(), 0.0)
    error = abs(value - problem.best) / size
    good = error <= 1e-6 and violation <= 1e-8 and kkt <= 1e-6
    good = good and int(got.status) == Status.SOLVED
    found, theirs = slsqp(name)
    theirs = max(theirs, 0.0)
    miss = abs(found.fun - problem.best) / size
    fair = miss <= 1e-6 and theirs <= 1e-6
    print(
        f"{name:6s} {count:3d} {float(value):15.8g} {error:8.0e} {violation:9.0e} "
        f"{kkt:7.0e} {int(got.evaluations):5d} {'' if good else 'MISS':4s} | "
        f"{miss:8.0e} {theirs:9.0e} {found.nfev:5d} {'' if fair else 'MISS'}"
    )
    return good, fair, int(got.evaluations), found.nfev


def main():
    print(
        "problem n       objective    error violation     kkt evals      |    SLSQP: error"
    )
    rows = np.array([row(name) for name in sys.argv[1:] or NAMES], dtype=int)
    good, fair, ours, theirs = rows.sum(axis=0)
    print(
        f"{len(rows)} problems: {good} to tolerance in {ours} evaluations; SLSQP {fair} "
        f"(violation to 1e-6) in {theirs} evaluations"
    )


if __name__ == "__main__":
    main()
