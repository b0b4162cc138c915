"""SLURM, PBS, LSF, SGE and HTCondor by name: headers of job scripts, and their commands.

Headers, and the jobs of workers, are dask-jobqueue's; what it does not do is here: a job that is
not a worker's, and the state of a job.
"""

import logging
import re
import shlex
import shutil
import subprocess
from collections import Counter
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import IO, Any, ClassVar

from dynahull.extras import install_command
from pipeline.configuration.cluster import ClusterParameters
from pipeline.configuration.quantities import clock
from pipeline.errors import ClusterError, MissingPackageError

_PATIENCE = 60
"""Seconds that a command of a batch system may take."""


class Phase(Enum):
    """Where in its life a job is."""

    WAITING = "waiting"
    RUNNING = "running"
    ENDED = "ended"


@dataclass(frozen=True, slots=True)
class JobState:
    """What a batch system says of a job."""

    word: str
    """Its own word for it."""
    phase: Phase
    """What that means."""

    @property
    def alive(self) -> bool:
        """Whether the job waits or runs."""
        return self.phase is not Phase.ENDED


def count_words(states: Iterable[JobState]) -> str:
    """Say how many jobs are in which state, by the batch system's words."""
    words = Counter(state.word for state in states)
    return ", ".join(f"{count} {word}" for word, count in sorted(words.items()))


@dataclass(frozen=True, slots=True)
class JobDescription:
    """What a job asks for, in terms that all batch systems have."""

    name: str
    cores: int
    memory: int
    walltime: int
    queue: str | None
    resource_spec: str | None
    logs: Path
    prologue: Sequence[str]


class BatchSystem:
    """A batch system; subclasses say what is its own."""

    name: str
    """As in the configuration."""
    cluster_class: str
    submit: tuple[str, ...]
    cancel: tuple[str, ...]
    """Commands that are followed by the script, and by the number of a job."""
    reads_standard_input = False
    account = "account"
    """What dask-jobqueue calls who pays."""
    takes_resources = False
    number = r"(\d+)"
    script_suffix = ".sh"
    waiting: Container[str] = ()
    ended: Container[str] = ()
    """Its words for jobs that wait, and that have ended; all others run."""

    def require(self) -> None:
        """Raise a `ClusterError` where its commands are not there."""
        if shutil.which(self.submit[0]) is None:
            raise ClusterError(
                f"{self.name}: the command {self.submit[0]} was not found; give the command on a "
                "machine from which jobs are submitted"
            )

    def keywords(self, parameters: ClusterParameters, job: JobDescription) -> dict[str, Any]:
        """Return how dask-jobqueue is told of a job."""
        described = {
            "job_name": job.name,
            "cores": job.cores,
            "memory": f"{job.memory}B",
            "queue": job.queue,
            self.account: parameters.account,
            "walltime": clock(job.walltime),
            "job_extra_directives": list(parameters.job_extra_directives),
            "job_script_prologue": list(job.prologue),
            "log_directory": str(job.logs),
        }
        return described | ({"resource_spec": job.resource_spec} if self.takes_resources else {})

    def script(
        self, parameters: ClusterParameters, job: JobDescription, command: Sequence[str]
    ) -> str:
        """Return the script of a job that runs one command."""
        described = self._described(parameters, job)
        lines = [described.shebang, "", described.job_header, *job.prologue]
        return "\n".join([*lines, f"exec {shlex.join(command)}", ""])

    def _described(self, parameters: ClusterParameters, job: JobDescription) -> Any:
        """Return dask-jobqueue's job, which is never started and only lends its header."""
        keywords = {"processes": 1, **self.keywords(parameters, job)}
        return cluster_class(self).job_cls("tcp://unused:0", name=job.name, **keywords)

    def submit_script(self, script: Path) -> str:
        """Hand over a script; return the number of the job."""
        if self.reads_standard_input:
            with script.open(encoding="utf-8") as stream:
                said = self._called(self.submit, stdin=stream)
        else:
            said = self._called((*self.submit, str(script)))
        if found := re.search(self.number, said):
            return found[1]
        said = " ".join(said.split())
        raise ClusterError(f"{self.submit[0]}: expected the number of a job, found {said!r}")

    def cancel_jobs(self, jobs: Sequence[str]) -> None:
        """Cancel jobs; those that have ended meanwhile do not matter."""
        for job in jobs:
            try:
                self._called((*self.cancel, job))
            except ClusterError:
                if self.states([job])[job].alive:
                    raise

    def states(self, jobs: Sequence[str]) -> Mapping[str, JobState]:
        """Ask for the states of jobs; no answer is a `ClusterError`, which says nothing of them."""
        return {job: self._state(self._word(job)) for job in jobs}

    def _word(self, job: str) -> str | None:
        """Ask for the state of a job, None where it is not known any more."""
        raise NotImplementedError

    def _state(self, word: str | None) -> JobState:
        if word is None:
            return JobState("ended", Phase.ENDED)
        if word in self.waiting:
            return JobState(word, Phase.WAITING)
        return JobState(word, Phase.ENDED if word in self.ended else Phase.RUNNING)

    def _called(
        self, command: Sequence[str], gone: str | None = None, stdin: IO[str] | None = None
    ) -> str:
        """Return what a command prints; nothing where its complaint matches `gone`."""
        try:
            done = subprocess.run(
                command, stdin=stdin, capture_output=True, text=True, timeout=_PATIENCE, check=False
            )
        except FileNotFoundError:
            raise ClusterError(f"{self.name}: the command {command[0]} was not found") from None
        except subprocess.TimeoutExpired:
            raise ClusterError(f"{command[0]}: no answer within {_PATIENCE} s") from None
        if done.returncode == 0:
            return done.stdout
        if gone is not None and re.search(gone, done.stdout + done.stderr):
            return ""
        said = (done.stderr or done.stdout).strip() or f"exit code {done.returncode}"
        raise ClusterError(f"{command[0]}: {said}")


