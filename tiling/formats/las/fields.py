"""The fields of a LAS file: those of its point format, and the extra bytes behind them.

Those of LAS 1.0 to 1.4 are written down here, by the names that laspy gives them, and compared with
laspy in a test: to ask laspy means to import it, with what it needs for geodesy and for the
network, before a run knows how large its map is. A record gives extra bytes names and types; byte
positions are those of the ASPRS LAS specification, 1.4 R15 (table 24).
"""

import struct
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tiling.errors import MapFormatError
from tiling.formats.las.compression import is_laszip_record, own_compression
from tiling.formats.las.header import (
    SMALLEST_HEADER,
    At,
    LasHeader,
    read_vlrs,
)
from tiling.formats.points import Field

USER_ID, RECORD_ID = "LASF_Spec", 4
"""The VLR of extra bytes."""

_FIRST = "X:int32 Y:int32 Z:int32 intensity:uint16 return_number number_of_returns"
_SHORT = (
    f"{_FIRST} scan_direction_flag edge_of_flight_line classification synthetic key_point withheld "
    "scan_angle_rank:int8 user_data point_source_id:uint16"
)
_LONG = (
    f"{_FIRST} synthetic key_point withheld overlap scanner_channel scan_direction_flag "
    "edge_of_flight_line classification user_data scan_angle:int16 point_source_id:uint16 "
    "gps_time:float64"
)
_TIME = "gps_time:float64"
_COLOUR = "red:uint16 green:uint16 blue:uint16"
_INFRARED = "nir:uint16"
_WAVEFORM = (
    "wavepacket_index wavepacket_offset:uint64 wavepacket_size:uint32 "
    "return_point_wave_location:float32 x_t:float32 y_t:float32 z_t:float32"
)

_FIELDS = (
    (_SHORT,),
    (_SHORT, _TIME),
    (_SHORT, _COLOUR),
    (_SHORT, _TIME, _COLOUR),
    (_SHORT, _TIME, _WAVEFORM),
    (_SHORT, _TIME, _COLOUR, _WAVEFORM),
    (_LONG,),
    (_LONG, _COLOUR),
    (_LONG, _COLOUR, _INFRARED),
    (_LONG, _WAVEFORM),
    (_LONG, _COLOUR, _INFRARED, _WAVEFORM),
)

# Types from code 1 on; codes 11 to 30 are pairs and triples of them, code 0 is as many bytes as
# the options say.
_TYPES = (
    *("uint8", "int8", "uint16", "int16", "uint32", "int32", "uint64", "int64"),
    *("float32", "float64"),
)
_LAST_CODE = 30
_DESCRIPTOR = struct.Struct("<2xBB32s156x")


def standard_fields(point_format: int) -> tuple[Field, ...]:
    """Return the fields of a point format, 0 to 10; those of a few bits are uint8."""
    words = " ".join(_FIELDS[point_format]).split()
    parts = (word.partition(":") for word in words)
    return tuple(Field(name, dtype or "uint8") for name, _, dtype in parts)


def extra_fields(header: LasHeader) -> tuple[Field, ...]:
    """Return what is known of the extra bytes; those without a description are `ExtraBytes`."""
    fields, left = _described(header)
    return (*fields, Field("ExtraBytes", "uint8", left)) if left else fields


def _extended_descriptors(header: LasHeader, fields: Sequence[Field]) -> bytes:
    """Return the data of a VLR that describes the extra bytes of a file, and further ones."""
    described, left = _described(header)
    data = bytearray(_stored(header)[: len(described) * _DESCRIPTOR.size])
    piece = 0
    # Further fields could not be found behind what nobody described. It comes in pieces of sizes
    # that laspy takes: it reads two bits of a size, 8 and 16, as those of a scale and an offset.
    while left:
        size = next(each for each in range(min(left, 0xFF), 0, -1) if not each & 0b11000)
        piece += 1
        data += _DESCRIPTOR.pack(0, size, b"ExtraBytes" if piece == 1 else b"ExtraBytes %d" % piece)
        left -= size
    for field in fields:
        data += _DESCRIPTOR.pack(_TYPES.index(field.dtype) + 1, 0, field.name.encode())
    return bytes(data)


