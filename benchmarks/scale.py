"""Memory, temporary files and time of maps of 10 and of 100 million points, cleaned in tiles.

    python -m benchmarks.scale [--points 10000000 100000000] [--folder DIR] [--workers 2]
    python -m benchmarks.scale --maps MAP [MAP ...] [--config auto] [--max-points 500000]

Makes each map with `dynahull-pipeline simulate --points N`, unless it is there, or takes maps that
are given, and cleans it in tiles of a million points (`--max-points`). Prints for each the wall
time, microseconds a point, the most that its temporary files took, and the most memory that all
processes of the run held together: anonymous and shared pages, as the page cache of files is the
system's to give and take.
Asked of 100 million points: at most 1.5 GiB, 10 GB of temporary files, and 1.15 times the time a
point of 10 million.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from contextlib import suppress
from datetime import date
from pathlib import Path

from benchmarks.density import machine
from pipeline.work.folder import WORK_FOLDER

COMMAND = [
    sys.executable,
    "-P",
    "-c",
    "from pipeline.commands.app import main; main()",
]
_EVERY = 0.25


def main() -> None:
    """Make and clean the maps, and print a line for each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, nargs="+", default=[10_000_000, 100_000_000])
    parser.add_argument("--maps", type=Path, nargs="+", help="maps to clean instead of these")
    parser.add_argument("--folder", type=Path, default=Path("scale"))
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--max-points", type=int, default=1_000_000)
    parser.add_argument("--config", default="paper", help="a ready configuration")
    arguments = parser.parse_args()
    print(f"{date.today()}, {machine()}; {arguments.workers} workers")
    made = (simulated(arguments.folder / str(points), points) for points in arguments.points)
    for path in arguments.maps or made:
        folder = arguments.folder / path.stem if arguments.maps else path.parent
        folder.mkdir(parents=True, exist_ok=True)
        settings = ["--set", f"execution.workers={arguments.workers}"]
        settings += ["--set", f"tiling.max_points={arguments.max_points}"]
        clean = ["run", str(path), "-o", str(folder / "out"), *settings]
        clean += ["-c", arguments.config]
        work = folder / "out" / WORK_FOLDER
        seconds, peak, used, files = measured([*COMMAND, *clean], folder / "log", work)
        points = json.loads((folder / "out" / "run.json").read_text())["points"]
        print(
            f"{path.name}, {points:,} points: {seconds:7.1f} s, "
            f"{seconds / points * 1e6:.2f} us a point; "
            f"of processors {used / points * 1e6:.2f} us a point; peak {peak / 2**30:.2f} GiB; "
            f"temporary files {files / 1e9:.2f} GB, {files / points:.0f} bytes a point",
            flush=True,
        )


def simulated(folder: Path, points: int) -> Path:
    """Return a map of so many points in a folder, made unless it is there."""
    if not (folder / "map.pcd").exists():
        make = ["simulate", "-o", str(folder), "--points", str(points)]
        subprocess.run([*COMMAND, *make], check=True, capture_output=True)
    return folder / "map.pcd"


def measured(command: list[str], log: Path, work: Path) -> tuple[float, int, float, int]:
    """Run a command; return its wall time, the memory and the processor time of its processes.

    The time is summed over processes as they were last seen: not all of them are waited for, so
    that the system's account of ended processes lacks some. The last value is the most that a
    folder of temporary files held.
    """
    begun, peak, files = time.perf_counter(), 0, 0
    used: dict[int, float] = {}
    with log.open("w") as stream:
        process = subprocess.Popen(command, stdout=stream, stderr=stream)
        while process.poll() is None:
            family = family_of(process.pid)
            peak = max(peak, sum(map(held_by, family)))
            used |= {each: seconds for each in family if (seconds := processor_seconds(each))}
            files = max(files, stored_in(work))
            time.sleep(_EVERY)
    if process.returncode:
        sys.exit(f"failed: see {log}")
    return time.perf_counter() - begun, peak, sum(used.values()), files


def stored_in(folder: Path) -> int:
    """Return the bytes that the files of a folder take on the disk; they may go meanwhile."""
    total = 0
    for parent, _, names in os.walk(folder):
        for name in names:
            with suppress(OSError):
                total += (Path(parent) / name).lstat().st_blocks * 512
    return total


def family_of(root: int) -> list[int]:
    """Return a process and all below it."""
    parents = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        fields = after_name(path)
        if fields:
            parents[int(path.parent.name)] = int(fields[1])
    family = [root]
    for each in family:
        family += [child for child, parent in parents.items() if parent == each]
    return family


def held_by(process: int) -> int:
    """Return the bytes that a process holds now, the page cache not counted.

    What several processes share, as those forked from one do, counts once in their sum.
    """
    try:
        lines = Path(f"/proc/{process}/smaps_rollup").read_text(encoding="utf-8").splitlines()
    except OSError:
        return 0
    kinds = ("Pss_Anon:", "Pss_Shmem:")
    return sum(int(line.split()[1]) << 10 for line in lines if line.startswith(kinds))


def processor_seconds(process: int) -> float:
    """Return the processor time of a process so far; 0 where it has ended."""
    fields = after_name(Path(f"/proc/{process}/stat"))
    return sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK") if fields else 0.0


def after_name(path: Path) -> list[str]:
    """Return what the system says of a process, from its state on; see proc(5)."""
    try:
        return path.read_text(encoding="utf-8").rpartition(")")[2].split()
    except OSError:
        return []


if __name__ == "__main__":
    main()
