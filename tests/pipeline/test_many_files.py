"""A map of many small files: what is done for each of them does not grow with the others."""

import sys
from collections import Counter

import numpy as np
import pytest

from pipeline.configuration.run import load_configuration
from pipeline.progress import LogDisplay, StageObserver
from pipeline.run import run
from pipeline.work import job

pytestmark = pytest.mark.usefixtures("nothing_waits_for_the_disk")

POINTS = 12
WANTED = [
    "neighbours.k=8",
    "clustering.count=1",
    "ground.method=none",
    "execution.cluster=none",
]
_counts: Counter[str] = Counter()
_counting: list[bool] = []


def _count(event, _arguments):
    if _counting and event == "open":
        _counts["opened"] += 1


sys.addaudithook(_count)  # none can be taken away again


def pcd(points: np.ndarray) -> str:
    head = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
    rows = "".join(f"{x:.3f} {y:.3f} {z:.3f}\n" for x, y, z in points)
    return f"{head}WIDTH {len(points)}\nHEIGHT 1\nPOINTS {len(points)}\nDATA ascii\n{rows}"


def work(folder, files, suffix, max_points, monkeypatch):
    """Clean a map of so many files; count files opened, and looked at for changes."""
    points = np.random.default_rng(0).uniform(0, 5, (files, POINTS, 3))
    maps = folder / f"{files}"
    maps.mkdir()
    for number, of_file in enumerate(points):
        if suffix == ".npy":
            np.save(maps / f"{number}.npy", of_file)
        else:
            (maps / f"{number}.pcd").write_text(pcd(of_file))
    state_of = job._state_of
    _counts.clear()

    def counted(status):
        _counts["looked at"] += 1
        return state_of(status)

    configuration = load_configuration(None, [*WANTED, f"tiling.max_points={max_points}"])
    _counting.append(True)
    with monkeypatch.context() as patch:
        patch.setattr(job, "_state_of", counted)
        report = run([maps], folder / f"out{files}", configuration, StageObserver(LogDisplay()))
    _counting.clear()
    assert sum(report.counts.values()) == files * POINTS
    return Counter(_counts)


@pytest.mark.parametrize("suffix", [".npy", ".pcd"])
@pytest.mark.parametrize("in_tiles", [True, False])
def test_twice_the_files_are_twice_the_work(tmp_path, monkeypatch, suffix, in_tiles):
    few, many = (
        work(tmp_path, files, suffix, files * POINTS // 4 if in_tiles else 10**6, monkeypatch)
        for files in (40, 80)
    )
    for kind, count in many.items():
        assert count < 2.2 * few[kind] + 20, (kind, few, many)
