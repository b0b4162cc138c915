"""A whole run: nothing is lost, the same bytes every time, and bad input writes nothing."""

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml

from dynahull import Label, clean
from pipeline import run as run_module
from pipeline.configuration.run import load_configuration
from pipeline.errors import DiskSpaceError, InputChangedError, LostPointsError, OutputError
from pipeline.outputs import writing
from pipeline.progress import LogDisplay, StageObserver
from pipeline.run import run
from tiling.errors import MapFormatError
from tiling.formats import open_map

FAST = ["neighbours.k=20", "clustering.count=2"]


def hall(size=2000, seed=0):
    random = np.random.default_rng(seed)
    floor = np.column_stack([random.uniform(0, 8, (size, 2)), random.normal(0, 0.01, size)])
    wall = random.uniform(size=(size, 3)) * [8, 0.03, 2.5] + [0, 8, 0]
    ghost = random.uniform(size=(size // 20, 3)) * [3, 2, 1.5] + [2, 3, 0.3]
    return random.permutation(np.vstack([floor, wall, ghost])).astype(np.float32)


@pytest.fixture
def map_file(tmp_path):
    points = hall()
    fields = [("x", "f4"), ("y", "f4"), ("z", "f4"), ("ring", "u2"), ("time", "f8")]
    table = np.zeros(len(points), fields)
    table["x"], table["y"], table["z"] = points.T
    table["ring"], table["time"] = np.arange(len(points)) % 16, np.linspace(0, 1, len(points))
    table["x"][5] = np.nan
    path = tmp_path / "hall.npy"
    np.save(path, table)
    return path


def cleaned(maps, folder, *settings, config=None):
    configuration = load_configuration(config, [*FAST, *settings])
    return run(maps, folder, configuration, StageObserver(LogDisplay()))


def contents(folder):
    """The bytes of all results but the reports, which hold times."""
    return {
        path.relative_to(folder): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name not in ("run.json", "report.html")
    }


def test_static_and_dynamic_are_the_input_with_every_field_in_order(map_file, tmp_path):
    report = cleaned([map_file], tmp_path / "out", config="paper")
    whole = np.load(map_file)
    static, dynamic = (np.load(tmp_path / "out" / f"{name}.npy") for name in ("static", "dynamic"))
    result = clean(
        np.column_stack([whole[axis] for axis in "xyz"]),
        load_configuration("paper", FAST).method(),
    )
    assert 0 < len(dynamic) == report.counts["dynamic"]
    assert static.tobytes() == whole[result.kept].tobytes()
    assert dynamic.tobytes() == whole[~result.kept].tobytes()
    assert report.counts["invalid"] == 1


def test_the_report_says_what_was_done(map_file, tmp_path):
    cleaned([map_file], tmp_path / "out", "output.labels=true", config="paper")
    report = json.loads((tmp_path / "out" / "run.json").read_text(encoding="utf-8"))
    assert report["points"] == sum(report["counts"].values()) == len(np.load(map_file))
    assert set(report["counts"]) == {label.title for label in Label}
    assert report["files"][0]["size_bytes"] == map_file.stat().st_size
    assert len(report["input_hash"]) == 64
    assert list(report["seconds"]) == [
        "hashing", "reading", "ground", "clustering", "density", "write", "report",
    ]  # fmt: skip
    assert report["peak_memory_bytes"] > 10**7
    counts = [cluster["count"] for cluster in report["clusters"]]
    for cluster in report["clusters"]:
        share = (cluster["count"] - min(counts)) / (max(counts) - min(counts))
        assert cluster["removal_percent"] == pytest.approx(5 + 15 * share)
        assert cluster["removed"] == int(cluster["removal_percent"] / 100 * cluster["count"])
        assert cluster["threshold"] > 0
    written = yaml.safe_load((tmp_path / "out" / "config.yaml").read_text(encoding="utf-8"))
    assert report["configuration"] == written
    assert sorted(report["outputs"]) == sorted(
        str(path.relative_to(tmp_path / "out")) for path in (tmp_path / "out").iterdir()
    )


def test_labels_have_one_row_a_point_in_input_order(map_file, tmp_path):
    cleaned([map_file], tmp_path / "out", "output.labels=true", config="paper")
    labels = pq.read_table(tmp_path / "out" / "labels.parquet")
    points = open_map(map_file)
    xyz = np.concatenate([batch.xyz for batch in points.batches()])
    result = clean(xyz, load_configuration("paper", FAST).method())
    assert labels.column_names == ["label", "cluster", "density", "score", "reason"]
    assert labels["label"].to_pylist() == [Label(label).title for label in result.labels]
    np.testing.assert_array_equal(labels["cluster"].to_numpy(), result.cluster)
    np.testing.assert_array_equal(labels["density"].to_numpy(), result.density)


def test_the_same_bytes_again_from_the_written_configuration(map_file, tmp_path):
    cleaned([map_file], tmp_path / "first", "output.labels=true", "removal.threshold=stepped")
    configuration = load_configuration(str(tmp_path / "first" / "config.yaml"))
    run([map_file], tmp_path / "second", configuration, StageObserver(LogDisplay()))
    assert contents(tmp_path / "first") == contents(tmp_path / "second")


def test_several_files_are_one_map_and_come_back_under_their_names(map_file, tmp_path):
    whole = np.load(map_file)
    pieces = tmp_path / "pieces"
    pieces.mkdir()
    for number, piece in enumerate(np.array_split(whole, 3)):
        np.save(pieces / f"part {number}.npy", piece)
    one = cleaned([map_file], tmp_path / "one")
    for maps in ([pieces], [pieces / "*.npy"], sorted(pieces.iterdir())):
        many = cleaned(maps, tmp_path / "many")
        assert many.counts == one.counts
        for name in ("static", "dynamic"):
            parts = [np.load(path) for path in sorted((tmp_path / "many" / name).iterdir())]
            assert len(parts) == 3
            assert (
                np.concatenate(parts).tobytes() == np.load(tmp_path / f"one/{name}.npy").tobytes()
            )


def test_the_default_folder_is_beside_the_user(map_file, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    cleaned([map_file], None)
    assert (tmp_path / "hall_dynahull" / "run.json").is_file()


def test_a_truncated_map_is_refused_and_nothing_is_written(map_file, tmp_path):
    map_file.write_bytes(map_file.read_bytes()[:-10])
    with pytest.raises(MapFormatError, match=r"hall\.npy"):
        cleaned([map_file], tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_map_that_changes_meanwhile_is_refused(map_file, tmp_path, monkeypatch):
    def meddling(*arguments):
        np.save(map_file, np.load(map_file)[::-1])
        return "0" * 64

    monkeypatch.setattr(run_module, "content_hash", meddling)
    with pytest.raises(InputChangedError, match="changed while"):
        cleaned([map_file], tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_lost_points_stop_the_run(map_file, tmp_path, monkeypatch):
    monkeypatch.setattr(writing, "open_map", lambda path: open_map(map_file))
    with pytest.raises(LostPointsError, match="points read"):
        cleaned([map_file], tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_results_cannot_replace_their_input(map_file, tmp_path):
    cleaned([map_file], tmp_path / "out")
    with pytest.raises(OutputError, match="this input lies where a result goes"):
        cleaned([tmp_path / "out" / "static.npy"], tmp_path / "out")


def test_results_do_not_go_into_the_folder_that_is_the_map(map_file):
    with pytest.raises(OutputError, match="this folder is the input"):
        cleaned([map_file.parent], map_file.parent)
    assert list(map_file.parent.iterdir()) == [map_file]


def test_an_empty_map_passes_through(tmp_path):
    np.save(tmp_path / "empty.npy", np.empty((0, 3)))
    report = cleaned([tmp_path / "empty.npy"], tmp_path / "out")
    assert report.points == 0
    assert "0 of 0 points removed" in report.summary()
    assert np.load(tmp_path / "out" / "static.npy").shape == (0, 3)


def points_as_stored(path):
    """The bytes of every point, read without the project's own readers."""
    header, _, body = path.read_bytes().partition(b"\nDATA ")
    kind, _, body = body.partition(b"\n")
    count = int(header.split(b"\nPOINTS ")[1].split()[0])
    if kind.strip() == b"ascii":
        return np.array(body.splitlines()[:count], "S100")
    sizes = header.split(b"\nSIZE ")[1].split(b"\n")[0].split()
    size = sum(int(field) for field in sizes)
    return np.frombuffer(body[: count * size], f"V{size}")


@pytest.mark.parametrize("name", ["corridor.pcd", "lobby_a.pcd", "lobby_b.pcd"])
def test_real_maps_lose_nothing(name, shared_data: Path, tmp_path):
    source = shared_data / "maps" / name
    report = cleaned([source], tmp_path / "out", "output.labels=true", config="paper")
    labels = pq.read_table(tmp_path / "out" / "labels.parquet")["label"].to_numpy()
    static, dynamic, whole = (
        points_as_stored(path)
        for path in (tmp_path / "out/static.pcd", tmp_path / "out/dynamic.pcd", source)
    )
    assert 0.01 < report.counts["dynamic"] / len(whole) < 0.2
    assert static.tobytes() == whole[labels != "dynamic"].tobytes()
    assert dynamic.tobytes() == whole[labels == "dynamic"].tobytes()


def test_a_run_that_would_fill_the_disk_is_refused_before_any_work(tmp_path):
    np.save(tmp_path / "map.npy", np.zeros((4, 3)))
    configuration = load_configuration(None, ["output.keep_free=9000 TiB"])
    with pytest.raises(DiskSpaceError, match=r"9000.0 TiB are to stay so") as error:
        run([tmp_path / "map.npy"], tmp_path / "out", configuration, StageObserver(LogDisplay()))
    assert "\n" not in str(error.value)
    assert not (tmp_path / "out").exists()
