"""How fast points become densities: the compiled kernels against the published procedure.

One run, one core, the same points in the same order for all, alternating, medians of processor
time. Prints the machine, the date and ratios:

    OMP_NUM_THREADS=1 python -m benchmarks.density [--maps ../shared/data/maps] [--quick]

The published procedure is `sklearn.neighbors.KDTree.query(k=75)` and a Python loop over
`scipy.spatial.ConvexHull(neighbours).volume`. Other libraries are timed on neighbours alone, where
they are installed. Building the tree counts for all, shared out over the points of the map.
"""

import argparse
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from datetime import date
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from statistics import median
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError, cKDTree
from sklearn.neighbors import KDTree

from dynahull.kernels import hull_densities
from dynahull.kernels.compiled_kernels import grown_tree, kernels
from dynahull.kernels.solve import Results, make_workspace
from dynahull.kernels.tree import LEAF_SIZE
from tiling.formats import open_map

Points = NDArray[np.float64]
Answer = TypeVar("Answer")

K = 75
ROUNDS = 7
SAMPLE = 9_600
ALONE = """
import sys, time
import numpy as np
from benchmarks.density import simulated
from dynahull.kernels import hull_densities
points = simulated(int(sys.argv[1]))
rows = np.arange(len(points))
hull_densities(points[:1000], rows[:1000], 75)
print("ready", flush=True)
sys.stdin.readline()
begin = time.perf_counter()
hull_densities(points, rows, 75)
print(time.perf_counter() - begin)
"""
PUBLISHED_SAMPLE = 1_000


