"""Plan: several polishing steps one after another, from the milled surface to the mirror.

What a step does to the part does not depend on the texture it finds, so the mechanics of
all steps are worked out first, those of one structure by one compiled loop; then the
surface is handed from step to step.
"""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .chain import Outcome, Worn, finish, worn
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
    return _followed(processes, plan, forward=False)


def follow_forward(processes: Sequence[Process], plan: Plan) -> PlanOutcome:
    """As `follow`, for slopes in forward mode by many settings at once.

    Whatever the settings are, they reach the height map by the pressures and removals of
    the steps that came before. Slopes by these are worked out once, and those by settings
    are sums of them: in a plan of seven steps with 28 settings a step carries 2 to 14 maps
    instead of 28. In reverse mode `follow` is the faster one.

    Args:
        processes: As in `follow`.
        plan: As in `follow`.

    Raises:
        ValueError: as `follow`.
    """
    return _followed(processes, plan, forward=True)


def _followed(processes: Sequence[Process], plan: Plan, forward: bool) -> PlanOutcome:
    if len(processes) != len(plan.setups):
        raise ValueError(
            f"`processes` has {len(processes)} entries, must have one for each of the "
            f"{len(plan.setups)} steps."
        )
    start, outcomes, wears = plan.setups[0].start, [], [None] * len(plan.setups)
    mechanics = _mechanics(processes, plan.setups)
    if forward and start.heights is not None:
        bare = [eqx.tree_at(lambda s: s.start, setup, Start()) for setup in plan.setups]
        strains = jnp.stack([jnp.stack([m.pressure, m.mean_removal]) for m in mechanics])
        wears = _all_worn(strains, tuple(bare), start.heights, start.spacing)
    for done, setup, wear in zip(mechanics, plan.setups, wears, strict=True):
        outcome = finish(done, setup, start, wear)
        outcomes.append(outcome)
        start = outcome.left
    return PlanOutcome(plan.names, tuple(outcomes))


@eqx.filter_custom_jvp
def _all_worn(
    strains: Float[Array, "steps 2"],
    setups: tuple[Setup, ...],
    heights: Float[Array, "ny nx"],
    spacing: Float[Array, "2"],
) -> tuple[Worn, ...]:
    """What each step leaves of a height map, given its pressure and removal [MPa, mm]."""
    return _worn_one_by_one(strains, setups, heights, spacing)


def _worn_one_by_one(strains, setups, heights, spacing) -> tuple[Worn, ...]:
    found = []
    for (pressure, removal), setup in zip(strains, setups, strict=True):
        found.append(worn(setup, heights, spacing, pressure, removal))
        heights = found[-1].heights
    return tuple(found)


@_all_worn.def_jvp
def _all_worn_jvp(primals, tangents):
    """Slopes by the pressures and removals so far, handed on with the map."""
    strains, setups, heights, spacing = primals
    moves, *others = tangents
    if jax.tree.leaves(others):
        return eqx.filter_jvp(_worn_one_by_one, primals, tangents)
    found, turned = [], []
    # slopes of the map, by pressure and removal of each step that it has been through
    carried = jnp.zeros((0, *heights.shape), heights.dtype)
    for i, ((pressure, removal), setup) in enumerate(zip(strains, setups, strict=True)):
        count = len(carried)
        maps = jnp.pad(carried, ((0, 2), (0, 0), (0, 0)))
        own = jnp.eye(count + 2, dtype=heights.dtype)[:, count:]

        def one(direction, by, heights=heights, at=(pressure, removal), setup=setup):
            return jax.jvp(
                lambda z, p, h: worn(setup, z, spacing, p, h),
                (heights, *at),
                (direction, by[0], by[1]),
            )

        left, rows = jax.vmap(one, out_axes=(None, 0))(maps, own)
        heights, carried = left.heights, rows.heights
        by = moves[: i + 1].reshape(-1)
        found.append(left)
        turned.append(jax.tree.map(lambda row, by=by: jnp.tensordot(by, row, 1), rows))
    return tuple(found), tuple(turned)


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
