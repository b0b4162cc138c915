"""The densities of a cluster, from the compiled kernels."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynahull.density import SPREAD_COLUMNS
from dynahull.errors import InvalidParametersError, InvalidPointsError
from dynahull.kernels.compiled_kernels import grown_tree, kernels
from dynahull.kernels.solve import Results, Workspace, make_workspace
from dynahull.kernels.tree import LEAF_SIZE
from dynahull.kernels.vectors import INDEX_BITS
from dynahull.reference import reference_densities

_LEAVES_AT_A_TIME = 128
_FEWEST = 4
_MOST = 2**32 - 1  # positions in the tree are 32 bits
_MOST_NEIGHBOURS = 2**INDEX_BITS
_LARGEST = 1e150  # squares of differences stay finite


@dataclass(frozen=True, slots=True)
class HullDensities:
    """What is known of every point of a cluster.

    Attributes
    ----------
    density : (n,) float64 array
        k / v in points per cubic unit; infinite where the hull has no volume; NaN where the point
        was not a query.
    squared_reach : (n,) float64 array
        Squared distance of the k-th neighbour, `(dx dx + dy dy) + dz dz` in float64; NaN where
        the point was not a query. Points missing beyond a plane `x = b` change nothing as long as
        it is smaller than the square of `b - x`, to the last bit.
    spread : (n, SPREAD_COLUMNS) or (n, 0) float32 array
        How the neighbourhood is spread, if asked for: see `dynahull.kernels.spread`; NaN where the
        point was not a query.
    """

    density: NDArray[np.float64]
    squared_reach: NDArray[np.float64]
    spread: NDArray[np.float32]


def hull_densities(
    points: NDArray[np.float64],
    rows: NDArray[np.int64],
    k: int,
    *,
    queries: NDArray[np.bool_] | None = None,
    threads: int = 1,
    on_progress: Callable[[int], None] | None = None,
    spread: bool = False,
) -> HullDensities:
    """Compute the density k / v of the points of one cluster (Section III-C of the paper).

    v is the volume of the convex hull of the k nearest points, the point itself included; ties of
    distance go to the smaller row number. It is zero where the points are flat, by
    `FLATNESS` of `dynahull.reference`. The result for a point is a function of the coordinates
    of its neighbours in their order, to the last bit: whatever else is in the cluster, however it
    is ordered, and whichever points are queries.

    Parameters
    ----------
    points : (n, 3) float64 array
        Finite coordinates.
    rows : (n,) int64 array
        Row numbers, distinct.
    k : int
        Neighbours; n where it is more.
    queries : (n,) bool array, optional
        The points whose densities are wanted; the others serve as neighbours. All by default.
    threads : int
        Threads that share the work.
    on_progress : callable, optional
        Told, in the calling thread, of each number of points done (queries or not) since the last
        call.
    spread : bool
        Measure how each neighbourhood is spread as well.

    Raises
    ------
    InvalidPointsError
        When there are fewer than four points, or they are not finite, or too large to square.
    InvalidParametersError
        When `k` is less than four or more than 16,384, or `threads` less than one.
    """
    density = np.full(len(points), np.nan)
    columns = SPREAD_COLUMNS if spread else 0
    spreads = np.full((len(points), columns), np.nan, np.float32)
    results = Results(np.full(len(points), np.nan), density, spread=spreads)
    wanted = np.ones(len(points), np.bool_) if queries is None else np.ascontiguousarray(queries)
    _solve(points, rows, k, results, wanted, threads, on_progress)
    # What no wrapping could be certified for, next to nothing, the plain version measures.
    left = np.flatnonzero(wanted & np.isnan(density))
    density[left] = reference_densities(points, rows, k, centres=points[left])
    return HullDensities(density, results.squared_reach, spreads)


def nearest_rows(
    points: NDArray[np.float64], rows: NDArray[np.int64], k: int, *, threads: int = 1
) -> NDArray[np.int64]:
    """Return the row numbers of the k nearest points of every point, in their order.

    Parameters and errors are those of `hull_densities`.

    Returns
    -------
    (n, min(k, n)) int64 array
        Ordered by (squared distance, row number).
    """
    count = len(points)
    results = Results(np.empty(count), neighbours=np.empty((count, min(k, count)), np.int64))
    _solve(points, rows, k, results, np.ones(count, np.bool_), threads)
    return results.neighbours


def squared_reaches(
    points: NDArray[np.float64], rows: NDArray[np.int64], k: int, *, threads: int = 1
) -> NDArray[np.float64]:
    """Return the squared distance of every point's k-th neighbour, without any hull.

    Parameters and errors are those of `hull_densities`.
    """
    results = Results(np.empty(len(points)))
    _solve(points, rows, k, results, np.ones(len(points), np.bool_), threads)
    return results.squared_reach


def _solve(
    points: NDArray[np.float64],
    rows: NDArray[np.int64],
    k: int,
    results: Results,
    wanted: NDArray[np.bool_],
    threads: int,
    on_progress: Callable[[int], None] | None = None,
) -> None:
    """Fill in what there is room for, where it is wanted, (n,)."""
    _check(points, rows, k, wanted, threads)
    count = len(points)
    k = min(k, count)
    leaves = -(-count // LEAF_SIZE)
    tree, compiled = grown_tree(points, rows), kernels()
    workspaces: list[Workspace] = []  # not in use

    def solve_leaves(first: int) -> int:
        end = min(first + _LEAVES_AT_A_TIME, leaves)
        workspace = workspaces.pop() if workspaces else make_workspace(k)
        compiled.solve(tree, k, first, end, wanted, workspace, results)
        workspaces.append(workspace)
        return min(end * LEAF_SIZE, count) - first * LEAF_SIZE

    _share_out(solve_leaves, range(0, leaves, _LEAVES_AT_A_TIME), threads, on_progress)


def _check(
    points: NDArray[np.float64],
    rows: NDArray[np.int64],
    k: int,
    queries: NDArray[np.bool_],
    threads: int,
) -> None:
    if points.ndim != 2 or points.shape[1] != 3:
        raise InvalidPointsError(f"points: expected an (n, 3) array, found shape {points.shape}")
    count = len(points)
    if not _FEWEST <= count <= _MOST:
        raise InvalidPointsError(
            f"points: expected {_FEWEST} to {_MOST} of them, found {count}: fewer have no hull"
        )
    # A NaN fails any comparison; minimum and maximum need no array of their own.
    if not (points.min() >= -_LARGEST and points.max() <= _LARGEST):
        raise InvalidPointsError(f"points: expected finite coordinates up to {_LARGEST:g}")
    if rows.shape != (count,):
        raise InvalidPointsError(f"rows: expected one for each point, found shape {rows.shape}")
    if queries.shape != (count,):
        raise InvalidPointsError(f"queries: expected one a point, found shape {queries.shape}")
    if k < _FEWEST:
        raise InvalidParametersError(f"k: expected at least {_FEWEST} neighbours, found {k}")
    if min(k, count) > _MOST_NEIGHBOURS:
        raise InvalidParametersError(f"k: expected at most {_MOST_NEIGHBOURS}, found {k}")
    if threads < 1:
        raise InvalidParametersError(f"threads: expected at least 1, found {threads}")


def _share_out(
    work: Callable[[int], int],
    parts: range,
    threads: int,
    on_progress: Callable[[int], None] | None,
) -> None:
    """Do all parts, in as many threads; report in this one."""
    tell = on_progress or (lambda done: None)
    if threads == 1:
        for part in parts:
            tell(work(part))
        return
    with ThreadPoolExecutor(threads) as pool:
        try:
            for done in pool.map(work, parts):
                tell(done)
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
