"""Interruption: what becomes of a search that does not come to its end.

Finished searches are in the folder `searches` (of a front: `front_searches`) whatever
happens. Who interrupts a fit with Ctrl-C, or ends it by SIGTERM, is told how far it came
and finds what was found so far in `partial.csv`.
"""

import sys
from collections.abc import Mapping

import numpy as np

from .files.assemble import NAMES
from .files.config import Loaded
from .files.results import write_table
from .files.searches import Searches
from .session import Asked
from .units import from_internal, label, suffix


FOLDER, PARTIAL = "searches", "partial.csv"
NOTHING_TUNED = "nothing is tuned: write {start: ..., between: [..., ...]} for a setting"
ENDED = ("stationary", "limits cannot all hold", "work ran out", "not a number")


def finished(asked: Asked, folder: str = FOLDER) -> Searches:
    """The finished searches in the folder of a command: none, unless it is to resume.

    Args:
        asked: From `session.begin`.
        folder: What the folder of searches is called; each command has one of its own.
    """
    store, say = Searches(asked.target / folder), ""
    if folder == FOLDER:
        (asked.target / PARTIAL).unlink(missing_ok=True)
    if asked.given.resume and not len(store):
        say = f"nothing to resume in {store.folder}: all starts are searched"
    elif len(store) and not asked.given.resume:
        say = (
            f"the finished searches in {store.folder} are dropped; --resume would use them"
        )
        store.clear()
    if say and not asked.given.quiet:
        print(say, file=sys.stderr)
    return store


def keys(loaded: Loaded) -> dict[str, str]:
    """Key in the config of each tuned setting, by its name in a search."""
    found = {}
    for step, config in loaded.steps or (("", loaded.config),):
        for key in config.tuned():
            unit = suffix(key)
            word = key.removesuffix(f"_{unit}") if unit else key
            found[f"{step} {NAMES.get(word, word)}".strip()] = f"{step} {key}".strip()
    return found


def interrupted(asked: Asked, store: Searches) -> str:
    """How far a search came, in a sentence or two; what it found is in `partial.csv`.

    Args:
        asked: From `session.begin`.
        store: What this run has finished or found finished.
    """
    goes_on = "The same command with --resume goes on from there."
    batches = (store.get(name) for name in sorted(store.used))
    found = rows([batch for batch in batches if batch], keys(asked.loaded))
    starts = asked.loaded.config.solver.starts
    if not found:
        return f"Interrupted before any of {starts} starts was done; nothing is written."
    path = asked.target / PARTIAL
    write_table(path, list(found[0]), [list(row.values()) for row in found])
    done = {row["start"] for row in found}
    best = min(found, key=lambda row: (not row["limits hold"], row[MISS]))
    told = ", ".join(
        f"{key.removesuffix('_' + suffix(key)).replace('_', ' ')} "
        f"{best[key]:.4g} {label(suffix(key))}".rstrip()
        for key in keys(asked.loaded).values()
    )
    kept = "within" if best["limits hold"] else "outside"
    return (
        f"Interrupted: {len(done)} of {starts} starts are done, see {path}. The nearest "
        f"texture so far, {kept} the limits, misses the target by {best[MISS]:.3g} "
        f"tolerances, at {told}. {goes_on}"
    )


MISS = "largest miss [tolerances]"
SEARCHES = {1: "target", 2: "least cost", 3: "nearest"}


def rows(
    batches: list[Mapping[str, np.ndarray]], named: Mapping[str, str]
) -> list[dict[str, float | int | str | bool]]:
    """One row for each finished search of a tuning, in the order of stages and starts.

    Args:
        batches: Of a store.
        named: From `keys`.
    """
    made = {}
    from .optimize.goals import band_names
    from .optimize.tune import AIM

    for batch in batches:
        if "stage" not in batch:
            continue  # of another kind of search
        # the second stage holds the goals as limits, at the worst place as maps of them
        ends = [v for k, v in batch.items() if k.endswith(band_names(""))]
        off = [v + AIM if v.ndim == 1 else np.max(v.clip(0), axis=(1, 2)) for v in ends]
        # searches for the target see no miss below what they aim at
        held, first = np.max(off, axis=0), np.max(np.abs(batch["residual 0"]), axis=1)
        first = first + np.where(batch["stage"] == 1, AIM, 0.0)
        for i, (stage, start) in enumerate(
            zip(batch["stage"], batch["start"], strict=True)
        ):
            made[int(stage), int(start)] = {
                "start": int(start) + 1,
                "search": SEARCHES[int(stage)],
                **{
                    key: from_internal(float(batch[f"x {name}"][i]), suffix(key))
                    for name, key in named.items()
                },
                MISS: float(held[i] if stage == 2 else first[i]),
                "limits hold": bool(batch["scaled_violation"][i] <= 1e-6),
                "ended": ENDED[int(batch["status"][i])],
            }
    return [made[place] for place in sorted(made)]
