"""The header of a PCD file: read, checked against the file, and written for another point count.

The format is that of the Point Cloud Library, https://pointclouds.org/documentation/tutorials/
pcd_file_format.html, in all its versions: 0.5 knows no VIEWPOINT, and still older files may lack
COUNT, SIZE, TYPE and POINTS, or say COLUMNS for FIELDS.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO

import numpy as np

from tiling.errors import MapFormatError
from tiling.formats.points import Field, coordinate_names

LONGEST_HEADER = 1 << 20
"""Bytes after which a file with no DATA line is given up."""

LARGEST_RECORD = 1 << 24
"""Most bytes, or values, of one point."""

_ENCODINGS = ("ascii", "binary", "binary_compressed")

_TYPES = {
    **{("I", size): f"int{8 * size}" for size in (1, 2, 4, 8)},
    **{("U", size): f"uint{8 * size}" for size in (1, 2, 4, 8)},
    **{("F", size): f"float{8 * size}" for size in (4, 8)},
    ("B", 1): "bool",
}
"""By TYPE and SIZE."""

_KEYWORDS = (
    *("VERSION", "FIELDS", "COLUMNS", "SIZE", "TYPE", "COUNT"),
    *("WIDTH", "HEIGHT", "VIEWPOINT", "POINTS", "DATA"),
)

_COUNT_LINE = re.compile(rb"^(\s*(WIDTH|HEIGHT|POINTS)\s+)\d+")


@dataclass(frozen=True, slots=True)
class PcdField:
    """One field: `count` values of `size` bytes."""

    name: str
    dtype: str
    size: int
    count: int

    @property
    def width(self) -> int:
        """Bytes that the field takes in a record."""
        return self.size * self.count


@dataclass(frozen=True, slots=True)
class PcdHeader:
    """What the header says."""

    lines: tuple[bytes, ...]
    """The header as it stands in the file, each line with its ending."""
    fields: tuple[PcdField, ...]
    coordinates: tuple[PcdField, PcdField, PcdField]
    width: int
    height: int
    """Points in a row, and rows; a height above 1 makes the cloud an organised one."""
    encoding: str
    """`"ascii"`, `"binary"` or `"binary_compressed"`."""
    viewpoint: tuple[float, ...] | None = None
    """Where the sensor was, and its quaternion, w first."""

    @property
    def point_count(self) -> int:
        """Points in the file."""
        return self.width * self.height

    @property
    def data_offset(self) -> int:
        """Bytes before the first point."""
        return sum(len(line) for line in self.lines)

    @property
    def record_size(self) -> int:
        """Bytes of a point in the binary encodings."""
        return sum(field.width for field in self.fields)

    @property
    def value_count(self) -> int:
        """Numbers of a point in the ascii encoding."""
        return sum(field.count for field in self.fields)

    def first_value(self, field: PcdField) -> int:
        """Which of a point's numbers, from 0, is the field's first."""
        return sum(other.count for other in self.fields[: self.fields.index(field)])

    def for_points(self, point_count: int) -> bytes:
        """Return the header of an unorganised cloud of `point_count` points, otherwise the same."""
        counts = {b"WIDTH": point_count, b"HEIGHT": 1, b"POINTS": point_count}
        return b"".join(
            _COUNT_LINE.sub(lambda found: b"%s%d" % (found[1], counts[found[2]]), line)
            for line in self.lines
        )

    def without_viewpoint(self) -> "PcdHeader":
        """Return the header of points that no single sensor saw."""
        lines = tuple(
            re.sub(rb"^(\s*VIEWPOINT)[^\r\n]*", rb"\1 0 0 0 1 0 0 0", line) for line in self.lines
        )
        return replace(self, lines=lines, viewpoint=None)

    def extended(self, further: Sequence[Field]) -> "PcdHeader":
        """Return the header of points with further fields of one value each."""
        sizes = [np.dtype(each.dtype).itemsize for each in further]
        added = zip(further, sizes, strict=True)
        fields = [*self.fields, *(PcdField(each.name, each.dtype, n, 1) for each, n in added)]
        kinds = {dtype: kind for (kind, _), dtype in _TYPES.items()}
        rows = [(f.name, f"{f.size}", kinds[f.dtype], f"{f.count}") for f in fields]
        # Old files lack some of these lines; with fields of other types they need them.
        words = dict(zip(("FIELDS", "SIZE", "TYPE", "COUNT"), zip(*rows, strict=True), strict=True))
        lines: list[bytes] = []
        for line in self.lines:
            keyword = (line.split() or [b""])[0].decode("latin-1").replace("COLUMNS", "FIELDS")
            if keyword == "FIELDS":
                end = line[len(line.rstrip()) :]
                lines += [f"{name} {' '.join(row)}".encode() + end for name, row in words.items()]
            elif keyword not in words:
                lines.append(line)
        return replace(self, lines=tuple(lines), fields=tuple(fields))


def read_header(stream: BinaryIO, path: Path) -> PcdHeader:
    """Read the header of a PCD file with x, y and z, up to the first point; refuse any other."""
    said = _Said(path)
    said.read(stream)
    fields = _fields(said)
    width, height = _extent(said)
    viewpoint = _viewpoint(said)
    word = said.values["DATA"][0]
    # Some writers slip, which readers have learnt to take.
    encoding = word.lower().replace("binaryscompressed", "binary_compressed")
    if encoding not in _ENCODINGS:
        raise said.wrong("DATA ascii, binary or binary_compressed", repr(_shortened(word)), "DATA")
    coordinates = _coordinates(fields, said)
    return PcdHeader(tuple(said.lines), fields, coordinates, width, height, encoding, viewpoint)


class _Said:
    """The lines of a header, the values that each keyword has, and in which line, from 1."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.lines: list[bytes] = []
        self.values: dict[str, list[str]] = {}
        self._places: dict[str, int] = {}

    def read(self, stream: BinaryIO) -> None:
        """Read lines up to DATA."""
        while "DATA" not in self.values:
            at = f"line {len(self.lines) + 1}"
            line = stream.readline(LONGEST_HEADER)
            self.lines.append(line)
            if not line:
                found = "the end of the file" if stream.tell() else "an empty file"
                raise MapFormatError(self.path, "a PCD header that ends in a DATA line", found, at)
            if stream.tell() >= LONGEST_HEADER:
                found = f"none in the first {LONGEST_HEADER} bytes"
                raise MapFormatError(self.path, "a DATA line", found)
            words = line.decode("utf-8", "replace").split()
            if line.startswith(b"version https://git-lfs"):
                found = "a Git LFS pointer, which stands for a file that was not fetched"
                raise MapFormatError(self.path, "a PCD file", found)
            if words and not words[0].startswith("#"):
                self._take(words[0], words[1:], at)

    def _take(self, keyword: str, values: list[str], at: str) -> None:
        if keyword not in _KEYWORDS:
            found = repr(_shortened(keyword))
            raise MapFormatError(self.path, "a keyword of a PCD header", found, at)
        keyword = "FIELDS" if keyword == "COLUMNS" else keyword
        if keyword in self.values:
            raise MapFormatError(self.path, f"one {keyword} line", "a second one", at)
        if not values:
            raise MapFormatError(self.path, f"values after {keyword}", "none", at)
        self.values[keyword] = values
        self._places[keyword] = len(self.lines)

    def wrong(self, expected: str, found: str, keyword: str) -> MapFormatError:
        """Return the error of a keyword's line."""
        return MapFormatError(self.path, expected, found, f"line {self._places[keyword]}")

    def numbers(self, keyword: str, missing: list[int]) -> list[int]:
        """Return a keyword's numbers, or others where it is missing."""
        for value in self.values.get(keyword, ()):
            # Python would take `1_000`, and digits of other scripts, too.
            if not (value.isascii() and value.isdigit() and len(value) <= 18):
                expected = f"a whole number after {keyword}"
                raise self.wrong(expected, repr(_shortened(value)), keyword)
        return [int(value) for value in self.values.get(keyword, missing)]

    def number(self, keyword: str) -> int:
        """Return a keyword's only number, 0 where it is missing."""
        found = len(self.values.get(keyword, "0"))
        if found != 1:
            raise self.wrong(f"one value of {keyword}", f"{found}", keyword)
        return self.numbers(keyword, [0])[0]


