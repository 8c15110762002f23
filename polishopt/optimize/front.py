"""Front: what two outcomes cost each other, and what they can be together at all.

A *front* holds the points where one outcome cannot become better without the other getting
worse. One of them is kept at or under a level while the other is made small, and the level
is moved; new levels go where the front has its largest gaps. A *region* is what two
outcomes, Ssk and Sku as a rule, can be together within the limits. It is cut into slices:
one outcome is held at a value, the other made as small and as large as it can be. So a
region may be bent; holes in it, and gaps between the ends of a slice, are not seen.

Every search starts from what its neighbours found, from either side. Settings drawn at
random that lie beyond a front or a region say that there is more, and are searched from.

Sources: Haimes, Lasdon & Wismer (1971) for the level as a constraint; Das & Dennis (1997)
for what weighted sums miss where a front bends inwards.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .explore import MISS, Explorer, Found, Question, sign


STARTS = 4  # searches for each end of a front or region, and of drawn settings for a slice
FIRST = 3  # levels between the ends before gaps are looked at
SAME = 1e-3  # of the front's range: levels nearer than that are one
BETTER = 1e-5  # spreads of an outcome by which a search must gain to count
# what the other outcome counts at each end of a front, so that it is not left lying about
LITTLE = 1e-4
# spreads of an outcome by which a drawn point must lie outside a region to make a slice
OUTSIDE = 0.03
PASSES = 3  # most times that points start again from neighbours, or from what lies outside


class Point(NamedTuple):
    """One answer."""

    values: tuple[float, float]
    """Both outcomes, in their units or in tolerances."""
    settings: dict[str, float]
    """Where they come about [mm, s, rad]."""
    slope: float
    """Of a front: fall of the first outcome per unit that the level rises."""


class Front(NamedTuple):
    """Points of which none is better than another in both outcomes."""

    names: tuple[str, str]
    """What is made small at each level, and what the level is of."""
    points: tuple[Point, ...]
    """From the best of the second outcome to the best of the first."""
    drawn: Float[np.ndarray, "m 2"]
    """What settings at random do within the limits."""
    searches: int
    """How many searches it took."""


class Region(NamedTuple):
    """What two outcomes can be together."""

    names: tuple[str, str]
    """What is held in each slice, and whose ends are found."""
    low: tuple[Point, ...]
    """The lower ends, by the first outcome."""
    high: tuple[Point, ...]
    """The upper ends."""
    drawn: Float[np.ndarray, "m 2"]
    """What settings at random do within the limits."""
    searches: int
    """How many searches it took."""

    @property
    def outline(self) -> Float[np.ndarray, "n 2"]:
        """The edge, once around: lower ends, then upper ones backwards."""
        around = [point.values for point in (*self.low, *self.high[::-1])]
        return np.asarray(around, float).reshape(-1, 2)


def front(explorer: Explorer, names: tuple[str, str], points: int = 12) -> Front:
    """How much of one outcome the other costs, within the limits.

    Args:
        explorer: The job; knows both outcomes.
        names: Two outcomes; of `miss`, the level is taken.
        points: How many levels.

    Raises:
        ValueError: if the two are one, or the explorer does not know them.
    """
    first, second = names[::-1] if names[0] == MISS else names
    if first == second:
        raise ValueError(f"`names` is {names}, must be two outcomes.")
    a = _index(explorer, first)
    goal, unit, column = _weight(explorer, a), explorer.units[a], explorer.seen[:, a]
    if second == MISS:
        level, levels = 1.0, explorer.missed
        b, held, floor = None, {"near": 1.0}, 0.0
    else:
        b = _index(explorer, second)
        level, levels = explorer.units[b], explorer.seen[:, b]
        held = {"capped": _weight(explorer, b)}
        floor = -np.inf
    within = explorer.over <= 0
    known = levels[within if within.any() else np.isfinite(levels)]
    wide = max(float(np.ptp(known)), 1e-6 * abs(float(known[0])), 1e-12)
    floor, top = max(floor, float(known.min()) - 3 * wide), float(known.max()) + wide

    def at(t: float) -> Question:
        return Question(goal, **held, least=t, most=t)

    explorer.say(f"looking for the ends: least {second}, least {first}")
    least = Question(LITTLE * goal, 1.0, **held, least=floor, most=top)
    other = Question(goal, LITTLE, **held, least=floor, most=top)
    lowest, best = explorer.ask(
        [
            (least, explorer.likely(levels, STARTS)),
            (other, explorer.likely(column, STARTS)),
        ]
    )
    drawn = np.stack([explorer.shown(a), explorer.shown(b)], axis=1)[within]
    if lowest is None or best is None:
        return Front((first, second), (), drawn, explorer.searches)

    low, high = lowest.level, max(best.level, lowest.level)
    found: dict[float, Found] = {}

    def search(asked: Sequence[tuple[float, list]]) -> bool:
        """Whether any of the levels has got a better answer."""
        gained = False
        for (t, _), new in zip(
            asked, explorer.ask([(at(t), p) for t, p in asked]), strict=True
        ):
            old = found.get(t)
            if new and (old is None or new.objective < old.objective - BETTER):
                found[t], gained = new, True
        return gained

    def drawn_for(t: float) -> list:
        return explorer.likely(np.where(levels <= t, column, np.inf), 1)

    ends = [lowest.x, best.x]
    some = [low, high] if high - low > SAME * wide else [low]
    some = sorted({*some, *np.linspace(low, high, FIRST + 2)[: 99 if len(some) > 1 else 1]})
    search([(t, ends + drawn_for(t)) for t in some])
    explorer.say(f"filling the gaps of the front of {first} against {second}")
    while len(found) < points and (gaps := _gaps(found, high - low)):
        new = [
            (t, [found[left].x, found[right].x, *drawn_for(t)])
            for t, left, right in gaps[: points - len(found)]
        ]
        known_levels = len(found)
        search(new)
        if len(found) == known_levels:
            break
    _improve(found, search, explorer)
    made = []
    for t in sorted(found):
        outcomes, missed = explorer.values(found[t].x)
        pair = (outcomes[a], missed if b is None else outcomes[b])
        slope = found[t].slope * abs(unit / level)
        made.append(Point(pair, found[t].x, slope))
    kept = _undominated(made, sign(first), sign(second), BETTER * abs(unit))
    return Front((first, second), kept, drawn, explorer.searches)


def _gaps(found: dict[float, Found], span: float) -> list[tuple[float, float, float]]:
    """Middles of the longest pieces of the front, each with its ends, the longest first."""
    levels = sorted(found)
    heights = [found[t].objective for t in levels]
    tall = max(max(heights) - min(heights), 1e-12)
    pieces = []
    for i, (left, right) in enumerate(zip(levels, levels[1:], strict=False)):
        if right - left > 2 * SAME * span:
            rise = (heights[i] - heights[i + 1]) / tall
            length = np.hypot((right - left) / span, rise)
            pieces.append((float(length), 0.5 * (left + right), left, right))
    pieces.sort(reverse=True)
    return [piece[1:] for piece in pieces[:STARTS]]


def _improve(found: dict[float, Found], search: Callable, explorer: Explorer) -> None:
    """Starts points again from their neighbours' answers, as long as that helps."""
    asked: set[tuple[float, float, float]] = set()
    for _ in range(PASSES):
        levels, again = sorted(found), []
        for i, t in enumerate(levels):
            near = [n for n in levels[max(i - 1, 0) : i + 2] if n != t]
            fresh = [n for n in near if (t, n, found[n].objective) not in asked]
            asked |= {(t, n, found[n].objective) for n in fresh}
            if fresh:
                again.append((t, [found[n].x for n in fresh]))
        explorer.say(f"starting {len(again)} points again from their neighbours")
        if not again or not search(again):
            return


