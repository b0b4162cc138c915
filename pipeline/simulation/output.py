"""A simulation on disk: the map, the truth, the poses, the scans, and two maps to compare with."""

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import yaml

from pipeline.errors import OutputError
from pipeline.simulation.meshes.parameters import MeshParameters
from pipeline.simulation.meshes.simulate import mesh_scans
from pipeline.simulation.parameters import SimulationParameters, nothing_seen
from pipeline.simulation.scans import SimulatedScan, simulate_scans
from pipeline.simulation.scene import Surface
from pipeline.simulation.tables import Points
from tiling.output_file import create_file, writing_only_into

POINT = np.dtype([*((name, "<f4") for name in ("x", "y", "z", "intensity")),
                  ("time", "<f8"), ("scan", "<u4")])  # fmt: skip
"""A point in every file, in metres and seconds."""

Parameters: TypeAlias = SimulationParameters | MeshParameters

_PCD_FIELDS = """\
VERSION 0.7
FIELDS x y z intensity time scan
SIZE 4 4 4 4 8 4
TYPE F F F F F U
COUNT 1 1 1 1 1 1
WIDTH {points}
HEIGHT 1
VIEWPOINT 0 0 0 1 0 0 0
POINTS {points}
DATA binary
"""

POINTS_IN_MEMORY = 250_000  # points whose truth is gathered before it is written

_HEADER_SIZE = 384  # bytes, filled up in a comment, so that the count can be written at the end


@contextmanager
def point_cloud_file(path: Path) -> Iterator[Callable[[Points], None]]:
    """Write a binary PCD 0.7 file (the Point Cloud Library's format) by what appends points."""
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
    """Write Parquet by what appends points, a row each: `moving` (bool), `surface` (dictionary).

    With `known`, a third column (bool) tells whether `moving` can be told.
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
        points = Points.joined(waiting)
        surface = pa.DictionaryArray.from_arrays(pa.array(points.surface), titles)
        values = [pa.array(points.moving), surface, pa.array(points.known)]
        writer.write_table(pa.Table.from_arrays(values[: len(schema)], schema=schema))
        waiting.clear()

    with create_file(path) as file, pq.ParquetWriter(file, schema) as writer:
        yield append
        if any(map(len, waiting)):
            flush()


def _pcd_header(points: int) -> bytes:
    """Return the header of a file of so many points, always of the same size."""
    rest = _PCD_FIELDS.format(points=points)
    comment = "# .PCD v0.7 - Point Cloud Data file format"
    return (comment.ljust(_HEADER_SIZE - len(rest) - 1) + "\n" + rest).encode("ascii")


_STAGING = ".simulation-partial"
_SCAN_DIGITS = 6


class SimulationFiles:
    """The files of a simulation in a folder."""

    def __init__(self, folder: Path) -> None:
        # The map with its ghosts: binary PCD of x, y, z, intensity, time and scan.
        self.map = folder / "map.pcd"
        # A row a point in the map's order: `moving` (bool), `surface` (dictionary), and of scenes
        # of meshes `known` (bool): whether `moving` can be told.
        self.truth = folder / "truth.parquet"
        # One scan a line (KITTI): the 3x4 matrix from sensor to map, row by row; and when it began.
        self.poses, self.true_poses = folder / "poses.txt", folder / "poses_true.txt"
        self.times = folder / "times.txt"
        self.parameters = folder / "simulation.yaml"  # which make the same files again
        self.scans = folder / "scans"  # 000000.pcd and so on, in the sensor's frame, as in the map
        # The map that the same drive would have given without anything that moves, and that of
        # another drive through the same scene, while hardly anybody was there.
        self.static_truth = folder / "static_truth.pcd"
        self.low_activity = folder / "low_activity.pcd"

    def besides_map(self) -> list[Path]:
        """Return every file but the map and the scans."""
        return [file for file in vars(self).values() if file not in (self.map, self.scans)]


def write_simulation(
    parameters: Parameters,
    folder: Path,
    *,
    map_only: bool = False,
    advance: Callable[[int], None] = lambda points: None,
) -> SimulationFiles:
    """Simulate, and write into a folder as a stream, in memory that does not grow with the map.

    The map of a scene of meshes is held in memory if it has a voxel filter.

    Parameters
    ----------
    folder : Path
        Made if need be. What an earlier simulation left in it is replaced.
    map_only : bool, optional
        Leave out the scans, the static truth and the low-activity map.
    advance : callable, optional
        Told of the points of the map as they are made.

    Returns
    -------
    SimulationFiles
        All appear when all are complete, the map last.

    Raises
    ------
    OutputError
        When the folder cannot be made or written.
    ConfigurationError
        When the parameters leave the sensor nothing to see.
    MissingPackageError
        When a scene of meshes is wanted, and Open3D is not installed.
    """
    folder = Path(folder)
    try:
        with _staged(folder) as staging:
            files = SimulationFiles(staging)
            text = yaml.safe_dump(parameters.model_dump(mode="json"), sort_keys=False)
            files.parameters.write_text(text, encoding="utf-8")
            _write_drive(parameters, files, map_only, advance)
            if not map_only:
                quiet = parameters.low_activity()
                with point_cloud_file(files.low_activity) as cloud, _map_of(quiet, cloud) as append:
                    for scan in _scans(quiet, static=False):
                        append(scan.returns)
    except OSError as error:
        found = "a file" if folder.is_file() else error.strerror or error
        raise OutputError(f"{folder}: expected a folder to write in, found {found}") from error
    return SimulationFiles(folder)


def _scans(parameters: Parameters, static: bool) -> Iterator[SimulatedScan]:
    if isinstance(parameters, MeshParameters):
        return mesh_scans(parameters, static=static)
    return simulate_scans(parameters)


@contextmanager
def _map_of(
    parameters: Parameters, *writers: Callable[[Points], None]
) -> Iterator[Callable[[Points], None]]:
    """Give what appends a scan to a map: a stream, or at the end through the map's voxel filter."""
    voxel = parameters.voxel if isinstance(parameters, MeshParameters) else 0.0
    waiting: list[Points] = []

    def write(points: Points) -> None:
        for each in writers:
            each(points)

    yield waiting.append if voxel else write
    if waiting:
        write(Points.joined(waiting).filtered(voxel))


