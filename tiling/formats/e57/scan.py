"""One scan of an E57 file: its fields, its pose, and its points in the frame of the map."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tiling.errors import MapFormatError
from tiling.formats.e57.tree import children, member, node, number

_CARTESIAN = ("cartesianX", "cartesianY", "cartesianZ")
_SPHERICAL = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
_INVALID = {_CARTESIAN: "cartesianInvalidState", _SPHERICAL: "sphericalInvalidState"}
_MOST_FIELDS = 1000


@dataclass(frozen=True, slots=True)
class ScanField:
    """A field of every point."""

    name: str
    dtype: str
    """`"<f4"`, `"<f8"` or, of integers that may be scaled, `"<i8"`."""
    bits: float
    """That a value takes in the file."""
    scale: float = 1.0
    offset: float = 0.0
    """What a stored integer is multiplied by, and what is added."""

    def scaled(self, values: NDArray[Any]) -> NDArray[np.float64]:
        """Return what stored values stand for."""
        whole = values.astype(np.float64)
        return whole * self.scale + self.offset if self.dtype == "<i8" else whole


@dataclass(frozen=True, slots=True)
class Scan:
    """What is known of a scan before its points are read."""

    number: int
    count: int
    """Points."""
    fields: tuple[ScanField, ...]
    rotation: tuple[tuple[float, float, float], ...] | None
    translation: tuple[float, float, float] | None
    """From the scan to the map, (3, 3) and (3,); None where the file has none."""
    grouped: bool
    """Whether its points are grouped by lines."""

    @property
    def dtype(self) -> np.dtype:
        """Of a point's record."""
        return np.dtype([(field.name, field.dtype) for field in self.fields])

    @property
    def pose(self) -> tuple[float, ...]:
        """The matrix from the scan to the map, (3, 4), row by row."""
        rotation = self.rotation or ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
        rows = zip(rotation, self.translation or (0.0, 0.0, 0.0), strict=True)
        return tuple(value for turn, shift in rows for value in (*turn, shift))

    @property
    def _axes(self) -> tuple[str, str, str]:
        names = {field.name for field in self.fields}
        return _CARTESIAN if names.issuperset(_CARTESIAN) else _SPHERICAL

    def coordinates(self, records: NDArray[Any]) -> NDArray[np.float64]:
        """Return coordinates in the frame of the map, (n, 3); those of invalid points are NaN."""
        by_name = {field.name: field for field in self.fields}
        x, y, z = (by_name[name].scaled(records[name]) for name in self._axes)
        with np.errstate(all="ignore"):
            if self._axes == _SPHERICAL:
                distance, azimuth, elevation = x, y, z
                across = distance * np.cos(elevation)
                x, y = across * np.cos(azimuth), across * np.sin(azimuth)
                z = distance * np.sin(elevation)
            if self.rotation is not None:
                x, y, z = (a * x + b * y + c * z for a, b, c in self.rotation)
            if self.translation is not None:
                x, y, z = (v + t for v, t in zip((x, y, z), self.translation, strict=True))
        xyz = np.stack([x, y, z], axis=1)
        state = _INVALID[self._axes]
        if state in by_name:
            xyz[records[state] != 0] = np.nan
        return xyz


def read_scan(scan: Any, number_of_scan: int, path: Path, size: int) -> Scan:
    """Read what a file says of a scan; one without coordinates, or too many points, is refused."""
    name = f"scan {number_of_scan + 1}"
    points = member(scan, "points")
    if points is None or not hasattr(points, "prototype"):
        raise MapFormatError(path, f"points in {name}", "none")
    fields = tuple(_field(each, name, path) for each in children(node(points.prototype())))
    if len(fields) > _MOST_FIELDS:
        raise MapFormatError(path, f"at most {_MOST_FIELDS} fields in {name}", f"{len(fields)}")
    names = {field.name for field in fields}
    if not (names.issuperset(_CARTESIAN) or names.issuperset(_SPHERICAL)):
        expected = f"cartesian or spherical coordinates in {name}"
        raise MapFormatError(path, expected, ", ".join(sorted(names)) or "no fields")
    count = points.childCount()
    bits = sum(field.bits for field in fields)
    if count * bits > 8 * size or (count and not bits):
        raise MapFormatError(path, f"{count} points in {name}", f"a file of {size} bytes")
    return Scan(
        number_of_scan,
        count,
        fields,
        _rotation(scan, name, path),
        _translation(scan),
        member(scan, "pointGroupingSchemes") is not None,
    )


def _field(of: Any, scan: str, path: Path) -> ScanField:
    name = of.elementName()
    kind = type(of).__name__
    if kind == "FloatNode":
        single = "SINGLE" in str(of.precision())
        return ScanField(name, "<f4" if single else "<f8", 32 if single else 64)
    if kind not in ("IntegerNode", "ScaledIntegerNode"):
        raise MapFormatError(path, f"numbers in field {name!r} of {scan}", kind)
    bits = math.ceil(math.log2(max(int(of.maximum()) - int(of.minimum()) + 1, 1)))
    if kind == "IntegerNode":
        return ScanField(name, "<i8", bits)
    return ScanField(name, "<i8", bits, float(of.scale()), float(of.offset()))


def _rotation(scan: Any, name: str, path: Path) -> tuple[tuple[float, float, float], ...] | None:
    """Return the rotation matrix of the pose's quaternion; None where it turns nothing."""
    if member(scan, "pose", "rotation") is None:
        return None
    w, x, y, z = (number(scan, "pose", "rotation", part) or 0.0 for part in "wxyz")
    length = math.sqrt(w * w + x * x + y * y + z * z)
    if not 0 < length < math.inf:
        raise MapFormatError(path, f"a rotation in the pose of {name}", f"{w}, {x}, {y}, {z}")
    w, x, y, z = w / length, x / length, y / length, z / length
    if x == y == z == 0:
        return None
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def _translation(scan: Any) -> tuple[float, float, float] | None:
    x, y, z = (number(scan, "pose", "translation", axis) or 0.0 for axis in "xyz")
    return (x, y, z) if (x, y, z) != (0.0, 0.0, 0.0) else None
