"""Runs on a real SLURM, started on this machine: workers and nodes are lost, the bytes are not."""

import os
import shlex
import subprocess
import sys
import time

import laspy
import numpy as np
import pytest
import yaml

from pipeline.configuration.run import configurations_folder, load_configuration
from tests.pipeline.slurm_on_loopback import SlurmOnLoopback, wait_until, why_not
from tests.test_documentation import BLOCKS

REASON = why_not()
pytestmark = [
    pytest.mark.linux_only,
    pytest.mark.skipif(REASON is not None, reason=f"no SLURM: {REASON}"),
]

SETTINGS = [
    "ground.method=none", "tiling.max_points=450", "output.labels=true",
    "cluster.interface=lo", "cluster.check_every=1", "cluster.silence=10",
    "cluster.workers=2", "cluster.memory=1GiB",
    "cluster.run.memory=1GiB",
]  # fmt: skip
RESULTS = ("static.npy", "dynamic.npy", "labels.parquet")
DONE_WITHIN = 120

GATE = """
import time
from pathlib import Path
from distributed.core import Status
from pipeline.tiles import stages

def dask_setup(worker):
    score_tile, gate = stages.TASKS["density"], Path({gate!r})

    def may_pass():
        for ticket in gate.glob("ticket-*"):
            try:
                ticket.unlink()
            except FileNotFoundError:  # taken by another one
                continue
            return True
        return (gate / "open").exists()

    def score_tile_when_let(job, tile):
        while worker.status == Status.running and not may_pass():
            time.sleep(0.05)
        return score_tile(job, tile)

    stages.TASKS["density"] = score_tile_when_let
"""
"""Loaded by workers: they wait in the middle of their work until they are let on, or must leave."""


class Gate:
    """What workers wait at.

    Parameters
    ----------
    folder : Path
    """

    def __init__(self, folder):
        self._folder = folder
        folder.mkdir()
        preload = folder / "gate.py"
        preload.write_text(GATE.format(gate=str(folder)), encoding="utf-8")
        self.setting = f"cluster.prologue=[export DASK_DISTRIBUTED__WORKER__PRELOAD={preload}]"

    def let_one_pass(self):
        """Let one task be done."""
        (self._folder / f"ticket-{time.monotonic_ns()}").touch()

    def open(self):
        """Hold nobody any more."""
        (self._folder / "open").touch()

    def close(self):
        """Hold everybody again."""
        (self._folder / "open").unlink()


@pytest.fixture
def gate(tmp_path):
    return Gate(tmp_path / "gate")


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


def command(*words, slurm=None, folder=None):
    """Run the command line: exit code, standard output, error lines."""
    environment = {**os.environ, **(slurm.environment if slurm else {})}
    done = subprocess.run(
        arguments(*words), env=environment, capture_output=True, text=True, timeout=DONE_WITHIN,
        check=False, cwd=folder,
    )  # fmt: skip
    return done.returncode, done.stdout, [
        line for line in done.stderr.splitlines() if line.startswith("error: ")
    ]  # fmt: skip


def density_tasks_done(folder):
    """Return how many tasks of the density stage are done, by their markers."""
    return len(list((folder / ".dynahull-work/density").glob("*.done")))


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
    slurm, map_file, expected, gate, tmp_path
):
    folder = tmp_path / "out"
    with Watched(
        slurm, folder, "run", map_file, "-o", folder, "--cluster", "slurm", *settings(gate.setting)
    ) as run:
        gate.let_one_pass()
        wait_until(lambda: density_tasks_done(folder) >= 1, DONE_WITHIN)
        wait_until(lambda: len(alive(slurm, "dynahull-worker")) == 2, DONE_WITHIN)

        victim = min(alive(slurm, "dynahull-worker"))
        slurm.call("scancel", victim)
        wait_until(lambda: f"worker job {victim} is gone (" in run.said(), DONE_WITHIN)
        wait_until(lambda: len(alive(slurm, "dynahull-worker").keys() - {victim}) == 2, DONE_WITHIN)

        nodes = [node for (node,) in alive(slurm, "dynahull-worker").values()]
        slurm.lose(nodes[0])
        done = density_tasks_done(folder)
        gate.let_one_pass()
        wait_until(lambda: density_tasks_done(folder) > done, DONE_WITHIN)  # by the other one

        for node in ("n0", "n1", "n2"):
            slurm.lose(node)
        wait_until(
            lambda: "waiting: no worker is there" in run.said().partition("density:")[2],
            DONE_WITHIN,
        )
        assert run.goes_on()
        assert 0 < density_tasks_done(folder) < 14
        gate.open()
        for node in ("n0", "n1", "n2"):
            slurm.bring_up(node)
        assert run.code(DONE_WITHIN) == 0, run.said()
    assert results(folder) == expected
    wait_until(lambda: alive(slurm, "dynahull-worker") == {}, DONE_WITHIN)
    assert not (folder / ".dynahull-cluster/workers.json").exists()


