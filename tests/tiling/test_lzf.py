"""LZF against a decoder written from the format's description, on made and on real data."""

import io
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tiling.errors import MapFormatError
from tiling.formats.pcd import compressed as lzf

PATH = Path("map.pcd")


def plain_decode(packed):
    """Decode one instruction after the other; None for what is not LZF."""
    data = bytearray()
    position = 0
    while position < len(packed):
        control = packed[position]
        position += 1
        if control < 32:
            literal = packed[position : position + control + 1]
            if len(literal) <= control:
                return None
            data += literal
            position += control + 1
            continue
        length, distance = (control >> 5) + 2, (control & 31) << 8
        rest = packed[position : position + (2 if control >> 5 == 7 else 1)]
        if len(rest) < (2 if control >> 5 == 7 else 1):
            return None
        length += rest[0] if len(rest) == 2 else 0
        start = len(data) - distance - rest[-1] - 1
        if start < 0:
            return None
        for place in range(start, start + length):
            data.append(data[place])
        position += len(rest)
    return bytes(data)


def stream_decode(packed, size):
    blocks = lzf.decompress(io.BytesIO(packed), len(packed), size, PATH)
    return b"".join(block.tobytes() for block in blocks)


def pack(data):
    data = np.frombuffer(data, dtype=np.uint8)
    starts = range(0, len(data), lzf.BLOCK)
    return b"".join(lzf.compress(data[start : start + lzf.BLOCK]) for start in starts)


repetitive = st.lists(
    st.tuples(st.binary(min_size=1, max_size=40), st.integers(1, 400)), max_size=8
).map(lambda parts: b"".join(part * times for part, times in parts))


@given(st.one_of(st.binary(max_size=400), repetitive))
@settings(deadline=None)
def test_what_is_packed_is_unpacked_by_any_decoder(data):
    packed = pack(data)
    assert plain_decode(packed) == data
    assert stream_decode(packed, len(data)) == data
    assert len(packed) <= len(data) + len(data) // 32 + 1


@given(st.binary(max_size=60))
@settings(deadline=None, max_examples=300)
def test_any_bytes_are_decoded_like_the_plain_decoder_or_refused(packed):
    expected = plain_decode(packed)
    if expected is None:
        with pytest.raises(MapFormatError, match=r"map\.pcd: expected .* at byte \d+"):
            stream_decode(packed, 1 << 20)
    else:
        assert stream_decode(packed, len(expected)) == expected
        with pytest.raises(MapFormatError, match=f"found {len(expected)} bytes"):
            stream_decode(packed, len(expected) + 1)
        if expected:
            with pytest.raises(MapFormatError, match="more than these"):
                stream_decode(packed, len(expected) - 1)


def test_copies_reach_over_block_borders():
    start = np.random.default_rng(5).integers(0, 256, 8192, dtype=np.uint8).tobytes()
    literals = b"".join(b"\x1f" + start[i : i + 32] for i in range(0, 8192, 32))
    farthest = bytes([0xFF, 255, 255])
    packed = literals + farthest * (3 * lzf.BLOCK // lzf.LONGEST_COPY)
    data = plain_decode(packed)
    assert len(data) > 2 * lzf.BLOCK
    assert stream_decode(packed, len(data)) == data


def test_instructions_cross_block_borders_of_the_input():
    data = np.random.default_rng(6).integers(0, 256, 2 * lzf.BLOCK + 77, dtype=np.uint8).tobytes()
    packed = pack(data)
    assert len(packed) > 2 * lzf.BLOCK
    assert stream_decode(packed, len(data)) == data


def test_runs_are_compressed_well():
    assert len(pack(bytes(lzf.BLOCK))) < lzf.BLOCK // 80


def test_input_that_ends_early_is_refused():
    with pytest.raises(MapFormatError, match="10 compressed bytes, found the end of the file"):
        list(lzf.decompress(io.BytesIO(b"\x00a"), 10, 8, PATH))


def test_data_written_by_pcl(shared_data):
    content = (shared_data / "formats/binary_compressed_depot.pcd").read_bytes()
    start = content.index(b"binary_compressed\n") + len(b"binary_compressed\n")
    packed_size, size = struct.unpack_from("<II", content, start)
    packed = content[start + 8 : start + 8 + packed_size]
    assert stream_decode(packed, size) == plain_decode(packed)
