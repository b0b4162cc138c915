"""One field of every point of a map as numbers, such as a label."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tiling.errors import MapFormatError
from tiling.formats import open_map


def field_values(path: Path, name: str) -> Iterator[NDArray[np.generic]]:
    """Yield the values of one field, in the order of the points, as arrays that follow each other.

    Parameters
    ----------
    path : Path
    name : str
        A field with one number a point, as the file names it.

    Yields
    ------
    (n,) array
        Of numbers or booleans.

    Raises
    ------
    MapFormatError
        When the map has no such field, when it is not of numbers, or when the map's fields cannot
        be read apart.
    """
    reader = open_map(path)
    fields = {field.name: field for field in reader.description.fields}
    if name not in fields:
        found = f"only {', '.join(fields) or 'none'}"
        raise MapFormatError(path, f"a field {name!r}", found)
    if fields[name].count != 1:
        raise MapFormatError(path, f"one {name} a point", f"{fields[name].count}")
    for batch in reader.batches():
        values = reader.values(batch.records, name)
        if values.dtype.kind not in "biuf":
            raise MapFormatError(path, f"numbers in the field {name}", str(values.dtype))
        yield values
