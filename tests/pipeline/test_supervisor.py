"""Which worker's job is given up, and when: without a batch system, in no time."""

from types import SimpleNamespace

import pytest

from pipeline.cluster import supervisor
from pipeline.cluster.batch_systems import JobState, Phase
from pipeline.cluster.supervisor import Supervisor
from pipeline.configuration.run import load_configuration


class Watch:
    """A supervisor of two jobs, whose workers come and go as the test says."""

    def __init__(self, folder, monkeypatch, *settings):
        self.now, self.there = 1_000.0, {"first", "second"}
        self.phase = Phase.RUNNING
        self.removed = []
        monkeypatch.setattr(supervisor, "monotonic", lambda: self.now)
        parameters = load_configuration(
            None, ["cluster.workers=2", "cluster.check_every=1", *settings]
        ).cluster
        jobs = {name: SimpleNamespace(job_id=name[0], status=None) for name in self.there}
        cluster = SimpleNamespace(
            workers=jobs, scale_down=None, sync=lambda _, names: self.removed.extend(names)
        )
        client = SimpleNamespace(scheduler_info=lambda n_workers: {"workers": self.workers()})
        system = SimpleNamespace(name="slurm", states=self.states)
        self.supervisor = Supervisor(cluster, client, system, parameters, folder)

    def workers(self):
        return {name: {"name": name} for name in self.there}

    def states(self, jobs):
        return {job: JobState(self.phase.name, self.phase) for job in jobs}

    def look_after(self, seconds):
        """Return the jobs that are given up."""
        self.now += seconds
        self.removed.clear()
        self.supervisor._look()
        return self.removed


@pytest.mark.parametrize("silence", [30, 300])
def test_a_job_that_is_said_to_run_is_given_up_after_its_silence(tmp_path, monkeypatch, silence):
    watch = Watch(tmp_path, monkeypatch, f"cluster.silence={silence}s")
    assert watch.look_after(0) == []
    watch.there.remove("second")
    assert watch.look_after(silence - 1) == []
    assert watch.look_after(2) == ["second"]


def test_a_worker_that_comes_back_keeps_its_job(tmp_path, monkeypatch):
    watch = Watch(tmp_path, monkeypatch)
    watch.look_after(0)
    watch.there.remove("second")
    assert watch.look_after(29) == []
    watch.there.add("second")
    assert watch.look_after(29) == []
    watch.there.remove("second")
    assert watch.look_after(29) == []


def test_a_job_that_waits_again_or_has_ended_is_given_up_at_once(tmp_path, monkeypatch):
    watch = Watch(tmp_path, monkeypatch)
    watch.look_after(0)
    watch.there.remove("second")
    watch.phase = Phase.WAITING
    assert watch.look_after(2) == ["second"]
