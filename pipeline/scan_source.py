"""Where the scan numbers of a map come from, and what they are."""

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from pipeline.pose_numbers import nearest_poses
from tiling.collection import MapCollection
from tiling.foreign_text import printable
from tiling.formats.points import PointBatch

TENTH = 0.1
"""Of a second, in seconds."""

UNKNOWN = np.iinfo(np.int64).min


class ScanSource(BaseModel):
    """Where the scan numbers of a map come from.

    Attributes
    ----------
    kind : str
        `field`; `rows`, the order of the rows; or `files`, each of which is a scan or has scans.
    scans : int
        Different numbers; an estimate where the order of the rows is all there is.
    name : str
        Of the field, or of what keeps the scans apart.
    tenth : float
        Units of the field that make a tenth of a second; 0 for scan numbers.
    firsts : tuple of int
        For each file, what number 0 stands for: tenths of a second, or a scan number.
    rows : int
        Rows that are taken for a scan.
    of_poses : tuple of int
        What number each pose of the map has, ascending: scans are numbered by their poses then.
    """

    model_config = ConfigDict(frozen=True)

    kind: Literal["field", "rows", "files"]
    scans: int
    name: str = ""
    tenth: float = 0.0
    firsts: tuple[int, ...] = ()
    rows: int = 0
    of_poses: tuple[int, ...] = ()

    def __str__(self) -> str:
        if self.kind == "field":
            posed = " with poses" if self.of_poses else ""
            return f"{printable(self.name)}, {self.scans:,} scans{posed}"
        if self.kind == "files":
            return f"{self.name}, {self.scans:,} scans with poses"
        return f"order of the rows, about {self.scans:,} scans"

    def numbers(self, collection: MapCollection, file: int, batch: PointBatch) -> NDArray[np.int32]:
        """Return the scan number of each point of a batch of the map, -1 where it is not known.

        Parameters
        ----------
        collection : MapCollection
            The map.
        file : int
            That the batch comes from.
        batch : PointBatch
            As `MapCollection.batches` gives it.
        """
        row = batch.first_row + np.arange(len(batch.xyz))
        if self.kind == "files":
            firsts = collection.scan_rows
            return (np.searchsorted(firsts, row, side="right") - 1).astype(np.int32)
        if self.kind == "rows":
            row -= collection.first_rows[file]
            return (self.firsts[file] + row // self.rows).astype(np.int32)
        found = whole_numbers(collection.readers[file].values(batch.records, self.name), self.tenth)
        known = found != UNKNOWN
        number = np.where(known, found - self.firsts[file], -1)
        if self.of_poses:
            number = nearest_poses(number, self.of_poses, exact=not self.tenth)
        return number.astype(np.int32)

    def sensor(self, collection: MapCollection) -> NDArray[np.float64] | None:
        """Return where the sensor was in each scan, (S, 3), metres; None where nobody tells."""
        poses = collection.poses
        if poses is None or not (self.kind == "files" or self.of_poses):
            return None
        places = np.ascontiguousarray(poses.poses[:, :, 3])
        if not poses.are_applied or collection.metres is None:
            return places
        return np.asarray(places * collection.metres)


def whole_numbers(values: NDArray[Any], tenth: float) -> NDArray[np.int64]:
    """Return scan numbers, or tenths of a second, and `UNKNOWN` where there is none."""
    if values.dtype.kind == "M":
        values = values.astype("datetime64[ns]").astype(np.int64)
    if values.dtype.kind in "iu":
        known = values >= 0 if not tenth else values > 0
        if values.dtype == np.uint64:
            known &= values <= np.uint64(np.iinfo(np.int64).max)
        whole = values.astype(np.int64)
        if tenth:
            whole = whole // int(tenth)
    else:
        known = np.isfinite(values) & (np.abs(values) < 2.0**62)
        known &= values != 0 if tenth else values >= 0
        seconds = np.where(known, values, 0).astype(np.float64)
        whole = np.floor(seconds * 10 if tenth == TENTH else seconds / (tenth or 1))
        whole = whole.astype(np.int64)
    return np.where(known, whole, UNKNOWN)
