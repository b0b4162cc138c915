"""A simulation on disk: the map, the truth, the poses, the scans, and two maps to compare with."""

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import yaml

from pipeline.errors import ConfigurationError, OutputError
from pipeline.simulation.campus import simulate_scans
from pipeline.simulation.meshes.parameters import MeshParameters
from pipeline.simulation.meshes.simulate import mesh_scans
from pipeline.simulation.parameters import SimulationParameters
from pipeline.simulation.points import Points
from pipeline.simulation.products import point_cloud_file, truth_file, write_row
from pipeline.simulation.simulate import SimulatedScan
from tiling.output_file import create_file, writing_only_into

_STAGING = ".simulation-partial"
_SCAN_DIGITS = 6
_FILE_NAMES = {
    "map": "map.pcd",
    "truth": "truth.parquet",
    "poses": "poses.txt",
    "true_poses": "poses_true.txt",
    "times": "times.txt",
    "parameters": "simulation.yaml",
    "scans": "scans",
    "static_truth": "static_truth.pcd",
    "low_activity": "low_activity.pcd",
}


@dataclass(frozen=True, slots=True)
class SimulationFiles:
    """The files of a simulation.

    Attributes
    ----------
    map : Path
        The map with its ghosts: binary PCD of x, y, z, intensity, time and scan.
    truth : Path
        Parquet, one row a point in the map's order: `moving` (bool), `surface` (dictionary), and
        of scenes of meshes `known` (bool): whether `moving` can be told.
    poses, true_poses : Path
        Estimated and true poses, one scan a line: the 3x4 matrix from sensor to map, row by row
        (KITTI).
    times : Path
        When each scan began, in seconds, one a line (KITTI).
    parameters : Path
        YAML of the parameters, which make the same files again.
    scans : Path
        Folder of the scans in the sensor's frame, `000000.pcd` and so on, fields as in the map.
    static_truth : Path
        The map that the same drive would have given without anything that moves.
    low_activity : Path
        The map of another drive through the same scene, while hardly anybody was there.
    """

    map: Path
    truth: Path
    poses: Path
    true_poses: Path
    times: Path
    parameters: Path
    scans: Path
    static_truth: Path
    low_activity: Path

    @classmethod
    def in_folder(cls, folder: Path) -> "SimulationFiles":
        """Return the files' places in a folder."""
        return cls(**{name: folder / file for name, file in _FILE_NAMES.items()})

    def besides_map(self) -> tuple[Path, ...]:
        """Return every file but the map and the scans."""
        names = (name for name in _FILE_NAMES if name not in ("map", "scans"))
        return tuple(getattr(self, name) for name in names)


def write_simulation(
    parameters: SimulationParameters | MeshParameters,
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
            files = SimulationFiles.in_folder(staging)
            settings = parameters.model_dump(mode="json")
            text = yaml.safe_dump(settings, sort_keys=False)
            files.parameters.write_text(text, encoding="utf-8")
            _write_drive(parameters, files, map_only, advance)
            if not map_only:
                _write_low_activity(parameters, files)
    except OSError as error:
        raise OutputError(
            f"{folder}: expected a folder to write in, found {error.strerror or error}"
        ) from error
    return SimulationFiles.in_folder(folder)


def _scans(
    parameters: SimulationParameters | MeshParameters, static: bool
) -> Iterator[SimulatedScan]:
    if isinstance(parameters, MeshParameters):
        return mesh_scans(parameters, static=static)
    return simulate_scans(parameters)


class _Map:
    """A map and its truth: written as a stream, or at the end through the map's voxel filter."""

    def __init__(
        self,
        parameters: SimulationParameters | MeshParameters,
        *writers: Callable[[Points], None],
    ) -> None:
        self._voxel = parameters.voxel if isinstance(parameters, MeshParameters) else 0.0
        self._writers = writers
        self._waiting: list[Points] = []

    def append(self, points: Points) -> None:
        """Append the points of a scan."""
        if self._voxel:
            self._waiting.append(points)
        else:
            self._write(points)

    def finish(self) -> None:
        """Filter what waits, and write it."""
        if self._waiting:
            self._write(Points.joined(self._waiting).filtered(self._voxel))

    def _write(self, points: Points) -> None:
        for write in self._writers:
            write(points)


def _write_drive(
    parameters: SimulationParameters | MeshParameters,
    files: SimulationFiles,
    map_only: bool,
    advance: Callable[[int], None],
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
        maps = [_Map(parameters, cloud, truth)]
        if not map_only:
            files.scans.mkdir()
            maps.append(_Map(parameters, stack.enter_context(point_cloud_file(files.static_truth))))
        count = 0
        for scan in _scans(parameters, static=not map_only):
            returns = scan.returns
            count += len(returns)
            for kept, seen in zip(maps, (returns, scan.static_returns), strict=False):
                kept.append(seen)
            write_row(poses, scan.estimated_pose)
            write_row(true_poses, scan.true_pose)
            write_row(times, np.array(scan.start))
            if not map_only:
                path = files.scans / f"{scan.number:0{_SCAN_DIGITS}d}.pcd"
                with point_cloud_file(path) as append:
                    append(replace(returns, xyz=scan.in_sensor_frame()))
            advance(len(returns))
        for kept in maps:
            kept.finish()
        if not count:
            raise ConfigurationError(
                "simulate: expected something within the sensor's range, found nothing from "
                f"min_range {parameters.min_range:g} to max_range {parameters.max_range:g} m"
            )


def _write_low_activity(
    parameters: SimulationParameters | MeshParameters, files: SimulationFiles
) -> None:
    """Write the map of a drive while hardly anybody is there."""
    quiet = parameters.low_activity()
    with point_cloud_file(files.low_activity) as cloud:
        kept = _Map(quiet, cloud)
        for scan in _scans(quiet, static=False):
            kept.append(scan.returns)
        kept.finish()


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
        _remove_earlier(SimulationFiles.in_folder(folder))
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
    files = SimulationFiles.in_folder(folder)
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
    return isinstance(written, dict) and {"scene", "seed"} <= written.keys()


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
