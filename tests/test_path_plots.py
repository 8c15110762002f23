"""Path plots: axes with units, and what they show."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from polishopt import path_plots
from polishopt.contact.removal import Grid
from polishopt.path.surface import Plane, SphereCap
from polishopt.texture.spectrum import areal_spectrum
from test_plots import labels, titles


@pytest.mark.parametrize("radius", [None, 40.0])
def test_path_on_part(radius):
    """A plane, and a dome that is drawn taller than it is, with the feed as colour."""
    size = jnp.asarray([10.0, 8.0])
    part = Plane(size) if radius is None else SphereCap(size, radius)
    way = jnp.asarray(np.linspace([1.0, 1.0], [9.0, 7.0], 50))
    points = jax.vmap(part)(way)
    feed = None if radius is None else np.linspace(5.0, 10.0, 50)
    figure = path_plots.path_on_part(part, size, points, feed)
    space: Any = figure.axes[0]
    assert "x [mm]" in labels(figure)
    assert space.get_zlabel() == "z [mm]"
    assert ("feed [mm/min]" in labels(figure)) == (radius is not None)
    assert ("times as large" in titles(figure)) == (radius is not None)
    low, high = space.get_zlim()
    assert low <= float(points[:, 2].min()) <= float(points[:, 2].max()) <= high + 1e-12
    assert low < high


def test_coverages():
    grid = Grid(jnp.zeros(2), jnp.asarray([8.0, 4.0]), (4, 8))
    values = np.full((4, 8), 0.5)
    values[0, 0] = np.nan
    uneven = np.where(np.arange(8) < 4, 0.4, 0.6) + np.zeros((4, 1))
    figure = path_plots.coverages({"even": values, "not": uneven}, grid)
    assert "coverage off its mean [%]" in labels(figure)
    assert "mean 0.5/mm, varies by 0.0 %" in titles(figure)
    assert "varies by 20.0 %" in titles(figure)


def test_spectra():
    wave = np.cos(np.pi / 4 * np.arange(32)) + np.zeros((32, 1))
    found = {name: areal_spectrum(jnp.asarray(wave), 0.5) for name in ("one", "two")}
    figure = path_plots.spectra(found, {"1/step": 0.25}, "mm²", 0.8)
    assert "density [mm²]" in labels(figure)
    assert [axes.get_title() for axes in figure.axes[:2]] == ["one", "two"]
    below = figure.axes[-1]
    assert below.get_xlim() == (0, 0.8)
    for line in below.lines[:2]:
        frequency, density = np.asarray(line.get_xydata()).T
        assert abs(frequency[np.argmax(density)] - 0.25) < 1e-9
