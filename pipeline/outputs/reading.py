"""The points of a finished run with all that its outputs say of them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynahull.labels import Label
from pipeline.errors import OutputError
from pipeline.outputs.modes import DENSITY, LABEL, own_names
from pipeline.outputs.run_report import InputFile, RunReport
from pipeline.replacing import LABELS_FILE
from tiling.errors import MapFormatError
from tiling.formats import field_values, open_map
from tiling.formats.parquet_tables import open_parquet
from tiling.formats.points import DEFAULT_BATCH

Points = NDArray[np.float64]
Labels = NDArray[np.uint8]
Densities = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ResultPoints:
    """What became of every finite point of a map."""

    xyz: Points
    """(n, 3)"""
    labels: Labels
    """(n,): `Label` of each; only static and dynamic where the outputs tell no more."""
    density: Densities | None
    """(n,): None where the outputs do not tell; NaN for points that are not scored."""


def read_result(folder: Path) -> ResultPoints:
    """Read the points of a finished run, from its output folder.

    More than static and dynamic is known where the run wrote labels.parquet (`--labels`) or a
    labelled map.

    Raises
    ------
    OutputError
        When the folder holds no complete result, or its files are not those of the run.
    """
    report = RunReport.read(folder)
    files = report.files[:1] if report.configuration["output"].get("merge") else report.files
    if LABELS_FILE in report.outputs:
        labels, density = _read_table(folder / LABELS_FILE)
        starts = [file.first_row for file in files] + [len(labels)]
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


def _points_in_order(folder: Path, file: InputFile, labels: Labels) -> Points:
    """Read the points of one input file, in its order, from what was written of it."""
    parts = [_read_xyz(folder, file, name) for name in file.outputs]
    gone = labels == Label.DYNAMIC
    rows = [np.arange(len(labels))] if file.labelled else [*map(np.flatnonzero, (~gone, gone))]
    if [len(part) for part in parts] != [len(own) for own in rows]:
        raise OutputError(
            f"{folder / LABELS_FILE}: expected labels of the points beside it, found "
            f"{len(labels)} labels: files were changed since the run"
        )
    xyz = np.empty((len(labels), 3))
    xyz[np.concatenate(rows)] = np.concatenate(parts)
    return xyz


def _points_of(folder: Path, file: InputFile) -> tuple[Points, Labels, Densities | None]:
    """Read what was written of one input file, where there is no table of labels."""
    if file.labelled is None:
        static, dynamic = (_read_xyz(folder, file, name) for name in file.outputs)
        labels = np.repeat(
            np.array([Label.STATIC, Label.DYNAMIC], np.uint8), [len(static), len(dynamic)]
        )
        return np.concatenate([static, dynamic]), labels, None
    path = folder / file.labelled
    labels = np.concatenate([np.empty(0, np.uint8), *label_batches(path)])
    density = np.concatenate([np.empty(0), *added_values(path, DENSITY)])
    return _read_xyz(folder, file, file.labelled), labels, density


def label_batches(path: Path) -> Iterator[Labels]:
    """Yield the labels of a map that a run labelled, in order.

    Raises
    ------
    OutputError
        When it has none, or its format does not give them back.
    """
    for values in added_values(path, LABEL):
        yield values.astype(np.uint8)


def added_values(path: Path, name: str) -> Iterator[NDArray[Any]]:
    """Yield the values of a field that a run added to a map, by the name that it got.

    Raises
    ------
    OutputError
        When it has none, or its format does not give them back.
    """
    names = [field.name for field in open_map(path).description.fields]
    own = next((each for each in reversed(own_names(name, path.suffix)) if each in names), name)
    try:
        yield from field_values(path, own)
    except MapFormatError as error:
        raise OutputError(f"{error}; run again with --labels, which writes {LABELS_FILE}") from None


def _read_xyz(folder: Path, file: InputFile, name: str) -> Points:
    """Read the points of one output of an input file, in the map's frame."""
    batches = open_map(folder / name).batches()
    xyz = np.concatenate([np.empty((0, 3)), *(batch.xyz for batch in batches)])
    if file.pose is None:
        return xyz
    pose = np.array(file.pose).reshape(3, 4)
    return np.asarray(xyz @ pose[:, :3].T + pose[:, 3])


def _read_table(path: Path) -> tuple[Labels, Densities]:
    columns = [*row_columns(path, (LABEL, DENSITY))]
    labels = np.concatenate([np.empty(0, np.uint8), *(each[LABEL] for each in columns)])
    return labels, np.concatenate([np.empty(0), *(each[DENSITY] for each in columns)])


def row_columns(
    path: Path, names: Sequence[str], rows: int = DEFAULT_BATCH
) -> Iterator[dict[str, NDArray[Any]]]:
    """Yield columns of `labels.parquet`, so many rows at a time; labels as numbers.

    Raises
    ------
    OutputError
        When it has no such column.
    """
    numbers = {label.title: label.value for label in Label}
    with open_parquet(path) as file:
        missing = set(names) - set(file.schema_arrow.names)
        if missing:
            raise OutputError(f"{path}: has no column {min(missing)}; run again with --labels")
        for batch in file.iter_batches(rows, columns=list(names), use_threads=False):
            found = {name: batch.column(name) for name in names}
            label = found.pop(LABEL)
            codes = np.array([numbers[title] for title in label.dictionary.to_pylist()], np.uint8)
            values = {name: column.to_numpy() for name, column in found.items()}
            yield {LABEL: codes[label.indices.to_numpy()], **values}
