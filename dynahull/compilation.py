"""Compiled code is kept for a machine: made once, by whoever comes first, for every later process.

The code lies in a folder of its own, named after the sources it was made from: an upgrade or an
edit never meets stale code, and two installations never overwrite each other's. Nobody else can
write there, as reading it runs it. Who comes first
compiles under a lock, and says so; the others wait for it and read what it wrote. Where no folder
can be written, each process compiles.
"""

import fcntl
import hashlib
import logging
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any

import numba
from llvmlite import binding

from dynahull.private_folder import private_folder

log = logging.getLogger("dynahull")


_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}


def compiled(function: Callable[..., Any]) -> Any:
    """Compile a function on its first call, and keep the code with that of its package."""
    folder = cache_folder(Path(function.__code__.co_filename).parent)
    with numba_cache(folder):
        return numba.njit(**_OPTIONS, cache=folder is not None)(function)


def helper(function: Callable[..., Any]) -> Any:
    """Compile a function that compiled ones call, and nobody else: it is kept with their code."""
    return numba.njit(**_OPTIONS, no_cpython_wrapper=True)(function)


def inlined(function: Callable[..., Any]) -> Any:
    """Compile a helper into each of its callers."""
    return numba.njit(**_OPTIONS, no_cpython_wrapper=True, forceinline=True)(function)


@contextmanager
def compiling(what: str, sources: Path) -> Iterator[Path | None]:
    """Compile, in this block, what is named; yield where the code is kept, None where it cannot be.

    The functions are those of the modules in a folder. One process compiles at a time, and only the
    first one says so.
    """
    folder = cache_folder(sources)
    if folder is None:
        log.warning(
            "Compiling %s (about 15 s). No private folder can be written, so this "
            "happens in every process; set NUMBA_CACHE_DIR to a folder of your own to avoid it.",
            what,
        )
        yield None
        return
    done = _marker(folder)
    with _locked(folder / "lock"):
        if not done.exists():
            log.warning(
                "Compiling %s for this machine (about 15 s). "
                "This happens once; the result is kept in %s.",
                what,
                folder,
            )
        yield folder
        done.touch()


def is_compiled(sources: Path) -> bool:
    """Tell whether the functions of a folder's modules are compiled and kept."""
    folder = cache_folder(sources)
    return folder is not None and _marker(folder).exists()


def _marker(folder: Path) -> Path:
    return folder / f"{binding.get_host_cpu_name()}-numba-{numba.__version__}.done"


def cache_folder(sources: Path) -> Path | None:
    """Return the folder for the compiled code of some sources, or None where there is none.

    It is in the first of `$NUMBA_CACHE_DIR`, the user's cache and the system's folder for temporary
    files that only this user can write: numba calls what the code that it reads says.
    """
    return private_folder(_fingerprint(sources), str(numba.config.CACHE_DIR))


@contextmanager
def numba_cache(folder: Path | None) -> Iterator[None]:
    """Make numba keep the code it compiles here; it looks when a function is decorated."""
    config: Any = numba.config
    before = config.CACHE_DIR
    config.CACHE_DIR = before if folder is None else str(folder)
    try:
        yield
    finally:
        config.CACHE_DIR = before


@lru_cache
def _fingerprint(sources: Path) -> str:
    """Return a short name for all modules in a folder: where they are, their times and texts.

    Numba takes code of a file of another time for stale, and compiles it again.
    """
    digest = hashlib.sha256()
    for source in sorted(sources.glob("*.py")):
        digest.update(os.fsencode(f"{source.resolve()} {source.stat().st_mtime_ns}"))
        digest.update(source.read_bytes())
    return digest.hexdigest()[:16]


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Hold a lock file while others wait; go on without where the file system has no locks."""
    with path.open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX)
        except OSError:
            log.debug("No lock on %s: several processes may compile at once.", path)
        # Closing the file releases the lock.
        yield
