"""What workers have at hand as they start; imported by the process that they are forked from."""

import gc
from importlib import import_module

import numpy as np

_NEEDED = ("distributed.nanny", "lazrs", "pyarrow.parquet", "pipeline.tiles.stages")


def _load() -> None:
    """Import what tasks use, and load the compiled code that is kept."""
    for name in _NEEDED:
        import_module(name)
    import_module("dynahull.loading").load_compiled()
    # The first conversion imports pandas, where that is installed.
    import_module("pyarrow").array(np.empty(0))


# Nothing of this goes away again: to look for garbage takes a sixth of the time.
gc.disable()
_load()
gc.freeze()
gc.enable()
