"""Several files that are one map: finding them, and reading them as one stream."""

import glob
import hashlib
import re
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import accumulate
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tiling.errors import NoMapError, SeveralMapsError
from tiling.formats import MAP_SUFFIXES, OTHERS_TOO, open_map
from tiling.formats.base import MapReader
from tiling.formats.points import DEFAULT_BATCH, PointBatch, checked_rows
from tiling.key_frames import Frame, ScanPoses, find_poses, scan_folder

_HASH_BLOCK = 1 << 20

_SEVERAL_MAPS: tuple[frozenset[str], ...] = (
    frozenset({"static", "dynamic"}),
    frozenset({"globalmap", "surfmap"}),
    frozenset({"globalmap", "trajectory"}),
    frozenset({"cornermap", "surfmap"}),
    frozenset({"trajectory", "transformations"}),
)
"""Names, in lower case and without suffixes, of files that are not parts of one map."""


def find_map_files(arguments: Sequence[Path | str], as_one: bool = True) -> tuple[Path, ...]:
    """Find the files that the arguments name.

    Parameters
    ----------
    arguments : sequence of Path or str
        Each is a file, whatever its suffix; or a folder, which means the scans in it where these
        have poses (`tiling.key_frames`), and else the maps directly in it, and in its partitions
        (folders called `key=value`, as Spark writes them, at any depth); or a pattern (`*`, `?`,
        `[...]`, and `**` for folders at any depth), unless there is something of that very name.
        In folders and patterns, hidden files and those without a suffix of `MAP_SUFFIXES` are
        passed over, and so are those with one of `OTHERS_TOO` where there are maps with another,
        or where each map of a folder is one of its own.
    as_one : bool
        Whether together they are one map: a folder of several maps of one place is refused, and
        the scans of a folder may lie in one within it.

    Returns
    -------
    tuple of Path
        Each file once, in the order of the arguments, and within a folder or pattern by name
        with numbers in order of value (`cell_2` before `cell_10`).

    Raises
    ------
    NoMapError
        When an argument names no map, or one that cannot be read, or there are no arguments;
        `SeveralMapsError` when it names several that are not parts of one.
    MapFormatError
        When a file that could be a scan is not a map that can be read.
    """
    if not arguments:
        raise NoMapError("no argument", "none")
    found: dict[Path, Path] = {}
    for argument in arguments:
        try:
            files = _files_of(argument, as_one)
        except OSError as error:
            reason = error.strerror or type(error).__name__
            raise NoMapError(str(argument), f"one that cannot be read ({reason})") from error
        for path in files:
            found.setdefault(path.resolve(), path)
    return tuple(found.values())


def content_hash(paths: Sequence[Path], advance: Callable[[int], None] | None = None) -> str:
    """Hash the bytes of files, whose names do not matter but whose order and sizes do.

    Returns SHA-256 in hexadecimal; for a single file, the one that `sha256sum` prints. `advance` is
    told of the bytes of each block that was hashed; what it raises ends the hashing.
    """
    digest = hashlib.sha256()
    for number, path in enumerate(paths):
        if number:
            # Without the size, moving bytes from one file to the next would go unseen.
            digest.update(b"\0next file, %d bytes\0" % path.stat().st_size)
        with path.open("rb") as file:
            while block := file.read(_HASH_BLOCK):
                digest.update(block)
                if advance is not None:
                    advance(len(block))
    return digest.hexdigest()


