"""One value for every row of a map, read in the order of the rows, never all at once."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import EvaluationError


@dataclass(frozen=True, slots=True)
class RowValues:
    """Values of all rows of a map, which can be gone through several times.

    Attributes
    ----------
    read : callable
        Begins a pass: returns arrays that together are the values of all rows, in order.
    """

    read: Callable[[], Iterable[NDArray[Any]]]

    @classmethod
    def of(cls, values: NDArray[Any]) -> "RowValues":
        """Return values that are in memory, (N,)."""
        return cls(lambda: [values])

    def __iter__(self) -> Iterator[NDArray[Any]]:
        return iter(self.read())


class RowReader:
    """One pass through the values of a map, as many rows at a time as are asked for.

    Parameters
    ----------
    values : RowValues
    name : str
        What they are of, for the message where there are too few.
    """

    def __init__(self, values: RowValues, name: str) -> None:
        self._arrays = iter(values)
        self._left: NDArray[Any] = np.empty(0)
        self._name = name

    def take(self, count: int) -> NDArray[Any]:
        """Return the values of the next rows, (count,).

        Raises
        ------
        EvaluationError
            When there are no more.
        """
        parts, wanted = [self._left[:count]], count - len(self._left[:count])
        self._left = self._left[count:]
        while wanted:
            array = next(self._arrays, None)
            if array is None:
                raise EvaluationError(
                    f"{self._name}: expected a value of every row, found {wanted:,} too few"
                )
            parts.append(array[:wanted])
            self._left = array[wanted:]
            wanted -= len(parts[-1])
        # An empty first part has no type of its own.
        filled = [part for part in parts if len(part)] or parts[-1:]
        return filled[0] if len(filled) == 1 else np.concatenate(filled)