def _undominated(
    points: Sequence[Point], a: float, b: float, least: float
) -> tuple[Point, ...]:
    """Those points that gain something on all before them, the best of the second first."""
    order = sorted(points, key=lambda p: (b * p.values[1], a * p.values[0]))
    kept, best = [], np.inf
    for point in order:
        if a * point.values[0] < best - least:
            kept.append(point)
            best = a * point.values[0]
    return tuple(kept)


def region(
    explorer: Explorer, names: tuple[str, str] = ("Ssk", "Sku"), slices: int = 16
) -> Region:
    """What two outcomes can be together within the limits.

    Args:
        explorer: The job; knows both outcomes.
        names: What is held in each slice, and whose ends are found.
        slices: How many; they lie closer towards the ends, where regions are round.

    Raises:
        ValueError: if the two are one, or the explorer does not know them.
    """
    if names[0] == names[1]:
        raise ValueError(f"`names` is {names}, must be two outcomes.")
    i, j = (_index(explorer, name) for name in names)
    across, up = explorer.seen[:, i], explorer.seen[:, j]
    along, away = _weight(explorer, i), _weight(explorer, j)
    explorer.say(f"looking for the least and the largest {names[0]}")
    left, right = explorer.ask(
        [
            (Question(along), explorer.likely(across, STARTS)),
            (Question(-along), explorer.likely(-across, STARTS)),
        ]
    )
    within = explorer.over <= 0
    drawn = np.stack([explorer.shown(i), explorer.shown(j)], axis=1)[within]
    if left is None or right is None:
        return Region(names, (), (), drawn, explorer.searches)
    low, high = left.objective, -right.objective
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    places = middle - half * np.cos(np.pi * (np.arange(slices) + 0.5) / slices)
    sides: dict[float, dict[float, Found]] = {1.0: {}, -1.0: {}}

    def search(
        asked: Sequence[tuple[float, float, dict[str, float]]],
    ) -> list[Found | None]:
        """Answers for sides of slices, each from a place; the best are remembered."""
        answers = explorer.ask(
            [(Question(s * away, held=along, at=t * along), [x]) for s, t, x in asked]
        )
        for (side, t, _), new in zip(asked, answers, strict=True):
            old = sides[side].get(t)
            if new and (old is None or new.objective < old.objective):
                sides[side][t] = new
        return answers

    explorer.say(f"following both ends of {names[1]} through {slices} slices")
    walks = [
        (side, way, end.x)
        for side in sides
        for way, end in ((places, left), (places[::-1], right))
    ]
    for k in range(slices):
        asked = [(side, float(way[k]), x) for side, way, x in walks]
        # a walk that finds nothing ends: the one from the other side may come by here
        walks = [
            (side, way, new.x)
            for (side, way, _), new in zip(walks, search(asked), strict=True)
            if new
        ]
    for _ in range(PASSES):
        strays = _strays(explorer, across, up, sides)
        if not strays:
            break
        explorer.say(f"searching from {len(strays)} drawn settings that lie outside")
        for (side, t, x), new in zip(strays, search(strays), strict=True):
            # what was drawn keeps the limits: it is in the region whatever a search finds
            worth = side * float(up[explorer.drawn.index(x)])
            if new is None or new.objective > worth:
                sides[side][t] = Found(x, worth, 0.0, float("nan"))
    ends = [_point(explorer, one, i, j) for one in (left, right)]

    def line(found: dict[float, Found]) -> tuple[Point, ...]:
        inner = [_point(explorer, found[t], i, j) for t in sorted(found)]
        return (ends[0], *inner, ends[1])

    return Region(names, line(sides[1.0]), line(sides[-1.0]), drawn, explorer.searches)


