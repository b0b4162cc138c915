"""The product: command line, configuration, and the run from map to cleaned map."""

import tiling
from dynahull.private_folder import private_folder

# Neither of the two packages knows of the other.
tiling.code_folder = private_folder
