"""What is written of each file of the map: what stays and what goes, or all of it with labels."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynahull.labels import Label
from pipeline.configuration.run import Configuration, OutputParameters
from pipeline.errors import ConfigurationError
from tiling.errors import MapFormatError
from tiling.formats import Field, MapReader, PointBatch

LABEL, DENSITY, SCORE, ORIGINAL_CLASS = "label", "density", "score", "original_class"
"""Fields of a labelled map."""

_PREFIX = "dynahull_"
"""Before the name of a field where the map has one by that name."""

_AT_A_TIME = 1 << 22

Labels = NDArray[np.uint8]


Scores = Mapping[str, NDArray[Any]]
"""What a labelled map says of each point beside its label, (n,) each, in this order: density, NaN
where not scored; and where evidence was weighed score, the probability of having moved."""


def scores_of(columns: Mapping[str, NDArray[Any]], configuration: Configuration) -> Scores:
    """Return those of some columns that a labelled map has."""
    names = (DENSITY, SCORE) if configuration.removal.weighs_evidence else (DENSITY,)
    return {name: columns[name] for name in names}


class SplitMode:
    """What stays and what goes of a file's points, by their labels, in an output each."""

    def __init__(self, reader: MapReader, labels: Labels) -> None:
        self.reader = reader
        self.formats: tuple[MapReader, ...] = (reader, reader)
        self._labels = labels

    def counts(self, rows: range) -> tuple[int, int]:
        """Count what stays and what goes, a bounded part of the labels at a time."""
        starts = range(rows.start, rows.stop, _AT_A_TIME)
        parts = (self._labels[start : min(start + _AT_A_TIME, rows.stop)] for start in starts)
        kept = sum(int(np.count_nonzero(part != Label.DYNAMIC)) for part in parts)
        return kept, len(rows) - kept

    def records(self, batch: PointBatch) -> tuple[Any, Any]:
        """Select what stays and what goes."""
        kept = self._labels[batch.first_row : batch.first_row + len(batch.xyz)] != Label.DYNAMIC
        return batch.select(kept), batch.select(~kept)


class LabelMode:
    """All points in one output, with labels and scores, and with classes where the format has them.

    `classes` gives the class of points of each label, None for their own.
    """

    def __init__(
        self,
        reader: MapReader,
        labels: Labels,
        scores: Scores,
        classes: dict[Label, int | None],
    ) -> None:
        self.reader = reader
        self._extended = reader.extended(added_fields(reader, SCORE in scores))
        self.formats: tuple[MapReader, ...] = (self._extended,)
        self._labels = labels
        self._scores = scores
        self._kept = np.array([classes[label] is None for label in Label])
        self._classes = np.array([classes[label] or 0 for label in Label], np.uint8)

    def counts(self, rows: range) -> tuple[int]:
        """Return the number of the rows: all points are written."""
        return (len(rows),)

    def records(self, batch: PointBatch) -> tuple[Any]:
        """Add labels and scores, and set the classes."""
        rows = slice(batch.first_row, batch.first_row + len(batch.xyz))
        labels = np.asarray(self._labels[rows])
        values = [labels, *(np.asarray(each[rows]) for each in self._scores.values())]
        if batch.classification is None:
            return (self._extended.extend(batch, values),)
        classes = np.where(self._kept[labels], batch.classification, self._classes[labels])
        records = self._extended.extend(batch, [*values, batch.classification])
        return (self._extended.with_classes(records, classes),)


OutputMode = SplitMode | LabelMode
"""How the points of one file of the map go into its outputs: `formats` has one for each."""


def own_names(name: str, suffix: str) -> tuple[str, str]:
    """Return what a field that is added is called, and what where the map has one like it.

    In PLY, CloudCompare shows properties at once whose names begin with `scalar_`.
    """
    return f"scalar_{name}" if suffix.lower() == ".ply" else name, _PREFIX + name


def added_fields(reader: MapReader, with_score: bool) -> tuple[Field, ...]:
    """Return the fields that a labelled map has behind those of the input; a score, if weighed.

    Raises
    ------
    ConfigurationError
        When the map has fields of these names already, with the prefix `dynahull_` and without.
    """
    taken = {field.name for field in reader.description.fields}
    wanted = [(LABEL, "uint8"), (DENSITY, "float64")]
    if with_score:
        wanted.append((SCORE, "float32"))
    if reader.description.has_classification:
        wanted.append((ORIGINAL_CLASS, "uint8"))
    fields = []
    for name, dtype in wanted:
        names = own_names(name, reader.description.suffix)
        free = next((each for each in names if each not in taken), None)
        if free is None:
            raise ConfigurationError(
                f"{reader.description.path}: output.mode label adds a field {' or '.join(names)}, "
                "and the map has both; choose output.mode split"
            )
        fields.append(Field(free, dtype))
    return tuple(fields)


def check_mode(readers: Sequence[MapReader], configuration: Configuration) -> None:
    """Refuse, before any work, outputs that a file's format has no place for.

    Raises
    ------
    ConfigurationError
        When a class is larger than the format's largest, or the names of fields are taken.
    MapFormatError
        When points of the file cannot have further fields.
    """
    output = configuration.output
    if output.merge:
        _check_merging(readers)
    if output.voxel is not None and output.voxel_fields == "mean":
        for said in (reader.description for reader in readers if not reader.sets_values):
            expected = "a binary format with fields, as output.voxel_fields is mean"
            raise MapFormatError(said.path, expected, said.format)
    if output.mode != "label":
        return
    for reader in readers:
        reader.extended(added_fields(reader, configuration.removal.weighs_evidence))
        description = reader.description
        for label, number in output.classes.of_labels().items():
            if not description.has_classification or number is None:
                continue
            if number > description.largest_class:
                raise ConfigurationError(
                    f"{description.path}: {description.format} has classes 0 to "
                    f"{description.largest_class}, found output.classes.{label.title} {number}"
                )


def _check_merging(readers: Sequence[MapReader]) -> None:
    """Refuse files whose points cannot be in one file."""
    first = readers[0].merged().description
    for reader in readers:
        said = reader.description
        if (said.format, said.fields) != (first.format, first.fields):
            expected = f"format and fields of {first.path}, as output.merge is set"
            raise MapFormatError(said.path, expected, f"{said.format}, other fields or both")


def mode_of(
    reader: MapReader, output: OutputParameters, labels: Labels, scores: Scores
) -> OutputMode:
    """Return how the points of a file go into its outputs; scores where `output.needs_scores`."""
    if output.mode == "split":
        return SplitMode(reader, labels)
    return LabelMode(reader, labels, scores, output.classes.of_labels())
