"""Distances on the disk, 8 bytes each."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

_AT_A_TIME = 100_000


class DistanceFile:
    """A file of distances, gone through in batches.

    Parameters
    ----------
    path : Path
        An earlier file of this name is replaced.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        path.write_bytes(b"")

    def append(self, distances: NDArray[np.float64]) -> None:
        """Put some more behind the others."""
        with self._path.open("ab") as stream:
            np.ascontiguousarray(distances, np.float64).tofile(stream)

    def __iter__(self) -> Iterator[NDArray[np.float64]]:
        with self._path.open("rb") as stream:
            while len(batch := np.fromfile(stream, np.float64, _AT_A_TIME)):
                yield batch

    def remove(self) -> None:
        """Remove the file."""
        self._path.unlink()
