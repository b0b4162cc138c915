"""Arrays in NumPy's .npy form: the header, and rows read and written some at a time.

NumPy reads the headers (`numpy.lib.format`). Nothing here ever unpickles.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from math import prod
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from tiling.errors import MapFormatError
from tiling.formats.checks import SIGNATURE_LENGTH, kind_of
from tiling.formats.parts import put_records
from tiling.formats.points import COORDINATES, Field, coordinate_names

_ALIGNMENT = 64
_LONGEST_HEADER = 10_000
"""Bytes of a header that are evaluated, as NumPy itself limits them."""
_MOST_COLUMNS = 1024
"""Columns of an array in Fortran order, which are read side by side."""
_LONGEST_ROW = 1 << 24
_MOST_DOUBTLESS_COLUMNS = 16
"""Columns that points without named fields have in practice; coordinates in rows have many more."""
_COORDINATE_KINDS = "iuf"


@dataclass(frozen=True, slots=True)
class ArrayHeader:
    """What stands before the values of an array."""

    dtype: np.dtype
    fortran_order: bool
    """Whether the first index runs fastest."""
    shape: tuple[int, ...]
    """The first is the number of rows."""
    version: int = 1
    """1, 2 or 3; 0 for values that have no header."""
    size: int = 0
    """Bytes of the header itself."""

    @property
    def row_count(self) -> int:
        """Length along the first index; 1 for an array with no index at all."""
        return self.shape[0] if self.shape else 1

    @property
    def row_elements(self) -> int:
        """Elements in a row."""
        return prod(self.shape[1:])

    @property
    def row_bytes(self) -> int:
        """Bytes of a row."""
        return self.row_elements * self.dtype.itemsize

    @property
    def data_bytes(self) -> int:
        """Bytes of all values."""
        return self.row_count * self.row_bytes

    @property
    def column_count(self) -> int:
        """Runs of bytes that rows are spread over: 1, or an element each in Fortran order."""
        return self.row_elements if self.fortran_order and len(self.shape) > 1 else 1

    @property
    def unorganised(self) -> "ArrayHeader":
        """The same values as one row after the other, of an array of rows and columns of points.

        That is one of shape (H, W, 3 or more), or (H, W) with named fields, in C order.
        """
        points = 2 if self.dtype.names else 3
        if len(self.shape) != points or self.fortran_order:
            return self
        if points == 3 and not 3 <= self.shape[2] <= _MOST_DOUBTLESS_COLUMNS:
            return self
        return replace(self, shape=(self.shape[0] * self.shape[1], *self.shape[2:]))

    @property
    def is_coordinates(self) -> bool:
        """Whether it is an (N, 3 or more) array of numbers, or has fields x, y and z."""
        if self.dtype.names:
            names = coordinate_names(self.dtype.names)
            return (
                len(self.shape) == 1
                and names is not None
                and all(self.dtype[name].kind in _COORDINATE_KINDS for name in names)
            )
        if len(self.shape) != 2 or self.dtype.kind not in _COORDINATE_KINDS:
            return False
        rows, columns = self.shape
        lies_on_its_side = 0 < rows < columns and columns > _MOST_DOUBTLESS_COLUMNS
        return columns >= 3 and not lies_on_its_side

    @property
    def has_float_coordinates(self) -> bool:
        """Whether coordinates can be any numbers."""
        names = coordinate_names(self.dtype.names or ())
        return all(self.dtype[n].kind == "f" for n in names) if names else self.dtype.kind == "f"

    @property
    def is_column(self) -> bool:
        """Whether it is an (N,) array of numbers."""
        return len(self.shape) == 1 and self.dtype.kind in _COORDINATE_KINDS

    def __str__(self) -> str:
        return f"{self.dtype} of shape {self.shape}"

    def fields(self, name: str | None = None) -> tuple[Field, ...]:
        """Describe the array, called `name`, as fields of a point; that of points has no name."""
        if self.dtype.names:
            kinds = [(each, self.dtype[each]) for each in self.dtype.names]
            return tuple(Field(each, kind.base.name, prod(kind.shape)) for each, kind in kinds)
        if name is not None:
            return (Field(name, self.dtype.name, self.row_elements),)
        names = [*COORDINATES, *(f"column {n}" for n in range(4, self.row_elements + 1))]
        return tuple(Field(each, self.dtype.name) for each in names)

    def extended(self, fields: Sequence[Field]) -> "ArrayHeader | None":
        """Return the header of rows with further fields, None where they have no place.

        They are fields of a structured array, and columns of one of floating point numbers.
        """
        if self.dtype.names:
            # A gap, as alignment leaves it, is described as a field without a name.
            described = [*npy.dtype_to_descr(self.dtype), *((f.name, f.dtype) for f in fields)]
            return replace(self, dtype=npy.descr_to_dtype(described))
        if self.dtype.kind != "f" or len(self.shape) != 2:
            return None
        return replace(self, shape=(self.shape[0], self.shape[1] + len(fields)))

    def encode(self, row_count: int) -> bytes:
        """Return the header of an array like this one, with `row_count` rows."""
        if not self.version:
            return b""
        description = {
            "descr": npy.dtype_to_descr(self.dtype),
            "fortran_order": self.fortran_order,
            "shape": (row_count, *self.shape[1:]),
        }
        text = repr(description).encode("utf-8" if self.version == 3 else "latin-1")
        start = npy.magic(self.version, 0)
        length_size = 2 if self.version == 1 else 4
        padding = -(len(start) + length_size + len(text) + 1) % _ALIGNMENT
        text += b" " * padding + b"\n"
        return start + len(text).to_bytes(length_size, "little") + text

    def coordinates(self, rows: NDArray[np.void]) -> NDArray[np.float64]:
        """Take the coordinates, (n, 3), out of rows as `RowReader` gives them."""
        xyz = np.empty((len(rows), 3))
        with np.errstate(all="ignore"):
            if self.dtype.names:
                points = rows.view(self.dtype)
                for column, name in enumerate(coordinate_names(self.dtype.names) or ()):
                    xyz[:, column] = points[name]
            else:
                xyz[:] = rows.view(self.dtype).reshape(-1, self.row_elements)[:, :3]
        return xyz


def organised_note(header: ArrayHeader) -> str:
    """Say that an organised array becomes an unorganised one."""
    shape = " x ".join(map(str, header.shape[:2]))
    return f"The organised cloud ({shape}) becomes an unorganised one, a point a row."


def read_array_header(stream: BinaryIO, path: Path, name: str = "array") -> ArrayHeader:
    """Read the header that `stream` begins with, and leave it before the values.

    What is not the header of an array is refused; in the message it is called `name`.
    """
    magic = npy.magic(1, 0)[:-2]
    start = stream.read(len(magic) + 2)
    if not start.startswith(magic):
        found = kind_of(start + stream.read(SIGNATURE_LENGTH - len(start)))
        raise MapFormatError(path, f"{name} in NumPy's .npy form", found, at="byte 0")
    version = start[len(magic) :]
    if version not in (b"\1\0", b"\2\0", b"\3\0"):
        found = ".".join(map(str, version)) or "none"
        raise MapFormatError(path, f"{name} of .npy version 1.0, 2.0 or 3.0", found, at="byte 6")
    length_size = 2 if version[0] == 1 else 4
    length = int.from_bytes(stream.read(length_size), "little")
    if not 0 < length <= _LONGEST_HEADER:
        expected = f"a header of {name} with 1 to {_LONGEST_HEADER} bytes"
        raise MapFormatError(path, expected, f"{length} bytes", at="byte 8")
    text = stream.read(length)
    place = f"byte {len(start) + length_size}"
    if len(text) != length:
        raise MapFormatError(path, f"{length} bytes of header of {name}", f"{len(text)}", at=place)
    try:
        shape, fortran_order, dtype = _understood(text, version[0])
    except Exception:  # evaluating foreign text fails in many ways
        expected = f"a header of {name} with descr, fortran_order and shape"
        found = repr(text[:60].decode("latin-1"))
        raise MapFormatError(path, expected, found, at=place) from None
    size = len(start) + length_size + length
    header = ArrayHeader(dtype, fortran_order, shape, version[0], size)
    if header.row_bytes > _LONGEST_ROW:
        expected = f"{name} with at most {_LONGEST_ROW} bytes a row"
        raise MapFormatError(path, expected, f"{header.row_bytes}", at=place)
    if header.column_count > _MOST_COLUMNS:
        expected = f"{name} in Fortran order with at most {_MOST_COLUMNS} columns"
        raise MapFormatError(path, expected, f"{header.column_count}", at=place)
    return header


def _understood(text: bytes, version: int) -> tuple[tuple[int, ...], bool, np.dtype]:
    """Return shape, order and type; raise any error for text that is no header."""
    if version == 3:
        # UTF-8 of version 3 and Latin-1 of version 2 mean the same where they are escaped.
        text = text.decode("utf-8").encode("ascii", "backslashreplace")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # NumPy advises to write anew what Python 2 wrote
        stream = BytesIO(len(text).to_bytes(4, "little") + text)
        shape, fortran_order, dtype = npy.read_array_header_2_0(stream)
    if not all(0 <= n < 1 << 62 for n in shape):
        raise ValueError
    return shape, fortran_order, dtype


@dataclass(slots=True)
class RowReader:
    """Reads the rows of an array from the first wanted on, some at a time.

    There is a stream for each of `header.column_count`; the same one many times where it can jump
    about. The row is the next one.
    """

    streams: Sequence[BinaryIO]
    header: ArrayHeader
    path: Path
    name: str
    row: int

    def read(self, count: int) -> NDArray[np.void]:
        """Read the next rows, (count,) of `header.row_bytes` bytes; refuse an end before."""
        header = self.header
        columns = header.column_count
        if not header.row_bytes:
            return np.empty(count, dtype="V0")
        width = header.row_bytes // columns
        table = np.empty((count, columns), dtype=f"V{width}")
        for column in range(columns):
            start = header.size + (column * header.row_count + self.row) * width
            stream = self.streams[column]
            stream.seek(start)
            content = stream.read(count * width)
            if len(content) != count * width:
                expected = f"{header.data_bytes} bytes of {self.name} ({header})"
                found = f"the end at byte {start + len(content)}"
                raise MapFormatError(self.path, expected, found, f"byte {start}")
            table[:, column] = np.frombuffer(content, dtype=table.dtype)
        self.row += count
        return table.view(f"V{header.row_bytes}").reshape(count)

    def finish(self) -> None:
        """Read on past the last row, upon which an archive compares its checksum."""
        if self.streams:
            self.streams[-1].read(1)


def put_rows(
    file: BinaryIO, header: ArrayHeader, row_count: int, first: int, rows: NDArray[np.void]
) -> None:
    """Write rows, as `RowReader.read` gives them, to their places from row `first` on.

    The array will have `row_count` rows; its header is for the caller to write.
    """
    columns = header.column_count
    if header.row_bytes:
        start = len(header.encode(row_count))
        width = header.row_bytes // columns
        table = rows.view(f"V{width}").reshape(-1, columns)
        for column in range(columns):
            put_records(file, start + (column * row_count + first) * width, table[:, column])
