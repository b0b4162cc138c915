"""Batch systems without one at hand: scripts, commands and their answers, refusals, TLS."""

import json
import os
import shlex
import sys
from pathlib import Path
from subprocess import run as run_command

import numpy as np
import pytest
from distributed import Client, LocalCluster, Security

from pipeline.cluster import record
from pipeline.cluster.batch_systems import Phase, batch_system
from pipeline.cluster.submitting import cancel_run, run_script, submit_run
from pipeline.cluster.workers import (
    TOPIC,
    SharedFiles,
    SharingCheck,
    check_running_workers,
    cluster_security,
    scheduler_security,
    worker_job,
    worker_keywords,
)
from pipeline.commands import app as cli
from pipeline.configuration.cluster import BATCH_SYSTEMS
from pipeline.configuration.run import load_configuration
from pipeline.errors import ClusterError, ConfigurationError, OutputError, WorkError
from pipeline.plan.resources import worker_memory_limit
from pipeline.work.opening import job_key

dask_jobqueue = pytest.importorskip("dask_jobqueue")


@pytest.fixture
def map_file(tmp_path):
    np.save(tmp_path / "a map.npy", np.random.default_rng(0).uniform(size=(100, 3)))
    return tmp_path / "a map.npy"


@pytest.fixture
def commands(tmp_path, monkeypatch):
    """A folder of commands of a batch system, first on the path; what they were given is kept."""
    folder = tmp_path / "commands"
    folder.mkdir()
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")

    def make(name, said, code=0, complaint=""):
        script = folder / name
        script.write_text(
            f'#!/bin/sh\necho "$0 $*" >> {folder}/given\n[ -t 0 ] || cat > {folder}/{name}.in\n'
            f"printf '%s' {shlex.quote(said)}\nprintf '%s' {shlex.quote(complaint)} >&2\n"
            f"exit {code}\n",
            encoding="utf-8",
        )
        script.chmod(0o755)

    make.given = lambda: [
        line.removeprefix(f"{folder}/")
        for line in (folder / "given").read_text(encoding="utf-8").splitlines()
    ]
    make.folder = folder
    return make


def configured(system, *settings):
    return load_configuration(None, [f"execution.cluster={system}", *settings])


def script_of(system, map_file, *settings, output="out", fresh=False):
    folder = map_file.parent / output
    return run_script([str(map_file)], folder, configured(system, *settings), fresh=fresh)


