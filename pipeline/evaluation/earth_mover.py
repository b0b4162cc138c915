"""The Earth Mover's Distance between samples of two maps, by POT, an optional extra.

Exact transport costs n^2 memory and more time than that, so maps are sampled. A sample differs from
its own map: `sampling_floor` says by how much, and no distance below it means anything.
"""

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from pipeline.configuration.quantities import in_units
from pipeline.errors import EvaluationError, MissingPackageError, PlanError
from pipeline.plan.machine import available_memory

GroundCost = Literal["euclidean", "sqeuclidean"]

_BYTES_A_PAIR = 42
"""Of two points, one of each sample; measured with POT 0.9.6 at 4,000 and 8,000 points."""

_MOST_STEPS = 10_000_000
"""Steps of the network simplex: POT's own limit, 100,000, is reached by some thousand points."""


class EarthMoversDistance(BaseModel):
    """The least cost of moving one sample into the other, all points of a sample weighing alike.

    Rubner, Tomasi, Guibas (IJCV 2000) with equal total weights, which is the Wasserstein distance;
    `ot.emd2` of POT (Flamary et al., JMLR 2021). The DynaHull paper reports it.

    Attributes
    ----------
    distance : float
        Mean cost of a unit of weight: metres, or square metres with the squared ground cost.
    sampling_floor : float
        The same between two samples of the truth alone.
    cleaned_points, truth_points : int
        Sizes of the samples, drawn at random, uniformly, without replacement; a map that has fewer
        points than were asked for is its own sample.
    ground_cost : str
        Of moving a unit from x to y: `euclidean` |x - y|, `sqeuclidean` |x - y|^2.
    seed : int
    """

    model_config = ConfigDict(frozen=True)

    distance: float
    sampling_floor: float
    cleaned_points: int
    truth_points: int
    ground_cost: GroundCost
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
    try:
        import ot  # noqa: PLC0415 (optional, and seconds of import time)
    except (ImportError, OSError) as error:
        raise MissingPackageError(
            "the Earth Mover's Distance needs POT: pip install 'dynahull-pipeline[evaluation]', "
            f"or leave it out with --emd-points 0 ({error})"
        ) from error
    return ot


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
