"""Loops over single bytes, points or columns, compiled by Numba, where NumPy has none for them."""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

import tiling

Function = TypeVar("Function", bound=Callable[..., object])


def compiled(function: Function) -> Function:
    """Compile a function on its first call, and keep the machine code for later processes.

    It is kept in a folder that is the user's alone, see `tiling.code_folder`, where there is one.
    """
    config: Any = numba.config
    before = config.CACHE_DIR
    folder = tiling.code_folder("formats", str(before)) if tiling.code_folder else None
    config.CACHE_DIR = before if folder is None else str(folder)  # numba looks at it here
    try:
        return cast(Function, numba.njit(cache=folder is not None, nogil=True)(function))
    finally:
        config.CACHE_DIR = before


def helper(function: Function) -> Function:
    """Compile a function that compiled ones call for every point, byte or column.

    It allocates nothing: so the references to the arrays handed to it need not be counted, which
    would take several times as long as what it does. `_nrt` is an option of Numba's own (0.68).
    """
    return cast(Function, numba.njit(nogil=True, _nrt=False)(function))
