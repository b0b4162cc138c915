"""The comparison as a whole, on a scene small enough for a test, and its parts."""

import json
import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from shutil import which

import laspy
import numpy as np
import pytest
from scipy.spatial import cKDTree

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
    assert f"| DynaHull, paper | ours | 1 | {paper['figures']['MAE']:.2f} |" in done.stdout
    if which("pdal") is None:
        assert "PDAL is not installed" in pdal["skipped"]
        assert "- PDAL filters.outlier (statistical, 8, 2.0): PDAL is not inst" in done.stdout


@pytest.fixture
def crossing():
    from benchmarks.compare.data.crossing import crossing_scene  # noqa: PLC0415

    return crossing_scene(scans=8, rings=32, columns=120)


def test_in_the_crossing_all_but_the_box_lies_on_the_hall(crossing):
    from pipeline.evaluation.truth import Truth  # noqa: PLC0415

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


def comparison_of(removal, crossing, folder, monkeypatch, family="SCANS"):
    """A comparison of one method, run here and not in another process."""
    from benchmarks.compare import comparison as module  # noqa: PLC0415
    from benchmarks.compare.isolated import Limits, Outcome  # noqa: PLC0415
    from benchmarks.compare.measure import evaluation_options  # noqa: PLC0415
    from benchmarks.compare.method import Family, Method  # noqa: PLC0415
    from benchmarks.compare.scene import Scene  # noqa: PLC0415

    def run(method, scene, *_):
        return Outcome(None, False, method.load()(Scene.read(scene)), 1.0)

    monkeypatch.setattr(module, "run_isolated", run)
    method = Method("peer", Family[family], lambda: removal)
    options = evaluation_options(0)
    return module.Comparison([method], Limits(60, 4), options, folder, crossing=crossing)


def test_a_peer_that_finds_nothing_where_it_must_is_not_compared(crossing, tmp_path, monkeypatch):
    def finds_nothing(scene):
        return np.zeros(len(scene), dtype=bool)

    comparison = comparison_of(finds_nothing, crossing, tmp_path, monkeypatch)
    (result,) = comparison.on(crossing)
    assert "finds 0% of a thing that crosses" in result.skipped
    assert not result.figures


def test_a_peer_with_the_map_only_must_find_points_that_are_alone(crossing, tmp_path, monkeypatch):
    def takes_the_first(scene):
        return np.arange(len(scene)) < 10

    comparison = comparison_of(takes_the_first, crossing, tmp_path, monkeypatch, "MAP")
    (result,) = comparison.on(crossing)
    assert "finds 0% of single points above a dense floor" in result.skipped


def test_among_strays_all_but_the_floor_is_alone():
    from scipy.spatial import KDTree  # noqa: PLC0415

    from benchmarks.compare.data.strays import strays_scene  # noqa: PLC0415
    from pipeline.evaluation.truth import Truth  # noqa: PLC0415

    scene = strays_scene()
    strays = scene.labels == Truth.DYNAMIC
    distances, _ = KDTree(scene.xyz).query(scene.xyz, k=17)
    assert distances[strays, 1].min() > 0.9
    assert distances[~strays, 16].max() < 0.2
    assert 50 < strays.sum() < 0.01 * len(scene)


def test_dbscan_works_where_it_must(crossing, tmp_path, monkeypatch):
    from benchmarks.compare.peers import dbscan  # noqa: PLC0415

    (method,) = dbscan.METHODS
    comparison = comparison_of(method.load(), crossing, tmp_path, monkeypatch, "MAP")
    from benchmarks.compare.data.strays import strays_scene  # noqa: PLC0415

    (result,) = comparison.on(strays_scene())
    assert result.skipped is None
    assert result.figures["recall"] == 100


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
    assert slow.skipped == "more than 0.01 s" and slow.exhausted


