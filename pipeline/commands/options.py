"""Arguments and options that several commands share."""

import json
import shlex
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from pipeline.configuration.run import Configuration

MAPS = typer.Argument(
    metavar="MAP...",
    help="One or more files, a folder, or a glob: together they are one map. "
    "PCD, LAS, LAZ, COPC, PLY, E57, Parquet, npy, npz, text (xyz, txt, pts, asc, csv), KITTI bin; "
    "a folder of scans with poses.",
    show_default=False,
)
Maps = Annotated[list[str], MAPS]
Output = Annotated[
    str | None,
    typer.Option(
        "-o", "--output", metavar="DIR", help="Output folder.", show_default="<map>_dynahull"
    ),
]
ConfigurationSource = Annotated[
    str | None,
    typer.Option(
        "-c",
        "--config",
        metavar="CONFIG.yaml",
        help="Configuration file, or one of: auto (default), paper, indoor, outdoor, slurm.",
    ),
]
Settings = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="One setting, such as neighbours.k=50."),
]
WindowOption = Annotated[
    tuple[float, float, float, float] | None,
    typer.Option(
        "--window", metavar="X0 Y0 X1 Y1", help="Clean what lies in this window alone, metres."
    ),
]
HeightOption = Annotated[
    tuple[float, float] | None,
    typer.Option(
        "--height", metavar="Z0 Z1", help="Clean what lies between these heights alone, metres."
    ),
]
Protect = Annotated[
    Path | None,
    typer.Option(
        "--protect",
        metavar="FILE",
        help="Areas where nothing is removed: GeoJSON, WKT, or boxes, a line each.",
    ),
]
Confidence = Annotated[
    float | None,
    typer.Option(
        "--confidence",
        metavar="SHARE",
        help="Remove what moved with at least this probability, above 0 and below 1; of auto "
        "(removal.confidence).",
    ),
]
Scans = Annotated[
    str | None,
    typer.Option("--scans", metavar="FOLDER", help="Scans that are the map, in the place of MAP."),
]
Poses = Annotated[
    str | None,
    typer.Option(
        "--poses", metavar="FILE", help="Poses of the scans, also of those in a map (input.poses)."
    ),
]
Scheduler = Annotated[
    str | None, typer.Option(metavar="ADDRESS", help="Use the workers of a running Dask scheduler.")
]
ClusterName = Annotated[
    str | None,
    typer.Option(
        "--cluster",
        metavar="NAME",
        help="Workers are jobs of a batch system: slurm, pbs, lsf, sge or htcondor.",
    ),
]
TLS = Annotated[
    bool, typer.Option("--tls", help="Encrypt between scheduler, workers and run (cluster.tls).")
]


Folder = Annotated[Path, typer.Argument(metavar="DIR", help="Output folder of a run.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]
Fresh = Annotated[
    bool, typer.Option("--fresh", help="Start over, whatever an earlier run left half done.")
]


@contextmanager
def telling_how_to_go_on() -> Iterator[None]:
    """Say, where Ctrl-C or a signal ends the block, by which command it goes on."""
    try:
        yield
    except KeyboardInterrupt:
        words = [word for word in sys.argv[1:] if word != "--fresh"]
        typer.echo(f"to go on: {shlex.join(['dynahull-pipeline', *words])}", err=True)
        raise


def named_maps(maps: list[str] | None, scans: str | None) -> list[str]:
    """Return what is cleaned: what `MAP...` names, or `--scans`."""
    if bool(maps) == bool(scans):
        raise typer.BadParameter("expected MAP... or --scans FOLDER", param_hint="MAP...")
    return [*(maps or []), *([scans] if scans else [])]


def output_folder(output: str | None) -> Path | None:
    """Return the folder that `-o` names, None for the default."""
    from pipeline.errors import ConfigurationError  # noqa: PLC0415

    if output == "":
        raise ConfigurationError("-o: expected a folder, found nothing")
    return None if output is None else Path(output)


def configured(config: str | None, settings: list[str]) -> "Configuration":
    """Return the configuration of a run; settings without effect are refused."""
    from pipeline.configuration.effect import check_effect  # noqa: PLC0415 (slow to import)
    from pipeline.configuration.run import load_configuration  # noqa: PLC0415

    configuration = load_configuration(config, settings)
    check_effect(settings, configuration)
    return configuration


def pose_settings(poses: str | None) -> list[str]:
    """Return `--poses` as a setting of the configuration."""
    return [f"input.poses={json.dumps(poses)}"] if poses else []


def part_settings(
    window: tuple[float, ...] | None,
    height: tuple[float, ...] | None,
    protect: Path | None,
    confidence: float | None = None,
) -> list[str]:
    """Return the options about what is removed, and where, as settings of the configuration."""
    from pipeline.areas import read_areas  # noqa: PLC0415 (slow to import)

    settings = [] if confidence is None else [f"removal.confidence={confidence}"]
    settings += [f"input.window={list(window)}"] if window else []
    settings += [f"input.height={list(height)}"] if height else []
    if protect is not None:
        areas = [area.model_dump() for area in read_areas(protect)]
        settings.append(f"removal.protect={json.dumps(areas)}")
    return settings


def worker_settings(scheduler: str | None, cluster: str | None, tls: bool) -> list[str]:
    """Return the options about workers elsewhere as settings of the configuration."""
    settings = [f"execution.scheduler={scheduler}"] if scheduler else []
    settings += [f"execution.cluster={cluster}"] if cluster else []
    return settings + (["cluster.tls.enabled=true"] if tls else [])


def check_encryption(configuration: "Configuration", tls: bool) -> None:
    """Refuse `--tls` where there is nobody elsewhere to talk to."""
    from pipeline.configuration.run import is_elsewhere  # noqa: PLC0415 (slow to import)
    from pipeline.errors import ConfigurationError  # noqa: PLC0415

    if tls and not is_elsewhere(configuration):
        raise ConfigurationError("--tls: expected --cluster or --scheduler with it, found neither")
