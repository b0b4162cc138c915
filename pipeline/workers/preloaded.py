"""What workers have at hand as they start; imported by the process that they are forked from."""

import logging
from importlib import import_module

import numpy as np

from pipeline.tiles.local_dask import site_settings_aside

_NEEDED = ("distributed.nanny", "lazrs", "pyarrow.parquet", "pipeline.tiles.stages")


def _load() -> None:
    """Import what tasks use, and load the compiled code that is kept."""
    with site_settings_aside():
        for name in _NEEDED:
            import_module(name)
    import_module("dynahull.loading").load_compiled()
    # Else workers, which take this over, tell how they start and stop.
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    # The first conversion imports pandas, where that is installed.
    import_module("pyarrow").array(np.empty(0))


_load()
