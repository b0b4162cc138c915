"""Points sorted into blocks: all that is near is read, and little else."""

import numpy as np
import pytest

from tiling.errors import ChunkError
from tiling.sorted_points import read_near, write_sorted_points


def near_box(low, high):
    """Tell which boxes meet one."""
    return lambda lows, highs: ((lows <= high) & (highs >= low)).all(axis=1)


@pytest.mark.parametrize("count", [0, 1, 3, 50_000])
def test_all_points_of_a_box_are_read_to_the_last_bit(count, tmp_path):
    random = np.random.default_rng(count)
    xyz = random.normal(size=(count, 3)) * [30, 10, 2] + [4e5, 5e6, 0]
    rows = random.permutation(10 * count)[:count].astype(np.int64)
    write_sorted_points(tmp_path / "a.parquet", xyz, rows)
    for low, high in (([4e5, 5e6], [4e5 + 5, 5e6 + 2]), ([-np.inf] * 2, [np.inf] * 2)):
        found, of_rows = read_near(tmp_path / "a.parquet", near_box(np.array(low), np.array(high)))
        inside = ((xyz[:, :2] >= low) & (xyz[:, :2] <= high)).all(axis=1)
        known = dict(zip(of_rows.tolist(), found.tolist(), strict=True))
        wanted = zip(rows[inside].tolist(), xyz[inside].tolist(), strict=True)
        assert all(known[row] == place for row, place in wanted)
    assert len(of_rows) == count  # the second box has no end


def test_what_is_far_is_not_read(tmp_path):
    xyz = np.random.default_rng(0).uniform(0, 100, (200_000, 3))
    write_sorted_points(tmp_path / "a.parquet", xyz, np.arange(200_000))
    found, _ = read_near(tmp_path / "a.parquet", near_box(np.full(2, 10.0), np.full(2, 11.0)))
    assert 20 < len(found) < 20_000
    none, _ = read_near(tmp_path / "a.parquet", near_box(np.full(2, 200.0), np.full(2, 201.0)))
    assert len(none) == 0


@pytest.mark.parametrize("content", [None, b"", b"PAR1 and no more"])
def test_a_missing_or_damaged_file_is_said_to_be_so(content, tmp_path):
    if content is not None:
        (tmp_path / "a.parquet").write_bytes(content)
    with pytest.raises(ChunkError, match=r"a\.parquet: expected points sorted by blocks"):
        read_near(tmp_path / "a.parquet", near_box(np.zeros(2), np.ones(2)))
