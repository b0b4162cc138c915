"""The errors of maps on disk: one base class, flat subclasses, messages of one line."""

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


class TilingError(Exception):
    """Base class of every error that this package raises on purpose."""


class MapFormatError(TilingError):
    """A file is not what its format demands.

    Parameters
    ----------
    path : Path
        The file.
    expected : str
        What the format demands there.
    found : str
        What the file holds instead.
    at : str, optional
        Where, for example `"byte 227"` or `"line 11"`.
    """

    def __init__(self, path: Path, expected: str, found: str, at: str | None = None) -> None:
        self.path = path
        self.expected = expected
        self.found = found
        self.at = at
        place = f" at {at}" if at else ""
        # A header may hold anything at all: the message stays one line and printable.
        message = f"{path}: expected {expected}, found {found}{place}"
        super().__init__("".join(c if c.isprintable() else "?" for c in message))


class UnknownFormatError(MapFormatError):
    """No reader knows the file's kind."""


class CoordinateSystemError(MapFormatError):
    """A map's coordinates are angles, or those of its files are not of one system."""


class PointCountError(TilingError):
    """A writer was given more or fewer points than it was opened for."""


class PartsError(TilingError):
    """An output was to be written in parts whose format does not allow it.

    Parameters
    ----------
    path : Path
        The map that the output is to be like.
    format : str
        Its kind and variant.
    """

    def __init__(self, path: Path, format: str) -> None:
        self.path = path
        self.format = format
        super().__init__(f"{path}: expected a map with records of one size, found {format}")


class RowRangeError(TilingError):
    """Rows were asked for that a map does not have.

    Parameters
    ----------
    name : str
        What the map is called.
    rows : range
        What was asked for.
    point_count : int
        Points in the map.
    """

    def __init__(self, name: str, rows: range, point_count: int) -> None:
        self.rows = rows
        self.point_count = point_count
        message = f"{name}: expected consecutive rows from 0 to {point_count}, found {rows}"
        super().__init__("".join(c if c.isprintable() else "?" for c in message))


class NoMapError(TilingError):
    """The files, folders or patterns given name no map.

    Parameters
    ----------
    argument : str
        What was given.
    found : str
        What it names instead.
    """

    def __init__(self, argument: str, found: str) -> None:
        self.argument = argument
        self.found = found
        message = f"{argument}: expected a map, a folder of maps or a pattern, found {found}"
        super().__init__("".join(c if c.isprintable() else "?" for c in message))


class ChunkError(MapFormatError):
    """A piece or a chunk of a map that was cut is missing, not whole, or another map's."""


class GridError(TilingError):
    """Coordinates are on no grid that LAS can keep: they would not come back as they are.

    Parameters
    ----------
    name : str
        What the map is called.
    xyz : (3,) array
        A point that no grid gives back.
    """

    def __init__(self, name: str, xyz: "NDArray[np.float64]") -> None:
        self.xyz = xyz
        point = ", ".join(repr(value) for value in xyz.tolist())
        super().__init__(
            f"{name}: expected coordinates that LAS gives back as integer * scale + offset, found "
            f"a point that it does not ({point}); use Parquet chunks instead"
        )
