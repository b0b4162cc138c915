"""What takes a second to load, loaded ahead of its use, while there is time."""

from importlib import import_module
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


def load_libraries() -> None:
    """Load the library that clusters are fitted with, and the compiled code that is kept."""
    load_compiled()
    import_module("sklearn.cluster")
