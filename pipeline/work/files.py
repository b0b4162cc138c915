"""The files of a work folder: small ones with a checksum, arrays of a task, and values by row.

A small file is JSON, and tells by its checksum whether it is damaged. A file of arrays begins with
a line of JSON that says of each array its name, type, shape and place; the arrays follow as they
lie in memory, and are read back one by one, as fast as the disk gives them: NumPy's own archive
computes a checksum at each reading and writing, and copies every array twice.
"""

import json
import math
import os
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import DTypeLike, NDArray

from pipeline.errors import WorkError
from tiling.atomic import atomic_file
from tiling.output_file import create_file, sync, write_only

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
    described, size = [], 0
    for name, array in arrays.items():
        described.append((name, array.dtype.str, array.shape, size))
        size += _padded(array.nbytes)
    head = json.dumps(described).encode() + b"\n"
    head = head.rjust(_padded(len(head)))
    with path.open("wb") as stream:
        stream.write(head)
        for array in arrays.values():
            stream.write(np.ascontiguousarray(array).reshape(-1).data)
            stream.write(bytes(_padded(array.nbytes) - array.nbytes))


def read_arrays(path: Path, *names: str) -> list[NDArray[Any]]:
    """Read some of a file's arrays.

    Raises
    ------
    WorkError
        When the file is shorter than it says, or has no such array.
    """
    with path.open("rb") as stream:
        places = _places(path, stream, names)
        try:
            return [_read(stream, *place) for place in places]
        except (ValueError, OverflowError):
            raise _damaged(path, names) from None


def map_array(path: Path, name: str) -> NDArray[Any]:
    """Return one of a file's arrays without reading it: the system reads what is looked at.

    Raises
    ------
    WorkError
        When the file is shorter than it says, or has no such array.
    """
    with path.open("rb") as stream:
        ((start, kind, shape),) = _places(path, stream, (name,))
        if not math.prod(shape):
            return np.empty(shape, kind)  # nothing cannot be mapped
        try:
            # Not "r": compiled code would be compiled once more for arrays that are read only.
            return np.asarray(np.memmap(stream, kind, "c", start, tuple(shape)))
        except ValueError:
            raise _damaged(path, (name,)) from None


_Place = tuple[int, np.dtype[Any], list[int]]
"""First byte, type and shape of an array."""


def _places(path: Path, stream: BinaryIO, names: Sequence[str]) -> list[_Place]:
    head = stream.readline()
    try:
        described = {name: place for name, *place in json.loads(head)}
        places = [_place(len(head), *described[name]) for name in names]
    except (ValueError, KeyError, TypeError, RecursionError):
        raise _damaged(path, names) from None
    size = os.fstat(stream.fileno()).st_size
    if any(start + kind.itemsize * math.prod(shape) > size for start, kind, shape in places):
        raise _damaged(path, names)
    return places


def _place(head: int, kind: Any, shape: Any, start: Any) -> _Place:
    """Return where an array lies; raise a `ValueError` where no array of ours is so described."""
    if type(kind) is not str or np.dtype(kind).kind not in "biufc":  # no addresses of objects
        raise ValueError(f"expected the type of numbers, found {kind!r}")
    if type(shape) is not list or not all(type(each) is int for each in (start, *shape)):
        raise ValueError(f"expected integers, found {start!r}, {shape!r}")
    if min(start, *shape, 0) < 0:
        raise ValueError(f"expected no negative numbers, found {start}, {shape}")
    return head + start, np.dtype(kind), shape


def _damaged(path: Path, names: Sequence[str]) -> WorkError:
    wanted = ", ".join(names)
    return WorkError(f"{path}: expected the arrays {wanted}, found a damaged file; {GO_ON}")


def _read(stream: BinaryIO, start: int, kind: np.dtype[Any], shape: list[int]) -> NDArray[Any]:
    stream.seek(start)
    return np.fromfile(stream, kind, math.prod(shape)).reshape(shape)


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