class TestScriptOfTheRun:
    ASKED = (
        "cluster.account=lidar", "cluster.run.walltime=1-06:30:00", "cluster.run.memory=3GiB",
        "cluster.run.cores=2", "cluster.prologue=[module load python, umask 027]",
    )  # fmt: skip
    LINES: dict = {  # noqa: RUF012
        "slurm": [
            "#!/usr/bin/env bash", "#SBATCH -J dynahull", "#SBATCH -p long", "#SBATCH -A lidar",
            "#SBATCH -n 1", "#SBATCH --cpus-per-task=2", "#SBATCH --mem=3G", "#SBATCH -t 30:30:00",
            "#SBATCH --nice=5",
        ],
        "pbs": [
            "#!/usr/bin/env bash", "#PBS -N dynahull", "#PBS -q long", "#PBS -A lidar",
            "#PBS -l select=1:ncpus=2:mem=3072MB", "#PBS -l walltime=30:30:00", "#PBS --nice=5",
        ],
        "lsf": [
            "#!/usr/bin/env bash", "#BSUB -J dynahull", "#BSUB -q long", '#BSUB -P "lidar"',
            "#BSUB -n 2", "#BSUB -W 30:30", "#BSUB --nice=5",
        ],
        "sge": [
            "#$ -N dynahull", "#$ -q long", "#$ -P lidar", "#$ -l h_rt=30:30:00", "#$ --nice=5",
        ],
    }  # fmt: skip

    @pytest.mark.parametrize("system", LINES)
    def test_asks_for_what_is_configured_and_runs_the_run(self, system, map_file):
        script = script_of(
            system, map_file, *self.ASKED, "cluster.queue=short", "cluster.run.queue=long",
            "cluster.job_extra_directives=['--nice=5']", fresh=True,
        )  # fmt: skip
        lines = script.splitlines()
        assert set(self.LINES[system]) <= set(lines)
        assert lines[0].startswith("#!")
        folder = map_file.parent / "out"
        assert lines[-3:-1] == ["module load python", "umask 027"]
        assert shlex.split(lines[-1]) == [
            "exec", sys.executable, "-P", "-m", "pipeline", "run", str(map_file), "-o", str(folder),
            "-c", f"{folder}/.dynahull-cluster/config.yaml", "--fresh",
        ]  # fmt: skip
        assert sum(f"{folder}/.dynahull-cluster/logs" in line for line in lines) == 2
        # Commands come after all directives: batch systems stop looking at the first.
        prefix = self.LINES[system][-1].split()[0]
        last = max(n for n, line in enumerate(lines) if line.startswith(f"{prefix} "))
        assert last < lines.index("module load python")

    def test_for_htcondor_is_a_submit_description(self, map_file):
        script = script_of(
            "htcondor", map_file, *self.ASKED, "cluster.disk=2GiB",
            "cluster.job_extra_directives=['requirements = Memory > 1']",
        )  # fmt: skip
        pairs = dict(line.split(" = ", 1) for line in script.splitlines() if " = " in line)
        assert pairs["MY.DaskWorkerCores"] == "2"
        assert pairs["MY.DaskWorkerMemory"] == str(3 << 30)
        assert pairs["MY.DaskWorkerDisk"] == str(2 << 30)
        assert pairs["allowed_execute_duration"] == str(30 * 3600 + 1800)
        assert pairs["accounting_group"] == "lidar"
        assert pairs["requirements"] == "Memory > 1"
        assert pairs["Executable"] == "/bin/sh"
        assert script.splitlines()[-1] == "Queue"
        # HTCondor's quoting: the words are in single quotes, and a single quote is doubled.
        shell = pairs["Arguments"].removeprefix("\"-c '").removesuffix("'\"").replace("''", "'")
        first, second, run = shell.split("; ")
        assert (first, second) == ("module load python", "umask 027")
        assert shlex.split(run)[:7] == [
            "exec", sys.executable, "-P", "-m", "pipeline", "run", str(map_file),
        ]  # fmt: skip

    def test_leaves_nothing_behind(self, map_file):
        before = sorted(map_file.parent.rglob("*"))
        for system in BATCH_SYSTEMS:
            assert script_of(system, map_file)
        assert sorted(map_file.parent.rglob("*")) == before

    @pytest.mark.parametrize(
        ("settings", "reason"),
        [
            (["execution.cluster=local"], "submit: expected one of --cluster slurm, pbs"),
            (["execution.cluster=slurm", "execution.scheduler=tcp://x:1"], "found tcp://x:1"),
            (["execution.cluster=htcondor", "cluster.queue=q"], "HTCondor has no queues"),
            (
                ["execution.cluster=htcondor", "cluster.job_extra_directives=[x]"],
                "expected `name = value` for HTCondor, found 'x'",
            ),
        ],
    )
    def test_is_refused_where_it_makes_no_sense(self, settings, reason, map_file):
        with pytest.raises((ConfigurationError, ClusterError), match=reason):
            run_script([str(map_file)], map_file.parent / "o", load_configuration(None, settings))

    def test_a_path_that_scripts_cannot_name_is_refused(self, map_file):
        with pytest.raises(ClusterError, match="without blanks"):
            script_of("slurm", map_file, output="an output")


