"""Before step 1: points that nothing stood at, and that would spoil what the others decide.

Drivers write a return that hit nothing as (0, 0, 0): a heap of points at exactly the origin. And a
handful of points far from all others, from a wrong pose or a damaged packet, would each take a
cluster for itself, be the smallest one of Eq. 1, and so set how much of the map goes.

Both are told by a count and the outermost points, `Outskirts`. Those of parts of a map merge into
that of the whole, so that a map cut into tiles gets the verdict that it gets in memory.
"""

from copy import copy
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynahull.observer import Observer

HEAP = 10
"""Points at exactly the origin, beyond which they are a heap of invalid returns."""

FAR = 10
"""Times the size of the map: what is farther from it is a stray, if there are few of them."""

SHARE = 100
"""Strays on one side are fewer than one in so many points, and fewer than k."""

_SIDES = 6
_BATCH = 65_536
"""Points looked at at a time."""


OUTSKIRTS_NAMES = (
    "outskirts_counts",
    "outskirts_origin_rows",
    "outskirts_points",
    "outskirts_rows",
)
"""Of the arrays that `Outskirts.to_arrays` returns."""


@dataclass(frozen=True, slots=True, eq=False)
class Strays:
    """The verdict on a whole map."""

    heap: int
    """Points at exactly the origin, if they are a heap; otherwise 0."""
    at_origin: int
    """Points at exactly the origin, if they are none."""
    rows: NDArray[np.int64]
    """(n,): row numbers of the strays, ascending."""
    points: NDArray[np.float64]
    """(n, 3): where they are."""
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    """(3,): all other points lie within."""


