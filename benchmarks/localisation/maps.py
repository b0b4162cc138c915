"""The maps of a first drive, and the scans of a second one through the same scene."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from dynahull import clean
from pipeline.configuration.run import load_configuration
from pipeline.simulation import SimulationParameters, simulate_scans

__all__ = [
    "CLEANED_WITH",
    "NOT_CLEANED",
    "PERFECT",
    "TRUE",
    "SecondDrive",
    "maps_of",
    "odometry",
    "second_drive",
]

Floats = NDArray[np.float64]

TRUE, NOT_CLEANED, PERFECT = "true map", "not cleaned", "cleaned perfectly"

CLEANED_WITH = ("paper", "indoor", "auto")
"""Ready configurations."""

SLIP, TURN_ERROR = 0.05, 0.05
"""Standard deviations of the odometry's errors, of the way and of the angle between two scans."""


@dataclass(frozen=True, slots=True)
class SecondDrive:
    """Scans that are to be found on a map.

    Attributes
    ----------
    scans : list of (n, 3) float64 array
        In the sensor's frame, metres.
    poses : (S, 4, 4) float64 array
        Where the sensor truly was, in the map's frame.
    moves : (S - 1, 4, 4) float64 array
        What the wheels tell of the motion from each scan to the next: the truth, with errors.
    """

    scans: list[Floats]
    poses: Floats
    moves: Floats


def maps_of(parameters: SimulationParameters) -> Mapping[str, Floats]:
    """Return the true map, the map as it is and as it is cleaned, (N, 3) each, by name.

    The true map has the noise and the drift of the drive, and no ghosts: what a perfect cleaning
    leaves, and what stood behind the ghosts.
    """
    scans = list(simulate_scans(parameters))
    xyz = np.concatenate([scan.returns.xyz for scan in scans])
    maps = {
        TRUE: np.concatenate([scan.static_returns.xyz for scan in scans]),
        NOT_CLEANED: xyz,
        PERFECT: xyz[~np.concatenate([scan.returns.moving for scan in scans])],
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
    random = np.random.default_rng(np.random.SeedSequence((another.seed, another.drive)))
    moves = odometry(np.linalg.inv(poses[:-1]) @ poses[1:], random)
    return SecondDrive([scan.in_sensor_frame() for scan in scans], poses, moves)


def odometry(moves: Floats, random: np.random.Generator) -> Floats:
    """Return motions, (n, 4, 4), as wheels would tell them: too long or short, turned too far."""
    told = moves.copy()
    told[:, :3, 3] *= 1 + random.normal(0, SLIP, (len(moves), 1))
    turns = Rotation.from_matrix(moves[:, :3, :3]).as_rotvec()
    turns *= 1 + random.normal(0, TURN_ERROR, (len(moves), 1))
    told[:, :3, :3] = Rotation.from_rotvec(turns).as_matrix()
    return told
