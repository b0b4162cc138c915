"""What is true of each point of the original map: it is static, or moved, or nobody said."""

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from pipeline.errors import ConfigurationError, EvaluationError
from tiling.collection import MapCollection
from tiling.formats import field_values
from tiling.formats.parquet_tables import open_parquet
from tiling.formats.points import DEFAULT_BATCH, coordinate_names

MOVING_COLUMN = "moving"
"""The column of `truth.parquet`, as `simulate` writes it."""

_CLASS_BITS = 0xFFFF
"""SemanticKITTI keeps the class in the lower half of its 32 bits, the instance in the upper."""

_RANGE = re.compile(r"(-?\d+)(?:-(-?\d+))?")


class Truth(IntEnum):
    """What is true of a point."""

    STATIC = 0
    DYNAMIC = 1
    UNKNOWN = 2
    """Not labelled, or without finite coordinates: counts nowhere."""


Labels = NDArray[np.int8]
"""A `Truth` for each of some points."""


@dataclass(frozen=True, slots=True)
class RowValues:
    """Values of all rows of a map, which can be gone through several times."""

    read: Callable[[], Iterable[NDArray[Any]]]
    """Begins a pass: returns arrays that together are the values of all rows, in order."""

    @classmethod
    def of(cls, values: NDArray[Any]) -> "RowValues":
        """Return values that are in memory, (N,)."""
        return cls(lambda: [values])

    def __iter__(self) -> Iterator[NDArray[Any]]:
        return iter(self.read())


class RowReader:
    """One pass through the values of a map of this name, as many rows at a time as asked for."""

    def __init__(self, values: RowValues, name: str) -> None:
        self._arrays = iter(values)
        self._left: NDArray[Any] = np.empty(0)
        self._name = name

    def take(self, count: int) -> NDArray[Any]:
        """Return the values of the next rows, (count,), or raise an `EvaluationError`."""
        while len(self._left) < count:
            array = next(self._arrays, None)
            if array is None:
                few = count - len(self._left)
                raise EvaluationError(
                    f"{self._name}: expected a value of every row, found {few:,} too few"
                )
            self._left = np.concatenate([self._left, array]) if len(self._left) else array
        taken, self._left = self._left[:count], self._left[count:]
        return taken


def parse_values(option: str, text: str) -> tuple[range, ...]:
    """Read label values such as `2`, `252-259` or `0,1,252-259`; errors name the `option`."""
    ranges = []
    for part in text.split(",") if text else []:
        match = _RANGE.fullmatch(part.strip())
        if match is None:
            raise ConfigurationError(
                f"{option} {text}: expected whole numbers and ranges such as 2 or 252-259, "
                f"found {part.strip()!r}"
            )
        first, last = int(match[1]), int(match[2] or match[1])
        if last < first:
            raise ConfigurationError(f"{option} {text}: {part.strip()} runs backwards")
        ranges.append(range(first, last + 1))
    return tuple(ranges)


def to_truth(
    values: NDArray[np.generic], dynamic: Sequence[range], unlabelled: Sequence[range]
) -> Labels:
    """Turn label values into what is true of the points.

    Parameters
    ----------
    values : (n,) array of numbers or booleans
        Of a number above 65535 the lower 16 bits are the class (SemanticKITTI).
    dynamic, unlabelled : sequence of range
        Values of points that moved, and of points that nobody labelled; all others are static.
        A value that is not a number, or not whole, is unlabelled.

    Returns
    -------
    (n,) int8 array
        Of `Truth`.
    """
    numbers = values.astype(np.float64)
    whole = np.isfinite(numbers) & (np.abs(numbers) < 2**53) & (numbers == np.floor(numbers))
    classes = np.where(whole, numbers, 0).astype(np.int64)
    classes = np.where(classes > _CLASS_BITS, classes & _CLASS_BITS, classes)
    labels = np.full(len(values), Truth.STATIC, dtype=np.int8)
    labels[_within(classes, dynamic)] = Truth.DYNAMIC
    labels[_within(classes, unlabelled) | ~whole] = Truth.UNKNOWN
    return labels


def is_label_table(path: Path) -> bool:
    """Whether a file is Parquet without columns x, y and z: labels, and not a map."""
    if path.suffix.lower() != ".parquet" or not path.is_file():
        return False
    try:
        return coordinate_names(_columns(path)) is None
    except (pa.ArrowException, OSError):
        return False  # the reader of maps says what is wrong with it


def read_label_table(
    path: Path, column: str | None, dynamic: Sequence[range], unlabelled: Sequence[range]
) -> RowValues:
    """Return the labels of a table of one row a point, such as the `truth.parquet` of `simulate`.

    The column, of numbers or booleans, is `moving` by default; `to_truth` says what they mean.
    """
    column = column or MOVING_COLUMN
    names = _columns(path)
    if column not in names:
        raise EvaluationError(
            f"{path}: expected a column {column!r} (--labels), found {', '.join(names)}"
        )
    labels = RowValues(
        lambda: (to_truth(each, dynamic, unlabelled) for each in _table_values(path, column))
    )
    next(iter(labels), None)  # so that what is wrong with the column is said now
    return labels


def _columns(path: Path) -> list[str]:
    with open_parquet(path) as file:
        return list(file.schema_arrow.names)


def _table_values(path: Path, column: str) -> Iterator[NDArray[np.generic]]:
    with open_parquet(path) as file:
        for batch in file.iter_batches(DEFAULT_BATCH, columns=[column], use_threads=False):
            values = batch.column(0).to_numpy(zero_copy_only=False)
            if values.dtype.kind not in "biuf":
                found = "missing values" if batch.column(0).null_count else f"{values.dtype}"
                raise EvaluationError(f"{path}: expected numbers in {column!r}, found {found}")
            yield values


def read_labels_of_map(
    collection: MapCollection, field: str, dynamic: Sequence[range], unlabelled: Sequence[range]
) -> RowValues:
    """Return the labels that a map carries in one of its fields, which holds numbers."""
    for path in collection.paths:
        next(field_values(path, field), None)  # so that a field that is missing is named now
    return RowValues(
        lambda: (
            to_truth(values, dynamic, unlabelled)
            for path in collection.paths
            for values in field_values(path, field)
        )
    )


def _within(classes: NDArray[np.int64], ranges: Sequence[range]) -> NDArray[np.bool_]:
    inside = np.zeros(len(classes), dtype=np.bool_)
    for each in ranges:
        inside |= (classes >= each.start) & (classes < each.stop)
    return inside
