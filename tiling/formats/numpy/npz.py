"""NumPy maps in an .npz archive: an array of points, or arrays x, y and z, and others beside."""

import shutil
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any, BinaryIO, cast

import numpy as np
from numpy.typing import NDArray

from tiling.errors import MapFormatError
from tiling.formats.base import MapReader, MapWriter
from tiling.formats.checks import check_leftover, check_signature
from tiling.formats.numpy.arrays import (
    ArrayHeader,
    RowReader,
    organised_note,
    put_rows,
    read_array_header,
)
from tiling.formats.points import COORDINATES, Field, MapDescription, PointBatch, joined, packed
from tiling.output_file import create_file

_POINT_ARRAYS = ("points", "xyz", "arr_0")
_COMPRESSIONS = {zipfile.ZIP_STORED: "stored", zipfile.ZIP_DEFLATED: "deflated"}
_DEFLATE_LIMIT = 1040
"""Deflate makes no more bytes than this out of one (about 1032, and a little for small data)."""
_BLOCK = 1 << 20


@dataclass(frozen=True, slots=True)
class _Member:
    """An entry of the archive; `header` is None for one that is not an array."""

    info: zipfile.ZipInfo
    name: str
    header: ArrayHeader | None
    is_per_point: bool = False


class NpzReader(MapReader):
    """Reads the arrays of an archive as points, all of them in step.

    The coordinates are an array `points`, `xyz` or `arr_0` of shape (N, 3 or more) or with fields
    x, y and z, or else three arrays x, y and z, or else the only array that can be meant. Every
    other array of N rows belongs to the points and is filtered along; any other entry, and whatever
    holds Python objects, is copied as it is.
    """

    seekable = False  # an entry is unpacked from its beginning
    sets_values = True

    def __init__(self, path: Path) -> None:
        self._path = path
        with _archive(path) as archive:
            entries = _entries(archive, path)
        by_name = {entry.name: entry.header for entry in entries if entry.header}
        plain = {name: each for name, each in by_name.items() if not each.dtype.hasobject}
        self._coordinates = _coordinate_arrays(plain, path)
        points = by_name[self._coordinates[0]]
        count = points.unorganised.row_count
        notes = list(_notes(entries, self._coordinates, path, count))
        if points.unorganised is not points:
            notes.append(organised_note(points))
            entries = [replace(e, header=_unorganised(e.header, points)) for e in entries]
        self._members = tuple(
            _Member(e.info, e.name, e.header, _is_per_point(e.header, count)) for e in entries
        )
        self._columns = tuple(
            (e.name, e.header) for e in self._members if e.header and e.is_per_point
        )
        # Fields are numbered: names of entries may be anything.
        self._dtype = np.dtype(
            [(f"array {n}", f"V{h.row_bytes}") for n, (_, h) in enumerate(self._columns)]
        )
        self.bytes_per_point = self._dtype.itemsize
        compression = _COMPRESSIONS[self._members[0].info.compress_type]
        self.description = MapDescription(
            path=path,
            format=f"NumPy npz, {compression}",
            suffix=".npz",
            point_count=count,
            fields=tuple(
                field for name, header in self._columns for field in self._fields_of(name, header)
            ),
            notes=tuple(notes),
        )

    def _batches(self, max_points: int, rows: range) -> Iterator[PointBatch]:
        with _archive(self._path) as archive, ExitStack() as streams:
            readers = []
            for name, header in self._columns:
                opened = [
                    cast(BinaryIO, streams.enter_context(archive.open(f"{name}.npy")))
                    for _ in range(header.column_count)
                ]
                reader = RowReader(opened, header, self._path, f"array {name!r}", rows.start)
                readers.append(reader)
            for first in range(rows.start, rows.stop, max_points):
                records = np.empty(min(max_points, rows.stop - first), dtype=self._dtype)
                arrays = {}
                for number, (name, _) in enumerate(self._columns):
                    records[f"array {number}"] = arrays[name] = readers[number].read(len(records))
                yield PointBatch(first, self._xyz(arrays), records)
            if rows.stop == self.description.point_count:
                for reader in readers:
                    reader.finish()

    def _fields_of(self, name: str, header: ArrayHeader) -> tuple[Field, ...]:
        return header.fields(None if [name] == self._coordinates else name)

    def values(self, records: Any, name: str) -> NDArray[Any]:
        """Return one field, or column, or array of one value a row; see `MapReader.values`."""
        for number, (owner, header) in enumerate(self._columns):
            rows = records[f"array {number}"]
            names = [field.name for field in self._fields_of(owner, header)]
            if name not in names:
                continue
            if header.dtype.names:
                return np.asarray(rows.view(header.dtype)[name])
            if len(names) == header.row_elements:
                columns = rows.view(np.dtype((header.dtype, (len(names),))))
                return np.asarray(columns[:, names.index(name)])
        return super().values(records, name)

    def _stream_writer(self, path: Path, point_count: int) -> MapWriter:
        return _NpzWriter(path, point_count, self._path, self._members)

    def _take_further(self) -> None:
        taken = {member.name for member in self._members}
        first = self._members[0].info
        for field in self.further:
            if field.name in taken:
                expected = f"no array {field.name!r}, which is to be added"
                raise MapFormatError(self._path, expected, "one")
            info = zipfile.ZipInfo(f"{field.name}.npy", first.date_time)
            info.compress_type = first.compress_type
            dtype = np.dtype(field.dtype).newbyteorder("<")
            header = ArrayHeader(dtype, False, (0,))
            self._members += (_Member(info, field.name, header, is_per_point=True),)

    def extend(self, batch: PointBatch, values: Sequence[NDArray[Any]]) -> NDArray[Any]:
        """Return the rows with those of further arrays; see `MapReader.extend`."""
        head = batch.records.dtype
        tail = packed(self.further, values)
        further = [
            (f"array {number}", f"V{tail.dtype[field.name].itemsize}")
            for number, field in enumerate(self.further, start=len(head.names))
        ]
        return joined(batch.records, tail).view(np.dtype([*head.descr, *further]))

    def _xyz(self, arrays: dict[str, NDArray[np.void]]) -> NDArray[np.float64]:
        headers = dict(self._columns)
        names = self._coordinates
        if len(names) == 1:
            return headers[names[0]].coordinates(arrays[names[0]])
        xyz = np.empty((len(arrays[names[0]]), 3))
        with np.errstate(all="ignore"):
            for column, name in enumerate(names):
                xyz[:, column] = arrays[name].view(headers[name].dtype)
        return xyz


