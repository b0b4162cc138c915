"""Evaluations in tiles: the same figures however the maps are cut, in bounded memory and disk."""

import json
import subprocess
import sys
import tempfile

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dynahull.observer import SilentObserver
from pipeline.errors import DiskSpaceError, EvaluationError
from pipeline.evaluation import tiled_cloud
from pipeline.evaluation.evaluation import evaluate
from pipeline.evaluation.inputs import EvaluationOptions, find_inputs
from pipeline.progress import LogDisplay, StageObserver


def figures_of(cleaned, truth, original=None, observer=None, **options):
    options = EvaluationOptions(**{"emd_points": 0, **options})
    inputs = find_inputs(str(cleaned), str(truth), original and str(original), options)
    return evaluate(inputs, options, observer or SilentObserver())


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    """A folder of its own for temporary files."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


@settings(
    deadline=None, max_examples=12, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(st.integers(0, 2**32 - 1), st.integers(2, 300), st.booleans())
def test_no_figure_depends_on_how_the_maps_are_cut(tmp_path, seed, count, by_labels):
    random = np.random.default_rng(seed)
    # Tenths, so that points are equally near; in two places, and with ghosts of their own.
    original = random.integers(0, 15, (count, 3)) * 0.1 + random.integers(0, 2, (count, 1)) * 30
    moved, kept = random.random(count) < 0.4, random.random(count) < 0.7
    moved[:2], kept[:2] = [False, True], True
    cleaned = original[kept] + (random.random((kept.sum(), 1)) < 0.1) * 0.05
    np.save(tmp_path / "original.npy", original)
    np.save(tmp_path / "cleaned.npy", cleaned)
    np.save(tmp_path / "truth.npy", original[~moved])
    pq.write_table(pa.table({"moving": moved}), tmp_path / "truth.parquet")
    truth = tmp_path / ("truth.parquet" if by_labels else "truth.npy")
    found = []
    for most in (1_000_000, 100, 10):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(tiled_cloud, "TILE_POINTS", most)
            patch.setattr(tiled_cloud, "BATCH", most)
            maps = tmp_path / "cleaned.npy", truth, tmp_path / "original.npy"
            found.append(figures_of(*maps, emd_points=20))
    assert found[0].scores is not None
    assert found[1] == found[0]
    assert found[2] == found[0]


def test_points_far_beyond_all_others_are_compared_like_them(tmp_path):
    xyz = np.random.default_rng(0).uniform(size=(50, 3))
    xyz[0], xyz[1] = [1e20, 0, 0], [0, -3e140, 1e150]
    np.save(tmp_path / "map.npy", xyz)
    np.save(tmp_path / "cleaned.npy", xyz[1:])
    pq.write_table(pa.table({"moving": np.arange(50) == 0}), tmp_path / "truth.parquet")
    maps = tmp_path / "cleaned.npy", tmp_path / "truth.parquet", tmp_path / "map.npy"
    found = figures_of(*maps, emd_points=5)
    assert found.geometry.distances.largest == 0
    assert found.scores.confusion.f1 == 100
    assert found.scores.preservation.rejection_rate == 100


@pytest.fixture
def walls(tmp_path):
    """A map, what is left of it, and both of them a million metres away."""
    xyz = np.random.default_rng(0).uniform(size=(200, 3))
    for name, points in (("map", xyz), ("cleaned", xyz[:150])):
        np.save(tmp_path / f"{name}.npy", points)
        np.save(tmp_path / f"{name}_away.npy", points + [0, 1e6, 0])
    pq.write_table(pa.table({"moving": np.arange(200) >= 140}), tmp_path / "labels.parquet")
    return tmp_path


def warnings_of(*maps):
    observer = StageObserver(LogDisplay())
    figures_of(*maps, observer=observer)
    return observer.warnings


def test_maps_of_different_places_are_named(walls):
    cleaned, away = walls / "cleaned.npy", walls / "map_away.npy"
    (warning,) = warnings_of(cleaned, away)
    assert "cleaned.npy lies 999999 m from" in warning
    assert "map_away.npy: are they in the same coordinates?" in warning
    (warning,) = warnings_of(cleaned, walls / "labels.parquet", away)
    assert "away.npy: is that the map that was cleaned, in the same coordinates?" in warning
    with pytest.raises(EvaluationError, match=r"a map of the same place .* found it 999999"):
        figures_of(cleaned, away, walls / "map.npy")
    assert warnings_of(cleaned, walls / "map.npy") == []
    assert warnings_of(walls / "cleaned_away.npy", walls / "labels.parquet", away) == []


def left_in(temporary):
    """All that is there, but the folder of this process, which goes with it."""
    return [each for each in temporary.rglob("*") if not each.name.startswith("dynahull-")]


def test_temporary_files_are_gone_after_success_and_failure(walls, temporary, monkeypatch):
    cleaned = walls / "cleaned.npy"
    figures_of(cleaned, walls / "labels.parquet", walls / "map.npy")
    assert left_in(temporary) == []
    with pytest.raises(EvaluationError):
        figures_of(cleaned, walls / "map_away.npy", walls / "map.npy")
    assert left_in(temporary) == []
    seen = []

    def fail(*_):
        seen.extend(temporary.rglob("*.xyz"))
        raise KeyboardInterrupt

    monkeypatch.setattr("pipeline.evaluation.evaluation.compare_geometry", fail)
    with pytest.raises(KeyboardInterrupt):
        figures_of(cleaned, walls / "map.npy")
    assert seen
    assert left_in(temporary) == []


def test_more_than_the_disk_holds_is_refused_before_the_work(walls, temporary, monkeypatch):
    usage = type("Usage", (), {"free": 10_000})
    monkeypatch.setattr("pipeline.plan.resources.shutil.disk_usage", lambda _: usage)
    with pytest.raises(
        DiskSpaceError, match=r"temporary/\S+: .* 16\.5 KiB of temp.* \(TMPDIR names"
    ):
        figures_of(walls / "cleaned.npy", walls / "map.npy")


def test_memory_does_not_grow_with_the_map(tmp_path):
    peaks = {}
    for count in (200_000, 600_000):
        random = np.random.default_rng(0)
        # High rather than wide: the survey has a bound of its own, by the columns occupied.
        xyz = random.uniform(size=(count, 3)) * [count / 30_000, 10, 30]
        moved = random.random(count) < 0.1
        np.save(tmp_path / "map.npy", xyz)
        np.save(tmp_path / "cleaned.npy", xyz[random.random(count) < np.where(moved, 0.3, 0.95)])
        pq.write_table(pa.table({"moving": moved}), tmp_path / "truth.parquet")
        script = (
            "from pipeline.evaluation import tiled_cloud\n"
            "tiled_cloud.TILE_POINTS, tiled_cloud.BATCH = 40_000, 20_000\n"
            "from pipeline.commands.app import main; main()"
        )
        files = {name: str(tmp_path / name) for name in ("cleaned.npy", "map.npy", "all.json")}
        command = [
            sys.executable, "-c", script, "evaluate", files["cleaned.npy"],
            "--original", files["map.npy"], "--truth", str(tmp_path / "truth.parquet"),
            "--emd-points", "0", "--json", files["all.json"],
        ]  # fmt: skip
        subprocess.run(command, check=True, capture_output=True, timeout=300)
        report = json.loads((tmp_path / "all.json").read_text(encoding="utf-8"))
        peaks[count] = report["peak_memory_bytes"]
    # Of 400,000 points more, not two thirds of their coordinates.
    assert peaks[600_000] - peaks[200_000] < 16 * 400_000, peaks
