"""What workers have at hand as they start; imported by the process that they are forked from."""

import laspy
import numpy as np
import pyarrow.parquet
from distributed import nanny

from dynahull.loading import load_compiled
from pipeline.tiles import stages

__all__ = ["laspy", "nanny", "pyarrow", "stages"]

load_compiled()

# The first conversion imports pandas, where that is installed.
pyarrow.array(np.empty(0))
