"""How much the whole `run` command costs beside its density stage.

    python -m benchmarks.whole_run [MAP] [--runs 3] [--workers 1] [--tiles]

Prints, as medians over several runs of the command in a process of its own, the wall time of the
command and of each stage as a ratio to the density stage. Asked, on one core: the whole at most
1.3, and ground, clustering and labelling at most 0.2 each. The map is one tile, unless `--tiles`
leaves `tiling.max_points` at its default.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median
from time import perf_counter

from benchmarks.density import machine

COMMAND = [
    sys.executable,
    "-P",
    "-c",
    "from pipeline.commands.app import main; main()",
    "run",
]
ONE_TILE = ["--set", "tiling.max_points=100000000"]


def main() -> None:
    """Run, read the reports, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    default = Path("../shared/data/maps/campus_loop.laz")
    parser.add_argument("map", nargs="?", type=Path, default=default)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--workers", default="1", help="a number, or auto")
    parser.add_argument("--tiles", action="store_true")
    arguments = parser.parse_args()
    print(f"{machine()}; {arguments.workers} workers")
    settings = ["--set", f"execution.workers={arguments.workers}"]
    settings += [] if arguments.tiles else ONE_TILE
    ratios: dict[str, list[float]] = {}
    for number in range(arguments.runs + 1):
        whole, seconds = measure(arguments.map, settings)
        if number == 0:
            continue  # compiles, and warms the file cache
        print(f"run {number}: {whole:.1f} s, density {seconds['density']:.1f} s", flush=True)
        for stage, value in {"whole command": whole, **seconds}.items():
            ratios.setdefault(stage, []).append(value / seconds["density"])
    for stage, values in ratios.items():
        print(f"{stage:<14} {median(values):6.3f}  ({min(values):.3f} to {max(values):.3f})")


def measure(path: Path, settings: list[str]) -> tuple[float, dict[str, float]]:
    """Return the wall time of the command, and of its stages, in seconds."""
    with tempfile.TemporaryDirectory() as folder:
        begun = perf_counter()
        subprocess.run(
            [*COMMAND, str(path), "-c", "paper", *settings, "-o", folder],
            check=True,
            capture_output=True,
        )
        whole = perf_counter() - begun
        report = json.loads((Path(folder) / "run.json").read_text(encoding="utf-8"))
    return whole, report["seconds"]


if __name__ == "__main__":
    main()
