"""What the range images of scans take is planned, and a run that has no room for it is refused."""

import json
from collections import namedtuple

import numpy as np
import pytest

from dynahull.evidence.range_images import HELD_BYTES
from pipeline.configuration.run import load_configuration
from pipeline.errors import DiskSpaceError
from pipeline.metres import open_collection
from pipeline.plan.resources import one_tile_memory
from pipeline.planning import plan_map
from pipeline.progress import LogDisplay, StageObserver
from pipeline.run import run
from pipeline.tiles import cleaning
from pipeline.tiles.stages import TASKS
from pipeline.work.folder import WORK_FOLDER

pytestmark = pytest.mark.usefixtures("nothing_waits_for_the_disk")

COUNT, SCANS = 3000, 200


def write(folder, count=COUNT, scans=SCANS):
    """Write a map whose points have scan numbers, and poses; return the map's path."""
    xyz = np.random.default_rng(0).uniform(size=(count, 3)) * [6, 5, 2]
    np.savez(folder / "map.npz", points=xyz, scan=np.arange(count) * scans // count)
    poses = np.tile(np.eye(3, 4), (scans, 1, 1))
    poses[:, :, 3] = np.linspace([1, 1, 1], [5, 4, 1], scans)
    np.savetxt(folder / "poses.txt", poses.reshape(scans, 12), "%.9g")
    return folder / "map.npz"


def configured(*wanted):
    wanted = ["execution.cluster=none", "tiling.max_points=1000", "neighbours.k=8", *wanted]
    return load_configuration("auto", [*wanted, "ground.method=none", "output.report=none"])


def planned(path, *wanted):
    observer = StageObserver(LogDisplay())
    text, refused = plan_map([str(path)], configured(*wanted), observer, None, as_json=True)
    if refused is not None:
        raise refused
    return json.loads(text)


def has_room(monkeypatch, free):
    usage = namedtuple("usage", "free")(free)
    monkeypatch.setattr("pipeline.plan.resources.shutil.disk_usage", lambda _: usage)


@pytest.mark.parametrize("poses", [True, False])
def test_temporary_files_are_at_most_as_planned(tmp_path, monkeypatch, poses):
    path, peak, plans = write(tmp_path, 30_000), [0], []
    more = ["tiling.max_points=10000"]
    more += [f"input.poses={tmp_path}/poses.txt"] if poses else []

    def measured(task, *arguments):
        done = task(*arguments)
        files = [each for each in (tmp_path / "out" / WORK_FOLDER).rglob("*") if each.is_file()]
        peak[0] = max(peak[0], sum(each.stat().st_size for each in files))
        return done

    for name, task in TASKS.items():
        monkeypatch.setitem(TASKS, name, lambda *given, task=task: measured(task, *given))
    make_plan = cleaning.make_plan
    monkeypatch.setattr(
        cleaning,
        "make_plan",
        lambda *given, **named: plans.append(make_plan(*given, **named)) or plans[0],
    )
    run([path], tmp_path / "out", configured(*more), StageObserver(LogDisplay()))
    assert peak[0] <= plans[0].disk < 1.2 * peak[0]
    figures = planned(path, *more)
    assert figures["temporary_bytes"] == plans[0].disk
    assert figures["worker_memory_bytes"] == plans[0].worker_memory


def test_many_scans_of_few_points_cost_no_more_disk(tmp_path, monkeypatch):
    has_room(monkeypatch, 1 << 50)
    files, memory = [], []
    for scans in (SCANS, 5 * SCANS):
        path = write(tmp_path, scans=scans)
        figures = [planned(path, *more) for more in ([], ["evidence.time=off"])]
        files.append([each["temporary_bytes"] for each in figures])
        memory.append([each["worker_memory_bytes"] for each in figures])
    assert files[0] == files[1]
    assert 0 < files[0][0] - files[0][1] <= 20 * COUNT
    assert memory[0] == memory[1]
    assert memory[0][0] - memory[0][1] == HELD_BYTES


def test_a_run_without_room_for_what_scans_saw_is_refused(tmp_path, monkeypatch):
    path = write(tmp_path)
    off = configured("evidence.time=off")
    needed = planned(path, "evidence.time=off")
    has_room(monkeypatch, needed["temporary_bytes"] + needed["output_bytes"] + COUNT)
    for command in (
        lambda: run([path], tmp_path / "out", configured(), StageObserver(LogDisplay())),
        lambda: planned(path),
    ):
        with pytest.raises(DiskSpaceError, match=r"of temporary files .* are free"):
            command()
    assert run([path], tmp_path / "out", off, StageObserver(LogDisplay())).time == "none"


def test_a_map_of_one_tile_holds_some_images(tmp_path):
    collection = open_collection([write(tmp_path)], configured().input)
    with_them, without = (
        one_tile_memory(collection, configured(*each))[0] for each in ([], ["evidence.time=off"])
    )
    assert with_them - without == HELD_BYTES
