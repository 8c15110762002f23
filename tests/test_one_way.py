"""One-way lines: what the lifted way back costs, averaged and as the path is run."""

import dataclasses
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close
from polishopt.files.assemble import job
from polishopt.files.config import load
from polishopt.mechanics import mechanics
from polishopt.path import lines
from polishopt.path.surface import Plane
from polishopt.resolved import removal, run, samples
from polishopt.setup import Sampling


CONFIGS = Path(__file__).parent.parent / "configs"
SIDES = (16.0, 12.0)


@pytest.mark.slow
def test_the_way_back_takes_time_and_removes_nothing():
    """The averaged process is that of the path as it is run, and the lines hold it all."""
    made = job(load(CONFIGS / "pessoles2009_diamond.yaml").config)
    size = jnp.asarray(SIDES)
    guide = lines(3, SIDES, one_way=True)
    sampling = Sampling(stations=4, phases=16, rows=4, columns=4, pixels=(12, 16))
    setup = dataclasses.replace(
        made.setup, surface=Plane(size), size=size, guide=guide, sampling=sampling
    )
    process = eqx.tree_at(
        lambda p: (p.step, p.trochoid_radius), made.process, (jnp.ones(()), jnp.ones(()))
    )
    done = eqx.filter_jit(mechanics)(process, setup)
    count = samples(process, setup, 40)

    @eqx.filter_jit
    def once(process, setup):
        path = run(process, setup, count, jerk=False)
        return path.law.time[-1], removal(path, process, setup, setup.grid, 8, 6)

    time, depth = once(process, setup)
    assert_close(done.time, time, rtol=0.04)
    assert_close(jnp.mean(done.removal), jnp.mean(depth), rtol=0.04)
    # one path carries its ripple, an average none
    gap = np.asarray(done.removal - depth) / float(jnp.mean(depth))
    assert np.sqrt(np.mean(gap**2)) < 0.06
    # at the programmed feed or slower
    back = float(guide.length - guide.contact_length)
    assert done.time > back / float(process.feed)
    assert np.isfinite(done.ripple)
