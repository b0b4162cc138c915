"""Key frames: a folder of scans that together are a map, each with the pose of the sensor.

The layouts are those that SLAM programs and data sets have: `NNNNNN/cloud.pcd` beside `data`
(hdl_graph_slam), `Scans/` beside `optimized_poses.txt` or `poses.txt` (SC-LIO-SAM, Removert),
`velodyne/` beside `poses.txt` and `calib.txt` (KITTI, SemanticKITTI), and PCD files with the pose
in VIEWPOINT (`pcd/`, DynamicMap_Benchmark). What a scan's points are turned by is known from where
its file lies, so that any of the files may be named alone.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tiling.errors import MapFormatError
from tiling.formats import MapReader, open_map
from tiling.formats.points import only_finite

_SCAN_FOLDERS = ("velodyne", "Scans", "scans")
_POSE_FILES = ("optimized_poses.txt", "poses.txt")
_VIEWPOINT_FOLDER = "pcd"
_UNTOLD = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
"""What VIEWPOINT is where nobody sets it."""

_OPENED = 10
"""Scans that tell whether a folder is one of scans: a sensor may stand still at first."""

_NOT_A_ROTATION = 1e-2
"""Largest entry of R R^T - 1: poses are written with few digits."""

_FAR = 5.0
"""Metres from the origin at which a pose tells which frame the points are in."""

_LOOKED_AT = 20_000
"""Points of a scan."""

Matrices = NDArray[np.float64]
Frame = Literal["auto", "sensor", "map"]


@dataclass(frozen=True, slots=True, eq=False)
class ScanPoses:
    """Where the sensor was, and where it looked."""

    poses: Matrices
    """(n, 3, 4): from the sensor's frame to the map's, metres; in the order of time."""
    are_applied: bool = False
    """Whether the points are in the map's frame already."""
    are_of_files: bool = True
    """Whether each file of the map is one of the scans, or keeps some apart; else the map's points
    tell their scans."""
    times: NDArray[np.float64] | None = None
    """(n,): seconds, where they are told."""
    counts: NDArray[np.int64] | None = None
    """(n,): points of each scan, where files keep several apart."""

    def hashed(self, digest: str = "") -> str:
        """Return the hash of the poses and of a digest, in hexadecimal."""
        told = digest.encode() + bytes([self.are_applied]) + self.poses.astype("<f8").tobytes()
        told += b"" if self.times is None else self.times.astype("<f8").tobytes()
        return hashlib.sha256(told).hexdigest()

    def to_map(self, file: int, xyz: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return points of a file, (n, 3), in the map's frame."""
        if self.are_applied:
            return xyz
        # Term by term: a product of matrices may depend on how many points come at a time.
        x, y, z = xyz.T
        with np.errstate(all="ignore"):
            return np.stack([a * x + b * y + c * z + d for a, b, c, d in self.poses[file]], axis=1)


def scan_folder(folder: Path) -> list[Path] | None:
    """Return the scans of a folder in one of the layouts, in any order; None of another folder."""
    frames = [each / "cloud.pcd" for each in folder.iterdir() if each.name.isdigit()]
    frames = [each for each in frames if each.is_file()]
    if any(each.with_name("data").is_file() for each in frames):
        return frames
    for name in _SCAN_FOLDERS:
        if (folder / name).is_dir() and _pose_file(folder) is not None:
            return list((folder / name).iterdir())
    scans = sorted((folder / _VIEWPOINT_FOLDER).glob("*.pcd"))
    some = scans[:: max(len(scans) // _OPENED, 1)] if len(scans) > 1 else []
    told = {open_map(path).description.viewpoint for path in some}
    return scans if told - {None, _UNTOLD} else None


def find_poses(
    readers: Sequence[MapReader], given: Path | None = None, frame: Frame = "auto"
) -> ScanPoses | None:
    """Find the poses of a map's files; None where they are no scans.

    Parameters
    ----------
    given : Path, optional
        A file of poses, see `read_poses`, in the place of what lies beside the scans; or those of
        the scans that a map was made of, where its files are not these scans.
    frame : str
        That the points of files which are scans are in: the `sensor`'s, the `map`'s, or what their
        layout tells, `auto`.

    Raises
    ------
    MapFormatError
        When poses are missing, or are no poses.
    """
    found = _found_poses(readers, given)
    if found is None or frame == "auto" or not found.are_of_files or found.counts is not None:
        return found
    return replace(found, are_applied=frame == "map")


def _found_poses(readers: Sequence[MapReader], given: Path | None) -> ScanPoses | None:
    paths = [reader.description.path for reader in readers]
    parents = {path.parent for path in paths}
    parent = paths[0].parent
    if given is not None:
        poses, times = read_poses(given)
        if len(paths) != len(poses) and not all(path.stem.isdigit() for path in paths):
            return ScanPoses(poses, are_applied=True, are_of_files=False, times=times)
        return ScanPoses(_matched(paths, poses, given))
    framed = all(path.name == "cloud.pcd" and path.parent.name.isdigit() for path in paths)
    if framed and any(path.with_name("data").is_file() for path in paths):
        return ScanPoses(np.array([_estimate(path.parent / "data") for path in paths]))
    several = len(paths) > 1 or paths[0].stem.isdigit()
    if several and len(parents) == 1 and parent.name in _SCAN_FOLDERS:
        file = _pose_file(parent.parent)
        if file is not None:
            poses = _matched(paths, read_poses(file)[0], file)
            calibration = parent.parent / "calib.txt"
            is_kitti = parent.name == _SCAN_FOLDERS[0] and calibration.is_file()
            return ScanPoses(_of_scanner(poses, calibration) if is_kitti else poses)
    if len(paths) > 1 and all(path.suffix.lower() == ".bin" for path in paths):
        raise MapFormatError(parent, "poses of the scans beside them, or input.poses", "none")
    return _of_scans_apart(readers) or _of_viewpoints(readers)


def read_poses(path: Path) -> tuple[Matrices, NDArray[np.float64] | None]:
    """Read a file of one pose a line, from sensor to map, (n, 3, 4), and their times, if told.

    Lines have 12 numbers, the matrix row by row (KITTI), 13 with the time before them, or 8: time,
    position, and quaternion with w last (TUM).

    Raises
    ------
    MapFormatError
        When it holds anything else.
    """
    expected = "12 numbers a line (KITTI) or 8 (TUM)"
    try:
        lines = np.loadtxt(path, dtype=np.float64, ndmin=2)
    except OSError as error:
        raise MapFormatError(path, "a file of poses", (error.strerror or "none").lower()) from error
    except UnicodeDecodeError as error:
        raise MapFormatError(path, expected, "no text") from error
    except ValueError as error:
        raise MapFormatError(path, expected, str(error)) from error
    if lines.shape[1] == 8:
        poses = _of_quaternions(lines[:, 1:4], lines[:, [7, 4, 5, 6]])
    elif lines.shape[1] in (12, 13):
        poses = lines[:, -12:].reshape(-1, 3, 4)
    else:
        raise MapFormatError(path, expected, f"{len(lines)} lines of {lines.shape[1]}")
    times = None if lines.shape[1] == 12 else lines[:, 0]
    return _checked(poses, path), times


def _pose_file(folder: Path) -> Path | None:
    """Return the file of the poses of the scans in a folder, if there is one."""
    beside = [folder / name for name in _POSE_FILES]
    absolute = folder.absolute()
    beside.append(absolute.parent.parent / "poses" / f"{absolute.name}.txt")  # KITTI
    return next((path for path in beside if path.is_file()), None)


def _matched(paths: Sequence[Path], poses: Matrices, source: Path) -> Matrices:
    """Return the pose of each scan: in order, or by its number where there are others as well."""
    if len(paths) == len(poses):
        return poses
    numbers = [int(path.stem) if path.stem.isdigit() else len(poses) for path in paths]
    if max(numbers) >= len(poses):
        raise MapFormatError(source, f"a pose for each of {len(paths)} scans", f"{len(poses)}")
    return poses[numbers]


def _estimate(path: Path) -> Matrices:
    """Read the pose that hdl_graph_slam estimated, (3, 4)."""
    expected = "a line `estimate`, and four lines of four numbers"
    try:
        words = path.read_text(encoding="utf-8", errors="replace").split()
    except OSError as error:
        raise MapFormatError(path, "the data of a key frame", "none") from error
    try:
        start = words.index("estimate") + 1
        pose = np.array(words[start : start + 16], np.float64).reshape(1, 4, 4)
    except ValueError as error:
        raise MapFormatError(path, expected, "another text") from error
    return np.asarray(_checked(pose[:, :3], path)[0])


def _of_scanner(poses: Matrices, calibration: Path) -> Matrices:
    """Return poses of the scanner, from those of KITTI's camera: Tr^-1 P Tr."""
    text = calibration.read_text(encoding="utf-8", errors="replace")
    lines = [line.partition(":") for line in text.splitlines()]
    found = next((values.split() for name, _, values in lines if name.strip() == "Tr"), [])
    try:
        to_camera = _square(np.array(found, np.float64).reshape(1, 3, 4))
    except ValueError as error:
        raise MapFormatError(calibration, "a line `Tr:` of 12 numbers", "none") from error
    _checked(to_camera[:, :3], calibration)
    return np.asarray((np.linalg.inv(to_camera) @ _square(poses) @ to_camera)[:, :3])


def _square(poses: Matrices) -> Matrices:
    last = np.broadcast_to([0.0, 0.0, 0.0, 1.0], (len(poses), 1, 4))
    return np.concatenate([poses, last], axis=1)


def _of_scans_apart(readers: Sequence[MapReader]) -> ScanPoses | None:
    """Return the poses of scans that files keep apart (E57), where there are different ones."""
    scans = [scan for reader in readers for scan in reader.description.scans]
    if len({pose for count, pose in scans if count}) < 2 or not all(
        reader.description.scans for reader in readers
    ):
        return None
    poses = np.array([pose for _, pose in scans], np.float64).reshape(-1, 3, 4)
    counts = np.array([count for count, _ in scans], np.int64)
    poses = _checked(poses, readers[0].description.path)
    return ScanPoses(poses, are_applied=True, counts=counts)


def _of_viewpoints(readers: Sequence[MapReader]) -> ScanPoses | None:
    """Return the poses in VIEWPOINT, where files have different ones, or lie in their folder."""
    viewpoints = [reader.description.viewpoint for reader in readers]
    told = [each for each in viewpoints if each is not None]
    folders = {reader.description.path.parent.name for reader in readers}
    stands = folders == {_VIEWPOINT_FOLDER} and len(told) > 1 and set(told) != {_UNTOLD}
    if len(told) < len(readers) or (len(set(told)) < 2 and not stands):
        return None
    values = np.array(told)
    poses = _checked(_of_quaternions(values[:, :3], values[:, 3:]), readers[0].description.path)
    return ScanPoses(poses, not _are_around_origin(readers, poses))


def _are_around_origin(readers: Sequence[MapReader], poses: Matrices) -> bool:
    """Tell whether points are in the frames of their sensors for sure.

    Programs that write the pose into VIEWPOINT leave the points in the map's frame.
    """
    away = np.linalg.norm(poses[:, :, 3], axis=1)
    votes = []
    for file in np.argsort(-away, kind="stable")[:5].tolist():
        batch = next(readers[file].batches(_LOOKED_AT), None) if away[file] > _FAR else None
        if batch is not None:
            xyz = only_finite(batch.xyz)
            to_origin = np.median(np.linalg.norm(xyz, axis=1)) if len(xyz) else np.inf
            to_sensor = np.median(np.linalg.norm(xyz - poses[file, :, 3], axis=1))
            votes.append(bool(to_origin < 0.5 * to_sensor))
    return bool(votes) and all(votes)


def _of_quaternions(places: NDArray[np.float64], wxyz: NDArray[np.float64]) -> Matrices:
    """Return poses, (n, 3, 4); those of quaternions of no length are not finite."""
    with np.errstate(all="ignore"):
        w, x, y, z = (wxyz / np.linalg.norm(wxyz, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.concatenate([np.moveaxis(np.array(rows), 2, 0), places[:, :, None]], axis=2)


def _checked(poses: Matrices, source: Path) -> Matrices:
    """Refuse matrices that are no poses: a wrong file must not be taken for one."""
    turns = poses[:, :, :3]
    off = np.abs(turns @ turns.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2), initial=0.0)
    wrong = ~np.isfinite(poses).all(axis=(1, 2)) | ~(off < _NOT_A_ROTATION)
    if wrong.any():
        place = f"pose {int(np.flatnonzero(wrong)[0]) + 1}"
        raise MapFormatError(source, "a rotation and a place", "other numbers", place)
    return poses


def pose_files(paths: Sequence[Path], given: Path | None = None) -> tuple[Path, ...]:
    """Return the files beside a map's own from which `find_poses` may take the poses.

    They are found by their names alone: no file is opened.
    """
    if given is not None:
        return (given,)
    beside = [path.with_name("data") for path in paths if path.name == "cloud.pcd"]
    for folder in dict.fromkeys(path.parent for path in paths):
        if folder.name in _SCAN_FOLDERS:
            beside += [_pose_file(folder.parent) or folder, folder.parent / "calib.txt"]
    return tuple(path for path in beside if path.is_file())