def _strays(
    explorer: Explorer, across: np.ndarray, up: np.ndarray, sides: dict
) -> list[tuple[float, float, dict[str, float]]]:
    """Drawn settings within the limits that lie outside of what was found: new slices.

    Between two slices an end is only known as a straight line, and a bent one lies beyond
    it; or there is something that no walk has come by. Of several between the same two
    slices the furthest one counts.
    """
    worst: dict[tuple[float, int], tuple[float, int]] = {}
    for side, found in sides.items():
        slices = sorted(found)
        if len(slices) < 2:
            continue
        edge = np.interp(across, slices, [found[t].objective for t in slices])
        inside = (across > slices[0]) & (across < slices[-1]) & (explorer.over <= 0)
        inside &= ~np.isin(across, slices)
        out = np.where(inside, edge - side * up, -1.0)
        between = np.searchsorted(slices, across)
        for i in np.flatnonzero(out > OUTSIDE):
            place = side, int(between[i])
            worst[place] = max(worst.get(place, (0.0, -1)), (float(out[i]), int(i)))
    return [
        (side, float(across[i]), explorer.drawn[i]) for (side, _), (_, i) in worst.items()
    ]


def _point(explorer: Explorer, found: Found, i: int, j: int) -> Point:
    outcomes, _ = explorer.values(found.x)
    return Point((outcomes[i], outcomes[j]), found.x, float("nan"))


def _index(explorer: Explorer, name: str) -> int:
    if name not in explorer.names:
        known = ", ".join(explorer.names)
        raise ValueError(f"{name!r} is none of the explorer's outcomes: {known}.")
    return explorer.names.index(name)


def _weight(explorer: Explorer, i: int) -> np.ndarray:
    return np.eye(len(explorer.names))[i]
