"""What workers have at hand as they start; imported by the process that they are forked from."""

import logging
from importlib import import_module

import numpy as np
import pyarrow as pa

from dynahull.loading import load_compiled
from pipeline.workers.local_dask import site_settings_aside

with site_settings_aside():
    import_module("distributed.nanny")
import_module("pipeline.tiles.stages")
load_compiled()
# Else workers, which take this over, tell how they start and stop.
logging.getLogger("distributed").setLevel(logging.CRITICAL)
# The first conversion imports pandas, where that is installed.
pa.array(np.empty(0))
