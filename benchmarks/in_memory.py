"""What the command costs beyond the API in memory, for a map of one tile.

    python -m benchmarks.in_memory [MAP] [--rounds 5] [--workers 2]

Runs in turn, forwards and backwards, in processes of their own: `dynahull-pipeline run` with the
map as one tile, and a program that reads the same file and calls `dynahull.clean` on the array, and
writes nothing. Prints the median of the ratios within a round. Asked: at most 1.15.

Use an environment as users have it, see `benchmarks.tiled_run`.
"""

import argparse
import subprocess
import sys
from datetime import date
from pathlib import Path
from statistics import median
from time import perf_counter

from benchmarks.density import machine
from benchmarks.whole_run import ONE_TILE, measure

IN_MEMORY = """
import sys
import numpy as np
from dynahull import clean
from tiling.formats import open_map
threads = int(sys.argv[2])
batches = open_map(sys.argv[1], threads).batches(500_000)
clean(np.concatenate([batch.xyz for batch in batches]), "paper", threads=threads)
"""


def main() -> None:
    """Run in turn, and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    default = Path("../shared/data/maps/campus_loop.laz")
    parser.add_argument("map", nargs="?", type=Path, default=default)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--workers", default="2")
    arguments = parser.parse_args()
    print(f"{date.today()}, {machine()}; {arguments.map.name}, {arguments.workers} workers")
    settings = [*ONE_TILE, "--set", f"execution.workers={arguments.workers}"]
    kinds = {
        "command": lambda: measure(arguments.map, settings)[0],
        "in memory": lambda: in_memory(arguments.map, arguments.workers),
    }
    ratios = []
    for number in range(arguments.rounds + 1):
        order = reversed(kinds) if number % 2 else kinds
        times = {kind: kinds[kind]() for kind in order}
        if number == 0:
            continue  # compiles, and warms the file cache
        ratios.append(times["command"] / times["in memory"])
        print(f"  {times['command']:.2f} s, {times['in memory']:.2f} s in memory", flush=True)
    print(f"{median(ratios):.2f} times ({min(ratios):.2f} to {max(ratios):.2f})")


def in_memory(path: Path, threads: str) -> float:
    """Return the wall time of the program, in seconds."""
    begun = perf_counter()
    subprocess.run([sys.executable, "-P", "-c", IN_MEMORY, str(path), threads], check=True)
    return perf_counter() - begun


if __name__ == "__main__":
    main()
