"""E57 maps: every scan is put into the frame of the map by its pose, and written back as it was.

Fields are read as they are stored: floating point numbers of either size, and integers before they
are scaled. The output is a copy of the whole tree (poses, images, names, extensions) with the
points that stay in each scan.
"""

import math
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
from tiling.formats.e57.nodes import (
    children,
    copy_tree,
    library,
    member,
    node,
    number,
    opened,
    write_errors,
)
from tiling.formats.las.crs import name_in_wkt
from tiling.formats.points import Field, MapDescription, PointBatch, only_rows
from tiling.output_file import create_file

_CARTESIAN = ("cartesianX", "cartesianY", "cartesianZ")
_SPHERICAL = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
_INVALID = {_CARTESIAN: "cartesianInvalidState", _SPHERICAL: "sphericalInvalidState"}
_MOST_FIELDS = 1000
_WRITTEN = 1 << 16
"""Points that libE57 is given at a time."""


@dataclass(frozen=True, slots=True)
class _ScanField:
    """A field of every point."""

    name: str
    dtype: str
    """`"<f4"`, `"<f8"` or, of integers that may be scaled, `"<i8"`."""
    bits: float
    """That a value takes in the file."""
    scale: float = 1.0
    offset: float = 0.0
    """What a stored integer is multiplied by, and what is added."""

    def scaled(self, values: NDArray[Any]) -> NDArray[np.float64]:
        """Return what stored values stand for."""
        whole = values.astype(np.float64)
        return whole * self.scale + self.offset if self.dtype == "<i8" else whole


