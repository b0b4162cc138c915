"""What must be known of a map before it is cut: how many points it has, and where.

A survey is one streaming pass. Surveys of parts of a map merge into that of the whole, whatever the
parts, so that several workers can share the pass.

Where the points are is said by counts on a sparse square lattice, as coarse as memory demands. It
is anchored at the coordinates' origin. Its cells are a power of two wide, so that the column of a
point is exact, and the columns of a coarser lattice are those of a finer one halved.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tiling.collection import MapCollection
from tiling.formats.points import PointBatch, only_finite

FINEST_CELL = 0.25
"""Side of a column of the occupancy lattice, metres, before any coarsening."""

MOST_COLUMNS = 2_000_000
"""Occupied columns beyond which the lattice is coarsened to cells twice as wide."""

_LARGEST_RASTER, _RASTER_EACH = 1 << 22, 16
"""Columns of a rectangle, at most (16 MiB), and for each that comes: else these are sorted."""

FARTHEST = 2.0**38
"""Metres from the origin; points beyond are counted in the column at the edge."""

Columns = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Occupancy:
    """Points in each occupied column of a square lattice anchored at the coordinates' origin."""

    cell: float
    """Side of a column, metres: `FINEST_CELL` times a power of two."""
    columns: Columns
    """(M, 2): floor(x / cell), floor(y / cell) of the occupied columns, in lexicographic order."""
    counts: NDArray[np.int64]
    """(M,)"""

    def without(self, xyz: NDArray[np.float64]) -> "Occupancy":
        """Return the occupancy without some of the points that it counts, few of them."""
        counts = self.counts.copy()
        for x, y in columns_of(xyz, self.cell).tolist():
            first, end = np.searchsorted(self.columns[:, 0], [x, x + 1])
            counts[first + np.searchsorted(self.columns[first:end, 1], y)] -= 1
        occupied = counts > 0
        return Occupancy(self.cell, self.columns[occupied], counts[occupied])


def columns_of(xyz: NDArray[np.float64], cell: float) -> Columns:
    """Return the lattice column of each point, (n, 2): floor(x / cell), floor(y / cell).

    Coordinates are finite, (n, 3); the cell is a power of two, so that the division is exact.
    Points beyond `FARTHEST` are in the column at the edge.
    """
    return np.floor(np.clip(xyz[:, :2], -FARTHEST, FARTHEST) / cell).astype(np.int64)


def distinct_columns(columns: Columns) -> tuple[Columns, NDArray[np.intp]]:
    """Return the columns that come, each once and in order, and which of them each that came is."""
    if not len(columns):
        return columns, np.zeros(0, np.intp)
    low, high = columns.min(axis=0), columns.max(axis=0)
    wide, deep = (high - low + 1).tolist()
    if wide * deep > min(_LARGEST_RASTER, _RASTER_EACH * len(columns)):
        return _distinct_by_sorting(columns)
    places = (columns[:, 0] - low[0]) * deep + (columns[:, 1] - low[1])
    raster = np.zeros(wide * deep, np.int32)
    raster[places] = 1
    held = np.flatnonzero(raster)
    raster[held] = np.arange(len(held))
    return np.column_stack(np.divmod(held, deep)) + low, raster[places].astype(np.intp)


def _distinct_by_sorting(columns: Columns) -> tuple[Columns, NDArray[np.intp]]:
    order = np.lexsort((columns[:, 1], columns[:, 0]))
    ordered = columns.take(order, axis=0)
    is_new = (np.diff(ordered, axis=0, prepend=ordered[:1] - 1) != 0).any(axis=1)
    numbers = np.empty(len(columns), np.intp)
    numbers[order] = np.cumsum(is_new) - 1
    return ordered[is_new], numbers


def count_within(
    occupancy: Occupancy, low: NDArray[np.float64], high: NDArray[np.float64]
) -> NDArray[np.int64]:
    """Count the points in boxes, (n,), a column counting whole where its middle is inside.

    The boxes are low <= x, y < high, (n, 2), metres; they may be infinite.
    """
    begins, ends = (_first_columns(edge, occupancy.cell) for edge in (low, high))
    # Those of one x are a run of columns, in the order of y.
    firsts, lasts = (np.searchsorted(occupancy.columns[:, 0], x[:, 0]) for x in (begins, ends))
    sums = np.zeros(len(low), np.int64)
    for box, (first, last) in enumerate(zip(firsts, lasts, strict=True)):
        y = occupancy.columns[first:last, 1]
        inside = (y >= begins[box, 1]) & (y < ends[box, 1])
        sums[box] = occupancy.counts[first:last][inside].sum()
    return sums


def _first_columns(edge: NDArray[np.float64], cell: float) -> Columns:
    """Return the first column whose middle is at an edge or after it."""
    # The middle is half a cell from where the column begins.
    return np.ceil(np.clip(edge, -2 * FARTHEST, 2 * FARTHEST) / cell - 0.5).astype(np.int64)


