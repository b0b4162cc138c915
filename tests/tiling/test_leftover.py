"""Points behind those that a header counts are refused, whatever the format.

But Parquet's, whose footer alone says which rows there are.
"""

import io
import re
import zipfile
from pathlib import Path

import laspy
import numpy as np
import pytest

from tiling.collection import MapCollection
from tiling.errors import MapFormatError
from tiling.formats import open_map

COUNT = 40
POINTS = np.random.default_rng(7).uniform(-9, 9, (COUNT, 3))


def pcd(encoding: str, counted: int) -> bytes:
    head = (
        "VERSION 0.7\nFIELDS x y z\nSIZE 8 8 8\nTYPE F F F\nCOUNT 1 1 1\n"
        f"WIDTH {counted}\nHEIGHT 1\nPOINTS {counted}\nDATA {encoding}\n"
    )
    if encoding == "ascii":
        return (head + "".join(f"{x} {y} {z}\n" for x, y, z in POINTS.tolist())).encode()
    if encoding == "binary":
        return head.encode() + POINTS.tobytes()
    columns = POINTS.T.tobytes()
    packed = b"".join(b"\x1f" + columns[at : at + 32] for at in range(0, len(columns), 32))
    sizes = len(packed).to_bytes(4, "little") + (24 * counted).to_bytes(4, "little")
    return head.encode() + sizes + packed


def ply(encoding: str, counted: int, *, faces: bool) -> bytes:
    head = f"ply\nformat {encoding} 1.0\nelement vertex {counted}\n"
    head += "".join(f"property double {axis}\n" for axis in "xyz")
    head += "element face 2\nproperty list uchar int vertex_indices\n" if faces else ""
    head += "end_header\n"
    if encoding == "ascii":
        rows = "".join(f"{x} {y} {z}\n" for x, y, z in POINTS.tolist())
        return (head + rows + ("3 0 1 2\n3 1 2 3\n" if faces else "")).encode()
    face = b"\x03" + np.array([0, 1, 2], "<i4").tobytes()
    return head.encode() + POINTS.tobytes() + (2 * face if faces else b"")


def las(suffix: str, version: str, point_format: int, counted: int, evlr: bool = False) -> bytes:
    header = laspy.LasHeader(version=version, point_format=point_format)
    header.scales = np.full(3, 0.001)
    data = laspy.LasData(header)
    data.xyz = POINTS
    data.return_number = np.ones(COUNT, np.uint8)
    if evlr:
        data.evlrs = laspy.vlrs.vlrlist.VLRList([laspy.VLR("test", 7, "", b"data" * 30)])
    file = io.BytesIO()
    data.write(file, do_compress=suffix == ".laz")
    content = bytearray(file.getvalue())
    content[107:111] = counted.to_bytes(4, "little")
    if version == "1.4":
        content[247:255] = counted.to_bytes(8, "little")
    return bytes(content)


def npy(counted: int, *, fortran: bool) -> bytes:
    file = io.BytesIO()
    np.save(file, np.asfortranarray(POINTS) if fortran else POINTS)
    old, new = f"({COUNT}, 3), }}".encode(), f"({counted}, 3), }}".encode()
    return file.getvalue().replace(old, new.ljust(len(old)))


def npz(counted: int) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("points.npy", npy(counted, fortran=False))
    return file.getvalue()


MAKERS = {
    "ascii.pcd": lambda n: pcd("ascii", n),
    "binary.pcd": lambda n: pcd("binary", n),
    "compressed.pcd": lambda n: pcd("binary_compressed", n),
    "ascii.ply": lambda n: ply("ascii", n, faces=False),
    "ascii_faces.ply": lambda n: ply("ascii", n, faces=True),
    "binary.ply": lambda n: ply("binary_little_endian", n, faces=False),
    "binary_faces.ply": lambda n: ply("binary_little_endian", n, faces=True),
    "12.las": lambda n: las(".las", "1.2", 1, n),
    "14.las": lambda n: las(".las", "1.4", 6, n),
    "14_evlr.las": lambda n: las(".las", "1.4", 6, n, evlr=True),
    "12.laz": lambda n: las(".laz", "1.2", 1, n),
    "14.laz": lambda n: las(".laz", "1.4", 6, n),
    "14_evlr.laz": lambda n: las(".laz", "1.4", 6, n, evlr=True),
    "c.npy": lambda n: npy(n, fortran=False),
    "fortran.npy": lambda n: npy(n, fortran=True),
    "map.npz": npz,
}


def read_all(path: Path) -> int:
    collection = MapCollection([path])
    return sum(len(batch.xyz) for _, batch in collection.batches(7))


@pytest.mark.parametrize("name", MAKERS)
@pytest.mark.parametrize("counted", [0, 1, COUNT // 2, COUNT - 2])
def test_points_that_are_not_counted_are_never_lost_without_a_word(tmp_path, name, counted):
    path = tmp_path / name
    path.write_bytes(MAKERS[name](COUNT))
    assert read_all(path) == COUNT
    path.write_bytes(MAKERS[name](counted))
    with pytest.raises(MapFormatError) as raised:
        read_all(path)
    assert len(str(raised.value)) < 400


@pytest.mark.parametrize("name", ["binary.pcd", "compressed.pcd", "binary.ply", "12.las", "c.npy"])
@pytest.mark.parametrize("padding", [b"\0" * 4096, b"\n", b"\0", b"garbage"])
def test_padding_is_left_out_and_noted(tmp_path, name, padding):
    path = tmp_path / name
    path.write_bytes(MAKERS[name](COUNT) + padding)
    assert read_all(path) == COUNT
    (note,) = open_map(path).description.notes
    assert re.match(rf"The {len(padding)} bytes after the last point are left out", note)


@pytest.mark.parametrize("name", ["binary.pcd", "compressed.pcd", "binary.ply", "12.las", "c.npy"])
def test_anything_else_of_a_points_size_is_refused(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(MAKERS[name](COUNT) + b"\0" * 5000 + b"points" * 10)
    with pytest.raises(MapFormatError, match="5060 bytes behind them, room for"):
        open_map(path)


@pytest.mark.parametrize("name", ["las09_count_zero.las", "las09_count_zero_12.las"])
def test_a_header_that_counts_none_of_its_points(shared_data, name):
    with pytest.raises(MapFormatError, match="room for 6000 more"):
        open_map(shared_data / "cases" / name)
