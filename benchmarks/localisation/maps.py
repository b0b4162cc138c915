"""The maps of a first drive, and the scans of a second one through the same scene."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynahull import clean
from pipeline.configuration import load_configuration
from pipeline.simulation import SimulationParameters, simulate_scans

__all__ = ["CLEANED_WITH", "NOT_CLEANED", "TRUE", "SecondDrive", "maps_of", "second_drive"]

Floats = NDArray[np.float64]

TRUE, NOT_CLEANED = "true map", "not cleaned"

CLEANED_WITH = ("paper", "indoor")
"""Ready configurations."""


@dataclass(frozen=True, slots=True)
class SecondDrive:
    """Scans that are to be found on a map.

    Attributes
    ----------
    scans : list of (n, 3) float64 array
        In the sensor's frame, metres.
    poses : (S, 4, 4) float64 array
        Where the sensor truly was, in the map's frame.
    """

    scans: list[Floats]
    poses: Floats


def maps_of(parameters: SimulationParameters) -> Mapping[str, Floats]:
    """Return the true map, the map as it is and as it is cleaned, (N, 3) each, by name.

    The true map has the noise and the drift of the drive, and no ghosts: what the best cleaning
    could leave, and what stood behind the ghosts.
    """
    scans = list(simulate_scans(parameters))
    xyz = np.concatenate([scan.returns.xyz for scan in scans])
    maps = {
        TRUE: np.concatenate([scan.static_returns.xyz for scan in scans]),
        NOT_CLEANED: xyz,
    }
    for name in CLEANED_WITH:
        maps[f"cleaned, {name}"] = xyz[clean(xyz, load_configuration(name).method()).kept]
    return maps


def second_drive(parameters: SimulationParameters) -> SecondDrive:
    """Drive once more, on another day: other people, noise and drift."""
    another = parameters.model_copy(update={"drive": parameters.drive + 1})
    scans = list(simulate_scans(another))
    poses = np.tile(np.eye(4), (len(scans), 1, 1))
    poses[:, :3] = [scan.true_pose for scan in scans]
    return SecondDrive([scan.in_sensor_frame() for scan in scans], poses)
