"""Maps on disk: streaming readers and writers of every format.

This package knows nothing of the method, nor of Dask.
"""

from collections.abc import Callable
from pathlib import Path

code_folder: Callable[[str, str], Path | None] | None = None
"""Finds a folder for compiled code that is the user's alone, by its name and one that Numba is told
of; set by who knows of one, before modules are imported that compile. Without it each process
compiles anew."""
