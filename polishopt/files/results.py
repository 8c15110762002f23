"""Results: what a run leaves behind, for people, spreadsheets and other programs.

Every file is written beside its place and then renamed, so that an interrupted run never
leaves half a file.
"""

import csv
import io
import json
import math
import os
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..optimize.attribution import Attribution
from ..optimize.sensitivity import Sensitivity
from ..optimize.variance import Variance
from .document import write_text


def numbers(tree: Any) -> Any:
    """Arrays as plain numbers and lists; what is not finite becomes None, as in JSON."""
    if isinstance(tree, Mapping):
        return {str(key): numbers(value) for key, value in tree.items()}
    if isinstance(tree, list | tuple):
        return [numbers(value) for value in tree]
    if tree is None or isinstance(tree, str | bool | int):
        return tree
    array = np.asarray(tree)
    if array.ndim:
        return [numbers(value) for value in array]
    value = array.item()
    return value if not isinstance(value, float) or math.isfinite(value) else None


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """A JSON file, in the order given.

    Args:
        path: Where to.
        content: Names, numbers, arrays and texts.
    """
    text = json.dumps(numbers(content), indent=2, ensure_ascii=False, allow_nan=False)
    write_text(path, text + "\n")


def write_table(path: Path, heads: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
    """A CSV table.

    Args:
        path: Where to.
        heads: Titles of the columns.
        rows: Texts and numbers.
    """
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(heads)
    for row in rows:
        table.writerow([f"{v:.9g}" if isinstance(v, float) else v for v in row])
    write_text(path, text.getvalue())


def write_sensitivity(path: Path, matrix: Sensitivity, units: Mapping[str, str]) -> None:
    """Derivatives and elasticities as a CSV table, one row per outcome and setting.

    Args:
        path: Where to.
        matrix: The sensitivities.
        units: Inner unit of each outcome and setting, for the column of derivatives.
    """
    lines = ["outcome,setting,value,derivative,unit,elasticity"]
    for i, outcome in enumerate(matrix.outcomes):
        for j, setting in enumerate(matrix.settings):
            # in a plan a setting follows the name of its step
            word = setting.rpartition(" ")[2]
            unit = f"{units.get(outcome, '1')}/({units.get(word, '1')})"
            lines.append(
                f"{outcome},{setting},{float(matrix.values[i]):.9g},"
                f"{float(matrix.derivatives[i, j]):.9g},{unit},"
                f"{float(matrix.elasticities[i, j]):.9g}"
            )
    write_text(path, "\n".join(lines) + "\n")


def write_shares(path: Path, found: Variance, units: Mapping[str, str]) -> None:
    """Sobol indices as a CSV table, one row per outcome and setting.

    Args:
        path: Where to.
        found: The indices.
        units: Inner unit of each outcome.
    """
    rows = [
        [
            outcome,
            units.get(outcome, "1"),
            setting,
            float(found.deviations[i]),
            *(float(each[i, j]) for each in (found.first, *found.first_between)),
            *(float(each[i, j]) for each in (found.total, *found.total_between)),
            found.samples,
        ]
        for i, outcome in enumerate(found.outcomes)
        for j, setting in enumerate(found.settings)
    ]
    ends = ("", "_low", "_high")
    heads = ["outcome", "unit", "setting", "deviation"]
    heads += [kind + end for kind in ("first", "total") for end in ends] + ["samples"]
    write_table(path, heads, rows)


def write_attribution(path: Path, split: Attribution, units: Mapping[str, str]) -> None:
    """Shares of a difference as a CSV table, one row per outcome and effect.

    Args:
        path: Where to.
        split: The shares.
        units: Inner unit of each outcome.
    """
    rows = [
        [
            outcome,
            units.get(outcome, "1"),
            effect,
            *(float(end[i]) for end in (split.first, split.second)),
            *(float(part[i, j]) for part in (split.parts, split.least, split.most)),
        ]
        for i, outcome in enumerate(split.outcomes)
        for j, effect in enumerate(split.effects)
    ]
    heads = ["outcome", "unit", "effect", "first", "second", "share", "least", "most"]
    write_table(path, heads, rows)


def write_maps(
    path: Path,
    variables: Mapping[str, tuple[tuple[str, ...], Any, str, str]],
    attributes: Mapping[str, str],
) -> None:
    """Labelled arrays as a NetCDF file.

    Args:
        path: Where to.
        variables: By name: names of the dimensions, values, unit, and what it is. One
            whose only dimension bears its own name is a coordinate.
        attributes: Texts about the whole file, such as the config and versions.
    """
    import xarray  # half a second; not everyone who reads results writes them

    dataset = xarray.Dataset(attrs=dict(attributes))
    for name, (dimensions, values, unit, meaning) in variables.items():
        dataset[name] = (dimensions, np.asarray(values))
        dataset[name].attrs.update(units=unit, long_name=meaning)
    descriptor, beside = tempfile.mkstemp(suffix=".nc", prefix=".", dir=path.parent)
    os.close(descriptor)
    try:
        dataset.to_netcdf(beside, engine="h5netcdf")
        os.chmod(beside, 0o644)
        os.replace(beside, path)
    except BaseException:
        os.unlink(beside)
        raise
