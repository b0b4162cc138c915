"""The header of a PLY file: elements, their properties, and the lines as they were written.

The format is described by Greg Turk, "The PLY Polygon File Format" (Stanford, 1994); type names
with a width (`int8`, `float32`) came later and mean the same.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO

import numpy as np

from tiling.errors import MapFormatError
from tiling.formats.checks import SIGNATURE_LENGTH, kind_of
from tiling.formats.points import Field

VERTEX = "vertex"

_LONGEST_HEADER = 1 << 20
_BYTE_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("long", "int64"), "i8"),
    **dict.fromkeys(("ulong", "uint64"), "u8"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_ELEMENTS_OF_VERTICES = frozenset({"face", "edge", "tristrips", "polygon", "polyline", "line"})


@dataclass(frozen=True, slots=True)
class PlyProperty:
    """One property of an element: a number, or a list of numbers that begins with its length."""

    name: str
    dtype: np.dtype
    count_dtype: np.dtype | None = None
    """Type of the length of a list; None for a number."""

    @property
    def least_bytes(self) -> int:
        """Bytes of a number, or of an empty list."""
        return (self.count_dtype or self.dtype).itemsize


@dataclass(frozen=True, slots=True)
class PlyElement:
    """A kind of thing in the file, such as `vertex`, and how many of it there are."""

    name: str
    count: int
    properties: tuple[PlyProperty, ...]

    @property
    def scalars(self) -> tuple[PlyProperty, ...]:
        """The properties that are numbers."""
        return tuple(p for p in self.properties if p.count_dtype is None)

    @property
    def is_fixed(self) -> bool:
        """Whether every record has the same size, there being no lists."""
        return len(self.scalars) == len(self.properties)

    @property
    def scalar_dtype(self) -> np.dtype:
        """A record without its lists, packed as in a binary file."""
        return np.dtype([(p.name, p.dtype) for p in self.scalars])

    @property
    def least_bytes(self) -> int:
        """Bytes of the smallest record in a binary file."""
        return sum(p.least_bytes for p in self.properties)

    @property
    def names_vertices(self) -> bool:
        """Whether its records mean vertices by their number, as faces and edges do."""
        return self.name.lower() in _ELEMENTS_OF_VERTICES or any(
            p.name.lower().startswith(VERTEX) for p in self.properties
        )


@dataclass(frozen=True, slots=True)
class PlyHeader:
    """All that stands before the first record."""

    encoding: str
    """`"ascii"`, `"binary_little_endian"` or `"binary_big_endian"`."""
    line_end: bytes
    r"""What ends a line: `b"\n"`, or `b"\r"` in files from old Macs. (A `b"\r"` before a `b"\n"` is
    kept as part of the line.)"""
    lines: tuple[bytes, ...]
    """The lines without their ends, up to and including `end_header`."""
    owners: tuple[str | None, ...]
    """For each line, the element it declares or belongs to; None for format and remarks."""
    elements: tuple[PlyElement, ...]
    size: int

    @property
    def byte_order(self) -> str:
        """Of binary records, as NumPy writes it; that of this machine for text."""
        return _BYTE_ORDERS[self.encoding] or "="

    @property
    def vertex(self) -> PlyElement:
        """The element that holds the points."""
        return next(element for element in self.elements if element.name == VERTEX)

    @property
    def dropped(self) -> tuple[PlyElement, ...]:
        """The elements that cannot survive when vertices are removed."""
        return tuple(e for e in self.elements if e.name != VERTEX and e.count and e.names_vertices)

    def extended(self, fields: Sequence[Field]) -> "PlyHeader":
        """Return the header of vertices with further properties of one number each."""
        further = tuple(
            PlyProperty(each.name, np.dtype(self.byte_order + np.dtype(each.dtype).str[1:]))
            for each in fields
        )
        types = {code: word for word, code in reversed(_TYPES.items())}
        last = max(number for number, owner in enumerate(self.owners) if owner == VERTEX)
        ending = self.lines[last][len(self.lines[last].rstrip()) :]
        lines = [
            f"property {types[each.dtype.str[1:]]} {each.name}".encode() + ending
            for each in further
        ]
        vertex = replace(self.vertex, properties=(*self.vertex.properties, *further))
        return replace(
            self,
            lines=(*self.lines[: last + 1], *lines, *self.lines[last + 1 :]),
            owners=(*self.owners[: last + 1], *[VERTEX] * len(lines), *self.owners[last + 1 :]),
            elements=tuple(vertex if each.name == VERTEX else each for each in self.elements),
        )

    def encode(self, vertex_count: int) -> bytes:
        """Return the same header for `vertex_count` vertices, without the dropped elements."""
        dropped = {element.name for element in self.dropped}
        lines = []
        for line, owner in zip(self.lines, self.owners, strict=True):
            if owner not in dropped:
                counts = owner == VERTEX and line.split()[0] == b"element"
                own = re.sub(rb"\d+(\s*)$", b"%d\\1" % vertex_count, line) if counts else line
                lines.append(own + self.line_end)
        return b"".join(lines)


def read_header(file: BinaryIO, path: Path) -> PlyHeader:
    """Read the header that a file begins with; refuse one of no vertices."""
    start = file.read(_LONGEST_HEADER)
    if not re.match(rb"ply[ \t]*[\r\n]", start):
        raise MapFormatError(path, "a PLY file", kind_of(start[:SIGNATURE_LENGTH]), at="byte 0")
    line_end = b"\r" if re.match(rb"ply[ \t]*\r(?!\n)", start) else b"\n"
    parser = _HeaderParser(path)
    lines = start.split(line_end)
    size = 0
    for number, line in enumerate(lines[:-1], start=1):
        size += len(line) + len(line_end)
        parser.read(number, line)
        if parser.ended:
            break
    if not parser.ended:
        expected = f"end_header within {_LONGEST_HEADER} bytes"
        raise MapFormatError(path, expected, "none", at=f"line {len(lines)}")
    return PlyHeader(
        encoding=parser.encoding,
        line_end=line_end,
        lines=tuple(lines[: len(parser.owners)]),
        owners=tuple(parser.owners),
        elements=parser.elements(),
        size=size,
    )


class _HeaderParser:
    """Reads header lines one by one."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.encoding = ""
        self.ended = False
        self.owners: list[str | None] = []
        self._counts: dict[str, int] = {}
        self._properties: dict[str, dict[str, PlyProperty]] = {}
        self._current: str | None = None

    def read(self, number: int, line: bytes) -> None:
        """Take in the line of this number, counted from 1."""
        self._at = f"line {number}"
        words = line.decode("latin-1").split()
        keyword = words[0] if words else ""
        owner = None
        if keyword == "element":
            owner = self._current = self._element(words)
        elif keyword == "property":
            owner = self._property(words)
        elif keyword == "format":
            self._format(words)
        elif keyword == "end_header" and len(words) == 1:
            self._check_elements()
            self.ended = True
        elif not (keyword in ("", "comment", "obj_info") or number == 1):
            raise self._error("a keyword of a PLY header", repr(keyword))
        self.owners.append(owner)

    def elements(self) -> tuple[PlyElement, ...]:
        return tuple(
            PlyElement(name, count, tuple(self._properties[name].values()))
            for name, count in self._counts.items()
        )

    def _error(self, expected: str, found: str) -> MapFormatError:
        return MapFormatError(self.path, expected, found, at=self._at)

    def _format(self, words: list[str]) -> None:
        if self.encoding:
            raise self._error("one format line", "a second")
        if self._counts:
            raise self._error("the format before the first element", "it after one")
        if len(words) != 3 or words[1] not in _BYTE_ORDERS or words[2] != "1.0":
            known = ", ".join(_BYTE_ORDERS)
            raise self._error(f"format {known}, version 1.0", repr(" ".join(words[1:])))
        self.encoding = words[1]

    def _element(self, words: list[str]) -> str:
        if not self.encoding:
            raise self._error("the format before the first element", "none")
        if len(words) != 3 or not (words[2].isascii() and words[2].isdigit()):
            raise self._error("an element with its name and count", repr(" ".join(words)))
        if len(words[2]) > 18:
            raise self._error("a count below 10^18", f"one of {len(words[2])} digits")
        name = words[1]
        if name in self._counts:
            raise self._error("each element once", f"a second {name!r}")
        self._counts[name] = int(words[2])
        self._properties[name] = {}
        return name

    def _property(self, words: list[str]) -> str:
        element = self._current
        if element is None:
            raise self._error("an element before its properties", "none")
        is_list = words[1:2] == ["list"]
        if len(words) != (5 if is_list else 3):
            raise self._error("a property with its type and name", repr(" ".join(words)))
        name = words[-1]
        if name in self._properties[element]:
            raise self._error("each property once", f"a second {name!r}")
        count_dtype = None
        if is_list:
            count_dtype = self._dtype(words[2])
            if count_dtype.kind == "f":
                raise self._error("whole numbers as lengths of a list", repr(words[2]))
        dtype = self._dtype(words[-2])
        self._properties[element][name] = PlyProperty(name, dtype, count_dtype)
        return element

    def _dtype(self, word: str) -> np.dtype:
        if word not in _TYPES:
            raise self._error("a PLY type such as 'float' or 'uint8'", repr(word))
        return np.dtype(_BYTE_ORDERS[self.encoding] + _TYPES[word])

    def _check_elements(self) -> None:
        if VERTEX not in self._counts:
            raise self._error("an element 'vertex'", "none in the header")
        for name, properties in self._properties.items():
            if self._counts[name] and not properties:
                raise self._error(f"properties of element {name!r}", "none in the header")
