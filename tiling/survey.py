"""What must be known of a map before it is cut: how many points it has, and where.

A survey is one streaming pass. Surveys of parts of a map merge into that of the whole, whatever the
parts, so that several workers can share the pass.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tiling.collection import MapCollection
from tiling.formats.points import PointBatch, only_finite
from tiling.occupancy import ColumnCounter, Occupancy


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
