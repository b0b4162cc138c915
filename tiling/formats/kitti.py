"""Scans as KITTI has them: float32 x, y, z and intensity, without a header."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np

from tiling.errors import MapFormatError
from tiling.formats.numpy.arrays import ArrayHeader
from tiling.formats.numpy.npy import NpyReader
from tiling.formats.points import COORDINATES, Field, MapDescription


@dataclass(frozen=True, slots=True)
class _NoHeader(ArrayHeader):
    """An array that starts with its first value."""

    def encode(self, row_count: int) -> bytes:
        """Return nothing."""
        del row_count
        return b""


class KittiReader(NpyReader):
    """Reads a `.bin` of KITTI.

    Raises
    ------
    MapFormatError
        When the size is not that of whole points.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        count, rest = divmod(path.stat().st_size, 16)
        if rest:
            raise MapFormatError(path, "points of 16 bytes", f"{rest} bytes behind the last")
        self._header = _NoHeader(np.dtype("<f4"), False, (count, 4))
        fields = tuple(Field(name, "float32") for name in (*COORDINATES, "intensity"))
        self.description = MapDescription(path, "KITTI bin", ".bin", count, fields)

    def extended(self, fields: Sequence[Field]) -> NoReturn:
        """Refuse: there is no place for further fields."""
        names = ", ".join(field.name for field in fields)
        raise MapFormatError(self._path, f"a format with room for {names}", "KITTI bin")
