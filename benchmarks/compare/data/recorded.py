"""Recorded maps, which are no part of the project: a street with labels, a room without."""

from pathlib import Path

import laspy
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from benchmarks.compare.data.occupancy import labels_by_occupancy
from benchmarks.compare.scene import Scene
from pipeline.evaluation.truth import Truth

__all__ = ["first_half_of_street", "room_scene", "second_half_of_street", "street_scene"]

SCORED_WITHIN = 40.0
"""Metres from the path, where the labels of the street are scored."""

_STREET_SCANS, _STREET_MIDDLE = 77, 38
_STREET_LABELS = {0: Truth.UNKNOWN, 1: Truth.STATIC, 2: Truth.DYNAMIC}


def street_scene(maps: Path) -> Scene:
    """Read 77 scans of a 64-ring sensor, in part labelled (`user_data`)."""
    return _street(maps, "recorded street", range(_STREET_SCANS))


def first_half_of_street(maps: Path) -> Scene:
    """Read the first 38 scans of the street, as a map of their own."""
    return _street(maps, "recorded street, first half", range(_STREET_MIDDLE))


def second_half_of_street(maps: Path) -> Scene:
    """Read the last 39 scans of the street, as a map of their own."""
    return _street(maps, "recorded street, second half", range(_STREET_MIDDLE, _STREET_SCANS))


def standing_street_scene(maps: Path) -> Scene:
    """Read 78 scans of a 64-ring sensor that stands in a street, in part labelled."""
    return _labelled(maps / "street_static_sensor.laz", "standing street")


def semantickitti_scene(sequence: str, maps: Path) -> Scene:
    """Read the first ten scans of a sequence of SemanticKITTI."""
    return _labelled(maps / f"semantickitti_{sequence}.laz", f"SemanticKITTI {sequence}")


def _street(maps: Path, name: str, scans: range) -> Scene:
    return _labelled(maps / "street_64beam_labelled.laz", name, scans)


def _labelled(path: Path, name: str, scans: range | None = None) -> Scene:
    """Read scans of a 64-ring sensor, labelled in `user_data`, with their poses beside them."""
    points = laspy.read(path)
    poses = np.loadtxt(path.with_suffix(".poses.txt")).reshape(-1, 3, 4)
    scans = range(len(poses)) if scans is None else scans
    points = points[np.isin(points.point_source_id, scans)]
    poses = poses[scans.start : scans.stop]
    xyz = _coordinates(points)
    labels = np.full(len(xyz), Truth.UNKNOWN, dtype=np.int8)
    for value, truth in _STREET_LABELS.items():
        labels[np.asarray(points.user_data) == value] = truth
    away, _ = cKDTree(poses[:, :2, 3]).query(xyz[:, :2])
    labels[away > SCORED_WITHIN] = Truth.UNKNOWN
    return Scene(
        name=name,
        group=name,
        xyz=xyz,
        labels=labels,
        scan=np.asarray(points.point_source_id).astype(np.int32) - scans.start,
        poses=poses,
        ring_spacing=26.9 / 64,
    )


def room_scene(maps: Path) -> Scene:
    """Read 227 scans of a sensor that stands still, with labels by how often a place is seen."""
    points = laspy.read(maps / "room_static_sensor.laz")
    xyz = _coordinates(points)
    scan = np.asarray(points.point_source_id).astype(np.int32)
    return Scene(
        name="recorded room",
        group="recorded room (labels by how often a place is seen)",
        xyz=xyz,
        labels=labels_by_occupancy(xyz, scan),
        scan=scan,
        poses=np.tile(np.eye(3, 4), (int(scan.max()) + 1, 1, 1)),
        ring_spacing=2.0,
    )


def _coordinates(points: laspy.LasData) -> NDArray[np.float64]:
    return np.ascontiguousarray(points.xyz, dtype=np.float64)
