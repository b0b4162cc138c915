"""What must be known of a map before it is cut: how many points it has, and where.

A survey is one streaming pass. Surveys of parts of a map merge into that of the whole, whatever the
parts, so that several workers can share the pass.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tiling.formats.base import PointBatch

FINEST_CELL = 0.25
"""Side of a column of the occupancy lattice, metres, before any coarsening."""

MOST_COLUMNS = 2_000_000
"""Occupied columns beyond which the lattice is coarsened to cells twice as wide."""

_FARTHEST_CELL = 2.0**40


@dataclass(frozen=True, slots=True)
class Occupancy:
    """Points in each occupied column of a square lattice anchored at the coordinates' origin.

    Attributes
    ----------
    cell : float
        Side of a column, metres: `FINEST_CELL` times a power of two.
    columns : (M, 2) int64 array
        floor(x / cell), floor(y / cell) of the occupied columns, in lexicographic order.
    counts : (M,) int64 array
    """

    cell: float
    columns: NDArray[np.int64]
    counts: NDArray[np.int64]

    @classmethod
    def none(cls) -> "Occupancy":
        """Return the occupancy of no points."""
        return cls(FINEST_CELL, np.empty((0, 2), np.int64), np.empty(0, np.int64))

    def coarsened(self, cell: float) -> "Occupancy":
        """Return the same points on wider cells."""
        steps = round(np.log2(cell / self.cell))
        return _summed(cell, self.columns >> steps, self.counts)


@dataclass(frozen=True, slots=True)
class Survey:
    """What is known of a map, or of a part of it.

    Attributes
    ----------
    point_count : int
        All points.
    finite_count : int
        Points whose coordinates are finite.
    minimum, maximum : (3,) float64 arrays
        Bounds of the finite points, metres; infinities the wrong way round if there are none.
    occupancy : Occupancy
        Of the finite points.
    """

    point_count: int
    finite_count: int
    minimum: NDArray[np.float64]
    maximum: NDArray[np.float64]
    occupancy: Occupancy


def survey(batches: Iterable[PointBatch]) -> Survey:
    """Survey a stream of points.

    Parameters
    ----------
    batches : iterable of PointBatch
        Of the whole map or of a part.

    Returns
    -------
    Survey
    """
    result = merge_surveys([])
    for batch in batches:
        result = merge_surveys([result, _survey_of(batch.xyz)])
    return result


def merge_surveys(parts: Iterable[Survey]) -> Survey:
    """Return the survey of several parts of a map together, in any order."""
    points = finite = 0
    minimum, maximum = np.full(3, np.inf), np.full(3, -np.inf)
    occupancies = [Occupancy.none()]
    for part in parts:
        points += part.point_count
        finite += part.finite_count
        minimum = np.minimum(minimum, part.minimum)
        maximum = np.maximum(maximum, part.maximum)
        occupancies.append(part.occupancy)
    return Survey(points, finite, minimum, maximum, _merged(occupancies))


def cells_of(xyz: NDArray[np.float64], cell: float) -> NDArray[np.int64]:
    """Return the lattice column of each point: floor(x / cell), floor(y / cell).

    Parameters
    ----------
    xyz : (n, 3) float64 array
        Finite coordinates, metres.
    cell : float
        Side of a column, metres; a power of two, so that the division is exact.

    Returns
    -------
    (n, 2) int64 array
        Columns beyond 2^40 cells from the origin are those at the edge.
    """
    columns = np.floor(xyz[:, :2] / cell)
    return np.clip(columns, -_FARTHEST_CELL, _FARTHEST_CELL).astype(np.int64)


def _survey_of(xyz: NDArray[np.float64]) -> Survey:
    finite = xyz[np.isfinite(xyz).all(axis=1)]
    bounds = np.concatenate([finite, [[np.inf] * 3]]).min(axis=0)
    limits = np.concatenate([finite, [[-np.inf] * 3]]).max(axis=0)
    columns = cells_of(finite, FINEST_CELL)
    occupancy = _bounded(_summed(FINEST_CELL, columns, np.ones(len(finite), np.int64)))
    return Survey(len(xyz), len(finite), bounds, limits, occupancy)


def _merged(occupancies: list[Occupancy]) -> Occupancy:
    """Add up occupancies on the widest of their cells."""
    cell = max(occupancy.cell for occupancy in occupancies)
    coarse = [occupancy.coarsened(cell) for occupancy in occupancies]
    columns = np.concatenate([occupancy.columns for occupancy in coarse])
    counts = np.concatenate([occupancy.counts for occupancy in coarse])
    return _bounded(_summed(cell, columns, counts))


def _bounded(occupancy: Occupancy) -> Occupancy:
    """Coarsen until no more columns are occupied than may be.

    A part never needs wider cells than the whole, so merging parts gives what the whole gives.
    """
    while len(occupancy.counts) > MOST_COLUMNS:
        occupancy = occupancy.coarsened(2 * occupancy.cell)
    return occupancy


def _summed(cell: float, columns: NDArray[np.int64], counts: NDArray[np.int64]) -> Occupancy:
    """Add up the counts of equal columns."""
    if not len(columns):
        return Occupancy(cell, np.empty((0, 2), np.int64), np.empty(0, np.int64))
    order = np.lexsort((columns[:, 1], columns[:, 0]))
    columns, counts = columns[order], counts[order]
    first = np.flatnonzero(np.append(True, (columns[1:] != columns[:-1]).any(axis=1)))
    return Occupancy(cell, columns[first], np.add.reduceat(counts, first))