def _described(header: LasHeader) -> tuple[tuple[Field, ...], int]:
    """Return the fields that are described and are there, and how many bytes are left."""
    left = header.extra_bytes
    fields = []
    for code, options, text in _DESCRIPTOR.iter_unpack(_stored(header)):
        dtype, count = "uint8", options
        if code:
            dtype, count = _TYPES[(code - 1) % len(_TYPES)], (code - 1) // len(_TYPES) + 1
        size = np.dtype(dtype).itemsize * count
        if code > _LAST_CODE or not 0 < size <= left:
            break
        left -= size
        fields.append(Field(text.split(b"\0")[0].decode("utf-8", "replace"), dtype, count))
    return tuple(fields), left


def _stored(header: LasHeader) -> bytes:
    """Return all descriptors; there are files that have several VLRs of them."""
    return b"".join(
        each.data[: len(each.data) // _DESCRIPTOR.size * _DESCRIPTOR.size]
        for each in header.vlrs
        if each.names(USER_ID, RECORD_ID)
    )


LAST_SHORT_CLASS = 31
"""Until point format 5, a class has five bits."""

_VLR_HEADER = struct.Struct("<2x16sHH32s")
_LARGEST = 0xFFFF
"""Bytes of a point, and of the data of a VLR, at most."""


def extended_header(header: LasHeader, fields: Sequence[Field]) -> LasHeader:
    """Return the header of a file's points with further extra bytes, and the VLRs that these need.

    The VLR of extra bytes gets a descriptor for each field; one is made where there is none, and of
    several. That of LASzip, which lists the bytes of a point, is written anew. Points and VLRs that
    would be longer than the format allows are refused.
    """
    length = header.record_length + sum(np.dtype(field.dtype).itemsize for field in fields)
    descriptors = _extended_descriptors(header, fields)
    for size, name in ((length, "points"), (len(descriptors), "descriptions of extra bytes")):
        if size > _LARGEST:
            expected = f"{name} of at most {_LARGEST} bytes with the fields that are added"
            raise MapFormatError(header.path, expected, f"{size} bytes")
    longer = _with_vlr(_with_whole_header(header), USER_ID, RECORD_ID, descriptors)
    if header.compressed:
        record = next(each for each in header.vlrs if is_laszip_record(each))
        data = own_compression(replace(header, record_length=length))
        longer = _with_vlr(longer, record.user_id, record.record_id, data)
    block = bytearray(longer.block)
    struct.pack_into("<H", block, At.RECORD_LENGTH, length)
    struct.pack_into("<I", block, At.POINTS_OFFSET, len(block))
    return replace(longer, block=bytes(block), record_length=length)


def _with_whole_header(header: LasHeader) -> LasHeader:
    """Give a header the size that its version demands, lest VLRs be taken for missing fields."""
    minor = header.block[At.MINOR_VERSION]
    size = max(header.public_size, SMALLEST_HEADER[minor])
    block = bytearray(header.block)
    block[header.public_size : header.public_size] = bytes(size - header.public_size)
    struct.pack_into("<H", block, At.HEADER_SIZE, size)
    return replace(header, block=bytes(block), minor_version=minor, vlrs=read_vlrs(block))


def _with_vlr(header: LasHeader, user_id: str, record_id: int, data: bytes) -> LasHeader:
    """Give a VLR other data, in place of all of its name, or put a new one behind the others."""
    block = bytearray(header.block)
    same = [record for record in header.vlrs if record.names(user_id, record_id)]
    for record in reversed(same[1:]):
        del block[record.start : record.end]
    if same:
        first = same[0]
        block[first.end - len(first.data) : first.end] = data
        struct.pack_into("<H", block, first.start + 20, len(data))
    else:
        end = header.vlrs[-1].end if header.vlrs else header.public_size
        block[end:end] = _VLR_HEADER.pack(user_id.encode(), record_id, len(data), b"") + data
    count = len(header.vlrs) - len(same) + 1
    struct.pack_into("<I", block, At.VLR_COUNT, count)
    return replace(header, block=bytes(block), vlrs=read_vlrs(block))
