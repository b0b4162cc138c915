"""What a map is, before anything is done with it: `dynahull-pipeline info`."""

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryFile
from typing import Annotated, BinaryIO, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, SkipValidation

from pipeline.configuration.run import Configuration
from pipeline.metres import in_words
from pipeline.scan_numbers import find_scans
from tiling.collection import MapCollection, find_map_files
from tiling.foreign_text import LONGEST_LINE, escaped, printable
from tiling.formats import MapReader
from tiling.formats.points import only_finite
from tiling.formats.units import Units
from tiling.resolution import coarse_step_notes, typical_place

_NAMED_FIELDS = 100
"""Fields that are named to people; all of them are in the JSON."""

_LONGEST_NAME = 60
"""Characters of a field's name, which may be anything that the file says."""

_SAMPLED = 1000
"""Points of a batch that tell where the map lies."""

_IN_MEMORY = 1 << 21
"""Points that are sorted at a time; of more, those alike go to the same temporary file."""

_MOST_FILES = 512
_MULTIPLIERS = np.array([-7046029254386353131, -4417276706812531889, 1609587929392839161])


class FileInfo(BaseModel):
    """What one file says of itself."""

    path: Annotated[str, SkipValidation]
    format: str
    size_bytes: int
    points: int
    fields: list[str]
    crs: str | None
    unit: str | None
    system: str
    notes: list[str]

    @classmethod
    def of(cls, reader: MapReader) -> "FileInfo":
        """Take over a reader's description."""
        said = reader.description
        return cls(
            path=printable(said.path, LONGEST_LINE),
            format=said.format,
            size_bytes=said.path.stat().st_size,
            points=said.point_count,
            fields=[
                f"{printable(field.name, _LONGEST_NAME)}: {printable(field.dtype, _LONGEST_NAME)}"
                + (f" x {field.count}" if field.count > 1 else "")
                for field in said.fields
            ],
            crs=said.crs,
            unit=None if said.units is None else str(said.units),
            system=in_words(said),
            notes=list(said.notes),
        )


class MapInfo(BaseModel, frozen=True):
    """What a map of one or more files holds."""

    files: list[FileInfo]
    points: int
    units: tuple[str, str, str] = ("m", "m", "m")
    """Of x, y and z, those of the first file that tells them."""
    minimum: tuple[float, float, float] | None
    maximum: tuple[float, float, float] | None
    """Bounds of the finite points, in the map's units; None where there are none."""
    non_finite: int
    """Points with a coordinate that is NaN or infinite."""
    duplicates: int
    """Finite points at coordinates that an earlier point has already."""
    time: str = "none"
    """What tells when points were seen, in words."""
    notes: list[str] = []
    """What of the whole map is to be minded."""

    def to_text(self) -> str:
        """Return the information as aligned lines."""
        lines = []
        for file in self.files:
            lines += [f"file        {escaped(file.path)}", f"format      {file.format}"]
            lines += [f"points      {file.points:,}", f"size        {file.size_bytes:,} bytes"]
            more = len(file.fields) - _NAMED_FIELDS
            fields = ", ".join(file.fields[:_NAMED_FIELDS]) + (f" and {more} more" * (more > 0))
            lines += [f"fields      {fields}", f"CRS         {file.system}"]
            lines += [f"note        {note}" for note in file.notes] + [""]
        if len(self.files) > 1:
            lines.append(f"all points  {self.points:,} in {len(self.files)} files")
        if self.minimum and self.maximum:
            bounds = zip("xyz", self.minimum, self.maximum, self.units, strict=True)
            for axis, low, high, unit in bounds:
                size = f"{high - low:,.3f} {unit}"
                lines.append(f"{axis}           {low:,.3f} to {high:,.3f} ({size})")
        lines.append(f"non-finite  {self.non_finite:,}")
        lines.append(f"duplicates  {self.duplicates:,}")
        lines.append(f"time        {self.time}")
        lines += [f"note        {note}" for note in self.notes]
        return "\n".join(lines)