class TestScriptOfAWorker:
    def script(self, system, tmp_path, *settings):
        parameters = configured(system, *settings).cluster
        chosen = batch_system(system)
        keywords = worker_keywords(chosen, parameters, worker_job(parameters, tmp_path))
        made = getattr(dask_jobqueue, chosen.cluster_class).job_cls(
            "tcp://10.0.0.1:8786", name="w", **keywords
        )
        return made.job_script()

    @pytest.mark.parametrize("system", BATCH_SYSTEMS)
    def test_has_one_thread_a_process_a_lifetime_and_no_open_dashboard(self, system, tmp_path):
        script = self.script(
            system, tmp_path, "cluster.walltime=10:00:00", "cluster.memory=2GiB",
            "cluster.workers_per_job=3", "cluster.local_directory=/a scratch",
            "cluster.interface=ib0",
        )  # fmt: skip
        words = script.replace("''", "'")
        assert f"{sys.executable} -P -m distributed" in words  # not of the folder it begins in
        assert " --nthreads 1 --memory-limit 2.00GiB --nworkers 3 --nanny" in words
        assert "--lifetime 32400s --lifetime-stagger 1800s" in words
        assert "--dashboard-address 127.0.0.1:0" in words
        assert "--local-directory '/a scratch'" in words
        assert "--interface ib0" in words
        assert "export OMP_NUM_THREADS=1" in words
        assert "export DASK_DISTRIBUTED__WORKER__MEMORY__SPILL=False" in words

    def test_lifetime_ends_with_the_job_if_wanted(self, tmp_path):
        assert "--lifetime" not in self.script("slurm", tmp_path, "cluster.lifetime=walltime")

    @pytest.mark.parametrize(
        ("settings", "reason"),
        [
            (["cluster.lifetime=2h"], "within walltime, 3600 s, found 7200 s"),
            (["cluster.wallime=2h"], "no such key; did you mean walltime"),
            (["cluster.walltime=soon"], "cluster.walltime: "),
            (["cluster.tls.ca_file=x"], "ca_file, certificate and key together"),
            (["cluster.run.time=2h"], "no such key; did you mean walltime"),
        ],
    )
    def test_keys_that_do_not_fit_are_refused(self, settings, reason):
        with pytest.raises(ConfigurationError, match=reason):
            configured("slurm", *settings)

    def test_durations_are_what_people_write(self):
        for text, seconds in [
            ("36:00:00", 129600), ("'01:30:00'", 5400), ("2-12:00:00", 216000), ("90 min", 5400),
            ("3600", 3600), ("1.5h", 5400),
        ]:  # fmt: skip
            found = configured("slurm", f"cluster.walltime={text}").cluster.walltime
            assert found == seconds


