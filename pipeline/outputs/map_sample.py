"""The points that a report shows: a sample that row numbers decide.

It is the same however a map is cut, and no larger however large the map is.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from dynahull.clustering import ranked_below
from dynahull.evidence.range_images import MET, THROUGH, Views
from dynahull.evidence.summaries import FINEST
from dynahull.evidence.voxels import cells_of, unique_cells
from dynahull.labels import Label

MOST_POINTS = 300_000
"""Points that a report shows, at most."""


def magnitude(density: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the logarithms to base 10 of densities; finite for one that is rounded to zero.

    Where k neighbours fill more than 1e308 cubic metres k / v is zero, or too small to be exact.
    """
    return np.log10(np.maximum(density, np.finfo(np.float64).tiny))


@dataclass(frozen=True, slots=True)
class MapSample:
    """Some points of a map, and what the method made of them; invalid points are not among them."""

    total: int
    """Points of the whole map."""
    rows: NDArray[np.int64]
    """(n,): row numbers, ascending."""
    xyz: NDArray[np.float64]
    """(n, 3): metres."""
    labels: NDArray[np.uint8]
    """(n,)"""
    cluster: NDArray[np.int32]
    """(n,): -1 where not clustered."""
    density: NDArray[np.float64]
    """(n,): NaN where not scored."""
    score: NDArray[np.float32]
    """(n,): probability of having moved; NaN where not scored, or not weighed."""
    scan: NDArray[np.int32] | None = None
    """(n,): number of the scan that saw each, -1 where not known; None where nothing tells."""
    met: NDArray[np.int64] | None = None
    through: NDArray[np.int64] | None = None
    """(n,): how many scans met its voxel, and saw through it; None where poses are not known."""

    def __len__(self) -> int:
        return len(self.rows)

    @classmethod
    def of_map(
        cls,
        points: NDArray[np.float64],
        labels: NDArray[np.uint8],
        cluster: NDArray[np.int32],
        density: NDArray[np.float64],
        score: NDArray[np.float32],
    ) -> Self:
        """Take the sample of a map in memory."""
        rows = sampled_rows(len(points))
        rows = rows[labels[rows] != Label.INVALID]
        columns = (points, labels, cluster, density, score)
        return cls(len(points), rows, *(column[rows] for column in columns))

    @classmethod
    def of_parts(cls, total: int, parts: Sequence["MapSample"]) -> Self:
        """Put the samples of all parts of a map together."""
        parts = [cls.empty(total), *parts]
        columns = {
            name: np.concatenate([getattr(part, name) for part in parts]) for name in _COLUMNS
        }
        order = np.argsort(columns["rows"])
        order = order[columns["labels"][order] != Label.INVALID]
        return cls(total, **{name: column[order] for name, column in columns.items()})

    @classmethod
    def empty(cls, total: int) -> Self:
        """Return the sample of no points."""
        kinds = (np.uint8, np.int32, np.float64, np.float32)
        others: list[Any] = [np.empty(0, kind) for kind in kinds]
        return cls(total, np.empty(0, np.int64), np.empty((0, 3)), *others)

    def seen(self, scan: NDArray[np.int32] | None, views: Views | None, threads: int = 1) -> Self:
        """Add the scan of each point, and what all scans saw of its voxel."""
        if views is None:
            return replace(self, scan=scan)
        cells, numbers = unique_cells(cells_of(self.xyz, FINEST))
        counts = views.count(cells, FINEST, threads)[numbers]
        return replace(self, scan=scan, met=counts[:, MET], through=counts[:, THROUGH])


_COLUMNS = ("rows", "xyz", "labels", "cluster", "density", "score")


def sampled_rows(total: int) -> NDArray[np.int64]:
    """Return the row numbers of the sample of a map of `total` points, ascending."""
    return _sampled(np.arange(total), total)


def is_sampled(rows: NDArray[np.int64], total: int) -> NDArray[np.bool_]:
    """Tell which row numbers of a map are in its sample."""
    sampled = np.zeros(len(rows), np.bool_)
    sampled[_sampled(rows, total)] = True
    return sampled


def _sampled(rows: NDArray[np.int64], total: int) -> NDArray[np.intp]:
    """Return which of the rows are sampled: all of a small map, else those of the lowest ranks.

    Ranks are blind to any period in the recording. How many lie below a limit varies by the root of
    their number: five times that is left free, so that there are never more than `MOST_POINTS`.
    """
    if total <= MOST_POINTS:
        return np.arange(len(rows))
    wanted = MOST_POINTS - 5 * math.isqrt(MOST_POINTS)
    return ranked_below(2**64 * wanted // total, rows, seed=0)
