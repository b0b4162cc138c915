"""Arguments and options that several commands share."""

from typing import Annotated

import typer

Maps = Annotated[
    list[str],
    typer.Argument(
        metavar="MAP...",
        help="One or more files, a folder, or a glob: together they are one map. "
        "PCD, LAS, LAZ, COPC, PLY, Parquet, npy, npz.",
        show_default=False,
    ),
]
Output = Annotated[
    str | None,
    typer.Option("-o", "--output", metavar="DIR", help="Output folder. [default: <map>_dynahull]"),
]
ConfigurationSource = Annotated[
    str | None,
    typer.Option(
        "-c",
        "--config",
        metavar="CONFIG.yaml",
        help="Configuration file, or one of: paper, indoor, outdoor.",
    ),
]
Settings = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="One setting, such as neighbours.k=50."),
]
