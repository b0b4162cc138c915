"""What is made by a thread while this one does something else."""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

_Item = TypeVar("_Item")


def begun(make: Callable[[], _Item]) -> Callable[[], _Item]:
    """Let a thread make something, and return what gives it, or raises what that raised."""
    thread = ThreadPoolExecutor(1)
    coming = thread.submit(make)
    thread.shutdown(wait=False)
    return coming.result


def made_ahead(items: Iterable[_Item]) -> Iterator[_Item]:
    """Yield the items of a stream, of which a thread makes one ahead.

    Parameters
    ----------
    items : iterable
        Used by that thread only. What it raises is raised here, in its place.
    """
    iterator = iter(items)
    ended = object()
    with ThreadPoolExecutor(1) as thread:
        coming = thread.submit(next, iterator, ended)
        while (item := coming.result()) is not ended:
            coming = thread.submit(next, iterator, ended)
            yield item  # type: ignore[misc]  # the end is no item
