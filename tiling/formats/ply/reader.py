"""PLY maps: ASCII and binary of both byte orders, with any properties and further elements."""

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, BinaryIO, cast

import numpy as np
from numpy.typing import NDArray

from tiling.errors import MapFormatError
from tiling.formats.base import MapReader, MapWriter, SinglePartWriter
from tiling.formats.checks import check_leftover
from tiling.formats.parts import PartWriter, copy_spans, put_records
from tiling.formats.ply.header import VERTEX, PlyHeader, PlyProperty, read_header
from tiling.formats.ply.rows import PlyRows, open_rows
from tiling.formats.points import (
    Field,
    MapDescription,
    PointBatch,
    coordinate_names,
    longer_records,
    longer_rows,
    only_rows,
)
from tiling.formats.text_rows import TextRows
from tiling.output_file import create_file


class PlyReader(MapReader):
    """Reads the vertices of a PLY file as points.

    Rows of an ASCII file stay text and records of a binary file stay in its byte order, so no
    digit changes. Elements beside the vertices go to the output as they are, apart from those
    that mean vertices by number (faces, edges): these lose their sense with the first point
    removed and are left out, which the description's notes say.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        with path.open("rb") as file:
            self._header = read_header(file, path)
        self._is_checked = False
        vertex = self._header.vertex
        names = coordinate_names([each.name for each in vertex.scalars])
        if names is None:
            found = ", ".join(each.name for each in vertex.properties) or "none"
            raise MapFormatError(path, "vertex properties x, y and z", found, at="the header")
        self._names = names
        self.bytes_per_point = vertex.least_bytes
        # Vertices are binary records of one size, and those of other elements before them too.
        is_binary = self._header.encoding != "ascii"
        before = self._header.elements[: self._header.elements.index(vertex)]
        self.writes_parts = self.sets_values = is_binary and vertex.is_fixed
        self.seekable = self.writes_parts and all(each.is_fixed for each in before)
        self._check_size()
        notes = self._check_what_is_known()
        self.description = MapDescription(
            path=path,
            format=f"PLY {self._header.encoding} 1.0",
            suffix=".ply",
            point_count=vertex.count,
            fields=tuple(_field(each) for each in vertex.properties),
            notes=(
                *(
                    f"The {e.count} records of element {e.name!r} mean vertices by their number "
                    f"and are left out."
                    for e in self._header.dropped
                ),
                *notes,
            ),
        )

    def _batches(self, max_points: int, rows: range) -> Iterator[PointBatch]:
        if self.seekable or not rows.start:
            return self._batches_from(rows, max_points)
        return only_rows(self._batches_from(range(rows.stop), max_points), rows)

    def _batches_from(self, rows: range, max_points: int) -> Iterator[PointBatch]:
        """Yield vertices from a row on, which is the first unless each has its place."""
        elements, vertex = self._header.elements, self._header.vertex
        place = elements.index(vertex)
        with self._path.open("rb") as file:
            reader = open_rows(file, self._header, self._path)
            for element in elements[:place]:
                reader.skip(element)
            reader.skip(vertex, rows.start)
            first = rows.start
            while first < rows.stop:
                records, xyz = reader.take(vertex, min(max_points, rows.stop - first), self._names)
                yield PointBatch(first, xyz, records)
                first += len(records)
            if rows.stop == vertex.count and not self._is_checked:
                for element in elements[place + 1 :]:
                    reader.skip(element)
                self._check_behind(file, reader)
                self._is_checked = True

    def values(self, records: Any, name: str) -> NDArray[Any]:
        """Return one property of some vertices; see `MapReader.values`."""
        vertex = self._header.vertex
        if not vertex.is_fixed:
            return super().values(records, name)
        if self._header.encoding != "ascii":
            return np.asarray(records[name])
        names = [each.name for each in vertex.properties]
        column = names.index(name)
        return cast(TextRows, records).column(column, vertex.properties[column].dtype)

    def writer(self, path: Path, point_count: int) -> MapWriter:
        """Open a writer of a PLY file like this one; see `MapReader.writer`."""
        if self.writes_parts:
            return SinglePartWriter(self.part_writer(path, point_count))
        return _PlyWriter(path, point_count, self._header, self._kept_elements())

    def part_writer(self, path: Path, point_count: int) -> PartWriter:
        """Return a writer in parts of a binary file; see `MapReader.part_writer`."""
        if not self.writes_parts:
            return super().part_writer(path, point_count)
        return _PlyParts(path, point_count, self._header, self._kept_elements())

    def extended(self, fields: Sequence[Field]) -> MapReader:
        """Return what writes further properties; see `MapReader.extended`."""
        self._kept_elements()  # found by this header, the one of the file
        model = copy(self)
        model.further = tuple(fields)
        model._header = self._header.extended(fields)
        return model

    def extend(self, batch: PointBatch, values: Sequence[NDArray[Any]]) -> Any:
        """Return the records with further values; see `MapReader.extend`."""
        if self._header.encoding == "ascii":
            return longer_rows(batch.records, self.further, values)
        return longer_records(batch.records, self.further, values, self._header.byte_order)

    def _check_size(self) -> None:
        """Compare the counts of the header with the size of the file."""
        header = self._header
        size = self._path.stat().st_size
        if header.encoding == "ascii":
            # A digit and a blank or line end for each number; the last line may lack its end.
            needed = max(sum(2 * len(e.properties) * e.count for e in header.elements) - 1, 0)
        else:
            needed = sum(e.least_bytes * e.count for e in header.elements)
        if size - header.size < needed:
            counts = ", ".join(f"{e.count} {e.name}" for e in header.elements)
            expected = f"at least {needed} bytes after the header for its elements ({counts})"
            found = f"{size - header.size} bytes"
            raise MapFormatError(self._path, expected, found, f"byte {header.size}")

    def _kept_elements(self) -> "_KeptElements":
        """Find the elements to copy before and after the vertices."""
        header = self._header
        others = [e for e in header.elements if e.name != VERTEX]
        kept = [e for e in others if e.count and e not in header.dropped]
        if not kept:
            return _KeptElements(self._path)
        vertex_start = self._spans[VERTEX][0]
        spans = [self._spans[element.name] for element in kept]
        return _KeptElements(
            self._path,
            before=tuple(span for span in spans if span[0] < vertex_start),
            after=tuple(span for span in spans if span[0] >= vertex_start),
        )

    def _check_what_is_known(self) -> tuple[str, ...]:
        """Refuse vertices that the header does not count, where no record need be read for that.

        Otherwise they are met when the last vertex has been read; unless there is none to be read.
        """
        header = self._header
        if header.encoding != "ascii" and all(each.is_fixed for each in header.elements):
            with self._path.open("rb") as file:
                rows = open_rows(file, header, self._path)
                for element in header.elements:
                    rows.skip(element)
                return self._check_behind(file, rows)
        if not header.vertex.count:
            next(self._batches_from(range(0), 1), None)
        return ()

    def _check_behind(self, file: BinaryIO, rows: PlyRows) -> tuple[str, ...]:
        """Refuse bytes behind all elements that could be another vertex."""
        vertex = self._header.vertex
        counts = ", ".join(f"{e.count} {e.name}" for e in self._header.elements)
        is_text = self._header.encoding == "ascii"
        least = 2 * len(vertex.properties) - 1 if is_text else vertex.least_bytes
        stop = self._path.stat().st_size
        return check_leftover(file, rows.position, stop, least, self._path, counts)

    @cached_property
    def _spans(self) -> dict[str, tuple[int, int]]:
        """Where each element begins and ends."""
        spans = {}
        with self._path.open("rb") as file:
            rows = open_rows(file, self._header, self._path)
            for element in self._header.elements:
                start = rows.position
                rows.skip(element)
                spans[element.name] = (start, rows.position)
        return spans


@dataclass(frozen=True, slots=True)
class _KeptElements:
    """Bytes of the source, from and to, that stand before and after the vertices of an output."""

    source: Path
    before: tuple[tuple[int, int], ...] = ()
    after: tuple[tuple[int, int], ...] = ()

    @property
    def size_before(self) -> int:
        return sum(end - start for start, end in self.before)


class _PlyWriter(MapWriter):
    """Writes vertices under the header of the source, and copies its other elements."""

    def __init__(
        self, path: Path, point_count: int, header: PlyHeader, kept: _KeptElements
    ) -> None:
        super().__init__(path, point_count)
        self._is_text = header.encoding == "ascii"
        self._kept = kept
        self._file: BinaryIO = create_file(path)
        self._file.write(header.encode(point_count))
        copy_spans(kept.source, self._file, kept.before)

    def _append(self, records: Any) -> None:
        self._file.write(records.tobytes() if self._is_text else b"".join(records))

    def _finish(self) -> None:
        copy_spans(self._kept.source, self._file, self._kept.after)
        self._file.close()


class _PlyParts(PartWriter):
    """Writes vertices of one size, each to its place, and copies the other elements."""

    def __init__(
        self, path: Path, point_count: int, header: PlyHeader, kept: _KeptElements
    ) -> None:
        super().__init__(path, point_count)
        self._header = header.encode(point_count)
        self._kept = kept
        self._start = len(self._header) + kept.size_before
        self._record_size = header.vertex.least_bytes

    def put(self, file: BinaryIO, first: int, records: NDArray[Any]) -> None:
        put_records(file, self._start + first * self._record_size, records)

    def _write_surroundings(self, file: BinaryIO) -> None:
        file.write(self._header)
        copy_spans(self._kept.source, file, self._kept.before)
        end = self._start + self.point_count * self._record_size
        file.truncate(end)
        file.seek(end)
        copy_spans(self._kept.source, file, self._kept.after)


def _field(each: PlyProperty) -> Field:
    name = each.dtype.newbyteorder("=").name
    return Field(each.name, name if each.count_dtype is None else f"list of {name}")
