"""Plots: every figure names its axes with units, and files are whole and repeatable."""

import dataclasses
import os

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from polishopt import feed_plot, plots
from polishopt.chain import Outcome
from polishopt.contact.flat import flat_area, flat_force
from polishopt.parts import Abrasive, Machine, Process, Tool
from polishopt.path.families import lines
from polishopt.path.surface import Plane, SphereCap
from polishopt.resolved import run
from polishopt.setup import Setup, Start
from polishopt.texture.local import TextureMaps
from polishopt.texture.scratches import Population


PROCESS = {"tilt": 0.1, "displacement": 0.5, "step": 1.0, "trochoid_radius": 2.0}


def toy(surface):
    """A small part, a short guide, and a machine too slow for the feed."""
    size = jnp.asarray([10.0, 8.0])
    abrasive = Abrasive(
        preston=1e-8,
        grain=0.015,
        active_fraction=0.1,
        half_angle=1.2,
        hardness=2000.0,
        pad_modulus=5.0,
        depth_variation=0.5,
        conformity=0.5,
    )
    setup = Setup(
        surface=surface(size),
        size=size,
        guide=lines(2, (10.0, 8.0)),
        tool=Tool(
            radius=4.0,
            foundation=0.3,
            body_radius=3.0,
            body_recess=0.8,
            unstick_tilts=[0.05, 0.2],
            unstick_forces=[9.0, 15.0],
        ),
        abrasive=abrasive,
        machine=Machine(
            max_speed=[50.0, 50.0, 50.0, 0.5, 0.5],
            max_acceleration=[300.0, 300.0, 300.0, 1.0, 1.0],
            max_jerk=jnp.full(5, jnp.inf),
        ),
    )
    return Process(**PROCESS, feed=40.0, spin=200.0), setup


@pytest.fixture(scope="module")
def plane():
    process, setup = toy(lambda size: Plane(size))
    return process, setup, eqx.filter_jit(run)(process, setup, 600)


def outcome(**values):
    """An outcome with some values, and NaN for the rest."""
    named = {field.name: jnp.asarray(jnp.nan) for field in dataclasses.fields(Outcome)}
    named |= {name: jnp.asarray(value) for name, value in values.items()}
    maps = {"removal": jnp.zeros((2, 2)), "load": jnp.zeros((2, 2))}
    texture = {"waves": Population(), "parts": (), "left": Start(), "maps": None}
    return Outcome(**{**named, **maps, **texture})


def labels(figure):
    """All labels of the figure, each of which must end in a unit."""
    assert isinstance(figure, Figure)
    figure.draw_without_rendering()
    found = [f(axes) for axes in figure.axes for f in (type(axes).get_xlabel, ylabel)]
    named = [text for text in found if text]
    assert all(axes.get_xlabel() or axes.get_ylabel() for axes in figure.axes)
    for text in named:
        assert text.endswith("]"), text
        assert text[text.rindex("[") + 1 : -1].strip(), text
    return " ".join(named)


def ylabel(axes):
    return axes.get_ylabel()


def titles(figure):
    return " ".join(axes.get_title() for axes in figure.axes)


def test_path(plane):
    _, setup, path = plane
    figure = plots.path(path, setup)
    assert "x [mm]" in labels(figure)
    assert "time [min]" in labels(figure)
    assert f"{float(path.law.total) / 60:.1f} min" in titles(figure)