def _fields(said: _Said) -> tuple[PcdField, ...]:
    """Combine FIELDS, SIZE, TYPE and COUNT; those that old files lack have PCL's defaults."""
    if "FIELDS" not in said.values:
        raise MapFormatError(said.path, "a FIELDS line before DATA", "none")
    names = said.values["FIELDS"]
    for keyword in ("SIZE", "TYPE", "COUNT"):
        found = len(said.values.get(keyword, names))
        if found != len(names):
            expected = f"{len(names)} values of {keyword}, one for each of FIELDS"
            raise said.wrong(expected, f"{found}", keyword)
    sizes, counts = said.numbers("SIZE", [4] * len(names)), said.numbers("COUNT", [1] * len(names))
    types = said.values.get("TYPE", ["F"] * len(names))
    fields = []
    for name, size, kind, count in zip(names, sizes, types, counts, strict=True):
        if (kind.upper(), size) not in _TYPES:
            expected = "TYPE I or U of SIZE 1, 2, 4 or 8, or F of 4 or 8"
            keyword = "TYPE" if "TYPE" in said.values else "SIZE"
            raise said.wrong(expected, f"{_shortened(kind)} of {size}", keyword)
        if count == 0:
            raise said.wrong("a COUNT of 1 or more", "0", "COUNT")
        fields.append(PcdField(name, _TYPES[kind.upper(), size], size, count))
    if (size := sum(field.width for field in fields)) > LARGEST_RECORD:
        expected = f"points of at most {LARGEST_RECORD} bytes"
        raise MapFormatError(said.path, expected, f"{size} bytes")
    return tuple(fields)


