"""Basin_report: the distinct answers of a tuning as a table, for those who may choose."""

from collections.abc import Sequence

import numpy as np
from rich.table import Table

from .files.config import Loaded
from .optimize.basins import Basin
from .optimize.certificate import Status
from .optimize.tune import Tuning
from .report import SYMBOLS, empty_table, key_of
from .units import from_internal, label, suffix


MOST = 6  # rows


def basin_table(found: Sequence[Basin], tuning: Tuning, loaded: Loaded) -> Table:
    """The best of the distinct answers: settings, cost, and how many starts led there.

    Args:
        found: From `basins`.
        tuning: The answer.
        loaded: What was asked, as typed; of one step.
    """
    config = loaded.config
    force = config.secondary == "force"
    reached = bool(np.asarray(tuning.followed).any())
    cost = ("force [N]" if force else "time [min]") if reached else "miss [tolerances]"
    keys = {key.removesuffix("_" + suffix(key)): key for key in config.tuned()}
    names = {name: keys[key_of(name)] for name in found[0].answer}
    columns = (f"{SYMBOLS[name]} [{label(suffix(key))}]" for name, key in names.items())
    table = empty_table("Answers", "", "starts", cost, *columns)
    for i, basin in enumerate(found[:MOST]):
        value = basin.distance
        if reached:
            value = basin.cost if force else from_internal(basin.cost, "min")
        settings = (
            f"{from_internal(basin.answer[name], suffix(key)):.4g}"
            for name, key in names.items()
        )
        table.add_row(str(i + 1), str(len(basin.starts)), f"{value:.4g}", *settings)
    return table


def left_over(found: Sequence[Basin], tuning: Tuning) -> str:
    """What became of the starts that are in none of the rows, in a sentence or two."""
    statuses, followed = np.asarray(tuning.statuses), np.asarray(tuning.followed)
    shown = {start for basin in found[:MOST] for start in basin.starts}
    rest = [i for i in range(statuses.size) if i not in shown]
    stopped = sum(1 for i in rest if statuses[i] != Status.SOLVED)
    waiting = sum(1 for i in rest if statuses[i] == Status.SOLVED and not followed[i])
    said = []
    if followed.any() and waiting:
        said.append(f"{waiting} more reach the target at a higher cost, and stayed there")
    if len(found) > MOST:
        said.append(f"{len(found) - MOST} more answers are not shown")
    if stopped:
        said.append(f"{stopped} ended before a stationary point")
    return "; ".join(said).capitalize() + "." if said else ""