def test_path_shows_the_disc_where_it_touches(plane):
    _, setup, path = plane
    axes = plots.path(path, setup).axes[0]
    (disc,) = [line for line in axes.lines if line.get_label() == "disc"]
    touched = np.asarray(path.posture.xy[path.s.size // 2])
    away = np.hypot(*(np.asarray(disc.get_xydata()) - touched[None, :]).T)
    # the contact point is a point of the rim, and no point is further than a diameter
    assert away.min() < 1e-9
    assert away.max() <= 2 * float(setup.tool.radius) + 1e-9


def test_feed_names_what_limits(plane):
    process, _, path = plane
    figure = feed_plot.feed(path, process)
    text = labels(figure)
    assert "[mm/min]" in text
    assert "share of the time [%]" in text
    bars = figure.axes[-1]
    names = [tick.get_text() for tick in bars.get_yticklabels()]
    assert any("acceleration" in name for name in names)
    shares = [bar.get_width() for bar in bars.patches if isinstance(bar, Rectangle)]
    assert sum(shares) == pytest.approx(100)
    part = figure.axes[1]
    spots = sum(np.shape(one.get_offsets())[0] for one in part.collections)
    assert spots == np.count_nonzero(np.asarray(path.law.limiting))


def test_contact_shows_the_closed_form(plane):
    process, setup, _ = plane
    figure = plots.contact(process, setup)
    text = labels(figure)
    for unit in ("[MPa]", "force [N]", "displacement [mm]"):
        assert unit in text
    tool = setup.tool
    force = flat_force(tool.radius, tool.foundation, process.tilt, process.displacement)
    area = flat_area(tool.radius, process.tilt, process.displacement)
    assert f"{float(force):.1f} N on {float(area):.0f} mm²" in titles(figure)


def test_contact_on_a_dome_is_smaller(plane):
    process, setup, _ = plane
    domed = eqx.tree_at(lambda s: s.surface, setup, SphereCap(size=setup.size, radius=60.0))
    assert titles(plots.contact(process, domed)) != titles(plots.contact(process, setup))


def test_removal():
    depth = jnp.linspace(1e-3, 3e-3, 12).reshape(3, 4)
    figure = plots.removal(depth, jnp.asarray([8.0, 6.0]))
    assert "depth removed [µm]" in labels(figure)
    assert "mean removal is 2 µm" in titles(figure)
    # three rows: the profile is the middle one
    profile = np.asarray(figure.axes[1].lines[0].get_xydata())
    np.testing.assert_allclose(profile[:, 0], [1, 3, 5, 7])
    np.testing.assert_allclose(profile[:, 1], 1e3 * np.asarray(depth[1]), rtol=1e-12)


def test_no_removal():
    assert "µm" in labels(plots.removal(jnp.zeros((4, 4)), jnp.asarray([8.0, 6.0])))


def test_titles_of_texture_maps_are_not_cut_off():
    """Also those of small numbers, which are long."""
    low, high = jnp.asarray(2.72e-6), jnp.asarray(6.09e-4)
    values = jnp.linspace(low, high, 64).reshape(8, 8)
    maps = TextureMaps(values, values, -1e-3 - values, values, jnp.ones((8, 8), bool))
    figure = plots.texture_maps(values, maps, jnp.asarray([50.0, 50.0]), 5.0)
    figure.set_canvas(FigureCanvasAgg(figure))
    figure.draw_without_rendering()
    for axes in figure.axes[:4]:
        box = axes.title.get_window_extent()
        assert figure.bbox.x0 <= box.x0
        assert box.x1 <= figure.bbox.x1
    assert "depth removed: 0.00272 to 0.609 µm" in titles(figure)
    assert "Ssk: −0.00161 to −0.001" in titles(figure)


@pytest.mark.parametrize("log", [True, False])
def test_texture(log):
    heights = 1e-4 * jax.random.normal(jax.random.key(0), (64, 64))
    told = outcome(Sq=1e-4, Ssk=-0.5, Sku=3.5)
    figure = plots.texture(heights, jnp.asarray([0.04, 0.05]), told, log)
    text = labels(figure)
    assert "x [µm]" in text
    assert "height [nm]" in text
    assert "Sq = 100 nm, Ssk = −0.50, Sku = 3.50" in titles(figure)
    assert figure.axes[1].get_yscale() == ("log" if log else "linear")


def test_topography_leaves_out_spikes_and_holes():
    heights = 1e-3 * np.sin(np.arange(40.0))[:, None] * np.ones(60)
    heights[3, 4], heights[5, 6] = 5.0, np.nan
    figure = plots.topography(heights, np.array([0.4, 0.9]), "a surface")
    over, through = figure.axes[:2]
    image = over.images[0]
    assert image.get_extent() == [0, 0.9, 0, 0.4]
    low, high = image.get_clim()
    assert -1.2e3 < low < high < 1.2e3  # the spike is 5000 µm high
    shown = image.get_array()
    assert shown is not None
    assert np.ma.count_masked(np.ma.masked_invalid(shown)) == 1
    text = labels(figure)
    assert "x [mm]" in text
    assert "height [µm]" in text
    assert over.get_title() == "a surface"
    assert np.size(through.lines[0].get_xdata()) == 60


def test_flat_texture():
    told = outcome(Sq=0.0, Ssk=0.0, Sku=3.0)
    assert "nm" in labels(plots.texture(jnp.zeros((8, 8)), jnp.asarray([0.1, 0.1]), told))


def test_sensitivities():
    matrix = jnp.asarray([[1.0, -0.5, 0.0], [-0.001, 20.0, jnp.nan]])
    figure = plots.sensitivities(
        matrix, ["force", "mean_removal"], ["tilt", "step", "feed"]
    )
    assert "[% per %]" in labels(figure)
    cells = [text.get_text() for text in figure.axes[0].texts]
    assert cells[:5] == ["+1.00", "−0.50", "0.00", "0.00", "+20.00"]
    ticks = [tick.get_text() for tick in figure.axes[0].get_yticklabels()]
    assert ticks == ["force", "mean removal"]


def small():
    return plots.removal(jnp.ones((4, 4)), jnp.asarray([8.0, 6.0]))


def test_save_repeats_its_bytes(tmp_path):
    first = plots.save(small(), tmp_path / "new" / "a.png")
    second = plots.save(small(), tmp_path / "new" / "b.png")
    assert first.read_bytes() == second.read_bytes()
    assert first.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert b"tEXt" not in first.read_bytes()
    assert sorted(os.listdir(tmp_path / "new")) == ["a.png", "b.png"]


def test_failing_save_leaves_the_old_file(tmp_path, monkeypatch):
    target = tmp_path / "a.png"
    target.write_bytes(b"old")

    def fail(self, file, **options):
        file.write(b"half")
        raise OSError("disk full")

    monkeypatch.setattr(Figure, "savefig", fail)
    with pytest.raises(OSError, match="disk full"):
        plots.save(small(), target)
    assert target.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["a.png"]
