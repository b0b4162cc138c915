"""What surrounds the points of a LAS or LAZ output: the header, VLRs and EVLRs of the input.

They are kept byte for byte. Only what depends on the points is set anew: their number, in all and
by return, their bounds, and the places of what follows them.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self, cast

import numpy as np
from numpy.typing import NDArray

from tiling.formats.las.compression import is_laszip_record
from tiling.formats.las.header import (
    At,
    LasHeader,
    VariableLengthRecord,
)
from tiling.formats.parts import PartSummary, PartWriter, Surroundings, integers, member
from tiling.grid import integers_in_records

_WITHOUT_GPS_TIME = (0, 2)
_RETURNS = 16


@dataclass(slots=True)
class LasSummary(PartSummary):
    """What a header must know of some points."""

    point_format: int = 0
    minor_version: int = 0
    """Of the file; they say where to look."""
    returns: NDArray[np.int64] = field(default_factory=lambda: np.zeros(_RETURNS, np.int64))
    """(16,): points by number of return."""
    lowest: list[int] = field(default_factory=lambda: [np.iinfo(np.int32).max] * 3)
    highest: list[int] = field(default_factory=lambda: [np.iinfo(np.int32).min] * 3)
    """Bounds on the grid, along each axis."""
    gps_time: tuple[float, float] = (np.inf, -np.inf)
    """The first and the last; the first is the later one where there is none."""

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
            struct.pack_into("<2d", block, At.GPS_TIME_BOUNDS, *times)

    def _write_counts(self, block: bytearray, header: LasHeader) -> None:
        """Set both generations of counts; the older stays empty where it was, as 1.4 allows."""
        count, by_return = self.count, self.returns[1:].tolist()
        if self.minor_version >= 4:
            struct.pack_into("<16Q", block, At.COUNT, count, *by_return)
            (legacy,) = struct.unpack_from("<I", block, At.LEGACY_COUNT)
            unused = header.point_count > 0 and legacy == 0
            if unused or count > 0xFFFFFFFF:
                count, by_return = 0, [0] * 15
        struct.pack_into("<6I", block, At.LEGACY_COUNT, count, *by_return[:5])

    def _write_bounds(self, block: bytearray, header: LasHeader) -> None:
        """Set the bounds; one that is still right keeps its bits, however it was rounded."""
        for axis in range(3):
            scale, offset = header.scales[axis], header.offsets[axis]
            ends = [self.highest[axis], self.lowest[axis]]
            for place, end in enumerate(ends if scale > 0 else reversed(ends)):
                at = At.BOUNDS + 16 * axis + 8 * place
                value = float(end) * scale + offset if self.count else 0.0
                (old,) = struct.unpack_from("<d", block, at)
                if not self.count or not abs(old - value) < abs(scale) / 2:
                    struct.pack_into("<d", block, at, value)


def is_copc_index(record: VariableLengthRecord) -> bool:
    """Tell whether a record says where COPC's nodes lie (COPC 1.0, info VLR and hierarchy)."""
    return record.names("copc", 1) or record.names("copc", 1000)


class LasSurroundings(Surroundings):
    """The header, VLRs and EVLRs of an input, but for what COPC says of the order of its points.

    The data of the laszip VLR are those of the output, if they are not the input's.
    """

    def __init__(self, header: LasHeader, laszip: bytes | None = None) -> None:
        self._header = header
        block = bytearray(header.block)
        if laszip is not None:
            record = next(r for r in header.vlrs if is_laszip_record(r))
            start = record.end - len(record.data)
            block[start : start + len(laszip)] = laszip
        dropped = [record for record in header.vlrs if is_copc_index(record)]
        for record in reversed(dropped):
            del block[record.start : record.end]
        struct.pack_into("<I", block, At.VLR_COUNT, len(header.vlrs) - len(dropped))
        struct.pack_into("<I", block, At.POINTS_OFFSET, len(block))
        evlrs = [(r.start, r.end) for r in header.evlrs if not is_copc_index(r)]
        self._evlr_count = len(evlrs)
        waveforms = header.waveforms
        if waveforms is not None and waveforms[0] not in [start for start, _ in evlrs]:
            evlrs.append(waveforms)
        super().__init__(bytes(block), header.path, after=evlrs)

    def completed(self, points_end: int, summary: LasSummary) -> bytes:
        """Return the header and VLRs with what depends on the points, and on where these end."""
        header, position = self._header, points_end
        block = bytearray(self.head)
        if header.minor_version >= 4:
            first = position if self._evlr_count else 0
            struct.pack_into("<QI", block, At.FIRST_EVLR, first, self._evlr_count)
        for start, end in self.after:
            if header.waveforms is not None and start == header.waveforms[0]:
                struct.pack_into("<Q", block, At.WAVEFORMS, position)
            position += end - start
        summary.write_into(block, header)
        return bytes(block)


class LasPartWriter(PartWriter):
    """Writes raw, uncompressed point records under the header of the file they come from."""

    around: LasSurroundings

    def __init__(self, path: Path, point_count: int, header: LasHeader) -> None:
        super().__init__(path, point_count, LasSurroundings(header), header.record_length)
        self._header = header

    def new_summary(self, first: int) -> LasSummary:
        """Return the summary of a part that has no points yet."""
        return LasSummary.of(self._header, first)

    def _completed_header(self, parts: Sequence[PartSummary]) -> bytes:
        whole = self.new_summary(0)
        for part in parts:
            whole.merge(cast(LasSummary, part))
        return self.around.completed(self._start_of(self.point_count), whole)
