"""Compiled once for all processes, and saying so."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from dynahull import compilation

PROGRAM = """
import logging
logging.basicConfig()
from dynahull.kernels.compiled_kernels import kernels
compiled = kernels()
print("read" if sum(compiled.solve.stats.cache_hits.values()) else "compiled")
"""


def start(folder: Path) -> "subprocess.Popen[str]":
    return subprocess.Popen(
        [sys.executable, "-c", PROGRAM],
        env={**os.environ, "NUMBA_CACHE_DIR": str(folder)},
        cwd=Path(__file__).resolve().parents[2],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def test_processes_on_an_empty_cache_compile_once_and_say_so(tmp_path: Path) -> None:
    processes = [start(tmp_path) for _ in range(2)]
    results = [process.communicate(timeout=300) for process in processes]
    assert sorted(out.strip() for out, _ in results) == ["compiled", "read"]
    said = [line for _, error in results for line in error.splitlines()]
    assert len(said) == 1
    assert "happens once" in said[0]
    assert str(tmp_path) in said[0]

    out, error = start(tmp_path).communicate(timeout=60)
    assert (out.strip(), error) == ("read", "")


def test_other_folder_is_found_where_the_first_cannot_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("not a folder")
    monkeypatch.setattr(compilation.numba.config, "CACHE_DIR", str(tmp_path / "file"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    folder = compilation.cache_folder(tmp_path)
    assert folder is not None
    assert (tmp_path / "cache") in folder.parents
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(tmp_path / "file"))
    assert compilation.cache_folder(tmp_path) is None


def test_two_installations_of_the_same_sources_keep_their_own_code(tmp_path: Path) -> None:
    folders = set()
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "kernel.py").write_text("x = 1")
        folders.add(compilation.cache_folder(tmp_path / name))
    assert len(folders) == 2
    assert not compilation.is_compiled(tmp_path / "one")
    with compilation.compiling("a test", tmp_path / "one"):
        pass
    assert compilation.is_compiled(tmp_path / "one")
    assert not compilation.is_compiled(tmp_path / "two")
