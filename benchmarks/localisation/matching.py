"""Finding scans on a map, one after the other: GICP of small_gicp (Koide, JOSS 2024).

The first pose is known. Each further one is first guessed from the motion between the last two, as
nothing but the LiDAR were there, and then matched.
"""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

__all__ = ["localise"]

Floats = NDArray[np.float64]

VOXEL = 0.2
"""Metres: of map and scans, one point each."""

FARTHEST_MATCH = 0.5
"""Metres, between a point of the scan and its nearest in the map."""


def localise(map_points: Floats, scans: Iterable[Floats], first_pose: Floats) -> Floats:
    """Find each scan on a map.

    Parameters
    ----------
    map_points : (N, 3) float64 array
        Metres.
    scans : iterable of (n, 3) float64 array
        In the sensor's frame.
    first_pose : (4, 4) float64 array
        From the sensor's frame to the map's, near that of the first scan.

    Returns
    -------
    (S, 4, 4) float64 array
        The pose of each scan.
    """
    import small_gicp  # noqa: PLC0415 (of the extra `localisation`)

    target, tree = small_gicp.preprocess_points(map_points, downsampling_resolution=VOXEL)
    poses: list[Floats] = []
    guess = first_pose
    for scan in scans:
        source, _ = small_gicp.preprocess_points(scan, downsampling_resolution=VOXEL)
        match = small_gicp.align(
            target, source, tree, guess, max_correspondence_distance=FARTHEST_MATCH
        )
        poses.append(match.T_target_source)
        before = poses[max(len(poses) - 2, 0)]
        guess = poses[-1] @ np.linalg.inv(before) @ poses[-1]
    return np.stack(poses)
