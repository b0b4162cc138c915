"""How far the cleaned map lies from the truth, place by place: who removed what is not asked.

Most figures take the distances from each point of one map to its nearest point in the other. The
Earth Mover's Distance, by POT, an optional extra, costs n^2 memory and more time than that, so maps
are sampled. A sample differs from its own map: `sampling_floor` says by how much, and no distance
below it means anything.
"""

import math
from collections.abc import Callable
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from dynahull.clustering import random_rank
from dynahull.observer import Observer
from pipeline.configuration.quantities import in_units
from pipeline.errors import EvaluationError, PlanError
from pipeline.evaluation.inputs import EvaluationOptions, GroundCost
from pipeline.evaluation.tiled_cloud import TiledCloud, look_up
from pipeline.plan.machine import available_memory
from pipeline.showing import optional_package

Distances = NDArray[np.float64]
"""At least one; perhaps a file that is mapped into memory, and more than fits there."""

_AT_A_TIME = 100_000

_BYTES_A_PAIR = 42
"""Of two points, one of each sample; measured with POT 0.9.6 at 4,000 and 8,000 points."""

_MOST_STEPS = 10_000_000
"""Steps of the network simplex: POT's own limit, 100,000, is reached by some thousand points."""


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


class EarthMoversDistance(BaseModel, frozen=True):
    """The least cost of moving one sample into the other, all points of a sample weighing alike.

    Rubner, Tomasi, Guibas (IJCV 2000) with equal total weights, which is the Wasserstein distance;
    `ot.emd2` of POT (Flamary et al., JMLR 2021). The DynaHull paper reports it.
    """

    distance: float
    """Mean cost of a unit of weight: metres, or square metres with the squared ground cost."""
    sampling_floor: float
    """The same between two samples of the truth alone."""
    cleaned_points: int
    truth_points: int
    """Sizes of the samples, drawn at random, uniformly, without replacement; a map that has fewer
    points than were asked for is its own sample."""
    ground_cost: GroundCost
    """Of moving a unit from x to y: `euclidean` |x - y|, `sqeuclidean` |x - y|^2."""
    seed: int


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
    earth_mover = _transport(cleaned, truth, options, observer) if options.emd_points else None
    return Geometry(statistics, ChamferDistance.of(too_much, lacking), earth_mover)


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


def check_transport(points: int, cleaned: int, truth: int) -> None:
    """Refuse samples of so many points, of maps of so many, that memory does not suffice for."""
    transport_library()
    of_cleaned, of_truth = min(points, cleaned), min(points, truth)
    wanted, free = _BYTES_A_PAIR * max(of_cleaned, of_truth) * of_truth, available_memory()
    if wanted > free:
        raise PlanError(
            f"--emd-points {points}: the Earth Mover's Distance of {of_cleaned:,} and {of_truth:,} "
            f"points would take {in_units(wanted)}, and there are {in_units(free)}: choose fewer"
        )


def transport_library() -> Any:
    """Import POT, or raise a `MissingPackageError`."""
    return optional_package("the Earth Mover's Distance needs POT", "evaluation", "POT", "ot")


def transport_cost(
    first: NDArray[np.float64], second: NDArray[np.float64], ground_cost: GroundCost
) -> float:
    """Return the Earth Mover's Distance between two clouds of equally weighted points.

    Parameters
    ----------
    first, second : (n, 3) and (m, 3) arrays

    Raises
    ------
    EvaluationError
        When no optimum is reached.
    """
    ot = transport_library()
    # Large coordinates (UTM) lose digits where POT expands the square; the cost does not see a
    # shift of both.
    centre = first.mean(axis=0)
    costs = ot.dist(first - centre, second - centre, metric=ground_cost)
    weights = (np.full(len(each), 1 / len(each)) for each in (first, second))
    cost, log = ot.emd2(*weights, costs, numItermax=_MOST_STEPS, log=True)
    if log["warning"]:
        raise EvaluationError(f"no optimal transport found: {log['warning']}")
    return float(cost)


def draw_sample(cloud: TiledCloud, size: int, seed: int, stream: int) -> NDArray[np.float64]:
    """Draw points at random, uniformly, without replacement; all where there are not more.

    Row numbers decide, see `dynahull.clustering.random_rank`: those of the lowest ranks are drawn.
    Samples of one seed and several streams, up to 4, are independent of each other. They are
    (min(n, size), 3), in the order of their rows, whatever the tiles.
    """
    rows, xyz = np.empty(0, np.int64), np.empty((0, 3))
    for tile in cloud.tiles():
        rows = np.concatenate([rows, cloud.rows(tile)])
        xyz = np.concatenate([xyz, cloud.xyz(tile)])
        if len(rows) > size:
            drawn = np.argpartition(random_rank(rows, 4 * seed + stream), size)[:size]
            rows, xyz = rows[drawn], xyz[drawn]
    return np.asarray(xyz[np.argsort(rows)])
