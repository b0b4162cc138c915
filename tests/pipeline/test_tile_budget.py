"""How large tiles are: one where the map fits, else as memory and workers allow."""

import json

import numpy as np
import pytest

from pipeline.configuration.run import load_configuration
from pipeline.errors import DiskSpaceError
from pipeline.plan import resources
from pipeline.plan.plan import halo_width, points_held
from pipeline.plan.resources import is_one_tile, tile_budget
from pipeline.progress import Display, LogDisplay, StageObserver
from pipeline.run import run
from pipeline.tiles import stages
from tiling.layout import quadtree
from tiling.survey import Occupancy

GIB = 1 << 30


class Map:
    """All that is asked of a map here."""

    def __init__(self, point_count):
        self.point_count = point_count


@pytest.mark.parametrize(
    ("points", "settings", "one_tile"),
    [
        (5_000_000, ["execution.memory=4GiB", "removal.decision=paper"], True),
        (5_000_000, ["execution.memory=1GiB", "removal.decision=paper"], False),
        (5_000_000, ["execution.memory=4GiB", "removal.decision=auto"], False),
        (60_000_000, ["execution.memory=100GiB"], False),
        (5_000_000, ["execution.memory=4GiB", "execution.scheduler=tcp://a:1"], False),
        (900_000, ["execution.memory=4GiB", "execution.scheduler=tcp://a:1"], True),
        (60_000_000, ["execution.memory=1GiB", "ground.method=csf"], True),
        (5_000_000, ["execution.memory=4GiB", "tiling.max_points=4999999"], False),
        (5_000_000, ["execution.memory=1GiB", "tiling.max_points=5000000"], True),
    ],
)
def test_a_map_is_one_tile_where_it_fits(points, settings, one_tile):
    assert is_one_tile(Map(points), load_configuration(None, settings)) is one_tile


def test_a_map_that_was_begun_in_tiles_stays_cut():
    configuration = load_configuration(None, ["execution.memory=4GiB"])
    assert is_one_tile(Map(1000), configuration)
    assert not is_one_tile(Map(1000), configuration, begun=True)
    fixed = load_configuration(None, ["tiling.max_points=1000"])
    assert is_one_tile(Map(1000), fixed, begun=True)


@pytest.mark.parametrize(
    ("points", "workers", "memory", "expected"),
    [
        (100_000_000, 2, "24GiB", 2_000_000),
        (9_000_000, 2, "24GiB", 1_500_000),
        (9_000_000, 40, "24GiB", 1_000_000),
        (100_000_000, 2, "100MiB", 20_000),
    ],
)
def test_tiles_are_as_large_as_workers_and_memory_allow(points, workers, memory, expected):
    configuration = load_configuration(None, [f"execution.memory={memory}"])
    assert tile_budget(Map(points), configuration, workers) == expected
    fixed = load_configuration(None, ["tiling.max_points=77"])
    assert tile_budget(Map(points), fixed, workers) == 77


def test_tiles_fit_the_memory_of_a_worker():
    configuration = load_configuration(None, ["execution.memory=1GiB"])
    budget = tile_budget(Map(100_000_000), configuration, 2)
    assert 20_000 < budget < 1_000_000
    assert resources.BASE_BYTES + 2 * budget * resources.TILE_BYTES <= GIB


class Killed(BaseException):
    """Ends the process at once, as far as the run can tell."""


def test_a_run_goes_on_in_its_tiles_whatever_memory_there_is_by_then(tmp_path, monkeypatch):
    points = np.random.default_rng(3).uniform(size=(3000, 3)) * [9, 7, 2]
    np.save(tmp_path / "map.npy", points)

    def cleaned(folder):
        wanted = ["neighbours.k=8", "execution.cluster=none", "output.report=none"]
        run([tmp_path / "map.npy"], folder, load_configuration(None, wanted), observer())
        return (folder / "static.npy").read_bytes()

    expected = cleaned(tmp_path / "whole")
    task = stages.TASKS["label"]

    def killing(job, number):
        raise Killed

    with monkeypatch.context() as patch:
        patch.setattr(resources, "_LARGEST_ONE_TILE", 2_000)
        patch.setattr(resources, "_USUAL_TILE", 500)
        patch.setattr(resources, "_SMALLEST_TILE", 500)
        patch.setitem(stages.TASKS, "label", killing)
        with pytest.raises(Killed):
            cleaned(tmp_path / "out")
    store = json.loads(next((tmp_path / "out").rglob("store.json")).read_text())
    assert store["max_points"] < 3000
    done = []
    monkeypatch.setitem(
        stages.TASKS, "label", lambda job, number: done.append(number) or task(job, number)
    )
    assert cleaned(tmp_path / "out") == expected
    assert len(done) > 1


def observer():
    return StageObserver(LogDisplay())


@pytest.mark.parametrize("points_a_column", [1, 30, 4_000])
@pytest.mark.parametrize("max_points", [2_000, 40_000, 10**9])
def test_halos_hold_few_points_however_dense_the_map_is(points_a_column, max_points):
    columns = np.stack(np.mgrid[:40, :30], axis=-1).reshape(-1, 2)
    occupancy = Occupancy(0.25, columns, np.full(len(columns), points_a_column))
    layout = quadtree(occupancy, max_points)
    halo = halo_width(layout, occupancy, 75)
    held = points_held(layout, occupancy, halo).sum()
    assert held <= 1.15 * layout.counts.sum()
    # No wider than neighbours need, and no narrower, if there is no other reason.
    reach = min(np.sqrt(75 * 0.25**2 / (np.pi * points_a_column)), 2.0)
    assert halo < reach + 1 / 16
    wider = points_held(layout, occupancy, halo + 1 / 16).sum()
    assert halo >= reach or wider > 1.15 * layout.counts.sum()


def test_workers_that_a_small_map_does_not_need_are_told_of(tmp_path):
    np.save(tmp_path / "map.npy", np.random.default_rng(1).uniform(size=(200, 3)))
    configuration = load_configuration(None, ["execution.scheduler=tcp://nobody:1"])
    report = run([tmp_path / "map.npy"], tmp_path / "out", configuration, StageObserver(Display()))
    assert any("without the workers of tcp://nobody:1" in each for each in report.warnings)


@pytest.mark.parametrize(("most", "warned"), [(10, 1), (30, 0)])
def test_thousands_of_tiny_tiles_are_warned_of(most, warned, tmp_path):
    random = np.random.default_rng(1)
    np.save(tmp_path / "map.npy", random.uniform(size=(20_000, 3)) * [40, 40, 2])
    asked = [f"tiling.max_points={most}", "output.keep_free=900TiB", "ground.method=none"]
    configuration = load_configuration(None, [*asked, "execution.cluster=none"])
    observer = StageObserver(Display())
    with pytest.raises(DiskSpaceError):  # so that none of them is made
        run([tmp_path / "map.npy"], tmp_path / "out", configuration, observer)
    found = [each for each in observer.warnings if "from 20,000 on the run is faster" in each]
    assert len(found) == warned
