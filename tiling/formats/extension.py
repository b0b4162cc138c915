"""Maps like another, whose points have further fields behind their own.

An `ExtendedFormat` writes them, and extends points that the reader of the other map gives. What a
point had stays as it was stored; new values stand behind it, of the types that the format has.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tiling.formats.base import ExtendedFormat, MapReader
from tiling.formats.points import Field, PointBatch

if TYPE_CHECKING:
    from tiling.formats.text_rows import TextRows  # compiled: takes long to import


class ExtendedRecords(ExtendedFormat):
    """Records that are packed bytes: the values follow, packed, in the file's byte order."""

    def __init__(self, model: MapReader, fields: Sequence[Field], byte_order: str = "<") -> None:
        super().__init__(model, fields)
        self._byte_order = byte_order

    def extend(self, batch: PointBatch, values: Sequence[NDArray[Any]]) -> NDArray[Any]:
        """Return the records with the values; see `ExtendedFormat.extend`."""
        tail = packed(self.fields, values, self._byte_order)
        if batch.records.dtype == object:  # records of no fixed size, as bytes
            longer = np.empty(len(tail), dtype=object)
            longer[:] = [
                record + more
                for record, more in zip(batch.records, rows_of_bytes(tail), strict=True)
            ]
            return longer
        return joined(batch.records, tail)


class ExtendedText(ExtendedFormat):
    """Rows of text: the values follow on the line, in as many digits as tell them from others."""

    def __init__(self, model: MapReader, fields: Sequence[Field], separator: bytes = b" ") -> None:
        super().__init__(model, fields)
        self._separator = separator

    def extend(self, batch: PointBatch, values: Sequence[NDArray[Any]]) -> "TextRows":
        """Return the rows with the values; see `ExtendedFormat.extend`."""
        columns = [
            column.astype(field.dtype).tolist()
            for field, column in zip(self.fields, values, strict=True)
        ]
        words = [
            self._separator.join(repr(value).encode() for value in row)
            for row in zip(*columns, strict=True)
        ]
        return batch.records.with_words(words, self._separator)


def packed(
    fields: Sequence[Field], values: Sequence[NDArray[Any]], byte_order: str = "<"
) -> NDArray[Any]:
    """Pack values of some fields into records of their own, (n,)."""
    dtype = np.dtype([(field.name, byte_order + np.dtype(field.dtype).str[1:]) for field in fields])
    records = np.empty(len(values[0]), dtype=dtype)
    for field, column in zip(fields, values, strict=True):
        records[field.name] = column
    return records


def joined(head: NDArray[Any], tail: NDArray[Any]) -> NDArray[np.void]:
    """Put the bytes of each of some records before those of the record beside it, (n,)."""
    rows = np.empty((len(head), head.dtype.itemsize + tail.dtype.itemsize), dtype=np.uint8)
    rows[:, : head.dtype.itemsize] = bytes_of(head)
    rows[:, head.dtype.itemsize :] = bytes_of(tail)
    return rows.view(f"V{rows.shape[1]}")[:, 0]


def bytes_of(records: NDArray[Any]) -> NDArray[np.uint8]:
    """Return the bytes of records, (n, size)."""
    size = records.dtype.itemsize
    return np.ascontiguousarray(records).view(np.uint8).reshape(len(records), size)


def rows_of_bytes(records: NDArray[Any]) -> list[bytes]:
    """Return the bytes of each record."""
    return [record.tobytes() for record in records]
