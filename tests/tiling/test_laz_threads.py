"""Cores change how long LAZ takes, and neither what is read nor what is written."""

import itertools
import random
import struct
from multiprocessing import get_all_start_methods, get_context
from pathlib import Path

import laspy
import lazrs
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tiling.errors import MapFormatError
from tiling.formats import MapReader, open_map
from tiling.formats.las import compression
from tiling.formats.las.compression import find_chunks, read_compression
from tiling.formats.las.header import read_header

COUNT = 300
CHUNK = 7
VARIED = (1, 40, 2, 99, 158)


def save_laz(path: Path, point_format: int, extra_bytes: int = 0, varied: bool = False) -> None:
    """Write random points in chunks of 7, or of various sizes."""
    header = laspy.LasHeader(version="1.4", point_format=point_format)
    if extra_bytes:
        header.add_extra_dim(laspy.ExtraBytesParams("more", f"{extra_bytes}u1"))
    laspy.LasData(header).write(path)
    block = bytearray(read_header(path).block)
    stored = read_compression(read_header(path)).data
    data = bytearray(stored)
    struct.pack_into("<I", data, 12, 0xFFFFFFFF if varied else CHUNK)
    at = block.index(stored)
    block[at : at + len(data)] = data
    struct.pack_into("<Q", block, 247, COUNT)
    length = header.point_format.size
    raw = np.random.default_rng(8).integers(0, 256, (COUNT, length), dtype=np.uint8)
    raw[:, 15] &= 0xCF
    with path.open("wb") as file:
        file.write(block)
        compressor = lazrs.LasZipCompressor(file, lazrs.LazVlr(bytes(data)))
        if varied:
            ends = itertools.accumulate(VARIED, initial=0)
            chunks = [raw[start:end].reshape(-1) for start, end in itertools.pairwise(ends)]
            compressor.compress_chunks(chunks)
        else:
            compressor.compress_many(raw.reshape(-1))
        compressor.done()


