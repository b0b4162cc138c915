"""The decorator of every function that is compiled into the kernels."""

from numba import njit

compiled = njit(
    nogil=True, error_model="numpy", _nrt=False, no_cpython_wrapper=True, no_cfunc_wrapper=True
)
"""Compile a function for the kernels: without the interpreter's lock, and without NumPy's memory.

Counting the references to arrays would take as long as the work. So compiled functions allocate
nothing: their room is made in Python and handed in.
"""
