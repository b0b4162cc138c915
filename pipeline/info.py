"""What a map is, before anything is done with it: `dynahull-pipeline info`."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, SkipValidation

from pipeline.showing import printable
from tiling.formats import MapReader
from tiling.formats.collection import MapCollection, find_map_files


class FileInfo(BaseModel):
    """What one file says of itself."""

    path: Annotated[str, SkipValidation]
    format: str
    size_bytes: int
    points: int
    fields: list[str]
    crs: str | None
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
            notes=list(said.notes),
        )


class MapInfo(BaseModel):
    """What a map of one or more files holds.

    Attributes
    ----------
    files : list of FileInfo
    points : int
    minimum, maximum : tuple of float or None
        Bounds of the finite points, in metres; None where there are none.
    non_finite : int
        Points with a coordinate that is NaN or infinite.
    duplicates : int
        Finite points at coordinates that an earlier point has already.
    """

    model_config = ConfigDict(frozen=True)

    files: list[FileInfo]
    points: int
    minimum: tuple[float, float, float] | None
    maximum: tuple[float, float, float] | None
    non_finite: int
    duplicates: int

    def to_text(self) -> str:
        """Return the information as aligned lines."""
        lines = []
        for file in self.files:
            lines += [f"file        {printable(file.path)}", f"format      {file.format}"]
            lines += [f"points      {file.points:,}", f"size        {file.size_bytes:,} bytes"]
            lines += [f"fields      {', '.join(file.fields)}", f"CRS         {file.crs or 'none'}"]
            lines += [f"note        {note}" for note in file.notes] + [""]
        if len(self.files) > 1:
            lines.append(f"all points  {self.points:,} in {len(self.files)} files")
        if self.minimum and self.maximum:
            for axis, low, high in zip("xyz", self.minimum, self.maximum, strict=True):
                lines.append(f"{axis}           {low:,.3f} to {high:,.3f} ({high - low:,.3f} m)")
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


def _triple(values: NDArray[np.float64]) -> tuple[float, float, float]:
    return (float(values[0]), float(values[1]), float(values[2]))