def test_a_row_is_over_all_its_scenes_that_were_not_skipped():
    from benchmarks.compare.results import Result, row_of  # noqa: PLC0415

    def result(scene, value, skipped=None):
        figures = {"SA": value, "DA": None, "MAE": 1.0}
        return Result("m", "ours", scene, "g", 10, skipped, False, figures)

    row = row_of([result("a", 90.0), result("b", 80.0)])
    assert row.figures == {"SA": (85.0, 80.0, 90.0), "DA": None, "MAE": (1.0, 1.0, 1.0)}
    assert row.scenes == 2
    row = row_of([result("a", 90.0), Result("m", "ours", "b", "g", 10, "too slow", True, {})])
    assert row.figures == {"SA": (90.0, 90.0, 90.0), "DA": None, "MAE": (1.0, 1.0, 1.0)}
    assert (row.scenes, row.missing, row.skipped) == (2, 1, "too slow")
    assert row_of([result("b", 1.0, "too slow")]).figures == {}


def test_tables_tell_means_and_ranges():
    from benchmarks.compare.results import COLUMNS, Result  # noqa: PLC0415
    from benchmarks.compare.tables import tables  # noqa: PLC0415

    timed = dict.fromkeys([*COLUMNS, "removed %", "s", "µs a point"], 1.0)
    results = [
        Result("m", "ours", scene, "g", 10, None, False, timed | {"SA": sa, "DA": None})
        for scene, sa in (("a", 90.0), ("b", 80.0))
    ]
    lines = tables(results).splitlines()
    assert "20 points: a; b." in lines
    assert "| m | ours | 2 | 85.0 (80.0 to 90.0) | - | 1.0 | 1.0 | 1.0 | 1.0 | 1.0 |" in lines
    failed = Result("m", "ours", "c", "g", 10, "too slow", True, {})
    never = Result("n", "ours", "c", "g", 10, "not installed", False, {})
    lines = tables([*results, failed, never]).splitlines()
    assert "| m | ours | 2 of 3 | 85.0 (80.0 to 90.0) | - | 1.0 | 1.0 | 1.0 | 1.0 | 1.0 |" in lines
    assert "- m on 1 of 3 scenes: too slow" in lines
    assert "- n: not installed" in lines


def test_what_is_always_there_is_static_and_what_passes_is_not():
    from benchmarks.compare.data.occupancy import labels_by_occupancy  # noqa: PLC0415
    from pipeline.evaluation.truth import Truth  # noqa: PLC0415

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


def test_what_is_finished_is_reused_and_what_is_not_is_done(crossing, tmp_path, monkeypatch):
    from benchmarks.compare import comparison as module  # noqa: PLC0415
    from benchmarks.compare.isolated import Limits, Outcome  # noqa: PLC0415
    from benchmarks.compare.measure import evaluation_options  # noqa: PLC0415
    from benchmarks.compare.method import Family, Method  # noqa: PLC0415
    from benchmarks.compare.record import Record  # noqa: PLC0415

    outcomes = {
        "works": Outcome(None, False, np.asarray(crossing.labels == 1), 1.0),
        "too slow": Outcome.skip("more than 1 s", exhausted=True),
        "missing": Outcome.skip("not installed"),
    }
    done = []

    def run(method, *_):
        done.append(method.name)
        return outcomes[method.name]

    monkeypatch.setattr(module, "run_isolated", run)
    methods = [Method(name, Family.OURS, lambda: None) for name in outcomes]

    def names_done(scene=crossing, seconds=1.0, methods=methods):
        done.clear()
        record = Record.resume(tmp_path / "figures.json")
        limits, options = Limits(seconds, 4), evaluation_options(0)
        results = list(module.Comparison(methods, limits, options, tmp_path, record).on(scene))
        assert [each.skipped for each in results] == [None, "more than 1 s", "not installed"]
        return list(done)

    assert names_done() == list(outcomes)
    assert names_done() == ["missing"]
    assert names_done(seconds=2.0) == list(outcomes)
    moved = replace(crossing, xyz=crossing.xyz + 1e-9)
    assert names_done(scene=moved) == list(outcomes)
    changed = [replace(method, parameters="k=50") for method in methods]
    assert names_done(methods=changed) == list(outcomes)
    newer = [replace(method, version=lambda: "peer 2.0") for method in methods]
    assert names_done(methods=newer) == list(outcomes)
    assert len(json.loads((tmp_path / "figures.json").read_text(encoding="utf-8"))) == 15


