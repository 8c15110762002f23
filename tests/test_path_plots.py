"""Path plots: axes with units, and what they show."""

import jax.numpy as jnp
import numpy as np
from polishopt import path_plots
from polishopt.contact.removal import Grid
from polishopt.texture.spectrum import areal_spectrum
from test_plots import labels, titles


def test_coverages():
    grid = Grid(jnp.zeros(2), jnp.asarray([8.0, 4.0]), (4, 8))
    values = np.full((4, 8), 0.5)
    values[0, 0] = np.nan
    uneven = np.where(np.arange(8) < 4, 0.4, 0.6) + np.zeros((4, 1))
    figure = path_plots.coverages({"even": values, "not": uneven}, grid)
    assert "coverage [1/mm]" in labels(figure)
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
