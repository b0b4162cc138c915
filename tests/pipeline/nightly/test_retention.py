"""What old results are removed; the last good one never is."""

import os

from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.nightly.results import MapFolder, remove_old_runs
from pipeline.nightly.settings import Retention
from pipeline.outputs.folder_lock import locked_folder

DAY = 86400.0
NOW = 1e9 + 100 * DAY


def make(folder, age, key, *, finished=True):
    run = folder.new(f"{key:016x}", NOW - age * DAY)
    run.mkdir(parents=True)
    (run / ".dynahull-work").mkdir()
    if finished:
        (run / "run.json").write_text("{}")
    return run


def left(folder, keep, wanted=None, *, work_may_go_on=False):
    remove_old_runs(folder, keep, NOW, wanted, work_may_go_on=work_may_go_on)
    return [int(run.name[-16:], 16) for run in folder.runs()]


def test_the_last_and_the_young_stay(tmp_path):
    folder = MapFolder(tmp_path / "map")
    for age in (40, 30, 20, 10, 1):
        make(folder, age, age)
    assert left(folder, Retention(runs=1, days=25)) == [20, 10, 1]
    assert left(folder, Retention(runs=2, days=None)) == [10, 1]
    assert left(folder, Retention(runs=1, days=0)) == [1]
    assert left(folder, Retention(runs=1, days=0)) == [1]


def test_what_latest_points_to_stays_however_old(tmp_path):
    folder = MapFolder(tmp_path / "map")
    old = make(folder, 50, 1)
    for age in (3, 2):
        make(folder, age, age)
    folder.point_latest(old)
    assert left(folder, Retention(runs=1, days=None)) == [1, 2]


def test_unfinished_work_stays_only_where_it_goes_on(tmp_path):
    folder = MapFolder(tmp_path / "map")
    make(folder, 50, 1)
    make(folder, 3, 2, finished=False)
    make(folder, 2, 3, finished=False)
    keep = Retention(runs=1, days=10)
    assert left(folder, keep, work_may_go_on=True) == [1, 2, 3]
    assert left(folder, keep, f"{3:016x}") == [1, 3]
    assert left(folder, keep) == [1]


def test_what_somebody_works_on_stays(tmp_path):
    folder = MapFolder(tmp_path / "map")
    run = make(folder, 50, 1, finished=False)
    with locked_folder(run):
        assert left(folder, Retention()) == [1]
    assert left(folder, Retention()) == []


def test_nothing_else_is_ever_removed(tmp_path):
    folder = MapFolder(tmp_path / "map")
    make(folder, 1, 1)
    others = [folder.path / name for name in ("notes", "2026-01-01T00-00-00Z-x", "kept-by-hand")]
    for other in others:
        other.mkdir()
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    link = folder.path / folder.new("f" * 16, 0.0).name
    link.symlink_to(elsewhere)
    left(folder, Retention(runs=1, days=0))
    assert all(each.is_dir() for each in [*others, elsewhere, link])


def test_a_removal_that_was_cut_off_is_finished(tmp_path, monkeypatch):
    folder = MapFolder(tmp_path / "map")
    run = make(folder, 1, 1)
    monkeypatch.setattr("pipeline.nightly.results.shutil.rmtree", lambda *_, **__: None)
    folder.remove(run)
    monkeypatch.undo()
    assert folder.runs() == []
    assert len(os.listdir(folder.path)) == 1  # noqa: PTH208
    folder.remove_leftovers()
    assert list(folder.path.iterdir()) == []


@settings(deadline=None)  # it is about files
@given(
    ages=st.lists(st.integers(0, 60), min_size=1, max_size=8, unique=True),
    finished=st.lists(st.booleans(), min_size=8, max_size=8),
    runs=st.integers(1, 4),
    days=st.none() | st.integers(0, 60),
    pointed=st.integers(0, 7),
)
def test_the_last_good_result_is_never_removed(
    ages, finished, runs, days, pointed, tmp_path_factory
):
    folder = MapFolder(tmp_path_factory.mktemp("map"))
    made = [
        make(folder, age, age, finished=done) for age, done in zip(ages, finished, strict=False)
    ]
    whole = folder.finished()
    if whole:
        folder.point_latest(whole[pointed % len(whole)])
    latest = folder.latest()
    for _ in range(2):
        remove_old_runs(folder, Retention(runs=runs, days=days), NOW, None, work_may_go_on=False)
        assert folder.latest() == latest
        assert folder.finished()[-runs:] == whole[-runs:]
    assert not [run for run in made if run not in whole and run.exists()]