def test_a_submitted_run_is_followed_and_cancelled_by_its_folder_and_goes_on_when_submitted_again(
    slurm, map_file, expected, gate, tmp_path
):
    folder = tmp_path / "out"
    submit = ("submit", map_file, "-o", folder, "--cluster", "slurm", *settings(gate.setting))
    begun = time.monotonic()
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

    gate.let_one_pass()
    wait_until(lambda: density_tasks_done(folder) >= 1, DONE_WITHIN)
    to_begin = time.monotonic() - begun
    wait_until(lambda: len(alive(slurm, "dynahull-worker")) == 2, DONE_WITHIN)
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

    # Long enough for a worker to begin in, on this machine as it is now.
    lifetime = max(12, round(2 * to_begin))
    again = (
        f"cluster.lifetime={lifetime}s", "cluster.lifetime_stagger=3s", "output.keep_work=true"
    )  # fmt: skip
    code, said, errors = command(*submit, "--tls", *settings(*again), slurm=slurm)
    assert (code, errors) == (0, [])
    log = folder / f".dynahull-cluster/logs/dynahull-{said.split()[3].rstrip(';')}.err"
    wait_until(lambda: log.exists() and "is gone (" in log.read_text("utf-8"), 2 * DONE_WITHIN)
    gate.open()  # one left of old age
    wait_until((folder / "run.json").exists, DONE_WITHIN)
    assert results(folder) == expected
    assert {path: path.stat().st_mtime_ns for path in done} == before  # not done a second time
    wait_until(lambda: slurm.jobs() == [], DONE_WITHIN)
    _, said, _ = command("status", folder, slurm=slurm)
    assert said.splitlines()[0].endswith(": COMPLETED")
    keys = list((folder / ".dynahull-cluster").glob("tls-*"))
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
    wait_until(lambda: slurm.jobs() == [], DONE_WITHIN)


@pytest.fixture
def as_on_the_page(map_file, gate, tmp_path):
    """A folder with the map and the configuration that docs/cluster.md speaks of."""
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.scales = np.full(3, 0.001)
    las = laspy.LasData(header)
    las.xyz = np.load(map_file)
    las.write(tmp_path / "big_map.laz")
    ready = yaml.safe_load((configurations_folder() / "slurm.yaml").read_text(encoding="utf-8"))
    small = load_configuration(None, [*SETTINGS, gate.setting]).model_dump(
        mode="json", exclude_unset=True
    )
    cluster = ready["cluster"] | small["cluster"]
    mine = {**small, "execution": ready["execution"], "cluster": cluster}
    (tmp_path / "my-cluster.yaml").write_text(yaml.safe_dump(mine), encoding="utf-8")
    return tmp_path


def test_the_commands_of_the_page_do_what_it_says(slurm, gate, as_on_the_page):
    lines = [
        line
        for block in BLOCKS
        if block.page.name == "cluster.md" and "test_slurm.py" in (block.reason or "")
        for line in block.commands
    ]
    verbs = [line.split()[1] for line in lines]
    assert verbs == ["run", "submit", "status", "cancel", "run"]
    said = {}
    gate.open()
    for line, verb in zip(lines, verbs, strict=True):
        code, said[verb], errors = command(
            *shlex.split(line, comments=True)[1:], slurm=slurm, folder=as_on_the_page
        )
        assert (code, errors) == (0, []), line
        if verb == "run":  # what is submitted shall not be over before it is cancelled
            gate.close()
            said.clear()
        if verb == "cancel":
            assert said["submit"].startswith("submitted: slurm job ")
            assert "slurm job " in said["status"]
            assert said["cancel"].startswith("cancelled: job ")
            wait_until(lambda: slurm.jobs() == [], DONE_WITHIN)
            gate.open()
    assert (as_on_the_page / "big_map_dynahull" / "run.json").is_file()


def test_a_night_is_spent_on_the_cluster(slurm, map_file, expected, tmp_path):
    chosen = [*SETTINGS, "execution.cluster=slurm"]
    file = {
        "inputs": [{"maps": str(map_file), "settings": chosen}],
        "output": "cleaned", "settle": "1 s", "wait": "1 min",
    }  # fmt: skip
    (tmp_path / "nightly.yaml").write_text(yaml.safe_dump(file), encoding="utf-8")
    code, _, errors = command("nightly", tmp_path / "nightly.yaml", slurm=slurm)
    assert (code, errors) == (0, [])
    (latest,) = (tmp_path / "cleaned").glob("map-*/latest")
    assert results(latest) == expected
    assert list((latest / ".dynahull-cluster/logs").iterdir()), "there were jobs"
    wait_until(lambda: slurm.jobs() == [], DONE_WITHIN)
