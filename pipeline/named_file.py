"""A single file that the user names to be written: a picture, a table of figures, a recording."""

import os
from collections.abc import Iterable
from pathlib import Path

from pipeline.errors import OutputError
from pipeline.showing import is_text, printable


def check_named_file(path: Path, suffix: str, inputs: Iterable[Path] = ()) -> None:
    """Refuse, before any work, a file that cannot be written or that is read.

    It must be named by its suffix, which no map has, so that no map is ever written over.

    Parameters
    ----------
    path : Path
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
