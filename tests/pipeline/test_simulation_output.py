"""The files hold what was simulated, as their formats say, and are complete or not there."""

import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml
from typer.testing import CliRunner

from pipeline.commands.app import app
from pipeline.errors import ConfigurationError, OutputError
from pipeline.simulation import (
    SimulationParameters,
    Surface,
    output,
    scans,
    simulate,
    simulate_scans,
    write_simulation,
)
from tiling.formats import open_map

SMALL = SimulationParameters(scans=12, rotations_per_scan=40, seed=4)
EVERYTHING = [
    "low_activity.pcd",
    "map.pcd",
    "poses.txt",
    "poses_true.txt",
    "scans",
    "simulation.yaml",
    "static_truth.pcd",
    "times.txt",
    "truth.parquet",
]


def rows_of(path):
    """Points of a PCD file of the simulation, read by hand."""
    header, body = path.read_bytes().split(b"DATA binary\n", 1)
    rows = np.frombuffer(body, "<f4,<f4,<f4,<f4,<f8,<u4")
    rows.dtype.names = ("x", "y", "z", "intensity", "time", "scan")
    assert f"\nPOINTS {len(rows)}\n".encode() in header
    return rows


def xyz_of(path):
    return np.concatenate([batch.xyz for batch in open_map(path).batches()])


def test_files_hold_what_was_simulated(tmp_path):
    simulated = simulate(SMALL)
    files = write_simulation(SMALL, tmp_path / "new" / "folder")
    assert sorted(path.name for path in files.map.parent.iterdir()) == EVERYTHING
    reader = open_map(files.map)
    assert [(field.name, field.dtype) for field in reader.description.fields] == [
        ("x", "float32"),
        ("y", "float32"),
        ("z", "float32"),
        ("intensity", "float32"),
        ("time", "float64"),
        ("scan", "uint32"),
    ]
    assert np.array_equal(xyz_of(files.map), simulated.xyz.astype(float))
    rows = rows_of(files.map)
    for name in ("intensity", "time", "scan"):
        assert np.array_equal(rows[name], getattr(simulated, name))
    truth = pq.read_table(files.truth)
    assert truth["moving"].to_pylist() == simulated.moving.astype(bool).tolist()
    titles = [Surface(number).title for number in simulated.surface]
    assert truth["surface"].to_pylist() == titles


def test_scans_by_their_poses_are_the_map(tmp_path):
    files = write_simulation(SMALL, tmp_path)
    poses = np.loadtxt(files.poses).reshape(-1, 3, 4)
    names = sorted(files.scans.iterdir())
    assert [path.name for path in names] == [f"{number:06d}.pcd" for number in range(12)]
    placed = [
        xyz_of(path) @ pose[:, :3].T + pose[:, 3] for path, pose in zip(names, poses, strict=True)
    ]
    # float32 and the nine decimals of the poses.
    assert np.concatenate(placed) == pytest.approx(xyz_of(files.map), abs=1e-5)
    scans = list(simulate_scans(SMALL))
    true_poses = np.loadtxt(files.true_poses).reshape(-1, 3, 4)
    assert true_poses == pytest.approx(np.stack([scan.true_pose for scan in scans]), abs=1e-9)
    assert np.loadtxt(files.times) == pytest.approx(np.arange(12) * SMALL.scan_interval)
    assert np.array_equal(np.concatenate([rows_of(path)["scan"] for path in names]),
                          rows_of(files.map)["scan"])  # fmt: skip


def test_maps_to_compare_with_are_of_the_same_scene(tmp_path):
    files = write_simulation(SMALL, tmp_path)
    static = [scan.static_returns.xyz for scan in simulate_scans(SMALL)]
    assert np.array_equal(xyz_of(files.static_truth), np.float32(np.concatenate(static)))
    quiet = simulate(SMALL.low_activity())
    assert np.array_equal(xyz_of(files.low_activity), quiet.xyz.astype(float))


def test_stream_of_many_blocks_is_the_map_built_in_memory(tmp_path, monkeypatch):
    monkeypatch.setattr(scans, "POINTS_OF_A_BLOCK", 4000)
    monkeypatch.setattr(output, "POINTS_IN_MEMORY", 1000)
    parameters = SimulationParameters(points=11_111, scans=20, scene="street")
    told = []
    files = write_simulation(parameters, tmp_path, map_only=True, advance=told.append)
    simulated = simulate(parameters)
    rows = rows_of(files.map)
    assert len(rows) == sum(told) == 11_111
    assert np.array_equal(np.stack([rows["x"], rows["y"], rows["z"]], axis=1), simulated.xyz)
    assert np.array_equal(rows["scan"], simulated.scan)
    truth = pq.read_table(files.truth)
    assert np.array_equal(truth["moving"].to_numpy(), simulated.moving == 1)
    assert pq.ParquetFile(files.truth).num_row_groups > 5
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "map.pcd",
        "poses.txt",
        "poses_true.txt",
        "simulation.yaml",
        "times.txt",
        "truth.parquet",
    ]


