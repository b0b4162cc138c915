"""Executors: few tasks in flight, none kept, and every failure told with its reason."""

import asyncio
import gc
import os
import pickle
import sys
import threading
import time
from pathlib import Path

import cloudpickle
import numpy as np
import pytest
from distributed import Client, LocalCluster, Worker

from pipeline.configuration.run import load_configuration
from pipeline.errors import TasksFailedError
from pipeline.plan.resources import worker_memory_limit
from pipeline.progress import LogDisplay, StageObserver
from pipeline.run import run
from pipeline.tiles import stages
from pipeline.work.folder import TaskReport
from pipeline.workers import executors as execution
from pipeline.workers import local_dask
from pipeline.workers.executors import RETRIES, InProcess, OnDask, TaskFailure
from pipeline.workers.local_dask import local_workers

# Workers cannot import the tests: what these hand them is sent whole.
cloudpickle.register_pickle_by_value(sys.modules[__name__])


pytestmark = pytest.mark.usefixtures("nothing_waits_for_the_disk")


def answer(folder, number):
    return TaskReport(points=number, counts=(len(folder),))


def faulty(folder, number):
    """Fail in one way or another; every call leaves a trace in the folder."""
    with (Path(folder) / f"{number}.calls").open("a", encoding="ascii") as trace:
        trace.write("x")
    if number == 1:
        raise ValueError("two\nlines")
    if number == 2:
        raise OSError(5, "Input/output error", "tile.npz")
    if number == 3 and len((Path(folder) / "3.calls").read_text(encoding="ascii")) <= RETRIES:
        raise OSError(116, "Stale file handle")
    if number == 4:
        raise KeyError
    return TaskReport(number)


def dying(folder, number):
    if number == 1:
        os._exit(9)
    return answer(folder, number)


def meeting(folder, number):
    execution.MEETING.wait()  # of the test, whose process the workers share
    return answer(folder, number)


def threads_allowed(folder, number):
    return TaskReport(int(os.environ["RAYON_NUM_THREADS"]))


@pytest.fixture(scope="module")
def client():
    """Two workers in this process."""
    with (
        LocalCluster(
            n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None,
            scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},
        ) as cluster,
        Client(cluster, set_as_default=False) as client,
    ):  # fmt: skip
        yield client


@pytest.fixture(params=["in process", "dask"])
def executor(request):
    return (
        InProcess() if request.param == "in process" else OnDask(request.getfixturevalue("client"))
    )


def test_every_number_is_answered_once(executor):
    found = dict(executor.run(answer, "abc", iter(range(30))))
    assert found == {number: TaskReport(number, (3,)) for number in range(30)}
    assert list(executor.run(answer, "abc", [])) == []


def test_failures_are_told_in_one_line_and_stop_no_other_task(executor, tmp_path):
    found = dict(executor.run(faulty, str(tmp_path), range(6)))
    assert sorted(found) == list(range(6))
    assert found[0] == TaskReport(0)
    assert found[1] == TaskFailure("two lines")
    assert found[2] == TaskFailure("[Errno 5] Input/output error: 'tile.npz'")
    assert found[4] == TaskFailure("KeyError")
    assert found[5] == TaskReport(5)


def test_faults_of_the_file_system_are_tried_again_and_others_are_not(executor, tmp_path):
    found = dict(executor.run(faulty, str(tmp_path), range(6)))
    calls = [len((tmp_path / f"{number}.calls").read_bytes()) for number in range(6)]
    assert calls == [1, 1, 1 + RETRIES, 1 + RETRIES, 1, 1]
    assert found[3] == TaskReport(3)  # the last try went well


def test_starting_workers_leaves_this_process_its_threads(monkeypatch):
    names = ("OMP_NUM_THREADS", "RAYON_NUM_THREADS")
    for name in names:
        monkeypatch.setenv(name, "7")
    with local_workers(1, 1 << 30) as executor:
        assert dict(executor.run(answer, "abc", [0])) == {0: TaskReport(0, (3,))}
        assert {name: os.environ[name] for name in names} == dict.fromkeys(names, "7")
        here = dict(executor.run(threads_allowed, "", [0]))
    assert here == {0: TaskReport(1)}