class TestAnswers:
    """What is sent to a batch system, and what is made of its answers."""

    SUBMITTED: dict = {  # noqa: RUF012
        "slurm": ("sbatch", "4711;cluster\n", "4711", "sbatch --parsable {script}"),
        "pbs": ("qsub", "4711.head.example.org\n", "4711.head.example.org", "qsub {script}"),
        "lsf": ("bsub", "Job <4711> is submitted to queue <q>.\n", "4711", "bsub "),
        "sge": ("qsub", 'Your job 4711 ("x") has been submitted\n', "4711", "qsub {script}"),
        "htcondor": (
            "condor_submit",
            "Submitting job(s).\n1 job(s) submitted to cluster 4711.\n",
            "4711",
            "condor_submit {script}",
        ),
    }

    @pytest.mark.parametrize("system", SUBMITTED)
    def test_the_number_of_a_job_is_found(self, system, commands, map_file):
        command, said, number, given = self.SUBMITTED[system]
        commands(command, said)
        folder = map_file.parent / "out"
        job, output = submit_run([str(map_file)], folder, configured(system))
        assert (job, output) == (number, folder)
        suffix = ".sub" if system == "htcondor" else ".sh"
        script = folder / f".dynahull-cluster/run{suffix}"
        assert commands.given() == [given.format(script=script)]
        if system == "lsf":
            assert (commands.folder / "bsub.in").read_text("utf-8") == script.read_text("utf-8")
        assert record.submitted_job(folder) == record.RecordedJobs(system, (number,))
        # The job finds a configuration that says all.
        again = load_configuration(str(folder / ".dynahull-cluster/config.yaml"))
        assert again.execution.cluster == system
        assert again.execution.workers == 1

    @pytest.mark.parametrize(
        ("system", "command", "said", "phase", "word"),
        [
            ("slurm", "squeue", "7 PENDING\n8 RUNNING\n", Phase.WAITING, "PENDING"),
            ("slurm", "squeue", "8 RUNNING\n7 COMPLETING\n", Phase.RUNNING, "COMPLETING"),
            ("slurm", "squeue", "7 NODE_FAIL\n", Phase.ENDED, "NODE_FAIL"),
            ("pbs", "qstat", "Job Id: 7\n    job_state = Q\n", Phase.WAITING, "Q"),
            ("pbs", "qstat", "Job Id: 7\n    job_state = R\n", Phase.RUNNING, "R"),
            ("pbs", "qstat", "Job Id: 7\n    job_state = F\n", Phase.ENDED, "F"),
            ("lsf", "bjobs", "PEND\n", Phase.WAITING, "PEND"),
            ("lsf", "bjobs", "RUN\n", Phase.RUNNING, "RUN"),
            ("lsf", "bjobs", "EXIT\n", Phase.ENDED, "EXIT"),
            ("sge", "qstat", "job-ID  prior\n---\n  7 0.5 dyn me qw 11/23\n", Phase.WAITING, "qw"),
            ("sge", "qstat", "  70 0.5 dyn me qw x\n 7 0.5 dyn me r x\n", Phase.RUNNING, "r"),
            ("sge", "qstat", "  70 0.5 dyn me qw x\n", Phase.ENDED, "ended"),
            ("htcondor", "condor_q", "1\n", Phase.WAITING, "IDLE"),
            ("htcondor", "condor_q", "2\n", Phase.RUNNING, "RUNNING"),
            ("htcondor", "condor_q", "", Phase.ENDED, "ended"),
        ],
    )
    def test_the_state_of_a_job_is_read(self, system, command, said, phase, word, commands):
        commands(command, said)
        state = batch_system(system).states(["7"])["7"]
        assert (state.phase, state.word) == (phase, word)

    @pytest.mark.parametrize(
        ("system", "command", "complaint"),
        [
            ("slurm", "squeue", "slurm_load_jobs error: Invalid job id specified"),
            ("pbs", "qstat", "qstat: Unknown Job Id 7.head"),
            ("pbs", "qstat", "qstat: 7.head Job has finished, use -x or -H"),
            ("lsf", "bjobs", "Job <7> is not found"),
        ],
    )
    def test_a_job_that_is_forgotten_has_ended(self, system, command, complaint, commands):
        commands(command, "", code=1, complaint=complaint)
        commands("sacct", "", code=1, complaint="Slurm accounting storage is disabled")
        assert not batch_system(system).states(["7"])["7"].alive

    @pytest.mark.parametrize(
        ("system", "command"),
        [("slurm", "squeue"), ("pbs", "qstat"), ("lsf", "bjobs"), ("sge", "qstat"),
         ("htcondor", "condor_q")],
    )  # fmt: skip
    def test_no_answer_is_not_taken_for_the_end_of_a_job(self, system, command, commands):
        commands(command, "", code=1, complaint="cannot\nconnect to server")
        with pytest.raises(ClusterError, match=f"^{command}: cannot connect to server$"):
            batch_system(system).states(["7"])

    def test_accounting_knows_what_the_queue_forgot(self, commands):
        commands("squeue", "")
        commands("sacct", "TIMEOUT\n")
        assert batch_system("slurm").states(["7"])["7"].word == "TIMEOUT"

    def test_what_has_no_number_is_an_error(self, commands, map_file):
        commands("sbatch", "good morning\n")
        with pytest.raises(ClusterError, match="number of a job, found 'good morning'"):
            submit_run([str(map_file)], map_file.parent / "out", configured("slurm"))


