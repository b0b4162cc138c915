"""Poses of the scans that a map was made of, in a file of their own."""

import json
import os

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.configuration.run import load_configuration
from pipeline.errors import ConfigurationError
from pipeline.info import inspect_map
from pipeline.metres import open_collection
from pipeline.progress import LogDisplay, StageObserver
from pipeline.run import run
from pipeline.scan_numbers import find_scans
from pipeline.scan_source import nearest_poses
from pipeline.tiles.stages import TASKS
from pipeline.work.folder import WORK_FOLDER

pytestmark = pytest.mark.usefixtures("nothing_waits_for_the_disk")

SCANS, COUNT = 25, 3000
SCAN = np.arange(COUNT) * SCANS // COUNT
TIME = SCAN * 0.1 + 0.05
XYZ = np.random.default_rng(0).uniform(size=(COUNT, 3)) * [6, 5, 2]
PLACES = np.linspace([1, 1, 1], [5, 4, 1], SCANS)


def write_map(path, **fields):
    np.savez(path, points=XYZ, **fields)
    return path


def write_poses(path, places=PLACES, times=None, kind="kitti"):
    turns = np.tile(np.eye(3).ravel(), (len(places), 1)).reshape(-1, 3, 3)
    rows = np.concatenate([turns, places[:, :, None]], axis=2).reshape(-1, 12)
    if kind == "tum":
        rows = np.column_stack([times, places, np.tile([0, 0, 0, 1], (len(places), 1))])
    elif times is not None:
        rows = np.column_stack([times, rows])
    np.savetxt(path, rows, "%.17g")
    return path


def found(path, poses):
    """Return the source of the scan numbers, the numbers, and where the sensor was."""
    configuration = load_configuration("auto", [f"input.poses={poses}"])
    collection = open_collection([path], configuration.input)
    source = find_scans(collection, configuration)
    batches = list(collection.batches())
    xyz = np.concatenate([batch.xyz for _, batch in batches])
    np.testing.assert_array_equal(xyz, XYZ)  # the map is in its frame already
    numbers = np.concatenate([source.numbers(collection, *each) for each in batches])
    return source, numbers, source.sensor(collection)


@pytest.mark.parametrize(
    ("field", "values", "poses"),
    [
        ("scan", SCAN, {}),
        ("scan", SCAN * 10 + 1000, {}),  # key frames: each has its pose
        ("t", TIME, {"times": np.arange(SCANS) * 0.1 + 0.06}),
        ("stamp", (TIME + 1.7e9) * 1e9, {"times": np.arange(SCANS) * 0.1 + 1.7e9, "kind": "tum"}),
    ],
)
def test_scans_are_those_of_the_poses(tmp_path, field, values, poses):
    path = write_map(tmp_path / "map.npz", **{field: values})
    source, numbers, sensor = found(path, write_poses(tmp_path / "poses.txt", **poses))
    assert str(source) == f"{field}, 25 scans with poses"
    np.testing.assert_array_equal(numbers, SCAN)
    np.testing.assert_array_equal(sensor, PLACES)


def test_scans_that_are_missing_shift_no_other(tmp_path):
    scan = np.where(SCAN % 5 == 2, 0, SCAN)
    source, numbers, _ = found(
        write_map(tmp_path / "map.npz", scan=scan), write_poses(tmp_path / "poses.txt")
    )
    assert source.scans == 20
    np.testing.assert_array_equal(numbers, scan)


def test_times_are_passed_over_where_the_poses_have_none(tmp_path):
    path = write_map(tmp_path / "map.npz", gps_time=TIME, point_source_id=SCAN)
    source, numbers, _ = found(path, write_poses(tmp_path / "poses.txt"))
    assert source.name == "point_source_id"
    np.testing.assert_array_equal(numbers, SCAN)


