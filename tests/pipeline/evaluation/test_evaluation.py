"""Whole evaluations, from files, against a plain evaluation over all pairs of points."""

import json
import subprocess
import sys

import laspy
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pipeline.configuration.run import load_configuration
from pipeline.errors import (
    ConfigurationError,
    EvaluationError,
    OutputError,
)
from pipeline.evaluation.evaluation import evaluate
from pipeline.evaluation.inputs import EvaluationOptions, find_inputs
from pipeline.evaluation.report import evaluate_files
from pipeline.progress import LogDisplay, StageObserver
from pipeline.run import run
from tiling.errors import MapFormatError

COMMAND = [
    sys.executable,
    "-c",
    "from pipeline.commands.app import main; main()",
    "evaluate",
]
NO_TRANSPORT = EvaluationOptions(emd_points=0)


def figures_of(cleaned, truth, original=None, **options):
    options = EvaluationOptions.checked(**{"emd_points": 0, **options})
    inputs = find_inputs(str(cleaned), str(truth), original and str(original), options)
    observer = StageObserver(LogDisplay())
    return evaluate(inputs, options, observer), observer.warnings


def nearest(first, second):
    return np.sqrt(((first[:, np.newaxis] - second) ** 2).sum(axis=2)).min(axis=1)


@settings(
    deadline=None, max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(st.integers(0, 2**32 - 1))
def test_an_evaluation_is_that_of_all_pairs(tmp_path, seed):
    random = np.random.default_rng(seed)
    original = random.uniform(0, 1, (60, 3))
    original[random.integers(0, 60, 3)] = np.nan
    moved, kept = random.random(60) < 0.3, random.random(60) < 0.7
    finite = np.isfinite(original).all(axis=1)
    moved[np.flatnonzero(finite)[:2]] = False, True
    kept[np.flatnonzero(finite)[:2]] = True
    np.save(tmp_path / "original.npy", original)
    np.save(tmp_path / "cleaned.npy", original[kept])
    np.save(tmp_path / "truth.npy", original[~moved])
    pq.write_table(pa.table({"moving": moved}), tmp_path / "labels.parquet")
    for truth in ("truth.npy", "labels.parquet"):
        found, warnings = figures_of(
            tmp_path / "cleaned.npy", tmp_path / truth, tmp_path / "original.npy",
            match_distance=0.1,
        )  # fmt: skip
        assert warnings == []
        points, static = original[kept & finite], original[~moved & finite]
        there, back = nearest(points, static), nearest(static, points)
        geometry, scores = found.geometry, found.scores
        assert geometry.distances.mean_absolute_error == pytest.approx(there.mean())
        assert geometry.distances.variance == pytest.approx(there.var())
        assert geometry.chamfer.squared == pytest.approx((there**2).mean() + (back**2).mean())
        assert geometry.earth_mover is None
        counts = scores.confusion
        assert counts.true_positives == np.count_nonzero(finite & moved & ~kept)
        assert counts.false_positives == np.count_nonzero(finite & ~moved & ~kept)
        assert counts.false_negatives == np.count_nonzero(finite & moved & kept)
        assert counts.true_negatives == np.count_nonzero(finite & ~moved & kept)
        matched = nearest(original[finite], points) <= 0.1
        sa = 100 * matched[~moved[finite]].mean()
        da = 100 * (~matched[moved[finite]]).mean()
        assert scores.accuracy.static_accuracy == pytest.approx(sa)
        assert scores.accuracy.dynamic_accuracy == pytest.approx(da)


@pytest.fixture
def scene(tmp_path):
    """A wall, a ghost beside it, and a floor that nobody labelled; the ghost is removed, but for
    one point, and so is a piece of the wall.
    """
    random = np.random.default_rng(1)
    wall = random.uniform(size=(300, 3)) * [4, 0.02, 2]
    ghost = random.uniform(size=(60, 3)) * 0.6 + [1, 1.5, 0.2]
    floor = random.uniform(size=(200, 3)) * [4, 4, 0.01] - [0, 0, 3]
    xyz = np.round(np.vstack([wall, ghost, floor]), 3)
    labels = np.repeat([1, 2, 0], [300, 60, 200]).astype(np.uint8)
    removed = np.zeros(560, dtype=bool)
    removed[280:359] = True
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = [0.001] * 3, [0.0] * 3
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = xyz.T
    cloud.user_data = labels
    cloud.write(tmp_path / "labelled.laz")
    np.save(tmp_path / "cleaned.npy", xyz[~removed])
    np.save(tmp_path / "static.npy", xyz[labels != 2])
    return tmp_path


def test_labels_in_a_field_of_the_original(scene):
    found, warnings = figures_of(
        scene / "cleaned.npy", scene / "labelled.laz",
        labels="user_data", dynamic="2", unlabelled="0",
    )  # fmt: skip
    assert warnings == []
    counts = found.scores.confusion
    assert (counts.true_positives, counts.false_positives) == (59, 20)
    assert (counts.false_negatives, counts.true_negatives) == (1, 280)
    # The floor, three metres below, is compared with nothing.
    assert found.geometry.distances.count == 281
    assert found.geometry.distances.largest < 2.5
    assert found.scores.preservation.dynamic_voxels > 5
    assert found.scores.preservation.rejection_rate > 80


def test_a_truth_recorded_apart_needs_a_tolerance(scene):
    static = np.load(scene / "static.npy")
    apart = static + np.random.default_rng(0).normal(scale=0.005, size=static.shape)
    np.save(scene / "apart.npy", apart)
    arguments = scene / "cleaned.npy", scene / "apart.npy", scene / "labelled.laz"
    with pytest.raises(EvaluationError, match="expected points that are static in truth"):
        figures_of(*arguments)
    found, warnings = figures_of(*arguments, truth_tolerance=0.03)
    assert warnings == []
    assert found.scores.confusion.true_positives == 59
    assert found.scores.confusion.false_positives == 20


def test_a_truth_that_the_original_hardly_holds_is_warned_about(scene):
    static = np.load(scene / "static.npy")
    np.save(scene / "elsewhere.npy", np.concatenate([static, static[:480] + 50]))
    arguments = scene / "cleaned.npy", scene / "elsewhere.npy", scene / "labelled.laz"
    assert figures_of(*arguments)[1] == []
    np.save(scene / "elsewhere.npy", np.concatenate([static, static + 50, static[:100] + 90]))
    (warning,) = figures_of(*arguments)[1]
    assert "--truth-tolerance" in warning


def test_a_thinned_out_map_is_warned_about(scene):
    cleaned = np.load(scene / "cleaned.npy")
    np.save(scene / "thin.npy", cleaned[::3] + 0.004)
    _, warnings = figures_of(scene / "thin.npy", scene / "static.npy", scene / "labelled.laz")
    assert any("--cleaned-tolerance" in warning for warning in warnings)


def test_without_the_original_only_distances(scene):
    found, warnings = figures_of(scene / "static.npy", scene / "static.npy")
    assert found.scores is None
    assert warnings == []
    assert found.geometry.distances.largest == 0
    assert found.geometry.chamfer.squared == 0


def test_the_folder_of_a_run_is_a_cleaned_map(scene):
    settings = ["ground.method=none", "neighbours.k=20", "clustering.count=1", "output.labels=true"]
    configuration = load_configuration("paper", settings)
    original = scene / "labelled.laz"
    report = run([original], scene / "out", configuration, StageObserver(LogDisplay()))
    found, _ = figures_of(scene / "out", scene / "static.npy")
    counts = found.scores.confusion
    assert counts.true_positives + counts.false_positives == report.counts["dynamic"]
    assert counts.true_positives + counts.false_negatives == 60
    (scene / "out" / "labels.parquet").unlink()
    assert figures_of(scene / "out", scene / "static.npy")[0].scores.confusion == counts
    original.unlink()
    report = evaluate_files(str(scene / "out"), str(scene / "static.npy"), None, NO_TRANSPORT)
    assert report.confusion is None
    assert "no longer there" in report.warnings[0]


def test_a_labelled_map_is_evaluated_as_the_static_one_is(scene):
    settings = ["ground.method=none", "neighbours.k=20", "clustering.count=1"]
    found = {}
    for mode in ("split", "label"):
        configuration = load_configuration("paper", [*settings, f"output.mode={mode}"])
        run([scene / "labelled.laz"], scene / mode, configuration, StageObserver(LogDisplay()))
        found[mode], _ = figures_of(scene / mode, scene / "static.npy")
    for name in ("confusion", "accuracy", "preservation"):
        one, other = (getattr(found[mode].scores, name) for mode in ("label", "split"))
        assert one == other
    assert found["label"].scores.confusion.true_positives > 0
    assert found["label"].geometry == found["split"].geometry
    (scene / "labelled.laz").unlink()  # the input is not needed for distances
    assert figures_of(scene / "label", scene / "static.npy")[0].geometry == found["split"].geometry


def test_the_command_prints_and_writes_all_figures(scene):
    command = [
        *COMMAND, "cleaned.npy", "--truth", "labelled.laz", "--labels", "user_data",
        "--dynamic", "2", "--unlabelled", "0", "--json", "all.json", "--picture", "all.png",
        "--emd-points", "100", "--ground-cost", "sqeuclidean", "--seed", "7",
    ]  # fmt: skip
    done = subprocess.run(
        command, check=False, capture_output=True, text=True, timeout=120, cwd=scene
    )
    assert done.returncode == 0, done.stderr
    report = json.loads((scene / "all.json").read_text(encoding="utf-8"))
    assert report["confusion"]["true_positives"] == 59
    assert report["earth_mover"]["ground_cost"] == "sqeuclidean"
    assert (report["earth_mover"]["cleaned_points"], report["earth_mover"]["seed"]) == (100, 7)
    assert report["options"]["voxel"] == 0.2
    assert report["peak_memory_bytes"] > 1e6
    for shown in ("MAE", "variance", "RMSE", "90th percentile", "Chamfer", "EMD", "precision"):
        assert shown in done.stdout
    for shown in ("SA", "DA", "AA", "HA", "preservation rate", "rejection rate", "100, 100"):
        assert shown in done.stdout
    assert f"{report['accuracy']['associated_accuracy']:.2f}" in done.stdout
    assert (scene / "all.png").read_bytes().startswith(b"\x89PNG")
    assert "\x1b" not in done.stdout


def test_the_same_seed_gives_the_same_distance(scene):
    first, second, other = (
        figures_of(scene / "cleaned.npy", scene / "static.npy", emd_points=50, seed=seed)[0]
        for seed in (1, 1, 2)
    )
    assert first.geometry.earth_mover == second.geometry.earth_mover
    assert first.geometry.earth_mover.distance != other.geometry.earth_mover.distance


def test_without_the_extra_packages_all_else_is_measured(scene, monkeypatch):
    monkeypatch.setitem(sys.modules, "ot", None)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    report = evaluate_files(
        str(scene / "cleaned.npy"),
        str(scene / "labelled.laz"),
        None,
        EvaluationOptions.checked(labels="user_data", emd_points=10),
        picture=scene / "a.png",
    )
    assert report.earth_mover is None
    assert report.confusion is not None
    assert [warning.split(" needs ")[1].split(":")[0] for warning in report.warnings] == [
        "Matplotlib", "POT",
    ]  # fmt: skip
    assert "precision" in report.confusion.summary()


def test_what_does_not_fit_together_is_one_line(scene):
    cleaned = scene / "cleaned.npy"
    pq.write_table(pa.table({"moving": [True, False]}), scene / "short.parquet")
    with pytest.raises(EvaluationError, match="give it by --original"):
        figures_of(cleaned, scene / "short.parquet")
    with pytest.raises(EvaluationError, match=r"labels of the 560 points of .*, found 2"):
        figures_of(cleaned, scene / "short.parquet", scene / "labelled.laz")
    with pytest.raises(ConfigurationError, match="--original: with --labels"):
        figures_of(cleaned, scene / "labelled.laz", cleaned, labels="user_data")
    with pytest.raises(MapFormatError, match="expected a field 'colour'"):
        figures_of(cleaned, scene / "labelled.laz", labels="colour")
    with pytest.raises(ConfigurationError, match=r"--voxel: .* or equal to 0.000001, found -1"):
        figures_of(cleaned, scene / "static.npy", voxel=-1)
    with pytest.raises(ConfigurationError, match=r"--ground-cost: .*'euclidean' or 'sqeuclidean'"):
        figures_of(cleaned, scene / "static.npy", ground_cost="manhattan")
    np.save(scene / "nothing.npy", np.full((3, 3), np.nan))
    with pytest.raises(EvaluationError, match=r"nothing\.npy: expected finite points"):
        figures_of(scene / "nothing.npy", scene / "static.npy")
    np.save(scene / "empty.npy", np.empty((0, 3)))
    with pytest.raises(EvaluationError, match=r"empty\.npy: expected finite points"):
        evaluate_files(
            str(scene / "empty.npy"), str(scene / "empty.npy"), None, EvaluationOptions()
        )
    with pytest.raises(ConfigurationError, match="--picture: expected --original"):
        evaluate_files(
            str(cleaned), str(scene / "static.npy"), None, NO_TRANSPORT, picture=scene / "a.png"
        )
    with pytest.raises(OutputError, match="expected a folder to write in"):
        evaluate_files(
            str(cleaned), str(cleaned), None, NO_TRANSPORT, json_file=scene / "no" / "a.json"
        )


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"dynamic": "1"}, "--dynamic: .* a map without labels"),
        ({"unlabelled": "0"}, "--unlabelled: .* a map without labels"),
        ({"truth_tolerance": 0.1}, "--truth-tolerance: .* no original map"),
        ({"cleaned_tolerance": 0.1}, "--cleaned-tolerance: .* no original map"),
        ({"match_distance": 0.1}, "--match-distance: .* no original map"),
        ({"voxel": 0.1}, "--voxel: .* no original map"),
        ({"ground_cost": "sqeuclidean"}, "--ground-cost: .*--emd-points 0"),
        ({"seed": 1}, "--seed: .*--emd-points 0"),
    ],
)
def test_an_option_without_effect_is_refused(scene, options, reason):
    with pytest.raises(ConfigurationError, match=reason):
        figures_of(scene / "cleaned.npy", scene / "static.npy", **options)


