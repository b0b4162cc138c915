"""The errors of maps on disk: one base class, flat subclasses, messages of one line."""

from pathlib import Path
from typing import TYPE_CHECKING

from tiling.foreign_text import LONGEST_MESSAGE, printable, printable_path

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


class TilingError(Exception):
    """Base class of every error that this package raises on purpose.

    The message is made one printable line, and cut where it is too long: it may quote what a file
    holds.
    """

    def __init__(self, message: str) -> None:
        super().__init__(printable(message, LONGEST_MESSAGE))


class MapFormatError(TilingError):
    """A file is not what its format demands.

    Parameters
    ----------
    expected, found : str
        What the format demands, and what the file holds instead.
    at : str, optional
        Where, for example `"byte 227"` or `"line 11"`.
    """

    def __init__(self, path: Path, expected: str, found: str, at: str | None = None) -> None:
        self.path = path
        self.expected = expected
        self.found = found
        self.at = at
        place = f" at {at}" if at else ""
        expected, found = printable(expected), printable(found)
        super().__init__(f"{printable_path(path)}: expected {expected}, found {found}{place}")


class UnknownFormatError(MapFormatError):
    """No reader knows the file's kind."""


class CoordinateSystemError(MapFormatError):
    """A map's coordinates are angles, or those of its files are not of one system."""


class PointCountError(TilingError):
    """A writer was given more or fewer points than it was opened for."""


class PartsError(TilingError):
    """An output was to be written in parts whose format does not allow it."""

    def __init__(self, path: Path, format: str) -> None:
        name = printable_path(path)
        super().__init__(f"{name}: expected a map with records of one size, found {format}")


class RowRangeError(TilingError):
    """Rows were asked for that a map does not have."""

    def __init__(self, name: str, rows: range, point_count: int) -> None:
        expected = f"expected consecutive rows from 0 to {point_count}"
        super().__init__(f"{printable_path(name)}: {expected}, found {rows}")


class NoMapError(TilingError):
    """The files, folders or patterns given name no map."""

    def __init__(self, argument: str, found: str) -> None:
        expected = "expected a map, a folder of maps or a pattern"
        super().__init__(f"{printable_path(argument)}: {expected}, found {printable(found)}")


class SeveralMapsError(NoMapError):
    """A folder holds maps that are not parts of one."""


class ChunkError(MapFormatError):
    """A piece or a chunk of a map that was cut is missing, not whole, or another map's."""


class GridError(TilingError):
    """Coordinates are on no grid that LAS can keep: they would not come back as they are."""

    def __init__(self, name: str, xyz: "NDArray[np.float64]") -> None:
        point = ", ".join(repr(value) for value in xyz.tolist())
        super().__init__(
            f"{printable_path(name)}: expected coordinates that LAS gives back as integer * scale "
            f"+ offset, found a point that it does not ({point}); use Parquet chunks instead"
        )
