"""Plan: several polishing steps one after another, from the milled surface to the mirror.

What a step does to the part does not depend on the texture it finds, so the mechanics of
all steps are worked out first, those of one structure by one compiled loop; then the
surface is handed from step to step.
"""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp

from .chain import Outcome, finish
from .mechanics import Mechanics, mechanics
from .parts import Process, Scalar
from .setup import Setup, Start


class Plan(eqx.Module):
    """The jobs of a plan in their order; only the first one's start texture is read."""

    names: tuple[str, ...] = eqx.field(static=True)
    """What people call the steps, each another name."""
    setups: tuple[Setup, ...]
    """What each is given."""


class PlanOutcome(eqx.Module):
    """What the steps of a plan do."""

    names: tuple[str, ...] = eqx.field(static=True)
    """What people call them."""
    steps: tuple[Outcome, ...]
    """What each does; its texture is the one after it."""

    @property
    def last(self) -> Outcome:
        """The last step, which leaves the finished surface."""
        return self.steps[-1]

    @property
    def time(self) -> Scalar:
        """Duration of all steps [s]."""
        return jnp.sum(jnp.stack([step.time for step in self.steps]))

    @property
    def force_max(self) -> Scalar:
        """The largest force of any step [N]."""
        return jnp.max(jnp.stack([step.force_max for step in self.steps]))


def follow(processes: Sequence[Process], plan: Plan) -> PlanOutcome:
    """What the steps of a plan do, one after another.

    Pure and differentiable like `chain.polish`, which is a plan of one step.

    Args:
        processes: The settings of each step.
        plan: The jobs of the steps.

    Raises:
        ValueError: if there are not as many processes as steps.
    """
    if len(processes) != len(plan.setups):
        raise ValueError(
            f"`processes` has {len(processes)} entries, must have one for each of the "
            f"{len(plan.setups)} steps."
        )
    start, outcomes = plan.setups[0].start, []
    for done, setup in zip(_mechanics(processes, plan.setups), plan.setups, strict=True):
        outcome = finish(done, setup, start)
        outcomes.append(outcome)
        start = outcome.left
    return PlanOutcome(plan.names, tuple(outcomes))


def _mechanics(
    processes: Sequence[Process], setups: Sequence[Setup]
) -> tuple[Mechanics, ...]:
    """Mechanics of all steps; steps that differ in numbers only share one loop."""
    jobs = [
        (process, eqx.tree_at(lambda s: s.start, setup, Start()))
        for process, setup in zip(processes, setups, strict=True)
    ]
    groups: dict[object, list[int]] = {}
    for i, job in enumerate(jobs):
        leaves, structure = jax.tree.flatten(job)
        shapes = tuple((leaf.shape, leaf.dtype) for leaf in leaves)
        groups.setdefault((structure, shapes), []).append(i)
    done: dict[int, Mechanics] = {}
    for members in groups.values():
        alike = [jobs[i] for i in members]
        stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *alike)
        all_of_them = _each(*stacked)
        for place, i in enumerate(members):
            done[i] = jax.tree.map(lambda leaf, place=place: leaf[place], all_of_them)
    return tuple(done[i] for i in range(len(jobs)))


def _plainly(processes: Process, setups: Setup) -> Mechanics:
    return jax.lax.map(lambda job: mechanics(*job), (processes, setups))


@eqx.filter_custom_jvp
def _each(processes: Process, setups: Setup) -> Mechanics:
    """Mechanics of steps of one structure, stacked.

    A step's mechanics depend on its own settings only. So its slopes by these are worked
    out once, however many settings of other steps are differentiated beside them.
    """
    return _plainly(processes, setups)


@_each.def_jvp
def _each_jvp(primals, tangents):
    """Values, and slopes times tangents; as usual where jobs are differentiated too."""
    (processes, setups), (moves, others) = primals, tangents
    if jax.tree.leaves(others):
        return eqx.filter_jvp(_plainly, primals, tangents)
    changed = [move for move in jax.tree.leaves(moves) if move is not None]
    moved = jax.tree.map(lambda _, move: move is not None, processes, moves)
    free, fixed = eqx.partition(processes, moved)

    def slopes(job):
        free, fixed, setup = job
        values, structure = jax.tree.flatten(free)

        def at(values):
            process = eqx.combine(jax.tree.unflatten(structure, list(values)), fixed)
            return mechanics(process, setup)

        values = jnp.stack(values)
        return jax.vmap(
            lambda direction: jax.jvp(at, (values,), (direction,)), out_axes=(None, 0)
        )(jnp.eye(values.size, dtype=values.dtype))

    done, rows = jax.lax.map(slopes, (free, fixed, setups))
    steps = jnp.stack(changed, axis=1)
    turned = jax.tree.map(lambda row: jnp.einsum("ki,ki...->k...", steps, row), rows)
    return done, turned
