"""What only shows results never fails a run: reports, pictures, pages, bars; and names in them."""

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from tiling.foreign_text import escaped as printable

__all__ = ["is_text", "only_showing", "printable"]

logger = logging.getLogger("dynahull")


@contextmanager
def only_showing(what: str, warn: Callable[[str], None]) -> Iterator[None]:
    """Go on after a block that fails, with a warning.

    Parameters
    ----------
    what : str
        What the block makes.
    warn : callable
        Told of the failure, in one line.
    """
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
