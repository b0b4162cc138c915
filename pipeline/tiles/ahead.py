"""A stream whose next item is made while the present one is used."""

from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

_Item = TypeVar("_Item")


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
