"""The files of a work folder: small ones with a checksum, arrays of a task, and values by row.

A small file is JSON, and tells by its checksum whether it is damaged. A file of arrays begins with
a line of JSON, the bytes of each by its name; they follow as `.npy` files, one behind the other,
whose numbers are compressed (Zstandard) where that makes them fewer bytes. They are read back one
by one: NumPy's own archive computes a checksum at each reading and writing, and its compression
takes ten times as long.
"""

import json
import math
import os
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, BinaryIO, Literal, NamedTuple

import numpy as np
import numpy.lib.format as npy
import pyarrow as pa
from numpy.typing import DTypeLike, NDArray

from pipeline.errors import WorkError
from tiling.output_file import atomic_file, create_file, sync, write_only

GO_ON = "the same command makes it again, and goes on"
"""What to do about work that is damaged."""

_HEAD = b'{"checksum": "%08x", "content": '
_HEAD_SIZE = len(_HEAD % 0)
_TAIL = b"}"

_ALIGNMENT = 64
"""Bytes: each array begins at a multiple."""

_AT_A_TIME = 1 << 22

_CODEC = pa.Codec("zstd", 1)


def write_sealed(path: Path, values: Mapping[str, Any]) -> None:
    """Write values to a file that appears whole or not at all."""
    content = json.dumps(values).encode()
    with atomic_file(path) as temporary:
        temporary.write_bytes(_HEAD % zlib.crc32(content) + content + _TAIL)


