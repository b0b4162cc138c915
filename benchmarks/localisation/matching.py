"""Finding scans on a map, one after the other: GICP of small_gicp (Koide, JOSS 2024).

The first pose is known. Each further one is first guessed from the last that was found and the
odometry, and then matched.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

__all__ = ["localise"]

Floats = NDArray[np.float64]

VOXEL = 0.2
"""Metres: of map and scans, one point each."""

FARTHEST_MATCH = 0.5
"""Metres, between a point of the scan and its nearest in the map."""


def localise(
    map_points: Floats, scans: Sequence[Floats], moves: Floats, first_pose: Floats
) -> Floats:
    """Find each scan on a map.

    Parameters
    ----------
    map_points : (N, 3) float64 array
        Metres.
    scans : sequence of (n, 3) float64 array
        In the sensor's frame.
    moves : (S - 1, 4, 4) float64 array
        About how the sensor moved from each scan to the next, in its own frame.
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
    for number, scan in enumerate(scans):
        if number:
            guess = poses[-1] @ moves[number - 1]
        source, _ = small_gicp.preprocess_points(scan, downsampling_resolution=VOXEL)
        match = small_gicp.align(
            target, source, tree, guess, max_correspondence_distance=FARTHEST_MATCH
        )
        poses.append(match.T_target_source)
    return np.stack(poses)
