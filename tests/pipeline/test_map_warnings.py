"""A map of tiles is warned about as in memory: the same words, the same numbers."""

import laspy
import numpy as np
import pytest

from pipeline.configuration.run import load_configuration
from pipeline.progress import LogDisplay, StageObserver
from pipeline.run import run

pytestmark = pytest.mark.usefixtures("nothing_waits_for_the_disk")

FAST = [
    "neighbours.k=8",
    "clustering.count=3",
    "execution.cluster=none",
    "output.report=none",
    "ground.method=las_class",
]
ONE_TILE, TILES = "tiling.max_points=1000000", "tiling.max_points=300"


TINY = (24, [20, 60, 0])


def las_map(path, ground, groups=(TINY,)):
    """Write two large groups and others, `ground` points of which are of class 2."""
    random = np.random.default_rng(0)
    groups = [(900, [0, 0, 0]), (850, [40, 5, 0]), *groups]
    points = np.concatenate([random.uniform(size=(n, 3)) * 8 + place for n, place in groups])
    header = laspy.LasHeader(version="1.2", point_format=3)
    header.scales = np.full(3, 0.001)
    las = laspy.LasData(header)
    las.xyz = points
    classes = np.zeros(len(points), np.uint8)
    classes[:ground] = 2
    las.classification = classes
    las.write(path)
    return path


def warnings_of(source, folder, *wanted):
    return run(
        [source], folder, load_configuration(None, [*FAST, *wanted]), StageObserver(LogDisplay())
    ).warnings


@pytest.mark.parametrize("decision", ["paper", "auto"])
@pytest.mark.parametrize("ground", [20, 200])
def test_tiles_warn_as_one_tile_does(tmp_path, decision, ground):
    source = las_map(tmp_path / "map.las", ground)
    one, many = (
        warnings_of(source, tmp_path / folder, f"removal.decision={decision}", tiles)
        for folder, tiles in (("one", ONE_TILE), ("many", TILES))
    )
    assert one == many
    assert any(f"({ground} of 1,774 points" in each for each in one) == (ground == 20)
    assert any("has 24 points, and half" in each for each in one) == (decision == "paper")
    assert any("sparse, or was" in each for each in one) == (decision == "auto")


@pytest.mark.parametrize("groups", [(), (TINY,)], ids=["one population", "two"])
def test_densities_are_counted_over_tiles(tmp_path, groups, monkeypatch):
    monkeypatch.setattr("dynahull.warn._FEWEST_SCORED", 1_000)
    source = las_map(tmp_path / "map.las", 200, groups)
    one, many = (
        warnings_of(source, tmp_path / folder, "removal.decision=paper", tiles)
        for folder, tiles in (("one", ONE_TILE), ("many", TILES))
    )
    assert one == many
    assert any("no second, sparser" in each for each in one) == (not groups)
