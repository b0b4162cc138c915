"""Records with further values behind their own."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tiling.formats.points import Field

if TYPE_CHECKING:
    from tiling.formats.text_rows import TextRows  # compiled: takes long to import


def longer_records(
    records: NDArray[Any],
    fields: Sequence[Field],
    values: Sequence[NDArray[Any]],
    byte_order: str = "<",
) -> NDArray[Any]:
    """Put values, packed in the file's byte order, behind records that are packed bytes."""
    tail = packed(fields, values, byte_order)
    if records.dtype != object:
        return joined(records, tail)
    longer = np.empty(len(tail), dtype=object)  # records of no fixed size, as bytes
    longer[:] = [head + more.tobytes() for head, more in zip(records, tail, strict=True)]
    return longer


def longer_rows(
    rows: "TextRows",
    fields: Sequence[Field],
    values: Sequence[NDArray[Any]],
    separator: bytes = b" ",
) -> "TextRows":
    """Put values on the lines of text, in as many digits as tell them from others."""
    columns = [
        column.astype(field.dtype).tolist() for field, column in zip(fields, values, strict=True)
    ]
    words = [
        separator.join(repr(value).encode() for value in row) for row in zip(*columns, strict=True)
    ]
    return rows.with_words(words, separator)


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
    rows = np.hstack([bytes_of(head), bytes_of(tail)])
    return rows.view(f"V{rows.shape[1]}")[:, 0]


def bytes_of(records: NDArray[Any]) -> NDArray[np.uint8]:
    """Return the bytes of records, (n, size)."""
    size = records.dtype.itemsize
    return np.ascontiguousarray(records).view(np.uint8).reshape(len(records), size)
