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

ENCODINGS = {
    "ascii": "ascii",
    "binary": "binary",
    "binary_compressed": "binary_compressed",
    # A slip of the pen in some writers, which readers have learnt to take.
    "binaryscompressed": "binary_compressed",
}

_TYPES = {
    ("I", 1): "int8",
    ("I", 2): "int16",
    ("I", 4): "int32",
    ("I", 8): "int64",
    ("U", 1): "uint8",
    ("U", 2): "uint16",
    ("U", 4): "uint32",
    ("U", 8): "uint64",
    ("F", 4): "float32",
    ("F", 8): "float64",
    ("B", 1): "bool",
}

_KEYWORDS = (
    *("VERSION", "FIELDS", "COLUMNS", "SIZE", "TYPE", "COUNT"),
    *("WIDTH", "HEIGHT", "VIEWPOINT", "POINTS", "DATA"),
)

_COUNT_LINE = re.compile(rb"^(\s*(WIDTH|HEIGHT|POINTS)\s+)\d+")


@dataclass(frozen=True, slots=True)
class PcdField:
    """One field: `count` values of `size` bytes, the first at byte `offset` of a point's record."""

    name: str
    dtype: str
    size: int
    count: int
    offset: int

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
    """x, y and z."""
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
        fields, offset = list(self.fields), self.record_size
        for each in further:
            size = np.dtype(each.dtype).itemsize
            fields.append(PcdField(each.name, each.dtype, size, 1, offset))
            offset += size
        kinds = {dtype: kind for (kind, _), dtype in _TYPES.items()}
        # Old files lack some of these lines; with fields of other types they need them.
        words = {
            "FIELDS": [field.name for field in fields],
            "SIZE": [str(field.size) for field in fields],
            "TYPE": [kinds[field.dtype] for field in fields],
            "COUNT": [str(field.count) for field in fields],
        }
        lines: list[bytes] = []
        for line in self.lines:
            keyword = (line.split() or [b""])[0].decode("latin-1").replace("COLUMNS", "FIELDS")
            if keyword == "FIELDS":
                ending = line[len(line.rstrip()) :]
                lines += [
                    f"{name} {' '.join(values)}".encode() + ending for name, values in words.items()
                ]
            elif keyword not in words:
                lines.append(line)
        return replace(self, lines=tuple(lines), fields=tuple(fields))

    def described_fields(self) -> tuple[Field, ...]:
        """Return the fields in the terms that all formats share."""
        return tuple(Field(field.name, field.dtype, field.count) for field in self.fields)


@dataclass(frozen=True, slots=True)
class _Entry:
    """The values of one keyword, and the line, from 1, where they stand."""

    values: tuple[str, ...]
    line: int


def read_header(stream: BinaryIO, path: Path) -> PcdHeader:
    """Read the header at the beginning of a stream, and leave the stream at the first point.

    Raises
    ------
    MapFormatError
        When it is not the header of a PCD file with x, y and z.
    """
    lines, entries = _read_entries(stream, path)
    fields = _fields(entries, path)
    width, height = _extent(entries, path)
    viewpoint = _viewpoint(entries, path)
    kind = entries["DATA"].values[0].lower()
    if kind not in ENCODINGS:
        raise MapFormatError(
            path,
            "DATA ascii, binary or binary_compressed",
            repr(_shortened(entries["DATA"].values[0])),
            f"line {entries['DATA'].line}",
        )
    coordinates = _coordinates(fields, entries, path)
    return PcdHeader(lines, fields, coordinates, width, height, ENCODINGS[kind], viewpoint)


def _read_entries(stream: BinaryIO, path: Path) -> tuple[tuple[bytes, ...], dict[str, _Entry]]:
    """Read lines up to DATA; return them and the values that each keyword has."""
    lines: list[bytes] = []
    entries: dict[str, _Entry] = {}
    while "DATA" not in entries:
        at = f"line {len(lines) + 1}"
        line = stream.readline(LONGEST_HEADER)
        lines.append(line)
        if not line:
            found = "the end of the file" if stream.tell() else "an empty file"
            raise MapFormatError(path, "a PCD header that ends in a DATA line", found, at)
        if stream.tell() >= LONGEST_HEADER:
            found = f"none in the first {LONGEST_HEADER} bytes"
            raise MapFormatError(path, "a DATA line", found)
        words = line.decode("utf-8", "replace").split()
        if not words or words[0].startswith("#"):
            continue
        if line.startswith(b"version https://git-lfs"):
            found = "a Git LFS pointer, which stands for a file that was not fetched"
            raise MapFormatError(path, "a PCD file", found)
        keyword, *values = words
        if keyword not in _KEYWORDS:
            found = repr(_shortened(keyword))
            raise MapFormatError(path, "a keyword of a PCD header", found, at)
        keyword = "FIELDS" if keyword == "COLUMNS" else keyword
        if keyword in entries:
            raise MapFormatError(path, f"one {keyword} line", "a second one", at)
        if not values:
            raise MapFormatError(path, f"values after {keyword}", "none", at)
        entries[keyword] = _Entry(tuple(values), len(lines))
    return tuple(lines), entries


