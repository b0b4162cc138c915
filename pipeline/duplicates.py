"""How many points lie where an earlier one does, counted in bounded memory."""

from collections.abc import Iterator
from contextlib import ExitStack
from tempfile import TemporaryFile
from typing import BinaryIO, cast

import numpy as np
from numpy.typing import NDArray

_IN_MEMORY = 1 << 21
"""Points that are sorted at a time; of more, those alike go to the same temporary file."""

_MOST_FILES = 512
_POINT_BYTES = 24
_MULTIPLIERS = np.array([-7046029254386353131, -4417276706812531889, 1609587929392839161])

Points = NDArray[np.float64]


class DuplicateCounter:
    """Counts the points whose coordinates an earlier point has already.

    A context manager that removes its temporary files, which have no names and lie in `TMPDIR`.

    Parameters
    ----------
    point_count : int
        Points that there will be, at most.
    """

    def __init__(self, point_count: int) -> None:
        self._count = 0
        self._held: list[Points] = []
        self._stack = ExitStack()
        files = min(-(-point_count // _IN_MEMORY), _MOST_FILES)
        self._files: list[BinaryIO] = []
        if files > 1:
            for _ in range(files):
                file = cast(BinaryIO, TemporaryFile())  # noqa: SIM115 - closed by the stack
                self._files.append(self._stack.enter_context(file))

    def __enter__(self) -> "DuplicateCounter":
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def add(self, points: Points) -> None:
        """Take (n, 3) finite points into account."""
        # Adding zero makes one of the two zeros, which are equal and differ in their bits.
        points = points + 0.0
        if not self._files:
            self._held.append(points)
            return
        points = self._distinct(points)
        mixed = (points.view(np.int64) * _MULTIPLIERS).sum(axis=1)
        of_file = ((mixed ^ mixed >> 31) * _MULTIPLIERS[0] >> 33) % len(self._files)
        order = np.argsort(of_file, kind="stable")
        bounds = np.searchsorted(of_file[order], np.arange(len(self._files) + 1))
        points = points[order]
        for file, start, stop in zip(self._files, bounds, bounds[1:], strict=False):
            file.write(points[start:stop].tobytes())

    def total(self) -> int:
        """Return the number of duplicates; nothing can be added after that."""
        for points in self._parts():
            self._distinct(points)
        return self._count

    def _parts(self) -> Iterator[Points]:
        if not self._files:
            yield np.concatenate([*self._held, np.empty((0, 3))])
        for file in self._files:
            file.seek(0)
            yield np.frombuffer(file.read(), dtype=np.float64).reshape(-1, 3)

    def _distinct(self, points: Points) -> Points:
        """Return different points, and count the others."""
        order = np.lexsort((points[:, 2], points[:, 1], points[:, 0]))
        points = points[order]
        again = (points[1:] == points[:-1]).all(axis=1)
        self._count += int(np.count_nonzero(again))
        first = np.concatenate([np.ones(min(len(points), 1), bool), ~again])
        return np.asarray(points[first])
