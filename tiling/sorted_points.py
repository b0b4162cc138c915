"""Points in a Parquet file whose row groups are compact: what is far away is not read."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from tiling.errors import ChunkError
from tiling.formats.parquet_tables import open_parquet, xyz_of
from tiling.formats.points import COORDINATES
from tiling.output_file import atomic_file, create_file

Near = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.bool_]]
"""Tells which of some boxes, seen from above, are near: of low (m, 2) and high (m, 2)."""

_GROUP = 4_096
"""Points of a row group, at most."""


def write_sorted_points(path: Path, xyz: NDArray[np.float64], rows: NDArray[np.int64]) -> None:
    """Write points, (n, 3), and their row numbers in the map, (n,).

    They are sorted into square blocks, of about one row group each. Parquet's own statistics say
    where a row group lies. The file appears whole or not at all.
    """
    order = _by_blocks(xyz[:, :2])
    columns = {name: xyz[:, axis].take(order) for axis, name in enumerate(COORDINATES)}
    with atomic_file(path) as temporary, create_file(temporary) as file:
        pq.write_table(
            pa.table({**columns, "row": rows.take(order)}),
            file,
            row_group_size=_GROUP,
            use_dictionary=False,
            write_statistics=list(COORDINATES[:2]),
            compression="lz4",
        )


def _by_blocks(flat: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return an order of points, (n, 2): strips along x of like size, and each of them along y."""
    strips = max(1, round(np.sqrt(len(flat) / _GROUP)))
    order = np.argsort(flat[:, 0], kind="stable")
    parts = np.array_split(order, strips)
    return np.concatenate([part[np.argsort(flat[part, 1], kind="stable")] for part in parts])


def read_near(path: Path, near: Near) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the points, (n, 3), and the row numbers, (n,), of all row groups that are near.

    Raises
    ------
    ChunkError
        When the file is missing or damaged.
    """
    try:
        with open_parquet(path) as file:
            low, high = _bounds(file.metadata)
            chosen = np.flatnonzero(near(low, high)).tolist() if len(low) else []
            table = file.read_row_groups(chosen, use_threads=False)
    except Exception as error:  # of pyarrow, which has many
        found = " ".join(str(error).split())[:200]
        raise ChunkError(path, "points sorted by blocks", found) from error
    return xyz_of(table), table.column("row").to_numpy()


def _bounds(metadata: pq.FileMetaData) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the boxes of the row groups seen from above, low (m, 2) and high (m, 2)."""
    filled = range(metadata.num_row_groups if metadata.num_rows else 0)
    found = [
        [metadata.row_group(number).column(axis).statistics for axis in range(2)]
        for number in filled
    ]
    low = [[each.min for each in of_group] for of_group in found]
    high = [[each.max for each in of_group] for of_group in found]
    return np.reshape(low, (-1, 2)), np.reshape(high, (-1, 2))