def read_sealed(path: Path) -> dict[str, Any]:
    """Read what `write_sealed` wrote.

    Raises
    ------
    WorkError
        When the file is not there, or not as it was written.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise WorkError(f"{path}: expected a file of a run's work, found {reason}") from error
    content = data[_HEAD_SIZE : -len(_TAIL)]
    if data != _HEAD % zlib.crc32(content) + content + _TAIL:
        raise WorkError(f"{path}: expected a file of a run's work, found a damaged one; {GO_ON}")
    values: dict[str, Any] = json.loads(content)
    return values


def read_if_whole(path: Path) -> dict[str, Any] | None:
    """Read what `write_sealed` wrote; None where it is not there, or not as it was written."""
    try:
        return read_sealed(path)
    except WorkError:
        return None


def write_arrays(
    path: Path,
    arrays: Mapping[str, NDArray[Any]],
    to_map: Mapping[str, NDArray[Any]] = MappingProxyType({}),
) -> None:
    """Write arrays of fixed-size types, in any shape, by their names.

    What is to be mapped is not compressed. The others are kept by columns: tables compress best so.
    """
    contents = {name: _compressed(np.ascontiguousarray(array.T)) for name, array in arrays.items()}
    contents |= {name: np.ascontiguousarray(array).data for name, array in to_map.items()}
    with path.open("wb") as stream:
        sizes = {name: content.nbytes for name, content in contents.items()}
        stream.write(json.dumps(sizes).encode() + b"\n")
        for name, array in {**arrays, **to_map}.items():
            stream.seek(_padded(stream.tell()))
            described = npy.header_data_from_array_1_0(array) | {"fortran_order": name in arrays}
            npy.write_array_header_1_0(stream, described)
            stream.write(contents.pop(name))


def _compressed(array: NDArray[Any]) -> memoryview:
    """Return the bytes of an array in the order of C, compressed where that makes them fewer."""
    fewer = memoryview(_CODEC.compress(array))
    return fewer if fewer.nbytes < array.nbytes else array.data


def read_arrays(path: Path, *names: str) -> list[NDArray[Any]]:
    """Read some of a file's arrays.

    Raises
    ------
    WorkError
        When the file is shorter than it says, or has no such array.
    """
    with path.open("rb") as stream:
        return [_read(path, stream, place) for place in _places(path, stream, names)]


def map_array(path: Path, name: str) -> NDArray[Any]:
    """Return one of a file's arrays without reading it: the system reads what is looked at.

    Raises
    ------
    WorkError
        When the file is shorter than it says, or has no such array.
    """
    with path.open("rb") as stream:
        (place,) = _places(path, stream, (name,))
        if place.is_compressed or not place.size:  # nothing cannot be mapped
            return _read(path, stream, place)
        # Not "r": compiled code would be compiled once more for arrays that are read only.
        mapped = np.memmap(stream, place.kind, "c", place.start, place.shape, place.order)
        return np.asarray(mapped)


class _Place(NamedTuple):
    """Where an array is in a file: first byte, bytes there, and what they are."""

    start: int
    size: int
    kind: np.dtype[Any]
    shape: tuple[int, ...]
    order: Literal["C", "F"]

    @property
    def full_size(self) -> int:
        return self.kind.itemsize * math.prod(self.shape)

    @property
    def is_compressed(self) -> bool:
        return self.size < self.full_size


def _places(path: Path, stream: BinaryIO, names: Sequence[str]) -> list[_Place]:
    whole = os.fstat(stream.fileno()).st_size
    places: dict[str, _Place] = {}
    try:
        for name, size in json.loads(stream.readline()).items():
            stream.seek(_padded(stream.tell()))
            npy.read_magic(stream)
            shape, by_columns, kind = npy.read_array_header_1_0(stream)
            place = _Place(stream.tell(), size, kind, shape, "F" if by_columns else "C")
            end = stream.seek(size, os.SEEK_CUR)
            if kind.hasobject or min(shape, default=0) < 0 or not 0 <= size <= place.full_size:
                raise ValueError("expected an array of numbers")
            if end > whole:
                raise ValueError("expected an array that the file holds whole")
            places[name] = place
        return [places[name] for name in names]
    except (
        ValueError,
        KeyError,
        TypeError,
        AttributeError,
        ArithmeticError,
        RecursionError,
        OSError,
    ):
        raise _damaged(path, *names) from None


def _read(path: Path, stream: BinaryIO, place: _Place) -> NDArray[Any]:
    """Return an array in the order of C, which may be written to."""
    stream.seek(place.start)
    if place.is_compressed:
        try:
            content = _CODEC.decompress(stream.read(place.size), place.full_size)
            values = np.frombuffer(content, place.kind)
        except (OSError, ValueError, OverflowError):
            raise _damaged(path) from None
    else:
        values = np.fromfile(stream, place.kind, math.prod(place.shape))
    return np.asarray(values.reshape(place.shape, order=place.order), order="C")


def _damaged(path: Path, *names: str) -> WorkError:
    wanted = f"the arrays {', '.join(names)}" if names else "arrays"
    return WorkError(f"{path}: expected {wanted}, found a damaged file; {GO_ON}")


def _padded(size: int) -> int:
    return -(-size // _ALIGNMENT) * _ALIGNMENT


def make_rows(path: Path, count: int, dtype: DTypeLike, value: float) -> None:
    """Make the file anew, with one value everywhere."""
    kind = np.dtype(dtype)
    temporary = path.with_suffix(".part")
    block = np.full(min(count, _AT_A_TIME), value, kind)
    temporary.unlink(missing_ok=True)
    with create_file(temporary) as stream:
        for start in range(0, count, _AT_A_TIME):
            stream.write(block[: count - start].data)
    temporary.replace(path)


def open_rows(path: Path, dtype: DTypeLike, mode: str = "r") -> NDArray[Any]:
    """Map the file into memory; `mode` is that of `numpy.memmap`."""
    if path.stat().st_size == 0:
        return np.empty(0, dtype)
    return np.memmap(path, dtype, mode=mode)  # type: ignore[call-overload, no-any-return]


def write_rows(path: Path, first_row: int, values: NDArray[Any]) -> None:
    """Write values of consecutive rows to the disk; other processes may write others."""
    with write_only(path) as stream:
        stream.seek(first_row * values.itemsize)
        stream.write(np.ascontiguousarray(values).data)
        stream.flush()
        sync(stream.fileno())
