"""The library that draws, imported where something is drawn."""

from typing import Any

from pipeline.errors import MissingPackageError


def drawing_library() -> Any:
    """Import Matplotlib.

    Raises
    ------
    MissingPackageError
        When it is not installed.
    """
    try:
        import matplotlib as mpl  # noqa: PLC0415 (optional, and seconds of import time)
        import matplotlib.figure  # noqa: PLC0415
    except (ImportError, OSError, RuntimeError) as error:
        raise MissingPackageError(
            f"--picture needs Matplotlib: pip install 'dynahull-pipeline[plot]' ({error})"
        ) from error
    return mpl