@pytest.fixture(scope="module")
def paths(tmp_path_factory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("maps")
    save_laz(folder / "points.laz", 3, extra_bytes=2)
    save_laz(folder / "layers.laz", 7, extra_bytes=2)
    save_laz(folder / "waves.laz", 10)
    save_laz(folder / "varied_points.laz", 1, varied=True)
    save_laz(folder / "varied_layers.laz", 6, varied=True)
    return {path.stem: path for path in folder.iterdir()}


NAMES = ["points", "layers", "waves", "varied_points", "varied_layers"]


def content(reader: MapReader, most: int, rows: range) -> tuple[bytes, bytes, list[int]]:
    batches = list(reader.batches(most, rows))
    return (
        b"".join(batch.records.tobytes() for batch in batches),
        b"".join(batch.xyz.tobytes() for batch in batches),
        [batch.first_row for batch in batches],
    )


def written(reader: MapReader, path: Path, chosen: np.ndarray, most: int) -> bytes:
    with reader.writer(path, int(chosen.sum())) as writer:
        for batch in reader.batches(most):
            rows = slice(batch.first_row, batch.first_row + len(batch.xyz))
            writer.write(batch.select(chosen[rows]))
    return path.read_bytes()


@pytest.mark.parametrize("name", NAMES)
@settings(deadline=None, max_examples=15)
@given(
    threads=st.integers(2, 5),
    most=st.sampled_from([1, 5, 7, 50, 1000]),
    ends=st.tuples(st.integers(0, COUNT), st.integers(0, COUNT)),
    share=st.sampled_from([0.0, 0.02, 0.5, 1.0]),
)
def test_files_and_points_do_not_depend_on_threads(
    paths, tmp_path_factory, name, threads, most, ends, share
):
    one, several = open_map(paths[name]), open_map(paths[name], threads)
    rows = range(min(ends), max(ends))
    assert content(several, most, rows) == content(one, most, rows)
    folder = tmp_path_factory.mktemp("out")
    chosen = np.random.default_rng(most).random(COUNT) < share
    expected = written(one, folder / "one.laz", chosen, 11)
    assert written(several, folder / "several.laz", chosen, most) == expected


def test_no_more_chunks_than_threads_are_in_work(paths, tmp_path, monkeypatch):
    chunks_at_once: list[int] = []
    decompress, compressor = lazrs.decompress_points_with_chunk_table, lazrs.ParLasZipCompressor

    def spy_on_decompression(data, vlr, points, table):
        chunks_at_once.append(len(table))
        decompress(data, vlr, points, table)

    class SpyOnCompression:
        def __init__(self, file, vlr):
            self.inner = compressor(file, vlr)
            self.chunk_bytes = vlr.chunk_size() * vlr.item_size()
            self.done = self.inner.done

        def compress_many(self, points):
            chunks_at_once.append(-(-len(points) // self.chunk_bytes))
            self.inner.compress_many(points)

    monkeypatch.setattr(lazrs, "decompress_points_with_chunk_table", spy_on_decompression)
    monkeypatch.setattr(lazrs, "ParLasZipCompressor", SpyOnCompression)
    everything = np.ones(COUNT, dtype=bool)
    written(open_map(paths["layers"], 3), tmp_path / "out.laz", everything, 100)
    assert len(chunks_at_once) == 2 * -(-COUNT // (3 * CHUNK))
    assert max(chunks_at_once) == 3
    chunks_at_once.clear()
    written(open_map(paths["layers"]), tmp_path / "out.laz", everything, 100)
    assert chunks_at_once == []


@pytest.mark.skipif("fork" not in get_all_start_methods(), reason="processes cannot be forked")
@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")
def test_a_forked_process_does_not_wait_for_threads_that_it_lacks(paths, tmp_path):
    reader = open_map(paths["layers"], 2)
    everything = np.ones(COUNT, dtype=bool)
    expected = written(reader, tmp_path / "here.laz", everything, 100)
    there = tmp_path / "there.laz"
    process = get_context("fork").Process(target=written, args=(reader, there, everything, 100))
    process.start()
    process.join(30)
    process.kill()
    assert there.read_bytes() == expected


@pytest.mark.parametrize("name", NAMES)
def test_a_range_is_found_without_what_is_before_it(paths, name):
    header = read_header(paths[name])
    compression = read_compression(header)
    rows = range(290, 296)
    first_row = COUNT - VARIED[-1] if name.startswith("varied") else 290 // CHUNK * CHUNK
    with paths[name].open("rb") as file:
        first = next(iter(find_chunks(file, header, compression, rows)))
        assert first.first_row == first_row


@pytest.mark.parametrize("name", ["layers", "varied_layers"])
def test_chunks_before_a_range_are_not_walked(paths, name, monkeypatch):
    walked = []
    header = read_header(paths[name])
    inner = compression._layered_chunk_end

    def spy(file, header, compression, start, end):
        walked.append(start)
        return inner(file, header, compression, start, end)

    monkeypatch.setattr(compression, "_layered_chunk_end", spy)
    with paths[name].open("rb") as file:
        list(find_chunks(file, header, read_compression(header), range(290, 300)))
    assert 0 < len(walked) <= 3


def test_chunks_of_layers_are_found_without_the_chunk_table(paths, tmp_path):
    path = tmp_path / "map.laz"
    data = bytearray(paths["layers"].read_bytes())
    start = read_header(paths["layers"]).points_offset
    (table,) = struct.unpack_from("<Q", data, start)
    expected = content(open_map(paths["layers"]), 100, range(100, 200))
    for wrong in (bytes(8), struct.pack("<q", table - 3)):
        data[start : start + 8] = wrong
        path.write_bytes(data)
        for threads in (1, 2):
            assert content(open_map(path, threads), 100, range(100, 200)) == expected


def test_spoilt_files_are_read_or_refused_with_threads(paths, tmp_path):
    chance = random.Random(4)
    path = tmp_path / "map.laz"
    outcomes = set()
    for _ in range(60):
        for name in NAMES:
            data = bytearray(paths[name].read_bytes())
            start = read_header(paths[name]).points_offset
            for _ in range(chance.randint(1, 3)):
                data[chance.randrange(start, len(data))] = chance.randrange(256)
            path.write_bytes(data[: chance.choice([len(data), chance.randrange(start, len(data))])])
            try:
                content(open_map(path, 3), 50, range(COUNT))
                outcomes.add("read")
            except MapFormatError as error:
                assert "\n" not in str(error)
                outcomes.add("refused")
    assert outcomes == {"read", "refused"}


def test_real_files_do_not_depend_on_threads(shared_data, tmp_path):
    formats = shared_data / "formats"
    compared = 0
    for path in sorted(formats.glob("*.laz")):
        try:
            one = open_map(path)
            rows = range(one.description.point_count)
            expected = content(one, 500, rows)
        except MapFormatError:
            continue
        assert content(open_map(path, 2), 500, rows) == expected, path.name
        chosen = np.random.default_rng(0).random(len(rows)) < 0.5
        wanted = written(one, tmp_path / "one.laz", chosen, 500)
        found = written(open_map(path, 2), tmp_path / "two.laz", chosen, 500)
        assert found == wanted, path.name
        compared += 1
    assert compared > 10
