"""One field of every point as numbers, such as a label; no reader's batches hold it apart."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tiling.errors import MapFormatError
from tiling.formats import open_map
from tiling.formats.base import MapReader
from tiling.formats.parquet_file import open_parquet
from tiling.formats.points import DEFAULT_BATCH


def field_values(path: Path, name: str) -> Iterator[NDArray[np.generic]]:
    """Yield the values of one field, in the order of the points, as arrays that follow each other.

    Parameters
    ----------
    path : Path
        A PCD, LAS, LAZ, COPC, Parquet, npy, npz or text file.
    name : str
        A field with one number a point, as the file names it.

    Yields
    ------
    (n,) array
        Of numbers or booleans.

    Raises
    ------
    MapFormatError
        When the map has no such field, when it is not of numbers, or when the map is of a format
        whose fields cannot be read apart (PLY, E57, bare records).
    """
    reader = open_map(path)
    fields = {field.name: field for field in reader.description.fields}
    if name not in fields:
        found = f"only {', '.join(fields) or 'none'}"
        raise MapFormatError(path, f"a field {name!r}", found)
    if fields[name].count != 1:
        raise MapFormatError(path, f"one {name} a point", f"{fields[name].count}")
    suffix = path.suffix.lower()
    if suffix not in _SOURCES:
        known = ", ".join(_SOURCES)
        raise MapFormatError(path, f"fields of a map in {known}", f"one in {suffix}")
    for values in _SOURCES[suffix](reader, name):
        if values.dtype.kind not in "biuf":
            raise MapFormatError(path, f"numbers in the field {name}", str(values.dtype))
        yield values


def _pcd_values(reader: MapReader, name: str) -> Iterator[NDArray[np.generic]]:
    from tiling.formats.pcd.header import read_header  # noqa: PLC0415

    path = reader.description.path
    with path.open("rb") as stream:
        header = read_header(stream, path)
    field = next(field for field in header.fields if field.name == name)
    if header.encoding == "ascii":
        column = header.first_value(field)
        for batch in reader.batches():
            lines = batch.records.tobytes().decode("latin-1").splitlines()
            yield np.array([line.split()[column] for line in lines]).astype(np.float64)
        return
    for batch in reader.batches():
        rows = batch.records.view(np.uint8).reshape(len(batch.records), -1)
        # Compressed records may lack the padding, fields named `_`, of the header.
        whole = rows.shape[1] == header.record_size
        stored = [each for each in header.fields if whole or each.name != "_"]
        start = sum(each.width for each in stored if each.offset < field.offset)
        values = np.ascontiguousarray(rows[:, start : start + field.size])
        yield values.view(np.dtype(field.dtype).newbyteorder("<"))[:, 0]


def _las_values(reader: MapReader, name: str) -> Iterator[NDArray[np.generic]]:
    import laspy  # noqa: PLC0415

    path = reader.description.path
    try:
        with laspy.open(path) as file:
            for points in file.chunk_iterator(DEFAULT_BATCH):
                yield np.asarray(points[name])
    except (laspy.LaspyException, ValueError) as error:
        raise MapFormatError(path, "a map that laspy reads", str(error)) from error


def _text_values(reader: MapReader, name: str) -> Iterator[NDArray[np.generic]]:
    from tiling.formats.text import read_head  # noqa: PLC0415

    path = reader.description.path
    head = read_head(path)
    column = head.names.index(name)
    for batch in reader.batches():
        lines = batch.records.tobytes().splitlines()
        words = [line.split(head.layout.separator or None)[column] for line in lines]
        try:
            yield np.array(words).astype(np.float64)
        except ValueError as error:
            raise MapFormatError(path, f"numbers in the field {name}", str(error)) from error


def _parquet_values(reader: MapReader, name: str) -> Iterator[NDArray[np.generic]]:

    with open_parquet(reader.description.path) as file:
        for batch in file.iter_batches(DEFAULT_BATCH, columns=[name], use_threads=False):
            yield batch.column(0).to_numpy(zero_copy_only=False)


def _numpy_values(reader: MapReader, name: str) -> Iterator[NDArray[np.generic]]:
    path = reader.description.path
    if path.suffix.lower() == ".npz":
        with np.load(path, allow_pickle=False) as archive:
            owner = name if name in archive else next(iter(archive))
            array = archive[owner]
    else:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    column = array[name] if array.dtype.names else array
    if column.ndim != 1:
        raise MapFormatError(path, f"one {name} a point", f"an array of shape {column.shape}")
    for first in range(0, len(column), DEFAULT_BATCH):
        yield np.asarray(column[first : first + DEFAULT_BATCH])


_SOURCES = {
    ".pcd": _pcd_values,
    ".las": _las_values,
    ".laz": _las_values,
    ".parquet": _parquet_values,
    ".npy": _numpy_values,
    ".npz": _numpy_values,
    **dict.fromkeys((".xyz", ".pts", ".asc", ".txt", ".csv"), _text_values),
}
