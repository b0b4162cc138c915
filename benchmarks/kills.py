"""A run killed again and again, with everything that belongs to it, and resumed each time.

    python -m benchmarks.kills [MAP] [--kills 20] [--max-points 20000] [--seed 0]

Cleans a map once undisturbed. Then starts the same run elsewhere, kills the whole process group at
random moments (`kill -9`), and starts it again, until it ends in spite of that; and all this again
until it was killed often enough. Prints how often it was killed in which stage, how many tasks
were done twice, and whether all result files have the same bytes.
"""

import argparse
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from pipeline.errors import WorkError
from pipeline.work.files import read_sealed

COMMAND = [
    sys.executable,
    "-P",
    "-c",
    "from pipeline.commands.app import main; main()",
    "run",
]
RESULTS = ("static.pcd", "dynamic.pcd", "labels.parquet")
WORK = ".dynahull-work"


def main() -> None:
    """Kill, resume, and compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    default = Path("../shared/data/maps/corridor.pcd")
    parser.add_argument("map", nargs="?", type=Path, default=default)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--max-points", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    random.seed(arguments.seed)
    settings = ["--labels", "--set", f"tiling.max_points={arguments.max_points}"]
    with tempfile.TemporaryDirectory() as folder:
        whole, killed = Path(folder) / "whole", Path(folder) / "killed"
        command = [*COMMAND, str(arguments.map), *settings]
        begun = time.perf_counter()
        subprocess.run([*command, "-o", str(whole)], check=True, capture_output=True)
        seconds = time.perf_counter() - begun
        stages: Counter[str] = Counter()
        kills = redone = ended = 0
        same = True
        done: dict[str, int] = {}
        while kills < arguments.kills or not ended:
            moment = random.uniform(0.3, 0.8) * seconds if kills < arguments.kills else 1e6
            killed_it = run_for(moment, [*command, "-o", str(killed)])
            if killed_it and not (killed / "run.json").exists():
                stages[stage_of(killed)] += 1
                kills += 1
                now = markers(killed)
                redone += sum(1 for name, time_ns in done.items() if now.get(name) != time_ns)
                done = now
                continue
            ended += 1
            same &= all(
                (whole / name).read_bytes() == (killed / name).read_bytes() for name in RESULTS
            )
            shutil.rmtree(killed)
            done = {}
        print(f"killed {kills} times, in {dict(stages)}; {ended} runs came to their end")
        print(f"finished tasks done again: {redone}")
        print(f"results: {'the same bytes' if same else 'DIFFERENT'}")
        sys.exit(0 if same and not redone else 1)


def run_for(seconds: float, command: list[str]) -> bool:
    """Start a run, and kill it with all its processes after some time; False if it ended before."""
    process = subprocess.Popen(
        command, start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        process.wait(seconds)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        return True
    return False


def stage_of(folder: Path) -> str:
    """Return the stage that a run was in."""
    try:
        return str(read_sealed(folder / WORK / "state.json")["stage"])
    except WorkError:
        return "start"


def markers(folder: Path) -> dict[str, int]:
    """Return when each task was marked as done; parts of results are written anew by each run."""
    found = (folder / WORK).glob("*/*.done")
    return {str(path): path.stat().st_mtime_ns for path in found if path.parent.name != "write"}


if __name__ == "__main__":
    main()
