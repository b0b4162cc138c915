"""A digest of every record of some points, so that points of two files can be told to be the same.

Records are compared as the files store them, all fields to the last bit; rows of text without their
line ends, since the last row of a file may have none.
"""

from collections.abc import Iterable
from hashlib import blake2b
from typing import Any

import numpy as np
from numpy.typing import NDArray


def row_digests(records: Any) -> list[bytes]:
    """Return a digest of each record.

    Parameters
    ----------
    records : opaque
        As `PointBatch.records`, of any format.
    """
    return [blake2b(row, digest_size=16).digest() for row in _rows(records)]


def _rows(records: Any) -> Iterable[bytes]:
    """Return the bytes of each record."""
    if isinstance(records, np.ndarray):
        return _of_array(records)
    if hasattr(records, "starts"):  # rows of text
        text = records.text.tobytes()
        bounds = zip(records.starts.tolist(), records.stops.tolist(), strict=True)
        return (text[start:stop].rstrip() for start, stop in bounds)
    if hasattr(records, "scan"):
        return (b"%d " % records.scan + row for row in _of_array(records.rows))
    columns = [_exact(column).to_pylist() for column in records.columns]
    return (repr(row).encode("utf-8", "surrogatepass") for row in zip(*columns, strict=True))


def _of_array(records: NDArray[Any]) -> Iterable[bytes]:
    if records.dtype == object:
        return list(records)
    size = records.nbytes // max(len(records), 1)
    content = records.tobytes()
    return (content[at : at + size] for at in range(0, len(content), size or 1))


def _exact(column: Any) -> Any:
    """Return a column whose values Python has in full: its times have no nanoseconds."""
    import pyarrow as pa  # noqa: PLC0415 - heavy, and here for tables only

    if pa.types.is_temporal(column.type) and not pa.types.is_interval(column.type):
        wide = column.type.bit_width == 64
        return column.cast(pa.int64() if wide else pa.int32())
    return column