def test_a_tolerance_of_the_truth_is_refused_beside_labels(scene):
    labels = {"labels": "user_data", "dynamic": "2", "unlabelled": "0"}
    with pytest.raises(ConfigurationError, match=r"--truth-tolerance: .* the truth is labels"):
        figures_of(scene / "cleaned.npy", scene / "labelled.laz", truth_tolerance=0.1, **labels)


@pytest.mark.parametrize(("given", "kind"), [("json_file", ".json"), ("picture", ".png")])
def test_no_map_is_written_over(scene, given, kind):
    cleaned, before = scene / "cleaned.npy", (scene / "cleaned.npy").read_bytes()
    with pytest.raises(OutputError, match=rf"cleaned\.npy: expected a name that ends in \{kind}"):
        evaluate_files(
            str(cleaned), str(scene / "static.npy"), None, NO_TRANSPORT, **{given: cleaned}
        )
    assert cleaned.read_bytes() == before


def test_labels_without_a_point_that_moved_are_warned_about(scene):
    found, warnings = figures_of(scene / "cleaned.npy", scene / "labelled.laz", labels="user_data",
                                 dynamic="9", unlabelled="0")  # fmt: skip
    assert found.scores.confusion.recall is None
    assert found.scores.accuracy.associated_accuracy is None
    assert any("no point moved" in warning for warning in warnings)
