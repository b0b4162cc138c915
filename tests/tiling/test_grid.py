import laspy
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tiling.chunks import grid_of
from tiling.collection import MapCollection
from tiling.errors import GridError
from tiling.grid import Grid
from tiling.survey import survey


def grid_of_array(folder, *parts):
    paths = [folder / f"{number}.npy" for number in range(len(parts))]
    for path, xyz in zip(paths, parts, strict=True):
        np.save(path, xyz)
    collection = MapCollection(paths)
    return grid_of(collection, survey(collection))


def write_las(path, xyz, scale, offset):
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = [scale] * 3, [offset] * 3
    cloud = laspy.LasData(header)
    cloud.xyz = xyz
    cloud.write(path)
    return path


@given(
    st.lists(st.tuples(*[st.integers(-(2**31) + 1, 2**31 - 1)] * 3), min_size=1, max_size=20),
    st.sampled_from([0.001, 0.01, 2.0**-10, -0.001, 1 / 3]),
    st.sampled_from([0.0, 4.5e6, -17.25]),
)
def test_coordinates_on_a_grid_come_back(integers, scale, offset):
    grid = Grid((scale,) * 3, (offset,) * 3)
    integers = np.array(integers, np.int32)
    xyz = grid.coordinates(integers)
    assert grid.holds(xyz).all()
    assert grid.reaches(xyz)
    np.testing.assert_array_equal(grid.integers(xyz), integers)
    off = xyz.copy()
    off[0, 1] = np.nextafter(off[0, 1], np.inf)
    assert not grid.holds(off)[0]


def test_what_is_out_of_reach_is_not_held():
    grid = Grid((0.001,) * 3, (0.0,) * 3)
    assert not grid.reaches(np.array([[3e6, 0, 0]]))
    np.testing.assert_array_equal(grid.holds(np.array([[3e6, 0, 0], [2, 1e300, 0]])), [False] * 2)


def test_a_las_map_has_its_own_grid(tmp_path):
    xyz = np.random.default_rng(0).uniform(0, 50, (100, 3))
    paths = [write_las(tmp_path / f"{name}.las", xyz, 0.0005, 3.0) for name in "ab"]
    collection = MapCollection(paths)
    grid = grid_of(collection, survey(collection))
    assert grid == Grid((0.0005,) * 3, (3.0,) * 3)


def test_las_files_of_two_grids_may_share_a_finer_one(tmp_path):
    integers = np.random.default_rng(0).integers(0, 1000, (100, 3))
    coarse = write_las(tmp_path / "coarse.las", integers * 0.5, 0.5, 0.0)
    fine = write_las(tmp_path / "fine.las", integers * 0.125, 0.125, 0.0)
    collection = MapCollection([coarse, fine])
    assert grid_of(collection, survey(collection)) == Grid((0.125,) * 3, (0.0,) * 3)


@pytest.mark.parametrize("scale", [0.001, 0.0001, 2.0**-8])
def test_arrays_on_a_grid(tmp_path, scale):
    integers = np.random.default_rng(0).integers(-99_999, 99_999, (500, 3))
    first, second = integers[:400] * scale, integers[400:] * scale
    first[7] = np.nan
    grid = grid_of_array(tmp_path, first, second)
    both = np.concatenate([first[:7], first[8:], second])
    np.testing.assert_array_equal(grid.coordinates(grid.integers(both)), both)


def test_far_from_the_origin_the_grid_is_moved(tmp_path):
    xyz = 5e6 + np.random.default_rng(0).integers(0, 10_000, (500, 3)) * 2.0**-12
    grid = grid_of_array(tmp_path, xyz)
    np.testing.assert_array_equal(grid.coordinates(grid.integers(xyz)), xyz)


@pytest.mark.parametrize("kind", ["float64", "float32"])
def test_coordinates_on_no_grid_are_refused(tmp_path, kind):
    xyz = np.random.default_rng(0).normal(size=(100, 3)).astype(kind)
    with pytest.raises(GridError, match=r"0\.npy: expected coordinates that LAS .* Parquet") as e:
        grid_of_array(tmp_path, xyz)
    assert "\n" not in str(e.value)
    with pytest.raises(GridError):
        grid_of_array(tmp_path, np.array([[0.0, 0, 0], [1e12, 0, 0]]))


def test_a_map_without_points_has_a_grid(tmp_path):
    assert grid_of_array(tmp_path, np.full((2, 3), np.nan)).scales == (0.001,) * 3
