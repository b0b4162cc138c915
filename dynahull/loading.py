"""The compiled code that is kept, loaded before it is used."""

from pathlib import Path

from dynahull import ground, kernels
from dynahull.compilation import is_compiled
from dynahull.ground.slope import compile_once
from dynahull.kernels.compilation import kernels as compiled_kernels


def load_compiled() -> None:
    """Load the compiled code that is kept; what is not yet, is compiled when it is needed."""
    for package, load in ((ground, compile_once), (kernels, compiled_kernels)):
        if is_compiled(Path(str(package.__file__)).parent):
            load()
