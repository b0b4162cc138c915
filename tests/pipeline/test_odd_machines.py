"""File systems, folders and streams that are not as usual: a run warns where it must."""

import errno
import fcntl
import hashlib
import json
import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from pipeline.configuration.quantities import in_home
from pipeline.configuration.run import load_configuration
from pipeline.errors import ConfigurationError
from pipeline.nightly.install import user_name
from pipeline.outputs import folder_lock
from pipeline.progress import LogDisplay, StageObserver
from pipeline.run import run
from pipeline.workers import local_dask
from tests.pipeline.test_nothing_overwritten import FAST, TILED, save
from tiling import output_file

TWO_WORKERS = [*FAST[:-1], "execution.workers=2", "tiling.max_points=150", "tiling.halo=0.5"]


def clean(given, output, settings):
    observer = StageObserver(LogDisplay())
    return run([str(given)], output, load_configuration(None, settings), observer)


def command(given, output, settings=TWO_WORKERS):
    words = [sys.executable, "-m", "pipeline", "run", given, "-o", output]
    return [*map(str, words), *(f"--set={each}" for each in settings)]


def called(words, folder, **environment):
    """Run a command in a folder, with variables set, or unset by None."""
    variables = os.environ | environment
    variables = {name: str(value) for name, value in variables.items() if value is not None}
    ended = subprocess.run(
        words, cwd=folder, env=variables, capture_output=True, text=True, check=False
    )
    assert "Traceback" not in ended.stderr, ended.stderr
    return ended


def digest(path):
    return hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.fixture
def given(tmp_path):
    return save(tmp_path / "map.npy")


@pytest.fixture
def expected(given, tmp_path):
    """Digests of the results of a run on a usual machine."""
    clean(given, tmp_path / "usual", TILED)
    return [digest(tmp_path / f"usual/{name}.npy") for name in ("static", "dynamic")]


def results(folder):
    assert (folder / "run.json").is_file()
    return [digest(folder / f"{name}.npy") for name in ("static", "dynamic")]


@pytest.mark.parametrize("settings", [FAST, TILED])
@pytest.mark.parametrize("fault", [errno.EINVAL, errno.ENOTSUP])
def test_where_nothing_waits_for_the_disk_a_run_warns_once(
    given, tmp_path, monkeypatch, caplog, settings, fault
):
    def refused(handle):
        raise OSError(fault, os.strerror(fault))

    output_file._warn_once.cache_clear()
    monkeypatch.setattr(os, "fsync", refused)
    clean(given, tmp_path / "out", settings)
    results(tmp_path / "out")
    assert caplog.text.count("fsync") == 1


def test_a_fault_of_the_disk_is_no_lack_of_fsync(given, tmp_path, monkeypatch):
    def faulty(handle):
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(os, "fsync", faulty)
    with pytest.raises(Exception, match="Input/output error"):
        clean(given, tmp_path / "out", FAST)
    assert not (tmp_path / "out/run.json").exists()


@pytest.mark.parametrize("settings", [FAST, TILED])
def test_where_nothing_is_locked_a_run_warns_once(given, tmp_path, monkeypatch, caplog, settings):
    def refused(handle, operation):
        raise OSError(errno.ENOLCK, "No locks available")

    folder_lock.warn_of_no_locks.cache_clear()
    monkeypatch.setattr(fcntl, "flock", refused)
    clean(given, tmp_path / "out", settings)
    results(tmp_path / "out")
    assert caplog.text.count("has no locks") == 1


def test_a_long_name_of_the_temporary_folder_is_as_good(given, tmp_path, expected):
    """A socket's name has 107 bytes; those of workers lie elsewhere then."""
    temporary = tmp_path / ("t" * 120)
    temporary.mkdir()
    ended = called(command(given, "out"), tmp_path, TMPDIR=temporary)
    assert ended.returncode == 0, ended.stderr
    assert results(tmp_path / "out") == expected


WITHOUT_SEMAPHORES = """
import _multiprocessing, errno, os

class SemLock:
    SEM_VALUE_MAX = 1

    def __new__(cls, *_, **__):
        raise OSError(errno.ENOSYS, "Function not implemented")

_multiprocessing.SemLock = SemLock
access = os.access
os.access = lambda path, mode, **more: path != "/dev/shm" and access(path, mode, **more)
"""


@pytest.mark.linux_only
def test_without_semaphores_one_process_does_the_work(given, tmp_path, expected):
    (tmp_path / "site").mkdir()
    (tmp_path / "site/sitecustomize.py").write_text(WITHOUT_SEMAPHORES)
    ended = called(command(given, "out"), tmp_path, PYTHONPATH=tmp_path / "site")
    assert ended.returncode == 0, ended.stderr
    assert "/dev/shm" in ended.stderr
    assert results(tmp_path / "out") == expected


