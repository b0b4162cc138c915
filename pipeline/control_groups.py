"""Limits that control groups set to the memory and the processors of this process.

A process is in a group of a tree, or of one tree for each kind of limit, and every group above sets
limits as well. A container sees a part of such a tree, and may be told a place outside of it.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import ceil
from pathlib import Path


@dataclass(frozen=True, slots=True)
class _Mount:
    """A tree of groups, as the process sees it.

    Attributes
    ----------
    folder : Path
        Where it is seen.
    root : str
        The group that is seen there.
    controllers : frozenset of str
        What it limits; none for a tree of the second version, which limits everything.
    """

    folder: Path
    root: str
    controllers: frozenset[str]


def memory_left(root: Path = Path("/")) -> int | None:
    """Return the bytes that the control groups of this process leave it; None without a limit.

    Parameters
    ----------
    root : Path
        Of the file system in which `proc` and `sys` are looked for.
    """
    left = []
    for folder, is_second in _groups(root, "memory"):
        statistics = _statistics(folder / "memory.stat")
        if is_second:
            limits = [_number(folder / name) for name in ("memory.max", "memory.high")]
            used, cache, shared = _number(folder / "memory.current"), "file", "shmem"
        else:
            limits = [_number(folder / "memory.limit_in_bytes")]
            # Of all groups above, those included that a container does not see.
            limits.append(statistics.get("hierarchical_memory_limit"))
            used = _number(folder / "memory.usage_in_bytes")
            cache, shared = "total_cache", "total_shmem"
        # The page cache counts as used, and gives way, unless it is memory that is shared.
        gives_way = statistics.get(cache, 0) - statistics.get(shared, 0)
        held = max((used or 0) - max(gives_way, 0), 0)
        left += [limit - held for limit in limits if limit is not None]
    return max(min(left), 0) if left else None


def processors(root: Path = Path("/")) -> int | None:
    """Return how many processors the groups' quotas of time are worth, rounded up; None without.

    Parameters
    ----------
    root : Path
        Of the file system in which `proc` and `sys` are looked for.
    """
    shares = []
    for folder, is_second in _groups(root, "cpu"):
        if is_second:
            words = " ".join(_lines(folder / "cpu.max")).split()
            quota, period = map(_as_number, words) if len(words) == 2 else (None, None)
        else:
            quota = _number(folder / "cpu.cfs_quota_us")
            period = _number(folder / "cpu.cfs_period_us")
        if quota and period:
            shares.append(quota / period)
    return max(ceil(min(shares)), 1) if shares else None


def _groups(root: Path, controller: str) -> Iterator[tuple[Path, bool]]:
    """Yield the groups of this process that limit something, and all those above that it sees.

    With each comes whether its files are those of the second version.
    """
    told = [line.split(":", 2) for line in _lines(root / "proc/self/cgroup")]
    places = [(words[1], words[2]) for words in told if len(words) == 3]
    for mount in [*_mounts(root)] or _usual_mounts(root):
        is_second = not mount.controllers
        if not is_second and controller not in mount.controllers:
            continue
        for controllers, place in places:
            if not controllers if is_second else controller in controllers.split(","):
                for folder in _seen(mount, place):
                    yield folder, is_second


def _seen(mount: _Mount, place: str) -> Iterator[Path]:
    """Yield where a group is seen, and the groups above it; the latter where it is not seen."""
    group = Path(place.lstrip("/"))
    top = Path(mount.root.lstrip("/"))
    inside = group.relative_to(top) if group.is_relative_to(top) else Path()
    if ".." in inside.parts:  # outside of what a container is shown
        inside = Path()
    for each in (inside, *inside.parents):
        if (mount.folder / each).is_dir():
            yield mount.folder / each


def _mounts(root: Path) -> Iterator[_Mount]:
    for line in _lines(root / "proc/self/mountinfo"):
        fields, _, source = line.partition(" - ")
        if not source.startswith("cgroup"):
            continue
        try:
            seen, place = fields.split(" ")[3:5]
            kind, _, options = source.split(" ", 2)
        except ValueError:
            continue
        folder = root / place.replace(r"\040", " ").lstrip("/")
        controllers = options.split(",") if kind == "cgroup" else []
        yield _Mount(folder, seen, frozenset(controllers))


def _usual_mounts(root: Path) -> list[_Mount]:
    """Return where the trees are on nearly every system, if that is not said."""
    folder = root / "sys/fs/cgroup"
    first = [_Mount(folder / name, "/", frozenset([name])) for name in ("memory", "cpu")]
    return [_Mount(folder, "/", frozenset()), *first]


def _statistics(path: Path) -> dict[str, int]:
    pairs = (line.partition(" ")[::2] for line in _lines(path))
    return {name: number for name, text in pairs if (number := _as_number(text)) is not None}


def _number(path: Path) -> int | None:
    return _as_number("".join(_lines(path)))


def _as_number(text: str) -> int | None:
    """Return a limit; None for `max`, -1 and what cannot be read, which are none."""
    return int(text) if text.strip().isdigit() else None


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text(encoding="utf-8", errors="surrogateescape").splitlines()
    except OSError:
        return []
