"""One night at a time, whatever became of the processes before."""

import subprocess
import sys

import pytest

from pipeline.errors import NightLockedError
from pipeline.outputs.folder_lock import locked_folder

HOLD = (
    "import sys; from pathlib import Path; from pipeline.outputs.folder_lock import locked_folder\n"
    "with locked_folder(Path(sys.argv[1])):\n"
    "    print('held', flush=True); sys.stdin.read()\n"
)


def night_lock(folder):
    return locked_folder(folder, "night", NightLockedError)


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


@pytest.mark.usefixtures("holder")
def test_a_second_night_is_refused(tmp_path):
    with pytest.raises(NightLockedError, match="another night"), night_lock(tmp_path):
        pytest.fail("it was held")


def test_a_killed_night_holds_nothing(tmp_path, holder):
    holder.kill()
    holder.wait()
    with night_lock(tmp_path):
        pass


def test_what_a_night_starts_does_not_keep_its_lock(tmp_path):
    with night_lock(tmp_path):
        child = subprocess.Popen([sys.executable, "-c", "import sys; sys.stdin.read()"], stdin=-1)
    try:
        with night_lock(tmp_path):
            pass
    finally:
        child.communicate()
