"""Memory and time of maps of 10 and of 100 million points, cleaned in tiles.

    python -m benchmarks.scale [--points 10000000 100000000] [--folder DIR] [--workers 2]

Makes each map with `dynahull-pipeline simulate --points N`, unless it is there, and cleans it with
`tiling.max_points` at its default. Prints for each the wall time, microseconds a point, and the
most memory that all processes of the run held together: anonymous and shared pages, as the page
cache of files is the system's to give and take. Asked: below 2 GiB, within 10 % of each other, and
the time a point within 1.15.
"""

import argparse
import resource
import subprocess
import sys
import time
from datetime import date
from pathlib import Path

from benchmarks.density import machine

COMMAND = [sys.executable, "-c", "from pipeline.cli import leave_at_once; leave_at_once()"]
_EVERY = 0.1


def main() -> None:
    """Make and clean the maps, and print a line for each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, nargs="+", default=[10_000_000, 100_000_000])
    parser.add_argument("--folder", type=Path, default=Path("scale"))
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args()
    print(f"{date.today()}, {machine()}; {arguments.workers} workers")
    for points in arguments.points:
        folder = arguments.folder / str(points)
        if not (folder / "map.pcd").exists():
            make = ["simulate", "-o", str(folder), "--points", str(points)]
            subprocess.run([*COMMAND, *make], check=True, capture_output=True)
        settings = ["--set", f"execution.workers={arguments.workers}"]
        clean = ["run", str(folder / "map.pcd"), "-o", str(folder / "out"), *settings]
        before = processor_seconds()
        seconds, peak = measured([*COMMAND, *clean], folder / "log")
        used = processor_seconds() - before
        print(
            f"{points:>13,} points: {seconds:7.1f} s, {seconds / points * 1e6:.2f} us a point; "
            f"of processors {used / points * 1e6:.2f} us a point; peak {peak / 2**30:.2f} GiB",
            flush=True,
        )


def measured(command: list[str], log: Path) -> tuple[float, int]:
    """Run a command; return its wall time, and the most memory that its processes held."""
    begun, peak = time.perf_counter(), 0
    with log.open("w") as stream:
        process = subprocess.Popen(command, stdout=stream, stderr=stream)
        while process.poll() is None:
            peak = max(peak, held_by(process.pid))
            time.sleep(_EVERY)
    if process.returncode:
        sys.exit(f"failed: see {log}")
    return time.perf_counter() - begun, peak


def processor_seconds() -> float:
    """Return the processor time of all ended processes, which other work hardly changes."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def held_by(root: int) -> int:
    """Return the bytes that a process and all below it hold now, the page cache not counted."""
    parents, sizes = {}, {}
    for status in Path("/proc").glob("[0-9]*/status"):
        try:
            lines = status.read_text().splitlines()
        except OSError:
            continue
        fields = {name: value.split() for name, _, value in (each.partition(":") for each in lines)}
        number = int(fields["Pid"][0])
        parents[number] = int(fields["PPid"][0])
        kinds = ("RssAnon", "RssShmem")
        sizes[number] = sum(int(fields[kind][0]) << 10 for kind in kinds if kind in fields)
    total = 0
    for number, size in sizes.items():
        above: int | None = number
        while above is not None and above != root:
            above = parents.get(above)
        total += size if above == root else 0
    return total


if __name__ == "__main__":
    main()
