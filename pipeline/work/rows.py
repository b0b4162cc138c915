"""One value for each row of the map, in a file: labels, densities, classes."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from tiling.output_file import create_file, sync, write_only

_AT_A_TIME = 1 << 22


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
