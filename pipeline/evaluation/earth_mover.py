"""The Earth Mover's Distance between samples of two maps, by POT, an optional extra.

Exact transport costs n^2 memory and more time than that, so maps are sampled. A sample differs from
its own map: `sampling_floor` says by how much, and no distance below it means anything.
"""

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from pipeline.configuration.quantities import in_units
from pipeline.errors import EvaluationError, PlanError
from pipeline.evaluation.tiled_cloud import TiledCloud
from pipeline.plan.machine import available_memory
from pipeline.showing import optional_package

GroundCost = Literal["euclidean", "sqeuclidean"]

_BYTES_A_PAIR = 42
"""Of two points, one of each sample; measured with POT 0.9.6 at 4,000 and 8,000 points."""

_RUN_BITS = 8
"""Of a row number; so a sampled point brings at most 256 others into memory."""

_MOST_STEPS = 10_000_000
"""Steps of the network simplex: POT's own limit, 100,000, is reached by some thousand points."""


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


def check_transport(points: int, cleaned: int, truth: int) -> None:
    """Refuse samples whose transport would take more memory than there is.

    Parameters
    ----------
    points : int
        Asked for, of each sample.
    cleaned, truth : int
        Points that the maps have at most.

    Raises
    ------
    MissingPackageError
        When POT is not installed.
    PlanError
    """
    transport_library()
    of_cleaned, of_truth = min(points, cleaned), min(points, truth)
    wanted, free = _BYTES_A_PAIR * max(of_cleaned, of_truth) * of_truth, available_memory()
    if wanted > free:
        raise PlanError(
            f"--emd-points {points}: the Earth Mover's Distance of {of_cleaned:,} and {of_truth:,} "
            f"points would take {in_units(wanted)}, and there are {in_units(free)}: choose fewer"
        )


def transport_library() -> Any:
    """Import POT.

    Raises
    ------
    MissingPackageError
        When it is not installed.
    """
    return optional_package("the Earth Mover's Distance needs POT", "evaluation", "POT", "ot")


def transport_cost(
    first: NDArray[np.float64], second: NDArray[np.float64], ground_cost: GroundCost
) -> float:
    """Return the Earth Mover's Distance between two clouds of equally weighted points.

    Parameters
    ----------
    first, second : (n, 3) and (m, 3) arrays
    ground_cost : {"euclidean", "sqeuclidean"}

    Raises
    ------
    MissingPackageError
        When POT is not installed.
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

    Samples of one seed and several streams are independent of each other.

    Returns
    -------
    (min(n, size), 3) array
        In the order of their rows, whatever the tiles: drawn as from an array of the points.
    """
    count = len(cloud)
    if size == 0:
        return np.empty((0, 3))
    if count <= size:
        return _points_at(cloud, np.arange(count))
    random = np.random.default_rng([seed, stream])
    return _points_at(cloud, np.sort(random.choice(count, size, replace=False, shuffle=False)))


def _points_at(cloud: TiledCloud, places: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the points at ascending places in the order of the rows.

    They are found by counting how many points are in each run of a few hundred rows, and then by
    reading what is in the runs that are hit.
    """
    counts = np.zeros(0, np.int64)
    for tile in cloud.tiles():
        found = np.bincount(cloud.rows(tile) >> _RUN_BITS, minlength=len(counts))
        found[: len(counts)] += counts
        counts = found
    ends = np.cumsum(counts)
    hit = np.zeros(len(counts), np.bool_)
    hit[np.searchsorted(ends, places, side="right")] = True
    rows, xyz = [], []
    for tile in cloud.tiles():
        of_tile = cloud.rows(tile)
        chosen = hit[of_tile >> _RUN_BITS]
        rows.append(of_tile[chosen])
        xyz.append(cloud.xyz(tile)[chosen])
    order = np.argsort(np.concatenate(rows))
    # Runs are here as a whole, so the places of their points follow from where they begin.
    held = counts * hit
    begins = np.repeat(ends - counts - (np.cumsum(held) - held), held)
    points: NDArray[np.float64] = np.concatenate(xyz)[order]
    return points[np.searchsorted(begins + np.arange(len(order)), places)]