class Outskirts:
    """What must be known of points to tell strays: counts, and the k outermost of each side."""

    def __init__(self, k: int) -> None:
        self._most = k
        self._count = 0
        self._at_origin = 0
        self._origin_rows = np.empty(0, np.int64)
        # Of each side, from the outermost inwards: lowest x, y, z, then highest x, y, z.
        self._points = np.empty((_SIDES, 0, 3))
        self._rows = np.empty((_SIDES, 0), np.int64)

    def add(
        self,
        points: NDArray[np.float64],
        first_row: int = 0,
        chosen: NDArray[np.bool_] | None = None,
    ) -> None:
        """Take points of consecutive rows, (n, 3), into account: the chosen, all finite, or all."""
        for start in range(0, len(points), _BATCH):
            end = min(start + _BATCH, len(points))
            batch, rows = points[start:end], np.arange(first_row + start, first_row + end)
            if chosen is not None and not chosen[start:end].all():
                batch, rows = batch[chosen[start:end]], rows[chosen[start:end]]
            zero = is_at_origin(batch)
            if zero.any():
                self._note_origin(int(np.count_nonzero(zero)), rows[zero])
                batch, rows = batch[~zero], rows[~zero]
            self._count += len(batch)
            self._note(batch, rows)

    def merge(self, other: "Outskirts") -> None:
        """Take the points of another part of the map into account."""
        self._count += other._count
        self._note_origin(other._at_origin, other._origin_rows)
        self._keep(
            [np.concatenate(pair) for pair in zip(self._points, other._points, strict=True)],
            [np.concatenate(pair) for pair in zip(self._rows, other._rows, strict=True)],
        )

    def strays(self) -> Strays:
        """Return the verdict, if all points of the map were taken into account."""
        heap = self._at_origin if self._count and self._at_origin > HEAP else 0
        whole = copy(self)
        if not heap:
            whole._note(np.zeros((len(self._origin_rows), 3)), self._origin_rows)
        at_origin = self._at_origin - heap
        rows, points = np.empty(0, np.int64), np.empty((0, 3))
        low, high = np.full(3, -np.inf), np.full(3, np.inf)
        tail = min(self._most, (self._count + at_origin) // SHARE)
        if tail and self._count:  # what is all in one place has no strays
            values = _outwardness(whole._points)
            # The map's size is that of what is left when the tails of all sides are cut off.
            inner_low, inner_high = values[:3, tail - 1], -values[3:, tail - 1]
            reach = FAR * float((inner_high - inner_low).max())
            far = values < values[:, [tail - 1]] - reach
            if reach > 0 and far.any():
                rows, first = np.unique(whole._rows[far], return_index=True)
                points = whole._points[far][first]
                low, high = inner_low - reach, inner_high + reach
        return Strays(heap, at_origin, rows, points, low, high)

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Return what is known as arrays, which `from_arrays` takes."""
        counts = np.array([self._most, self._count, self._at_origin])
        values = (counts, self._origin_rows, self._points, self._rows)
        return dict(zip(OUTSKIRTS_NAMES, values, strict=True))

    @classmethod
    def from_arrays(
        cls,
        counts: NDArray[np.int64],
        origin_rows: NDArray[np.int64],
        points: NDArray[np.float64],
        rows: NDArray[np.int64],
    ) -> "Outskirts":
        """Return what `to_arrays` turned into these."""
        most, count, at_origin = counts.tolist()
        found = cls(most)
        found._count, found._at_origin = count, at_origin
        found._origin_rows, found._points, found._rows = origin_rows, points, rows
        return found

    def _note_origin(self, count: int, rows: NDArray[np.int64]) -> None:
        self._at_origin += count
        self._origin_rows = np.concatenate([self._origin_rows, rows])[:HEAP]

    def _note(self, points: NDArray[np.float64], rows: NDArray[np.int64]) -> None:
        """Take over what is farther out on a side than what is held."""
        outer = [self._outermost(_along(side, points)) for side in range(_SIDES)]
        self._keep(
            [
                np.concatenate([held, points[more]])
                for held, more in zip(self._points, outer, strict=True)
            ],
            [
                np.concatenate([held, rows[more]])
                for held, more in zip(self._rows, outer, strict=True)
            ],
        )

    def _outermost(self, outwardness: NDArray[np.float64]) -> NDArray[np.intp]:
        """Return which points are the farthest out, as many as are held, in no order."""
        if len(outwardness) <= self._most:
            return np.arange(len(outwardness))
        return np.argpartition(outwardness, self._most - 1)[: self._most]

    def _keep(self, points: list[NDArray[np.float64]], rows: list[NDArray[np.int64]]) -> None:
        """Hold the outermost of some points of each side."""
        kept_points, kept_rows = [], []
        for side in range(_SIDES):
            outwardness = _along(side, points[side])
            outer = self._outermost(outwardness)
            order = outer[np.lexsort((rows[side].take(outer), outwardness.take(outer)))]
            kept_points.append(points[side].take(order, axis=0))
            kept_rows.append(rows[side].take(order))
        self._points, self._rows = np.stack(kept_points), np.stack(kept_rows)


def warn_of_strays(heap: int, strays: int, observer: Observer) -> None:
    """Say how many points lie in a heap at the origin, and how many are strays, if any are."""
    if heap:
        observer.warn(
            f"{heap:,} points lie at exactly (0, 0, 0), as invalid returns do: labelled invalid, "
            "kept in place"
        )
    if strays:
        points = "1 point lies" if strays == 1 else f"{strays:,} points lie"
        observer.warn(
            f"{points} farther from the rest of the map than {FAR} times its size: labelled "
            "unscored, kept in place"
        )


def is_at_origin(points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tell which points lie at exactly the origin."""
    at_zero = points[:, 0] == 0
    if at_zero.any():  # seldom: the other coordinates are not looked at
        at_zero &= (points[:, 1] == 0) & (points[:, 2] == 0)
    return np.asarray(at_zero)


def _along(side: int, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how far outwards points lie on a side: the less, the farther."""
    return points[:, side] if side < 3 else -points[:, side - 3]


def _outwardness(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the same of the points held of each side, (6, m)."""
    return np.stack([_along(side, points[side]) for side in range(_SIDES)])
