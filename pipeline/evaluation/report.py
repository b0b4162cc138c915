"""One evaluation from files to files: its report as JSON, and as a table for people."""

import json
from collections.abc import Iterator
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, SkipValidation
from rich.table import Table

from pipeline.errors import ConfigurationError
from pipeline.evaluation.distances import ChamferDistance, DistanceStatistics
from pipeline.evaluation.earth_mover import EarthMoversDistance
from pipeline.evaluation.evaluate import Figures, evaluate
from pipeline.evaluation.inputs import EvaluationInputs, find_inputs
from pipeline.evaluation.options import EvaluationOptions
from pipeline.evaluation.scoring import Confusion, DynamicMapAccuracy, Preservation
from pipeline.plan.machine import peak_memory
from pipeline.progress import StageObserver, watching
from pipeline.replacing import RUN_FILE
from pipeline.showing import check_named_file, drawable, named_file
from tiling.collection import MapCollection

Row = tuple[str, str, str]
"""A figure's name, its value, and its unit or what it is of."""


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
    confusion: Confusion | None
    accuracy: DynamicMapAccuracy | None
    preservation: Preservation | None
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
        geometry, scores = figures.geometry, figures.scores
        return cls(
            version=version("dynahull-pipeline"),
            finished=datetime.now(UTC).isoformat(timespec="seconds"),
            cleaned=MapFiles.of(inputs.cleaned),
            truth=truth,
            original=MapFiles.of(inputs.original) if inputs.original else None,
            options=options,
            distances=geometry.distances,
            chamfer=geometry.chamfer,
            earth_mover=geometry.earth_mover,
            confusion=scores.confusion if scores else None,
            accuracy=scores.accuracy if scores else None,
            preservation=scores.preservation if scores else None,
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
        sections = [("to the nearest point", _distance_rows(self))]
        if self.earth_mover:
            sections.append(("Earth Mover's Distance", _transport_rows(self.earth_mover)))
        if self.confusion:
            sections.append(("points removed", _confusion_rows(self.confusion)))
        if self.accuracy:
            sections.append(("DynamicMap benchmark", _accuracy_rows(self.accuracy)))
        if self.preservation:
            sections.append(("ERASOR", _preservation_rows(self.preservation)))
        for title, rows in sections:
            table.add_section()
            table.add_row(title, style="bold")
            for row in rows:
                table.add_row(*row)
        return table


def _distance_rows(report: EvaluationReport) -> Iterator[Row]:
    distances, chamfer = report.distances, report.chamfer
    yield "MAE", _metres(distances.mean_absolute_error), "m"
    yield "variance", _metres(distances.variance), "m²"
    yield "RMSE", _metres(distances.root_mean_square_error), "m"
    yield "90th percentile", _metres(distances.percentile_90), "m"
    yield "largest", _metres(distances.largest), "m"
    yield "Chamfer, squared", _metres(chamfer.squared), "m²"
    yield "  cleaned to truth", _metres(chamfer.cleaned_to_truth.squared), "m²"
    yield "  truth to cleaned", _metres(chamfer.truth_to_cleaned.squared), "m²"
    yield "Chamfer, unsquared", _metres(chamfer.unsquared), "m"
    yield "  cleaned to truth", _metres(chamfer.cleaned_to_truth.unsquared), "m"
    yield "  truth to cleaned", _metres(chamfer.truth_to_cleaned.unsquared), "m"


def _transport_rows(moved: EarthMoversDistance) -> Iterator[Row]:
    unit = "m" if moved.ground_cost == "euclidean" else "m²"
    yield "EMD", _metres(moved.distance), unit
    yield "two samples of the truth", _metres(moved.sampling_floor), unit
    yield "points of the samples", f"{moved.cleaned_points:,}, {moved.truth_points:,}", ""
    yield "ground cost", moved.ground_cost, f"seed {moved.seed}"


def _confusion_rows(counts: Confusion) -> Iterator[Row]:
    yield "TP, moved and removed", f"{counts.true_positives:,}", "points"
    yield "FP, static but removed", f"{counts.false_positives:,}", "points"
    yield "FN, moved but kept", f"{counts.false_negatives:,}", "points"
    yield "TN, static and kept", f"{counts.true_negatives:,}", "points"
    yield "FP", _percent(counts.false_positive_percent), "% of the static points"
    yield "FN", _percent(counts.false_negative_percent), "% of the points that moved"
    yield "precision", _percent(counts.precision), "% of the removed points"
    yield "recall", _percent(counts.recall), "% of the points that moved"
    yield "F1", _percent(counts.f1), "%"


def _accuracy_rows(accuracy: DynamicMapAccuracy) -> Iterator[Row]:
    yield "SA", _percent(accuracy.static_accuracy), "%"
    yield "DA", _percent(accuracy.dynamic_accuracy), "%"
    yield "AA", _percent(accuracy.associated_accuracy), "%"
    yield "HA", _percent(accuracy.harmonic_accuracy), "%"
    yield "matched within", f"{accuracy.match_distance:g}", "m"


def _preservation_rows(rates: Preservation) -> Iterator[Row]:
    yield "preservation rate", _percent(rates.preservation_rate), "%"
    yield "rejection rate", _percent(rates.rejection_rate), "%"
    yield "F1", _percent(rates.f1), "%"
    yield "voxels", f"{rates.voxel:g}", "m"


def _metres(value: float) -> str:
    return f"{value:.6g}"


def _percent(value: float | None) -> str:
    return "undefined" if value is None else f"{value:.2f}"


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
