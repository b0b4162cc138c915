"""Files that are written as streams: point clouds, the truth about each point, and poses.

What waits to be written is bounded; the number of points goes into the header at the end.
"""

from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from pipeline.simulation.points import Points
from pipeline.simulation.shapes import Surface
from pipeline.simulation.simulate import SimulatedScan
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


def point_records(points: Points) -> NDArray[np.void]:
    """Return points as files hold them."""
    records = np.empty(len(points), dtype=POINT)
    records["x"], records["y"], records["z"] = points.xyz.T
    for name in ("intensity", "time", "scan"):
        records[name] = getattr(points, name)
    return records


class PointCloudFile:
    """A binary PCD 0.7 file (the Point Cloud Library's format), written as a stream."""

    def __init__(self, path: Path) -> None:
        self._count = 0
        self._file = create_file(path)
        self._file.write(_pcd_header(0))

    def append(self, records: NDArray[np.void]) -> None:
        """Append points."""
        self._file.write(records.data)
        self._count += len(records)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        with self._file:
            if kind is None:
                self._file.seek(0)
                self._file.write(_pcd_header(self._count))


def write_point_cloud(path: Path, records: NDArray[np.void]) -> None:
    """Write a binary PCD file at once."""
    with create_file(path) as file:
        file.write(_pcd_header(len(records)))
        file.write(records.data)


class TruthFile:
    """Parquet, one row a point: `moving` (bool) and `surface` (dictionary), written as a stream.

    Parameters
    ----------
    path : Path
    known : bool, optional
        Write `known` (bool), too: whether `moving` can be told.
    """

    _TITLES = pa.array([surface.title for surface in Surface])

    def __init__(self, path: Path, *, known: bool = False) -> None:
        columns = [("moving", pa.bool_()), ("surface", pa.dictionary(pa.uint8(), pa.string()))]
        self._schema = pa.schema([*columns, ("known", pa.bool_())] if known else columns)
        self._known = known
        self._file = create_file(path)
        self._writer = pq.ParquetWriter(self._file, self._schema)
        self._waiting: list[Points] = []
        self._waiting_points = 0

    def append(self, returns: Points) -> None:
        """Append what is true of the points of a scan."""
        self._waiting.append(returns)
        self._waiting_points += len(returns)
        if self._waiting_points >= POINTS_IN_MEMORY:
            self._flush()

    def _flush(self) -> None:
        if not self._waiting_points:
            return
        surface = np.concatenate([returns.surface for returns in self._waiting])
        columns = [
            pa.array(np.concatenate([returns.moving for returns in self._waiting])),
            pa.DictionaryArray.from_arrays(pa.array(surface), self._TITLES),
        ]
        if self._known:
            columns.append(pa.array(np.concatenate([returns.known for returns in self._waiting])))
        self._writer.write_table(pa.Table.from_arrays(columns, schema=self._schema))
        self._waiting, self._waiting_points = [], 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        with self._file:
            if kind is None:
                self._flush()
            self._writer.close()


class PoseFiles:
    """Poses of the scans, as the KITTI odometry benchmark has them, written as streams.

    `poses.txt` (estimated) and `poses_true.txt`: one scan a line, the 3x4 matrix from the sensor's
    frame to the map's, row by row. `times.txt`: the start of each scan, in seconds.
    """

    def __init__(self, poses: Path, true_poses: Path, times: Path) -> None:
        self._files = [create_file(path) for path in (poses, true_poses, times)]

    def append(self, scan: SimulatedScan) -> None:
        """Append the poses of a scan."""
        rows = (scan.estimated_pose.ravel(), scan.true_pose.ravel(), np.array([scan.start]))
        for file, row in zip(self._files, rows, strict=True):
            file.write((" ".join(f"{value:.9f}" for value in row) + "\n").encode())

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: Any) -> None:
        for file in self._files:
            file.close()


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