def main() -> None:
    """Run all comparisons."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--maps", type=Path, default=Path("../shared/data/maps"))
    parser.add_argument("--quick", action="store_true", help="fewer points and rounds")
    arguments = parser.parse_args()
    count = 200_000 if arguments.quick else 1_000_000
    rounds = 3 if arguments.quick else ROUNDS
    print(f"{date.today()}, {machine()}")
    kernels()
    for name, points in maps(arguments.maps, count):
        print(f"\n{name}: {len(points):,} points, k = {K}")
        compare(points, rounds)
    print("\nOn a simulated map")
    scaling(count)
    two_threads(simulated(count // 4), rounds)
    peak_memory(count)
    start_up()


def machine() -> str:
    """Name the processor and the versions that matter."""
    model = platform.machine()
    cpu_info = Path("/proc/cpuinfo")
    if cpu_info.exists():
        lines = [line for line in cpu_info.read_text().splitlines() if "model name" in line]
        model = lines[0].partition(":")[2].strip() if lines else model
    import numba  # noqa: PLC0415 (only its version)

    return (
        f"{model}, {os.cpu_count()} cores, Python {platform.python_version()}, "
        f"NumPy {np.__version__}, numba {numba.__version__}"
    )


def maps(folder: Path, count: int) -> Iterator[tuple[str, Points]]:
    """Yield the three maps of the comparison, as far as they are here."""
    for name in ("room_static_sensor.laz", "corridor.pcd"):
        path = folder / name
        if not path.exists():
            print(f"\n{name}: skipped, not in {folder}")
            continue
        batches, found = [], 0
        for batch in open_map(path).batches():
            batches.append(batch.xyz[np.isfinite(batch.xyz).all(axis=1)])
            found += len(batches[-1])
            if found >= count:
                break
        yield name, np.concatenate(batches)[:count]
    yield "simulated workspaces", simulated(count)


def simulated(count: int) -> Points:
    """Sample walls and floors of rooms with 5 mm of noise, at about 5,000 points a square metre."""
    random = np.random.default_rng(0)
    surfaces = 24
    corner = random.random((surfaces, 3)) * [60, 60, 3]
    sides = np.eye(3)[random.permuted(np.tile([0, 1, 2], (surfaces, 1)), axis=1)[:, :2]]
    which = random.integers(0, surfaces, count)
    along = random.random((count, 2)) * np.sqrt(count / surfaces / 5_000)
    points: Points = corner[which] + np.einsum("ni,nij->nj", along, sides[which])
    return points + random.normal(scale=0.005, size=points.shape)


def compare(points: Points, rounds: int) -> None:
    """Print microseconds a point of each contestant, and the ratios that matter."""
    kernel = Kernel(points)
    # The same part of the map for all, in the same order.
    sample = kernel.queries()
    sklearn_tree, sklearn_build = timed(lambda: KDTree(points))
    others = peers(points)
    contestants: dict[str, tuple[Callable[[], object], float]] = {
        "published procedure": (
            lambda: published(sklearn_tree, points, sample[:PUBLISHED_SAMPLE]),
            sklearn_build,
        ),
        "this, densities": (lambda: kernel.solve(hulls=True), kernel.build_seconds),
        "this, neighbours": (lambda: kernel.solve(hulls=False), kernel.build_seconds),
    }
    for name, (query, build) in others.items():
        contestants[name] = (partial(query, sample), build)
    timings: dict[str, list[float]] = {name: [] for name in contestants}
    for _ in range(rounds):
        for name, (work, build) in contestants.items():
            queries = PUBLISHED_SAMPLE if name == "published procedure" else len(sample)
            timings[name].append((timed(work)[1] / queries + build / len(points)) * 1e6)
    medians = {name: median(values) for name, values in timings.items()}
    for name, value in medians.items():
        print(f"  {name:28s} {value:8.2f} us a point")
    fastest = min(others, key=lambda name: medians[name])
    print(
        f"  densities: {medians['published procedure'] / medians['this, densities']:.1f}x the "
        f"published procedure; neighbours: "
        f"{medians[fastest] / medians['this, neighbours']:.1f}x the fastest, {fastest}"
    )


class Kernel:
    """The compiled kernels on a part of a map: some leaves in the middle of the tree."""

    def __init__(self, points: Points) -> None:
        self.compiled = kernels()
        rows = np.arange(len(points))
        self.tree, self.build_seconds = timed(lambda: grown_tree(points, rows))
        leaves = len(points) // LEAF_SIZE
        self.first = leaves // 3
        self.end = min(self.first + SAMPLE // LEAF_SIZE, leaves)
        self.wanted = np.ones(len(points), np.bool_)
        self.workspace = make_workspace(K)
        self.reach = np.empty(len(points))
        self.density = np.empty(len(points))

    def queries(self) -> Points:
        """Return the points of the part."""
        part = slice(self.first * LEAF_SIZE, self.end * LEAF_SIZE)
        return np.column_stack([self.tree.x[part], self.tree.y[part], self.tree.z[part]])

    def solve(self, hulls: bool) -> None:
        """Find the neighbours of all points of the part, and perhaps measure the hulls."""
        results = Results(self.reach, self.density) if hulls else Results(self.reach)
        self.compiled.solve(
            self.tree, K, self.first, self.end, self.wanted, self.workspace, results
        )


def timed(work: Callable[[], Answer]) -> tuple[Answer, float]:
    """Return what some work gives, and the seconds of processor time that it takes."""
    begin = time.process_time()
    result = work()
    return result, time.process_time() - begin


def published(tree: KDTree, points: Points, sample: Points) -> list[float]:
    """Find the neighbours and measure the hulls as the paper's code does."""
    volumes = []
    for neighbours in tree.query(sample, K)[1]:
        try:
            volumes.append(ConvexHull(points[neighbours]).volume)
        except QhullError:
            volumes.append(0.0)
    return volumes


def peers(points: Points) -> dict[str, tuple[Callable[[Points], object], float]]:
    """Return the other libraries' queries for neighbours, and their seconds to build a tree."""
    found: dict[str, tuple[Callable[[Points], object], float]] = {}

    def add(name: str, build: Callable[[], object], query: Callable[[Any, Points], object]) -> None:
        module = name.partition(" ")[2].strip("()") or name
        if find_spec(module.partition(".")[0]) is None:
            print(f"  {name}: skipped, not installed")
            return
        tree, seconds = timed(build)
        found[name] = partial(query, tree), seconds

    def build_nanoflann() -> object:
        from pynanoflann import KDTree as NanoTree  # noqa: PLC0415 (optional)

        tree = NanoTree(n_neighbors=K, metric="L2", leaf_size=20)
        tree.fit(points)
        return tree

    def build_pykdtree() -> object:
        from pykdtree.kdtree import KDTree as PyKDTree  # noqa: PLC0415 (optional)

        return PyKDTree(points)

    def build_gicp() -> object:
        import small_gicp  # noqa: PLC0415 (optional)

        return small_gicp.KdTree(points)

    add("cKDTree (scipy)", lambda: cKDTree(points), lambda tree, sample: tree.query(sample, K))
    add("pykdtree", build_pykdtree, lambda tree, sample: tree.query(sample, K))
    add("pynanoflann", build_nanoflann, lambda tree, sample: tree.kneighbors(sample))
    add("small_gicp", build_gicp, lambda tree, sample: tree.batch_knn_search(sample, K))
    return found


