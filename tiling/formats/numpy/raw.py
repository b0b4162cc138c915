"""Bare records of float32, as KITTI and nuScenes store scans: no header, the size tells the points.

`.bin` has x, y, z and intensity (16 bytes), `.pcd.bin` the ring as well (20 bytes).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np

from tiling.errors import MapFormatError
from tiling.formats.numpy.arrays import ArrayHeader
from tiling.formats.numpy.npy import NpyReader
from tiling.formats.points import Field, MapDescription
from tiling.formats.signature import SIGNATURE_LENGTH, kind_of

_NAMES = ("x", "y", "z", "intensity", "ring")
_NUSCENES = ".pcd.bin"
_UNKNOWN = "a file that begins"


@dataclass(frozen=True, slots=True)
class _NoHeader(ArrayHeader):
    """An array that starts with its first value."""

    def encode(self, row_count: int) -> bytes:
        """Return nothing."""
        del row_count
        return b""


class RawReader(NpyReader):
    """Reads bare records.

    Parameters
    ----------
    path : Path

    Raises
    ------
    MapFormatError
        When the size is not that of whole records, or the file is known to be another thing.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        is_nuscenes = path.name.lower().endswith(_NUSCENES)
        names = _NAMES if is_nuscenes else _NAMES[:4]
        size, record = path.stat().st_size, 4 * len(names)
        with path.open("rb") as file:
            start = file.read(SIGNATURE_LENGTH)
        kind = kind_of(start)
        if size and not kind.startswith(_UNKNOWN) and start.strip(b"\0"):
            raise MapFormatError(path, f"records of float32 {', '.join(names)}", kind, at="byte 0")
        if size % record:
            expected = f"records of {record} bytes, float32 {', '.join(names)}"
            raise MapFormatError(path, expected, f"{size} bytes, {size % record} too many")
        self._header = _NoHeader(np.dtype("<f4"), False, (size // record, len(names)))
        self.description = MapDescription(
            path=path,
            format=f"bare float32 records, as {'nuScenes' if is_nuscenes else 'KITTI'} has them",
            suffix=_NUSCENES if is_nuscenes else ".bin",
            point_count=size // record,
            fields=tuple(Field(name, "float32") for name in names),
            notes=() if size else ("The file has no points.",),
        )

    def extended(self, fields: Sequence[Field]) -> NoReturn:
        """Refuse: without a header nobody would find further fields."""
        expected = "a format with names for further fields; --labels writes them beside the map"
        raise MapFormatError(self._path, expected, self.description.format)
