"""How far a map lies from the truth: nearest-point distances and what is made of them.

All of them take the distances from each point of one map to its nearest point in the other.
"""

import math
from collections.abc import Iterable, Iterator
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from pipeline.evaluation.order_statistics import order_statistics

Batches = Iterable[NDArray[np.float64]]
"""Distances in batches, together at least one, which can be gone through several times."""


class DistanceStatistics(BaseModel):
    """Distances d of the cleaned map's points to their nearest points in the truth.

    The DynaHull paper (Habibiroudkenar, Ojala, Tammi 2024, arXiv 2401.07541) reports them; in
    metres, the variance in square metres.

    Attributes
    ----------
    count : int
        n, points of the cleaned map that are compared.
    mean_absolute_error : float
        MAE, sum(d) / n.
    variance : float
        sum((d - MAE)^2) / n: of the points at hand, not an estimate for others (no n - 1).
    root_mean_square_error : float
        RMSE, sqrt(sum(d^2) / n); its square is variance + MAE^2.
    percentile_90 : float
        A tenth of the points is farther away; linear between the two nearest in rank.
    largest : float
        The one-sided Hausdorff distance.
    """

    model_config = ConfigDict(frozen=True)

    count: int
    mean_absolute_error: float
    variance: float
    root_mean_square_error: float
    percentile_90: float
    largest: float

    @classmethod
    def of(cls, distances: Batches) -> "DistanceStatistics":
        """Take them of distances; neither their order nor the batches matter, to the last bit."""
        count = sum(map(len, distances))
        mean = exact_sum(distances) / count
        rank = 0.9 * (count - 1)
        below = int(rank)
        low, high = order_statistics(distances, below)
        return cls(
            count=count,
            mean_absolute_error=mean,
            variance=exact_sum(np.square(each - mean) for each in distances) / count,
            root_mean_square_error=math.sqrt(_squares(distances) / count),
            percentile_90=low + (rank - below) * (high - low),
            largest=max(float(each.max(initial=0.0)) for each in distances),
        )


class DirectedChamfer(BaseModel):
    """One direction of the Chamfer distance: from each point to its nearest in the other map.

    Attributes
    ----------
    squared : float
        Mean of the squared distances, square metres.
    unsquared : float
        Mean of the distances, metres.
    """

    model_config = ConfigDict(frozen=True)

    squared: float
    unsquared: float

    @classmethod
    def of(cls, distances: Batches) -> "DirectedChamfer":
        """Take the means; neither the order of the distances nor the batches matter."""
        count = sum(map(len, distances))
        return cls(squared=_squares(distances) / count, unsquared=exact_sum(distances) / count)


class ChamferDistance(BaseModel):
    """The Chamfer distance between the cleaned map C and the truth T.

    mean over c of min over t of |c - t|^2, plus mean over t of min over c of |t - c|^2: the form
    of Fan, Su, Guibas (CVPR 2017), by means in place of their sums, so that it does
    not grow with the number of points. Published code and text differ in the square, in adding or
    averaging the directions, and in taking one direction only, so all parts are here.

    Attributes
    ----------
    squared : float
        Both directions added, square metres.
    unsquared : float
        The same of plain distances, metres.
    cleaned_to_truth : DirectedChamfer
        What the cleaned map has too much.
    truth_to_cleaned : DirectedChamfer
        What it lacks.
    """

    model_config = ConfigDict(frozen=True)

    squared: float
    unsquared: float
    cleaned_to_truth: DirectedChamfer
    truth_to_cleaned: DirectedChamfer

    @classmethod
    def of(
        cls, cleaned_to_truth: DirectedChamfer, truth_to_cleaned: DirectedChamfer
    ) -> "ChamferDistance":
        """Add the two directions."""
        return cls(
            squared=cleaned_to_truth.squared + truth_to_cleaned.squared,
            unsquared=cleaned_to_truth.unsquared + truth_to_cleaned.unsquared,
            cleaned_to_truth=cleaned_to_truth,
            truth_to_cleaned=truth_to_cleaned,
        )


def exact_sum(batches: Batches) -> float:
    """Return the sum of all numbers as if it were rounded but once: in any order the same."""
    return math.fsum(chain.from_iterable(each.tolist() for each in batches))


def _squares(distances: Batches) -> float:
    return exact_sum(np.square(each) for each in distances)


_AT_A_TIME = 100_000


class DistanceFile:
    """A file of distances, gone through in batches.

    Parameters
    ----------
    path : Path
        An earlier file of this name is replaced.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        path.write_bytes(b"")

    def append(self, distances: NDArray[np.float64]) -> None:
        """Put some more behind the others."""
        with self._path.open("ab") as stream:
            np.ascontiguousarray(distances, np.float64).tofile(stream)

    def __iter__(self) -> Iterator[NDArray[np.float64]]:
        with self._path.open("rb") as stream:
            while len(batch := np.fromfile(stream, np.float64, _AT_A_TIME)):
                yield batch

    def remove(self) -> None:
        """Remove the file."""
        self._path.unlink()
