"""Named arrays in one file, which are read back one by one, as fast as the disk gives them.

A file begins with a line of JSON that says of each array its name, type, shape and place; the
arrays follow as they lie in memory. NumPy's own archive computes a checksum at each reading and
writing, and copies every array twice.
"""

import json
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import WorkError
from pipeline.tiles.sealed import GO_ON

_ALIGNMENT = 64
"""Bytes: each array begins at a multiple."""


def write_arrays(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write arrays of fixed-size types.

    Parameters
    ----------
    path : Path
    arrays : mapping of str to array
        In any shape.
    """
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