def test_nothing_is_kept_of_tasks_that_are_done():
    def lengths():
        gc.collect()
        kinds = (list, set, dict)
        # They are held, lest another object gets the number of one that is gone.
        return [(each, len(each)) for each in gc.get_objects() if isinstance(each, kinds)]

    with local_workers(1, 1 << 30) as executor:
        for done, _ in enumerate(executor.run(answer, "", range(350)), 1):
            if done == 50:
                before = lengths()
            if done == 349:
                grown = [len(each) - length for each, length in before]
    assert done == 350
    assert [growth for growth in grown if growth >= 250] == []


class TestSlidingWindow:
    def test_numbers_are_taken_as_they_are_needed(self, client):
        taken = 0

        def numbers():
            nonlocal taken
            for number in range(5_000):
                taken += 1
                yield number

        outcomes = OnDask(client).run(answer, "abc", numbers())
        for done in range(1, 101):
            next(outcomes)
            assert taken <= done + 2
        outcomes.close()
        assert taken < 110

    def test_there_are_never_more_tasks_than_workers_and_none_is_kept(self, client):
        executor = OnDask(client)
        assert executor.workers == 2
        held, on_scheduler = [], []
        for _ in executor.run(answer, "abc", range(300)):
            client.sync(asyncio.sleep, 0)  # until its thread has let go what it was told to
            held.append(len(client.futures))
            on_scheduler.append(len(client.cluster.scheduler.tasks))
        # Those just yielded are let go when the next is asked for, by another thread.
        assert max(held) <= 2 + 3
        assert held[100] > 1
        # The client and the scheduler hear of it a little later.
        assert max(on_scheduler) < 40
        deadline = time.monotonic() + 20
        while client.futures or client.cluster.scheduler.tasks:
            assert time.monotonic() < deadline
            time.sleep(0.01)

    def test_both_workers_work_at_a_time(self, client, monkeypatch):
        barrier = threading.Barrier(2, timeout=20)
        monkeypatch.setattr(execution, "MEETING", barrier, raising=False)
        # Each waits for another: so two run at any time, or the barrier breaks.
        found = dict(OnDask(client).run(meeting, "abc", range(6)))
        assert found == {number: answer("abc", number) for number in range(6)}

    def test_the_window_grows_when_workers_come(self, client, monkeypatch):
        monkeypatch.setattr(execution, "_COUNT_EVERY", 0.0)
        monkeypatch.setattr(OnDask, "workers", property(lambda self: self.count), raising=True)
        executor = OnDask(client)
        executor.count = 1
        taken = []
        outcomes = executor.run(answer, "abc", (taken.append(n) or n for n in range(500)))
        next(outcomes)
        assert len(taken) <= 1 + 1
        executor.count = 10
        for done in range(2, 6):
            next(outcomes)
            assert done < len(taken) <= done + 10
        assert len(taken) > 10
        outcomes.close()


def test_reports_are_small():
    largest = TaskReport(10**9, tuple([10**9] * 100), 1234.567)
    assert len(pickle.dumps(largest)) < 1_000
    assert len(pickle.dumps(TaskFailure("a reason of some length " * 10))) < 1_000


def surroundings(folder, number):
    """Report the limits and threads of the process that this runs in."""
    import numba  # noqa: PLC0415
    import scipy.linalg  # noqa: F401, PLC0415
    from distributed import get_worker  # noqa: PLC0415
    from threadpoolctl import threadpool_info  # noqa: PLC0415

    worker: Worker = get_worker()
    threads = [pool["num_threads"] for pool in threadpool_info()]
    limit = worker.memory_manager.memory_limit
    return TaskReport(os.getpid(), (worker.state.nthreads, numba.config.NUMBA_NUM_THREADS, limit,
                                    *threads))  # fmt: skip


def preloaded(folder, number):
    """Tell whether this process was forked from one that had imported all."""
    return TaskReport(int("pipeline.workers.preloaded" in sys.modules))


