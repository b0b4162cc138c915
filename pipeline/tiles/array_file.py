"""Named arrays in one file, which are read back one by one, as fast as the disk gives them.

A file begins with a line of JSON that says of each array its name, type, shape and place; the
arrays follow as they lie in memory. NumPy's own archive computes a checksum at each reading and
writing, and copies every array twice.
"""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import WorkError

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
        head = stream.readline()
        try:
            described = {name: place for name, *place in json.loads(head)}
            return [_read(stream, len(head), *described[name]) for name in names]
        except (ValueError, KeyError, TypeError):
            wanted = ", ".join(names)
            raise WorkError(
                f"{path}: expected the arrays {wanted}, found a damaged file; give --fresh"
            ) from None


def _read(stream: Any, start: int, kind: str, shape: list[int], place: int) -> NDArray[Any]:
    stream.seek(start + place)
    found = np.fromfile(stream, np.dtype(kind), math.prod(shape))
    return found.reshape(shape)


def _padded(size: int) -> int:
    return -(-size // _ALIGNMENT) * _ALIGNMENT