def _write_drive(
    parameters: Parameters, files: SimulationFiles, map_only: bool, advance: Callable[[int], None]
) -> None:
    """Write all that comes from the drive itself."""
    known = isinstance(parameters, MeshParameters)
    with ExitStack() as stack:
        cloud = stack.enter_context(point_cloud_file(files.map))
        truth = stack.enter_context(truth_file(files.truth, known=known))
        poses, true_poses, times = (
            stack.enter_context(create_file(path))
            for path in (files.poses, files.true_poses, files.times)
        )
        maps = [stack.enter_context(_map_of(parameters, cloud, truth))]
        if not map_only:
            files.scans.mkdir()
            static = stack.enter_context(point_cloud_file(files.static_truth))
            maps.append(stack.enter_context(_map_of(parameters, static)))
        count = 0
        for scan in _scans(parameters, static=not map_only):
            returns = scan.returns
            count += len(returns)
            for append_to_map, seen in zip(maps, (returns, scan.static_returns), strict=False):
                append_to_map(seen)
            # A line a scan, as the KITTI odometry benchmark has poses and times.
            np.savetxt(poses, scan.estimated_pose.reshape(1, -1), "%.9f")
            np.savetxt(true_poses, scan.true_pose.reshape(1, -1), "%.9f")
            np.savetxt(times, [scan.start], "%.9f")
            if not map_only:
                path = files.scans / f"{scan.number:0{_SCAN_DIGITS}d}.pcd"
                with point_cloud_file(path) as append:
                    append(replace(returns, xyz=scan.in_sensor_frame()))
            advance(len(returns))
        if not count:
            raise nothing_seen(parameters.min_range, parameters.max_range)


@contextmanager
def _staged(folder: Path) -> Iterator[Path]:
    """Give an empty folder to write in, whose files replace those of an earlier simulation."""
    staging = folder / _STAGING
    _refuse_to_replace(folder)
    made_here = not folder.exists()
    shutil.rmtree(staging, ignore_errors=True)
    staging.mkdir(parents=True)
    try:
        with writing_only_into(staging):
            yield staging
        _refuse_to_replace(folder)
        _remove_earlier(SimulationFiles(folder))
        written = [path for path in sorted(staging.rglob("*")) if path.is_file()]
        turn = {"simulation.yaml": 0, "map.pcd": 2}
        for path in sorted(written, key=lambda path: turn.get(path.name, 1)):
            place = folder / path.relative_to(staging)
            place.parent.mkdir(exist_ok=True)
            path.replace(place)
    finally:
        shutil.rmtree(staging, ignore_errors=True)
        if made_here and not any(folder.iterdir()):
            folder.rmdir()


def _refuse_to_replace(folder: Path) -> None:
    """Refuse a folder with files of these names that no simulation wrote."""
    files = SimulationFiles(folder)
    for place in (folder / _STAGING, files.scans):
        if place.is_symlink():
            raise OutputError(f"{place}: expected a folder, found a link")
    if not _is_simulation(files.parameters):
        for file in (files.map, *files.besides_map(), files.scans):
            if os.path.lexists(file):
                raise OutputError(
                    f"{file}: there is something that no simulation wrote; choose another -o"
                )


def _is_simulation(parameters: Path) -> bool:
    """Tell whether this is what a simulation writes of its parameters, the first of its files."""
    try:
        written = yaml.safe_load(parameters.read_bytes())
    except (OSError, ValueError, yaml.YAMLError):
        return False
    # Scenes of boxes have a `scene`, those of meshes a `kind`.
    names = written.keys() if isinstance(written, dict) else set()
    return "seed" in names and not names.isdisjoint({"scene", "kind"})


def _remove_earlier(files: SimulationFiles) -> None:
    """Remove what an earlier simulation left, the map first and the parameters last."""
    files.map.unlink(missing_ok=True)
    for scan in files.scans.glob("[0-9]*.pcd"):
        if scan.stem.isdecimal() and len(scan.stem) >= _SCAN_DIGITS:
            scan.unlink()
    for file in files.besides_map():
        if file != files.parameters:
            file.unlink(missing_ok=True)
    if files.scans.is_dir() and not any(files.scans.iterdir()):
        files.scans.rmdir()
