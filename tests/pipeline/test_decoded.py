"""A decoded map: kept where decoding takes long and there is room, read again otherwise."""

import numpy as np
import pytest

from pipeline.outputs import decoded
from pipeline.outputs.decoded import read_map
from pipeline.progress import LogDisplay, StageObserver
from tiling.collection import MapCollection
from tiling.formats.numpy.npz import NpzReader

POINTS = np.random.default_rng(4).normal(size=(700, 3))


@pytest.fixture(autouse=True)
def small_batches(monkeypatch):
    monkeypatch.setattr(decoded, "BATCH", 90)


@pytest.fixture
def readings(monkeypatch):
    """The files that are read from here on."""
    seen = []
    batches = NpzReader._batches

    def spy(self, most, rows):
        seen.append(self.description.path.name)
        return batches(self, most, rows)

    monkeypatch.setattr(NpzReader, "_batches", spy)
    return seen


@pytest.fixture
def collection(tmp_path):
    np.savez_compressed(tmp_path / "a.npz", points=POINTS[:300], weight=np.arange(300))
    np.savez_compressed(tmp_path / "b.npz", points=POINTS[300:], weight=np.arange(400))
    return MapCollection([tmp_path / "a.npz", tmp_path / "b.npz"])


@pytest.mark.parametrize(("most_kept", "again"), [(1 << 20, 0), (700 * 20, 2), (0, 2)])
def test_both_files_come_back_as_their_readers_give_them(collection, readings, most_kept, again):
    read = read_map(collection, most_kept, StageObserver(LogDisplay()))
    assert read.points.tobytes() == POINTS.tobytes()
    assert read.classification is None
    readings.clear()
    found = [list(read.batches(file)) for file in range(2)]
    assert len(readings) == again
    for reader, batches in zip(collection.readers, found, strict=True):
        for batch, expected in zip(batches, reader.batches(90), strict=True):
            assert batch.first_row == expected.first_row
            assert batch.xyz.tobytes() == expected.xyz.tobytes()
            assert batch.records.tobytes() == expected.records.tobytes()


def test_maps_whose_bytes_are_the_records_are_not_kept(tmp_path):
    np.save(tmp_path / "map.npy", POINTS)
    collection = MapCollection([tmp_path / "map.npy"])
    read = read_map(collection, 1 << 20, StageObserver(LogDisplay()))
    assert not read.kept
    assert sum(len(batch.xyz) for batch in read.batches(0)) == 700


def test_text_is_counted_by_its_characters():
    rows = np.array([b"1 2 3\n", b"4 5\n"], dtype=object)
    assert decoded._size_of(rows) == 10 + 2 * decoded._OBJECT_BYTES
