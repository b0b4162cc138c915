"""A tile that its worker's memory does not suffice for is done in parts, with the same bytes."""

import os
import sys
from contextlib import nullcontext

import cloudpickle
import dask
import numpy as np
import pytest

from pipeline.configuration.run import load_configuration
from pipeline.errors import TasksFailedError
from pipeline.progress import LogDisplay, StageObserver
from pipeline.run import run
from pipeline.tiles import stages
from pipeline.tiles.borders import Region
from pipeline.tiles.density import SIDES, divided
from pipeline.workers.local_dask import local_workers

# Workers cannot import the tests: what these hand them is sent whole.
cloudpickle.register_pickle_by_value(sys.modules[__name__])

WANTED = [
    "neighbours.k=8",
    "clustering.count=3",
    "ground.slope.window=0.3",
    "ground.slope.expert.extension=0.3",
    "ground.slope.expert.storey_radius=0.5",
    "max_height=1.2",
    "tiling.max_points=300",
    "output.labels=true",
]
RESULTS = ("static.npy", "dynamic.npy", "labels.parquet")

pytestmark = pytest.mark.usefixtures("nothing_waits_for_the_disk")


@pytest.fixture(scope="module")
def map_file(tmp_path_factory):
    random = np.random.default_rng(4)
    floor = random.uniform(size=(700, 3)) * [9, 7, 0.02]
    things = random.uniform(size=(700, 3)) * [9, 7, 2]
    path = tmp_path_factory.mktemp("map") / "map.npy"
    np.save(path, np.round(random.permutation(np.concatenate([floor, things])) * 16) / 16)
    return path


def cleaned(map_file, folder, *wanted):
    configuration = load_configuration(None, [*WANTED, *wanted])
    return run([map_file], folder, configuration, StageObserver(LogDisplay()))


def results(folder):
    return {name: (folder / name).read_bytes() for name in RESULTS}


@pytest.fixture(scope="module")
def expected(map_file, tmp_path_factory):
    folder = tmp_path_factory.mktemp("expected")
    cleaned(map_file, folder, "execution.cluster=none")
    return results(folder)


class Greedy:
    """Does a task only in so many parts, as if the memory did not suffice for fewer."""

    def __init__(self, monkeypatch, stage, sides):
        self._task, self._sides = stages.TASKS[stage], sides
        self.calls = []
        monkeypatch.setitem(stages.TASKS, stage, self)

    def __call__(self, job, tile, sides=1):
        self.calls.append((tile, sides))
        if sides < self._sides:
            raise MemoryError("Unable to allocate 7 GiB")
        return self._task(job, tile, sides)


@pytest.mark.parametrize(
    ("stage", "sides", "halo"),
    [("ground", 2, "auto"), ("ground", 4, "0"), ("density", 2, "0"), ("density", 4, "auto")],
)
def test_in_parts_the_results_have_the_same_bytes(
    stage, sides, halo, map_file, tmp_path, monkeypatch, expected
):
    greedy = Greedy(monkeypatch, stage, sides)
    wanted = ("execution.cluster=none", f"tiling.halo={halo}", "output.keep_work=true")
    report = cleaned(map_file, tmp_path, *wanted)
    tiles = len(list((tmp_path / ".dynahull-work/label").glob("*.done")))
    assert tiles > 4
    tried = [1, *(each for each in SIDES if each <= sides)]
    assert sorted(greedy.calls) == [(tile, each) for tile in range(tiles) for each in tried]
    assert f"{stage} task 0: Unable to allocate 7 GiB; it is done again in 4 parts" in (
        report.warnings
    )
    assert results(tmp_path) == expected


def test_one_model_a_tile_is_that_of_the_whole_tile(map_file, tmp_path, monkeypatch):
    wanted = ("execution.cluster=none", "clustering.scope=tile", "clustering.count=2")
    cleaned(map_file, tmp_path / "whole", *wanted)
    Greedy(monkeypatch, "ground", 2)
    Greedy(monkeypatch, "density", 4)
    cleaned(map_file, tmp_path / "parts", *wanted)
    assert results(tmp_path / "parts") == results(tmp_path / "whole")


@pytest.mark.parametrize("sides", [2, 4])
def test_evidence_weighed_in_parts_is_the_same(sides, map_file, tmp_path, monkeypatch):
    wanted = ("execution.cluster=none", "removal.decision=auto", "tiling.max_points=500")
    cleaned(map_file, tmp_path / "whole", *wanted)
    greedy = Greedy(monkeypatch, "evidence", sides)
    cleaned(map_file, tmp_path / "parts", *wanted)
    assert {each for _, each in greedy.calls} == {1, *(each for each in SIDES if each <= sides)}
    assert results(tmp_path / "parts") == results(tmp_path / "whole")


def test_a_tile_that_is_too_large_in_any_parts_is_named(map_file, tmp_path, monkeypatch, expected):
    with monkeypatch.context() as patch:
        greedy = Greedy(patch, "density", 100)
        with pytest.raises(TasksFailedError, match=r"\(0: Unable to .*; try a smaller tiling"):
            cleaned(map_file, tmp_path, "execution.cluster=none")
        assert {sides for _, sides in greedy.calls} == {1, *SIDES}
    cleaned(map_file, tmp_path, "execution.cluster=none")
    assert results(tmp_path) == expected


def test_a_stage_that_has_no_parts_is_not_tried_in_parts(map_file, tmp_path, monkeypatch):
    greedy = Greedy(monkeypatch, "label", 100)
    with pytest.raises(TasksFailedError, match="stage label failed"):
        cleaned(map_file, tmp_path, "execution.cluster=none")
    assert {sides for _, sides in greedy.calls} == {1}


do_task = stages.do_task


def dying(stage, folder, number, sides=1):
    """Die as a worker does that its nanny kills, on one tile as a whole."""
    if (stage, number, sides) == ("ground", 2, 1):
        os._exit(9)
    return do_task(stage, folder, number, sides)


def test_a_tile_whose_worker_is_killed_is_done_in_parts(map_file, tmp_path, monkeypatch, expected):
    monkeypatch.setattr(stages, "do_task", dying)
    # A task is tried on three more workers otherwise, each of which takes seconds to start.
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        local_workers(1, 3 << 30) as executor,
    ):
        monkeypatch.setattr("pipeline.run.workers_for", lambda *_: nullcontext(executor))
        report = cleaned(map_file, tmp_path)
    assert (
        "ground task 2: its workers died, probably for want of memory; it is done again in 4 "
        "parts" in report.warnings
    )
    assert results(tmp_path) == expected


@pytest.mark.parametrize("sides", [2, 3, 5])
@pytest.mark.parametrize("count", [0, 1, 7, 1_000])
def test_boxes_share_out_a_region_and_its_points(sides, count):
    random = np.random.default_rng(count)
    xyz = np.round(random.normal(size=(count, 3)) * 2, 1)
    region = Region(np.array([-np.inf, -1.5]), np.array([2.5, np.inf]))
    boxes = divided(region, xyz, sides)
    held = np.array([box.holds(xyz) for box in boxes])
    np.testing.assert_array_equal(held.sum(axis=0), region.holds(xyz))
    places = random.normal(size=(500, 3)) * 50
    shares = np.array([box.holds(places) for box in boxes])
    np.testing.assert_array_equal(shares.sum(axis=0), region.holds(places))
    if count == 1_000:
        assert held.sum(axis=1).max() < 1.5 * count / sides**2
