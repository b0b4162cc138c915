"""How right the hulls are: volumes of every map's neighbourhoods against Qhull.

Takes points of each map by chance, and prints the largest difference of their volumes from
`scipy.spatial.ConvexHull(..., qhull_options="Qt")`, relative to these:

    python -m benchmarks.volumes [--maps ../shared/data/maps] [--points 1500]

Points with a tie at the k-th distance are left out: which neighbours they have is a rule of this
package, not of geometry. Qhull does not do flat neighbourhoods; they are counted apart.
"""

import argparse
from datetime import date
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, KDTree, QhullError

from benchmarks.density import machine
from dynahull.kernels import hull_densities
from tiling.collection import MapCollection, find_map_files

K = 75
MOST = 2_000_000
"""Points read of a map: the others change the neighbours of those at the end, not the check."""


def main() -> None:
    """Compare all maps, and print a line for each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--maps", type=Path, default=Path("../shared/data/maps"))
    parser.add_argument("--points", type=int, default=1_500)
    arguments = parser.parse_args()
    print(f"{date.today()}, {machine()}")
    for path in sorted(arguments.maps.iterdir()):
        if path.suffix == ".txt":
            continue
        points = read(path)
        compared, flat, worst = compare(points, arguments.points)
        print(f"{path.name:32s} {compared:6d} compared, {flat:4d} flat, worst {worst:.1e}")


def read(path: Path) -> NDArray[np.float64]:
    """Return finite points of a map."""
    parts: list[NDArray[np.float64]] = []
    for _, batch in MapCollection(find_map_files([path])).batches(500_000):
        parts.append(batch.xyz[np.isfinite(batch.xyz).all(axis=1)])
        if sum(map(len, parts)) >= MOST:
            break
    return np.concatenate(parts)[:MOST]


def compare(points: NDArray[np.float64], count: int) -> tuple[int, int, float]:
    """Return how many volumes were compared, how many were flat, and the largest difference."""
    rows = np.arange(len(points))
    chosen = np.random.default_rng(0).choice(len(points), min(count, len(points)), replace=False)
    density = hull_densities(points, rows, K, queries=np.isin(rows, chosen)).density
    distance, neighbours = map(np.asarray, KDTree(points).query(points[chosen], K + 1))
    tie_free = distance[:, K - 1] * (1 + 1e-9) < distance[:, K]
    compared, flat, worst = 0, 0, 0.0
    for at, around in zip(chosen[tie_free], neighbours[tie_free, :K], strict=True):
        if np.isinf(density[at]):
            flat += 1
            continue
        try:
            expected = ConvexHull(points[around] - points[at], qhull_options="Qt").volume
        except QhullError:
            flat += 1
            continue
        compared += 1
        worst = max(worst, abs(K / density[at] - expected) / expected)
    return compared, flat, worst


if __name__ == "__main__":
    main()
