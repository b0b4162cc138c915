"""Several files renamed, all of them or none."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


@contextmanager
def renaming_all() -> Iterator[Callable[[Path, Path], None]]:
    """Give what renames files; where anything fails in the block, the last one is taken back first.

    Yields
    ------
    callable
        Takes the old path and the new one, whose folder is made.
    """
    done: list[tuple[Path, Path]] = []

    def rename(old: Path, new: Path) -> None:
        new.parent.mkdir(parents=True, exist_ok=True)
        old.replace(new)
        done.append((old, new))

    try:
        yield rename
    except BaseException:
        for old, new in reversed(done):
            with suppress(OSError):
                new.replace(old)
        raise
