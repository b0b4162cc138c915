"""What is to be compared, and how: options, maps, labels, and what a run left in its folder."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import BaseModel, Field, ValidationError

from dynahull import Label
from dynahull.parameters import validation_message
from pipeline.configuration.run import InputParameters
from pipeline.errors import ConfigurationError, EvaluationError
from pipeline.evaluation.truth import (
    RowValues,
    is_label_table,
    parse_values,
    read_label_table,
    read_labels_of_map,
)
from pipeline.metres import open_collection
from pipeline.outputs.reading import label_batches, row_columns
from pipeline.replacing import LABELS_FILE, RUN_FILE, no_result
from tiling.collection import MapCollection, find_map_files
from tiling.formats.parquet_tables import row_count

GroundCost = Literal["euclidean", "sqeuclidean"]


class EvaluationOptions(BaseModel, extra="forbid", frozen=True):
    """The options of `evaluate`; all of them are in its report."""

    labels: str | None = None
    """Field of the truth that holds a label of every point; None: the truth is the static map."""
    dynamic: str = "1"
    unlabelled: str = ""
    """Label values, as `labels.parse_values` reads them."""
    truth_tolerance: float = Field(1e-4, ge=0, allow_inf_nan=False)
    cleaned_tolerance: float = Field(1e-4, ge=0, allow_inf_nan=False)
    """Metres within which a point of the original is at a point of the truth, and of the cleaned
    map. The default is finer than the millimetre grid of most LAS files, and coarser than the
    rounding of float32 within a kilometre of the origin."""
    match_distance: float = Field(0.05, gt=0, allow_inf_nan=False)
    """Metres, of SA and DA."""
    voxel: float = Field(0.2, ge=1e-6, allow_inf_nan=False)
    """Metres, of PR and RR; at least a micrometre."""
    emd_points: int = Field(2000, ge=0)
    """Size of the samples for the Earth Mover's Distance; 0: none is computed."""
    ground_cost: GroundCost = "euclidean"
    seed: int = Field(0, ge=0)
    """Of the samples."""

    @classmethod
    def checked(cls, **values: Any) -> Self:
        """Make options of what the command line was given, or raise a `ConfigurationError`."""
        try:
            return cls(**values)
        except ValidationError as error:
            option, _, problem = validation_message(error, cls).partition(":")
            raise ConfigurationError(f"--{option.replace('_', '-')}:{problem}") from None

    def refuse_unused(self, *, labelled: bool, original: bool) -> None:
        """Refuse options that were given and have no effect.

        Parameters
        ----------
        labelled : bool
            Whether the truth is labels; otherwise it is a map of what is static.
        original : bool
            Whether there is an original map.
        """
        unused: dict[str, str] = {}
        if labelled:
            unused["truth_tolerance"] = "the truth is labels, not a map of what is static"
        else:
            without_labels = "the truth is a map without labels (--labels names their field)"
            unused |= dict.fromkeys(("dynamic", "unlabelled"), without_labels)
        if not original:
            names = ("truth_tolerance", "cleaned_tolerance", "match_distance", "voxel")
            unused |= dict.fromkeys(names, "there is no original map (--original)")
        if not self.emd_points:
            without_transport = "no samples are drawn (--emd-points 0)"
            unused |= dict.fromkeys(("ground_cost", "seed"), without_transport)
        for name, reason in unused.items():
            if name in self.model_fields_set:
                option = name.replace("_", "-")
                raise ConfigurationError(f"--{option}: it has no effect here: {reason}")


@dataclass(frozen=True, slots=True)
class EvaluationInputs:
    """What is to be compared."""

    cleaned: MapCollection
    truth: MapCollection | None
    """A map of what is static; None where `labels` say it."""
    original: MapCollection | None
    """The map before it was cleaned."""
    labels: RowValues | None
    """`Truth` of each row of the original, where the user has it."""
    removed: RowValues | None
    """Which rows of the original the run removed, bool, where its folder says so."""
    kept: RowValues | None = None
    """Which points of `cleaned` are left, where the run labelled them all (output.mode label)."""


@dataclass(frozen=True, slots=True)
class _RunFolder:
    """The files of a finished run: what it cleaned, the map it was given, and its labels.

    What it cleaned is the static map; with output.mode label, the whole map and its labels.
    """

    cleaned: tuple[Path, ...]
    labelled: bool
    originals: tuple[Path, ...]
    labels: Path


