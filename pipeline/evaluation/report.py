"""One evaluation from files to files: its report as JSON, and as a table for people."""

import json
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from operator import attrgetter
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, SkipValidation
from rich.table import Table

from pipeline.errors import ConfigurationError
from pipeline.evaluation.distances import ChamferDistance, DistanceStatistics, EarthMoversDistance
from pipeline.evaluation.evaluation import Figures, evaluate
from pipeline.evaluation.inputs import EvaluationInputs, EvaluationOptions, find_inputs
from pipeline.evaluation.scoring import Confusion, DynamicMapAccuracy, Preservation
from pipeline.plan.machine import peak_memory
from pipeline.progress import StageObserver, watching
from pipeline.replacing import RUN_FILE
from pipeline.showing import check_named_file, drawable, named_file
from tiling.collection import MapCollection

Row = tuple[str, str, str]
"""A figure's name, its value, and its unit or what it is of."""


# Names of figures, where they are in the report, and their units.
_DISTANCES: Sequence[Row] = (
    ("MAE", "distances.mean_absolute_error", "m"),
    ("variance", "distances.variance", "m²"),
    ("RMSE", "distances.root_mean_square_error", "m"),
    ("90th percentile", "distances.percentile_90", "m"),
    ("largest", "distances.largest", "m"),
    ("Chamfer, squared", "chamfer.squared", "m²"),
    ("  cleaned to truth", "chamfer.cleaned_to_truth.squared", "m²"),
    ("  truth to cleaned", "chamfer.truth_to_cleaned.squared", "m²"),
    ("Chamfer, unsquared", "chamfer.unsquared", "m"),
    ("  cleaned to truth", "chamfer.cleaned_to_truth.unsquared", "m"),
    ("  truth to cleaned", "chamfer.truth_to_cleaned.unsquared", "m"),
)
_CONFUSION: Sequence[Row] = (
    ("TP, moved and removed", "confusion.true_positives", "points"),
    ("FP, static but removed", "confusion.false_positives", "points"),
    ("FN, moved but kept", "confusion.false_negatives", "points"),
    ("TN, static and kept", "confusion.true_negatives", "points"),
    ("FP", "confusion.false_positive_percent", "% of the static points"),
    ("FN", "confusion.false_negative_percent", "% of the points that moved"),
    ("precision", "confusion.precision", "% of the removed points"),
    ("recall", "confusion.recall", "% of the points that moved"),
    ("F1", "confusion.f1", "%"),
)
_ACCURACY: Sequence[Row] = (
    ("SA", "accuracy.static_accuracy", "%"),
    ("DA", "accuracy.dynamic_accuracy", "%"),
    ("AA", "accuracy.associated_accuracy", "%"),
    ("HA", "accuracy.harmonic_accuracy", "%"),
    ("matched within", "accuracy.match_distance", "m"),
)
_PRESERVATION: Sequence[Row] = (
    ("preservation rate", "preservation.preservation_rate", "%"),
    ("rejection rate", "preservation.rejection_rate", "%"),
    ("F1", "preservation.f1", "%"),
    ("voxels", "preservation.voxel", "m"),
)


class MapFiles(BaseModel):
    """The files of a map, and how many points they have."""

    files: list[Annotated[str, SkipValidation]]
    points: int

    @classmethod
    def of(cls, collection: MapCollection) -> "MapFiles":
        """Name them in full."""
        files = [str(path.resolve()) for path in collection.paths]
        return cls(files=files, points=collection.point_count)


