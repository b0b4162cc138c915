"""Rows of numbers: what is a number, which one, and what is kept of the text."""

import io
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tiling.errors import MapFormatError
from tiling.formats import text_rows
from tiling.formats.text_rows import RowLayout, read_rows

PATH = Path("map.pcd")
XYZ = RowLayout(3, (0, 1, 2))
NUMBER = re.compile(
    r"[+-]?(\d+\.?\d*(e[+-]?\d+)?|\.\d+(e[+-]?\d+)?|nan(\([a-z0-9_]*\))?|inf|infinity)",
    re.IGNORECASE,
)


def parse(text, count, layout=XYZ, max_rows=1000):
    batches = list(read_rows(io.BytesIO(text), layout, count, max_rows, PATH, 12))
    xyz = np.concatenate([np.empty((0, 3)), *(xyz for _, xyz in batches)])
    return xyz, b"".join(rows.tobytes() for rows, _ in batches)


def value_of(word):
    return float(re.sub(r"\(.*\)", "", word))


ODD_NUMBERS = [
    *("+1.5", "5.", ".5", "-.5E+3", "00012.500", "-0", "1e400", "-1e400", "1e-400"),
    *("NaN", "-nan", "+nan", "nan(ind)", "-nan(0x7)"),
    *("INF", "-inf", "Infinity", "-INFINITY"),
]
written_numbers = st.one_of(
    st.floats().map(repr),
    st.tuples(st.floats(), st.integers(0, 25)).map(lambda pair: f"{pair[0]:.{pair[1]}g}"),
    st.tuples(st.floats(-1e9, 1e9), st.integers(0, 25)).map(lambda pair: f"{pair[0]:.{pair[1]}f}"),
    st.integers(-(10**25), 10**25).map(str),
    st.sampled_from(ODD_NUMBERS),
)


@given(st.lists(st.lists(written_numbers, min_size=4, max_size=4), max_size=8), st.integers(1, 9))
@settings(deadline=None, max_examples=200)
def test_coordinates_are_the_nearest_float64(rows, max_rows):
    text = "".join(" ".join(row) + "\n" for row in rows).encode()
    xyz, kept = parse(text, len(rows), RowLayout(4, (2, 0, 3)), max_rows)
    expected = [[value_of(row[place]) for place in (2, 0, 3)] for row in rows]
    np.testing.assert_array_equal(xyz, np.array(expected).reshape(-1, 3))
    signed = np.signbit(xyz) == np.signbit(np.array(expected).reshape(-1, 3))
    assert (signed | np.isnan(xyz)).all()
    assert kept == text


@given(st.text(alphabet="0123456789+-.eEnaNAifINFty()_x,", min_size=1, max_size=9))
@settings(deadline=None, max_examples=500)
def test_only_numbers_are_numbers(word):
    text = f"1 2 3 {word}\n".encode()
    layout = RowLayout(4, (0, 1, 2))
    if NUMBER.fullmatch(word):
        assert parse(text, 1, layout)[0].tolist() == [[1, 2, 3]]
    else:
        with pytest.raises(MapFormatError, match="line 12, value 4"):
            parse(text, 1, layout)


@pytest.mark.parametrize(
    "text",
    [
        b"1 2 3\n4 5 6\n",
        b"1 2 3\n4 5 6",
        b"1 2 3 \r\n\t4\t5  6 \r\n",
        b"1 2 3\n4 5 6\n\n  \n\r\n",
        b"\n1 2 3\n\n \t\n4 5 6\n",
        b"1 2 3\r\n4 5 6\r",
    ],
)
@pytest.mark.parametrize("max_rows", [1, 2, 100])
def test_blanks_blank_lines_and_line_endings(text, max_rows):
    xyz, kept = parse(text, 2, max_rows=max_rows)
    assert xyz.tolist() == [[1, 2, 3], [4, 5, 6]]
    lines = text.splitlines(keepends=True)
    assert kept == b"".join(line for line in lines if line.strip())


@pytest.mark.parametrize(
    ("text", "found"),
    [
        (b"1 2 3\n4 5\n", "expected 3 values in a row, found 2 at line 13"),
        (b"1 2 3\n\n4 5 6 7\n", "expected 3 values in a row, found 4 at line 14"),
        (b"1 2 3\n4 five 6\n", "expected a number, found 'five' at line 13, value 2"),
        (b"1 2 3\n4 5 6\x00\n", r"found '6\\x00' at line 13, value 3"),
        (b"1 2 3\n\xff\xfe 5 6\n", "expected a number, found .* at line 13, value 1"),
        (b"1 2 3\n", "expected 2 points, found the end of the file after 1 at line 13"),
        (b"", "expected 2 points, found the end of the file after 0 at line 12"),
        (b"1 2 3\n4 5 6\n\n7 8 9\n", "expected 2 points, found more rows at line 15"),
        (b"1 2 3\n4 5 6\n7 8 9\n1 2", "expected 2 points, found more rows at line 14"),
    ],
)
@pytest.mark.parametrize("max_rows", [1, 2, 100])
def test_broken_rows_are_refused_with_their_line(text, found, max_rows):
    with pytest.raises(MapFormatError, match=found):
        parse(text, 2, max_rows=max_rows)


@pytest.mark.parametrize("block", [1, 2, 7, 64])
def test_any_block_size_gives_the_same_rows(block, monkeypatch):
    text = b"".join(b"%d %d.5 -%de-2 \n" % (i, i, i) for i in range(50))
    whole = parse(text, 50)
    monkeypatch.setattr(text_rows, "BLOCK", block)
    cut = parse(text, 50)
    np.testing.assert_array_equal(cut[0], whole[0])
    assert cut[1] == whole[1] == text


def test_an_endless_line_is_refused_before_it_is_read_whole(monkeypatch):
    monkeypatch.setattr(text_rows, "BLOCK", 1 << 10)
    stream = io.BytesIO(b"1" * (1 << 20))
    with pytest.raises(MapFormatError, match="a line of over 1536 bytes at byte 0"):
        list(read_rows(stream, XYZ, 1, 10, PATH, 12))
    assert stream.tell() < 1 << 12


def test_chosen_rows_keep_their_text():
    (rows, _), *_ = read_rows(io.BytesIO(b"1 2 3 \n4 5\t6\r\n7 8 9\n"), XYZ, 3, 10, PATH, 1)
    chosen = rows[np.array([False, True, True])]
    assert len(chosen) == 2
    assert chosen.tobytes() == b"4 5\t6\r\n7 8 9\n"
    assert rows[np.zeros(3, dtype=bool)].tobytes() == b""
