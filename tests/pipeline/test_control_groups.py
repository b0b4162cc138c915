"""Limits of control groups, in trees as systems lay them."""

import pytest

from pipeline.plan.machine import available_memory, memory_left

pytestmark = pytest.mark.linux_only

GIB = 1 << 30
UNLIMITED = 9223372036854771712

SECOND = "42 32 0:38 {root} /sys/fs/cgroup rw,nosuid - cgroup2 cgroup2 rw,nsdelegate"
FIRST = "35 31 0:32 {root} /sys/fs/cgroup/{name} rw - cgroup cgroup rw,{name}"


def lay(root, group, mounts, files):
    """Lay a tree: what a process is told of its groups, and the files of these."""
    told = {"proc/self/cgroup": group, "proc/meminfo": "MemAvailable: 67108864 kB\n"}
    if mounts is not None:
        other = "31 23 0:28 / /run/with\\040blank rw - tmpfs  rw,mode=755\n"
        told["proc/self/mountinfo"] = other + "\n".join(mounts) + "\n"
    for name, text in {**told, **files}.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"{text}\n", encoding="utf-8")
    return root


def second(place, limit, used=0, cache=0, shared=0):
    """The files of a group of the second version."""
    folder = f"sys/fs/cgroup/{place}".rstrip("/")
    return {
        f"{folder}/memory.max": limit,
        f"{folder}/memory.current": used,
        f"{folder}/memory.stat": f"anon 1\nfile {cache}\nshmem {shared}",
    }


def first(place, limit, used=0, cache=0, above=UNLIMITED):
    """The files of a group of the first version."""
    folder = f"sys/fs/cgroup/memory/{place}".rstrip("/")
    return {
        f"{folder}/memory.limit_in_bytes": limit,
        f"{folder}/memory.usage_in_bytes": used,
        f"{folder}/memory.stat": f"total_cache {cache}\nhierarchical_memory_limit {above}",
    }


MEMORY = {
    "own group": (
        "0::/a/b", [SECOND.format(root="/")], second("a/b", 4 * GIB, GIB), 3 * GIB,
    ),
    "a group above": (
        "0::/a/b", [SECOND.format(root="/")],
        second("a", 2 * GIB, GIB) | second("a/b", "max", GIB), GIB,
    ),
    "one far above": (
        "0::/a/b/c/d", [SECOND.format(root="/")],
        second("a", 2 * GIB) | second("a/b/c", 3 * GIB) | second("a/b/c/d", "max"), 2 * GIB,
    ),
    "the most that is used above": (
        "0::/a/b", [SECOND.format(root="/")],
        second("a", 4 * GIB, 3 * GIB) | second("a/b", 2 * GIB, 0), GIB,
    ),
    "namespace": ("0::/", [SECOND.format(root="/")], second("", 5 * GIB), 5 * GIB),
    "outside of the namespace": (
        "0::/../../x", [SECOND.format(root="/")], second("", 5 * GIB), 5 * GIB,
    ),
    "seen from further up": ("0::/", [SECOND.format(root="/../..")], second("", GIB), GIB),
    "container without a namespace": (
        "0::/docker/abc", [SECOND.format(root="/docker/abc")], second("", 3 * GIB), 3 * GIB,
    ),
    "child of such a container": (
        "0::/docker/abc/x", [SECOND.format(root="/docker/abc")],
        second("", 3 * GIB) | second("x", "max"), 3 * GIB,
    ),
    "a place that is not seen": (
        "0::/a/gone/b", [SECOND.format(root="/")], second("a", 6 * GIB), 6 * GIB,
    ),
    "high": (
        "0::/a", [SECOND.format(root="/")],
        second("a", "max") | {"sys/fs/cgroup/a/memory.high": 7 * GIB}, 7 * GIB,
    ),
    "cache gives way": (
        "0::/a", [SECOND.format(root="/")], second("a", 4 * GIB, 3 * GIB, 2 * GIB), 3 * GIB,
    ),
    "shared memory does not": (
        "0::/a", [SECOND.format(root="/")],
        second("a", 4 * GIB, 3 * GIB, 2 * GIB, 2 * GIB), GIB,
    ),
    "more is used than allowed": (
        "0::/a", [SECOND.format(root="/")], second("a", GIB, 2 * GIB), 0,
    ),
    "first": (
        "4:memory:/a/b\n0::/", [FIRST.format(root="/", name="memory")],
        first("a/b", 4 * GIB, GIB), 3 * GIB,
    ),
    "first, a group above": (
        "4:cpu,memory:/a/b", [FIRST.format(root="/", name="memory")],
        first("a", 2 * GIB) | first("a/b", UNLIMITED), 2 * GIB,
    ),
    "first, container": (
        "4:memory:/docker/abc", [FIRST.format(root="/docker/abc", name="memory")],
        first("", 2 * GIB), 2 * GIB,
    ),
    "first, a group above that is not seen": (
        "4:memory:/docker/abc", [FIRST.format(root="/docker/abc", name="memory")],
        first("", UNLIMITED, above=3 * GIB), 3 * GIB,
    ),
    "both": (
        "4:memory:/a\n0::/b",
        [
            FIRST.format(root="/", name="memory"),
            SECOND.format(root="/").replace("group ", "group/unified "),
        ],
        first("a", 2 * GIB), 2 * GIB,
    ),
    "nobody says where": ("0::/a", None, second("a", GIB), GIB),
    "first, nobody says where": ("4:memory:/a", None, first("a", GIB), GIB),
    "no limit": ("0::/a", [SECOND.format(root="/")], second("a", "max"), None),
    "no groups": ("", [], {}, None),
}  # fmt: skip


@pytest.mark.parametrize("case", MEMORY)
def test_the_least_that_any_group_leaves_counts(case, tmp_path):
    group, mounts, files, left = MEMORY[case]
    root = lay(tmp_path, group, mounts, files)
    assert memory_left(root) == left
    assert available_memory(root) == (64 * GIB if left is None else left)


def test_no_more_memory_is_left_than_the_machine_has(tmp_path):
    root = lay(tmp_path, "0::/a", [SECOND.format(root="/")], second("a", 1 << 50))
    assert available_memory(root) == 64 * GIB


@pytest.mark.parametrize("text", ["", "::", "nonsense", "0::", "\x00"])
def test_what_cannot_be_understood_is_no_limit(text, tmp_path):
    files = dict.fromkeys(second("", ""), text)
    root = lay(tmp_path, text, [SECOND.format(root="/"), "- cgroup"], files)
    assert memory_left(root) is None
