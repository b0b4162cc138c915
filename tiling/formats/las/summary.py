"""What a LAS header says of the points: their number, in all and by return, bounds, GPS times."""

import struct
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from tiling.formats.las.header import (
    AT_BOUNDS,
    AT_COUNT,
    AT_GPS_TIME_BOUNDS,
    AT_LEGACY_COUNT,
    LasHeader,
)
from tiling.formats.parts import PartSummary, integers, member
from tiling.grid import integers_in_records

_WITHOUT_GPS_TIME = (0, 2)
_RETURNS = 16


@dataclass(slots=True)
class LasSummary(PartSummary):
    """What a header must know of some points.

    Attributes
    ----------
    first, count : int
        See `PartSummary`.
    returns : (16,) int64 array
        Points by number of return.
    lowest, highest : list of three int
        Bounds on the grid.
    gps_time : (float, float)
        The first and the last; the first is the later one where there is none.
    point_format, minor_version : int
        Of the file; they say where to look.
    """

    point_format: int = 0
    minor_version: int = 0
    returns: NDArray[np.int64] = field(default_factory=lambda: np.zeros(_RETURNS, np.int64))
    lowest: list[int] = field(default_factory=lambda: [np.iinfo(np.int32).max] * 3)
    highest: list[int] = field(default_factory=lambda: [np.iinfo(np.int32).min] * 3)
    gps_time: tuple[float, float] = (np.inf, -np.inf)

    @classmethod
    def of(cls, header: LasHeader, first: int = 0) -> Self:
        """Return the summary of no points yet, of files with a header."""
        return cls(first, point_format=header.point_format, minor_version=header.minor_version)

    def add(self, records: NDArray[np.uint8]) -> None:
        """Take at least one more point into account, (n, record_length) and contiguous."""
        self.count += len(records)
        grid = integers_in_records(records)
        for axis in range(3):
            column = np.ascontiguousarray(grid[:, axis])
            self.lowest[axis] = min(self.lowest[axis], int(column.min()))
            self.highest[axis] = max(self.highest[axis], int(column.max()))
        returns = records[:, 14] & (7 if self.point_format < 6 else 15)
        self.returns += np.bincount(returns, minlength=_RETURNS)
        if self.minor_version >= 5 and self.point_format not in _WITHOUT_GPS_TIME:
            at = 20 if self.point_format < 6 else 22
            times = np.ascontiguousarray(records[:, at : at + 8]).view("<f8")
            times = times[np.isfinite(times)]
            if len(times):
                self._widen_time(float(times.min()), float(times.max()))

    def to_json(self) -> dict[str, Any]:
        """Return what `restore` reads, of the types of JSON."""
        return PartSummary.to_json(self) | {
            "returns": self.returns.tolist(),
            "lowest": self.lowest,
            "highest": self.highest,
            "gps_time": list(self.gps_time),
        }

    def restore(self, kept: Any) -> None:
        """Take over the summary of other points; see `PartSummary.restore`."""
        PartSummary.restore(self, kept)
        grid = np.iinfo(np.int32)
        self.returns = np.array(integers(member(kept, "returns"), _RETURNS), np.int64)
        self.lowest = integers(member(kept, "lowest"), 3, grid.min, grid.max)
        self.highest = integers(member(kept, "highest"), 3, grid.min, grid.max)
        match member(kept, "gps_time"):
            case [float(first), float(last)]:
                self.gps_time = (first, last)
            case _:
                raise ValueError("expected two GPS times")
        if self.returns.sum() != self.count:
            raise ValueError("expected as many points by return as in all")

    def merge(self, other: "LasSummary") -> None:
        """Take the points of another summary into account."""
        self.count += other.count
        self.returns += other.returns
        self.lowest = [min(pair) for pair in zip(self.lowest, other.lowest, strict=True)]
        self.highest = [max(pair) for pair in zip(self.highest, other.highest, strict=True)]
        self._widen_time(*other.gps_time)

    def _widen_time(self, first: float, last: float) -> None:
        self.gps_time = (min(self.gps_time[0], first), max(self.gps_time[1], last))

    def write_into(self, block: bytearray, header: LasHeader) -> None:
        """Set the fields that depend on the points in a block that began as the header's."""
        self._write_counts(block, header)
        self._write_bounds(block, header)
        first, last = self.gps_time
        if self.minor_version >= 5 and (first <= last or self.count == 0):
            times = (last, first) if self.count else (0.0, 0.0)
            struct.pack_into("<2d", block, AT_GPS_TIME_BOUNDS, *times)

    def _write_counts(self, block: bytearray, header: LasHeader) -> None:
        """Set both generations of counts; the older stays empty where it was, as 1.4 allows."""
        count, by_return = self.count, self.returns[1:].tolist()
        if self.minor_version >= 4:
            struct.pack_into("<16Q", block, AT_COUNT, count, *by_return)
            (legacy,) = struct.unpack_from("<I", block, AT_LEGACY_COUNT)
            unused = header.point_count > 0 and legacy == 0
            if unused or count > 0xFFFFFFFF:
                count, by_return = 0, [0] * 15
        struct.pack_into("<6I", block, AT_LEGACY_COUNT, count, *by_return[:5])

    def _write_bounds(self, block: bytearray, header: LasHeader) -> None:
        """Set the bounds; one that is still right keeps its bits, however it was rounded."""
        for axis in range(3):
            scale, offset = header.scales[axis], header.offsets[axis]
            ends = [self.highest[axis], self.lowest[axis]]
            for place, end in enumerate(ends if scale > 0 else reversed(ends)):
                at = AT_BOUNDS + 16 * axis + 8 * place
                value = float(end) * scale + offset if self.count else 0.0
                (old,) = struct.unpack_from("<d", block, at)
                if not self.count or not abs(old - value) < abs(scale) / 2:
                    struct.pack_into("<d", block, at, value)
