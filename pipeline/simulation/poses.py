"""Poses of the sensor in the map: the true ones, and those a SLAM system would estimate."""

import numpy as np
from numpy.typing import NDArray

from pipeline.simulation.parameters import SimulationParameters

DRIFT_SECONDS = 10.0
"""Time over which the error of the estimated pose is forgotten."""


def rotations(heading: NDArray[np.float64], slope: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (n, 3, 3) rotations from the sensor's frame to the map's.

    The sensor turns by its heading about z, after it was pitched up by the slope ahead.
    """
    cosine, sine = np.cos(heading), np.sin(heading)
    level = 1 / np.sqrt(1 + slope**2)
    rise = slope * level
    zero = np.zeros_like(cosine)
    rows = [
        [cosine * level, -sine, -cosine * rise],
        [sine * level, cosine, -sine * rise],
        [rise, zero, level],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def pose_matrix(position: NDArray[np.float64], heading: float, slope: float) -> NDArray[np.float64]:
    """Return the (3, 4) transform from the sensor's frame to the map's."""
    (rotation,) = rotations(np.array([heading]), np.array([slope]))
    return np.column_stack([rotation, position])


def to_map(pose: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Take (n, 3) points from the sensor's frame to the map's."""
    return points @ pose[:, :3].T + pose[:, 3]


def to_sensor(pose: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Take (n, 3) points from the map's frame to the sensor's."""
    return (points - pose[:, 3]) @ pose[:, :3]


class Drift:
    """The error of the estimated pose, scan after scan.

    An Ornstein-Uhlenbeck process from 0: the error wanders, and loop closures hold it near 0, so
    that a wall seen several times becomes thicker and not two walls.
    """

    def __init__(self, parameters: SimulationParameters, random: np.random.Generator) -> None:
        self._deviation = np.array(
            [parameters.drift_position] * 3 + [np.radians(parameters.drift_heading)]
        )
        self._kept = float(np.exp(-parameters.scan_interval / DRIFT_SECONDS))
        self._random = random
        self._error = np.zeros(4)

    def step(self) -> NDArray[np.float64]:
        """Return the error of the next scan: x, y and z in metres, heading in radians."""
        error = self._error
        new = self._random.normal(size=4) * self._deviation * np.sqrt(1 - self._kept**2)
        self._error = self._kept * error + new
        return error
