"""Loops over single bytes, points or columns, compiled by Numba, where NumPy has none for them."""

import os
from collections.abc import Callable
from typing import TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., object])


def compiled(function: Function) -> Function:
    """Compile a function on its first call, and keep the machine code for later processes.

    Numba keeps it in `$NUMBA_CACHE_DIR`, beside the source or in the user's cache. Where it can be
    in none (an installed container image run by a user with no home), each process compiles anew.
    """
    # Without a home, Numba would take the current folder for one.
    has_home = os.path.isabs(os.path.expanduser("~"))  # noqa: PTH111, PTH117
    try:
        return cast(Function, numba.njit(cache=has_home, nogil=True)(function))
    except RuntimeError:
        return cast(Function, numba.njit(nogil=True)(function))


def helper(function: Function) -> Function:
    """Compile a function that compiled ones call for every point, byte or column.

    It allocates nothing: so the references to the arrays handed to it need not be counted, which
    would take several times as long as what it does. `_nrt` is an option of Numba's own (0.68).
    """
    return cast(Function, numba.njit(nogil=True, _nrt=False)(function))
