"""What workers and the clusters' fitter are forked from: one process, where that is safe.

Each test looks at a process of its own, as a command has: this one has threads.
"""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from pipeline.workers.fork_server import START_METHOD

pytestmark = pytest.mark.skipif(START_METHOD != "forkserver", reason="forks on Linux only")

PREAMBLE = """
import json, os, sys, threading, time
from pathlib import Path
from pipeline.workers.fork_server import start_fork_server, stay_forkable
stay_forkable()
import numpy as np

def children():
    found = Path("/proc/self/task", str(os.getpid()), "children").read_text()
    return [int(pid) for pid in found.split()]

def command(pid):
    return Path("/proc", str(pid), "cmdline").read_text()
"""

FITTING = (
    PREAMBLE
    + """
from dynahull.clustering import fit_clusters
from pipeline.configuration.run import load_configuration
from pipeline.workers.fitting import fitting
configuration = load_configuration(None, ["execution.workers=2", "clustering.count=3"])
sample = np.random.default_rng(0).uniform(size=(500, 3))
"""
)


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
if sys.argv[-1] == "thread":
    threading.Thread(target=time.sleep, args=(60,), daemon=True).start()
import fcntl
lock = os.open(".", os.O_RDONLY)
fcntl.flock(lock, fcntl.LOCK_EX)
start_fork_server()
os.close(lock)

from multiprocessing import forkserver
from pipeline.workers.executors import local_workers
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

server = command(forkserver._forkserver._forkserver_pid)
with local_workers(1, 3 << 30) as executor:
    ((_, report),) = executor.run(threads, "", [0])
    other = os.open(".", os.O_RDONLY)
    fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)  # which neither server nor workers hold
found = {"server": server, "own": command(os.getpid()), "threads": report.counts}
found["kept"] = kept()
print(json.dumps(found))
"""
)


@pytest.mark.parametrize("threads", ["none", "of Arrow", "of Python", "of a library"])
def test_workers_are_forked_from_this_process_where_it_has_one_thread(threads, tmp_path):
    program = WORKERS.replace("sys.argv[-1]", repr("thread" if threads == "of Python" else ""))
    if threads == "of Arrow":
        program = program.replace("import fcntl", "import fcntl, pyarrow")
    library = {"OPENBLAS_NUM_THREADS": "2"} if threads == "of a library" else {}
    found = said(f"import os\nos.chdir({str(tmp_path)!r})\n{program}", **library)
    assert (found["server"] == found["own"]) == (threads in ("none", "of Arrow"))
    assert found["server"]
    assert found["kept"] < 75_000_000
    assert set(found["threads"]) == {1}
    assert len(found["threads"]) > 3


@pytest.mark.parametrize("fate", ["", "os.kill(children()[0], 9)"])
def test_clusters_are_fitted_by_another_process_and_by_this_one_if_that_is_killed(fate):
    found = said(
        FITTING
        + f"""
with fitting(configuration) as fit:
    pids = children()
    less_urgent = min(os.getpriority(os.PRIO_PROCESS, 0) + 5, 19)
    while os.getpriority(os.PRIO_PROCESS, pids[0]) != less_urgent:
        time.sleep(0.01)
    {fate}
    found = fit(sample, configuration.clustering).centroids
here = "sklearn" in sys.modules
assert not children()
same = (found == fit_clusters(sample, configuration.clustering).centroids).all()
print(json.dumps([len(pids), here, bool(same)]))
"""
    )
    assert found == [1, bool(fate), True]


@pytest.mark.parametrize(
    ("settings", "thread"),
    [("execution.workers=1", False), ("clustering.scope=tile", False), ("", True)],
)
def test_clusters_are_fitted_here_where_no_process_is_forked_for_it(settings, thread):
    found = said(
        FITTING
        + f"""
wanted = [{settings!r}] if {settings!r} else []
configuration = load_configuration(None, ["execution.workers=2", "clustering.count=3", *wanted])
if {thread}:
    threading.Thread(target=time.sleep, args=(60,), daemon=True).start()
with fitting(configuration) as fit:
    print(json.dumps([len(children()), len(fit(sample, configuration.clustering).centroids)]))
"""
    )
    assert found == [0, 3]


def test_who_fits_ends_with_who_asked_for_it_however_that_ends(tmp_path):
    program = (
        FITTING
        + """
with fitting(configuration):
    print(children()[0], flush=True)
    time.sleep(60)
"""
    )
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE) as asking:
        fitter = Path("/proc") / asking.stdout.readline().decode().strip()
        assert fitter.exists()
        asking.send_signal(signal.SIGKILL)
    until = time.monotonic() + 60
    while fitter.exists() and "zombie" not in (fitter / "status").read_text():
        assert time.monotonic() < until
        time.sleep(0.05)


@pytest.mark.parametrize("before", ["", "import scipy.linalg; "])
def test_what_is_preloaded_has_compiled_code_but_no_linear_algebra(before):
    """numba imports it for one function, if it is there."""
    program = """
from dynahull.algorithm import clean
import numpy as np
clean(np.random.default_rng(0).uniform(size=(500, 3)))  # compiled from now on
"""
    subprocess.run([sys.executable, "-c", program], check=True, timeout=300)
    found = said(
        before
        + """
import json, sys
import pipeline.workers.preloaded
loaded = ["scipy.linalg" in sys.modules, "numba.np.arraymath" in sys.modules]
import scipy.linalg
print(json.dumps([*loaded, float(scipy.linalg.norm([3, 4]))]))
"""
    )
    assert found == [bool(before), True, 5.0]


def test_the_server_ends_with_its_workers_and_another_takes_its_place():
    found = said(
        PREAMBLE
        + """
from multiprocessing import forkserver
from pipeline.workers.executors import local_workers
from pipeline.work.folder import TaskReport

def done(folder, number):
    return TaskReport(number)

servers = []
for number in range(3):
    start_fork_server()
    servers.append(forkserver._forkserver._forkserver_pid)
    with local_workers(1, 3 << 30) as executor:
        assert [report.points for _, report in executor.run(done, "", [number])] == [number]
until = time.monotonic() + 60
while set(servers) & set(children()) and time.monotonic() < until:
    time.sleep(0.01)
print(json.dumps([len(set(servers)), len(set(servers) & set(children()))]))
"""
    )
    assert found == [3, 0]


@pytest.mark.parametrize("word", ["", "thread"])
def test_what_lies_in_the_current_folder_is_not_imported(word, tmp_path):
    hostile, installed = tmp_path / "hostile", tmp_path / "bin"
    hostile.mkdir()
    installed.mkdir()
    names = ("multiprocessing", "pipeline", "distributed", "dask", "numba", "socket", "pickle")
    for name in names:
        (hostile / f"{name}.py").write_text("open('imported', 'w').write(__name__)\n")
    program = """
import sys, threading, time
from pipeline.workers.executors import local_workers
from pipeline.work.folder import TaskReport
if __name__ == "__main__":
    if sys.argv[-1] == "thread":
        threading.Thread(target=time.sleep, args=(60,), daemon=True).start()
    with local_workers(1, 3 << 30) as executor:
        print(list(executor.run(TaskReport, "", [])))
        executor._started.result()
"""
    (installed / "program").write_text(program)  # as a command is, which has no -P
    subprocess.run(
        [sys.executable, installed / "program", word], cwd=hostile, check=True, timeout=300,
        env={name: value for name, value in os.environ.items() if name != "PYTHONSAFEPATH"},
    )  # fmt: skip
    assert not (hostile / "imported").exists()