def _fields(entries: dict[str, _Entry], path: Path) -> tuple[PcdField, ...]:
    """Combine FIELDS, SIZE, TYPE and COUNT; those that old files lack have PCL's defaults."""
    if "FIELDS" not in entries:
        raise MapFormatError(path, "a FIELDS line before DATA", "none")
    names = entries["FIELDS"].values
    for keyword in ("SIZE", "TYPE", "COUNT"):
        if keyword in entries and len(entries[keyword].values) != len(names):
            found = str(len(entries[keyword].values))
            at = f"line {entries[keyword].line}"
            raise MapFormatError(
                path, f"{len(names)} values of {keyword}, one for each of FIELDS", found, at
            )
    sizes = _numbers(entries, "SIZE", 4, len(names), path)
    counts = _numbers(entries, "COUNT", 1, len(names), path)
    types = entries["TYPE"].values if "TYPE" in entries else ("F",) * len(names)
    fields = []
    offset = 0
    for name, size, kind, count in zip(names, sizes, types, counts, strict=True):
        if (kind.upper(), size) not in _TYPES:
            at = _line(entries, "TYPE" if "TYPE" in entries else "SIZE")
            expected = "TYPE I or U of SIZE 1, 2, 4 or 8, or F of 4 or 8"
            raise MapFormatError(path, expected, f"{_shortened(kind)} of {size}", at)
        if count == 0:
            raise MapFormatError(path, "a COUNT of 1 or more", "0", _line(entries, "COUNT"))
        fields.append(PcdField(name, _TYPES[kind.upper(), size], size, count, offset))
        offset += size * count
    if offset > LARGEST_RECORD:
        raise MapFormatError(path, f"points of at most {LARGEST_RECORD} bytes", f"{offset} bytes")
    return tuple(fields)


def _coordinates(
    fields: tuple[PcdField, ...], entries: dict[str, _Entry], path: Path
) -> tuple[PcdField, PcdField, PcdField]:
    """Find x, y and z, the first of each name."""
    by_name = {field.name: field for field in reversed(fields)}
    names = coordinate_names(by_name)
    if names is None:
        found = _shortened(" ".join(field.name for field in fields))
        raise MapFormatError(path, "x, y and z among FIELDS", found, _line(entries, "FIELDS"))
    for name in names:
        if by_name[name].count != 1:
            found = str(by_name[name].count)
            raise MapFormatError(path, f"a COUNT of 1 for {name}", found, _line(entries, "COUNT"))
    x, y, z = names
    return by_name[x], by_name[y], by_name[z]


def _extent(entries: dict[str, _Entry], path: Path) -> tuple[int, int]:
    """Return the width and height; as PCL does, take 0 for a line that is not there."""
    width = _number(entries, "WIDTH", path)
    height = _number(entries, "HEIGHT", path)
    points = _number(entries, "POINTS", path)
    if "WIDTH" not in entries and "POINTS" not in entries:
        raise MapFormatError(path, "a WIDTH or POINTS line before DATA", "neither")
    if width == 0 and height == 0:
        width = points
    height = height or 1
    if "POINTS" in entries and width * height != points:
        raise MapFormatError(
            path, f"POINTS {width * height} = WIDTH x HEIGHT", str(points), _line(entries, "POINTS")
        )
    return width, height


def _viewpoint(entries: dict[str, _Entry], path: Path) -> tuple[float, ...] | None:
    if "VIEWPOINT" not in entries:
        return None
    values = entries["VIEWPOINT"].values
    try:
        numbers = [float(value) for value in values]
    except ValueError:
        numbers = []
    if len(numbers) < 7:
        found = repr(_shortened(" ".join(values)))
        raise MapFormatError(path, "7 numbers in VIEWPOINT", found, _line(entries, "VIEWPOINT"))
    return tuple(numbers[:7])


def _number(entries: dict[str, _Entry], keyword: str, path: Path) -> int:
    """Return a keyword's only number, 0 where it is missing."""
    if keyword in entries and len(entries[keyword].values) != 1:
        found = str(len(entries[keyword].values))
        raise MapFormatError(path, f"one value of {keyword}", found, _line(entries, keyword))
    return _numbers(entries, keyword, 0, 1, path)[0]


def _numbers(
    entries: dict[str, _Entry], keyword: str, default: int, count: int, path: Path
) -> tuple[int, ...]:
    """Return a keyword's numbers, or `count` times the default where it is missing."""
    if keyword not in entries:
        return (default,) * count
    for value in entries[keyword].values:
        # Python would take `1_000`, and digits of other scripts, too.
        if not (value.isascii() and value.isdigit() and len(value) <= 18):
            found = repr(_shortened(value))
            at = _line(entries, keyword)
            raise MapFormatError(path, f"a whole number after {keyword}", found, at)
    return tuple(int(value) for value in entries[keyword].values)


def _line(entries: dict[str, _Entry], keyword: str) -> str:
    return f"line {entries[keyword].line}"


def _shortened(text: str) -> str:
    return text if len(text) <= 40 else f"{text[:40]}..."
