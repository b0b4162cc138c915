"""What workers are forked from: one process that has imported what they need."""

import json
import os
import subprocess
import sys

import pytest

pytestmark = pytest.mark.linux_only

PREAMBLE = """
import json, os, sys, time
from pathlib import Path
from pipeline.workers.local_dask import local_workers, start_fork_server
import numpy as np

def children():
    found = Path("/proc/self/task", str(os.getpid()), "children").read_text()
    return [int(pid) for pid in found.split()]
"""


def said(program, **environment):
    """Run a program that prints JSON, and return what it says."""
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=os.environ | environment,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert not done.stderr
    return json.loads(done.stdout)


WORKERS = (
    PREAMBLE
    + """
import fcntl
lock = os.open(".", os.O_RDONLY)
fcntl.flock(lock, fcntl.LOCK_EX)
start_fork_server()
os.close(lock)

from pipeline.work.folder import TaskReport

def held():
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")

def kept():
    before = held()
    arrays = [np.ones(3_500_000) for _ in range(3)]
    del arrays
    return held() - before

def threads(folder, number):
    import signal
    import numba, scipy.linalg, sklearn.cluster
    from threadpoolctl import threadpool_info
    counts = [pool["num_threads"] for pool in threadpool_info()]
    counts.append(numba.config.NUMBA_NUM_THREADS)
    assert "pipeline.workers.preloaded" in sys.modules
    assert kept() > 75_000_000
    assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL
    return TaskReport(0, tuple(counts))

with local_workers(1, 3 << 30) as executor:
    ((_, report),) = executor.run(threads, "", [0])
    other = os.open(".", os.O_RDONLY)
    fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)  # which neither server nor workers hold
print(json.dumps({"threads": report.counts, "kept": kept()}))
"""
)


def test_workers_have_one_thread_no_lock_and_keep_what_is_freed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = said(WORKERS)
    assert set(found["threads"]) == {1}
    assert found["kept"] < 75_000_000  # these settings are for workers only


def test_what_lies_in_the_current_folder_is_not_imported(tmp_path):
    hostile, installed = tmp_path / "hostile", tmp_path / "bin"
    hostile.mkdir()
    installed.mkdir()
    names = ("multiprocessing", "pipeline", "distributed", "dask", "numba", "socket", "pickle")
    for name in names:
        (hostile / f"{name}.py").write_text("open('imported', 'w').write(__name__)\n")
    program = """
from pipeline.workers.local_dask import local_workers
from pipeline.work.folder import TaskReport
if __name__ == "__main__":
    with local_workers(1, 3 << 30) as executor:
        print(list(executor.run(TaskReport, "", [])))
"""
    (installed / "program").write_text(program)  # as a command is, which has no -P
    subprocess.run(
        [sys.executable, installed / "program"], cwd=hostile, check=True, timeout=300,
        env={name: value for name, value in os.environ.items() if name != "PYTHONSAFEPATH"},
    )  # fmt: skip
    assert not (hostile / "imported").exists()
