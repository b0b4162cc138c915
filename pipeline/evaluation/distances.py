"""How far the cleaned map lies from the truth, place by place: who removed what is not asked.

The figures take the distances from each point of one map to its nearest point in the other.
"""

import math
from collections.abc import Callable
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from dynahull.progress import Observer
from pipeline.evaluation.earth_mover import EarthMoversDistance, draw_sample, transport_cost
from pipeline.evaluation.options import EvaluationOptions
from pipeline.evaluation.tiled_cloud import TiledCloud, look_up

Distances = NDArray[np.float64]
"""At least one; perhaps a file that is mapped into memory, and more than fits there."""

_AT_A_TIME = 100_000


class DistanceStatistics(BaseModel, frozen=True):
    """Distances d of the cleaned map's points to their nearest points in the truth.

    The DynaHull paper (Habibiroudkenar, Ojala, Tammi 2024, arXiv 2401.07541) reports them; in
    metres, the variance in square metres.
    """

    count: int
    """n, points of the cleaned map that are compared."""
    mean_absolute_error: float
    """MAE, sum(d) / n."""
    variance: float
    """sum((d - MAE)^2) / n: of the points at hand, not an estimate for others (no n - 1)."""
    root_mean_square_error: float
    """RMSE, sqrt(sum(d^2) / n); its square is variance + MAE^2."""
    percentile_90: float
    """A tenth of the points is farther away; linear between the two nearest in rank."""
    largest: float
    """The one-sided Hausdorff distance."""

    @classmethod
    def of(cls, distances: Distances) -> "DistanceStatistics":
        """Take them of distances; their order does not matter to the last bit, and is changed."""
        count = len(distances)
        mean = _exact_sum(distances) / count
        rank = 0.9 * (count - 1)
        below, above = int(rank), min(int(rank) + 1, count - 1)
        distances.partition((below, above))
        low, high = float(distances[below]), float(distances[above])
        return cls(
            count=count,
            mean_absolute_error=mean,
            variance=_exact_sum(distances, lambda some: np.square(some - mean)) / count,
            root_mean_square_error=math.sqrt(_exact_sum(distances, np.square) / count),
            percentile_90=low + (rank - below) * (high - low),
            largest=float(distances.max()),
        )


class DirectedChamfer(BaseModel, frozen=True):
    """One direction of the Chamfer distance: from each point to its nearest in the other map."""

    squared: float
    """Mean of the squared distances, square metres."""
    unsquared: float
    """Mean of the distances, metres."""

    @classmethod
    def of(cls, distances: Distances) -> "DirectedChamfer":
        """Take the means; the order of the distances does not matter."""
        count = len(distances)
        squared = _exact_sum(distances, np.square) / count
        return cls(squared=squared, unsquared=_exact_sum(distances) / count)


class ChamferDistance(BaseModel, frozen=True):
    """The Chamfer distance between the cleaned map C and the truth T.

    mean over c of min over t of |c - t|^2, plus mean over t of min over c of |t - c|^2: the form
    of Fan, Su, Guibas (CVPR 2017), by means in place of their sums, so that it does
    not grow with the number of points. Published code and text differ in the square, in adding or
    averaging the directions, and in taking one direction only, so all parts are here.
    """

    squared: float
    """Both directions added, square metres."""
    unsquared: float
    """The same of plain distances, metres."""
    cleaned_to_truth: DirectedChamfer
    """What the cleaned map has too much."""
    truth_to_cleaned: DirectedChamfer
    """What it lacks."""

    @classmethod
    def of(cls, there: DirectedChamfer, back: DirectedChamfer) -> "ChamferDistance":
        """Add the directions: cleaned to truth, and back."""
        return cls(
            squared=there.squared + back.squared,
            unsquared=there.unsquared + back.unsquared,
            cleaned_to_truth=there,
            truth_to_cleaned=back,
        )


def _exact_sum(
    distances: Distances, changed: Callable[[Distances], Distances] = np.asarray
) -> float:
    """Return the sum of all numbers, each changed, as if it were rounded but once."""
    parts = (distances[at : at + _AT_A_TIME] for at in range(0, len(distances), _AT_A_TIME))
    return math.fsum(chain.from_iterable(changed(part).tolist() for part in parts))


class Geometry(NamedTuple):
    """The distances between two maps; `earth_mover` is None where none was asked for."""

    distances: DistanceStatistics
    chamfer: ChamferDistance
    earth_mover: EarthMoversDistance | None


def compare_geometry(
    cleaned: TiledCloud,
    truth: TiledCloud,
    options: EvaluationOptions,
    folder: Path,
    observer: Observer,
) -> Geometry:
    """Measure the distances between the cleaned map and the truth, which have a point at least.

    The distances lie in the folder, those of one direction at a time.
    """
    distances = _all_distances(cleaned, truth, folder, observer, "to the truth")
    statistics, too_much = DistanceStatistics.of(distances), DirectedChamfer.of(distances)
    distances = _all_distances(truth, cleaned, folder, observer, "from the truth")
    lacking = DirectedChamfer.of(distances)
    return Geometry(
        distances=statistics,
        chamfer=ChamferDistance.of(too_much, lacking),
        earth_mover=_transport(cleaned, truth, options, observer) if options.emd_points else None,
    )


def _all_distances(
    cloud: TiledCloud, other: TiledCloud, folder: Path, observer: Observer, stage: str
) -> Distances:
    """Write the distances of all points, which the percentile and the variance need again."""
    file = folder / "distances"
    with file.open("wb") as stream:
        for _, nearest in look_up(cloud, other, observer, stage):
            nearest.distances.tofile(stream)
    return np.memmap(file, np.float64)


def _transport(
    cleaned: TiledCloud, truth: TiledCloud, options: EvaluationOptions, observer: Observer
) -> EarthMoversDistance:
    """Move a sample of the cleaned map, and another of the truth, onto a sample of the truth."""
    of_truth, other, of_cleaned = (
        draw_sample(cloud, options.emd_points, options.seed, stream)
        for stream, cloud in enumerate((truth, truth, cleaned))
    )
    observer.stage("transport", len(of_cleaned))
    return EarthMoversDistance(
        distance=transport_cost(of_cleaned, of_truth, options.ground_cost),
        sampling_floor=transport_cost(other, of_truth, options.ground_cost),
        cleaned_points=len(of_cleaned),
        truth_points=len(of_truth),
        ground_cost=options.ground_cost,
        seed=options.seed,
    )
