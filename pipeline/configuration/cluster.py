"""The keys of the configuration about clusters."""

from typing import Literal, Self, get_args

from pydantic import BaseModel, Field, model_validator

from pipeline.configuration.quantities import Bytes, Seconds

BatchSystemName = Literal["slurm", "pbs", "lsf", "sge", "htcondor"]
BATCH_SYSTEMS: tuple[str, ...] = get_args(BatchSystemName)


class TLSParameters(BaseModel, extra="forbid", frozen=True):
    """Encryption between scheduler, workers and the run."""

    enabled: bool = Field(
        False,
        description="Encrypt, and let in only who holds the key. Without the files below, a key is "
        "made for this run.",
    )
    ca_file: str | None = Field(None, description="Certificate of the authority, PEM.")
    certificate: str | None = Field(
        None, description="Certificate of scheduler, workers and run, PEM."
    )
    key: str | None = Field(None, description="Its private key, PEM.")

    @model_validator(mode="after")
    def _all_files_or_none(self) -> Self:
        given = [name for name in ("ca_file", "certificate", "key") if getattr(self, name)]
        if len(given) not in (0, 3):
            raise ValueError(f"expected ca_file, certificate and key together, found {given}")
        return self


class RunJobParameters(BaseModel, extra="forbid", frozen=True):
    """The job that `submit` hands over: the run itself, without its workers."""

    cores: int = Field(1, ge=1, description="Cores of the job.")
    memory: Bytes = Field(
        4 << 30, description="Memory of the job; a map of one tile is cleaned in it."
    )
    walltime: Seconds = Field(
        24 * 3600,
        description="Time of the job: longer than the whole run, waiting for workers included.",
    )
    queue: str | None = Field(None, description="Queue or partition; null: that of the workers.")
    resource_spec: str | None = Field(None, description="As `cluster.resource_spec`, of this job.")


class ClusterParameters(BaseModel, extra="forbid", frozen=True):
    """Jobs of a batch system; the result does not depend on them."""

    workers: int = Field(
        4,
        ge=0,
        description="Workers, each a process of one thread. Lost jobs are started anew. 0 with "
        "`submit`: the run works on the cores of its own job.",
    )
    workers_per_job: int = Field(
        1, ge=1, description="Workers in one job, where jobs of one core are not wanted."
    )
    memory: Bytes = Field(
        4 << 30,
        description="Memory of a worker, such as 4GiB, for which the job asks; a worker that takes "
        "more is started anew.",
    )
    walltime: Seconds = Field(
        3600, description="Time of a worker's job: seconds, or text such as 12:00:00 or 2-00:00:00."
    )
    queue: str | None = Field(None, description="Queue or partition; null: the cluster's default.")
    account: str | None = Field(None, description="Account or project that pays.")
    job_name: str = Field(
        "dynahull",
        pattern=r"^[A-Za-z][A-Za-z0-9_.-]*$",
        description="Name of the run's job; those of workers have `-worker` behind it.",
    )
    job_extra_directives: tuple[str, ...] = Field(
        (),
        description="Further options for the batch system, one an entry, such as "
        "`--constraint=skylake`; HTCondor: `name = value`.",
    )
    prologue: tuple[str, ...] = Field(
        (), description="Lines of shell before a worker or a run starts, such as `module load`."
    )
    resource_spec: str | None = Field(
        None,
        description="PBS and SGE: resources (`-l`) of a worker, in place of those derived from "
        "memory. Without it, SGE asks for no memory.",
    )
    disk: Bytes = Field(1 << 30, description="HTCondor: disk of a job.")
    python: str | None = Field(
        None, description="Python on the nodes; null: the path of the one that starts the run."
    )
    local_directory: str | None = Field(
        None, description="Scratch folder on a node; null: its folder for temporary files."
    )
    interface: str | None = Field(
        None, description="Network interface of the nodes, such as ib0; null: the default route's."
    )
    scheduler_interface: str | None = Field(
        None, description="That of the run's machine; null: named like that of the nodes."
    )
    lifetime: Seconds | Literal["auto", "walltime"] = Field(
        "auto",
        description="Time after which a worker ends and another takes its task; `auto`: nine "
        "tenths of walltime; `walltime`: when the batch system ends it.",
    )
    lifetime_stagger: Seconds | Literal["auto"] = Field(
        "auto",
        description="Workers end up to so much earlier or later, lest all end at once; `auto`: a "
        "twentieth of walltime.",
    )
    check_every: Seconds = Field(
        15,
        description="Seconds between two questions to the batch system while workers are missing.",
    )
    silence: Seconds = Field(
        30,
        description="Seconds after which a job without workers is given up, though the batch "
        "system says that it runs: its node is lost. A worker that took too much memory begins "
        "anew within that time.",
    )
    dashboard: str | None = Field(
        None,
        description="Address of the dashboard, such as 0.0.0.0:8787 for everybody; null: a free "
        "port for the same machine only.",
    )
    run: RunJobParameters = RunJobParameters()
    tls: TLSParameters = TLSParameters()

    @property
    def lifetime_seconds(self) -> int | None:
        """Seconds after which a worker ends by itself; None if it does not."""
        if self.lifetime == "walltime":
            return None
        return self.walltime * 9 // 10 if self.lifetime == "auto" else self.lifetime

    @property
    def stagger_seconds(self) -> int:
        """Seconds by which lifetimes differ."""
        if self.lifetime_stagger == "auto":
            return min(self.walltime // 20, (self.lifetime_seconds or 0) // 2)
        return self.lifetime_stagger

    @model_validator(mode="after")
    def _lifetime_fits(self) -> Self:
        lifetime = self.lifetime_seconds
        if lifetime is not None and lifetime + self.stagger_seconds > self.walltime:
            raise ValueError(
                f"expected lifetime and lifetime_stagger within walltime, {self.walltime} s, found "
                f"{lifetime} s and {self.stagger_seconds} s"
            )
        return self
