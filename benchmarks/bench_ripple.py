"""Ripple: the closed form against the removal of the true path, every loop of it.

For the plane part of the paper at steps of 1, 2 and 4 mm, the removal at points drawn at
random, over eight starting phases of the trochoid: its standard deviation over the phases
is the ripple. No grid of pixels blurs it, and the footprint is evaluated in closed form at
each point, so that nothing but the path, its feed and the formulas of a flat contact is
shared with the prediction. Takes three minutes. Run as

    python benchmarks/bench_ripple.py
"""

import time
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from polishopt.chain import polish
from polishopt.files.assemble import job
from polishopt.files.config import load
from polishopt.resolved import run, samples


jax.config.update("jax_enable_x64", True)

CONFIG = Path(__file__).parents[1] / "configs" / "pessoles2009_plane.yaml"
STEPS = (4.0, 2.0, 1.0)
PHASES, POINTS, PER_LOOP = 8, 600, 384


@eqx.filter_jit
def depths(process, setup, count, points, phase):
    """What one path removes at points of a plane part [mm]."""
    path = run(process, setup, count, phase)
    half = 0.5 * jnp.diff(path.law.time)
    dwell = jnp.pad(half, (1, 0)) + jnp.pad(half, (0, 1))
    contact = path.posture.contact
    chord = jnp.concatenate([contact[1:], contact[-1:]])
    chord = chord - jnp.concatenate([contact[:1], contact[:-1]])
    length = jnp.linalg.norm(chord, axis=1)
    velocity = (path.law.feed / jnp.where(length > 0, length, 1.0))[:, None] * chord
    f, b, xy = path.posture.feed_direction, path.posture.side, path.posture.xy
    tool, spin, side = setup.tool, process.spin, setup.side
    slope, level = jnp.sin(process.tilt), jnp.cos(process.tilt)
    forth, left = jnp.sum(velocity * f, 1), jnp.sum(velocity * b, 1)

    def depth(point):
        way = point[None] - xy
        x = -side * jnp.sum(way * f[:, :2], 1) / level  # from the lowest rim point
        eta = jnp.sum(way * b[:, :2], 1)
        inside = (tool.radius - x) ** 2 + eta**2 <= tool.radius**2
        pressure = tool.foundation * jnp.maximum(process.displacement - x * slope, 0.0)
        along = -spin * eta * level + forth
        across = side * spin * (tool.radius - x) + left
        speed = jnp.sqrt(along**2 + across**2 + (spin * eta * slope) ** 2)
        return jnp.sum(jnp.where(inside, dwell * pressure * speed, 0.0))

    return setup.abrasive.preston * jax.lax.map(depth, points, batch_size=8)


def main():
    given = job(load(CONFIG).config)
    setup, average = given.setup, eqx.filter_jit(polish)
    points = np.random.default_rng(0).uniform(0, 1, (POINTS, 2)) * np.asarray(setup.size)
    print("| step [mm] | true rms [%] | predicted [%] | ratio | true [s] |")
    print("|---|---|---|---|---|")
    for step in STEPS:
        process = eqx.tree_at(
            lambda p: (p.step, p.trochoid_radius),
            given.process,
            (jnp.asarray(step), jnp.asarray(3.0)),
        )
        began = time.perf_counter()
        count = samples(process, setup, PER_LOOP)
        phases = 2 * np.pi * np.arange(PHASES) / PHASES
        found = np.stack(
            [depths(process, setup, count, jnp.asarray(points), turn) for turn in phases]
        )
        took = time.perf_counter() - began
        outcome = average(process, setup)
        variance = found.var(axis=0)
        share = np.sqrt(variance.mean()) / float(outcome.mean_removal)
        error = 0.5 * share * variance.std() / variance.mean() / np.sqrt(POINTS)
        predicted = float(outcome.ripple)
        print(
            f"| {step:g} | {100 * share:.2f} ± {100 * error:.2f} | {100 * predicted:.2f} "
            f"| {predicted / share:.3f} | {took:.0f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
