"""Which fields of a format with free field names are the coordinates."""

from collections.abc import Collection

COORDINATES = ("x", "y", "z")


def coordinate_names(names: Collection[str]) -> tuple[str, str, str] | None:
    """Find the fields that hold the coordinates.

    Parameters
    ----------
    names : collection of str
        The names of all fields.

    Returns
    -------
    tuple of str or None
        `("x", "y", "z")` where there are such fields, else `("X", "Y", "Z")`, else None.
    """
    for x, y, z in (COORDINATES, ("X", "Y", "Z")):
        if x in names and y in names and z in names:
            return x, y, z
    return None
