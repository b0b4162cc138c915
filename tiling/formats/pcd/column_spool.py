"""A temporary file between points, one after the other, and columns, one after the other.

binary_compressed PCD files hold all values of the first field, then all of the second, and so on.
Through a file of that layout points can be had, and given, in batches.
"""

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from tempfile import TemporaryFile
from typing import Self

import numpy as np
from numpy.typing import NDArray

BLOCK = 1 << 20


class ColumnSpool:
    """Fixed-size records of points, kept on disk as columns.

    The file lies in the folder for temporary files (`TMPDIR`), has no name, and is gone when it
    is closed, or when the process ends for whatever reason. A context manager that closes it.

    Parameters
    ----------
    widths : sequence of int
        Bytes that each column takes in a record.
    point_count : int
        Points that the file is for.
    """

    def __init__(self, widths: Sequence[int], point_count: int) -> None:
        self._widths = tuple(widths)
        self._point_count = point_count
        with _blaming_its_folder():
            # Unbuffered, so that a full disk is met where it is written to.
            self._file = TemporaryFile(buffering=0)  # noqa: SIM115 - closed by `close`

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def append(self, data: NDArray[np.uint8]) -> None:
        """Write the next bytes of the columns, in the file's order."""
        self._write(data.tobytes())

    def blocks(self) -> Iterator[NDArray[np.uint8]]:
        """Yield the bytes of all columns, in the file's order."""
        self._file.seek(0)
        while block := self._file.read(BLOCK):
            yield np.frombuffer(block, dtype=np.uint8)

    def write_points(self, first_row: int, records: NDArray[np.void]) -> None:
        """Put the records of consecutive points into their columns."""
        rows = records.view(np.uint8).reshape(len(records), -1)
        start = column = 0
        for width in self._widths:
            self._file.seek(column + first_row * width)
            self._write(rows[:, start : start + width].tobytes())
            start += width
            column += width * self._point_count

    def read_points(self, first_row: int, count: int) -> NDArray[np.void]:
        """Gather the records of consecutive points from their columns."""
        rows = np.empty((count, sum(self._widths)), dtype=np.uint8)
        start = column = 0
        for width in self._widths:
            self._file.seek(column + first_row * width)
            values = np.frombuffer(self._file.read(count * width), dtype=np.uint8)
            rows[:, start : start + width] = values.reshape(count, width)
            start += width
            column += width * self._point_count
        return rows.view(f"V{rows.shape[1]}")[:, 0]

    def close(self) -> None:
        """Remove the file."""
        self._file.close()

    def _write(self, data: bytes) -> None:
        left = memoryview(data)
        with _blaming_its_folder():
            while left:
                left = left[self._file.write(left) :]


@contextmanager
def _blaming_its_folder() -> Iterator[None]:
    """Name the folder for temporary files in an error, as the file itself has no name."""
    try:
        yield
    except OSError as error:
        folder = tempfile.gettempdir()
        raise OSError(error.errno, error.strerror, f"{folder} (temporary files)") from error