class _NpzWriter(MapWriter):
    """Gathers each array of the points in a temporary file, and zips one after the other."""

    def __init__(
        self, path: Path, point_count: int, source: Path, members: tuple[_Member, ...]
    ) -> None:
        super().__init__(path, point_count)
        self._source = source
        self._members = members
        self._file: BinaryIO = create_file(path)
        self._archive = zipfile.ZipFile(self._file, "w")
        self._stack = ExitStack()
        self._arrays: dict[str, tuple[BinaryIO, ArrayHeader]] = {}
        for member in members:
            if member.header and member.is_per_point:
                spool = cast(BinaryIO, TemporaryFile(dir=path.parent))  # noqa: SIM115
                self._stack.enter_context(spool)
                spool.write(member.header.encode(point_count))
                self._arrays[member.name] = spool, member.header

    def _append(self, records: Any) -> None:
        first = self.written - len(records)
        for field, (spool, header) in zip(records.dtype.names, self._arrays.values(), strict=True):
            rows = np.ascontiguousarray(records[field])
            put_rows(spool, header, self.point_count, first, rows)

    def _finish(self) -> None:
        with self._file, self._stack, self._archive, _archive(self._source) as source:
            for member in self._members:
                info = zipfile.ZipInfo(member.info.filename, member.info.date_time)
                info.compress_type = member.info.compress_type
                info.external_attr = member.info.external_attr
                with self._archive.open(info, "w", force_zip64=True) as target:
                    if member.name in self._arrays and member.is_per_point:
                        spool, _ = self._arrays[member.name]
                        spool.seek(0)
                        shutil.copyfileobj(spool, target, _BLOCK)
                    else:
                        with source.open(member.info.filename) as entry:
                            shutil.copyfileobj(entry, target, _BLOCK)

    def _abandon(self) -> None:
        with self._file, self._stack:
            self._archive.close()


@contextmanager
def _archive(path: Path) -> Iterator[zipfile.ZipFile]:
    """Open an archive for reading, and turn what is wrong with it into a `MapFormatError`."""
    check_signature(path, b"PK", "a ZIP archive of NumPy arrays")
    try:
        with zipfile.ZipFile(path) as archive:
            yield archive
    except (
        zipfile.BadZipFile,  # structure, or a checksum
        zlib.error,
        EOFError,
        NotImplementedError,  # a feature or version of ZIP that Python does not know
        RuntimeError,  # encryption
        ValueError,  # an offset out of the file, a name that is not text
        KeyError,
    ) as error:
        found = str(error) or type(error).__name__
        raise MapFormatError(path, "a whole ZIP archive of NumPy arrays", found) from error


