"""Text that comes from files or their names, made fit for one line of a terminal or a log."""

import os
from pathlib import Path

LONGEST_FOREIGN = 200
"""Characters of a name, or of what a file holds, that a message quotes."""

LONGEST_MESSAGE = 399
"""Characters of a whole message about a file."""

LONGEST_LINE = 4_000
"""Characters of any line that is said, such as one about several files."""

_CUT = "..."


def printable(text: object, most: int = LONGEST_FOREIGN) -> str:
    """Return what `str` says of anything, as one line without control characters, cut if too long.

    Escape sequences, line ends, marks that turn the direction of writing, and bytes of file names
    that are no text are written out: see `escaped`.
    """
    line = escaped(str(text)[: most + 1])
    return line if len(line) <= most else line[: most - len(_CUT)] + _CUT


def escaped(name: str | Path) -> str:
    r"""Return a name, or other text that is not ours, as text that any terminal and file takes.

    Bytes of names that are not UTF-8 become `\xff`, and so do control characters.
    """
    try:
        text = os.fsencode(name).decode("utf-8", "backslashreplace")
    except UnicodeEncodeError:  # not a name: half a surrogate pair
        text = str(name).encode("utf-8", "backslashreplace").decode()
    return "".join(
        each if each.isprintable() else each.encode("unicode_escape").decode() for each in text
    )


def printable_path(path: object) -> str:
    """Return a path as `printable` does; of one that is too long the end, which tells most."""
    line = str(path)
    if len(line) > LONGEST_FOREIGN:
        line = _CUT + line[len(_CUT) - LONGEST_FOREIGN :]
    return printable(line)
