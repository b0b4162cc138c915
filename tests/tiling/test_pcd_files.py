"""PCD files of other tools: read as these read them, in whole, in part and damaged."""

import struct
import time

import numpy as np
import pytest

from tiling.errors import MapFormatError
from tiling.formats import open_map

POINT_COUNTS = {
    "binary_compressed_depot.pcd": 17224,
    "padding_fields_0_0.pcd": 28834,
    "pcl-test__brisk_keypoints_gt.pcd": 1860,
    "pcl-test__bun0.pcd": 397,
    "pcl-test__bun4.pcd": 361,
    "pcl-test__bunny.pcd": 397,
    "pcl-test__curve3d.pcd": 110,
    "pcl-test__ism_train.pcd": 3400,
    "pcl-test__nhood_test.pcd": 36,
    "pcl-test__noisy_slice_displaced.pcd": 3782,
    "pcl-test__office1_keypoints.pcd": 1318,
    "pcl-test__sac_plane_test.pcd": 3283,
    "pcl-test__spherical_voxel_grid_test.pcd": 16,
    "pcl-test__v.pcd": 2,
    "pdal-test__utm17_space.pcd": 10,
    "pdal-test__utm17_tab.pcd": 10,
    "pypcd4-test__ascii_multi_count.pcd": 8,
    "pypcd4-test__ascii_with_underscore.pcd": 213,
}
REFUSED = {
    "pcl-test__all_types.pcd": "x, y and z among FIELDS, found a1 a2 .* at line 3",
    "pcl-test__brisk_descriptors_gt.pcd": "x, y and z among FIELDS, found brisk_scale .* at line 3",
    "pypcd4-test__ascii_invalid_header.pcd": "a keyword of a PCD header, found 'FIEL' at line 3",
}


def read_all(path, max_points=1000):
    """Read a map; return its coordinates."""
    reader = open_map(path)
    xyz = np.concatenate([np.empty((0, 3)), *(batch.xyz for batch in reader.batches(max_points))])
    assert len(xyz) == reader.description.point_count
    return xyz


def copy_chosen(source, target, chosen):
    reader = open_map(source)
    with reader.writer(target, int(chosen.sum())) as writer:
        for batch in reader.batches(700):
            mask = chosen[batch.first_row : batch.first_row + len(batch.xyz)]
            writer.write(batch.select(mask))


def plain_coordinates(path):
    """Read the coordinates of a file of float32 fields, one value at a time."""
    head, _, rest = path.read_bytes().partition(b"\nDATA ")
    kind, _, data = rest.partition(b"\n")
    lines = [line.split() for line in head.decode().splitlines()]
    header = {line[0]: line[1:] for line in lines if not line[0].startswith("#")}
    names = [name.lower() for name in header["FIELDS"]]
    places = [names.index(axis) for axis in "xyz"]
    if kind.strip() == b"ascii":
        rows = [row.split() for row in data.decode().splitlines()]
        return [[float(row[place]) for place in places] for row in rows]
    widths = [int(s) * int(c) for s, c in zip(header["SIZE"], header["COUNT"], strict=True)]
    starts = [sum(widths[:place]) for place in places]
    count, size = int(header["POINTS"][0]), sum(widths)
    return [
        [struct.unpack_from("<f", data, row * size + start)[0] for start in starts]
        for row in range(count)
    ]


@pytest.mark.parametrize("name", POINT_COUNTS)
def test_files_of_the_neighbouring_tools_are_read(tmp_path, shared_data, name):
    path = shared_data / "formats" / name
    xyz = read_all(path)
    assert len(xyz) == POINT_COUNTS[name]
    if name != "binary_compressed_depot.pcd":
        np.testing.assert_array_equal(xyz, plain_coordinates(path))
    chosen = np.arange(len(xyz)) % 3 != 1
    copy_chosen(path, tmp_path / name, chosen)
    np.testing.assert_array_equal(read_all(tmp_path / name), xyz[chosen])


@pytest.mark.parametrize("name", REFUSED)
def test_files_of_the_neighbouring_tools_without_points_in_space_are_refused(shared_data, name):
    with pytest.raises(MapFormatError, match=REFUSED[name]):
        open_map(shared_data / "formats" / name)


def test_every_pcd_file_of_the_suites_is_listed(shared_data):
    assert {path.name for path in (shared_data / "formats").glob("*.pcd")} == {
        *POINT_COUNTS,
        *REFUSED,
    }


def test_cells_whose_rows_end_in_a_blank_come_back_byte_for_byte(tmp_path, shared_data):
    for path in sorted((shared_data / "maps/campus_cells").glob("*.pcd")):
        count = open_map(path).description.point_count
        copy_chosen(path, tmp_path / "out.pcd", np.ones(count, dtype=bool))
        assert (tmp_path / "out.pcd").read_bytes() == path.read_bytes()


def readable_files(shared_data):
    return [
        path
        for path in sorted((shared_data / "formats").glob("*.pcd"))
        if path.stat().st_size < 300_000
    ]


def test_edits_of_real_files_give_an_error_or_a_good_read(tmp_path, shared_data):
    random = np.random.default_rng(20)
    files = [path.read_bytes() for path in readable_files(shared_data)]
    for name in ("pcl-test__bun0.pcd", "binary_compressed_depot.pcd"):
        read_all(shared_data / "formats" / name)  # compiles what is compiled
    path = tmp_path / "edited.pcd"
    refused = 0
    for turn in range(400):
        content = bytearray(files[turn % len(files)])
        within = len(content) if turn % 3 == 0 else min(len(content), 260)
        for _ in range(random.integers(1, 4)):
            content[random.integers(within)] = random.integers(256)
        path.write_bytes(content)
        started = time.perf_counter()
        try:
            read_all(path)
        except MapFormatError as error:
            refused += 1
            assert "\n" not in str(error)
        assert time.perf_counter() - started < 2, bytes(content[:300])
    assert 100 < refused < 400
