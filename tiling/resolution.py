"""The step between two neighbouring coordinates that a file can keep, where the points lie.

float32 has 24 bits: at 131 km from the origin they are 1.6 cm apart, at 6,675 km, as in UTM, half a
metre. LAS says its step itself.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from tiling.collection import MapCollection
from tiling.formats.base import MapReader
from tiling.formats.points import coordinate_names, only_finite

COARSE = 0.01
"""Metres. The method measures the room that 75 neighbours take, which are centimetres apart: a
step of more than one centimetre shows in their densities. LAS is often kept on just that grid."""

_LOOKED_AT = 1000
_SHORT_FLOATS = ("float16", "float32")


def typical_place(xyz: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the median distance of points from the origin along each axis, (3,).

    A few strays, or invalid points at the origin, do not move it. Points that are not finite do
    not count; 0 where there are no others.
    """
    finite = only_finite(xyz)
    return np.median(np.abs(finite), axis=0) if len(finite) else np.zeros(3)


def coarse_step_notes(
    collection: MapCollection, place: NDArray[np.float64], metres: NDArray[np.float64] | None = None
) -> list[str]:
    """Say in which steps coordinates are kept, where these are coarse.

    Parameters
    ----------
    place : (3,) float64 array
        Where the points lie, metres from the origin, see `typical_place`. Scans with poses lie
        around their own origin, whatever it says.
    metres : (3,) float64 array, optional
        In a unit of the files, along each axis; 1 by default.

    Returns
    -------
    list of str
        A sentence for each kind of step, once, whatever the number of files.
    """
    unit = np.ones(3) if metres is None else metres
    found: dict[tuple[float, str], dict[str, None]] = {}
    place = place * (not collection.is_moved)
    for reader in collection.readers:
        for axis, step, why in _coarse_steps(reader, place / unit, unit):
            found.setdefault((step, why), {})[axis] = None
    return [
        f"The file keeps {', '.join(axes)} in steps of {step:.3g} m ({why}): neighbours are "
        "centimetres apart, so densities show the steps more than the surfaces."
        for (step, why), axes in found.items()
    ]


def _coarse_steps(
    reader: MapReader, place: NDArray[np.float64], unit: NDArray[np.float64]
) -> Iterator[tuple[str, float, str]]:
    """Yield axis, step in metres and reason, where it is coarse; `place` is in the file's units."""
    description = reader.description
    if description.grid is not None:
        for axis, scale, size in zip("xyz", description.grid.scales, unit.tolist(), strict=True):
            if abs(scale) * size > COARSE:
                yield axis, abs(scale) * size, "the scale in its header"
        return
    types = {field.name: field.dtype for field in reversed(description.fields)}
    kinds = [types[name] for name in coordinate_names(types) or ()] or [""] * 3
    for axis, kind, distance, size in zip("xyz", kinds, place.tolist(), unit.tolist(), strict=True):
        if kind not in _SHORT_FLOATS:
            continue
        with np.errstate(over="ignore", invalid="ignore"):
            step = size * float(np.spacing(np.dtype(kind).type(distance)))
        if step > COARSE and _is_rounded(reader, kind):
            yield axis, step, f"{kind} at {distance:,.0f} m from the origin"


def _is_rounded(reader: MapReader, kind: str) -> bool:
    """Tell whether coordinates are of the type declared: text may have more digits."""
    if "ascii" not in reader.description.format:
        return True
    first = next(reader.batches(_LOOKED_AT), None)
    if first is None:
        return False
    finite = only_finite(first.xyz)
    return bool((finite.astype(kind) == finite).all())
