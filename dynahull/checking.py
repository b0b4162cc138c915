"""What is given to the method, checked: each fault ends in one line that says what to pass.

What is anything else than a function returns, raises `InvalidPointsError`.
"""

import sys
from collections.abc import Iterable, Iterator
from numbers import Number
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynahull.errors import InvalidParametersError, InvalidPointsError
from dynahull.observer import Observer

LARGEST_COORDINATE = 1e150
"""Metres from the origin; see `valid_points`."""

_ARRAY_PROTOCOLS = ("__array__", "__array_interface__", "__array_struct__", "__buffer__")

_REMEDIES = {
    "numpy": "its .numpy()",
    "points": "numpy.asarray of its .points",
    "toarray": "its .toarray()",
}
"""What to pass of objects that have an attribute: of PyVista, SciPy's sparse."""

_TOLD = ("stage", "advance", "warn")

_LONGEST = 200
"""Characters of what another library says is wrong."""


def checked_points(points: ArrayLike) -> NDArray[np.float64]:
    """Return points, or those of an Open3D cloud, as a C-ordered (N, 3) float64 array.

    What is masked becomes NaN, and so an invalid point.
    """
    array = as_array(cloud_points(points), "points", "an (N, 3) array")
    if array.dtype.names is not None:
        raise InvalidPointsError(
            "points: expected an (N, 3) array, found one with the fields "
            f"{', '.join(array.dtype.names)[:_LONGEST]}: pass "
            'numpy.column_stack([points["x"], points["y"], points["z"]])'
        )
    if array.ndim != 2 or array.shape[1] != 3:
        names = ", ".join(_column_names(points))[:_LONGEST]
        hint = f": name x, y and z among its columns ({names})" if names else ""
        raise InvalidPointsError(
            f"points: expected an (N, 3) array, found shape {array.shape}"
            f"{hint or remedy(array.shape, 'points')}"
        )
    if array.dtype.kind not in "fiu":
        hint = ": pass points.astype(float)" if array.dtype.kind == "O" else ""
        raise InvalidPointsError(f"points: expected real numbers, found dtype {array.dtype}{hint}")
    if isinstance(array, np.ma.MaskedArray):
        array = np.ma.filled(array.astype(np.float64), np.nan)
    return np.ascontiguousarray(array, np.float64)


def cloud_points(given: Any) -> Any:
    """Return the points of what other libraries hold a cloud in; all else as it is.

    They are clouds of Open3D, of either kind, data of laspy, tensors of PyTorch, on any device,
    and tables of pandas with x, y and z among their columns. Whoever has such an object has
    imported its library: nobody else is kept waiting for it.
    """
    if not isinstance(given, np.ndarray):
        kind = type(given)
        if hasattr(kind, "detach"):
            return _array_of_tensor(given)
        if hasattr(kind, "xyz") and not _offers_array(kind):
            return given.xyz
        if hasattr(kind, "loc") and _misnamed(names := _column_names(given)):
            named = {name.lower(): name for name in names}
            return given[[named[axis] for axis in "xyz"]]
    return _points_of_open3d(given)


def _array_of_tensor(given: Any) -> Any:
    try:
        return given.detach().cpu().numpy()
    except (TypeError, RuntimeError) as error:  # bfloat16, sparse, meta
        found = " ".join(str(error).split())[:_LONGEST]
        raise InvalidPointsError(
            f"points: expected a dense tensor of numbers that NumPy has, found {found}"
        ) from error


def _points_of_open3d(given: Any) -> Any:
    open3d = sys.modules.get("open3d")
    if open3d is None:
        return given
    if isinstance(given, open3d.geometry.PointCloud):
        return np.asarray(given.points)
    if isinstance(given, open3d.t.geometry.PointCloud):
        known = "positions" in given.point
        return given.point.positions.cpu().numpy() if known else np.empty((0, 3))
    return given


