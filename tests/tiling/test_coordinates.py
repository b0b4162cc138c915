"""Kept coordinates: what the survey read comes back, row by row, and a lost file is named."""

import numpy as np
import pytest

from tiling.coordinates import KeptCoordinates
from tiling.errors import ChunkError
from tiling.formats.base import PointBatch

XYZ = np.random.default_rng(2).normal(size=(11, 3))
XYZ[4] = [np.nan, -np.inf, -0.0]


def batches(rows, size):
    for first in range(rows.start, rows.stop, size):
        yield PointBatch(first, XYZ[first : min(first + size, rows.stop)], None)


@pytest.fixture
def kept(tmp_path):
    kept = KeptCoordinates(tmp_path / "map.coordinates", len(XYZ))
    kept.make()
    return kept


def test_what_was_kept_in_any_order_is_read_in_any_ranges(kept):
    for rows in (range(7, 11), range(7)):
        passed = list(kept.keep(batches(rows, 3)))
        assert [batch.first_row for batch in passed] == list(range(rows.start, rows.stop, 3))
    for rows in (range(11), range(3, 9), range(4, 5), range(5, 5)):
        found = list(kept.batches(4, rows))
        assert [batch.first_row for _, batch in found] == list(range(rows.start, rows.stop, 4))
        xyz = np.concatenate([np.empty((0, 3)), *(batch.xyz for _, batch in found)])
        assert xyz.tobytes() == XYZ[rows.start : rows.stop].tobytes()


def test_a_file_that_is_lost_or_cut_short_is_named(kept):
    list(kept.keep(batches(range(11), 5)))
    kept.path.write_bytes(kept.path.read_bytes()[:-1])
    with pytest.raises(ChunkError, match=r"map\.coordinates: expected .* 11 points, found the end"):
        list(kept.batches(4, range(11)))
    kept.path.unlink()
    for use in (lambda: kept.batches(4, range(11)), lambda: kept.keep(batches(range(11), 5))):
        with pytest.raises(ChunkError, match=r"map\.coordinates: .* found no such file"):
            list(use())
