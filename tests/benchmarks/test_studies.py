"""The parameter studies: what they measure, on points whose answer is known."""

from pathlib import Path

import numpy as np
import pytest

from dynahull import MethodParameters, clean

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(autouse=True)
def _benchmarks_are_importable(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT))


@pytest.fixture
def wall_and_ghost():
    """Four points of a wall, 1 m apart; one ghost on it, one 2 m away."""
    from benchmarks.studies.labelled import LabelledMap  # noqa: PLC0415

    xyz = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0], [1, 0.04, 0], [1, 2, 0.0]])
    return LabelledMap(xyz, np.array([0, 0, 0, 0, 1, 1], np.int8), np.array([0, 0, 0, 0, 0.04, 2]))


def test_distances_and_accuracy_are_those_of_what_is_kept(wall_and_ghost):
    from pipeline.evaluation.truth import Truth  # noqa: PLC0415

    assert (Truth.STATIC, Truth.DYNAMIC) == (0, 1)
    kept = np.array([1, 1, 1, 0, 1, 0], np.bool_)
    mean, variance = wall_and_ghost.distances(kept)
    assert mean == pytest.approx(10) and variance == pytest.approx(300)
    accuracy = wall_and_ghost.accuracy(kept)
    assert accuracy.static_accuracy == 75 and accuracy.dynamic_accuracy == 50
    kept[1] = kept[4] = False  # their neighbour 4 cm away is gone too
    assert wall_and_ghost.accuracy(kept).static_accuracy == 50


def test_other_bounds_keep_what_a_run_with_them_keeps():
    from benchmarks.studies.parameters import _kept  # noqa: PLC0415

    points = np.random.default_rng(0).normal(size=(3_000, 3)) ** 3
    cleaned = clean(points, MethodParameters())
    for low, high in ((0.0, 30.0), (10.0, 10.0)):
        bounds = {"removal": {"min_percent": low, "max_percent": high}}
        assert (_kept(cleaned, low, high) == clean(points, bounds).kept).all()


def test_all_studies_print_their_tables_and_draw_their_plots(tmp_path, monkeypatch, capsys):
    from benchmarks.studies import __main__ as studies  # noqa: PLC0415

    monkeypatch.setattr(studies, "NEIGHBOURS", (10, 20))
    monkeypatch.setattr(studies, "CLUSTERS", (1, 2))
    monkeypatch.setattr(studies, "RANGES", ((0.0, 10.0), (5.0, 20.0)))
    picture = tmp_path / "studies.svg"
    small = ["--seeds", "0", "1", "--set", "scans=60", "rotations_per_scan=10"]
    studies.main([*small, "--picture", str(picture)])
    lines = capsys.readouterr().out.splitlines()
    tables = [lines.index(line) for line in lines if line.startswith("|---")]
    # Heading, and a row for each choice.
    assert [line.split("|")[1].strip() for line in lines if line.startswith("| ")] == [
        "clusters", "1", "2", "smallest, %", "0", "5", "k", "10", "20",
    ]  # fmt: skip
    assert len(tables) == 3
    removed = [float(lines[tables[0] + row].split("|")[4]) for row in (1, 2)]
    assert 0 < removed[0] <= 5, "one cluster: the least share, of what is not ground"
    assert "</svg>" in picture.read_text(encoding="utf-8")
    studies.main([*small, "--picture", str(tmp_path / "again.png")])
    assert (tmp_path / "again.png").read_bytes().startswith(b"\x89PNG")
