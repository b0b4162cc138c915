"""Poses of the sensor in the map: the true ones, and those a SLAM system would estimate."""

import numpy as np
from numpy.typing import NDArray

from pipeline.simulation.parameters import SimulationParameters

DRIFT_SECONDS = 10.0
"""Time over which the error of the estimated pose is forgotten."""


def turned(vectors: NDArray[np.float64], heading: NDArray[np.float64]) -> NDArray[np.float64]:
    """Turn (n, 3) vectors about z, each by its own heading in radians."""
    cosine, sine = np.cos(heading), np.sin(heading)
    x, y, z = vectors.T
    return np.stack([cosine * x - sine * y, sine * x + cosine * y, z], axis=1)


def pose_matrix(position: NDArray[np.float64], heading: float) -> NDArray[np.float64]:
    """Return the (3, 4) transform from the sensor's frame to the map's."""
    matrix = np.zeros((3, 4))
    matrix[:, :3] = turned(np.eye(3), np.full(3, heading)).T
    matrix[:, 3] = position
    return matrix


def to_map(pose: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Take (n, 3) points from the sensor's frame to the map's."""
    return points @ pose[:, :3].T + pose[:, 3]


def to_sensor(pose: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Take (n, 3) points from the map's frame to the sensor's."""
    return (points - pose[:, 3]) @ pose[:, :3]


def drift(parameters: SimulationParameters, random: np.random.Generator) -> NDArray[np.float64]:
    """Return the error of the estimated pose during each scan.

    An Ornstein-Uhlenbeck process from 0: the error wanders, and loop closures hold it near 0, so
    that a wall seen several times becomes thicker and not two walls.

    Returns
    -------
    (scans, 4) float64 array
        x, y and z in metres, heading in radians.
    """
    deviation = np.array([parameters.drift_position] * 3 + [np.radians(parameters.drift_heading)])
    kept = np.exp(-parameters.scan_interval / DRIFT_SECONDS)
    steps = random.normal(size=(parameters.scans, 4)) * deviation * np.sqrt(1 - kept**2)
    errors = np.zeros((parameters.scans, 4))
    for scan in range(1, parameters.scans):
        errors[scan] = kept * errors[scan - 1] + steps[scan]
    return errors
