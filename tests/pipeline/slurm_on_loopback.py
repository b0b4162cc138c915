"""A real SLURM on this machine alone: a controller and a few nodes, each a slurmd of its own.

Everything lies in one folder, has its own key and ports, and listens on 127.0.0.1 only.
"""

import os
import secrets
import shutil
import signal
import socket
import subprocess
import tempfile
import time
from contextlib import suppress
from pathlib import Path

COMMANDS = ("munged", "slurmctld", "slurmd", "sbatch", "scancel", "squeue", "sinfo")

CONFIGURATION = """
ClusterName=loopback
SlurmctldHost={host}(127.0.0.1)
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=socket={folder}/munge/socket
CredType=cred/munge
CommunicationParameters=NoInAddrAny
SlurmctldPort={ports[0]}
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool-%n
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd-%n.pid
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
SlurmdParameters=config_overrides
ReturnToService=2
SlurmctldTimeout=10
SlurmdTimeout=5
KillWait=20
MinJobAge=300
SchedulerParameters=sched_interval=2
MpiDefault=none
SwitchType=switch/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
{nodes}
PartitionName=main Nodes=ALL Default=YES MaxTime=INFINITE State=UP
"""


def why_not() -> str | None:
    """Return why SLURM cannot be started here, None if it can."""
    missing = [command for command in COMMANDS if shutil.which(command) is None]
    if missing:
        return f"no {', '.join(missing)}: the packages slurm-wlm and munge are not installed"
    return None if os.getuid() == 0 else "only root can start SLURM"


class SlurmOnLoopback:
    """SLURM with nodes `n0`, `n1`, ..., while the block lasts.

    Parameters
    ----------
    cores : sequence of int
        Of each node.
    """

    def __init__(self, cores):
        # Everybody must be able to enter it and its parents: munge insists.
        folder = self._folder = Path(tempfile.mkdtemp(prefix="slurm-", dir="/tmp"))
        folder.chmod(0o755)
        self._nodes = [f"n{number}" for number in range(len(cores))]
        self._daemons = {}
        ports = free_ports(len(cores) + 1)
        host = socket.gethostname().partition(".")[0]
        nodes = [
            f"NodeName={name} NodeHostname={host} NodeAddr=127.0.0.1 Port={port} CPUs={count} "
            "RealMemory=64000"
            for name, port, count in zip(self._nodes, ports[1:], cores, strict=True)
        ]
        self._configuration = CONFIGURATION.format(
            host=host, folder=folder, ports=ports, nodes="\n".join(nodes)
        )
        self.environment = {"SLURM_CONF": str(folder / "slurm.conf")}

    def __enter__(self):
        try:
            self._start()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_):
        if "slurmctld" in self._daemons and not self._over("slurmctld"):
            subprocess.run(
                ["scancel", "--user=root", "--signal=KILL"], env=self._environ(), check=False,
                capture_output=True, timeout=30,
            )  # fmt: skip
        for node in self._nodes:
            self.lose(node)
        for name in ("slurmctld", "munged"):
            self._stop(name)
        shutil.rmtree(self._folder)

    def _start(self):
        munge = self._folder / "munge"
        munge.mkdir(mode=0o755)
        (self._folder / "state").mkdir()
        key = munge / "key"
        key.write_bytes(secrets.token_bytes(1024))
        key.chmod(0o400)
        (self._folder / "slurm.conf").write_text(self._configuration, encoding="utf-8")
        self._run(
            "munged", "--foreground", f"--key-file={key}", f"--socket={munge}/socket",
            f"--pid-file={munge}/pid", f"--log-file={munge}/log", f"--seed-file={munge}/seed",
        )  # fmt: skip
        wait_until((munge / "socket").exists, 10)
        self._run("slurmctld", "-D")
        for node in self._nodes:
            self.bring_up(node)
        wait_until(lambda: self.call("sinfo", "-h", "-o", "%T").strip() == "idle", 30)

    def bring_up(self, node):
        """Start the slurmd of a node."""
        (self._folder / f"spool-{node}").mkdir(exist_ok=True)
        self._run("slurmd", "-D", "-N", node, name=node)

    def lose(self, node):
        """Kill a node: its slurmd, and every process of the jobs on it, without a word."""
        if node not in self._daemons:
            return
        for process in [self._daemons[node].pid, *processes_of(self._folder, node)]:
            with suppress(ProcessLookupError):
                os.kill(process, signal.SIGKILL)
        self._daemons.pop(node).wait(10)

    def call(self, *command):
        """Return what a command of SLURM says."""
        return subprocess.run(
            command, env=self._environ(), check=True, capture_output=True, text=True, timeout=30
        ).stdout

    def jobs(self, columns="%i %j %T %N"):
        """Return the jobs there are, a list of words each."""
        return [line.split() for line in self.call("squeue", "-h", "-o", columns).splitlines()]

    def _run(self, *command, name=None):
        name = name or command[0]
        with (self._folder / f"{name}.log").open("ab") as log:
            self._daemons[name] = subprocess.Popen(
                command, env=self._environ(), stdin=subprocess.DEVNULL, stdout=log, stderr=log,
                start_new_session=True,
            )  # fmt: skip

    def _over(self, name):
        return self._daemons[name].poll() is not None

    def _stop(self, name):
        daemon = self._daemons.pop(name, None)
        if daemon is None:
            return
        daemon.terminate()
        try:
            daemon.wait(10)
        except subprocess.TimeoutExpired:
            daemon.kill()
            daemon.wait(10)

    def _environ(self):
        return {**os.environ, **self.environment}


def processes_of(folder, node):
    """Return the processes that a node's jobs consist of: what SLURM started there, and theirs.

    They are known by the configuration and the node's name in their environment, or, of those that
    watch over a job, by the slurmd they come from.
    """
    mine = [f"SLURM_CONF={folder}/slurm.conf".encode(), f"SLURMD_NODENAME={node}".encode()]
    found = []
    for place in Path("/proc").glob("[0-9]*"):
        try:
            variables = (place / "environ").read_bytes().split(b"\0")
        except OSError:
            continue
        if all(variable in variables for variable in mine):
            found.append(int(place.name))
    return sorted(found)  # who watches over a job before the job


def free_ports(count):
    """Return ports of the loopback that nobody listens on."""
    sockets = [socket.create_server(("127.0.0.1", 0)) for _ in range(count)]
    try:
        return [each.getsockname()[1] for each in sockets]
    finally:
        for each in sockets:
            each.close()


def wait_until(condition, seconds):
    """Wait until something is so."""
    deadline = time.monotonic() + seconds
    while True:
        try:
            if condition():
                return
        except subprocess.CalledProcessError:
            pass
        if time.monotonic() > deadline:
            raise TimeoutError(f"not so within {seconds} s: {condition}")
        time.sleep(0.2)
