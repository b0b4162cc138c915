"""Compiles the kernels once for a machine, and keeps the result for every later process.

The machine code lies in a folder of its own, named after the kernels' source text: an upgrade or
an edit never meets stale code. Whoever comes first compiles under a lock; the others wait for it
and read what it wrote. Where no folder can be written, each process compiles for itself.
"""

import hashlib
import logging
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from threading import Lock
from typing import Any, NamedTuple

import numba
import numpy as np
from llvmlite import binding

from dynahull.kernels import solve
from dynahull.kernels.solve import Results, make_room
from dynahull.kernels.tree import make_stack, make_tree

log = logging.getLogger("dynahull")

_ONE_AT_A_TIME = Lock()


class Kernels(NamedTuple):
    """The compiled functions; see `dynahull.kernels.solve` for their parameters."""

    grow: Callable[..., None]
    solve: Callable[..., None]


def kernels() -> Kernels:
    """Return the compiled kernels, compiling them if nobody has on this kind of machine."""
    with _ONE_AT_A_TIME:
        return _kernels()


@lru_cache(maxsize=1)
def _kernels() -> Kernels:
    folder = _cache_folder()
    if folder is None:
        log.warning(
            "Compiling the density kernels (about 15 s). No cache folder can be written, so this "
            "happens in every process; set NUMBA_CACHE_DIR to a writable folder to avoid it."
        )
        return _compile(cached=False)
    done = folder / f"{binding.get_host_cpu_name()}-numba-{numba.__version__}.done"
    with _locked(folder / "lock"):
        if not done.exists():
            log.warning(
                "Compiling the density kernels for this machine (about 15 s). "
                "This happens once; the result is kept in %s.",
                folder,
            )
        with _numba_cache(folder):
            compiled = _compile(cached=True)
        done.touch()
    return compiled


def _compile(cached: bool) -> Kernels:
    tree, stack, room = (
        make_tree(np.zeros((4, 3)), np.zeros(4, np.int64)),
        make_stack(),
        make_room(4),
    )
    results = Results(np.zeros(4), np.zeros(4), np.zeros((4, 4), np.int64))
    queries = np.zeros(4, np.bool_)
    grow_types = [numba.typeof(value) for value in (tree, stack)]
    solve_types = [numba.typeof(value) for value in (tree, 4, 0, 1, queries, room, results)]
    options = {"nogil": True, "error_model": "numpy", "cache": cached, "_nrt": False}
    return Kernels(
        numba.njit(numba.void(*grow_types), **options)(solve.grow),
        numba.njit(numba.void(*solve_types), **options)(solve.solve),
    )


def _cache_folder() -> Path | None:
    """Return the first folder that can be written, or None.

    They are `$NUMBA_CACHE_DIR`, the user's cache and the system's folder for temporary files.
    """
    user_cache = Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser())
    temporary = Path(tempfile.gettempdir()) / f"dynahull-{os.getuid()}"
    parents = [user_cache / "dynahull", temporary]
    if numba.config.CACHE_DIR:
        parents.insert(0, Path(numba.config.CACHE_DIR) / "dynahull")
    for parent in parents:
        folder = parent / _fingerprint()
        try:
            folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            # Code is loaded from here, so nobody else may have put it there.
            if folder.stat().st_uid != os.getuid():
                continue
            with tempfile.TemporaryFile(dir=folder):
                return folder
        except OSError:
            continue
    return None


def _fingerprint() -> str:
    """Return a short name for the text of all kernels."""
    digest = hashlib.sha256()
    for source in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(source.read_bytes())
    return digest.hexdigest()[:16]


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Hold a lock file while others wait; go on without where the file system has no locks."""
    with path.open("w") as file:
        try:
            import fcntl  # noqa: PLC0415 (POSIX only)

            fcntl.flock(file, fcntl.LOCK_EX)
        except (ImportError, OSError):
            log.debug("No lock on %s: several processes may compile at once.", path)
        # Closing the file releases the lock.
        yield


@contextmanager
def _numba_cache(folder: Path) -> Iterator[None]:
    """Make numba keep the code it compiles here; it looks when a function is decorated."""
    config: Any = numba.config
    before = config.CACHE_DIR
    config.CACHE_DIR = str(folder)
    try:
        yield
    finally:
        config.CACHE_DIR = before
