"""Runs on a real SLURM, started on this machine: workers and nodes are lost, the bytes are not."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from tests.pipeline.slurm_on_loopback import SlurmOnLoopback, wait_until, why_not

REASON = why_not()
pytestmark = pytest.mark.skipif(REASON is not None, reason=f"no SLURM: {REASON}")

SETTINGS = [
    "ground.method=none", "tiling.max_points=450", "output.labels=true",
    "cluster.interface=lo", "cluster.check_every=1", "cluster.workers=2", "cluster.memory=1GiB",
    "cluster.run.memory=1GiB",
]  # fmt: skip
RESULTS = ("static.npy", "dynamic.npy", "labels.parquet")
DONE_WITHIN = 120

SLOW = """
import time
from pipeline.tiles import stages

def dask_setup(worker):
    score_tile = stages.TASKS["density"]

    def score_tile_slowly(job, tile):
        time.sleep(2)
        return score_tile(job, tile)

    stages.TASKS["density"] = score_tile_slowly
"""
"""Loaded by workers: tasks take two seconds, so that there is something to be in the middle of."""


@pytest.fixture(scope="module")
def slurm():
    """Three nodes of one core: for two workers, and a spare one or the run itself."""
    with SlurmOnLoopback(cores=[1, 1, 1]) as slurm:
        yield slurm


@pytest.fixture(scope="module")
def map_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("map") / "map.npy"
    np.save(path, np.random.default_rng(0).uniform(size=(6_000, 3)) * [40, 30, 2])
    return path


@pytest.fixture(scope="module")
def slowly(tmp_path_factory):
    """The setting that makes workers slow."""
    path = tmp_path_factory.mktemp("slow") / "slow.py"
    path.write_text(SLOW, encoding="utf-8")
    preload = f"export DASK_DISTRIBUTED__WORKER__PRELOAD={path}"
    return f"cluster.prologue=[{preload}]"


@pytest.fixture(scope="module")
def expected(map_file):
    """What a run on this machine, in one process, leaves."""
    folder = map_file.parent / "local"
    code, _, errors = command(
        "run", map_file, "-o", folder, *settings(), "--set", "execution.cluster=none"
    )
    assert (code, errors) == (0, [])
    return results(folder)


def settings(*more):
    return [each for setting in (*SETTINGS, *more) for each in ("--set", setting)]


def results(folder):
    return {name: (folder / name).read_bytes() for name in RESULTS}


def arguments(*words):
    return [sys.executable, "-m", "pipeline", *map(str, words)]


def command(*words, slurm=None):
    """Run the command line: exit code, standard output, error lines."""
    environment = {**os.environ, **(slurm.environment if slurm else {})}
    done = subprocess.run(
        arguments(*words), env=environment, capture_output=True, text=True, timeout=DONE_WITHIN,
        check=False,
    )  # fmt: skip
    return done.returncode, done.stdout, [
        line for line in done.stderr.splitlines() if line.startswith("error: ")
    ]  # fmt: skip


def density_tasks_done(folder):
    """Return how many tasks of the density stage are done, -1 before it."""
    try:
        state = json.loads((folder / ".dynahull-work/state.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return -1
    return state["done_tasks"] if state["stage"] == "density" else -1


def alive(slurm, name):
    """Return the jobs of a name that run, and their nodes."""
    jobs = slurm.jobs()
    return {job: node for job, its, state, *node in jobs if (its, state) == (name, "RUNNING")}


class Watched:
    """A run in the background whose log is read meanwhile."""

    def __init__(self, slurm, folder, *words):
        self._log = folder.with_suffix(".log")
        with self._log.open("wb") as log:
            self._process = subprocess.Popen(
                arguments(*words), env={**os.environ, **slurm.environment}, stderr=log, stdout=log
            )

    def said(self):
        return self._log.read_text(encoding="utf-8")

    def goes_on(self):
        return self._process.poll() is None

    def code(self, seconds):
        return self._process.wait(seconds)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._process.kill()
        self._process.wait(10)


def test_a_run_goes_on_when_a_worker_and_nodes_and_all_of_them_are_lost(
    slurm, map_file, expected, slowly, tmp_path
):
    folder = tmp_path / "out"
    with Watched(
        slurm, folder, "run", map_file, "-o", folder, "--cluster", "slurm", *settings(slowly)
    ) as run:
        wait_until(lambda: density_tasks_done(folder) >= 1, 60)
        first = alive(slurm, "dynahull-worker")
        assert len(first) == 2

        victim = min(first)
        slurm.call("scancel", victim)
        wait_until(lambda: f"worker job {victim} is gone (" in run.said(), 30)
        wait_until(lambda: len(alive(slurm, "dynahull-worker").keys() - {victim}) == 2, 30)

        nodes = [node for (node,) in alive(slurm, "dynahull-worker").values()]
        slurm.lose(nodes[0])
        done = density_tasks_done(folder)
        wait_until(lambda: density_tasks_done(folder) > done, 30)  # by the other one

        for node in ("n0", "n1", "n2"):
            slurm.lose(node)
        wait_until(lambda: "waiting: no worker is there" in run.said().partition("density:")[2], 30)
        assert run.goes_on()
        assert 0 < density_tasks_done(folder) < 14
        for node in ("n0", "n1", "n2"):
            slurm.bring_up(node)
        assert run.code(DONE_WITHIN) == 0, run.said()
    assert results(folder) == expected
    wait_until(lambda: alive(slurm, "dynahull-worker") == {}, 30)
    assert not (folder / ".dynahull-cluster/workers.json").exists()


def test_a_submitted_run_is_followed_and_cancelled_by_its_folder_and_goes_on_when_submitted_again(
    slurm, map_file, expected, slowly, tmp_path
):
    folder = tmp_path / "out"
    submit = ("submit", map_file, "-o", folder, "--cluster", "slurm", *settings(slowly))
    code, said, errors = command(*submit, slurm=slurm)
    assert (code, errors) == (0, [])
    job = said.split()[3].rstrip(";")
    assert said.startswith(f"submitted: slurm job {job}; ")

    code, said, _ = command("status", folder, slurm=slurm)
    assert code == 0
    assert f"slurm job {job}: " in said.splitlines()[0]
    assert said.split()[4] in ("PENDING", "CONFIGURING", "RUNNING")
    code, _, errors = command(*submit, slurm=slurm)
    assert code == 1
    assert f"slurm job {job} is there for this folder" in errors[0]
    assert "cancel it first" in errors[0]

    wait_until(lambda: density_tasks_done(folder) >= 1, 60)
    _, said, _ = command("status", folder, slurm=slurm)
    assert said.splitlines()[0].endswith(f"slurm job {job}: RUNNING")
    assert said.splitlines()[1].endswith("slurm jobs of workers: 2 RUNNING")
    code, said, errors = command("cancel", folder, slurm=slurm)
    assert (code, errors) == (0, [])
    assert said.startswith(f"cancelled: job {job}")
    left = {state for _, _, state, *_ in slurm.jobs()}
    assert left <= {"COMPLETING"}  # the workers too
    code, _, errors = command("cancel", folder, slurm=slurm)
    assert code == 1
    assert "nothing to cancel" in errors[0]
    _, said, _ = command("status", folder, slurm=slurm)
    assert said.splitlines()[0].endswith(f"slurm job {job}: CANCELLED")
    assert "not running" in said
    done = set((folder / ".dynahull-work/density").glob("*.done"))
    assert done
    before = {path: path.stat().st_mtime_ns for path in done}

    again = ("cluster.lifetime=12s", "cluster.lifetime_stagger=3s", "output.keep_work=true")
    code, said, errors = command(*submit, "--tls", *settings(*again), slurm=slurm)
    assert (code, errors) == (0, [])
    wait_until((folder / "run.json").exists, DONE_WITHIN)
    assert results(folder) == expected
    assert {path: path.stat().st_mtime_ns for path in done} == before  # not done a second time
    wait_until(lambda: slurm.jobs() == [], 30)
    _, said, _ = command("status", folder, slurm=slurm)
    assert said.splitlines()[0].endswith(": COMPLETED")
    log = max((folder / ".dynahull-cluster/logs").glob("dynahull-[0-9]*.err")).read_text("utf-8")
    assert "is gone (" in log  # of old age
    keys = list((folder / ".dynahull-cluster").glob(".dask-jobqueue.worker.key*"))
    assert keys == []


def test_what_the_batch_system_refuses_is_told_in_its_words(slurm, map_file, tmp_path):
    words = [map_file, "-o", tmp_path / "out", "--cluster", "slurm"]
    wrong = settings("cluster.queue=nowhere")
    for verb in ("run", "submit"):
        code, _, errors = command(verb, *words, *wrong, slurm=slurm)
        assert code == 1
        assert len(errors) == 1
        assert "error: sbatch: " in errors[0]
        assert "nvalid partition" in errors[0]
    assert slurm.jobs() == []


def test_jobs_that_end_before_their_worker_comes_are_not_started_for_ever(
    slurm, map_file, tmp_path
):
    code, _, errors = command(
        "run", map_file, "-o", tmp_path / "out", "--cluster", "slurm", *settings(
            "cluster.python=/no/such/python", "cluster.workers=1"
        ), slurm=slurm,
    )  # fmt: skip
    assert code == 1
    assert len(errors) == 1
    assert "3 jobs in a row ended before their workers were there: " in errors[0]
    assert "/no/such/python" in errors[0]
    assert "No such file or directory" in errors[0]
    wait_until(lambda: slurm.jobs() == [], 30)