def find_inputs(
    cleaned: str, truth: str, original: str | None, options: EvaluationOptions
) -> EvaluationInputs:
    """Find and check the files of an evaluation; neither points nor labels are read.

    Parameters
    ----------
    cleaned : str
        A map (file, folder or pattern), or the output folder of a run.
    truth : str
        A map of what is static; or, with `options.labels`, a map that holds labels and is the
        original; or a Parquet table of labels, one row for each of the original.
    original : str or None
        By default the one that the run was given, or the labelled map.

    Raises
    ------
    ConfigurationError, EvaluationError, TilingError
    """
    run = _read_run(Path(cleaned))
    cleaned_map = _opened(run.cleaned if run else find_map_files([cleaned]))
    kept = _kept_rows(run) if run and run.labelled else None
    dynamic = parse_values("--dynamic", options.dynamic)
    unlabelled = parse_values("--unlabelled", options.unlabelled)
    labels: RowValues | None = None
    truth_map: MapCollection | None = None
    if is_label_table(Path(truth)):
        original_map = _original(original, run)
        if original_map is None:
            raise EvaluationError(f"{truth}: labels are of an original map; give it by --original")
        labels = read_label_table(Path(truth), options.labels, dynamic, unlabelled)
        if (rows := row_count(Path(truth))) != original_map.point_count:
            raise EvaluationError(
                f"{truth}: expected labels of the {original_map.point_count:,} points of "
                f"{original_map.name}, found {rows:,}"
            )
    elif options.labels is not None:
        original_map = _opened(find_map_files([truth]))
        if original is not None and not _same_files(find_map_files([original]), original_map.paths):
            raise ConfigurationError(
                "--original: with --labels it is the labelled map, --truth; leave it out"
            )
        labels = read_labels_of_map(original_map, options.labels, dynamic, unlabelled)
    else:
        truth_map = _opened(find_map_files([truth]))
        original_map = _original(original, run)
    options.refuse_unused(labelled=labels is not None, original=original_map is not None)
    removed = _removed_rows(run, kept, cleaned_map, original_map) if run and original_map else None
    return EvaluationInputs(cleaned_map, truth_map, original_map, labels, removed, kept)


def _read_run(folder: Path) -> _RunFolder | None:
    """Read what a run left in its folder; None where the path is no such folder."""
    if not (folder / RUN_FILE).is_file():
        return None
    try:
        files = json.loads((folder / RUN_FILE).read_text(encoding="utf-8"))["files"]
        if any(file.get("pose") for file in files):
            raise EvaluationError(
                f"{folder}: expected a map in one frame, found scans; run with output.merge=true"
            )
        return _RunFolder(
            cleaned=tuple(
                dict.fromkeys(folder / (file.get("labelled") or file["static"]) for file in files)
            ),
            labelled=any(file.get("labelled") for file in files),
            originals=tuple(Path(file["path"]) for file in files),
            labels=folder / LABELS_FILE,
        )
    except (ValueError, KeyError, TypeError, AttributeError):
        raise EvaluationError(no_result(folder)) from None


def _original(original: str | None, run: _RunFolder | None) -> MapCollection | None:
    """Return the map given, or else the one that the run was given, if it is still there."""
    if original is not None:
        return _opened(find_map_files([original]))
    if run is not None and all(path.is_file() for path in run.originals):
        return _opened(run.originals)
    return None


def _kept_rows(run: _RunFolder) -> RowValues:
    """Return which points of the labelled maps of a run are not called dynamic."""
    for path in run.cleaned:
        next(label_batches(path), None)  # so that labels that are missing are named now
    return RowValues(
        lambda: (labels != Label.DYNAMIC for path in run.cleaned for labels in label_batches(path))
    )


def _removed_rows(
    run: _RunFolder, kept: RowValues | None, cleaned: MapCollection, original: MapCollection
) -> RowValues | None:
    """Return which rows the run removed; None if it kept no labels or cleaned another map."""
    if not _same_files(run.originals, original.paths):
        return None
    if kept is not None and cleaned.point_count == original.point_count:
        return RowValues(lambda: (~each for each in kept))
    if not run.labels.is_file():
        return None
    if (rows := row_count(run.labels)) != original.point_count:
        raise EvaluationError(
            f"{run.labels}: expected a label of the {original.point_count:,} points of "
            f"{original.name}, found {rows:,}: the map was changed since it was cleaned"
        )
    return RowValues(
        lambda: (each["label"] == Label.DYNAMIC for each in row_columns(run.labels, ["label"]))
    )


def _same_files(first: tuple[Path, ...], second: tuple[Path, ...]) -> bool:
    return [path.resolve() for path in first] == [path.resolve() for path in second]


def _opened(paths: Sequence[Path]) -> MapCollection:
    return open_collection(paths, InputParameters())
