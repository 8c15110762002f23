"""Choice_plot: what each combination of choices costs, and how near it comes."""

from collections.abc import Mapping, Sequence

from matplotlib.figure import Figure

from .choice_report import Row, cost, listed, shown
from .plots import BLUE, GREY, ORANGE, PINK


CLOSE = 0.03  # of a picture: dots nearer to each other share a label
COLOURS = {"solved": BLUE, "infeasible": ORANGE, "not converged": GREY}
MARKS = {"solved": "o", "infeasible": "X", "not converged": "s"}


def figure(found: Sequence[Row], secondary: str) -> Figure:
    """Cost against the distance from the target, a numbered dot for each combination.

    Args:
        found: From `rows`.
        secondary: What was made small.
    """
    drawn = Figure((9.6, max(4.2, 0.9 + 0.2 * len(found))), layout="constrained")
    axes, beside = drawn.subplots(1, 2, width_ratios=(1.6, 1))
    tuned = [row for row in found if row.rank]
    at = {row.number: (shown(row), cost(row, secondary)) for row in tuned}
    for verdict, colour in COLOURS.items():
        places = [at[row.number] for row in tuned if row.verdict == verdict]
        if places:
            axes.plot(
                *zip(*places, strict=True), MARKS[verdict], color=colour, label=verdict
            )
    for row in tuned:
        if row.rank == 1:
            ring = {"markersize": 14, "color": PINK, "fillstyle": "none"}
            axes.plot(*at[row.number], "o", label="best", **ring)
    far = max((x for x, _ in at.values()), default=0.0)
    axes.set_xlim(-0.04 * max(far, 1.0), 1.1 * max(far, 1.0))
    axes.margins(y=0.12)
    for members in _near(at):
        numbers = ", ".join(map(str, members))
        axes.annotate(numbers, at[members[0]], xytext=(8, 5), textcoords="offset points")
    axes.set_xlabel("distance from the target [tolerances]")
    axes.set_ylabel("largest force [N]" if secondary == "force" else "time [min]")
    axes.spines[["top", "right"]].set_visible(False)
    if tuned:
        axes.legend(frameon=False)
    axes.set_title("What each choice can do within the limits")
    lines = [
        line if row.rank else f"{line} ({row.verdict})"
        for row, line in zip(found, listed(found), strict=True)
    ]
    beside.axis("off")
    beside.text(0, 1, "\n".join(lines), va="top", fontsize=8, wrap=True, parse_math=False)
    return drawn


def _near(at: Mapping[int, tuple[float, float]]) -> list[list[int]]:
    """Numbers of dots, those together whose labels would lie over each other."""
    spans = [max(max(part) - min(part), 1e-12) for part in zip(*at.values(), strict=True)]
    groups: list[list[int]] = []
    for number, place in at.items():
        for group in groups:
            off = zip(place, at[group[0]], spans, strict=True)
            if all(abs(a - b) <= CLOSE * span for a, b, span in off):
                group.append(number)
                break
        else:
            groups.append([number])
    return groups
