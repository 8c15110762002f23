"""Variance: Sobol indices against their closed form, and what steady outcomes do."""

import dataclasses
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close
from polishopt import Process
from polishopt.files.assemble import job
from polishopt.files.config import load
from polishopt.files.results import write_shares
from polishopt.optimize.variance import sobol_shares, variance_shares
from polishopt.sensitivity import main
from polishopt.shares_plot import variance_bars


PLANE = Path(__file__).parent.parent / "configs" / "pessoles2009_plane.yaml"
SETUP = job(load(PLANE).config).setup
START = Process(0.1, 0.3, 1.0, 6.0, 16.7, 209.0)
BOX: dict[str, tuple[float, float]] = dict.fromkeys(
    ("one", "two", "three"), (-np.pi, np.pi)
)


def ishigami(x):
    one, two, three = x.T
    return (np.sin(one) + 7 * np.sin(two) ** 2 + 0.1 * three**4 * np.sin(one))[:, None]


@dataclasses.dataclass
class Sum:
    """What the stand-in returns of the chain's outcome."""

    time: object
    force: object
    ripple: object


def stand_in(process, setup) -> Any:
    del setup
    tilt, step = process.tilt, process.step
    return Sum(time=3 * tilt + 4 * step, force=tilt * step, ripple=jnp.ones(()))


def test_ishigami():
    found = sobol_shares(ishigami, BOX, ["y"], samples=2048)
    # Saltelli et al., a = 7 and b = 0.1
    part = 0.1 * np.pi**4
    variance = 7**2 / 8 + part / 5 + part**2 / 18 + 0.5
    alone = 0.5 * (1 + part / 5) ** 2
    both = part**2 * (1 / 18 - 1 / 50)
    first = np.array([alone, 7**2 / 8, 0.0]) / variance
    total = np.array([alone + both, 7**2 / 8, both]) / variance
    assert_close(found.first[0], first, rtol=0, atol=0.02)
    assert_close(found.total[0], total, rtol=0, atol=0.02)
    assert_close(found.deviations[0] ** 2, variance, rtol=0.02)
    for exact, (low, high) in ((first, found.first_between), (total, found.total_between)):
        assert (low[0] - 0.01 <= exact).all()
        assert (exact <= high[0] + 0.01).all()


def test_bounds_shrink_with_the_root_of_the_samples():
    few, many = (sobol_shares(ishigami, BOX, ["y"], samples=n) for n in (128, 2048))
    for one, other in ((few.first_between, many.first_between),
                       (few.total_between, many.total_between)):  # fmt: skip
        ratio = np.diff(one, axis=0).sum() / np.diff(other, axis=0).sum()
        assert 2.5 < ratio < 6.5


def test_a_chain_and_its_files(tmp_path):
    between = {"tilt": (0.0, 1.0), "step": (0.5, 1.5)}
    names = ("time", "force", "ripple")
    found = variance_shares(START, SETUP, between, names, 256, chain=stand_in)
    assert_close(found.first[0], [9 / 25, 16 / 25], rtol=0, atol=0.03)
    # of x y: variances b^2 s, a^2 s and s^2, with means a, b and s = 1/12
    parts = np.array([1 / 12, 0.25 / 12, 1 / 144])
    assert_close(found.first[1], parts[:2] / parts.sum(), rtol=0, atol=0.05)
    assert_close(found.total[1], (parts[:2] + parts[2]) / parts.sum(), rtol=0, atol=0.05)
    # what does not vary has no shares, and is left out of the picture without a fuss
    assert np.isnan(found.first[2]).all()
    write_shares(tmp_path / "variance.csv", found, {"time": "s"})
    rows = (tmp_path / "variance.csv").read_text().splitlines()
    assert rows[0].startswith("outcome,unit,setting,deviation,first,first_low,first_high")
    assert len(rows) == 7
    assert variance_bars(found).axes


@pytest.mark.slow
def test_bounds_shrink_on_the_chain():
    """With eight times the samples by about the root of eight."""
    made = job(load(PLANE).config)
    outcomes = ("Ssk", "Sku", "force", "mean_removal")
    few, many = (
        variance_shares(made.process, made.setup, made.between, outcomes, samples=n)
        for n in (64, 512)
    )
    for one, other in ((few.first_between, many.first_between),
                       (few.total_between, many.total_between)):  # fmt: skip
        wide, narrow = (np.diff(x, axis=0)[0].mean(axis=1) for x in (one, other))
        print(f"widths {wide}, then {narrow}")
        assert (narrow < 0.75 * wide).all()
    for first, total in zip(many.first, many.total, strict=True):
        assert (first <= total + 0.05).all()


@pytest.mark.parametrize("samples", [0, 1, 100])
def test_samples_are_a_power_of_two(samples):
    with pytest.raises(ValueError, match="power of two"):
        sobol_shares(ishigami, BOX, ["y"], samples=samples)


@pytest.mark.parametrize("samples", ["1", "100", "many", str(2**40)])
def test_the_command_refuses_samples_that_make_no_sense(samples, tmp_path, capsys):
    with pytest.raises(SystemExit) as left:
        main(["job.yaml", "-o", str(tmp_path / "out"), "--samples", samples])
    assert left.value.code == 2
    assert (
        f"is {samples}, must be a power of two between 2 and 65536"
        in capsys.readouterr().err
    )
