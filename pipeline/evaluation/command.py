"""The command `evaluate`. Heavy imports live inside it, so that `--help` answers at once."""

from pathlib import Path
from typing import Annotated

import typer

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
        "--truth",
        metavar="TRUTH",
        help="A map of what is static; or labels of every point of the original: a Parquet table "
        "such as `simulate` writes, or a map with a field of labels (--labels).",
        show_default=False,
    ),
]
Original = Annotated[
    str | None,
    typer.Option(
        "--original",
        metavar="MAP",
        help="The map before it was cleaned; of a result of `run`, it is known. Without it only "
        "distances are measured.",
    ),
]
LabelField = Annotated[
    str | None,
    typer.Option(
        "--labels",
        metavar="FIELD",
        help="Field of TRUTH that holds labels: TRUTH is then the original map. Of a table, its "
        "column; `moving` by default.",
    ),
]
DynamicLabels = Annotated[
    str,
    typer.Option("--dynamic", metavar="VALUES", help="Labels of what moved: 2, or 252-259."),
]
UnknownLabels = Annotated[
    str,
    typer.Option("--unlabelled", metavar="VALUES", help="Labels of points not to be compared."),
]
TruthTolerance = Annotated[
    float,
    typer.Option(
        "--truth-tolerance",
        metavar="METRES",
        help="A point of the original this near to the truth is static.",
    ),
]
CleanedTolerance = Annotated[
    float,
    typer.Option(
        "--cleaned-tolerance",
        metavar="METRES",
        help="A point of the original this near to the cleaned map was kept.",
    ),
]
MatchDistance = Annotated[
    float,
    typer.Option(
        "--match-distance", metavar="METRES", help="The same, for SA and DA (DynamicMap benchmark)."
    ),
]
Voxel = Annotated[
    float,
    typer.Option("--voxel", metavar="METRES", help="Edge of the voxels of PR and RR (ERASOR)."),
]
TransportPoints = Annotated[
    int,
    typer.Option(
        "--emd-points",
        metavar="N",
        help="Points of each sample for the Earth Mover's Distance (extra: evaluation); 0: none.",
    ),
]
GroundCostName = Annotated[
    str,
    typer.Option(
        "--ground-cost",
        metavar="COST",
        help="Of the Earth Mover's Distance: euclidean or sqeuclidean.",
    ),
]
Seed = Annotated[int, typer.Option("--seed", help="Of the samples.")]
JsonFile = Annotated[
    Path | None, typer.Option("--json", metavar="FILE", help="Write all figures as JSON.")
]
PictureFile = Annotated[
    Path | None,
    typer.Option(
        "--picture",
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
    dynamic: DynamicLabels = "1",
    unlabelled: UnknownLabels = "",
    truth_tolerance: TruthTolerance = 1e-4,
    cleaned_tolerance: CleanedTolerance = 1e-4,
    match_distance: MatchDistance = 0.05,
    voxel: Voxel = 0.2,
    emd_points: TransportPoints = 2000,
    ground_cost: GroundCostName = "euclidean",
    seed: Seed = 0,
    json_file: JsonFile = None,
    picture: PictureFile = None,
) -> None:
    """Measure how clean a map is, against a map or labels of what is static."""
    from rich.console import Console  # noqa: PLC0415

    from pipeline.evaluation.options import EvaluationOptions  # noqa: PLC0415
    from pipeline.evaluation.results import evaluate_files  # noqa: PLC0415

    options = EvaluationOptions.checked(
        labels=labels,
        dynamic=dynamic,
        unlabelled=unlabelled,
        truth_tolerance=truth_tolerance,
        cleaned_tolerance=cleaned_tolerance,
        match_distance=match_distance,
        voxel=voxel,
        emd_points=emd_points,
        ground_cost=ground_cost,
        seed=seed,
    )
    report = evaluate_files(cleaned, truth, original, options, json_file, picture)
    Console().print(report.to_table())
