"""The decorators of every function that is compiled into the kernels."""

from typing import Any

from numba import njit

OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "_nrt": False}
"""Of all kernels. `_nrt` is an option of Numba's own (0.68)."""

_OPTIONS = OPTIONS | {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}

compiled = njit(**_OPTIONS)
"""Compile a function for the kernels: without the interpreter's lock, and without NumPy's memory.

Counting the references to arrays would take as long as the work. So compiled functions allocate
nothing: their room is made in Python and handed in.
"""

inlined = njit(**_OPTIONS, forceinline=True)
"""Compile a function into its callers: handing all arrays over would take longer than it does."""
