"""What it costs to schedule a hundred thousand tiles, whose tasks do nothing but mark themselves.

    python -m benchmarks.scheduling [--tasks 100000] [--workers 2]

Runs empty tasks through the scheduling code of a run, on workers of this machine. Prints, as it
goes, the tasks done, the microseconds a task, the memory of the process that schedules, and the
tasks that the client still knows.
"""

import argparse
import tempfile
import time
from datetime import date
from pathlib import Path
from typing import Any

from benchmarks.density import machine
from pipeline.work.folder import TaskReport, WorkFolder
from pipeline.workers.local_dask import local_workers


def mark_itself(folder: str, number: int) -> TaskReport:
    """Leave nothing but a marker."""
    report = TaskReport(1_000_000, (0, 1, 2, 3, 4, 5))
    WorkFolder(Path(folder), "key").finish("empty", number, report)
    return report


def main() -> None:
    """Schedule the tasks, and print a line now and then."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tasks", type=int, default=100_000)
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args()
    print(f"{date.today()}, {machine()}; {arguments.workers} workers")
    with (
        tempfile.TemporaryDirectory() as folder,
        local_workers(arguments.workers, 2 << 30) as executor,
    ):
        WorkFolder(Path(folder), "key").make("empty")
        on_dask: Any = executor._started.result()  # type: ignore[attr-defined]
        client = on_dask._client
        begun, most = time.perf_counter(), 0
        for done, _ in enumerate(executor.run(mark_itself, folder, range(arguments.tasks)), 1):
            most = max(most, len(client.futures))
            if done % (arguments.tasks // 10) == 0:
                print(
                    f"{done:>9,} tasks, {(time.perf_counter() - begun) / done * 1e6:6.0f} us each, "
                    f"{resident():.0f} MiB, at most {most} known to the client",
                    flush=True,
                )


def resident() -> float:
    """Return the memory of this process, client and scheduler, in MiB."""
    status = Path("/proc/self/status").read_text()
    line = next(line for line in status.splitlines() if line.startswith("RssAnon"))
    return int(line.split()[1]) / 1024


if __name__ == "__main__":
    main()