def test_workers_of_this_machine_are_processes_of_one_thread_with_a_limit_and_a_death_is_told(
    monkeypatch,
):
    # A task is tried on three more workers otherwise, each of which takes seconds to start.
    settings = {**local_dask._SETTINGS, "distributed.scheduler.allowed-failures": 0}
    monkeypatch.setattr(local_dask, "_SETTINGS", settings)
    with local_workers(1, 3 << 30) as executor:
        assert executor.workers == 1
        ((_, report),) = executor.run(surroundings, "", [0])
        assert report.points != os.getpid()
        assert report.counts[2] == 3 << 30
        assert set(report.counts[:2] + report.counts[3:]) == {1}
        assert len(report.counts) > 3
        assert dict(executor.run(preloaded, "", [0]))[0].points == 1

        begun = time.monotonic()
        found = dict(executor.run(dying, "abc", range(4)))
        assert time.monotonic() - begun < 60
        assert isinstance(found[1], TaskFailure)
        assert "its workers died" in found[1].reason
        # The one that waited behind it may have gone down with it; the others are done.
        assert sum(isinstance(outcome, TaskReport) for outcome in found.values()) >= 2


def test_memory_of_a_worker_is_as_configured_or_its_share_of_what_is_free():
    assert worker_memory_limit(load_configuration(None, ["execution.memory=1.5GiB"]), 4) == 3 << 29
    shares = [worker_memory_limit(load_configuration(None), workers) for workers in (1, 4)]
    assert shares[0] == pytest.approx(4 * shares[1], rel=0.2)


class LargeReports:
    """A task whose report is what it says, for the size of real reports."""

    def __init__(self):
        self.sizes = []
        self._do_task = stages.do_task

    def __call__(self, stage, folder, number):
        report = self._do_task(stage, folder, number)
        self.sizes.append(len(pickle.dumps(report)))
        return report


def test_a_run_on_a_scheduler_that_is_running_says_the_same(client, tmp_path, monkeypatch):
    np.save(tmp_path / "map.npy", np.random.default_rng(0).uniform(size=(600, 3)) * [8, 6, 2])
    wanted = ["ground.method=none", "neighbours.k=8", "tiling.max_points=100", "output.labels=true"]
    reports = LargeReports()
    monkeypatch.setattr(stages, "do_task", reports)
    cleaned(tmp_path, "one", *wanted, "execution.cluster=none")
    assert max(reports.sizes) < 1_000
    monkeypatch.undo()
    cleaned(tmp_path, "many", *wanted, f"execution.scheduler={client.scheduler.address}")
    for name in ("static.npy", "dynamic.npy", "labels.parquet"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "many" / name).read_bytes()


def test_a_run_on_dask_names_the_tile_that_failed_and_goes_on(client, tmp_path, monkeypatch):
    np.save(tmp_path / "map.npy", np.random.default_rng(0).uniform(size=(600, 3)) * [8, 6, 2])
    wanted = [
        "ground.method=none",
        "neighbours.k=8",
        "tiling.max_points=100",
        f"execution.scheduler={client.scheduler.address}",
    ]
    score = stages.TASKS["density"]
    tries = []

    def out_of_luck(job, tile):
        if tile == 2:
            tries.append(tile)
            raise OSError(28, "No space left on device")
        return score(job, tile)

    # The workers are threads of this process: they see the same table of tasks.
    with monkeypatch.context() as patch:
        patch.setitem(stages.TASKS, "density", out_of_luck)
        with pytest.raises(TasksFailedError, match=r"density failed \(2: .*No space left"):
            cleaned(tmp_path, "out", *wanted)
    assert len(tries) == 1 + RETRIES
    done = sorted(path.stem for path in (tmp_path / "out/.dynahull-work/density").glob("*.done"))
    assert len(done) > 4
    assert "000002" not in done
    assert cleaned(tmp_path, "out", *wanted).points == 600


def test_workers_elsewhere_are_given_a_folder_that_does_not_depend_on_where_they_are(
    tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    np.save("map.npy", np.random.default_rng(0).uniform(size=(300, 3)))
    folders = set()
    do_task = stages.do_task

    def spy(stage, folder, number):
        folders.add(folder)
        return do_task(stage, folder, number)

    monkeypatch.setattr(stages, "do_task", spy)
    settings = ["ground.method=none", "tiling.max_points=100", "execution.cluster=none"]
    cleaned(Path(), "out", *settings)
    assert folders == {str(tmp_path.resolve() / "out/.dynahull-work")}


def cleaned(folder, name, *wanted):
    configuration = load_configuration("paper", wanted)
    return run([folder / "map.npy"], folder / name, configuration, StageObserver(LogDisplay()))