class Slurm(BatchSystem):
    """SLURM: sbatch, scancel, squeue, and sacct for jobs that squeue has forgotten."""

    name = "slurm"
    cluster_class = "SLURMCluster"
    submit = ("sbatch", "--parsable")
    cancel = ("scancel",)

    _PHASES: ClassVar[Mapping[str, Phase]] = {
        **dict.fromkeys(("PENDING", "CONFIGURING", "REQUEUED", "REQUEUE_HOLD", "RESV_DEL_HOLD",
                         "REQUEUE_FED", "SPECIAL_EXIT"), Phase.WAITING),
        **dict.fromkeys(("RUNNING", "COMPLETING", "RESIZING", "SIGNALING", "STAGE_OUT", "STOPPED",
                         "SUSPENDED"), Phase.RUNNING),
    }  # fmt: skip

    def states(self, jobs: Sequence[str]) -> Mapping[str, JobState]:
        """Ask once for all jobs."""
        said = self._called(
            ("squeue", "--noheader", "--states=all", "--format=%i %T", "--jobs", ",".join(jobs)),
            gone="Invalid job id",
        )
        words = dict(line.split() for line in said.splitlines())
        return {
            job: JobState(words[job], self._PHASES.get(words[job], Phase.ENDED))
            if job in words
            else JobState(self._remembered(job), Phase.ENDED)
            for job in jobs
        }

    def _remembered(self, job: str) -> str:
        """Ask the accounting, which not every cluster keeps."""
        try:
            said = self._called(("sacct", "-n", "-X", "-P", "-o", "State", "-j", job))
        except ClusterError:
            said = ""
        return said.split()[0] if said.split() else "ended"


class PBS(BatchSystem):
    """PBS Professional, OpenPBS and Torque: qsub, qdel, qstat."""

    name = "pbs"
    cluster_class = "PBSCluster"
    submit = ("qsub",)
    cancel = ("qdel",)
    number = r"(\d+(?:\[\])?(?:\.\S+)?)"
    takes_resources = True
    waiting, ended = "QHWT", "CFEX"

    def _word(self, job: str) -> str | None:
        said = self._called(("qstat", "-f", job), gone=r"Unknown Job|has finished")
        found = re.search(r"job_state = (\w)", said)
        return found[1] if found else None


