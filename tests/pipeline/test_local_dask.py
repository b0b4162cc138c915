"""Workers of this machine take orders from their own run only, whatever the site says of Dask."""

import os
import subprocess
import sys
import textwrap
from copy import deepcopy

import dask
import psutil
import pytest
from distributed import LocalCluster

from pipeline.errors import ConfigurationError
from pipeline.temporary import temporary_folder
from pipeline.workers.local_dask import local_client, site_settings_aside

NOBODY = 65534

STRANGER = """
import asyncio, os, sys
from distributed import Security
from distributed.core import Server, connect
from distributed.comm import tcp
stranger = Security.temporary()
arguments = {"tcp": {}, "tls": stranger.get_connection_args("client")}

async def talk(place, protocol):
    comm = await connect(place, timeout=3, **arguments[protocol])
    await comm.write({"op": "identity", "reply": True})
    return await comm.read()

async def attempt(place, protocol):
    try:
        print("talked", place, await asyncio.wait_for(talk(place, protocol), 20))
    except Exception as error:
        print("refused", place, type(error).__name__)

async def try_all(addresses):
    # What is imported on first use is imported while its folder may still be read.
    async with Server({"identity": lambda: "itself"}) as itself:
        await itself.listen("tcp://127.0.0.1:0")
        await talk(itself.address, "tcp")
    BECOME_NOBODY
    assert os.geteuid() != 0
    await asyncio.gather(*(
        attempt(address.replace("tls", protocol), protocol)
        for address in addresses for protocol in ("tcp", "tls")
    ))

asyncio.run(try_all(sys.argv[1:]))
"""


def as_another_user(program, *arguments):
    """Run a program that becomes the user nobody once it has imported what it needs."""
    if os.getuid() != 0:
        pytest.skip("only root can become another user")
    program = program.replace("BECOME_NOBODY", f"os.setgroups([]); os.setgid({NOBODY}); "
                              f"os.setuid({NOBODY})")  # fmt: skip
    command = [sys.executable, "-P", "-c", program, *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=True).stdout


@pytest.fixture(scope="module")
def client():
    with site_settings_aside(), local_client(1, 1 << 30) as client:
        yield client


def addresses(client):
    (worker,) = client.scheduler_info()["workers"].values()
    return [
        client.scheduler.address,
        worker["nanny"],
        next(iter(client.scheduler_info()["workers"])),
    ]


def listening(client):
    """Every address at which this process, or one that it started, waits for connections."""
    this = psutil.Process()
    workers = [psutil.Process(client.submit(os.getpid).result())]
    return {
        connection.laddr
        for process in {this, *this.children(recursive=True), *workers}
        for connection in process.net_connections("inet")
        if connection.status == psutil.CONN_LISTEN
    }


def test_nobody_else_may_connect(client):
    assert all(address.startswith("tls://127.0.0.1:") for address in addresses(client))
    every = [f"tls://{place.ip}:{place.port}" for place in listening(client)]
    assert set(addresses(client)) <= set(every)
    said = as_another_user(STRANGER, *every).splitlines()
    assert len(said) == 2 * len(every)
    assert [line for line in said if not line.startswith("refused")] == []
    assert client.submit(sum, (1, 2)).result() == 3


def test_a_scheduler_without_keys_would_talk_to_anybody():
    with LocalCluster(
        n_workers=0, processes=False, protocol="tcp://", dashboard_address=None,
        scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},
    ) as cluster:  # fmt: skip
        address = cluster.scheduler_address.replace("tcp", "tls")
        assert "talked tcp://" in as_another_user(STRANGER, address)


def test_only_this_machine_may_knock(client):
    assert {place.ip for place in listening(client)} == {"127.0.0.1"}


def test_keys_stay_on_no_disk_and_nobody_else_may_look(client):
    folder = temporary_folder()
    assert folder.stat().st_mode & 0o777 == 0o700
    kept = [path for path in folder.rglob("*") if path.is_file()]
    assert not [path for path in kept if b"PRIVATE" in path.read_bytes()]
    options = [
        word for each in psutil.Process().children(recursive=True) for word in each.cmdline()
    ]
    assert not [word for word in options if "PRIVATE" in word]


