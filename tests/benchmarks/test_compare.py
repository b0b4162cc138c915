"""The comparison as a whole, on a scene small enough for a test, and its parts."""

import json
import math
import subprocess
import sys
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(autouse=True)
def _benchmarks_are_importable(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT))


def compare(*arguments):
    return subprocess.run(
        [sys.executable, "-m", "benchmarks.compare", *map(str, arguments)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )


def test_ours_and_a_peer_share_a_table_and_a_missing_peer_says_so(tmp_path):
    file = tmp_path / "figures.json"
    methods = ["DynaHull, paper", "nothing", "PDAL"]
    scene = ["--scenes", "simulated-indoor", "--set", "scans=20", "azimuth_step=6"]
    done = compare(*scene, "--emd-points", 200, "--methods", *methods, "--json", file)
    assert done.returncode == 0, done.stderr
    paper, nothing, pdal = json.loads(file.read_text(encoding="utf-8"))
    assert paper["points"] == nothing["points"] > 10_000
    assert 5 <= paper["figures"]["removed %"] <= 20
    # Eq. 1 cannot remove all that moved from so sparse a map, but more of it than of the rest.
    assert paper["figures"]["recall"] > 2 * paper["figures"]["FP %"]
    assert nothing["figures"]["FN %"] == 100 and nothing["figures"]["SA"] == 100
    assert paper["figures"]["EMD"] > 0
    accuracies = [paper["figures"][name] for name in ("SA", "DA", "AA")]
    assert accuracies[2] == pytest.approx(math.sqrt(accuracies[0] * accuracies[1]))
    assert f"| DynaHull, paper | ours | {paper['figures']['MAE']:.2f} |" in done.stdout
    if find_spec("pdal") is None:
        assert "PDAL is not installed" in pdal["skipped"]
        assert "- PDAL filters.outlier (statistical, 8, 2.0): PDAL is not inst" in done.stdout


@pytest.fixture
def crossing():
    from benchmarks.compare.data.crossing import crossing_scene  # noqa: PLC0415

    return crossing_scene(scans=8, rings=32, columns=120)


def test_in_the_crossing_all_but_the_box_lies_on_the_hall(crossing):
    from pipeline.evaluation.labels import Truth  # noqa: PLC0415

    moved = crossing.labels == Truth.DYNAMIC
    sides = np.abs(crossing.xyz - [[0, 0, 3]])
    from_hall = np.abs(sides - [12, 12, 3]).min(axis=1)
    assert from_hall[~moved].max() < 0.06
    assert 0.002 < moved.mean() < 0.05
    assert (np.abs(crossing.xyz[moved, 1] - 1.0) < 0.6).all()
    # No place of the box is one of the next scan's.
    for first, second in zip(range(7), range(1, 8), strict=True):
        ahead, behind = (
            crossing.xyz[moved & (crossing.scan == each), 0] for each in (second, first)
        )
        assert ahead.min() > behind.max()


def test_a_scene_comes_back_from_its_file_and_in_the_sensors_frame(crossing, tmp_path):
    from benchmarks.compare.scene import Scene  # noqa: PLC0415

    crossing.write(tmp_path / "scene.npz")
    back = Scene.read(tmp_path / "scene.npz")
    assert back.name == "crossing" and back.ring_spacing == crossing.ring_spacing
    scans = list(back.scans())
    assert sorted(np.concatenate([scan.rows for scan in scans])) == list(range(len(crossing)))
    for scan in scans:
        assert (back.xyz[scan.rows] == scan.points).all()
        there = scan.in_sensor_frame() @ scan.pose[:, :3].T + scan.pose[:, 3]
        assert there == pytest.approx(scan.points, abs=1e-12)


def comparison_of(removal, crossing, folder, monkeypatch):
    """A comparison of one method that needs scans, run here and not in another process."""
    from benchmarks.compare import comparison as module  # noqa: PLC0415
    from benchmarks.compare.isolated import Limits, Outcome  # noqa: PLC0415
    from benchmarks.compare.measure import evaluation_options  # noqa: PLC0415
    from benchmarks.compare.method import Family, Method  # noqa: PLC0415
    from benchmarks.compare.scene import Scene  # noqa: PLC0415

    def run(method, scene, *_):
        return Outcome(None, method.load()(Scene.read(scene)), 1.0)

    monkeypatch.setattr(module, "run_isolated", run)
    method = Method("peer", Family.SCANS, lambda: removal)
    options = evaluation_options(0)
    return module.Comparison([method], Limits(60, 4), options, folder, crossing)


def test_a_peer_that_finds_nothing_where_it_must_is_not_compared(crossing, tmp_path, monkeypatch):
    def finds_nothing(scene):
        return np.zeros(len(scene), dtype=bool)

    comparison = comparison_of(finds_nothing, crossing, tmp_path, monkeypatch)
    (result,) = comparison.on(crossing)
    assert "finds 0% of a thing that crosses" in result.skipped
    assert not result.figures


def test_a_peer_that_works_gets_the_figures_it_earns(crossing, tmp_path, monkeypatch):
    def finds_all(scene):
        return np.asarray(scene.labels == 1)

    comparison = comparison_of(finds_all, crossing, tmp_path, monkeypatch)
    (result,) = comparison.on(crossing)
    assert result.skipped is None
    assert result.figures["precision"] == result.figures["recall"] == 100
    assert result.figures["MAE"] == 0 and result.figures["SA"] == 100


def test_a_method_that_fails_or_takes_too_long_is_skipped_with_the_reason(crossing, tmp_path):
    from benchmarks.compare.isolated import Limits, run_isolated  # noqa: PLC0415
    from benchmarks.compare.method import Family, Method  # noqa: PLC0415

    crossing.write(tmp_path / "scene.npz")
    unknown = Method("no such method", Family.MAP, lambda: None)
    outcome = run_isolated(unknown, tmp_path / "scene.npz", tmp_path, Limits(60, 4))
    assert outcome.skipped.startswith("failed: ValueError")
    slow = run_isolated(unknown, tmp_path / "scene.npz", tmp_path, Limits(0.01, 4))
    assert slow.skipped == "more than 0.01 s"


def test_means_are_over_all_scenes_or_none():
    from benchmarks.compare.results import Result, mean_of  # noqa: PLC0415

    def result(scene, value, skipped=None):
        return Result("m", "ours", scene, "g", 10, skipped, {"SA": value, "DA": None})

    mean = mean_of([result("a", 90.0), result("b", 80.0)])
    assert mean.figures == {"SA": 85.0, "DA": None} and mean.points == 20
    assert mean_of([result("a", 90.0), result("b", 1.0, "too slow")]).skipped == "too slow"


def test_what_is_always_there_is_static_and_what_passes_is_not():
    from benchmarks.compare.data.occupancy import labels_by_occupancy  # noqa: PLC0415
    from pipeline.evaluation.labels import Truth  # noqa: PLC0415

    places = {"wall": (1.05, 1.05, 1.05), "person": (2.05, 0.05, 0.05), "stray": (3.05, 3.05, 0.05)}
    places["slanting"] = (-4.05, -1.05, 0.05)
    seen = {"wall": range(100), "person": range(40, 50), "stray": [7], "slanting": range(0, 100, 9)}
    expected = [Truth.STATIC, Truth.DYNAMIC, Truth.UNKNOWN, Truth.UNKNOWN]
    rows = [(xyz, scan, truth) for (name, xyz), truth in zip(places.items(), expected, strict=True)
            for scan in seen[name]]  # fmt: skip
    order = np.random.default_rng(0).permutation(len(rows))
    xyz, scan, truth = (np.array([rows[row][part] for row in order]) for part in range(3))
    assert (labels_by_occupancy(xyz, scan.astype(np.int32)) == truth).all()


def test_a_peer_that_removes_nothing_from_a_scene_is_not_compared_on_it(
    crossing, tmp_path, monkeypatch
):
    def sees_the_crossing_only(scene):
        return np.asarray(scene.labels == 1) & (scene.name == "crossing")

    comparison = comparison_of(sees_the_crossing_only, crossing, tmp_path, monkeypatch)
    (result,) = comparison.on(replace(crossing, name="another"))
    assert result.skipped.startswith("removed nothing here")