def _entries(archive: zipfile.ZipFile, path: Path) -> list[_Member]:
    """Read the headers of all arrays."""
    members: dict[str, _Member] = {}
    size = path.stat().st_size
    for info in archive.infolist():
        if info.filename.endswith("/"):
            continue
        name = info.filename.removesuffix(".npy")
        if info.filename in members:
            raise MapFormatError(path, "each array once", f"a second {name!r}")
        if info.compress_type not in _COMPRESSIONS:
            found = f"compression method {info.compress_type}"
            raise MapFormatError(path, f"array {name!r} stored or deflated", found)
        most = info.compress_size
        if info.compress_type == zipfile.ZIP_DEFLATED:
            most = info.compress_size * _DEFLATE_LIMIT
        if not 0 <= info.header_offset < size:
            found = f"it at byte {info.header_offset} of {size}"
            raise MapFormatError(path, f"array {name!r} within the file", found)
        if info.compress_size > size or info.file_size > most:
            found = f"{info.compress_size} bytes in a file of {size}"
            raise MapFormatError(path, f"{info.file_size} bytes of {name!r}", found)
        header = None
        if info.filename.endswith(".npy"):
            with archive.open(info) as stream:
                header = read_array_header(cast(BinaryIO, stream), path, f"array {name!r}")
        if header is not None and not header.dtype.hasobject:
            if header.size + header.data_bytes > info.file_size:
                expected = f"{header.data_bytes} bytes of array {name!r} ({header})"
                found = f"{info.file_size - header.size} bytes"
                raise MapFormatError(path, expected, found, at=f"byte {header.size} of the entry")
            end = header.size + header.data_bytes
            if end < info.file_size:
                counted = f"{header.row_count} rows of array {name!r}"
                with archive.open(info) as stream:
                    entry = cast(BinaryIO, stream)
                    check_leftover(entry, end, info.file_size, header.row_bytes, path, counted)
        members[info.filename] = _Member(info, name, header)
    return list(members.values())


def _coordinate_arrays(arrays: dict[str, ArrayHeader], path: Path) -> list[str]:
    """Return the name of the array of points, or of the three arrays of coordinates."""
    points = {name: each for name, each in arrays.items() if each.unorganised.is_coordinates}
    for name in _POINT_ARRAYS:
        if name in points:
            return [name]
    columns = [arrays[name] for name in COORDINATES if name in arrays]
    if (
        len(columns) == len(COORDINATES)
        and all(column.is_column for column in columns)
        and len({column.row_count for column in columns}) == 1
    ):
        return list(COORDINATES)
    # Poses have four columns, colours and faces are whole numbers.
    of_three = [name for name, each in points.items() if each.unorganised.row_elements in (1, 3)]
    floating = [name for name in of_three if points[name].dtype.kind not in "iu"]
    for candidates in (list(points), of_three, floating):
        if len(candidates) == 1:
            return candidates
    expected = (
        f"an (N, 3 or more) array {', '.join(_POINT_ARRAYS)}, or (N,) arrays x, y and z, or only "
        "one that can hold points"
    )
    found = ", ".join(f"{name!r} ({header})" for name, header in list(arrays.items())[:6])
    raise MapFormatError(path, expected, found or "no arrays")


def _notes(
    entries: Sequence[_Member], coordinates: Sequence[str], path: Path, count: int
) -> Iterator[str]:
    """Say what is not a matter of course; refuse Python objects that belong to the points."""
    name = coordinates[0]
    if len(coordinates) == 1 and name not in _POINT_ARRAYS:
        yield f"The points are taken from array {name!r}."
    for entry in entries:
        if entry.header is None or not entry.header.dtype.hasobject:
            continue
        if entry.header.shape and entry.header.row_count == count:
            found = f"{count} Python objects, one a point, which only unpickling could read"
            raise MapFormatError(path, f"array {entry.name!r} of plain values", found)
        yield (
            f"Array {entry.name!r} holds Python objects, which are never unpickled: each output "
            "has all of it, byte for byte."
        )


def _unorganised(header: ArrayHeader | None, points: ArrayHeader) -> ArrayHeader | None:
    """Return the header of an array of some organised points as a point a row; others as is."""
    if header is None or header.fortran_order or header.shape[:2] != points.shape[:2]:
        return header
    return replace(header, shape=(points.unorganised.row_count, *header.shape[2:]))


def _is_per_point(header: ArrayHeader | None, count: int) -> bool:
    return header is not None and len(header.shape) > 0 and header.row_count == count