@dataclass(frozen=True, slots=True)
class _Scan:
    """What is known of a scan before its points are read."""

    number: int
    count: int
    fields: tuple[_ScanField, ...]
    rotation: tuple[tuple[float, float, float], ...] | None
    translation: tuple[float, float, float] | None
    """From the scan to the map, (3, 3) and (3,); None where the file has none."""
    grouped: bool
    """Whether its points are grouped by lines."""

    @property
    def dtype(self) -> np.dtype:
        """Of a point's record."""
        return np.dtype([(field.name, field.dtype) for field in self.fields])

    @property
    def pose(self) -> tuple[float, ...]:
        """The matrix from the scan to the map, (3, 4), row by row."""
        rotation = self.rotation or ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
        rows = zip(rotation, self.translation or (0.0, 0.0, 0.0), strict=True)
        return tuple(value for turn, shift in rows for value in (*turn, shift))

    @property
    def _axes(self) -> tuple[str, str, str]:
        names = {field.name for field in self.fields}
        return _CARTESIAN if names.issuperset(_CARTESIAN) else _SPHERICAL

    def coordinates(self, records: NDArray[Any]) -> NDArray[np.float64]:
        """Return coordinates in the frame of the map, (n, 3); those of invalid points are NaN."""
        by_name = {field.name: field for field in self.fields}
        x, y, z = (by_name[name].scaled(records[name]) for name in self._axes)
        with np.errstate(all="ignore"):
            if self._axes == _SPHERICAL:
                distance, azimuth, elevation = x, y, z
                across = distance * np.cos(elevation)
                x, y = across * np.cos(azimuth), across * np.sin(azimuth)
                z = distance * np.sin(elevation)
            if self.rotation is not None:
                x, y, z = (a * x + b * y + c * z for a, b, c in self.rotation)
            if self.translation is not None:
                x, y, z = (v + t for v, t in zip((x, y, z), self.translation, strict=True))
        xyz = np.stack([x, y, z], axis=1)
        state = _INVALID[self._axes]
        if state in by_name:
            xyz[records[state] != 0] = np.nan
        return xyz


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
            self._scans: tuple[_Scan, ...] = tuple(
                _read_scan(each, number, path, size)
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
        raise self._refused(
            "a format that takes further fields; --labels writes them beside the map"
        )


class _E57Writer(MapWriter):
    """Writes points into the scans of a copy of a file, one scan after the other."""

    def __init__(self, path: Path, point_count: int, source: Path, scans: Sequence[_Scan]) -> None:
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


def _buffers(image: Any, scan: _Scan, count: int) -> tuple[Any, dict[str, NDArray[Any]]]:
    """Return arrays of so many values of each field, and what libE57 knows them by."""
    e57: Any = library(Path())
    buffers, arrays = e57.VectorSourceDestBuffer(), {}
    for field in scan.fields:
        # The bindings take NumPy's `long`, which int64 is, for 32 bits; `long long` is for them 64.
        kind = "q" if field.dtype == "<i8" else field.dtype
        values = arrays[field.name] = np.empty(count, kind)
        buffers.append(e57.SourceDestBuffer(image, field.name, values, count, False, False))
    return buffers, arrays


def _read(image: Any, scan: _Scan, max_points: int, path: Path) -> Iterator[NDArray[Any]]:
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


def _read_scan(scan: Any, number_of_scan: int, path: Path, size: int) -> _Scan:
    """Read what a file says of a scan; one without coordinates, or too many points, is refused."""
    name = f"scan {number_of_scan + 1}"
    points = member(scan, "points")
    if points is None or not hasattr(points, "prototype"):
        raise MapFormatError(path, f"points in {name}", "none")
    fields = tuple(_field(each, name, path) for each in children(node(points.prototype())))
    if len(fields) > _MOST_FIELDS:
        raise MapFormatError(path, f"at most {_MOST_FIELDS} fields in {name}", f"{len(fields)}")
    names = {field.name for field in fields}
    if not (names.issuperset(_CARTESIAN) or names.issuperset(_SPHERICAL)):
        expected = f"cartesian or spherical coordinates in {name}"
        raise MapFormatError(path, expected, ", ".join(sorted(names)) or "no fields")
    count = points.childCount()
    bits = sum(field.bits for field in fields)
    if count * bits > 8 * size or (count and not bits):
        raise MapFormatError(path, f"{count} points in {name}", f"a file of {size} bytes")
    return _Scan(
        number_of_scan,
        count,
        fields,
        _rotation(scan, name, path),
        _translation(scan),
        member(scan, "pointGroupingSchemes") is not None,
    )


def _field(of: Any, scan: str, path: Path) -> _ScanField:
    name = of.elementName()
    kind = type(of).__name__
    if kind == "FloatNode":
        single = "SINGLE" in str(of.precision())
        return _ScanField(name, "<f4" if single else "<f8", 32 if single else 64)
    if kind not in ("IntegerNode", "ScaledIntegerNode"):
        raise MapFormatError(path, f"numbers in field {name!r} of {scan}", kind)
    bits = math.ceil(math.log2(max(int(of.maximum()) - int(of.minimum()) + 1, 1)))
    if kind == "IntegerNode":
        return _ScanField(name, "<i8", bits)
    return _ScanField(name, "<i8", bits, float(of.scale()), float(of.offset()))


def _rotation(scan: Any, name: str, path: Path) -> tuple[tuple[float, float, float], ...] | None:
    """Return the rotation matrix of the pose's quaternion; None where it turns nothing."""
    if member(scan, "pose", "rotation") is None:
        return None
    w, x, y, z = (number(scan, "pose", "rotation", part) or 0.0 for part in "wxyz")
    length = math.sqrt(w * w + x * x + y * y + z * z)
    if not 0 < length < math.inf:
        raise MapFormatError(path, f"a rotation in the pose of {name}", f"{w}, {x}, {y}, {z}")
    w, x, y, z = w / length, x / length, y / length, z / length
    if x == y == z == 0:
        return None
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def _translation(scan: Any) -> tuple[float, float, float] | None:
    x, y, z = (number(scan, "pose", "translation", axis) or 0.0 for axis in "xyz")
    return (x, y, z) if (x, y, z) != (0.0, 0.0, 0.0) else None