def checked_classes(classification: ArrayLike, count: int) -> NDArray[np.uint8]:
    """Return ASPRS classes as an (N,) uint8 array."""
    classes = np.asarray(as_array(classification, "classification", "one class for each point"))
    if classes.shape != (count,):
        raise InvalidPointsError(
            f"classification: expected one class for each of {count} points, "
            f"found shape {classes.shape}"
        )
    if count and (classes.dtype.kind not in "iu" or classes.min() < 0 or classes.max() > 255):
        raise InvalidPointsError(
            f"classification: expected whole numbers from 0 to 255, found dtype {classes.dtype}"
        )
    return classes.astype(np.uint8)


def checked_mask(given: ArrayLike, count: int, name: str = "left_out") -> NDArray[np.bool_]:
    """Return true or false for each point as an (N,) bool array."""
    mask = np.asarray(as_array(given, name, "true or false for each point"))
    if mask.shape != (count,) or (count and mask.dtype != np.bool_):
        raise InvalidPointsError(
            f"{name}: expected true or false for each of {count} points, found shape "
            f"{mask.shape} and dtype {mask.dtype}"
        )
    return mask.astype(np.bool_)


def checked_scans(scan: ArrayLike, count: int) -> NDArray[np.int32]:
    """Return scan numbers as an (N,) int32 array."""
    scans = np.asarray(as_array(scan, "scan", "one scan number for each point"))
    if scans.shape != (count,):
        raise InvalidPointsError(
            f"scan: expected one number for each of {count} points, found shape {scans.shape}"
        )
    if count and (
        scans.dtype.kind not in "iu" or scans.min() < -1 or scans.max() > np.iinfo(np.int32).max
    ):
        raise InvalidPointsError(
            "scan: expected whole numbers from 0 to 2147483647, or -1 where not known, found "
            f"dtype {scans.dtype}"
        )
    return scans.astype(np.int32)


def checked_poses(poses: ArrayLike, scan: NDArray[np.int32] | None) -> NDArray[np.float64]:
    """Return where the sensor was in each scan, (S, 3), from positions or poses.

    Raises
    ------
    InvalidPointsError
        When they are anything else, or there is none for a scan number.
    """
    places = np.asarray(as_array(poses, "poses", "a position or a pose for each scan"))
    if places.dtype.kind not in "iuf" or not (
        (places.ndim == 2 and places.shape[1] == 3)
        or (places.ndim == 3 and places.shape[1:] in ((3, 4), (4, 4)))
    ):
        raise InvalidPointsError(
            "poses: expected numbers of shape (S, 3), (S, 3, 4) or (S, 4, 4), found shape "
            f"{places.shape} of {places.dtype}"
        )
    if scan is None:
        raise InvalidPointsError("poses: expected scan as well, the row of poses of each point")
    if len(scan) and scan.max() >= len(places):
        raise InvalidPointsError(
            f"poses: expected one for each scan number up to {scan.max()}, found {len(places)}"
        )
    return np.ascontiguousarray(places if places.ndim == 2 else places[:, :3, 3], np.float64)


def checked_threads(threads: int) -> int:
    """Return a number of threads.

    Raises
    ------
    InvalidParametersError
        When it is no whole number above zero.
    """
    whole = isinstance(threads, int | np.integer) and not isinstance(threads, bool)
    if not whole or threads < 1:
        raise InvalidParametersError(
            f"threads: expected a whole number above zero, found {short(threads)}"
        )
    return int(threads)


def checked_observer(observer: Observer) -> Observer:
    """Return what is told of the progress.

    Raises
    ------
    InvalidParametersError
        When it cannot be told.
    """
    missing = [name for name in _TOLD if not callable(getattr(observer, name, None))]
    if missing:
        raise InvalidParametersError(
            f"observer: expected methods {', '.join(_TOLD)}, found an object of type "
            f"{type(observer).__name__} without {', '.join(missing)}"
        )
    return observer


def as_array(given: Any, name: str, expected: str) -> NDArray[Any]:
    """Return what is an array, or is soon turned into one, as a NumPy array.

    Raises
    ------
    InvalidPointsError
        For all else, at once. NumPy would ask any other object for its items one after the other,
        which takes minutes where each is made anew.
    """
    reason = _not_an_array(given)
    if reason is None:
        try:
            return np.asanyarray(given)
        except Exception as error:  # of any library: NumPy hands on what an object raises
            said = " ".join(str(error).split()) or type(error).__name__
            reason = said[:_LONGEST]
    raise InvalidPointsError(f"{name}: expected {expected}, found {reason}")


