"""Keeps as many workers as were asked for, however often their jobs are lost.

dask-jobqueue starts jobs and ends them; what became of them it does not ask. A job that is
cancelled or preempted, whose node fails or whose time is over is replaced here; while no worker is
there, the run waits, and says so.
"""

import logging
from collections.abc import Mapping
from pathlib import Path
from threading import Event, Thread
from time import monotonic
from typing import Any

from distributed import Future
from distributed.core import Status

from pipeline.cluster.batch_systems import BatchSystem, JobState, Phase, count_words
from pipeline.cluster.record import logs_folder, record_workers
from pipeline.configuration.cluster import ClusterParameters
from pipeline.errors import ClusterError

logger = logging.getLogger("dynahull")

_LOOK_EVERY = 2.0
"""Seconds between two looks at who is there, which costs nothing."""

_SAY_EVERY = 60.0
"""Seconds between two lines that say that no worker is there."""

_FAILED_STARTS = 3
"""Times that every job in turn may end before a worker came from it."""


class Supervisor:
    """Watches over the jobs of a cluster's workers, in a thread of its own.

    The cluster, of dask_jobqueue, has no workers yet. The numbers of the jobs are kept in the
    output folder.
    """

    def __init__(
        self,
        cluster: Any,
        client: Any,
        system: BatchSystem,
        parameters: ClusterParameters,
        output: Path,
    ) -> None:
        self._cluster, self._client, self._system = cluster, client, system
        self._parameters, self._output = parameters, output
        self._jobs_wanted = -(-parameters.workers // parameters.workers_per_job)
        self._last_seen: dict[str, float] = {}
        self._recorded: set[str] = set()
        self._failed_starts = 0
        self._refusal: str | None = None
        self._trouble: str | None = None
        self._asked = self._said = -max(_SAY_EVERY, parameters.check_every)
        self._nobody = True
        self._states: Mapping[str, JobState] = {}
        self._ended = Event()
        self._thread = Thread(target=self._watch, name="supervisor", daemon=True)

    def begin(self) -> None:
        """Submit the jobs, and wait for the first worker; raise a `ClusterError` if none comes."""
        self._fill_up()
        self._thread.start()
        while self._nobody:
            self.check()
            self._ended.wait(0.1)

    def end(self) -> None:
        """Stop watching; the jobs end with the cluster."""
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join()

    def check(self) -> None:
        """Raise a `ClusterError` when there is no hope for workers any more."""
        if self._trouble is not None:
            raise ClusterError(self._trouble)

    def refused(self, event: tuple[float, str]) -> None:
        """Hear of a worker that left at once, and why."""
        _, self._refusal = event
        logger.warning("a worker was refused: %s", self._refusal)

    def _watch(self) -> None:
        while not self._ended.wait(_LOOK_EVERY if not self._nobody else _LOOK_EVERY / 4):
            try:
                self._look()
            except (ClusterError, OSError, RuntimeError) as error:
                logger.warning("%s; trying again", " ".join(str(error).split()))
            if self._trouble is not None:
                self._let_go()
                return

    def _look(self) -> None:
        present = self._present()
        now = monotonic()
        jobs = {name: job.job_id for name, job in self._cluster.workers.items()}
        for name in jobs.keys() & present:
            self._last_seen[jobs[name]] = now
            self._failed_starts = 0
        absent = {name: job for name, job in jobs.items() if name not in present and job}
        if absent and now - self._asked >= self._parameters.check_every:
            self._asked = now
            self._states = self._system.states(list(absent.values()))
            self._give_up([name for name, job in absent.items() if self._is_lost(job, now)])
        self._say(len(present), now)
        if self._trouble is None and len(self._cluster.workers) < self._jobs_wanted:
            self._fill_up()

    def _present(self) -> set[str]:
        """Return the jobs of which a worker is there."""
        names = {
            str(worker["name"])
            for worker in self._client.scheduler_info(n_workers=-1)["workers"].values()
        }
        # The workers of a job of several have a number behind its name.
        several = self._parameters.workers_per_job > 1
        return {name.rpartition("-")[0] for name in names} if several else names

    def _is_lost(self, job: str, now: float) -> bool:
        state = self._states[job]
        if job not in self._last_seen:
            return not state.alive
        # One that waits again was preempted, or its node failed: a new one waits no longer.
        silence = now - self._last_seen[job]
        return state.phase is not Phase.RUNNING or silence > self._parameters.silence

    def _give_up(self, names: list[str]) -> None:
        """Forget jobs that are lost; others will take their places."""
        for name in names:
            job = self._cluster.workers[name].job_id
            state = self._states[job].word
            if job in self._last_seen:
                logger.warning("worker job %s is gone (%s); starting another", job, state)
            else:
                self._failed_starts += 1
                logger.warning("job %s ended before its worker was there (%s)", job, state)
        if self._failed_starts >= _FAILED_STARTS * self._jobs_wanted:
            reason = self._refusal or _last_words(self._output)
            ended = f"{self._failed_starts} jobs in a row ended before their workers were there"
            self._trouble = f"{ended}: {reason}"
        self._remove(names)

    def _remove(self, names: list[str]) -> None:
        """Cancel jobs, and expect no more of them."""
        for name in names:
            # The cluster asks this of every job it ever made, when it closes.
            self._cluster.workers[name].status = Status.closed
        if names:
            self._cluster.sync(self._cluster.scale_down, names)

    def _fill_up(self) -> None:
        """Submit the jobs that are missing."""
        try:
            while len(self._cluster.worker_spec) < self._jobs_wanted:
                self._cluster.worker_spec.update(self._cluster.new_worker_spec())
            self._cluster.sync(self._submitted)
        except (OSError, RuntimeError, ValueError) as error:
            # Those that could not be submitted are no jobs.
            unborn = [name for name, job in self._cluster.workers.items() if not job.job_id]
            self._remove(unborn)
            # Of dask-jobqueue's account what the command said.
            said = str(error).rpartition("stderr:")[2].strip() or error
            raise ClusterError(f"{self._system.submit[0]}: {said}") from None
        finally:
            self._record()

    async def _submitted(self) -> None:
        await self._cluster

    def _record(self) -> None:
        jobs = {job.job_id for job in self._cluster.workers.values() if job.job_id}
        if jobs != self._recorded:
            self._recorded = jobs
            record_workers(self._output, self._system.name, sorted(jobs))

    def _say(self, present: int, now: float) -> None:
        """Tell when nobody is there, now and then, and when somebody is again."""
        if present:
            if self._nobody:
                logger.info("workers are there, of %d of %d jobs", present, self._jobs_wanted)
            self._nobody, self._said = False, -_SAY_EVERY
            return
        self._nobody = True
        if now - self._said >= _SAY_EVERY:
            self._said = now
            known = count_words(self._states.values())
            logger.warning("waiting: no worker is there (jobs of %s: %s)", self._system.name, known)

    def _let_go(self) -> None:
        """End what the run waits for: nobody is going to do it."""
        self._client.cancel([Future(key, self._client) for key in list(self._client.futures)])


def _last_words(output: Path) -> str:
    """Return the last line of the newest log of a job, and where it is."""
    folder = logs_folder(output)
    logs = sorted(folder.glob("*"), key=lambda path: path.stat().st_mtime)
    for log in reversed(logs):
        if said := log.read_text(encoding="utf-8", errors="replace").strip():
            return f"{log} ends with {said.splitlines()[-1].strip()!r}"
    return f"they left no word in {folder}"
