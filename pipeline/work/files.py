"""The files of a work folder: small ones with a checksum, arrays of a task, and values by row.

A small file is JSON, and tells by its checksum whether it is damaged. A file of arrays begins with
a line of JSON, their names; they follow as `.npy` files, one behind the other. They are read back
one by one, as fast as the disk gives them: NumPy's own archive computes a checksum at each reading
and writing, and copies every array twice.
"""

import json
import math
import os
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO, Literal

import numpy as np
import numpy.lib.format as npy
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


def write_arrays(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write arrays of fixed-size types, in any shape, by their names."""
    with path.open("wb") as stream:
        stream.write(json.dumps([*arrays]).encode() + b"\n")
        for array in arrays.values():
            stream.seek(_padded(stream.tell()))
            npy.write_array(stream, array, (1, 0), allow_pickle=False)


def read_arrays(path: Path, *names: str) -> list[NDArray[Any]]:
    """Read some of a file's arrays.

    Raises
    ------
    WorkError
        When the file is shorter than it says, or has no such array.
    """
    with path.open("rb") as stream:
        return [_read(stream, *place) for place in _places(path, stream, names)]


def map_array(path: Path, name: str) -> NDArray[Any]:
    """Return one of a file's arrays without reading it: the system reads what is looked at.

    Raises
    ------
    WorkError
        When the file is shorter than it says, or has no such array.
    """
    with path.open("rb") as stream:
        ((start, kind, shape, order),) = _places(path, stream, (name,))
        if not math.prod(shape):
            return np.empty(shape, kind)  # nothing cannot be mapped
        # Not "r": compiled code would be compiled once more for arrays that are read only.
        return np.asarray(np.memmap(stream, kind, "c", start, shape, order))


_Order = Literal["C", "F"]
_Place = tuple[int, np.dtype[Any], tuple[int, ...], _Order]
"""First byte, type, shape and order of an array."""


def _places(path: Path, stream: BinaryIO, names: Sequence[str]) -> list[_Place]:
    size = os.fstat(stream.fileno()).st_size
    places: dict[str, _Place] = {}
    try:
        for name in json.loads(stream.readline()):
            stream.seek(_padded(stream.tell()))
            npy.read_magic(stream)
            shape, by_columns, kind = npy.read_array_header_1_0(stream)
            start = stream.tell()
            end = start + kind.itemsize * math.prod(shape)
            if kind.hasobject or min(shape, default=0) < 0 or end > size:
                raise ValueError("expected an array of numbers that the file holds whole")
            stream.seek(end)
            places[name] = start, kind, shape, "F" if by_columns else "C"
        return [places[name] for name in names]
    except (ValueError, KeyError, TypeError, RecursionError):
        wanted = ", ".join(names)
        raise WorkError(
            f"{path}: expected the arrays {wanted}, found a damaged file; {GO_ON}"
        ) from None


def _read(
    stream: BinaryIO, start: int, kind: np.dtype[Any], shape: tuple[int, ...], order: _Order
) -> NDArray[Any]:
    stream.seek(start)
    return np.fromfile(stream, kind, math.prod(shape)).reshape(shape, order=order)


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