class EvaluationReport(BaseModel, frozen=True):
    """Everything an evaluation has to say."""

    version: str
    finished: str
    """Of this product; date and time, UTC, ISO 8601."""
    cleaned: MapFiles
    truth: Annotated[str, SkipValidation]
    """As it was given."""
    original: MapFiles | None
    options: EvaluationOptions
    distances: DistanceStatistics
    chamfer: ChamferDistance
    earth_mover: EarthMoversDistance | None
    confusion: Confusion | None = None
    accuracy: DynamicMapAccuracy | None = None
    preservation: Preservation | None = None
    """The figures; None where they were not asked for, or need an original map."""
    seconds: dict[str, float]
    """Wall time of each stage."""
    peak_memory_bytes: int
    """Of this process."""
    warnings: list[Annotated[str, SkipValidation]]

    @classmethod
    def of(
        cls,
        inputs: EvaluationInputs,
        truth: str,
        options: EvaluationOptions,
        figures: Figures,
        observer: StageObserver,
    ) -> "EvaluationReport":
        """Gather the report of a finished evaluation."""
        return cls(
            version=version("dynahull-pipeline"),
            finished=datetime.now(UTC).isoformat(timespec="seconds"),
            cleaned=MapFiles.of(inputs.cleaned),
            truth=truth,
            original=MapFiles.of(inputs.original) if inputs.original else None,
            options=options,
            **figures.geometry._asdict(),
            **(figures.scores._asdict() if figures.scores else {}),
            seconds={stage: round(seconds, 3) for stage, seconds in observer.seconds.items()},
            peak_memory_bytes=peak_memory(),
            warnings=observer.warnings,
        )

    def to_json(self) -> str:
        """Return the report as JSON."""
        return json.dumps(self.model_dump(mode="json"), indent=2, allow_nan=False) + "\n"

    def to_table(self) -> Table:
        """Return the figures for the terminal, one section a family."""
        table = Table(show_header=False)
        table.add_column(no_wrap=True)
        table.add_column(justify="right", no_wrap=True)
        table.add_column(no_wrap=True)
        sections = (
            ("to the nearest point", _rows(self, _DISTANCES)),
            ("Earth Mover's Distance", _transport_rows(self.earth_mover)),
            ("points removed", _rows(self, _CONFUSION)),
            ("DynamicMap benchmark", _rows(self, _ACCURACY)),
            ("ERASOR", _rows(self, _PRESERVATION)),
        )
        for title, rows in sections:
            if rows:
                table.add_section()
                table.add_row(title, style="bold")
            for row in rows:
                table.add_row(*row)
        return table


def _rows(report: EvaluationReport, figures: Sequence[Row]) -> list[Row]:
    """Write the figures of a family; none where the report has none of it."""
    if attrgetter(figures[0][1].partition(".")[0])(report) is None:
        return []
    return [(name, _text(attrgetter(place)(report), unit), unit) for name, place, unit in figures]


def _transport_rows(moved: EarthMoversDistance | None) -> list[Row]:
    if moved is None:
        return []
    unit = "m" if moved.ground_cost == "euclidean" else "m²"
    return [
        ("EMD", _text(moved.distance, unit), unit),
        ("two samples of the truth", _text(moved.sampling_floor, unit), unit),
        ("points of the samples", f"{moved.cleaned_points:,}, {moved.truth_points:,}", ""),
        ("ground cost", moved.ground_cost, f"seed {moved.seed}"),
    ]


def _text(value: float | None, unit: str) -> str:
    """Write a figure as its unit asks: counts whole, percentages with two places."""
    if value is None:
        return "undefined"
    if unit == "points":
        return f"{value:,}"
    return f"{value:.2f}" if unit.startswith("%") else f"{value:.6g}"


def evaluate_files(
    cleaned: str,
    truth: str,
    original: str | None,
    options: EvaluationOptions,
    json_file: Path | None = None,
    picture: Path | None = None,
) -> EvaluationReport:
    """Evaluate a cleaned map, and write what was asked for: all figures, and a map from above.

    The maps are named as for `inputs.find_inputs`.

    Raises
    ------
    PipelineError, TilingError
        With nothing written but, perhaps, the picture.
    """
    named = [Path(cleaned), Path(cleaned) / RUN_FILE, Path(truth)]
    for path, kind in ((json_file, ".json"), (picture, ".png")):
        if path is not None:
            check_named_file(path, kind, named)
    inputs = find_inputs(cleaned, truth, original, options)
    if picture is not None and inputs.original is None:
        raise ConfigurationError("--picture: expected --original, found none")
    with watching() as observer:
        picture = drawable(picture, observer.warn)
        if inputs.original is None and (Path(cleaned) / RUN_FILE).is_file():
            observer.warn(
                f"{cleaned}: the map that was cleaned is no longer there; only distances are "
                "measured (--original says where it is)"
            )
        figures = evaluate(inputs, options, observer, picture)
    report = EvaluationReport.of(inputs, truth, options, figures, observer)
    if json_file is not None:
        with named_file(json_file) as temporary:
            temporary.write_text(report.to_json(), encoding="utf-8")
    return report