def inspect_map(maps: Sequence[str | Path], poses: str | None = None) -> MapInfo:
    """Read a whole map and say what it is.

    Parameters
    ----------
    maps : sequence of str or Path
        Files, folders or globs that together are one map.
    poses : str, optional
        File of the poses of its scans, in the place of what lies beside them.

    Raises
    ------
    TilingError
        When a file cannot be found or read.
    """
    collection = MapCollection(find_map_files(maps), poses=None if poses is None else Path(poses))
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    finite_count, sample = 0, [np.empty((0, 3))]
    with DuplicateCounter(collection.point_count) as duplicates:
        for _, batch in collection.batches():
            finite = only_finite(batch.xyz)
            finite_count += len(finite)
            duplicates.add(finite)
            sample.append(finite[:: max(len(finite) // _SAMPLED, 1)].copy())
            if len(finite):
                low = np.minimum(low, finite.min(axis=0))
                high = np.maximum(high, finite.max(axis=0))
        duplicate_count = duplicates.total()
    told = (reader.description.units for reader in collection.readers)
    units = next((each for each in told if each is not None), Units(None))
    across = (units.horizontal and units.horizontal.metres) or 1.0
    metres = np.array([across, across, (units.vertical and units.vertical.metres) or across])
    return MapInfo(
        files=[FileInfo.of(reader) for reader in collection.readers],
        points=collection.point_count,
        units=_symbols(units),
        minimum=_triple(low) if finite_count else None,
        maximum=_triple(high) if finite_count else None,
        non_finite=collection.point_count - finite_count,
        duplicates=duplicate_count,
        time=str(find_scans(collection, Configuration()) or "none"),
        notes=coarse_step_notes(collection, typical_place(np.concatenate(sample)) * metres, metres),
    )


def _symbols(units: Units) -> tuple[str, str, str]:
    across = units.horizontal.symbol if units.horizontal else "m"
    return across, across, units.vertical.symbol if units.vertical else across


def _triple(values: NDArray[np.float64]) -> tuple[float, float, float]:
    return (float(values[0]), float(values[1]), float(values[2]))


class DuplicateCounter:
    """Counts the points whose coordinates an earlier point has already.

    A context manager that removes its temporary files, which have no names and lie in `TMPDIR`.

    Parameters
    ----------
    point_count : int
        Points that there will be, at most.
    """

    def __init__(self, point_count: int) -> None:
        self._count = 0
        self._stack = ExitStack()
        self._files: list[BinaryIO] = []
        for _ in range(min(point_count // _IN_MEMORY + 1, _MOST_FILES)):
            file = cast(BinaryIO, TemporaryFile())  # noqa: SIM115 - closed by the stack
            self._files.append(self._stack.enter_context(file))

    def __enter__(self) -> "DuplicateCounter":
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def add(self, points: NDArray[np.float64]) -> None:
        """Take (n, 3) finite points into account."""
        # Adding zero makes one of the two zeros, which are equal and differ in their bits.
        points = self._distinct(points + 0.0)
        mixed = (points.view(np.int64) * _MULTIPLIERS).sum(axis=1)
        of_file = ((mixed ^ mixed >> 31) * _MULTIPLIERS[0] >> 33) % len(self._files)
        order = np.argsort(of_file, kind="stable")
        bounds = np.searchsorted(of_file[order], np.arange(len(self._files) + 1))
        points = points[order]
        for file, start, stop in zip(self._files, bounds, bounds[1:], strict=False):
            file.write(points[start:stop].tobytes())

    def total(self) -> int:
        """Return the number of duplicates; nothing can be added after that."""
        for file in self._files:
            file.seek(0)
            self._distinct(np.frombuffer(file.read(), dtype=np.float64).reshape(-1, 3))
        return self._count

    def _distinct(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return different points, and count the others."""
        order = np.lexsort((points[:, 2], points[:, 1], points[:, 0]))
        points = points[order]
        again = (points[1:] == points[:-1]).all(axis=1)
        self._count += int(np.count_nonzero(again))
        first = np.concatenate([np.ones(min(len(points), 1), bool), ~again])
        return np.asarray(points[first])
