"""The command `evaluate`. Heavy imports live inside it, so that `--help` answers at once."""

from pathlib import Path
from typing import Annotated, Any

import typer


def _metres(default: str, meaning: str) -> Any:
    """Return an option of metres, whose default is known to `EvaluationOptions`."""
    return typer.Option(metavar="METRES", help=meaning, show_default=default)


Cleaned = Annotated[
    str,
    typer.Argument(
        metavar="CLEANED",
        help="A cleaned map (file, folder or pattern), or the output folder of `run`.",
        show_default=False,
    ),
]
TruthSource = Annotated[
    str,
    typer.Option(
        metavar="TRUTH",
        help="A map of what is static; or labels of every point of the original: a Parquet table "
        "such as `simulate` writes, or a map with a field of labels (--labels).",
        show_default=False,
    ),
]
Original = Annotated[
    str | None,
    typer.Option(
        metavar="MAP",
        help="The map before it was cleaned; of a result of `run`, it is known. Without it only "
        "distances are measured.",
    ),
]
LabelField = Annotated[
    str | None,
    typer.Option(
        metavar="FIELD",
        help="Field of TRUTH that holds labels: TRUTH is then the original map. Of a table, its "
        "column; `moving` by default.",
    ),
]
DynamicLabels = Annotated[
    str | None,
    typer.Option(metavar="VALUES", help="Labels of what moved: 2, or 252-259.", show_default="1"),
]
UnknownLabels = Annotated[
    str | None, typer.Option(metavar="VALUES", help="Labels of points not to be compared.")
]
TruthTolerance = Annotated[
    float | None, _metres("0.0001", "A point of the original this near to the truth is static.")
]
CleanedTolerance = Annotated[
    float | None,
    _metres("0.0001", "A point of the original this near to the cleaned map was kept."),
]
MatchDistance = Annotated[
    float | None, _metres("0.05", "The same, for SA and DA (DynamicMap benchmark).")
]
Voxel = Annotated[float | None, _metres("0.2", "Edge of the voxels of PR and RR (ERASOR).")]
TransportPoints = Annotated[
    int,
    typer.Option(
        metavar="N",
        help="Points of each sample for the Earth Mover's Distance (extra: evaluation); 0: none.",
    ),
]
GroundCostName = Annotated[
    str | None,
    typer.Option(
        metavar="COST",
        help="Of the Earth Mover's Distance: euclidean or sqeuclidean.",
        show_default="euclidean",
    ),
]
Seed = Annotated[int | None, typer.Option(help="Of the samples.", show_default="0")]
JsonFile = Annotated[
    Path | None, typer.Option("--json", metavar="FILE", help="Write all figures as JSON.")
]
PictureFile = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE.png",
        help="Draw the map from above: true positives green, false positives blue, false "
        "negatives red (extra: plot).",
    ),
]


def evaluate_command(
    cleaned: Cleaned,
    truth: TruthSource,
    original: Original = None,
    labels: LabelField = None,
    dynamic: DynamicLabels = None,
    unlabelled: UnknownLabels = None,
    truth_tolerance: TruthTolerance = None,
    cleaned_tolerance: CleanedTolerance = None,
    match_distance: MatchDistance = None,
    voxel: Voxel = None,
    emd_points: TransportPoints = 2000,
    ground_cost: GroundCostName = None,
    seed: Seed = None,
    json_file: JsonFile = None,
    picture: PictureFile = None,
) -> None:
    """Measure how clean a map is, against a map or labels of what is static."""
    from rich.console import Console  # noqa: PLC0415

    from pipeline.evaluation.inputs import EvaluationOptions  # noqa: PLC0415
    from pipeline.evaluation.report import evaluate_files  # noqa: PLC0415
    from pipeline.replacing import REPORT_FILE  # noqa: PLC0415
    from pipeline.showing import printable  # noqa: PLC0415

    given = {
        "labels": labels,
        "dynamic": dynamic,
        "unlabelled": unlabelled,
        "truth_tolerance": truth_tolerance,
        "cleaned_tolerance": cleaned_tolerance,
        "match_distance": match_distance,
        "voxel": voxel,
        "emd_points": emd_points,
        "ground_cost": ground_cost,
        "seed": seed,
    }
    # Only what was given: an option that would have no effect is refused, a default is not.
    options = EvaluationOptions.checked(
        **{name: value for name, value in given.items() if value is not None}
    )
    report = evaluate_files(cleaned, truth, original, options, json_file, picture)
    Console().print(report.to_table())
    if report.confusion is not None:
        typer.echo(report.confusion.summary())
    page = Path(cleaned) / REPORT_FILE
    if page.is_file():
        typer.echo(f"report: {printable(page)}")
