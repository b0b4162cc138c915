"""A map that changes during a run is noticed, however little of it can be seen."""

import os

import numpy as np
import pytest

from pipeline.errors import InputChangedError
from pipeline.work.job import check_map, map_state, unchanged


def test_a_map_rewritten_in_place_with_its_time_put_back(tmp_path):
    path = tmp_path / "map.npy"
    np.save(path, np.zeros((9, 3)))
    before = path.stat()
    with pytest.raises(InputChangedError, match="changed while it was being cleaned"):  # noqa: SIM117
        with unchanged([path]):
            with path.open("r+b") as file:
                file.seek(-8, os.SEEK_END)
                file.write(np.float64(1).tobytes())
            os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    after = path.stat()
    assert (after.st_size, after.st_mtime_ns) == (before.st_size, before.st_mtime_ns)


def test_a_map_that_is_only_read_is_the_same(tmp_path):
    path = tmp_path / "map.npy"
    np.save(path, np.zeros((9, 3)))
    state = map_state([path])
    np.load(path)
    check_map([path], state)