def test_versions_are_those_of_what_is_installed():
    from importlib.metadata import version  # noqa: PLC0415

    from benchmarks.compare.method import versions_of  # noqa: PLC0415
    from benchmarks.compare.registry import all_methods  # noqa: PLC0415

    assert versions_of("numpy", "no-such-package")() == f"numpy {version('numpy')}"
    told = {method.name: method.version() for method in all_methods()}
    assert "scikit-learn" in next(each for name, each in told.items() if name.startswith("DBSCAN"))


def test_a_file_that_is_no_record_is_refused(tmp_path):
    from benchmarks.compare.record import Record  # noqa: PLC0415

    file = tmp_path / "figures.json"
    file.write_text('[{"method": "m"}]', encoding="utf-8")
    with pytest.raises(ValueError, match=r"figures.json: expected results of a comparison"):
        Record.resume(file)


@pytest.mark.skipif(which("pdal") is None, reason="the program pdal is absent")
def test_pdal_removes_what_its_definition_says(crossing):
    from benchmarks.compare.peers.pdal_outliers import METHODS  # noqa: PLC0415

    removed = METHODS[0].load()(crossing)
    xyz = np.round(crossing.xyz, 4)
    distances = cKDTree(xyz).query(xyz, k=9)[0][:, 1:].mean(axis=1)
    far = distances > distances.mean() + 2 * distances.std(ddof=1)
    # A point on the threshold may fall to either side by the rounding of LAS.
    assert removed.sum() > 0 and np.count_nonzero(removed != far) <= 3


def test_scenes_of_the_first_seed_come_first():
    from benchmarks.compare.data import scene_makers  # noqa: PLC0415

    names = ["simulated-indoor", "street-64", "simulated-street"]
    makers = scene_makers(names, [3, 4], [], Path())
    told = [(make.func.__name__, *make.args[1:2]) for make in makers]
    simulated, recorded = "simulated_scene", "street_scene"
    assert told == [(simulated, 3), (recorded,), (simulated, 3), (simulated, 4), (simulated, 4)]


def test_halves_of_the_street_are_maps_of_their_own(tmp_path):
    from benchmarks.compare.data import recorded  # noqa: PLC0415
    from pipeline.evaluation.truth import Truth  # noqa: PLC0415

    points = laspy.LasData(laspy.LasHeader(version="1.4", point_format=6))
    random = np.random.default_rng(0)
    points.xyz = random.uniform(-50, 50, (1000, 3)).round(1)
    points.point_source_id = random.permutation(np.arange(1000) % 77)
    points.user_data = random.integers(0, 3, 1000)
    points.write(tmp_path / "street_64beam_labelled.las")
    # Without compression, under the name that is looked for.
    (tmp_path / "street_64beam_labelled.las").rename(tmp_path / "street_64beam_labelled.laz")
    poses = np.tile(np.eye(3, 4), (77, 1, 1))
    poses[:, 0, 3] = np.arange(77)
    np.savetxt(tmp_path / "street_64beam_labelled.poses.txt", poses.reshape(77, 12))

    halves = recorded.first_half_of_street(tmp_path), recorded.second_half_of_street(tmp_path)
    for half, first, last in zip(halves, (0, 38), (37, 76), strict=True):
        here = (points.point_source_id >= first) & (points.point_source_id <= last)
        assert np.array_equal(half.xyz, points.xyz[here])
        assert np.array_equal(half.scan + first, points.point_source_id[here])
        assert half.poses[0, 0, 3] == first and half.poses[-1, 0, 3] == last
        # Labels beyond 40 m of the half's own path do not count.
        from_path = half.xyz[:, 0] - np.clip(half.xyz[:, 0].round(), first, last)
        near = np.hypot(from_path, half.xyz[:, 1]) <= 40
        assert not near.all()
        assert np.array_equal(half.labels != Truth.UNKNOWN, near & (points.user_data[here] != 0))
