"""What only shows results never fails a run: reports, pictures, pages, bars; and names in them."""

import logging
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

from dynahull.extras import install_command
from pipeline.errors import MissingPackageError, OutputError, PipelineError
from tiling.foreign_text import escaped
from tiling.output_file import atomic_file

printable = escaped
"""Names of files, and what they hold, as text that any terminal and page can show."""

logger = logging.getLogger("dynahull")


@contextmanager
def only_showing(what: str, warn: Callable[[str], None]) -> Iterator[None]:
    """Go on after a block that fails, with a warning in one line of what it was to make."""
    try:
        yield
    except Exception as error:
        reason = " ".join(str(error).split())
        logger.debug("%s", what, exc_info=True)
        warn(
            f"{what} could not be made ({type(error).__name__}: {printable(reason):.200}); "
            "the results are whole without it"
        )


def is_text(name: str | Path) -> bool:
    """Tell whether a name is UTF-8, or can be written as such."""
    try:
        str(name).encode()
    except UnicodeEncodeError:
        return False
    return True


def check_named_file(path: Path, suffix: str, inputs: Iterable[Path] = ()) -> None:
    """Refuse, before any work, a file that cannot be written or that is read.

    It must be named by its suffix, which no map has, so that no map is ever written over.

    Parameters
    ----------
    suffix : str
        With the dot.
    inputs : iterable of Path
        What is read, by any name.

    Raises
    ------
    OutputError
    """
    folder = path.absolute().parent
    if not is_text(path):
        raise OutputError(f"{printable(path)}: expected a name that is UTF-8")
    if not folder.is_dir():
        raise OutputError(f"{path}: expected a folder to write in, found none")
    if not os.access(folder, os.W_OK):
        raise OutputError(f"{path}: its folder cannot be written into")
    if path.suffix.lower() != suffix:
        raise OutputError(f"{path}: expected a name that ends in {suffix}")
    if path.exists() and not path.is_file():
        raise OutputError(f"{path}: expected a file, found something else")
    if path.exists() and any(each.exists() and each.samefile(path) for each in inputs):
        raise OutputError(f"{path}: this is what is read; choose another name")


@contextmanager
def named_file(path: Path) -> Iterator[Path]:
    """Write a file that was asked for by its name, and is replaced when it is complete.

    Raises
    ------
    OutputError
        When it cannot be written.
    """
    try:
        with atomic_file(path) as temporary:
            yield temporary
    except OSError as error:
        raise OutputError(f"{path}: {error.strerror or error}") from error


def drawable(picture: Path | None, warn: Callable[[str], None]) -> Path | None:
    """Return where to draw a picture, before any work; None, with a warning, where none can be."""
    if picture is not None:
        try:
            drawing_library()
        except MissingPackageError as error:
            warn(f"{error}; {printable(picture)} is left out")
            return None
    return picture


def drawing_library() -> Any:
    """Import Matplotlib; see `optional_package`."""
    modules = ("matplotlib", "matplotlib.figure")
    return optional_package("--picture needs Matplotlib", "plot", "matplotlib", *modules)


def optional_package(
    need: str,
    extra: str,
    package: str,
    *modules: str,
    refusal: type[PipelineError] = MissingPackageError,
) -> Any:
    """Import modules of an optional package, which may take seconds, and return the first.

    Raises
    ------
    MissingPackageError
        Or another refusal, when it is not installed, or something that it needs is not.
    """
    try:
        first, *_ = [import_module(module) for module in modules]
    except (ImportError, OSError, RuntimeError) as error:
        raise refusal(f"{need}: {install_command(extra, package)} ({error})") from error
    return first