def scaling(count: int) -> None:
    """Print how the cost of a point grows with the map."""

    def cost(size: int, repeats: int) -> float:
        points, rows = simulated(size), np.arange(size)
        return min(timed(lambda: hull_densities(points, rows, K))[1] / size for _ in range(repeats))

    ratio = cost(count, 1) / cost(10_000, 20)
    print(f"  cost a point at {count:,} points: {ratio:.2f}x that at 10,000")


def two_threads(points: Points, rounds: int) -> None:
    """Print the gain of a second thread, by the clock; other work on the machine spoils it."""
    rows = np.arange(len(points))

    def seconds(threads: int) -> float:
        begin = time.perf_counter()
        hull_densities(points, rows, K, threads=threads)
        return time.perf_counter() - begin

    ratios = [seconds(1) / seconds(2) for _ in range(rounds)]
    print(
        f"  two threads: {median(ratios):.2f}x one (load of the machine {os.getloadavg()[0]:.1f}); "
        f"two processes that share nothing: {two_processes(len(points), rounds):.2f}x"
    )


def two_processes(count: int, rounds: int) -> float:
    """Return what the machine itself gives for a second core: twice the work by two processes."""

    def seconds(processes: int) -> float:
        command = [sys.executable, "-c", ALONE, str(count)]
        started = [
            subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
            for _ in range(processes)
        ]
        for each in started:
            assert each.stdout is not None  # a pipe
            each.stdout.readline()
        for each in started:
            assert each.stdin is not None  # a pipe
            each.stdin.write("go\n")
            each.stdin.flush()
        return max(float(each.communicate()[0]) for each in started)

    return median(2 * seconds(1) / seconds(2) for _ in range(rounds))


def peak_memory(count: int) -> None:
    """Print the peak memory of a run beyond its input, in a process of its own."""
    program = (
        "import sys, threading, time, numpy as np\n"
        "from benchmarks.density import K, resident, simulated\n"
        "from dynahull.kernels import hull_densities\n"
        f"points = simulated({count}); rows = np.arange({count})\n"
        "hull_densities(points[:1000], rows[:1000], K)\n"
        "before, peak, done = resident(), [0], threading.Event()\n"
        "def watch():\n"
        "    while not done.wait(0.01):\n"
        "        peak[0] = max(peak[0], resident())\n"
        "watcher = threading.Thread(target=watch); watcher.start()\n"
        "hull_densities(points, rows, K)\n"
        "done.set(); watcher.join()\n"
        f"print((peak[0] - before) / {count})\n"
    )
    answer = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    print(f"  peak memory beyond the input: {float(answer.stdout):.0f} bytes a point")


def resident() -> int:
    """Return the bytes of memory that this process holds now."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


def start_up() -> None:
    """Print the seconds of a first start, which compiles hulls and ground, and of a later one."""
    program = (
        "import time; begin = time.process_time()\n"
        "from dynahull.kernels.compiled_kernels import kernels; kernels()\n"
        "from dynahull.ground.slope import compile_once; compile_once()\n"
        "print(time.process_time() - begin)\n"
    )
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "NUMBA_CACHE_DIR": folder}
        seconds = [
            float(
                subprocess.run(
                    [sys.executable, "-P", "-c", program],
                    env=environment,
                    check=True,
                    capture_output=True,
                    text=True,
                ).stdout
            )
            for _ in range(4)
        ]
    print(f"  first start: {seconds[0]:.1f} s, then {min(seconds[1:]):.2f} s")


if __name__ == "__main__":
    main()
