"""The compiled kernels, made once for a machine; see `dynahull.compilation`."""

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from threading import Lock
from typing import NamedTuple

import numba
import numpy as np

from dynahull.compilation import compiling, numba_cache
from dynahull.kernels import closest, solve
from dynahull.kernels.build import make_tree_workspace
from dynahull.kernels.compiled import OPTIONS
from dynahull.kernels.solve import Results, make_workspace
from dynahull.kernels.tree import make_stack, make_tree

_ONE_AT_A_TIME = Lock()


class Kernels(NamedTuple):
    """The compiled functions; see `dynahull.kernels.solve` and `.closest` for their parameters."""

    build: Callable[..., None]
    solve: Callable[..., None]
    find: Callable[..., None]


def kernels() -> Kernels:
    """Return the compiled kernels, compiling them if nobody has on this kind of machine."""
    with _ONE_AT_A_TIME:
        return _kernels()


@lru_cache(maxsize=1)
def _kernels() -> Kernels:
    with (
        compiling("the density kernels", Path(__file__).parent) as folder,
        numba_cache(folder),
    ):
        return _compile(cached=folder is not None)


def _compile(cached: bool) -> Kernels:
    tree, rows, tree_workspace, workspace = (
        make_tree(np.zeros((4, 3))),
        np.zeros(4, np.int64),
        make_tree_workspace(),
        make_workspace(4),
    )
    results = Results(
        np.zeros(4), np.zeros(4), np.zeros((4, 4), np.int64), np.zeros((4, 5), np.float32)
    )
    queries = np.zeros(4, np.bool_)
    build_types = [numba.typeof(value) for value in (tree, rows, tree_workspace)]
    solve_types = [numba.typeof(value) for value in (tree, 4, 0, 1, queries, workspace, results)]
    places = np.zeros((1, 3)), 0, 1, make_stack(), np.empty(64), np.zeros(1), rows
    find_types = [numba.typeof(value) for value in (tree, *places)]
    options = OPTIONS | {"cache": cached}
    return Kernels(
        numba.njit(numba.void(*build_types), **options)(solve.build),
        numba.njit(numba.void(*solve_types), **options)(solve.solve),
        numba.njit(numba.void(*find_types), **options)(closest.find),
    )