class MapCollection:
    """Files that together are one map, whose points are numbered on from file to file.

    Parameters
    ----------
    paths : sequence of Path
        The files, as `find_map_files` gives them. Every header is read and checked.
    threads : int
        Cores that reading and writing a file may use at once, see `MapReader.threads`.
    poses : Path, optional
        A file of the scans' poses, in the place of what lies beside the files.
    frame : str
        That the scans' points are in: see `find_poses`.

    Attributes
    ----------
    readers : tuple of MapReader
        One for each file.
    first_rows : tuple of int
        For each file, the row number in the whole map of its first point.
    metres : (3,) float64 array or None
        What coordinates are multiplied by on their way out, so that they are metres; None where
        they are as they are in the files. Records never change.
    poses : ScanPoses or None
        Of the files, which are scans; their points come in the map's frame. None where the files
        are no scans with poses.

    Raises
    ------
    MapFormatError
        When a file is not a map that can be read; `NoMapError` when there are none.
    """

    def __init__(
        self,
        paths: Sequence[Path],
        threads: int = 1,
        poses: Path | None = None,
        frame: Frame = "auto",
    ) -> None:
        if not paths:
            raise NoMapError("no argument", "none")
        self.readers: tuple[MapReader, ...] = tuple(open_map(path, threads) for path in paths)
        counts = [reader.description.point_count for reader in self.readers]
        *first_rows, self.point_count = accumulate(counts, initial=0)
        self.first_rows: tuple[int, ...] = tuple(first_rows)
        self.metres: NDArray[np.float64] | None = None
        self.poses: ScanPoses | None = find_poses(self.readers, poses, frame)

    @cached_property
    def scan_rows(self) -> NDArray[np.int64]:
        """The row number of the first point of each scan with a pose of its own."""
        if self.poses is None or self.poses.counts is None:
            return np.array(self.first_rows, np.int64)
        return np.cumsum([0, *self.poses.counts[:-1]])

    @property
    def is_moved(self) -> bool:
        """Whether coordinates are elsewhere than in the files: scans, in the map's frame."""
        return self.poses is not None and not self.poses.are_applied

    def with_poses(self, digest: str) -> str:
        """Return a hash of the files' bytes and of what moves their points."""
        return digest if self.poses is None else self.poses.hashed(digest)

    @property
    def paths(self) -> tuple[Path, ...]:
        """The files."""
        return tuple(reader.description.path for reader in self.readers)

    @property
    def name(self) -> str:
        """What to call the map in messages: its file, or the first of them."""
        others = len(self.readers) - 1
        return f"{self.paths[0]} and {others} more" if others else str(self.paths[0])

    @property
    def has_classification(self) -> bool:
        """Whether every file carries ASPRS classes."""
        return all(reader.description.has_classification for reader in self.readers)

    @property
    def writes_parts(self) -> bool:
        """Whether all files can be written in parts: their bytes are their records, or nearly."""
        return all(reader.writes_parts for reader in self.readers)

    def batches(
        self, max_points: int = DEFAULT_BATCH, rows: range | None = None
    ) -> Iterator[tuple[int, PointBatch]]:
        """Yield points of the map, in order, as `MapReader.batches` does.

        Yields
        ------
        file : int
            Index into `readers` of the file that the batch comes from; no batch spans two.
        batch : PointBatch
            Its `first_row` counts from the first point of the whole map, as `rows` do.
        """
        rows = checked_rows(self.name, rows, self.point_count)
        for file in self.files_of(rows):
            reader, of_file = self.readers[file], self.rows_of(file)
            first_row = of_file.start
            start, stop = max(rows.start, first_row), min(rows.stop, of_file.stop)
            if start < stop:
                for batch in reader.batches(max_points, range(start - first_row, stop - first_row)):
                    # A copy: the reader goes on from the row numbers of its own.
                    of_map = replace(batch, first_row=batch.first_row + first_row)
                    yield file, self.in_map(file, of_map)

    def in_map(self, file: int, batch: PointBatch) -> PointBatch:
        """Return points as a file's reader gave them with coordinates as `batches` has them."""
        xyz = batch.xyz if self.metres is None else batch.xyz * self.metres
        if self.poses is not None:
            xyz = self.poses.to_map(file, xyz)
        return batch if xyz is batch.xyz else replace(batch, xyz=xyz)

    def files_of(self, rows: range) -> range:
        """Return the files, by index, that rows of the whole map come from; some may be empty."""
        if not rows:
            return range(0)
        first = bisect_right(self.first_rows, rows.start) - 1
        return range(first, bisect_left(self.first_rows, rows.stop))

    def rows_of(self, file: int) -> range:
        """Return the rows of the whole map that come from a file."""
        first_row = self.first_rows[file]
        return range(first_row, first_row + self.readers[file].description.point_count)

    def row_ranges(self, max_points: int) -> list[range]:
        """Cut all rows into consecutive ranges that several workers can read side by side.

        They have at most `max_points` where that is possible: a file that can only be read from its
        beginning is in one range as a whole.
        """
        ranges: list[range] = []
        for file, reader in enumerate(self.readers):
            rows = self.rows_of(file)
            step = max_points if reader.seekable else max(len(rows), 1)
            for start in rows[::step]:
                part = range(start, min(start + step, rows.stop))
                if ranges and len(ranges[-1]) + len(part) <= max_points:
                    ranges[-1] = range(ranges[-1].start, part.stop)
                else:
                    ranges.append(part)
        return ranges


