"""PLY maps: ASCII and binary of both byte orders, with any properties and further elements."""

from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Any, BinaryIO, cast

import numpy as np
from numpy.typing import NDArray

from tiling.errors import MapFormatError
from tiling.formats.base import MapReader, MapWriter, StreamWriter
from tiling.formats.checks import check_leftover
from tiling.formats.parts import PartWriter, Surroundings
from tiling.formats.ply.header import VERTEX, PlyProperty, read_header
from tiling.formats.ply.rows import open_rows
from tiling.formats.points import (
    Field,
    MapDescription,
    PointBatch,
    coordinate_names,
    only_rows,
)
from tiling.formats.text_rows import TextRows


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
        self._byte_order = self._header.byte_order
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
                self._check_behind(file, reader.position)
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

    def _stream_writer(self, path: Path, point_count: int) -> MapWriter:
        return _PlyWriter(path, point_count, self._surroundings(point_count))

    def _part_writer(self, path: Path, point_count: int) -> PartWriter:
        around = self._surroundings(point_count)
        return PartWriter(path, point_count, around, self._header.vertex.least_bytes)

    def _take_further(self) -> None:
        self._surroundings(0)  # found by this header, the one of the file
        self._header = self._header.extended(self.further)

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

    def _surroundings(self, point_count: int) -> Surroundings:
        """Return the header of an output, and the elements before and after its vertices."""
        header = self._header
        others = [e for e in header.elements if e.name != VERTEX]
        kept = [e for e in others if e.count and e not in header.dropped]
        spans = [self._spans[element.name] for element in kept]
        start = self._spans[VERTEX][0] if kept else 0
        before = [span for span in spans if span[0] < start]
        after = [span for span in spans if span[0] >= start]
        return Surroundings(header.encode(point_count), self._path, before, after)

    def _check_what_is_known(self) -> tuple[str, ...]:
        """Refuse vertices that the header does not count, where no record need be read for that."""
        header = self._header
        if header.encoding != "ascii" and all(each.is_fixed for each in header.elements):
            with self._path.open("rb") as file:
                return self._check_behind(file, max(end for _, end in self._spans.values()))
        # Otherwise they are met when the last vertex has been read, unless there is none.
        if not header.vertex.count:
            next(self._batches_from(range(0), 1), None)
        return ()

    def _check_behind(self, file: BinaryIO, start: int) -> tuple[str, ...]:
        """Refuse bytes behind all elements that could be another vertex."""
        vertex = self._header.vertex
        counts = ", ".join(f"{e.count} {e.name}" for e in self._header.elements)
        is_text = self._header.encoding == "ascii"
        least = 2 * len(vertex.properties) - 1 if is_text else vertex.least_bytes
        stop = self._path.stat().st_size
        return check_leftover(file, start, stop, least, self._path, counts)

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


class _PlyWriter(StreamWriter):
    """Writes vertices that are text, or have lists, and copies the other elements."""

    def _append(self, records: Any) -> None:
        is_text = isinstance(records, TextRows)
        self._file.write(records.tobytes() if is_text else b"".join(records))


def _field(each: PlyProperty) -> Field:
    name = each.dtype.newbyteorder("=").name
    return Field(each.name, name if each.count_dtype is None else f"list of {name}")
