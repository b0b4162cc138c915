"""The points of a finished run with all that its outputs say of them."""

import json
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from numpy.typing import NDArray

from dynahull.labels import Label
from pipeline.errors import OutputError
from pipeline.output_modes import DENSITY, LABEL, own_names
from pipeline.outputs import LABELS_FILE, RUN_FILE
from tiling.errors import MapFormatError
from tiling.formats import open_map
from tiling.formats.field_values import field_values

Points = NDArray[np.float64]
Labels = NDArray[np.uint8]
Densities = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ResultPoints:
    """What became of every finite point of a map.

    Attributes
    ----------
    xyz : (n, 3) float64 array
    labels : (n,) uint8 array
        `Label` of each; only static and dynamic where the outputs tell no more.
    density : (n,) float64 array or None
        None where the outputs do not tell; NaN for points that are not scored.
    """

    xyz: Points
    labels: Labels
    density: Densities | None


def read_result(folder: Path) -> ResultPoints:
    """Read the points of a finished run.

    More than static and dynamic is known where the run wrote labels.parquet (`--labels`) or a
    labelled map.

    Parameters
    ----------
    folder : Path
        An output folder of `run`.

    Raises
    ------
    OutputError
        When the folder holds no complete result, or its files are not those of the run.
    """
    try:
        report = json.loads((folder / RUN_FILE).read_text(encoding="utf-8"))
        files = [dict(file) for file in report["files"]]
    except (OSError, ValueError, KeyError, TypeError):
        raise OutputError(f"{folder}: expected the output of a run, found no {RUN_FILE}") from None
    table = folder / LABELS_FILE
    if LABELS_FILE in report.get("outputs", ()):
        labels, density = _read_table(table)
        starts = [file["first_row"] for file in files] + [len(labels)]
        rows = [slice(*bounds) for bounds in pairwise(starts)]
        xyz = [
            _points_in_order(folder, file, labels[own])
            for file, own in zip(files, rows, strict=True)
        ]
        return _finite(np.concatenate([np.empty((0, 3)), *xyz]), labels, density)
    parts = [_points_of(folder, file) for file in files]
    densities = [density for _, _, density in parts if density is not None]
    return _finite(
        np.concatenate([np.empty((0, 3)), *(xyz for xyz, _, _ in parts)]),
        np.concatenate([np.empty(0, np.uint8), *(labels for _, labels, _ in parts)]),
        np.concatenate(densities) if densities else None,
    )


def _finite(xyz: Points, labels: Labels, density: Densities | None) -> ResultPoints:
    finite = np.isfinite(xyz).all(axis=1)
    return ResultPoints(xyz[finite], labels[finite], None if density is None else density[finite])


def _points_in_order(folder: Path, file: dict[str, Any], labels: Labels) -> Points:
    """Read the points of one input file, in its order, from what was written of it."""
    if file.get("labelled"):
        xyz = _read_xyz(folder / file["labelled"])
        dynamic = np.empty((0, 3))
    else:
        xyz = np.empty((len(labels), 3))
        kept = labels != Label.DYNAMIC
        static, dynamic = (_read_xyz(folder / file[kind]) for kind in ("static", "dynamic"))
        if (len(static), len(dynamic)) == (kept.sum(), len(kept) - kept.sum()):
            xyz[kept], xyz[~kept] = static, dynamic
            return xyz
    if len(xyz) != len(labels) or len(dynamic):
        raise OutputError(
            f"{folder / LABELS_FILE}: expected labels of the points beside it, found "
            f"{len(labels)} labels: files were changed since the run"
        )
    return xyz


def _points_of(folder: Path, file: dict[str, Any]) -> tuple[Points, Labels, Densities | None]:
    """Read what was written of one input file, where there is no table of labels."""
    if not file.get("labelled"):
        static, dynamic = (_read_xyz(folder / file[kind]) for kind in ("static", "dynamic"))
        labels = np.repeat(
            np.array([Label.STATIC, Label.DYNAMIC], np.uint8), [len(static), len(dynamic)]
        )
        return np.concatenate([static, dynamic]), labels, None
    path = folder / file["labelled"]
    return _read_xyz(path), read_labels(path), _read_added(path, DENSITY)


def read_labels(path: Path) -> Labels:
    """Read the labels of a map that a run labelled.

    Raises
    ------
    OutputError
        When it has none, or its format does not give them back.
    """
    return _read_added(path, LABEL).astype(np.uint8)


def _read_added(path: Path, name: str) -> NDArray[np.float64]:
    """Read a field that a run added, by the name that it got."""
    names = [field.name for field in open_map(path).description.fields]
    own = next((each for each in reversed(own_names(name)) if each in names), name)
    try:
        return np.concatenate([np.empty(0), *field_values(path, own)])
    except MapFormatError as error:
        raise OutputError(f"{error}; run again with --labels, which writes {LABELS_FILE}") from None


def _read_xyz(path: Path) -> Points:
    return np.concatenate([np.empty((0, 3)), *(batch.xyz for batch in open_map(path).batches())])


def _read_table(path: Path) -> tuple[Labels, Densities]:
    table = pq.read_table(path, columns=["label", "density"])
    numbers = {label.title: label.value for label in Label}
    labels = np.empty(table.num_rows, np.uint8)
    row = 0
    for chunk in table["label"].chunks:
        codes = np.array([numbers[title] for title in chunk.dictionary.to_pylist()], np.uint8)
        labels[row : row + len(chunk)] = codes[chunk.indices.to_numpy()]
        row += len(chunk)
    return labels, table["density"].to_numpy()
