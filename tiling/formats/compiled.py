"""Loops over single bytes, points or columns, compiled by Numba, where NumPy has none for them."""

from collections.abc import Callable
from typing import TypeVar, cast

from numba import njit

Function = TypeVar("Function", bound=Callable[..., object])


def compiled(function: Function) -> Function:
    """Compile a function on its first call, and keep the machine code for later processes.

    The code is kept beside the module or in the user's cache. Where neither can be written to
    (an installed container image run by a user with no home), each process compiles anew.
    """
    try:
        return cast(Function, njit(cache=True, nogil=True)(function))
    except RuntimeError:
        return cast(Function, njit(nogil=True)(function))


def helper(function: Function) -> Function:
    """Compile a function that compiled ones call for every point, byte or column.

    It allocates nothing: so the references to the arrays handed to it need not be counted, which
    would take several times as long as what it does.
    """
    return cast(Function, njit(nogil=True, _nrt=False)(function))
