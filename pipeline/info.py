"""What a map is, before anything is done with it: `dynahull-pipeline info`."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from pipeline.units import in_words
from tiling.formats import MapReader
from tiling.formats.collection import MapCollection, find_map_files
from tiling.formats.units import Units


class FileInfo(BaseModel):
    """What one file says of itself."""

    path: str
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
            path=str(said.path),
            format=said.format,
            size_bytes=said.path.stat().st_size,
            points=said.point_count,
            fields=[
                f"{field.name}: {field.dtype}" + (f" x {field.count}" if field.count > 1 else "")
                for field in said.fields
            ],
            crs=said.crs,
            unit=None if said.units is None else str(said.units),
            system=in_words(said),
            notes=list(said.notes),
        )


class MapInfo(BaseModel):
    """What a map of one or more files holds.

    Attributes
    ----------
    files : list of FileInfo
    points : int
    units : tuple of str
        Of x, y and z, those of the first file that tells them.
    minimum, maximum : tuple of float or None
        Bounds of the finite points, in the map's units; None where there are none.
    non_finite : int
        Points with a coordinate that is NaN or infinite.
    duplicates : int
        Finite points at coordinates that an earlier point has already.
    """

    model_config = ConfigDict(frozen=True)

    files: list[FileInfo]
    points: int
    units: tuple[str, str, str] = ("m", "m", "m")
    minimum: tuple[float, float, float] | None
    maximum: tuple[float, float, float] | None
    non_finite: int
    duplicates: int

    def to_text(self) -> str:
        """Return the information as aligned lines."""
        lines = []
        for file in self.files:
            lines += [f"file        {file.path}", f"format      {file.format}"]
            lines += [f"points      {file.points:,}", f"size        {file.size_bytes:,} bytes"]
            lines += [f"fields      {', '.join(file.fields)}", f"CRS         {file.system}"]
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
        return "\n".join(lines)


def inspect_map(maps: Sequence[str | Path]) -> MapInfo:
    """Read a whole map and say what it is.

    Parameters
    ----------
    maps : sequence of str or Path
        Files, folders or globs that together are one map.

    Returns
    -------
    MapInfo

    Raises
    ------
    TilingError
        When a file cannot be found or read.
    """
    collection = MapCollection(find_map_files(maps))
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    finite_count, finite_points = 0, []
    for _, batch in collection.batches():
        finite = batch.xyz[np.isfinite(batch.xyz).all(axis=1)]
        finite_count += len(finite)
        finite_points.append(finite)
        if len(finite):
            low, high = np.minimum(low, finite.min(axis=0)), np.maximum(high, finite.max(axis=0))
    return MapInfo(
        files=[FileInfo.of(reader) for reader in collection.readers],
        points=collection.point_count,
        units=_symbols(collection),
        minimum=_triple(low) if finite_count else None,
        maximum=_triple(high) if finite_count else None,
        non_finite=collection.point_count - finite_count,
        duplicates=count_duplicates(finite_points),
    )


def count_duplicates(batches: Sequence[NDArray[np.float64]]) -> int:
    """Count the points whose coordinates an earlier point has already.

    Parameters
    ----------
    batches : sequence of (n, 3) float64 arrays

    Returns
    -------
    int
    """
    # Adding zero makes one of the two zeros, which are equal and differ in their bits.
    points = np.concatenate([*batches, np.empty((0, 3))]) + 0.0
    order = np.lexsort((points[:, 2], points[:, 1], points[:, 0]))
    points = points[order]
    return int(np.count_nonzero((points[1:] == points[:-1]).all(axis=1)))


def _symbols(collection: MapCollection) -> tuple[str, str, str]:
    said = [reader.description.units for reader in collection.readers]
    units = next((each for each in said if each is not None), Units(None))
    across = units.horizontal.symbol if units.horizontal else "m"
    return across, across, units.vertical.symbol if units.vertical else across


def _triple(values: NDArray[np.float64]) -> tuple[float, float, float]:
    return (float(values[0]), float(values[1]), float(values[2]))