class TestStatusAndCancel:
    @pytest.fixture
    def submitted(self, tmp_path):
        record.record_submitted(tmp_path / "out", "slurm", "7")
        return tmp_path / "out"

    def test_jobs_are_told_first(self, submitted, commands):
        commands("squeue", "7 RUNNING\n8 RUNNING\n9 PENDING\n10 RUNNING\n")
        record.record_workers(submitted, "slurm", ["8", "9", "10"])
        assert record.state_lines(submitted) == [
            f"{submitted}: slurm job 7: RUNNING",
            f"{submitted}: slurm jobs of workers: 1 PENDING, 2 RUNNING",
        ]
        commands("squeue", "", code=1, complaint="no route to host")
        assert record.state_lines(submitted)[0].endswith("unknown (squeue: no route to host)")

    def test_a_second_run_of_the_folder_is_refused(self, submitted, commands, map_file):
        commands("squeue", "7 PENDING\n")
        commands("sbatch", "8\n")
        with pytest.raises(OutputError, match=r"slurm job 7 is there .*PENDING.*cancel it first"):
            submit_run([str(map_file)], submitted, configured("slurm"))
        commands("squeue", "7 FAILED\n")
        assert submit_run([str(map_file)], submitted, configured("slurm"))[0] == "8"

    def test_workers_that_are_left_are_cancelled(self, submitted, commands):
        commands("squeue", "7 COMPLETED\n8 RUNNING\n9 COMPLETED\n")
        commands("scancel", "")
        record.record_workers(submitted, "slurm", ["8", "9"])
        assert cancel_run(submitted).startswith("cancelled: 1 jobs of workers; ")
        assert [line for line in commands.given() if line.startswith("scancel")] == ["scancel 8"]
        with pytest.raises(WorkError, match="nothing to cancel: slurm job 7 has ended"):
            cancel_run(submitted)

    def test_a_folder_without_jobs_has_nothing_to_cancel(self, tmp_path):
        with pytest.raises(WorkError, match="nothing to cancel: no run was submitted"):
            cancel_run(tmp_path)


@pytest.mark.parametrize("verb", ["run", "submit"])
def test_without_the_commands_of_the_batch_system_one_line_says_so(
    verb, map_file, tmp_path, monkeypatch, capsys
):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(cli.logging, "basicConfig", lambda **_: None)
    monkeypatch.setattr(cli.signal, "signal", lambda *_: None)
    words = [verb, str(map_file), "-o", str(tmp_path / "out"), "--cluster", "slurm"]
    words += ["--set", "tiling.max_points=10", "--set", "neighbours.k=5"]
    monkeypatch.setattr(sys, "argv", ["dynahull-pipeline", *words, "--set", "ground.method=none"])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == cli.EXIT_FAILURE
    errors = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error: ")]
    assert len(errors) == 1
    assert "slurm: the command sbatch was not found" in errors[0]


def test_where_a_run_works_does_not_decide_what_it_leaves():
    keys = {
        job_key("digest", configured(system, f"cluster.workers={number}"))
        for number, system in enumerate([*BATCH_SYSTEMS, "local"], 1)
    }
    assert len(keys) == 1


def test_memory_of_a_worker_is_that_of_its_job():
    assert worker_memory_limit(configured("slurm", "cluster.memory=3GiB"), 100) == 3 << 30


class TestSharing:
    @pytest.fixture
    def files(self, map_file):
        (map_file.parent / "work").mkdir()
        return SharedFiles.of(map_file.parent / "work", [map_file])

    def test_what_is_not_shared_is_named(self, files, map_file):
        assert files.trouble() is None
        map_file.write_bytes(map_file.read_bytes()[:-8])
        assert f"of {map_file}, which has" in files.trouble()
        map_file.unlink()
        assert f"cannot read {map_file}: No such file" in files.trouble()
        files.remove()
        assert f"does not see {map_file.parent}/work: map and output folder must" in files.trouble()
        assert list(Path(files.folder).iterdir()) == []

    def test_another_version_is_refused(self, files):
        other = SharedFiles(files.folder, files.token, files.sizes, "0.0.1")
        assert "the run has 0.0.1" in other.trouble()

    def test_a_worker_that_shares_nothing_leaves_and_says_why(self, files):
        files.remove()  # as a node without the file system would see it
        with (
            LocalCluster(
                n_workers=0, threads_per_worker=1, processes=False, dashboard_address=None,
                scheduler_kwargs={"dashboard_address": "127.0.0.1:0"}, silence_logs=50,
            ) as cluster,
            Client(cluster, set_as_default=False) as client,
        ):  # fmt: skip
            client.register_plugin(SharingCheck(files))
            cluster.scale(1)
            future = client.submit(os.getpid)
            with pytest.raises(TimeoutError):
                future.result(timeout=3)
            ((_, reason),) = client.get_events(TOPIC)
            assert "does not see" in reason
            assert client.scheduler_info(n_workers=-1)["workers"] == {}

    def test_workers_of_a_running_scheduler_are_asked_too(self, files):
        with (
            LocalCluster(
                n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None,
                scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},
            ) as cluster,
            Client(cluster, set_as_default=False) as client,
        ):  # fmt: skip
            assert check_running_workers(client, files) is None
            files.remove()
            assert "does not see" in check_running_workers(client, files)


