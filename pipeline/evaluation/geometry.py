"""The cleaned map against the truth, place by place: who removed what is not asked."""

from dataclasses import dataclass
from pathlib import Path

from dynahull.progress import Observer
from pipeline.evaluation.distances import (
    ChamferDistance,
    DirectedChamfer,
    DistanceFile,
    DistanceStatistics,
)
from pipeline.evaluation.earth_mover import EarthMoversDistance, transport_cost
from pipeline.evaluation.nearest_point import look_up
from pipeline.evaluation.options import EvaluationOptions
from pipeline.evaluation.sample import draw_sample
from pipeline.evaluation.tiled_cloud import TiledCloud


@dataclass(frozen=True, slots=True)
class Geometry:
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
    """Measure the distances between the cleaned map and the truth.

    Parameters
    ----------
    cleaned, truth : TiledCloud
        Each with at least one point.
    options : EvaluationOptions
        Of the Earth Mover's Distance.
    folder : Path
        For the distances, in one direction at a time.
    observer : Observer

    Returns
    -------
    Geometry
    """
    distances = _all_distances(cleaned, truth, folder, observer, "to the truth")
    statistics, too_much = DistanceStatistics.of(distances), DirectedChamfer.of(distances)
    distances.remove()
    distances = _all_distances(truth, cleaned, folder, observer, "from the truth")
    lacking = DirectedChamfer.of(distances)
    distances.remove()
    return Geometry(
        distances=statistics,
        chamfer=ChamferDistance.of(too_much, lacking),
        earth_mover=_transport(cleaned, truth, options, observer) if options.emd_points else None,
    )


def _all_distances(
    cloud: TiledCloud, other: TiledCloud, folder: Path, observer: Observer, stage: str
) -> DistanceFile:
    """Write the distances of all points, which the percentile and the variance need again."""
    distances = DistanceFile(folder / "distances")
    for _, nearest in look_up(cloud, other, observer, stage):
        distances.append(nearest.distances)
    return distances


def _transport(
    cleaned: TiledCloud, truth: TiledCloud, options: EvaluationOptions, observer: Observer
) -> EarthMoversDistance:
    """Move a sample of the cleaned map, and another of the truth, onto a sample of the truth."""
    of_truth, other, of_cleaned = (
        draw_sample(cloud, options.emd_points, options.seed, stream)
        for stream, cloud in enumerate((truth, truth, cleaned))
    )
    observer.stage("transport", len(of_cleaned))
    earth_mover = EarthMoversDistance(
        distance=transport_cost(of_cleaned, of_truth, options.ground_cost),
        sampling_floor=transport_cost(other, of_truth, options.ground_cost),
        cleaned_points=len(of_cleaned),
        truth_points=len(of_truth),
        ground_cost=options.ground_cost,
        seed=options.seed,
    )
    observer.advance(len(of_cleaned))
    return earth_mover
