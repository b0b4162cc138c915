"""How far poses are from the truth: evo (Grupp), without any alignment of the trajectories."""

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Errors", "errors_of"]

STEP = 1.0
"""Metres of way over which relative errors are taken."""

LOST = 0.5
"""Metres from the truth: a robot that far off does not fit through its doors."""


@dataclass(frozen=True, slots=True)
class Errors:
    """Errors of a trajectory.

    Attributes
    ----------
    ape_rmse, ape_largest : float
        Absolute pose error, translation, millimetres.
    heading_rmse : float
        Absolute pose error, angle of rotation, degrees.
    rpe_rmse : float
        Relative pose error over each metre of the way, translation, millimetres.
    lost_percent : float
        Of the scans: farther than `LOST` from the truth.
    """

    ape_rmse: float
    ape_largest: float
    heading_rmse: float
    rpe_rmse: float
    lost_percent: float

    def figures(self) -> dict[str, float]:
        """Return all by name."""
        return asdict(self)


def errors_of(poses: NDArray[np.float64], truth: NDArray[np.float64]) -> Errors:
    """Compare poses with the truth.

    Parameters
    ----------
    poses, truth : (S, 4, 4) float64 array
    """
    from evo.core.metrics import APE, RPE, PoseRelation  # noqa: PLC0415 (extra `localisation`)
    from evo.core.trajectory import PosePath3D  # noqa: PLC0415
    from evo.core.units import Unit  # noqa: PLC0415

    pair = PosePath3D(poses_se3=list(truth)), PosePath3D(poses_se3=list(poses))
    place, turn = APE(PoseRelation.translation_part), APE(PoseRelation.rotation_angle_deg)
    # Pairs from the truth, so that all maps are compared over the same stretches of the way.
    way = RPE(
        PoseRelation.translation_part, STEP, Unit.meters, all_pairs=True, pairs_from_reference=True
    )
    for metric in (place, turn, way):
        metric.process_data(pair)
    of_place = place.get_all_statistics()
    return Errors(
        ape_rmse=1000 * of_place["rmse"],
        ape_largest=1000 * of_place["max"],
        heading_rmse=turn.get_all_statistics()["rmse"],
        rpe_rmse=1000 * way.get_all_statistics()["rmse"],
        lost_percent=100 * float(np.mean(place.error > LOST)),
    )
