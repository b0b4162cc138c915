"""What k, the number of clusters, and the bounds of Eq. 1 do on simulated maps.

    python -m benchmarks.studies                                    # tables
    python -m benchmarks.studies --picture docs/images/studies.svg  # and the plots
    python -m benchmarks.studies --set scene=street --seeds 0 1

Time is processor time of one thread, on the map of the first seed.
"""

import argparse
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.density import machine
from benchmarks.studies.labelled import labelled_map
from benchmarks.studies.parameters import over_clusters, over_neighbours, over_ranges
from benchmarks.studies.picture import draw

__all__ = ["main"]

NEIGHBOURS = (10, 25, 50, 75, 100, 150)
CLUSTERS = (1, 2, 3, 5, 10, 20)
SMALLEST, LARGEST = (0.0, 5.0, 10.0), (5.0, 10.0, 20.0, 30.0, 40.0)
RANGES = tuple((low, high) for low in SMALLEST for high in LARGEST if low <= high)


def main(arguments: Sequence[str] | None = None) -> None:
    """Do all three studies."""
    parser = argparse.ArgumentParser(
        prog="benchmarks.studies",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("--seeds", nargs="+", type=int, default=[0, 1, 2], metavar="N")
    add("--set", nargs="+", default=[], metavar="KEY=VALUE", help="of the simulation")
    add("--picture", type=Path, metavar="FILE", help="SVG or PNG")
    options = parser.parse_args(arguments)
    print(
        f"{machine()}; {datetime.now(UTC):%Y-%m-%d %H:%M} UTC; seeds {options.seeds}; "
        f"settings {options.set or 'none'}",
        flush=True,
    )
    maps = [labelled_map([*options.set, f"seed={seed}"]) for seed in options.seeds]
    distances = np.array([list(over_clusters(made, CLUSTERS)) for made in maps])
    _print(("clusters", "mean, mm", "variance, mm²", "removed, %"), distances.mean(axis=0))
    ranges = np.array([list(over_ranges(made, RANGES)) for made in maps])
    _print(("smallest, %", "largest, %", "SA, %", "DA, %"), ranges.mean(axis=0))
    times = np.array(list(over_neighbours(maps[0], NEIGHBOURS)))
    _print(("k", "µs a point"), times)
    if options.picture:
        draw(options.picture, times, distances, ranges)


def _print(columns: Sequence[str], rows: Iterable[NDArray[np.float64]]) -> None:
    """Print a table of means over the seeds, as Markdown."""
    print("\n| " + " | ".join(columns) + " |\n|" + "---|" * len(columns))
    for row in rows:
        print("| " + " | ".join(f"{value:,.6g}" for value in row) + " |", flush=True)


if __name__ == "__main__":
    main()
