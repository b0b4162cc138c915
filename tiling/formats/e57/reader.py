"""E57 maps: every scan is put into the frame of the map by its pose, and written back as it was.

Fields are read as they are stored: floating point numbers of either size, and integers before they
are scaled. The output is a copy of the whole tree (poses, images, names, extensions) with the
points that stay in each scan.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from os import fsencode
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from tiling.errors import MapFormatError
from tiling.formats.base import MapReader, MapWriter
from tiling.formats.checks import check_signature
from tiling.formats.e57.scan import Scan, read_scan
from tiling.formats.e57.tree import children, copy_tree, library, member, node, opened, write_errors
from tiling.formats.las.crs import name_in_wkt
from tiling.formats.points import Field, MapDescription, PointBatch, only_rows
from tiling.output_file import create_file

_WRITTEN = 1 << 16
"""Points that libE57 is given at a time."""


@dataclass(frozen=True, slots=True)
class ScanRecords:
    """Records of one scan."""

    scan: int
    rows: NDArray[Any]
    """(n,), structured."""

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, chosen: NDArray[np.bool_] | slice) -> "ScanRecords":
        return ScanRecords(self.scan, self.rows[chosen])

    def tobytes(self) -> bytes:
        """Return the bytes of the records."""
        return self.rows.tobytes()


class E57Reader(MapReader):
    """Reads the scans of an E57 file, one after the other."""

    seekable = False  # libE57 reads a scan from its beginning

    def __init__(self, path: Path) -> None:
        self._path = path
        check_signature(path, b"ASTM-E57", "an E57 file")
        size = path.stat().st_size
        with opened(path) as image:
            root = image.root()
            scans = member(root, "data3D")
            self._scans: tuple[Scan, ...] = tuple(
                read_scan(each, number, path, size)
                for number, each in enumerate(() if scans is None else children(scans))
            )
            system = member(root, "coordinateMetadata")
            wkt = "" if system is None else str(system.value())
        fields = {field.name: field for scan in self._scans for field in scan.fields}
        is_grouped = any(scan.grouped for scan in self._scans)
        count = len(self._scans)
        self.description = MapDescription(
            path=path,
            format=f"E57, {count} scan{'' if count == 1 else 's'}",
            suffix=".e57",
            point_count=sum(scan.count for scan in self._scans),
            fields=tuple(Field(name, np.dtype(each.dtype).name) for name, each in fields.items()),
            crs=name_in_wkt(wkt) if wkt else None,
            notes=("The grouping of the points by lines is left out.",) * is_grouped,
            scans=tuple((scan.count, scan.pose) for scan in self._scans),
        )
        self.bytes_per_point = max((scan.dtype.itemsize for scan in self._scans), default=0)

    def _batches(self, max_points: int, rows: range) -> Iterator[PointBatch]:
        return only_rows(self._from_scan_of(rows, max_points), rows)

    def _from_scan_of(self, rows: range, max_points: int) -> Iterator[PointBatch]:
        """Yield points from the scan on that has the first of some rows."""
        first_row = 0
        with opened(self._path) as image:
            for scan in self._scans:
                if scan.count and first_row + scan.count > rows.start:
                    row = first_row
                    for records in _read(image, scan, max_points, self._path):
                        yield PointBatch(
                            row, scan.coordinates(records), ScanRecords(scan.number, records)
                        )
                        row += len(records)
                first_row += scan.count

    def values(self, records: ScanRecords, name: str) -> NDArray[Any]:
        """Return one field of some points, scaled; see `MapReader.values`.

        Scans have fields of their own, and count their times from their own beginnings: fields can
        be read apart where there is one scan only.
        """
        if len(self._scans) != 1:
            return super().values(records, name)
        (field,) = (each for each in self._scans[0].fields if each.name == name)
        column: NDArray[Any] = records.rows[name]
        return column if field.scale == 1 and not field.offset else field.scaled(column)

    def _stream_writer(self, path: Path, point_count: int) -> MapWriter:
        return _E57Writer(path, point_count, self._path, self._scans)

    def _take_further(self) -> NoReturn:
        # E57 has no fields of these names that others would read.
        expected = "a format that takes further fields; --labels writes them beside the map"
        raise MapFormatError(self._path, expected, self.description.format)


class _E57Writer(MapWriter):
    """Writes points into the scans of a copy of a file, one scan after the other."""

    def __init__(self, path: Path, point_count: int, source: Path, scans: Sequence[Scan]) -> None:
        super().__init__(path, point_count)
        e57 = library(path)
        self._scans = scans
        create_file(path).close()
        with opened(source) as image, write_errors(path):
            self._image = e57.ImageFile(fsencode(path), "w")
            copy_tree(image, self._image)
        self._vectors = (
            [member(each, "points") for each in children(node(self._image.root().get("data3D")))]
            if scans
            else []
        )
        self._next = 0
        self._writer: Any = None
        self._arrays: dict[str, NDArray[Any]] = {}

    def _append(self, records: ScanRecords) -> None:
        with write_errors(self.path):
            self._go_on_to(records.scan + 1)
            for start in range(0, len(records), _WRITTEN):
                rows = records.rows[start : start + _WRITTEN]
                for name, values in self._arrays.items():
                    values[: len(rows)] = rows[name]
                self._writer.write(len(rows))

    def _go_on_to(self, scan: int) -> None:
        """Open the next scans up to one: of those without points too, which must have an end."""
        while self._next < scan:
            if self._writer is not None:
                self._writer.close()
            buffers, self._arrays = _buffers(self._image, self._scans[self._next], _WRITTEN)
            self._writer = self._vectors[self._next].writer(buffers)
            self._next += 1

    def _finish(self) -> None:
        with write_errors(self.path):
            self._go_on_to(len(self._scans))
            if self._writer is not None:
                self._writer.close()
            self._image.close()

    def _abandon(self) -> None:
        self._image.cancel()  # which removes the file


def _buffers(image: Any, scan: Scan, count: int) -> tuple[Any, dict[str, NDArray[Any]]]:
    """Return arrays of so many values of each field, and what libE57 knows them by."""
    e57: Any = library(Path())
    buffers, arrays = e57.VectorSourceDestBuffer(), {}
    for field in scan.fields:
        # The bindings take NumPy's `long`, which int64 is, for 32 bits; `long long` is for them 64.
        kind = "q" if field.dtype == "<i8" else field.dtype
        values = arrays[field.name] = np.empty(count, kind)
        buffers.append(e57.SourceDestBuffer(image, field.name, values, count, False, False))
    return buffers, arrays


def _read(image: Any, scan: Scan, max_points: int, path: Path) -> Iterator[NDArray[Any]]:
    """Yield the records of a scan."""
    capacity = min(max_points, scan.count)
    buffers, arrays = _buffers(image, scan, capacity)
    reader = node(image.root().get(f"/data3D/{scan.number}/points")).reader(buffers)
    found = 0
    while count := reader.read():
        records = np.empty(count, scan.dtype)
        for name, values in arrays.items():
            records[name] = values[:count]
        found += count
        yield records
    reader.close()
    if found != scan.count:
        expected = f"{scan.count} points in scan {scan.number + 1}"
        raise MapFormatError(path, expected, f"{found}")