WITHOUT_LINUX = """
import os, sys

for name in ("sched_getaffinity", "sched_setaffinity"):
    if hasattr(os, name):
        delattr(os, name)

def forbid(event, arguments):
    if event != "open" or not str(arguments[0]).startswith(("/proc/", "/sys/")):
        return
    frame = sys._getframe(1)
    while frame is not None and frame.f_globals.get("__name__", "").startswith("pathlib"):
        frame = frame.f_back
    if frame is not None and frame.f_globals["__name__"].split(".")[0] in OWN:
        raise FileNotFoundError(2, "No such file or directory", arguments[0])

OWN = ("pipeline", "tiling", "dynahull")
sys.addaudithook(forbid)
"""


def test_what_only_linux_has_need_not_be_there(given, tmp_path, expected):
    """As on macOS: neither the cores of a process nor files that tell of it and of the machine."""
    (tmp_path / "site").mkdir()
    (tmp_path / "site/sitecustomize.py").write_text(WITHOUT_LINUX)
    environment = {"PYTHONPATH": tmp_path / "site"}
    look = "from pipeline.plan import machine; print(machine._lines(machine.Path('/proc/meminfo')))"
    looked = called([sys.executable, "-c", look], Path(__file__).parents[2], **environment)
    assert looked.stdout == "[]\n", "the hook hides nothing"
    for settings in (FAST, TWO_WORKERS):
        ended = called(command(given, "out", settings), tmp_path, **environment)
        assert ended.returncode == 0, ended.stderr
        peak = json.loads((tmp_path / "out/run.json").read_text())["peak_memory_all_bytes"]
        assert peak > 10_000_000
    assert results(tmp_path / "out") == expected


def test_elsewhere_than_on_linux_semaphores_have_no_folder(monkeypatch):
    monkeypatch.setattr(os, "access", lambda *_: False)
    for platform, can in (("darwin", True), ("linux", False)):
        monkeypatch.setattr(local_dask.sys, "platform", platform)
        assert local_dask.can_start_workers() == can


@pytest.mark.parametrize(
    ("settings", "closed"),
    [(FAST, ">&- 2>&- <&-"), *((TWO_WORKERS, each) for each in (">&-", "2>&-", ">&- 2>&- <&-"))],
)
def test_closed_streams_turn_no_success_into_failure(given, tmp_path, settings, closed, expected):
    line = f"{shlex.join(command(given, 'out', settings))} {closed}"
    ended = called(["sh", "-c", line], tmp_path)
    assert ended.returncode == 0, ended.stderr
    assert results(tmp_path / "out") == expected


@pytest.mark.parametrize("words", [["--version"], ["keys"], ["info", "map.npy"]])
def test_closed_streams_are_no_fault_of_other_commands(given, tmp_path, words):
    line = shlex.join([sys.executable, "-m", "pipeline", *words])
    assert called(["sh", "-c", f"{line} >&-"], tmp_path).returncode == 0


def test_a_failure_stays_one_where_streams_are_closed(tmp_path):
    line = shlex.join(command("absent.npy", "out"))
    assert called(["sh", "-c", f"{line} >&- 2>&-"], tmp_path).returncode == 3


def test_a_user_without_name_and_home_cleans_maps(tmp_path, expected):
    if os.getuid():
        pytest.skip("only root may become another user")
    folder = tmp_path / "open"
    folder.mkdir()
    for each in (tmp_path, *tmp_path.parents):
        if each != Path("/") and each != Path("/tmp"):
            each.chmod(0o755)
    folder.chmod(0o777)
    given = save(folder / "map.npy")
    given.chmod(0o644)
    (folder / "cache").mkdir()
    (folder / "cache").chmod(0o777)
    names = ("HOME", "USER", "LOGNAME", "LNAME", "USERNAME", "XDG_CACHE_HOME")
    environment = dict.fromkeys(names) | {"NUMBA_CACHE_DIR": None}
    words = ["setpriv", "--reuid=65432", "--regid=65432", "--clear-groups"]
    starting = "import subprocess, sys; subprocess.run([sys.executable, '-c', ''], check=True)"
    try:
        able = subprocess.run(
            [*words, sys.executable, "-c", starting], cwd=folder, capture_output=True, check=False
        )
    except FileNotFoundError:
        pytest.skip("there is no setpriv")
    if able.returncode:
        pytest.skip("other users may not start this Python, and workers are started by them")
    ended = called([*words, *command(given, folder / "out")], folder, **environment)
    if "Permission denied" in ended.stderr and not (folder / "out").exists():
        pytest.skip(f"other users may not read the packages here: {ended.stderr[-200:]}")
    assert ended.returncode == 0, ended.stderr
    assert results(folder / "out") == expected


def test_a_home_that_is_not_there_is_named(monkeypatch):
    def unknown(*_):
        raise KeyError("getpwuid(): uid not found")

    for name in ("HOME", "USER", "LOGNAME", "LNAME", "USERNAME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("pwd.getpwuid", unknown)
    with pytest.raises(ConfigurationError, match=r"~/maps: expected the home folder of a user"):
        in_home("~/maps")
    assert in_home("maps") == Path("maps")
    assert user_name() == str(os.getuid())
