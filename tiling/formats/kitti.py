"""Scans as KITTI has them: float32 x, y, z and reflectance, and nothing else."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from tiling.errors import MapFormatError
from tiling.formats.base import ExtendedFormat, MapReader, MapWriter, SinglePartWriter
from tiling.formats.parts import PartWriter, put_records
from tiling.formats.points import COORDINATES, Field, MapDescription, PointBatch

_RECORD = np.dtype([(name, "<f4") for name in (*COORDINATES, "intensity")])


class KittiReader(MapReader):
    """Reads a `.bin` of KITTI.

    Raises
    ------
    MapFormatError
        When the size is not that of whole points.
    """

    def __init__(self, path: Path) -> None:
        size = path.stat().st_size
        if size % _RECORD.itemsize:
            raise MapFormatError(path, "16 bytes a point (float32 x, y, z, r)", f"{size} bytes")
        fields = tuple(Field(name, "float32") for name in _RECORD.names or ())
        count = size // _RECORD.itemsize
        self.description = MapDescription(path, "KITTI bin", ".bin", count, fields)

    @property
    def seekable(self) -> bool:
        """Always: every point has its place."""
        return True

    @property
    def bytes_per_point(self) -> int:
        """Bytes of a record; see `MapReader.bytes_per_point`."""
        return _RECORD.itemsize

    def _batches(self, max_points: int, rows: range) -> Iterator[PointBatch]:
        with self.description.path.open("rb") as file:
            file.seek(rows.start * _RECORD.itemsize)
            for first in range(rows.start, rows.stop, max_points):
                count = min(max_points, rows.stop - first)
                records = np.fromfile(file, _RECORD, count)
                if len(records) < count:
                    found = "the end of the file"
                    raise MapFormatError(self.description.path, f"{rows.stop} points", found)
                with np.errstate(invalid="ignore"):
                    xyz = np.stack([records[name].astype(np.float64) for name in COORDINATES], 1)
                yield PointBatch(first, xyz, records)

    def values(self, records: Any, name: str) -> NDArray[Any]:
        """Return one field of some points; see `MapReader.values`."""
        return np.asarray(records[name])

    def merged(self) -> MapReader:
        """Return what writes several such files into one; see `MapReader.merged`."""
        return self

    def moved(self, records: NDArray[Any], xyz: NDArray[np.float64]) -> NDArray[Any]:
        """Return points with other coordinates; see `MapReader.moved`."""
        records = records.copy()
        for axis, name in enumerate(COORDINATES):
            records[name] = xyz[:, axis]
        return records

    def writer(self, path: Path, point_count: int) -> MapWriter:
        """Open a writer of such a file; see `MapReader.writer`."""
        return SinglePartWriter(self.part_writer(path, point_count))

    def extended(self, fields: Sequence[Field]) -> ExtendedFormat:
        """Refuse: there is no place for further fields."""
        names = ", ".join(field.name for field in fields)
        raise MapFormatError(self.description.path, f"a format with room for {names}", "KITTI bin")

    @property
    def writes_parts(self) -> bool:
        """Always: every point has its place."""
        return True

    def part_writer(self, path: Path, point_count: int) -> PartWriter:
        """Return a writer in parts; see `MapReader.part_writer`."""
        return _KittiParts(path, point_count)


class _KittiParts(PartWriter):
    """Writes each point to its place."""

    def put(self, file: BinaryIO, first: int, records: NDArray[Any]) -> None:
        """Write points to their places."""
        put_records(file, first * _RECORD.itemsize, records)

    def _write_surroundings(self, file: BinaryIO) -> None:
        file.truncate(self.point_count * _RECORD.itemsize)