@pytest.mark.parametrize(
    ("fields", "poses", "message"),
    [
        ({"scan": SCAN}, {"places": PLACES[:9]}, "a pose for each of 25 scans of scan, numbered"),
        ({"t": TIME}, {}, r"with its time \(8 or 13 numbers a line\), found none"),
        ({"t": TIME}, {"times": np.arange(25) + 1e5}, "from 0.0 to 2.4 s, found poses from 10"),
        ({"t": TIME}, {"times": -np.arange(25.0)}, "times that ascend"),
        ({}, {}, "a scan number or a time, found neither in .*map.npz"),
    ],
)
def test_poses_of_another_recording_are_refused(tmp_path, fields, poses, message):
    path = write_map(tmp_path / "map.npz", **fields)
    with pytest.raises(ConfigurationError, match=f"input.poses: expected .*{message}"):
        found(path, write_poses(tmp_path / "poses.txt", **poses))


@pytest.mark.parametrize(("decision", "warned"), [("paper", True), ("auto", False)])
def test_poses_that_nothing_looks_at_are_told_of(tmp_path, decision, warned):
    path, poses = write_map(tmp_path / "map.npz", scan=SCAN), write_poses(tmp_path / "poses.txt")
    wanted = [f"input.poses={poses}", "output.report=none", "ground.method=none"]
    configuration = load_configuration(decision, wanted)
    report = run([path], tmp_path / "out", configuration, StageObserver(LogDisplay()))
    assert any("input.poses has no effect" in each for each in report.warnings) == warned


@settings(deadline=None)
@given(
    poses=st.lists(st.integers(0, 10**6), min_size=1, max_size=30),
    numbers=st.lists(st.integers(-5, 10**6), max_size=30),
    exact=st.booleans(),
)
def test_the_nearest_pose_is_the_nearest(poses, numbers, exact):
    poses = sorted(poses)
    nearest = nearest_poses(np.array(numbers, np.int64), poses, exact=exact)
    for number, pose in zip(numbers, nearest.tolist(), strict=True):
        least = min(abs(number - each) for each in poses)
        if least <= (0 if exact else 10):
            assert abs(poses[pose] - number) == least
        else:
            assert pose == -1


def flip(path):
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 4
    path.write_bytes(content)


@pytest.mark.parametrize("name", ["images.rows", "images.arrays"])
@pytest.mark.parametrize("damage", [flip, lambda path: os.truncate(path, 9), os.unlink])
def test_returns_that_were_damaged_are_gathered_again(tmp_path, monkeypatch, damage, name):
    path = write_map(tmp_path / "map.npz", scan=SCAN)
    wanted = [f"input.poses={write_poses(tmp_path / 'poses.txt')}", "execution.cluster=none"]
    wanted += ["tiling.max_points=1000", "ground.method=none", "neighbours.k=8"]
    wanted += ["output.report=none", "output.labels=true"]
    configuration = load_configuration("auto", wanted)
    weigh_tile = TASKS["evidence"]

    def killed(job, tile):
        if tile == 1:
            raise KeyboardInterrupt
        return weigh_tile(job, tile)

    def labels(folder, task):
        monkeypatch.setitem(TASKS, "evidence", task)
        run([path], folder, configuration, StageObserver(LogDisplay()))
        return (folder / "labels.parquet").read_bytes()

    with pytest.raises(KeyboardInterrupt):
        labels(tmp_path / "killed", killed)
    damage(tmp_path / "killed" / WORK_FOLDER / name)
    expected = labels(tmp_path / "whole", weigh_tile)
    assert labels(tmp_path / "killed", weigh_tile) == expected
    assert json.loads((tmp_path / "killed/run.json").read_text())["warnings"]


def test_info_names_them(tmp_path):
    path = write_map(tmp_path / "map.npz", scan=SCAN)
    told = inspect_map([path], str(write_poses(tmp_path / "poses.txt"))).to_text()
    assert "time        scan, 25 scans with poses" in told
