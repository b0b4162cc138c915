"""The compiled kernels, made once for a machine; see `dynahull.compilation`."""

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from threading import Lock
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from dynahull.compilation import compiling, numba_cache
from dynahull.kernels import build, closest, solve
from dynahull.kernels.decorators import OPTIONS
from dynahull.kernels.solve import Results, make_workspace
from dynahull.kernels.tree import Tree, make_tree, make_walk

_ONE_AT_A_TIME = Lock()


class Kernels(NamedTuple):
    """The compiled functions; see the modules of their names, and `closest`, for parameters."""

    build: Callable[..., None]
    solve: Callable[..., None]
    find: Callable[..., None]


def kernels() -> Kernels:
    """Return the compiled kernels, compiling them if nobody has on this kind of machine."""
    with _ONE_AT_A_TIME:
        return _kernels()


def grown_tree(points: NDArray[np.float64], rows: NDArray[np.int64]) -> Tree:
    """Copy points, (n, 3), into kd-tree order, and measure the boxes."""
    tree, rows = make_tree(points), np.require(rows, np.int64, ["C", "W"])
    kernels().build(tree, rows, make_walk())
    return tree


@lru_cache(maxsize=1)
def _kernels() -> Kernels:
    with (
        compiling("the density kernels", Path(__file__).parent) as folder,
        numba_cache(folder),
    ):
        return _compile(cached=folder is not None)


def _compile(cached: bool) -> Kernels:
    tree, rows, walk = make_tree(np.zeros((4, 3))), np.zeros(4, np.int64), make_walk()
    queries, workspace, results = np.zeros(4, np.bool_), make_workspace(4), Results(np.zeros(4))

    def compile_for(function: Callable[..., None], *arguments: Any) -> Any:
        signature = numba.void(*map(numba.typeof, arguments))
        return numba.njit(signature, **OPTIONS, cache=cached)(function)

    return Kernels(
        compile_for(build.build, tree, rows, walk),
        compile_for(solve.solve, tree, 4, 0, 1, queries, workspace, results),
        compile_for(closest.find, tree, np.zeros((1, 3)), 0, 1, walk, np.zeros(1), rows),
    )