def _coordinates(fields: tuple[PcdField, ...], said: _Said) -> tuple[PcdField, PcdField, PcdField]:
    """Find x, y and z, the first of each name."""
    by_name = {field.name: field for field in reversed(fields)}
    names = coordinate_names(by_name)
    if names is None:
        found = _shortened(" ".join(field.name for field in fields))
        raise said.wrong("x, y and z among FIELDS", found, "FIELDS")
    for name in names:
        if by_name[name].count != 1:
            raise said.wrong(f"a COUNT of 1 for {name}", f"{by_name[name].count}", "COUNT")
    x, y, z = names
    return by_name[x], by_name[y], by_name[z]


def _extent(said: _Said) -> tuple[int, int]:
    """Return the width and height; as PCL does, take 0 for a line that is not there."""
    width, height, points = map(said.number, ("WIDTH", "HEIGHT", "POINTS"))
    if "WIDTH" not in said.values and "POINTS" not in said.values:
        raise MapFormatError(said.path, "a WIDTH or POINTS line before DATA", "neither")
    if width == 0 and height == 0:
        width = points
    height = height or 1
    if "POINTS" in said.values and width * height != points:
        raise said.wrong(f"POINTS {width * height} = WIDTH x HEIGHT", f"{points}", "POINTS")
    return width, height


def _viewpoint(said: _Said) -> tuple[float, ...] | None:
    if "VIEWPOINT" not in said.values:
        return None
    values = said.values["VIEWPOINT"]
    try:
        numbers = [float(value) for value in values]
    except ValueError:
        numbers = []
    if len(numbers) < 7:
        found = repr(_shortened(" ".join(values)))
        raise said.wrong("7 numbers in VIEWPOINT", found, "VIEWPOINT")
    return tuple(numbers[:7])


def _shortened(text: str) -> str:
    return text if len(text) <= 40 else f"{text[:40]}..."
