"""The simplest scene there is: one thing crosses an empty hall, in full view.

Everything is in favour of whoever has scans and poses: 64 rings, exact poses, floor and walls seen
from every scan, and a box of a metre that is never twice at the same place. A method that looks for
space seen to be free must find it; if it does not, it is called wrongly.
"""

import numpy as np
from numpy.typing import NDArray

from benchmarks.compare.scene import Scene
from pipeline.evaluation.truth import Truth

__all__ = ["crossing_scene"]

Floats = NDArray[np.float64]

_HALL = np.array([[-12.0, -12.0, 0.0], [12.0, 12.0, 6.0]])
_BOX = np.array([[-0.5, -0.5, 0.0], [0.5, 0.5, 1.6]])
_SENSOR_HEIGHT = 1.8
_NOISE = 0.01


def crossing_scene(scans: int = 16, rings: int = 64, columns: int = 720, seed: int = 0) -> Scene:
    """Drive 4 m through the hall while a box crosses it, 5 m ahead.

    Parameters
    ----------
    scans : int
    rings, columns : int
        Rays of a scan, over -30.1 to 12 degrees and all around.
    seed : int
        Of the noise of the ranges.
    """
    random = np.random.default_rng(seed)
    directions = _directions(rings, columns)
    parts, ghosts = [], []
    poses = np.tile(np.eye(3, 4), (scans, 1, 1))
    poses[:, :, 3] = np.linspace([-2, -4, _SENSOR_HEIGHT], [2, -4, _SENSOR_HEIGHT], scans)
    for number, pose in enumerate(poses):
        way = -8 + 16 * number / max(scans - 1, 1)
        to_wall = _far_side(_HALL, pose[:, 3], directions)
        to_box = _near_side(_BOX + [way, 1.0, 0.0], pose[:, 3], directions)
        ranges = np.minimum(to_wall, to_box) + random.normal(0, _NOISE, len(directions))
        parts.append(pose[:, 3] + ranges[:, None] * directions)
        ghosts.append(to_box < to_wall)
    return Scene(
        name="crossing",
        group="crossing",
        xyz=np.concatenate(parts),
        labels=np.where(np.concatenate(ghosts), Truth.DYNAMIC, Truth.STATIC).astype(np.int8),
        scan=np.repeat(np.arange(scans, dtype=np.int32), len(directions)),
        poses=poses,
        ring_spacing=42.0 / rings,
    )


def _directions(rings: int, columns: int) -> Floats:
    elevation, azimuth = (
        angles.ravel()
        for angles in np.meshgrid(
            np.radians(np.linspace(-30.1, 12, rings)),
            np.radians(np.linspace(0, 360, columns, endpoint=False) + 0.05),
        )
    )
    level = np.cos(elevation)
    return np.column_stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])


def _near_side(box: Floats, origin: Floats, directions: Floats) -> Floats:
    """Return where rays from outside enter a box; infinity where they do not."""
    entries, exits = _crossings(box, origin, directions)
    entry, leave = entries.max(axis=1), exits.min(axis=1)
    return np.where((entry <= leave) & (entry > 0), entry, np.inf)


def _far_side(box: Floats, origin: Floats, directions: Floats) -> Floats:
    """Return where rays from inside leave a box."""
    return np.asarray(_crossings(box, origin, directions)[1].min(axis=1))


def _crossings(box: Floats, origin: Floats, directions: Floats) -> tuple[Floats, Floats]:
    """Return where rays cross the planes of a box: the nearer and the farther of each axis."""
    first, second = ((corner - origin) / directions for corner in box)
    return np.minimum(first, second), np.maximum(first, second)
