"""The errors of maps on disk: one base class, flat subclasses, messages of one line."""

from pathlib import Path


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


class PointCountError(TilingError):
    """A writer was given more or fewer points than it was opened for."""


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
