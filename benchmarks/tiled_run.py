"""What tiles cost: the same map as one tile and as many, with one worker and with two.

    python -m benchmarks.tiled_run [MAP] [--rounds 3] [--max-points 1000000] [--config paper]
        [--only-two-workers]

Runs the whole command in turn, in processes of their own: the map as one tile with two threads, in
tiles with two workers, and in tiles with one worker. Prints medians of the wall times, and of the
ratios within a round, as machines change their speed from one to the next. Asked: tiles at most
1.25 times one tile, and two workers at least 1.7 times one. Each round ends with what the machine
itself gives for a second core, measured on density kernels in processes that share nothing.

The kinds of run take turns forwards and backwards, so that a machine that gets slower or faster
favours none. `--only-two-workers` leaves out those with one worker. A round before the first is not
counted: it compiles, where nothing compiled is kept.

Use an environment as users have it, without the extra `test`: what that installs (pandas, which
Arrow imports where it finds it) takes half a second of every run before its first task.
"""

import argparse
import os
import subprocess
import tempfile
import time
from datetime import date
from pathlib import Path
from statistics import median

from benchmarks.density import machine, two_processes
from benchmarks.whole_run import COMMAND, ONE_TILE

_POINTS_ALONE = 500_000
"""Points whose densities a process that shares nothing finds."""


def main() -> None:
    """Run in turn, and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    default = Path("../shared/data/maps/campus_loop.laz")
    parser.add_argument("map", nargs="?", type=Path, default=default)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--max-points", type=int, default=1_000_000)
    parser.add_argument("--config", default="paper", help="a ready configuration")
    parser.add_argument("--only-two-workers", action="store_true")
    arguments = parser.parse_args()
    print(f"{date.today()}, {machine()}; {arguments.config}")
    ready = ["-c", arguments.config]
    tiles = ["--set", f"tiling.max_points={arguments.max_points}"]
    kinds = {
        "one tile, two threads": [*ready, *ONE_TILE, "--set", "execution.workers=2"],
        "tiles, two workers": [*ready, *tiles, "--set", "execution.workers=2"],
    }
    if not arguments.only_two_workers:
        kinds["tiles, one worker"] = [*ready, *tiles, "--set", "execution.workers=1"]
    for settings in kinds.values():
        seconds(arguments.map, settings)
    rounds: dict[str, list[float]] = {}
    for number in range(arguments.rounds):
        times = {}
        for kind in reversed(kinds) if number % 2 else kinds:
            times[kind] = seconds(arguments.map, kinds[kind])
            print(f"  {kind:<22} {times[kind]:6.1f} s", flush=True)
        whole, two, *one = (times[kind] for kind in kinds)
        ratios = {"tiles, to one tile": two / whole}
        if one:
            ratios["two workers, to one"] = one[0] / two
            ratios["two processes that share nothing, to one"] = two_processes(_POINTS_ALONE, 1)
        print("  " + "; ".join(f"{name} {ratio:.2f}" for name, ratio in ratios.items()))
        for name, value in (times | ratios).items():
            rounds.setdefault(name, []).append(value)
    for name, values in rounds.items():
        print(f"{name}: {median(values):.2f} ({min(values):.2f} to {max(values):.2f})")


def seconds(path: Path, settings: list[str]) -> float:
    """Return the wall time of a run, whose modules are compiled once, as installing does."""
    environment = os.environ | {"PYTHONDONTWRITEBYTECODE": ""}
    with tempfile.TemporaryDirectory() as folder:
        begun = time.perf_counter()
        command = [*COMMAND, str(path), *settings, "-o", folder]
        subprocess.run(command, check=True, capture_output=True, env=environment)
        return time.perf_counter() - begun


if __name__ == "__main__":
    main()
