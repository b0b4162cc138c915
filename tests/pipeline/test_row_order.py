"""Rows that are scans are known; those that anything else ordered are not taken for such."""

import laspy
import numpy as np
import pytest

from pipeline.configuration.run import Configuration
from pipeline.scan_numbers import find_scans, rows_of_a_scan
from tiling.collection import MapCollection

SCAN, SCANS = 2_000, 60
RINGS = 10


def drive():
    """Scans of a sensor with ten rings that drives through a room of 12 x 9 x 3 m."""
    random = np.random.default_rng(1)
    azimuth = np.repeat(np.arange(SCAN // RINGS) * 2 * np.pi * RINGS / SCAN + 0.013, RINGS)
    elevation = np.tile(np.linspace(-0.4, 0.3, RINGS), SCAN // RINGS)
    rays = np.stack(
        [np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation),
         np.sin(elevation)], axis=1
    )  # fmt: skip
    low, high, scans = np.zeros(3), np.array([12, 9, 3]), []
    for number in range(SCANS):
        eye = np.array([3 + 0.08 * number, 4, 1.2])
        reach = np.where(rays > 0, (high - eye) / rays, (low - eye) / rays).min(axis=1)
        scans.append(eye + rays * (reach + random.normal(0, 0.01, SCAN))[:, None])
    return np.concatenate(scans)


def filtered(points, leaf):
    """The means of voxels, in the order of their indices, as PCL's filter leaves them."""
    cells = np.floor((points - points.min(axis=0)) / leaf).astype(np.int64)
    x, y, _ = cells.max(axis=0) + 1
    _, voxel, counts = np.unique(cells @ [1, x, x * y], return_inverse=True, return_counts=True)
    sums = [np.bincount(voxel, points[:, axis]) for axis in range(3)]
    return np.stack(sums, axis=1) / counts[:, None]


def along_a_curve(points):
    cells = np.floor((points - points.min(axis=0)) / 0.1).astype(np.int64)
    key = np.zeros(len(points), np.int64)
    for bit in range(10):
        for axis in range(3):
            key |= (cells[:, axis] >> bit & 1) << (3 * bit + axis)
    return points[np.argsort(key, kind="stable")]


def around(points):
    x, y, _ = (points - np.median(points, axis=0)).T
    return points[np.argsort(np.arctan2(y, x), kind="stable")]


OTHERS = {
    "shuffled": lambda points: np.random.default_rng(2).permutation(points),
    "sorted by x": lambda points: points[np.argsort(points[:, 0], kind="stable")],
    "sorted by y": lambda points: points[np.argsort(points[:, 1], kind="stable")],
    "sorted by z": lambda points: points[np.argsort(points[:, 2], kind="stable")],
    "voxels of 3 cm": lambda points: filtered(points, 0.03),
    "voxels of 10 cm": lambda points: filtered(points, 0.1),
    "along a curve": along_a_curve,
    "around": around,
}


def found(points, path):
    np.save(path, points)
    return rows_of_a_scan(MapCollection([path]))


def test_scans_one_after_the_other(tmp_path):
    points = drive()
    assert SCAN / 2 <= found(points, tmp_path / "a.npy") <= 2 * SCAN
    source = find_scans(MapCollection([tmp_path / "a.npy"]), Configuration())
    assert source.kind == "rows"
    assert str(source) == f"order of the rows, about {source.scans} scans"
    collection = MapCollection([tmp_path / "a.npy"])
    numbers = np.concatenate(
        [source.numbers(collection, *batch) for batch in collection.batches(777)]
    )
    np.testing.assert_array_equal(numbers, np.arange(len(points)) // source.rows)
    points[::9] = np.nan  # rays that did not return
    assert found(points, tmp_path / "b.npy")


def test_files_do_not_share_scans(tmp_path):
    first, second = np.split(drive(), [70_001])
    np.save(tmp_path / "a.npy", first)
    np.save(tmp_path / "b.npy", second)
    collection = MapCollection([tmp_path / "a.npy", tmp_path / "b.npy"])
    source = find_scans(collection, Configuration())
    of_first, of_second = (source.numbers(collection, *batch) for batch in collection.batches())
    assert of_first.max() + 1 == of_second.min()
    assert of_second.max() + 1 == source.scans


@pytest.mark.parametrize("order", OTHERS)
def test_other_orders(tmp_path, order):
    assert found(OTHERS[order](drive()), tmp_path / "a.npy") == 0


def test_a_map_of_few_rows_or_of_one_place(tmp_path):
    assert found(drive()[:40_000], tmp_path / "a.npy") == 0
    assert found(np.zeros((100_000, 3)), tmp_path / "b.npy") == 0
    assert found(np.full((100_000, 3), np.nan), tmp_path / "c.npy") == 0


@pytest.mark.parametrize("name", ["room_static_sensor", "street_64beam_labelled"])
def test_real_maps(shared_data, tmp_path, name):
    with laspy.open(shared_data / "maps" / f"{name}.laz") as reader:
        first = reader.read_points(4_000_000)
    points = np.stack([first.x, first.y, first.z], axis=1)
    assert 16_384 <= found(points, tmp_path / "a.npy") <= 131_072
    for order in ("shuffled", "sorted by x", "voxels of 3 cm"):
        assert found(OTHERS[order](points), tmp_path / "a.npy") == 0