def _files_of(argument: Path | str, as_one: bool) -> list[Path]:
    """Return the maps that one argument names, in order."""
    if str(argument) == "":
        raise NoMapError("an empty name", "no file or folder")
    path = Path(argument)
    if path.is_dir():
        candidates = (scan_folder(path) if as_one else None) or list(_in_folder(path))
        place = "a folder"
        if as_one:
            _refuse_several_maps(path, candidates)
    elif path.exists() or not glob.has_magic(str(argument)):
        if not path.exists():
            raise NoMapError(str(argument), "no such file or folder")
        return [path]
    else:
        # Path.glob takes no absolute patterns.
        matches = glob.glob(str(argument), recursive=True)  # noqa: PTH207
        candidates = [Path(match) for match in matches]
        place = "a pattern"
    files = [each for each in candidates if each.is_file() and not each.name.startswith(".")]
    maps = [each for each in files if each.suffix.lower() in MAP_SUFFIXES]
    doubtless = [each for each in maps if each.suffix.lower() not in OTHERS_TOO]
    if doubtless or (place == "a folder" and not as_one):
        maps = doubtless
    if not maps:
        others = f"{len(files)} other files" if files else "no files"
        others = "1 other file" if len(files) == 1 else others
        raise NoMapError(str(argument), f"{place} with {others} and no {', '.join(MAP_SUFFIXES)}")
    return sorted(maps, key=_natural_order)


def is_partition(folder: Path) -> bool:
    """Tell whether a folder is called as a partition of a table is, `key=value`."""
    return "=" in folder.name.lstrip("=")


def _in_folder(folder: Path) -> Iterator[Path]:
    """Yield what lies in a folder and in its partitions."""
    for each in folder.iterdir():
        if is_partition(each) and each.is_dir() and not each.is_symlink():
            yield from _in_folder(each)
        else:
            yield each


def _refuse_several_maps(folder: Path, files: Sequence[Path]) -> None:
    """Refuse a folder that holds several maps of one place: results of a run, or of LIO-SAM."""
    names = {path.stem.lower(): path.name for path in files if path.suffix.lower() in MAP_SUFFIXES}
    for together in _SEVERAL_MAPS:
        if together <= names.keys():
            found = ", ".join(names[name] for name in sorted(together))
            raise SeveralMapsError(
                str(folder), f"a folder of several maps of one place ({found}, ...): name one"
            )


def _natural_order(path: Path) -> tuple[list[list[tuple[str, int]]], str]:
    """Order by folder and name, digits by the number they make."""
    parts = (re.findall(r"(\D*)(\d*)", part) for part in path.parts)
    ordered = [[(text.lower(), int(digits or -1)) for text, digits in part] for part in parts]
    return ordered, str(path)
