"""LAS and LAZ files like another, whose points have further extra bytes."""

import struct
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tiling.errors import MapFormatError
from tiling.formats.base import ExtendedFormat, MapReader
from tiling.formats.extension import bytes_of, packed
from tiling.formats.las.fields import RECORD_ID, USER_ID, extended_descriptors
from tiling.formats.las.header import (
    AT_HEADER_SIZE,
    AT_MINOR_VERSION,
    AT_POINTS_OFFSET,
    AT_RECORD_LENGTH,
    AT_VLR_COUNT,
    RECORD_LENGTHS,
    SMALLEST_HEADER,
    LasHeader,
    read_vlrs,
)
from tiling.formats.las.laz_header import is_laszip_record, own_compression
from tiling.formats.points import Field, PointBatch

LAST_SHORT_CLASS = 31
"""Until point format 5, a class has five bits."""

_VLR_HEADER = struct.Struct("<2x16sHH32s")
_LARGEST = 0xFFFF
"""Bytes of a point, and of the data of a VLR, at most."""


class ExtendedLas(ExtendedFormat):
    """LAS or LAZ files of points with further extra bytes.

    Parameters
    ----------
    model, fields
        As for `ExtendedFormat`.
    header : LasHeader
        Of the points that are extended.
    """

    def __init__(self, model: MapReader, fields: Sequence[Field], header: LasHeader) -> None:
        super().__init__(model, fields)
        self._header = header

    def extend(
        self,
        batch: PointBatch,
        values: Sequence[NDArray[Any]],
        classification: NDArray[np.uint8] | None = None,
    ) -> NDArray[np.uint8]:
        """Return the records with the values; see `ExtendedFormat.extend`."""
        records = np.hstack([batch.records, bytes_of(packed(self.fields, values))])
        if classification is not None:
            if self._header.point_format < 6:
                # The other three bits are flags: synthetic, key-point, withheld.
                records[:, 15] &= np.uint8(0xFF ^ LAST_SHORT_CLASS)
                records[:, 15] |= classification & np.uint8(LAST_SHORT_CLASS)
            else:
                records[:, 16] = classification
        return records


def extended_header(header: LasHeader, fields: Sequence[Field]) -> LasHeader:
    """Return the header of points with further extra bytes, and the VLRs that these need.

    The VLR of extra bytes gets a descriptor for each field; one is made where there is none, and of
    several.
    That of LASzip, which lists the bytes of a point, is written anew.

    Parameters
    ----------
    header : LasHeader
        Of the file whose points are extended.
    fields : sequence of Field
        Each of one value.

    Raises
    ------
    MapFormatError
        When a point, or the VLR, would be longer than the format allows.
    """
    length = header.record_length + sum(np.dtype(field.dtype).itemsize for field in fields)
    descriptors = extended_descriptors(header, fields)
    for size, name in ((length, "points"), (len(descriptors), "descriptions of extra bytes")):
        if size > _LARGEST:
            expected = f"{name} of at most {_LARGEST} bytes with the fields that are added"
            raise MapFormatError(header.path, expected, f"{size} bytes")
    longer = _with_vlr(_with_whole_header(header), USER_ID, RECORD_ID, descriptors)
    if header.compressed:
        record = next(each for each in header.vlrs if is_laszip_record(each))
        extra = length - RECORD_LENGTHS[header.point_format]
        data = own_compression(header.point_format, extra, variable_chunks=False)
        longer = _with_vlr(longer, record.user_id, record.record_id, data)
    block = bytearray(longer.block)
    struct.pack_into("<H", block, AT_RECORD_LENGTH, length)
    struct.pack_into("<I", block, AT_POINTS_OFFSET, len(block))
    return replace(longer, block=bytes(block), record_length=length)


def _with_whole_header(header: LasHeader) -> LasHeader:
    """Give a header that is too short for its version the size that this version demands.

    Readers would take what is put behind it for the fields that are missing.
    """
    minor = header.block[AT_MINOR_VERSION]
    size = max(header.public_size, SMALLEST_HEADER[minor])
    block = bytearray(header.block)
    block[header.public_size : header.public_size] = bytes(size - header.public_size)
    struct.pack_into("<H", block, AT_HEADER_SIZE, size)
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
    struct.pack_into("<I", block, AT_VLR_COUNT, count)
    return replace(header, block=bytes(block), vlrs=read_vlrs(block))
