"""Files that are written as streams: point clouds, the truth about each point, and poses.

What waits to be written is bounded; the number of points goes into the header at the end.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from pipeline.simulation.points import Points
from pipeline.simulation.shapes import Surface
from tiling.output_file import create_file

POINT = np.dtype(
    [
        ("x", "<f4"),
        ("y", "<f4"),
        ("z", "<f4"),
        ("intensity", "<f4"),
        ("time", "<f8"),
        ("scan", "<u4"),
    ]
)
"""A point in every file, in metres and seconds."""

POINTS_IN_MEMORY = 250_000
"""Points whose truth is gathered before it is written."""

_HEADER_SIZE = 384  # bytes, filled up in a comment, so that the count can be written at the end


@contextmanager
def point_cloud_file(path: Path) -> Iterator[Callable[[Points], None]]:
    """Write a binary PCD 0.7 file (the Point Cloud Library's format) as a stream.

    Yields
    ------
    callable
        Appends points.
    """
    count = 0

    def append(points: Points) -> None:
        nonlocal count
        records = np.empty(len(points), dtype=POINT)
        records["x"], records["y"], records["z"] = points.xyz.T
        for name in ("intensity", "time", "scan"):
            records[name] = getattr(points, name)
        file.write(records.data)
        count += len(points)

    with create_file(path) as file:
        file.write(_pcd_header(0))
        yield append
        file.seek(0)
        file.write(_pcd_header(count))


@contextmanager
def truth_file(path: Path, *, known: bool) -> Iterator[Callable[[Points], None]]:
    """Write Parquet, one row a point, as a stream: `moving` (bool) and `surface` (dictionary).

    Parameters
    ----------
    known : bool
        Write `known` (bool), too: whether `moving` can be told.

    Yields
    ------
    callable
        Appends what is true of points.
    """
    columns = [("moving", pa.bool_()), ("surface", pa.dictionary(pa.uint8(), pa.string()))]
    schema = pa.schema([*columns, ("known", pa.bool_())] if known else columns)
    titles = pa.array([surface.title for surface in Surface])
    waiting: list[Points] = []

    def append(points: Points) -> None:
        waiting.append(points)
        if sum(map(len, waiting)) >= POINTS_IN_MEMORY:
            flush()

    def flush() -> None:
        if not sum(map(len, waiting)):
            return
        points = Points.joined(waiting)
        surface = pa.DictionaryArray.from_arrays(pa.array(points.surface), titles)
        values = [pa.array(points.moving), surface, pa.array(points.known)]
        writer.write_table(pa.Table.from_arrays(values[: len(schema)], schema=schema))
        waiting.clear()

    with create_file(path) as file, pq.ParquetWriter(file, schema) as writer:
        yield append
        flush()


def write_row(file: BinaryIO, values: NDArray[np.float64]) -> None:
    """Write numbers in a line, as the KITTI odometry benchmark has poses and times."""
    np.savetxt(file, np.reshape(values, (1, -1)), "%.9f")


def _pcd_header(points: int) -> bytes:
    """Return the header of a file of so many points, always of the same size."""
    columns = [POINT[name] for name in POINT.names or ()]
    lines = (
        "VERSION 0.7",
        "FIELDS " + " ".join(POINT.names or ()),
        "SIZE " + " ".join(str(column.itemsize) for column in columns),
        "TYPE " + " ".join(column.kind.upper() for column in columns),
        "COUNT " + " ".join("1" for _ in columns),
        f"WIDTH {points}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {points}",
        "DATA binary",
    )
    rest = "\n".join(lines) + "\n"
    comment = "# .PCD v0.7 - Point Cloud Data file format"
    return (comment.ljust(_HEADER_SIZE - len(rest) - 1) + "\n" + rest).encode("ascii")