class ColumnCounter:
    """Counts points by column, and coarsens the lattice when too many columns are occupied.

    The result depends on the points alone, not on their order: the columns that some of the
    points occupy are never more than those of all. Its memory is bounded by `MOST_COLUMNS`.
    """

    def __init__(self, cell: float = FINEST_CELL) -> None:
        self.cell = cell
        """Side of a column at present, metres."""
        self._parts = [Occupancy(cell, np.empty((0, 2), np.int64), np.empty(0, np.int64))]

    def add_points(self, xyz: NDArray[np.float64]) -> None:
        """Count points, whose coordinates are finite."""
        columns, numbers = distinct_columns(columns_of(xyz, self.cell))
        self.add(Occupancy(self.cell, columns, np.bincount(numbers, minlength=len(columns))))

    def add(self, occupancy: Occupancy) -> None:
        """Count the points of an occupancy."""
        self._parts.append(occupancy)
        if sum(len(part.counts) for part in self._parts) > MOST_COLUMNS * 5 // 4:
            self.occupancy()

    def occupancy(self) -> Occupancy:
        """Return the counts so far."""
        self.cell = max(self.cell, *(part.cell for part in self._parts))
        whole = _summed(self._parts, self.cell)
        while len(whole.counts) > MOST_COLUMNS:
            self.cell *= 2
            whole = _summed([whole], self.cell)
        self._parts = [whole]
        return whole


def _summed(parts: Sequence[Occupancy], cell: float) -> Occupancy:
    """Return the counts of all parts on a lattice of cells that are as wide as theirs, or wider."""
    steps = [round(np.log2(cell / part.cell)) for part in parts]
    columns = np.concatenate([part.columns >> n for part, n in zip(parts, steps, strict=True)])
    counts = np.concatenate([part.counts for part in parts])
    occupied, numbers = distinct_columns(columns)
    sums = np.zeros(len(occupied), np.int64)
    np.add.at(sums, numbers, counts)
    return Occupancy(cell, occupied, sums)


@dataclass(frozen=True, slots=True)
class Survey:
    """What is known of a map, or of a part of it."""

    point_count: int
    """All points."""
    finite_count: int
    """Points whose coordinates are finite."""
    minimum: NDArray[np.float64]
    maximum: NDArray[np.float64]
    """(3,): bounds of the finite points, metres; infinities the wrong way round if there are
    none."""
    occupancy: Occupancy
    """Of the finite points."""

    def without(
        self, xyz: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64]
    ) -> "Survey":
        """Return the survey without some of its finite points, the others being within a box."""
        return Survey(
            self.point_count,
            self.finite_count - len(xyz),
            np.maximum(self.minimum, low),
            np.minimum(self.maximum, high),
            self.occupancy.without(xyz),
        )

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Return the survey as arrays, for a file that hands it from one process to another."""
        return {
            "point_counts": np.array([self.point_count, self.finite_count]),
            "bounds": np.array([self.minimum, self.maximum]),
            "cell": np.array(self.occupancy.cell),
            "columns": self.occupancy.columns,
            "counts": self.occupancy.counts,
        }

    @classmethod
    def from_arrays(
        cls,
        point_counts: NDArray[np.int64],
        bounds: NDArray[np.float64],
        cell: NDArray[np.float64],
        columns: NDArray[np.int64],
        counts: NDArray[np.int64],
    ) -> "Survey":
        """Return the survey that `to_arrays` turned into these."""
        occupancy = Occupancy(float(cell), columns, counts)
        points, finite = point_counts.tolist()
        return cls(points, finite, bounds[0], bounds[1], occupancy)


def survey(collection: MapCollection, rows: range | None = None) -> Survey:
    """Survey a map, or some consecutive rows of it; see `MapCollection.batches` for errors."""
    return survey_batches(batch for _, batch in collection.batches(rows=rows))


def survey_batches(batches: Iterable[PointBatch]) -> Survey:
    """Survey a stream of points; see `survey`."""
    points = finite_count = 0
    minimum, maximum = _no_bounds()
    counter = ColumnCounter()
    for batch in batches:
        finite = only_finite(batch.xyz)
        points += len(batch.xyz)
        finite_count += len(finite)
        minimum = np.minimum(minimum, finite.min(axis=0, initial=np.inf))
        maximum = np.maximum(maximum, finite.max(axis=0, initial=-np.inf))
        counter.add_points(finite)
    return Survey(points, finite_count, minimum, maximum, counter.occupancy())


def merge(parts: Iterable[Survey]) -> Survey:
    """Return the survey of several parts of a map together, in any order."""
    points = finite = 0
    minimum, maximum = _no_bounds()
    counter = ColumnCounter()
    for part in parts:
        points += part.point_count
        finite += part.finite_count
        np.minimum(minimum, part.minimum, out=minimum)
        np.maximum(maximum, part.maximum, out=maximum)
        counter.add(part.occupancy)
    return Survey(points, finite, minimum, maximum, counter.occupancy())


def _no_bounds() -> NDArray[np.float64]:
    return np.array([[np.inf] * 3, [-np.inf] * 3])
