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
    """Compile a function into the compiled ones that call it for every point, byte or column."""
    return cast(Function, numba.njit(nogil=True, forceinline=True)(function))
