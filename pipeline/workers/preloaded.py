"""What workers have at hand as they start; imported by the process that they are forked from."""

import gc
import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module

import numpy as np

from pipeline.tiles.local_dask import site_settings_aside

_NEEDED = ("distributed.nanny", "lazrs", "pyarrow.parquet", "pipeline.tiles.stages")


def _load() -> None:
    """Import what tasks use, and load the compiled code that is kept."""
    with site_settings_aside():
        for name in _NEEDED:
            import_module(name)
    # numba looks whether SciPy brings a BLAS for `np.cov`, and nothing else here needs it.
    with _without("scipy.linalg"):
        import_module("dynahull.loading").load_compiled()
    # Else workers, which take this over, tell how they start and stop.
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    # The first conversion imports pandas, where that is installed.
    import_module("pyarrow").array(np.empty(0))


@contextmanager
def _without(name: str) -> Iterator[None]:
    """Let a package that is not yet imported seem not to be installed in this block."""
    hidden = name not in sys.modules
    if hidden:
        sys.modules[name] = None  # type: ignore[assignment]
    try:
        yield
    finally:
        if hidden:
            del sys.modules[name]


# Nothing of this goes away again: to look for garbage takes a sixth of the time.
gc.disable()
_load()
gc.freeze()
gc.enable()
