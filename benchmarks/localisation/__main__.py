"""Scans of a second drive, found on the true map, the map with ghosts, and the cleaned map.

    python -m benchmarks.localisation                                   # three seeds, indoors
    python -m benchmarks.localisation --set walkers=40 queuers=6 machines=4 --seeds 0 1 2 3
    python -m benchmarks.localisation --picture docs/images/localisation.png

Needs the extra `localisation`. Prints a table with means over the seeds, least and largest in
brackets; the picture is of the first seed.
"""

import argparse
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.util import find_spec
from pathlib import Path
from statistics import fmean

from benchmarks.density import machine
from benchmarks.localisation.maps import TRUE, maps_of, second_drive
from benchmarks.localisation.matching import localise
from benchmarks.localisation.picture import draw
from benchmarks.localisation.trajectories import Errors, errors_of
from pipeline.configuration.run import load_parameters
from pipeline.simulation import SimulationParameters

__all__ = ["main"]

SETTINGS = ("scans=300", "rotations_per_scan=4", "azimuth_step=2.0")
"""Two minutes: a scan of 16 rings and 180 columns every 0.4 s."""

_COLUMNS = {
    "ape_rmse": "APE, RMSE, mm",
    "ape_largest": "largest, mm",
    "rpe_rmse": "RPE over 1 m, RMSE, mm",
    "heading_rmse": "angle, RMSE, degrees",
    "lost_percent": "lost, % of scans",
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Drive, clean, localise, compare."""
    parser = _parser()
    options = parser.parse_args(arguments)
    missing = [name for name in ("small_gicp", "evo") if find_spec(name) is None]
    if missing:
        parser.error(
            f"{' and '.join(missing)} missing: pip install dynahull-pipeline[localisation]"
        )
    print(
        f"{machine()}; {datetime.now(UTC):%Y-%m-%d %H:%M} UTC; seeds {options.seeds}; "
        f"settings {options.set or 'none'}",
        flush=True,
    )
    errors: dict[str, list[Errors]] = {}
    for seed in options.seeds:
        picture = options.picture if seed == options.seeds[0] else None
        for name, found in _errors_by_map(seed, options.set, picture).items():
            print(f"  seed {seed}, {name}: APE {found.ape_rmse:.1f} mm", flush=True)
            errors.setdefault(name, []).append(found)
    print(table(errors))


def _errors_by_map(seed: int, settings: Sequence[str], picture: Path | None) -> dict[str, Errors]:
    parameters = load_parameters(SimulationParameters, None, [*SETTINGS, *settings, f"seed={seed}"])
    maps, drive = maps_of(parameters), second_drive(parameters)
    found = {
        name: localise(points, drive.scans, drive.moves, drive.poses[0])
        for name, points in maps.items()
    }
    if picture is not None:
        draw(picture, maps[TRUE], drive.poses, found)
    return {name: errors_of(poses, drive.poses) for name, poses in found.items()}


def table(errors: dict[str, list[Errors]]) -> str:
    """Return a row a map: means, and from the least to the largest where seeds are several."""
    lines = [
        "",
        "| map | " + " | ".join(_COLUMNS.values()) + " |",
        "|---|" + "---|" * len(_COLUMNS),
    ]
    for name, of_seeds in errors.items():
        cells = (_cell([each.figures()[column] for each in of_seeds]) for column in _COLUMNS)
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _cell(values: Sequence[float]) -> str:
    mean = f"{fmean(values):.2f}"
    return mean if len(values) == 1 else f"{mean} ({min(values):.2f} to {max(values):.2f})"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="benchmarks.localisation",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("--seeds", nargs="+", type=int, default=[0, 1, 2], metavar="N")
    add("--set", nargs="+", default=[], metavar="KEY=VALUE", help="of the simulation")
    add("--picture", type=Path, metavar="FILE", help="PNG or SVG of the first seed")
    return parser


if __name__ == "__main__":
    main()