class TestTLS:
    @pytest.fixture
    def files(self, tmp_path):
        """A key and its certificate, as an administrator would make them."""
        run_command(
            ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2",
             "-subj", "/CN=dask", "-keyout", tmp_path / "key.pem", "-out", tmp_path / "cert.pem"],
            check=True, capture_output=True,
        )  # fmt: skip
        return {
            "ca_file": tmp_path / "cert.pem",
            "certificate": tmp_path / "cert.pem",
            "key": tmp_path / "key.pem",
        }

    def parameters(self, files):
        given = [f"cluster.tls.{name}={path}" for name, path in files.items()]
        return configured("slurm", *given).cluster.tls

    def test_none_is_the_default(self):
        tls = configured("slurm").cluster.tls
        assert cluster_security(tls, {}) is None
        assert scheduler_security(tls, "tcp://10.0.0.1:8786") is None

    def test_a_key_is_made_where_none_is_given(self, tmp_path):
        keys = {name: tmp_path / name for name in ("ca_file", "certificate", "key")}
        tls = configured("slurm", "cluster.tls.enabled=true").cluster.tls
        security = cluster_security(tls, keys)
        assert security.require_encryption
        assert security.tls_worker_key == str(keys["key"])
        assert "PRIVATE KEY" in keys["key"].read_text(encoding="ascii")
        assert keys["key"].stat().st_mode & 0o777 == 0o600

    def test_a_scheduler_that_is_running_is_reached_with_its_files_only(self, files):
        security = cluster_security(self.parameters(files), {})
        with LocalCluster(
            n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None,
            protocol="tls://", security=security,
            scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},
        ) as cluster:  # fmt: skip
            address = cluster.scheduler_address
            assert address.startswith("tls://")
            given = scheduler_security(self.parameters(files), address)
            with Client(address, security=given, set_as_default=False) as client:
                assert client.submit(os.getpid).result(timeout=20) == os.getpid()
            # A certificate of another authority does not do.
            stranger = Security.temporary()
            with pytest.raises(OSError, match=r"certificate|SSL|ssl|connect"):
                Client(address, security=stranger, set_as_default=False, timeout=2)
            with pytest.raises(ConfigurationError, match=r"expected cluster\.tls\.ca_file"):
                scheduler_security(configured("slurm").cluster.tls, address)

    def test_a_file_that_is_not_there_is_named(self, files):
        files["key"].unlink()
        with pytest.raises(ConfigurationError, match=r"cluster\.tls\.key: .*key\.pem: expected"):
            cluster_security(self.parameters(files), {})


def test_a_run_in_its_job_alone_has_workers_on_its_cores(commands, map_file):
    commands("sbatch", "5\n")
    alone = ["cluster.workers=0", "cluster.run.cores=4", "cluster.run.memory=10GiB"]
    folder = map_file.parent / "out"
    submit_run([str(map_file)], folder, configured("slurm", *alone))
    execution = load_configuration(str(folder / ".dynahull-cluster/config.yaml")).execution
    assert (execution.cluster, execution.workers) == ("local", 4)
    assert execution.memory == (10 << 30) * 9 // 10 // 4


def test_the_record_survives_nonsense(tmp_path):
    folder = tmp_path / ".dynahull-cluster"
    folder.mkdir()
    for text in ("", "{", json.dumps({"system": "slurm"}), json.dumps([1])):
        (folder / "submitted.json").write_text(text, encoding="utf-8")
        assert record.submitted_job(tmp_path) is None