SITE = {
    "DASK_DISTRIBUTED__COMM__REQUIRE_ENCRYPTION": "True",
    "DASK_DISTRIBUTED__COMM__TLS__CA_FILE": "/nowhere/ca.pem",
    "DASK_DISTRIBUTED__COMM__TLS__CIPHERS": "none",
    "DASK_DISTRIBUTED__COMM__DEFAULT_SCHEME": "ucx",
    "DASK_DISTRIBUTED__COMM__COMPRESSION": "nonsense",
    "DASK_DISTRIBUTED__WORKER__PRELOAD": '["no_such_module"]',
    "DASK_DISTRIBUTED__NANNY__PRELOAD": '["no_such_module"]',
    "DASK_DISTRIBUTED__SCHEDULER__PRELOAD": '["no_such_module"]',
    "DASK_DISTRIBUTED__CLIENT__PRELOAD": '["no_such_module"]',
    "DASK_DISTRIBUTED__WORKER__MEMORY__TERMINATE": "0.001",
    "DASK_DISTRIBUTED__WORKER__MEMORY__PAUSE": "0.001",
    "DASK_DISTRIBUTED__WORKER__MULTIPROCESSING_METHOD": "nonsense",
    "DASK_DISTRIBUTED__WORKER__LIFETIME__DURATION": "1ms",
    "DASK_DISTRIBUTED__SCHEDULER__IDLE_TIMEOUT": "1ms",
    "DASK_DISTRIBUTED__SCHEDULER__DEFAULT_TASK_DURATIONS": "7",
    "DASK_DISTRIBUTED__SCHEDULER__PICKLE": "False",
    "DASK_DISTRIBUTED__NANNY__ENVIRON__OMP_NUM_THREADS": "64",
    "DASK_TEMPORARY_DIRECTORY": "/nowhere",
    "DASK_SCHEDULER_ADDRESS": "tcp://10.255.255.1:8786",
    "DASK_LOGGING_FILE_CONFIG": "/nowhere/logging.ini",
}

RUN = """
import os
from pipeline.workers.local_dask import local_workers
from pipeline.work.folder import TaskReport

def task(folder, number):
    return TaskReport(number, (int(os.environ["OMP_NUM_THREADS"]),))

with local_workers(2, 1 << 30) as executor:
    for number, report in executor.run(task, "", range(3)):
        print(number, report)
        assert report.points == number and report.counts == (1,)
"""


def test_the_settings_of_a_site_do_not_reach_our_workers(tmp_path):
    (tmp_path / ".config/dask").mkdir(parents=True)
    text = textwrap.dedent(
        """
        logging: {distributed: debug}
        distributed:
          worker: {resources: {GPU: 1}, preload: [no_such_module]}
          scheduler: {allowed-failures: 0}
        """
    )
    (tmp_path / ".config/dask/site.yaml").write_text(text, encoding="utf-8")
    environment = {**os.environ, **SITE, "HOME": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", RUN], env=environment, capture_output=True, text=True, timeout=300,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.splitlines()) == 3
    assert done.stderr == ""


def test_settings_that_cannot_be_read_are_named(tmp_path):
    (tmp_path / "dask.yaml").write_text("a: [", encoding="utf-8")
    program = (
        "from pipeline.workers.local_dask import local_workers\nwith local_workers(2, 9): pass"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], env={**os.environ, "DASK_CONFIG": str(tmp_path)},
        capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    last = done.stderr.splitlines()
    assert [line for line in last if ConfigurationError.__name__ in line and "dask.yaml" in line]


def test_a_program_keeps_its_own_settings_of_dask():
    with dask.config.set({"distributed.worker.memory.target": 0.123, "of.its.own": [1]}):
        before = deepcopy(dask.config.config)
        with site_settings_aside():
            assert dask.config.get("of.its.own", None) is None
            assert dask.config.get("distributed.worker.memory.target") != 0.123
        assert dask.config.config == before
    assert dask.config.get("of.its.own", None) is None
