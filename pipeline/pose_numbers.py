"""Which pose each scan of a map has: by the scan's number, or by the time it was seen."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import ConfigurationError
from tiling.foreign_text import printable
from tiling.key_frames import ScanPoses

_WITHIN = 10
"""Tenths of a second: no pose farther away in time is that of a scan."""


def numbers_of_poses(
    poses: ScanPoses, seen: NDArray[np.int64], field: str, in_tenths: bool
) -> tuple[int, tuple[int, ...]]:
    """Return the number of each pose, counted from the first number, which comes before them.

    Parameters
    ----------
    poses : ScanPoses
        Of the scans that a map was made of.
    seen : (n,) int64 array
        Different scan numbers, or tenths of a second, of the map's points; ascending.
    field : str
        That tells them.
    in_tenths : bool
        Whether they are tenths of a second.

    Raises
    ------
    ConfigurationError
        When poses and scans are not of one recording.
    """
    count = len(poses.poses)
    expected = f"input.poses: expected a pose for each of {len(seen)} scans of {printable(field)}"
    if not in_tenths:
        if len(seen) == count:
            return 0, tuple(seen.tolist())
        if seen[0] >= 0 and seen[-1] < count:
            return 0, tuple(range(count))
        raise ConfigurationError(f"{expected}, numbered up to {seen[-1]}, found {count}")
    if poses.times is None:
        raise ConfigurationError(f"{expected} with its time (8 or 13 numbers a line), found none")
    times = np.floor(poses.times * 10).astype(np.int64)
    if (np.diff(times) < 0).any():
        raise ConfigurationError("input.poses: expected times that ascend, found others")
    apart = nearest_poses(seen, times.tolist(), exact=False) < 0
    if apart.mean() > 0.5:
        raise ConfigurationError(
            f"{expected}, from {seen[0] / 10} to {seen[-1] / 10} s, found poses from "
            f"{times[0] / 10} to {times[-1] / 10} s"
        )
    lowest = min(int(seen[0]), int(times[0]))
    return lowest, tuple((times - lowest).tolist())


def nearest_poses(
    number: NDArray[np.int64], of_poses: Sequence[int], *, exact: bool
) -> NDArray[np.int64]:
    """Return the pose of each number, (n,): the nearest; -1 where none is near enough.

    Parameters
    ----------
    number : (n,) int64 array
    of_poses : sequence of int
        The number of each pose, ascending.
    exact : bool
        Whether only a pose of the same number will do; else of one within a second.
    """
    numbers = np.array(of_poses, np.int64)
    after = np.searchsorted(numbers, number).clip(max=len(numbers) - 1)
    before = np.maximum(after - 1, 0)
    to_before, to_after = np.abs(numbers[before] - number), np.abs(numbers[after] - number)
    nearest = np.where(to_before <= to_after, before, after)
    near = np.minimum(to_before, to_after) <= (0 if exact else _WITHIN)
    return np.asarray(np.where(near, nearest, -1))
