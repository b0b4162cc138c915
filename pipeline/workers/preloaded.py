"""What workers have at hand as they start; imported by the process that they are forked from."""

import logging
from importlib import import_module
from pathlib import Path

import numpy as np
import pyarrow as pa

from dynahull import ground, kernels
from dynahull.compilation import is_compiled
from dynahull.ground.slope import compile_once
from dynahull.kernels.compiled_kernels import kernels as compiled_kernels
from pipeline.workers.local_dask import site_settings_aside

with site_settings_aside():
    import_module("distributed.nanny")
import_module("pipeline.tiles.stages")
# What is not compiled yet, is when it is needed.
for package, load in ((ground, compile_once), (kernels, compiled_kernels)):
    if is_compiled(Path(str(package.__file__)).parent):
        load()
# Else workers, which take this over, tell how they start and stop.
logging.getLogger("distributed").setLevel(logging.CRITICAL)
# The first conversion imports pandas, where that is installed.
pa.array(np.empty(0))
