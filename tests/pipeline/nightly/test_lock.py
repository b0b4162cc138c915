"""One night at a time, whatever became of the processes before."""

import os
import subprocess
import sys

import pytest

from pipeline.errors import NightLockedError
from pipeline.outputs.folder_lock import LOCK_FILE, night_lock

HOLD = (
    "import sys; from pathlib import Path; from pipeline.outputs.folder_lock import night_lock\n"
    "with night_lock(Path(sys.argv[1])):\n"
    "    print('held', flush=True); sys.stdin.read()\n"
)


@pytest.fixture
def holder(tmp_path):
    """Another process that holds the lock."""
    with subprocess.Popen(
        [sys.executable, "-c", HOLD, str(tmp_path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout.readline() == "held\n"
        yield process
        process.kill()


def test_a_second_night_is_told_who_holds_the_lock(tmp_path, holder):
    expected = f"process {holder.pid} on .* since 20"
    with pytest.raises(NightLockedError, match=expected), night_lock(tmp_path):
        pytest.fail("it was held")


def test_a_killed_night_holds_nothing(tmp_path, holder):
    holder.kill()
    holder.wait()
    assert f"process {holder.pid} " in (tmp_path / LOCK_FILE).read_text()
    with night_lock(tmp_path):
        assert f"process {os.getpid()} " in (tmp_path / LOCK_FILE).read_text()


def test_the_number_of_a_living_process_in_the_file_locks_nothing(tmp_path):
    (tmp_path / LOCK_FILE).write_text(f"process {os.getppid()} on here since yesterday\n" * 5)
    with night_lock(tmp_path):
        assert (tmp_path / LOCK_FILE).read_text().count("process") == 1


def test_what_a_night_starts_does_not_keep_its_lock(tmp_path):
    with night_lock(tmp_path):
        child = subprocess.Popen([sys.executable, "-c", "import sys; sys.stdin.read()"], stdin=-1)
    try:
        with night_lock(tmp_path):
            pass
    finally:
        child.communicate()