class LSF(BatchSystem):
    """IBM Spectrum LSF: bsub, bkill, bjobs."""

    name = "lsf"
    cluster_class = "LSFCluster"
    submit = ("bsub",)
    cancel = ("bkill",)
    reads_standard_input = True  # a script given by its name is not looked into for options
    number = r"Job <(\d+)>"
    account = "project"
    waiting, ended = ("PEND", "PSUSP", "WAIT"), ("DONE", "EXIT", "ZOMBI")

    def keywords(self, parameters: ClusterParameters, job: JobDescription) -> dict[str, Any]:
        """Leave out the seconds."""
        minutes = -(-job.walltime // 60)
        walltime = f"{minutes // 60:02d}:{minutes % 60:02d}"
        return {**super().keywords(parameters, job), "walltime": walltime}

    def _word(self, job: str) -> str | None:
        said = self._called(("bjobs", "-noheader", "-o", "stat", job), gone=r"is not found")
        return said.strip() or None


class SGE(BatchSystem):
    """Grid Engine: qsub, qdel, qstat."""

    name = "sge"
    cluster_class = "SGECluster"
    submit = ("qsub",)
    cancel = ("qdel",)
    number = r"Your job (\d+)"
    account, takes_resources = "project", True
    waiting = ("qw", "hqw", "hRwq", "Rq", "Eqw")

    def _word(self, job: str) -> str | None:
        rows = [line.split() for line in self._called(("qstat", "-u", "*")).splitlines()]
        return next((row[4] for row in rows if len(row) > 4 and row[0] == job), None)


class HTCondor(BatchSystem):
    """HTCondor: condor_submit, condor_rm, condor_q."""

    name = "htcondor"
    cluster_class = "HTCondorCluster"
    submit = ("condor_submit",)
    cancel = ("condor_rm",)
    number = r"submitted to cluster (\d+)"
    script_suffix = ".sub"
    waiting, ended = ("IDLE", "HELD"), ("REMOVED", "COMPLETED")

    _WORDS: ClassVar[Mapping[str, str]] = {
        "1": "IDLE", "2": "RUNNING", "3": "REMOVED", "4": "COMPLETED", "5": "HELD",
        "6": "TRANSFERRING", "7": "SUSPENDED",
    }  # fmt: skip

    def keywords(self, parameters: ClusterParameters, job: JobDescription) -> dict[str, Any]:
        """Say account and time by their names there; there are no queues."""
        if job.queue is not None:
            raise ClusterError("cluster.queue: HTCondor has no queues; leave it null")
        described = super().keywords(parameters, job)
        for unknown in ("queue", "account", "walltime"):
            del described[unknown]
        attributes = {"allowed_execute_duration": str(job.walltime)}
        if parameters.account is not None:
            attributes["accounting_group"] = parameters.account
        for line in parameters.job_extra_directives:
            name, equals, value = line.partition("=")
            if not equals:
                expected = "cluster.job_extra_directives: expected `name = value` for HTCondor"
                raise ClusterError(f"{expected}, found {line!r}")
            attributes[name.strip()] = value.strip()
        described["job_extra_directives"] = attributes
        return {**described, "disk": f"{parameters.disk}B"}

    def script(
        self, parameters: ClusterParameters, job: JobDescription, command: Sequence[str]
    ) -> str:
        """Return a submit description: its lines are not shell."""
        from dask_jobqueue import htcondor  # noqa: PLC0415 (an extra)

        described = self._described(parameters, job)
        shell = "; ".join([*job.prologue, f"exec {shlex.join(command)}"])
        lines = [f"{name} = {value}" for name, value in described.job_header_dict.items()]
        lines += [f'Arguments = "{htcondor.quote_arguments(["-c", shell])}"']
        lines += [f"Executable = {described.executable}"]
        return "\n".join([described.shebang, "", *lines, "", "Queue", ""])

    def _word(self, job: str) -> str | None:
        said = self._called(("condor_q", job, "-autoformat", "JobStatus")).split()
        return self._WORDS.get(said[0], said[0]) if said else None


def batch_system(name: str) -> BatchSystem:
    """Return a batch system by its name in the configuration."""
    return {system.name: system for system in (Slurm, PBS, LSF, SGE, HTCondor)}[name]()


def cluster_class(system: BatchSystem) -> Any:
    """Return dask-jobqueue's class of a batch system, or raise a `MissingPackageError`."""
    try:
        import dask_jobqueue  # noqa: PLC0415 (an extra)
    except ImportError:
        raise MissingPackageError(
            f"{system.name}: jobs of a batch system need the optional package dask-jobqueue: "
            + install_command("cluster", "dask-jobqueue")
        ) from None
    logging.getLogger("dask_jobqueue").setLevel(logging.WARNING)  # it tells of its defaults
    return getattr(dask_jobqueue, system.cluster_class)
