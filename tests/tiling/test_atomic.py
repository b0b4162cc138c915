import os
import re
from pathlib import Path

import pytest

from tiling.output_file import atomic_file, write_only


def test_a_file_appears_when_it_is_whole(tmp_path):
    path = tmp_path / "map.bin"
    path.write_text("old")
    with atomic_file(path) as temporary:
        temporary.write_text("new")
        assert path.read_text() == "old"
        assert temporary.parent == tmp_path
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


def test_a_failure_leaves_what_was_there(tmp_path):
    path = tmp_path / "map.bin"
    path.write_text("old")

    def write_half(temporary):
        temporary.write_text("ne")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), atomic_file(path) as temporary:
        write_half(temporary)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_two_writers_of_one_file_do_not_meet(tmp_path):
    path = tmp_path / "map.bin"
    with atomic_file(path) as first, atomic_file(path) as second:
        first.write_text("first")
        second.write_text("second")
    assert path.read_text() == "first"
    assert list(tmp_path.iterdir()) == [path]


def test_places_of_a_file_are_written_beside_others_and_never_read(tmp_path):
    path = tmp_path / "shared"
    path.write_bytes(b"........")
    with write_only(path) as one, write_only(path) as other:
        one.seek(1)
        other.seek(5)
        one.write(b"ab")
        other.write(b"xy")
        with pytest.raises(OSError, match="Bad file descriptor"):
            os.read(one.fileno(), 1)
    assert path.read_bytes() == b".ab..xy."
    with pytest.raises(FileNotFoundError):
        write_only(tmp_path / "absent")


def test_no_task_maps_a_file_that_others_write_too():
    """Two machines that map one page would undo each other's writes (NFS)."""
    project = Path(__file__).resolve().parents[2]
    mapped = [
        path.name
        for package in ("pipeline", "tiling")
        for path in (project / package).rglob("*.py")
        if re.search(r'"r\+b?"', path.read_text(encoding="utf-8"))
    ]
    # One process alone writes them: the coordinating one, `apply`, and the one that thins.
    alone = ["apply.py", "kept_returns.py", "labelling.py", "thinning.py"]
    assert sorted(mapped) == alone
