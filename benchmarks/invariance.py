"""The same bytes however a real map is cut: static map, ghosts and labels, against one tile.

    python -m benchmarks.invariance [--maps ../shared/data/maps] [--only corridor.pcd]

Cleans each map as one tile, and again for each way to cut it below; prints the tiles and whether
all result files have the same bytes. The maps of campus and street take many minutes each.
"""

import argparse
import subprocess
import sys
import tempfile
from datetime import date
from pathlib import Path

from benchmarks.density import machine
from benchmarks.whole_run import COMMAND, ONE_TILE

CUTS: dict[str, list[list[str]]] = {
    "corridor.pcd": [
        ["tiling.max_points=150000"],
        ["tiling.max_points=2000"],
        ["tiling.max_points=2000", "tiling.halo=0.1", "execution.cluster=none"],
        ["tiling.max_points=20000", "tiling.halo=30"],
    ],
    "room_static_sensor.laz": [
        ["tiling.max_points=25000", "tiling.halo=0.05"],
    ],
    "campus_loop.laz": [
        ["tiling.max_points=2500000", "tiling.format=las"],
        ["tiling.max_points=550000", "execution.workers=1"],
        ["tiling.max_points=50000", "tiling.halo=1"],
    ],
    "street_64beam_labelled.laz": [
        ["tiling.max_points=8000000"],
        ["tiling.max_points=80000", "tiling.format=las"],
    ],
}


def main() -> None:
    """Clean, compare, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--maps", type=Path, default=Path("../shared/data/maps"))
    parser.add_argument("--only", choices=CUTS)
    parser.add_argument("--config", default="auto", help="a ready configuration")
    arguments = parser.parse_args()
    print(f"{date.today()}, {machine()}")
    same = True
    for name in [arguments.only] if arguments.only else CUTS:
        with tempfile.TemporaryDirectory() as folder:
            whole, tiled = Path(folder) / "whole", Path(folder) / "tiled"
            clean(arguments.maps / name, whole, [*ONE_TILE, "-c", arguments.config])
            for cut in CUTS[name]:
                settings = [part for setting in cut for part in ("--set", setting)]
                clean(
                    arguments.maps / name, tiled, [*settings, "--keep-work", "-c", arguments.config]
                )
                tiles = len(list(tiled.glob(".dynahull-work/label/*.done")))
                equal = all(
                    (whole / each).read_bytes() == (tiled / each).read_bytes()
                    for each in results(whole)
                )
                same &= equal
                verdict = "the same bytes" if equal else "DIFFERENT"
                print(
                    f"{name}, {' '.join(cut) or 'as it is'}: {tiles} tiles, {verdict}", flush=True
                )
    sys.exit(0 if same else 1)


def clean(path: Path, folder: Path, settings: list[str]) -> None:
    """Clean a map, with labels."""
    command = [*COMMAND, str(path), "-o", str(folder), "--labels", "--fresh", *settings]
    subprocess.run(command, check=True, capture_output=True)


def results(folder: Path) -> list[str]:
    """Return the names of the files that must be the same."""
    return [path.name for path in folder.iterdir() if path.stem in ("static", "dynamic", "labels")]


if __name__ == "__main__":
    main()
