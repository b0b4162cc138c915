"""What is known of points from afar: rows of numbers by the cell of a lattice.

A lattice is anchored at the origin of the coordinates, so a point falls into the same cell whatever
else is in the map, and the rows of a map are those of its parts. So whoever holds a part of a map
can decide about its own points by the summaries of the parts around, without their points.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import numpy.typing as npt

__all__ = ["Summary"]


@dataclass(frozen=True)
class Summary:
    """Rows of numbers, each of one cell; a cell may have several rows, which keep their order."""

    cells: npt.NDArray[Any]
    """(n, 2) or (n, 3): cell (i, j, ...) holds the points with i <= x / side < i + 1, and so on."""
    values: npt.NDArray[Any]
    """(n, C)"""

    def __len__(self) -> int:
        return len(self.cells)

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Return the rows of some parts of a map, at least one, one part after the other."""
        return cls(
            np.concatenate([part.cells for part in parts]),
            np.concatenate([part.values for part in parts]),
        )

    def select(self, chosen: npt.NDArray[np.bool_]) -> Self:
        """Return some of the rows."""
        return type(self)(self.cells[chosen], self.values[chosen])

    def within(self, low: npt.NDArray[Any], high: npt.NDArray[Any]) -> Self:
        """Return the rows of cells with low <= (i, j) <= high; both are (2,) arrays."""
        flat = self.cells[:, :2]
        return self.select(np.asarray(((flat >= low) & (flat <= high)).all(axis=1)))

    def to_arrays(self, name: str) -> dict[str, npt.NDArray[Any]]:
        """Return the rows as arrays for a file that hands them on, integers in few bytes."""
        return dict(zip(self.names(name), map(_narrowed, (self.cells, self.values)), strict=True))

    @staticmethod
    def names(name: str) -> tuple[str, str]:
        """Return the names of these arrays."""
        return f"{name}_cells", f"{name}_values"


def _narrowed(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return integers as 32 bits, if these hold them."""
    limits = np.iinfo(np.int32)
    if array.dtype.kind != "i" or not len(array):
        return array
    fits = limits.min <= array.min() and array.max() <= limits.max
    return array.astype(np.int32) if fits else array