def test_written_parameters_make_the_same_bytes_again(tmp_path):
    first = write_simulation(SMALL, tmp_path / "a")
    parameters = SimulationParameters(**yaml.safe_load(first.parameters.read_text()))
    write_simulation(parameters, tmp_path / "b")
    written = sorted(path for path in (tmp_path / "a").rglob("*") if path.is_file())
    assert len(written) == 8 + SMALL.scans
    for path in written:
        again = tmp_path / "b" / path.relative_to(tmp_path / "a")
        assert path.read_bytes() == again.read_bytes()


def test_writing_again_replaces_all_and_nothing_of_others(tmp_path):
    write_simulation(SMALL, tmp_path)
    (tmp_path / "scans" / "notes.txt").write_text("mine")
    shorter = SMALL.model_copy(update={"scans": 3})
    files = write_simulation(shorter, tmp_path)
    assert open_map(files.map).description.point_count == len(simulate(shorter).xyz)
    assert sorted(path.name for path in files.scans.iterdir()) == [
        "000000.pcd", "000001.pcd", "000002.pcd", "notes.txt",
    ]  # fmt: skip
    write_simulation(shorter, tmp_path, map_only=True)
    assert not files.static_truth.exists()
    assert [path.name for path in files.scans.iterdir()] == ["notes.txt"]


def test_interrupted_simulation_leaves_what_was_there(tmp_path):
    files = write_simulation(SMALL, tmp_path)
    before = files.map.read_bytes()

    def interrupt(points):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_simulation(SMALL.model_copy(update={"seed": 9}), tmp_path, advance=interrupt)
    assert files.map.read_bytes() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == EVERYTHING


def test_command_takes_scene_seed_and_points(tmp_path):
    arguments = ["--scene", "ramp", "--seed", "3", "--points", "700", "--set", "walkers=1"]
    result = CliRunner().invoke(app, ["simulate", "-o", str(tmp_path), *arguments])
    assert result.exit_code == 0, result.output
    assert f"written: {tmp_path / 'map.pcd'}" in result.output
    settings = yaml.safe_load((tmp_path / "simulation.yaml").read_text())
    assert [settings[key] for key in ("scene", "seed", "points", "walkers")] == ["ramp", 3, 700, 1]
    assert len(rows_of(tmp_path / "map.pcd")) == 700
    assert not (tmp_path / "scans").exists(), "left out where points are given"


def test_command_writes_all_if_told(tmp_path):
    arguments = ["--points", "300", "--all", "--set", "scans=5"]
    assert CliRunner().invoke(app, ["simulate", "-o", str(tmp_path), *arguments]).exit_code == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == EVERYTHING
    assert len(rows_of(tmp_path / "low_activity.pcd")) == 300


def test_failure_leaves_no_folder_behind(tmp_path):
    blind = SimulationParameters(points=100, min_range=50, max_range=60, scans=5)
    with pytest.raises(ConfigurationError, match="found 0 in 24 scans"):
        write_simulation(blind, tmp_path / "new")
    assert not list(tmp_path.iterdir())


def test_a_step_that_the_points_choose_is_refused(tmp_path):
    arguments = ["--points", "300", "--set", "azimuth_step=0.2"]
    found = CliRunner().invoke(app, ["simulate", "-o", str(tmp_path / "new"), *arguments])
    assert isinstance(found.exception, ConfigurationError)
    assert "azimuth_step: it has no effect with points=300" in str(found.exception)
    assert not list(tmp_path.iterdir())
    # Of the file that a simulation leaves, and without points, it is what it is.
    assert SimulationParameters(points=300, azimuth_step=20.0).points == 300
    assert SimulationParameters(azimuth_step=0.2).columns == 1800


def test_folder_that_cannot_be_made_is_one_clear_line(tmp_path):
    (tmp_path / "taken").write_text("a file")
    with pytest.raises(OutputError, match=r"taken/sub: expected a folder to write in, found Not a"):
        write_simulation(SMALL, tmp_path / "taken" / "sub")
    with pytest.raises(OutputError, match=r"taken: expected a folder to write in, found a file$"):
        write_simulation(SMALL, tmp_path / "taken")


@pytest.mark.parametrize("ranges", [{"max_range": 0.1}, {"min_range": 5.0, "max_range": 1.0}])
def test_a_sensor_that_sees_nothing_leaves_no_map(tmp_path, ranges):
    parameters = SimulationParameters(scans=2, **ranges)
    with pytest.raises(ConfigurationError, match="expected something within the sensor's range"):
        write_simulation(parameters, tmp_path / "out")
    assert not (tmp_path / "out" / "map.pcd").exists()
