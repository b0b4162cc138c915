"""What a killed process leaves of temporary files is removed by the next one, and nothing else."""

import os
import signal
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from pipeline import temporary
from pipeline.temporary import remove_leftovers

NOBODY = 65534

HOLD = """
import sys, time
from pipeline.temporary import temporary_folder
(temporary_folder() / "kept").touch()
print(temporary_folder(), flush=True)
time.sleep(float(sys.argv[1]))
"""


def start(program, *arguments, place):
    """Start a program, and wait until it has said a line."""
    process = subprocess.Popen(
        [sys.executable, "-P", "-c", program, *arguments],
        env={**os.environ, "TMPDIR": str(place)}, stdout=subprocess.PIPE, text=True,
        start_new_session=True,
    )  # fmt: skip
    return process, process.stdout.readline().strip()


def kill(process):
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    process.stdout.close()


def test_the_folder_goes_with_its_process(tmp_path):
    process, folder = start(HOLD, "0", place=tmp_path)
    process.communicate()
    assert folder.startswith(f"{tmp_path}/dynahull-{os.getuid()}-")
    assert not Path(folder).exists()


def test_what_a_killed_process_left_is_removed_and_what_others_use_is_not(tmp_path):
    killed, left = start(HOLD, "600", place=tmp_path)
    kill(killed)
    assert (Path(left) / "kept").exists()
    working, used = start(HOLD, "600", place=tmp_path)
    assert not Path(left).exists()
    start(HOLD, "0", place=tmp_path)[0].communicate()
    assert (Path(used) / "kept").exists()
    assert Path(used).stat().st_mode & 0o777 == 0o700
    kill(working)


def test_only_this_users_own_folders_are_removed(tmp_path):
    prefix = temporary._prefix()
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / f"{prefix}link").symlink_to(tmp_path / "elsewhere")
    (tmp_path / f"{prefix}file").touch()
    (tmp_path / "dynahull-another").mkdir()
    if os.getuid() == 0:
        (tmp_path / f"{prefix}theirs").mkdir()
        os.chown(tmp_path / f"{prefix}theirs", NOBODY, NOBODY)
    (tmp_path / f"{prefix}left/deep").mkdir(parents=True)
    before = set(tmp_path.iterdir())
    remove_leftovers(tmp_path)
    assert set(tmp_path.iterdir()) == before - {tmp_path / f"{prefix}left"}
    remove_leftovers(tmp_path / "nowhere")


@pytest.fixture
def place():
    """A folder whose name is short enough for sockets."""
    with TemporaryDirectory(prefix="t-", dir="/tmp") as folder:
        yield Path(folder)


WORK = """
import time
from pipeline.workers.local_dask import start_fork_server
from pipeline.temporary import temporary_folder
if __name__ == "__main__":
    start_fork_server()
    print(temporary_folder(), flush=True)
    time.sleep(600)
"""


def test_sockets_of_a_killed_run_are_removed(place):
    process, folder = start(WORK, place=place)
    assert list(Path(folder).glob("pymp-*/listener-*"))
    kill(process)
    start(HOLD, "0", place=place)[0].communicate()
    assert not list(place.iterdir())


def test_addresses_of_sockets_fit_where_the_folder_has_a_long_name(tmp_path):
    (tmp_path / ("x" * 90)).mkdir()
    process, folder = start(WORK, place=tmp_path / ("x" * 90))
    assert Path(folder).parent.parent == tmp_path
    kill(process)
