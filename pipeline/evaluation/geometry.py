"""The cleaned map against the truth, place by place: who removed what is not asked."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynahull.progress import Observer
from pipeline.evaluation.cloud import Cloud, NearestPoint, look_up
from pipeline.evaluation.distances import ChamferDistance, DirectedChamfer, DistanceStatistics
from pipeline.evaluation.earth_mover import EarthMoversDistance, draw_sample, transport_cost
from pipeline.evaluation.options import EvaluationOptions


@dataclass(frozen=True, slots=True)
class Geometry:
    """The distances between two maps; `earth_mover` is None where none was asked for."""

    distances: DistanceStatistics
    chamfer: ChamferDistance
    earth_mover: EarthMoversDistance | None


def compare_geometry(
    cleaned: Cloud, truth: Cloud, options: EvaluationOptions, observer: Observer
) -> Geometry:
    """Measure the distances between the cleaned map and the truth.

    Parameters
    ----------
    cleaned, truth : Cloud
        Each with at least one finite point.
    options : EvaluationOptions
        Of the Earth Mover's Distance.
    observer : Observer

    Returns
    -------
    Geometry

    Raises
    ------
    EvaluationError
        When a cloud has no finite point.
    """
    points = truth.points()
    truth_sample, other_sample = (
        draw_sample(points, options.emd_points, options.seed, stream) for stream in (0, 1)
    )
    distances = _all_distances(cleaned, NearestPoint(points), observer)
    del points

    points = cleaned.points()
    cleaned_sample = draw_sample(points, options.emd_points, options.seed, 2)
    found = look_up(truth, NearestPoint(points), observer, "from the truth")
    lacking = DirectedChamfer.of(batch for _, batch, _ in found)
    del points

    earth_mover = None
    if options.emd_points:
        observer.stage("transport", len(cleaned_sample))
        earth_mover = EarthMoversDistance(
            distance=transport_cost(cleaned_sample, truth_sample, options.ground_cost),
            sampling_floor=transport_cost(other_sample, truth_sample, options.ground_cost),
            cleaned_points=len(cleaned_sample),
            truth_points=len(truth_sample),
            ground_cost=options.ground_cost,
            seed=options.seed,
        )
        observer.advance(len(cleaned_sample))
    return Geometry(
        distances=DistanceStatistics.of(distances),
        chamfer=ChamferDistance.of(DirectedChamfer.of([distances]), lacking),
        earth_mover=earth_mover,
    )


def _all_distances(
    cleaned: Cloud, nearest: NearestPoint, observer: Observer
) -> NDArray[np.float64]:
    """Gather the distances of all points: the percentile needs them at once."""
    distances = np.empty(cleaned.row_count)
    count = 0
    for rows, batch, _ in look_up(cleaned, nearest, observer, "to the truth"):
        distances[count : count + len(rows)] = batch
        count += len(rows)
    return distances[:count]
