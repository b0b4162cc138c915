"""A simulated map on disk: the map, the truth, the poses and the parameters."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import yaml

from pipeline.errors import OutputError
from pipeline.simulation.scene import Surface
from pipeline.simulation.simulate import SimulatedMap

_PCD_FIELDS: dict[str, np.dtype[Any]] = {
    "x": np.dtype("<f4"),
    "y": np.dtype("<f4"),
    "z": np.dtype("<f4"),
    "intensity": np.dtype("<f4"),
    "time": np.dtype("<f8"),
    "scan": np.dtype("<u4"),
}


@dataclass(frozen=True, slots=True)
class SimulationFiles:
    """The files of a simulated map.

    Attributes
    ----------
    map : Path
        The map with its ghosts: binary PCD of x, y, z, intensity, time and scan.
    truth : Path
        Parquet, one row a point in the map's order: `moving` (bool), `surface` (dictionary).
    poses : Path
        Estimated poses, one scan a line: the 3x4 matrix from sensor to map, row by row (KITTI).
    parameters : Path
        YAML of the parameters, which make the same map again.
    """

    map: Path
    truth: Path
    poses: Path
    parameters: Path

    @classmethod
    def in_folder(cls, folder: Path) -> "SimulationFiles":
        """Return the files' places in a folder."""
        return cls(
            map=folder / "map.pcd",
            truth=folder / "truth.parquet",
            poses=folder / "poses.txt",
            parameters=folder / "simulation.yaml",
        )


def write_simulated_map(simulated: SimulatedMap, folder: Path) -> SimulationFiles:
    """Write a simulated map into a folder, which is made if need be.

    Parameters
    ----------
    simulated : SimulatedMap
    folder : Path
        Files in it of the same names are replaced.

    Returns
    -------
    SimulationFiles
        The map is renamed into place last: where it is, the rest is complete.

    Raises
    ------
    OutputError
        When the folder cannot be made or written.
    """
    folder = Path(folder)
    files = SimulationFiles.in_folder(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _write_all(simulated, files)
    except OSError as error:
        raise OutputError(
            f"{folder}: expected a folder to write in, found {error.strerror or error}"
        ) from error
    return files


def _write_all(simulated: SimulatedMap, files: SimulationFiles) -> None:
    """Write the four files, the map last."""
    files.map.unlink(missing_ok=True)
    settings = simulated.parameters.model_dump()
    files.parameters.write_text(yaml.safe_dump(settings, sort_keys=False), encoding="utf-8")
    np.savetxt(files.poses, simulated.estimated_poses.reshape(-1, 12), fmt="%.9f")
    pq.write_table(_truth_table(simulated), files.truth)
    partial = files.map.with_suffix(".pcd.partial")
    _write_pcd(simulated, partial)
    partial.replace(files.map)


def _truth_table(simulated: SimulatedMap) -> pa.Table:
    """Return what is true of each point, one row a point."""
    titles = pa.array([surface.title for surface in Surface])
    return pa.table(
        {
            "moving": pa.array(simulated.moving.astype(bool)),
            "surface": pa.DictionaryArray.from_arrays(pa.array(simulated.surface), titles),
        }
    )


def _write_pcd(simulated: SimulatedMap, path: Path) -> None:
    """Write the points as binary PCD 0.7 (the Point Cloud Library's format)."""
    records = np.empty(len(simulated.xyz), dtype=list(_PCD_FIELDS.items()))
    records["x"], records["y"], records["z"] = simulated.xyz.T
    for name in ("intensity", "time", "scan"):
        records[name] = getattr(simulated, name)
    header = (
        "# .PCD v0.7 - Point Cloud Data file format",
        "VERSION 0.7",
        "FIELDS " + " ".join(_PCD_FIELDS),
        "SIZE " + " ".join(str(column.itemsize) for column in _PCD_FIELDS.values()),
        "TYPE " + " ".join(column.kind.upper() for column in _PCD_FIELDS.values()),
        "COUNT " + " ".join("1" for _ in _PCD_FIELDS),
        f"WIDTH {len(records)}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {len(records)}",
        "DATA binary",
    )
    with path.open("wb") as file:
        file.write(("\n".join(header) + "\n").encode("ascii"))
        file.write(records.tobytes())
