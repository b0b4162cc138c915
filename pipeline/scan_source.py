"""Where the scan numbers of a map come from, what they are, and which pose each scan has."""

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from pipeline.errors import ConfigurationError
from tiling.collection import MapCollection
from tiling.foreign_text import printable
from tiling.formats.points import PointBatch
from tiling.key_frames import ScanPoses

_WITHIN = 10
"""Tenths of a second: no pose farther away in time is that of a scan."""


def numbers_of_poses(
    poses: ScanPoses, seen: NDArray[np.int64], field: str, in_tenths: bool
) -> tuple[int, tuple[int, ...]]:
    """Return the number of each pose, counted from the first number, which comes before them.

    Parameters
    ----------
    seen : (n,) int64 array
        Different scan numbers, or with `in_tenths` tenths of a second, of the map's points;
        ascending.
    field : str
        That tells them.

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


TENTH = 0.1
"""Of a second, in seconds."""

UNKNOWN = np.iinfo(np.int64).min


class ScanSource(BaseModel):
    """Where the scan numbers of a map come from.

    Attributes
    ----------
    kind : str
        `field`; `rows`, the order of the rows; or `files`, each of which is a scan or has scans.
    scans : int
        Different numbers; an estimate where the order of the rows is all there is.
    name : str
        Of the field, or of what keeps the scans apart.
    tenth : float
        Units of the field that make a tenth of a second; 0 for scan numbers.
    firsts : tuple of int
        For each file, what number 0 stands for: tenths of a second, or a scan number.
    rows : int
        Rows that are taken for a scan.
    of_poses : tuple of int
        What number each pose of the map has, ascending: scans are numbered by their poses then.
    """

    model_config = ConfigDict(frozen=True)

    kind: Literal["field", "rows", "files"]
    scans: int
    name: str = ""
    tenth: float = 0.0
    firsts: tuple[int, ...] = ()
    rows: int = 0
    of_poses: tuple[int, ...] = ()

    def __str__(self) -> str:
        if self.kind == "field":
            posed = " with poses" if self.of_poses else ""
            return f"{printable(self.name)}, {self.scans:,} scans{posed}"
        if self.kind == "files":
            return f"{self.name}, {self.scans:,} scans with poses"
        return f"order of the rows, about {self.scans:,} scans"

    def numbers(self, collection: MapCollection, file: int, batch: PointBatch) -> NDArray[np.int32]:
        """Return the scan number of each point of a batch of the map, -1 where it is not known."""
        row = batch.first_row + np.arange(len(batch.xyz))
        if self.kind == "files":
            firsts = collection.scan_rows
            return (np.searchsorted(firsts, row, side="right") - 1).astype(np.int32)
        if self.kind == "rows":
            row -= collection.first_rows[file]
            return (self.firsts[file] + row // self.rows).astype(np.int32)
        found = whole_numbers(collection.readers[file].values(batch.records, self.name), self.tenth)
        known = found != UNKNOWN
        number = np.where(known, found - self.firsts[file], -1)
        if self.of_poses:
            number = nearest_poses(number, self.of_poses, exact=not self.tenth)
        return number.astype(np.int32)

    def sensor(self, collection: MapCollection) -> NDArray[np.float64] | None:
        """Return where the sensor was in each scan, (S, 3), metres; None where nobody tells."""
        poses = collection.poses
        if poses is None or not (self.kind == "files" or self.of_poses):
            return None
        places = np.ascontiguousarray(poses.poses[:, :, 3])
        if not poses.are_applied or collection.metres is None:
            return places
        return np.asarray(places * collection.metres)


def whole_numbers(values: NDArray[Any], tenth: float) -> NDArray[np.int64]:
    """Return scan numbers, or tenths of a second, and `UNKNOWN` where there is none."""
    if values.dtype.kind == "M":
        values = values.astype("datetime64[ns]").astype(np.int64)
    if values.dtype.kind in "iu":
        known = values >= 0 if not tenth else values > 0
        if values.dtype == np.uint64:
            known &= values <= np.uint64(np.iinfo(np.int64).max)
        whole = values.astype(np.int64)
        if tenth:
            whole = whole // int(tenth)
    else:
        known = np.isfinite(values) & (np.abs(values) < 2.0**62)
        known &= values != 0 if tenth else values >= 0
        seconds = np.where(known, values, 0).astype(np.float64)
        whole = np.floor(seconds * 10 if tenth == TENTH else seconds / (tenth or 1))
        whole = whole.astype(np.int64)
    return np.where(known, whole, UNKNOWN)
