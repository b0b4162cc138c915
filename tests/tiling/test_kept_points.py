"""Kept points: what the survey decoded comes back, row by row, and a lost file is named."""

import laspy
import numpy as np
import pytest

from tiling.collection import MapCollection
from tiling.errors import ChunkError
from tiling.kept_points import KeptPoints, bytes_kept

XYZ = np.random.default_rng(2).normal(size=(11, 3)).round(3)


def write_laz(path, xyz, point_format):
    header = laspy.LasHeader(point_format=point_format, version="1.4")
    header.scales = [0.001] * 3
    cloud = laspy.LasData(header)
    cloud.xyz = xyz
    cloud.classification = np.arange(len(xyz)) % 7
    cloud.write(path, laz_backend=laspy.LazBackend.Lazrs)


def write_packed_pcd(path, xyz):
    rows = np.c_[xyz, np.arange(len(xyz))].astype("<f8")
    columns = rows.T.tobytes()
    parts = [columns[at : at + 32] for at in range(0, len(columns), 32)]
    literals = b"".join(bytes([len(part) - 1]) + part for part in parts)
    sizes = np.array([len(literals), len(columns)], "<u4").tobytes()
    header = (
        "VERSION 0.7\nFIELDS x y z n\nSIZE 8 8 8 8\nTYPE F F F F\nCOUNT 1 1 1 1\n"
        f"WIDTH {len(xyz)}\nHEIGHT 1\nPOINTS {len(xyz)}\nDATA binary_compressed\n"
    )
    path.write_bytes(header.encode() + sizes + literals)


def write_text(path, xyz):
    lines = "".join("{} {} {}\n".format(*row) for row in xyz.tolist())
    path.write_text(
        f"ply\nformat ascii 1.0\nelement vertex {len(xyz)}\n"
        f"property double x\nproperty double y\nproperty double z\nend_header\n{lines}"
    )


def several_files(folder):
    """Files whose records differ in size."""
    write_laz(folder / "a.laz", XYZ[:4], 6)
    write_packed_pcd(folder / "b.pcd", XYZ[4:9])
    write_laz(folder / "c.laz", XYZ[9:], 7)
    return MapCollection([folder / "a.laz", folder / "b.pcd", folder / "c.laz"])


def with_text(folder):
    """Files of which one has no records of one size."""
    write_laz(folder / "a.laz", XYZ[:4], 6)
    write_text(folder / "b.ply", XYZ[4:])
    return MapCollection([folder / "a.laz", folder / "b.ply"])


def kept(folder, collection):
    points = KeptPoints(folder / "map.decoded", collection)
    points.make()
    for rows in (range(7, 11), range(7)):
        passed = list(points.keep(collection.batches(3, rows)))
        assert sum(len(batch.xyz) for batch in passed) == len(rows)
    return points


def rows_of(batches):
    """File, row number, coordinates, class and record of each point."""
    rows = []
    for file, batch in batches:
        for at, xyz in enumerate(batch.xyz):
            number = None if batch.classification is None else int(batch.classification[at])
            binary = isinstance(batch.records, np.ndarray)
            record = batch.records[at : at + 1].tobytes() if binary else None
            rows.append((file, batch.first_row + at, xyz.tobytes(), number, record))
    return rows


@pytest.mark.parametrize("files", [several_files, with_text])
@pytest.mark.parametrize("rows", [range(11), range(3, 9), range(4, 5), range(9, 11), range(5, 5)])
def test_what_was_kept_in_any_order_is_read_in_any_ranges(tmp_path, files, rows):
    collection = files(tmp_path)
    points = kept(tmp_path, collection)
    assert points.has_records == (files is several_files)
    for most in (1, 2, 100):
        found, expected = (rows_of(each.batches(most, rows)) for each in (points, collection))
        assert [row[:3] for row in found] == [row[:3] for row in expected]
        assert len(found) == len(rows)
        if points.has_records:
            assert found == expected


def test_a_file_of_the_map_is_read_as_its_reader_reads_it(tmp_path):
    collection = several_files(tmp_path)
    points = kept(tmp_path, collection)
    for file, reader in enumerate(collection.readers):
        found, expected = list(points.batches_of(file, 2)), list(reader.batches(2))
        assert [each.first_row for each in found] == [each.first_row for each in expected]
        assert [each.records.tobytes() for each in found] == [
            each.records.tobytes() for each in expected
        ]


def test_large_records_are_read_few_at_a_time(tmp_path, monkeypatch):
    collection = several_files(tmp_path)
    points = kept(tmp_path, collection)
    size = collection.readers[0].record_dtype.itemsize
    monkeypatch.setattr("tiling.kept_points._LARGEST_BATCH", 2 * size)
    assert [len(batch.xyz) for batch in points.batches_of(0, 100)] == [2, 2]


@pytest.mark.parametrize("files", [several_files, with_text])
def test_a_file_that_is_lost_or_cut_short_is_named(tmp_path, files):
    collection = files(tmp_path)
    points = kept(tmp_path, collection)
    assert points.path.stat().st_size == points.size
    points.path.write_bytes(points.path.read_bytes()[:-1])
    with pytest.raises(ChunkError, match=r"map\.decoded: expected 11 points .*, found the end"):
        list(points.batches(4, range(11)))
    points.path.unlink()
    for use in (
        lambda: points.batches(4, range(11)),
        lambda: points.keep(collection.batches(4, range(11))),
    ):
        with pytest.raises(ChunkError, match=r"map\.decoded: .* found no such file"):
            list(use())


def test_only_records_are_kept_to_the_end(tmp_path):
    collection = several_files(tmp_path)
    assert bytes_kept(collection) == kept(tmp_path, collection).path.stat().st_size > 0
    assert bytes_kept(with_text(tmp_path)) == 0
    np.save(tmp_path / "plain.npy", XYZ)
    assert bytes_kept(MapCollection([tmp_path / "plain.npy"])) == 0
