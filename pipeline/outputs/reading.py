"""The points of a finished run with all that its outputs say of them."""

import json
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
from pipeline.replacing import LABELS_FILE, RUN_FILE, no_result
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
    try:
        report = json.loads((folder / RUN_FILE).read_text(encoding="utf-8"))
        files = [dict(file) for file in report["files"]]
        if report["configuration"]["output"].get("merge"):
            files = files[:1]
    except (OSError, ValueError, KeyError, TypeError):
        raise OutputError(no_result(folder)) from None
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
        xyz = _read_xyz(folder, file, "labelled")
        dynamic = np.empty((0, 3))
    else:
        xyz = np.empty((len(labels), 3))
        kept = labels != Label.DYNAMIC
        static, dynamic = (_read_xyz(folder, file, kind) for kind in ("static", "dynamic"))
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
        static, dynamic = (_read_xyz(folder, file, kind) for kind in ("static", "dynamic"))
        labels = np.repeat(
            np.array([Label.STATIC, Label.DYNAMIC], np.uint8), [len(static), len(dynamic)]
        )
        return np.concatenate([static, dynamic]), labels, None
    path = folder / file["labelled"]
    labels = np.concatenate([np.empty(0, np.uint8), *label_batches(path)])
    density = np.concatenate([np.empty(0), *added_values(path, DENSITY)])
    return _read_xyz(folder, file, "labelled"), labels, density


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


def _read_xyz(folder: Path, file: dict[str, Any], kind: str) -> Points:
    """Read the points of one output of an input file, in the map's frame."""
    batches = open_map(folder / file[kind]).batches()
    xyz = np.concatenate([np.empty((0, 3)), *(batch.xyz for batch in batches)])
    if file.get("pose") is None:
        return xyz
    pose = np.array(file["pose"]).reshape(3, 4)
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
