"""The returns of all scans, in a folder: gathered from what parts of the map say of them."""

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from dynahull.evidence.range_images import Returns
from pipeline.work.files import make_rows, map_array, open_rows, write_arrays
from tiling.ledger import note_file
from tiling.output_file import atomic_file

_RETURNS, _COUNTS = "images.rows", "images.arrays"


def gather(folder: Path, scans: int, parts: Callable[[], Iterable[Returns]]) -> None:
    """Write the returns of all parts, scan after scan, in bounded memory; it asks for them twice.

    Parameters
    ----------
    scans : int
        Range images that there are.
    parts : callable
        Returns what the parts say, one after the other.
    """
    counts = np.zeros(scans, np.int64)
    for part in parts():
        counts += part.counts
    with atomic_file(folder / _COUNTS) as temporary:
        write_arrays(temporary, {}, {"counts": counts})
    make_rows(folder / _RETURNS, int(counts.sum()), np.uint32, 0)
    returns = open_rows(folder / _RETURNS, np.uint32, "r+")
    Returns(counts, returns).take(parts())
    if isinstance(returns, np.memmap):
        returns.flush()
    note_file(folder / _RETURNS)


def kept_returns(folder: Path) -> Returns:
    """Return what was gathered; the system reads what is looked at."""
    # Not "r": compiled code would be compiled once more for arrays that are read only.
    returns = np.asarray(open_rows(folder / _RETURNS, np.uint32, "c"))
    return Returns(map_array(folder / _COUNTS, "counts"), returns)