def _not_an_array(given: Any) -> str | None:
    """Say what is given instead of an array, and what to pass; None where it is one."""
    if isinstance(given, str | bytes) or hasattr(given, "__fspath__"):
        return f"{short(given)}: files are read by tiling.formats.open_map, or by the command line"
    if isinstance(given, list | tuple):
        return _not_numbers(set(map(type, given)))
    if isinstance(given, np.ndarray) or _offers_array(type(given)) or _offers_buffer(given):
        return _misnamed(_column_names(given))
    return _other(given)


def _other(given: Any) -> str:
    """Say what is given that NumPy would have to ask for its items, and what to pass."""
    kind = "None" if given is None else f"an object of type {type(given).__name__}"
    for attribute, instead in _REMEDIES.items():
        # Of its type: to ask the object itself might make the coordinates of all points.
        if hasattr(type(given), attribute):
            return f"{kind}: pass {instead}"
    if isinstance(given, Iterator):
        return f"{kind}: pass a list of it"
    return kind


def _not_numbers(kinds: set[type]) -> str | None:
    """Say which kinds of items are neither numbers nor rows of them."""
    known = (list, tuple, Number, np.generic, np.ndarray, str, bytes)
    for kind in sorted(kinds, key=lambda each: each.__name__):
        if not issubclass(kind, known) and not _offers_array(kind):
            return f"items that are {kind.__name__}"
    return None


def _offers_array(kind: type) -> bool:
    """Tell whether objects of a kind give NumPy their numbers at once."""
    return any(hasattr(kind, name) for name in _ARRAY_PROTOCOLS)


def _offers_buffer(given: Any) -> bool:
    try:
        memoryview(given).release()
    except TypeError:
        return False
    return True


def _column_names(table: Any) -> list[str]:
    """Return the names of the columns of a table (pandas, polars, Arrow); none of all else."""
    if isinstance(table, np.ndarray):
        return []
    # The columns of an Arrow table are not their names.
    names = getattr(table, "column_names", None) or getattr(table, "columns", ())
    return [str(name) for name in names] if isinstance(names, Iterable) else []


def _misnamed(columns: list[str]) -> str | None:
    """Say what to pass of a table that has x, y and z, and not just these in this order."""
    named = {name.lower(): name for name in columns}
    if not {"x", "y", "z"} <= set(named) or [name.lower() for name in columns] == ["x", "y", "z"]:
        return None
    wanted = ", ".join(f'"{named[axis]}"' for axis in "xyz")
    return f"a table of the columns {', '.join(columns)[:_LONGEST]}: pass table[[{wanted}]]"


def remedy(shape: tuple[int, ...], name: str) -> str:
    """Say what to pass instead of an array of a shape, where that is plain."""
    if len(shape) == 2 and shape[0] == 3:
        return f": pass {name}.T if the rows are x, y, z"
    if len(shape) == 2 and shape[1] > 3:
        return f": pass {name}[:, :3] if the first three columns are x, y, z"
    if len(shape) == 3 and shape[2] >= 3:
        return f": pass {name}.reshape(-1, {shape[2]}){'[:, :3]' if shape[2] > 3 else ''}"
    return ""


def short(given: Any) -> str:
    """Return what is given as Python writes it, if that is not long."""
    return repr(given)[:_LONGEST]


def valid_points(points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tell which points have coordinates that can be measured: not NaN, not infinite, not absurd.

    Parameters
    ----------
    points : (N, 3) float64 array

    Returns
    -------
    (N,) bool array
        False also where a coordinate is beyond `LARGEST_COORDINATE`: squared distances to such a
        point overflow.
    """
    if len(points) and -LARGEST_COORDINATE <= points.min() <= points.max() <= LARGEST_COORDINATE:
        return np.ones(len(points), np.bool_)
    x, y, z = (np.abs(points[:, axis]) <= LARGEST_COORDINATE for axis in range(3))
    return np.asarray(x & y & z)
