"""Pages of Parquet that say they are larger than they are: no memory is taken for them."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.tiling.test_parquet import parquet, table_of_all_kinds
from tiling.errors import MapFormatError
from tiling.formats import open_map
from tiling.formats.parquet_pages import LARGEST_PAGE, check_pages, find_chunks

CODECS = ["NONE", "SNAPPY", "GZIP", "ZSTD"]
MOST = 1 << 31
POOL = pa.default_memory_pool()


def zigzag(number):
    number, found = number << 1, b""
    while number > 127:
        found, number = found + bytes([number & 127 | 128]), number >> 7
    return found + bytes([number])


def claiming(content, place, size, which):
    """Put another size into the header of a page, and as much less into the page."""
    ends, at = [], place + 2
    for _ in "up":
        assert content[at] == 0x15
        begin = at = at + 1
        while content[at] > 127:
            at += 1
        at += 1
        ends.append((begin, at))
    begin, end = ends[which]
    claim = zigzag(size)
    longer = len(claim) - (end - begin)
    return content[:begin] + claim + content[end : at + 99] + content[at + 99 + longer :]


def columns(count=200_000, seed=0):
    return dict(zip("xyz", np.random.default_rng(seed).normal(size=(3, count)), strict=True))


def read(path):
    return sum(len(batch.xyz) for batch in open_map(path).batches())


@pytest.mark.parametrize("codec", CODECS)
@pytest.mark.parametrize(
    "options",
    [{}, {"row_group_size": 20}, {"data_page_version": "2.0"}, {"use_dictionary": False},
     {"write_page_checksum": True, "data_page_size": 64}, {"write_page_index": True}],
)  # fmt: skip
def test_pages_are_where_arrow_finds_them(tmp_path, codec, options):
    path = tmp_path / "map.parquet"
    path.write_bytes(parquet(table_of_all_kinds(50), compression=codec, **options))
    metadata = pq.read_metadata(path)
    expected = []
    for group in range(metadata.num_row_groups):
        expected.append([])
        for column in range(metadata.num_columns):
            said = metadata.row_group(group).column(column)
            starts = [said.data_page_offset]
            starts += [said.dictionary_page_offset] if said.has_dictionary_page else []
            expected[-1].append((min(starts), min(starts) + said.total_compressed_size))
    found = find_chunks(path)
    assert found == expected
    check_pages(path, [chunk for group in found for chunk in group])


@pytest.mark.parametrize("codec", CODECS)
@pytest.mark.parametrize("which", [0, 1], ids=["unpacked", "packed"])
@pytest.mark.parametrize("group", [0, 1])
@pytest.mark.parametrize("size", [MOST - 1, LARGEST_PAGE + 1, -5])
def test_a_page_takes_no_memory_that_it_does_not_fill(tmp_path, codec, which, group, size):
    content = parquet(
        pa.table(columns()), compression=codec, row_group_size=100_000, use_dictionary=False
    )
    assert len(content) > 4 << 20
    path = tmp_path / "map.parquet"
    path.write_bytes(content)
    place = find_chunks(path)[group][1][0]
    size = size if size > 0 else (1 << 64) - 3  # -2 as zigzag has it
    path.write_bytes(claiming(content, place, size, which))
    before = POOL.max_memory()
    with pytest.raises(MapFormatError, match=rf"map\.parquet: expected a page .* at byte {place}"):
        read(path)
    assert POOL.max_memory() < max(before, LARGEST_PAGE)


def test_a_page_larger_than_the_file_is_refused(tmp_path):
    path = tmp_path / "map.parquet"
    content = parquet(pa.table(columns(9)), use_dictionary=False)
    path.write_bytes(claiming(content, 4, len(content), 1))
    with pytest.raises(MapFormatError, match=rf"found one of {len(content)} bytes, \d+ unpacked"):
        read(path)


def test_large_pages_are_refused_as_the_documentation_says(tmp_path, monkeypatch):
    path = tmp_path / "map.parquet"
    table = pa.table({axis: np.zeros(9000) for axis in "xyz"})
    path.write_bytes(parquet(table, compression="ZSTD", use_dictionary=False))
    assert read(path) == 9000
    monkeypatch.setattr("tiling.formats.parquet_pages.LARGEST_PAGE", 70_000)
    with pytest.raises(MapFormatError, match=r"of at most 70000 bytes, found one of \d+ bytes, 72"):
        read(path)


def test_statistics_of_any_length_are_passed_over(tmp_path):
    path = tmp_path / "map.parquet"
    texts = pa.array(["a" * 30_000, "b" * 30_000] * 20)
    table = pa.table({**columns(40), "text": texts})
    path.write_bytes(parquet(table, use_dictionary=False))
    check_pages(path, [chunk for group in find_chunks(path) for chunk in group])
    assert read(path) == 40


WHOLE = parquet(pa.table(columns(300)), row_group_size=100, compression="SNAPPY")


@given(
    group=st.integers(0, 2),
    column=st.integers(0, 2),
    at=st.integers(0, 25),
    value=st.integers(0, 255),
)
@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_damaged_headers_are_read_or_refused_in_little_memory(tmp_path, group, column, at, value):
    path = tmp_path / "map.parquet"
    path.write_bytes(WHOLE)
    content, place = bytearray(WHOLE), find_chunks(path)[group][column][0]
    content[place + at] = value
    path.write_bytes(content)
    before = POOL.max_memory()
    try:
        assert read(path) == 300
    except MapFormatError as error:
        assert str(error).startswith(f"{path}: expected ")
        assert "\n" not in str(error)
    assert POOL.max_memory() < max(before, 2 * LARGEST_PAGE)


@given(st.binary(max_size=300))
@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_footer_is_passed_to_arrow(tmp_path, footer):
    path = tmp_path / "map.parquet"
    path.write_bytes(b"PAR1" + footer + len(footer).to_bytes(4, "little") + b"PAR1")
    assert isinstance(find_chunks(path), list)
    with pytest.raises(MapFormatError):
        read(path)
