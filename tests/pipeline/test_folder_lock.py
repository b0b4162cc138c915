"""The lock of a folder, on file systems that lock folders, only files, or nothing."""

import errno
import fcntl
import os
import stat
from pathlib import Path

import pytest

from pipeline.errors import OutputError
from pipeline.outputs.folder_lock import LOCK_FILE, folder_is_locked, locked_folder


@pytest.fixture(params=["folders", "files", "nothing"])
def locks(request, monkeypatch):
    """What the file system locks: NFS answers EBADF for folders, Lustre without flock ENOSYS."""
    flock = fcntl.flock

    def of_a_poorer_one(handle, operation):
        if request.param == "nothing":
            raise OSError(errno.ENOSYS, "Function not implemented")
        if request.param == "files" and stat.S_ISDIR(os.fstat(handle).st_mode):
            raise OSError(errno.EBADF, "Bad file descriptor")
        flock(handle, operation)

    monkeypatch.setattr(fcntl, "flock", of_a_poorer_one)
    return request.param


def test_one_at_a_time_and_nothing_is_left(locks, tmp_path, caplog):
    assert not folder_is_locked(tmp_path)
    with locked_folder(tmp_path):
        if locks == "nothing":
            assert "has no locks" in caplog.text
        else:
            assert folder_is_locked(tmp_path)
            with pytest.raises(OutputError, match="another run"), locked_folder(tmp_path):
                pass
            assert folder_is_locked(tmp_path)
    assert not folder_is_locked(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_was_removed_meanwhile_is_no_lock(locks, tmp_path, monkeypatch):
    if locks != "files":
        pytest.skip("there is no file")
    opened = os.open
    removed = []

    def slow(path, *arguments):
        handle = opened(path, *arguments)
        if str(path).endswith(LOCK_FILE) and not removed:
            removed.append(path)
            Path(path).unlink()  # by a run that ends at this moment
        return handle

    monkeypatch.setattr(os, "open", slow)
    with locked_folder(tmp_path):
        assert removed
        assert (tmp_path / LOCK_FILE).exists()
        assert folder_is_locked(tmp_path)


def test_another_fault_is_not_taken_for_a_lock(tmp_path, monkeypatch):
    def faulty(handle, operation):
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(fcntl, "flock", faulty)
    with pytest.raises(OSError, match="Input/output"):
        folder_is_locked(tmp_path)
