"""The laszip VLR of a LAZ file: how its points are compressed.

LASzip's format is described by its author (Isenburg 2013, LASzip: lossless compression of LiDAR
data) and by its source.
"""

import struct
from dataclasses import dataclass
from importlib import import_module
from typing import Any, NoReturn

from tiling.errors import MapFormatError
from tiling.formats.las.header import RECORD_LENGTHS, LasHeader, VariableLengthRecord

lazrs: Any = import_module("lazrs")  # without types that a checker can use

_POINT_WISE, _POINT_WISE_CHUNKED, _LAYERED_CHUNKED = 1, 2, 3
_VARIABLE_CHUNK_SIZE = 0xFFFFFFFF
_AT_CHUNK_SIZE = 12
_AT_ITEMS = 32

_WAVE_PACKET13 = 9
_LAYERS = {10: 9, 11: 1, 12: 2, 13: 1}
"""Layers of each item of a chunk of layers, by its code; extra bytes are a layer each."""


def is_laszip_record(record: VariableLengthRecord) -> bool:
    """Tell whether a VLR is the one that says how the points are compressed."""
    return record.names("laszip encoded", 22204)


@dataclass(frozen=True, slots=True)
class Compression:
    """How the points of a LAZ file are compressed: the laszip VLR, checked."""

    data: bytes
    """The VLR's data."""
    compressor: int
    """1 for points in one stretch, 2 for chunks of points, 3 for chunks of layers."""
    chunk_size: int
    """Points in a chunk; `0xFFFFFFFF` where each has its own number."""
    item_versions: tuple[int, ...]
    """LASzip's version of each item of a point."""
    layers: int
    """Separately compressed layers in a chunk of layers."""

    @property
    def has_chunks(self) -> bool:
        """Whether an offset to a chunk table precedes the points."""
        return self.compressor != _POINT_WISE

    @property
    def has_layers(self) -> bool:
        """Whether each chunk is made of layers."""
        return self.compressor == _LAYERED_CHUNKED

    @property
    def has_variable_chunks(self) -> bool:
        """Whether the chunk table says how many points each chunk has."""
        return self.has_chunks and self.chunk_size == _VARIABLE_CHUNK_SIZE

    @property
    def needs_laszip(self) -> bool:
        """Whether points of several scanner channels are stored in a way that lazrs cannot read.

        Version 4 of LASzip's items differs from version 3, which lazrs reads, in what the items
        beside the first remember of each channel.
        """
        return 4 in self.item_versions and len(self.item_versions) > 1

    def can_be_written_as(self, data: bytes) -> bool:
        """Tell whether a writer that follows the VLR `data` also follows this one.

        Both must agree in compressor and items; chunks of any fixed size will do.
        """
        same_items = self.data[_AT_ITEMS : len(data)] == data[_AT_ITEMS:]
        return self.data[:2] == data[:2] and same_items and not self.has_variable_chunks

    def for_chunks(self, points: int) -> bytes:
        """Return the VLR's data for lazrs, for chunks of so many points."""
        data = bytearray(self.data)
        struct.pack_into("<I", data, _AT_CHUNK_SIZE, min(points, _VARIABLE_CHUNK_SIZE - 1))
        for item, version in enumerate(self.item_versions):
            at = _AT_ITEMS + 2 + 6 * item + 4
            struct.pack_into("<H", data, at, min(version, 3))
        return bytes(data)


def own_compression(point_format: int, extra_bytes: int, variable_chunks: bool) -> bytes:
    """Return the data of a laszip VLR that lazrs can follow, and every reader understands.

    lazrs calls its wave packets of point formats 4 and 5 version 2, although LASzip knows them in
    version 1 only, which is what they are.
    """
    vlr = lazrs.LazVlr.new_for_compression(point_format, extra_bytes, variable_chunks)
    data = bytearray(vlr.record_data())
    for item, (kind, _, _) in enumerate(_items(data)):
        if kind == _WAVE_PACKET13:
            struct.pack_into("<H", data, _AT_ITEMS + 2 + 6 * item + 4, 1)
    return bytes(data)


def _items(data: bytes | bytearray) -> list[tuple[int, int, int]]:
    """Return code, bytes in a point and version of each item that a VLR lists."""
    (count,) = struct.unpack_from("<H", data, _AT_ITEMS)
    return list(struct.iter_unpack("<HHH", data[_AT_ITEMS + 2 :][: 6 * count]))


def read_compression(header: LasHeader) -> Compression:
    """Find and check the laszip VLR of a LAZ file.

    Raises
    ------
    MapFormatError
        When there is none, or it describes other points than the header does.
    """
    record = next((r for r in header.vlrs if is_laszip_record(r)), None)
    if record is None:
        raise MapFormatError(header.path, "a laszip VLR, since the points are compressed", "none")
    start = record.end - len(record.data)
    if len(record.data) < _AT_ITEMS + 2:
        refuse(header, "a laszip VLR of 34 bytes or more", f"{len(record.data)} bytes", start)
    compressor, coder = struct.unpack_from("<HH", record.data)
    (chunk_size,) = struct.unpack_from("<I", record.data, _AT_CHUNK_SIZE)
    (item_count,) = struct.unpack_from("<H", record.data, _AT_ITEMS)
    if len(record.data) < _AT_ITEMS + 2 + 6 * item_count:
        refuse(header, "the laszip VLR to hold its items", f"{item_count} items", start)
    allowed = (_LAYERED_CHUNKED,) if header.point_format >= 6 else (1, 2)
    if compressor not in allowed:
        names = " or ".join(map(str, allowed))
        expected = f"LASzip compressor {names} for point format {header.point_format}"
        refuse(header, expected, str(compressor), start)
    if coder != 0:
        refuse(header, "LASzip coder 0", str(coder), start + 2)
    if compressor != _POINT_WISE and chunk_size == 0:
        refuse(header, "LASzip chunks of 1 point or more", "0", start + _AT_CHUNK_SIZE)
    stored = _items(record.data)
    _check_items(header, stored, start + _AT_ITEMS)
    return Compression(
        data=record.data,
        compressor=compressor,
        chunk_size=chunk_size,
        item_versions=tuple(version for _, _, version in stored),
        layers=sum(_LAYERS.get(kind, size) for kind, size, _ in stored),
    )


def _check_items(header: LasHeader, stored: list[tuple[int, int, int]], at: int) -> None:
    """Check that LASzip's items make up the points that the header describes."""
    layered = header.point_format >= 6
    extra_bytes = header.record_length - RECORD_LENGTHS[header.point_format]
    own = own_compression(header.point_format, extra_bytes, variable_chunks=False)
    expected = [(kind, size) for kind, size, _ in _items(own)]
    found = [(kind, size) for kind, size, _ in stored]
    if found != expected:
        refuse(header, f"LASzip items (type, bytes) {expected}", str(found), at)
    versions = {version for _, _, version in stored}
    known = ({3}, {4}) if layered else ({1}, {2}, {1, 2})
    if versions not in known:
        names = "3 or 4" if layered else "1 or 2"
        refuse(header, f"LASzip items of version {names}", f"version {max(versions)}", at)


def refuse(header: LasHeader, expected: str, found: str, at: int) -> NoReturn:
    """Raise the error of a file that is not what its header announces."""
    raise MapFormatError(header.path, expected, found, f"byte {at}")
