"""One field of every point, out of every format that names its fields."""

import laspy
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tiling.errors import MapFormatError
from tiling.formats import field_values

COUNT = 7
LABELS = np.array([0, 1, 252, 0, 255, 7, 1], dtype=np.uint16)
XYZ = np.arange(3.0 * COUNT).reshape(COUNT, 3)


def values_of(path, name="label"):
    return np.concatenate(list(field_values(path, name)))


def pcd_header(encoding, padding):
    return (
        f"VERSION 0.7\nFIELDS x y z{' _' if padding else ''} label time\n"
        f"SIZE 4 4 4{' 1' if padding else ''} 2 8\nTYPE F F F{' U' if padding else ''} U F\n"
        f"COUNT 1 1 1{' 3' if padding else ''} 1 1\nWIDTH {COUNT}\nHEIGHT 1\n"
        f"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {COUNT}\nDATA {encoding}\n"
    ).encode()


def pcd_records(padding):
    fields = [("xyz", "<f4", 3), *([("_", "u1", 3)] if padding else [])]
    records = np.zeros(COUNT, dtype=[*fields, ("label", "<u2"), ("time", "<f8")])
    records["xyz"], records["label"], records["time"] = XYZ, LABELS, XYZ[:, 0] / 3
    return records


@pytest.mark.parametrize("padding", [False, True])
def test_binary_pcd_with_and_without_padding(tmp_path, padding):
    data = pcd_records(padding).tobytes()
    (tmp_path / "a.pcd").write_bytes(pcd_header("binary", padding) + data)
    np.testing.assert_array_equal(values_of(tmp_path / "a.pcd"), LABELS)
    np.testing.assert_array_equal(values_of(tmp_path / "a.pcd", "time"), XYZ[:, 0] / 3)


@pytest.mark.parametrize("stored", [False, True])
def test_compressed_pcd_that_keeps_the_padding_or_leaves_it_out(tmp_path, stored):
    lzf = pytest.importorskip("lzf")
    records = pcd_records(True)
    kept = ["label", "time"] if not stored else ["_", "label", "time"]
    columns = [np.ascontiguousarray(records["xyz"][:, axis]) for axis in range(3)]
    columns += [np.ascontiguousarray(records[name]) for name in kept]
    data = b"".join(column.tobytes() for column in columns)
    packed = lzf.compress(data, 2 * len(data))
    sizes = np.array([len(packed), len(data)], dtype="<u4").tobytes()
    path = tmp_path / "a.pcd"
    path.write_bytes(pcd_header("binary_compressed", True) + sizes + packed)
    np.testing.assert_array_equal(values_of(path), LABELS)
    np.testing.assert_array_equal(values_of(path, "time"), XYZ[:, 0] / 3)


def test_ascii_pcd(tmp_path):
    lines = [
        f"{x} {y} {z} 9 9 9 {label} 1e-3" for (x, y, z), label in zip(XYZ, LABELS, strict=True)
    ]
    (tmp_path / "a.pcd").write_bytes(pcd_header("ascii", True) + "\n".join(lines).encode())
    np.testing.assert_array_equal(values_of(tmp_path / "a.pcd"), LABELS)
    np.testing.assert_array_equal(values_of(tmp_path / "a.pcd", "time"), np.full(COUNT, 1e-3))


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_las_extra_bytes_and_parts_of_a_byte(tmp_path, suffix):
    cloud = laspy.create(point_format=3, file_version="1.2")
    cloud.add_extra_dim(laspy.ExtraBytesParams("label", "uint16"))
    cloud.xyz, cloud.label, cloud.classification = XYZ, LABELS, LABELS % 5
    path = tmp_path / f"a{suffix}"
    cloud.write(path)
    np.testing.assert_array_equal(values_of(path), LABELS)
    np.testing.assert_array_equal(values_of(path, "classification"), LABELS % 5)


def test_tables_and_arrays(tmp_path):
    x, y, z = XYZ.T
    pq.write_table(pa.table({"x": x, "y": y, "z": z, "label": LABELS}), tmp_path / "a.parquet")
    np.savez(tmp_path / "columns.npz", xyz=XYZ, label=LABELS)
    records = np.zeros(COUNT, dtype=[("x", "f8"), ("y", "f8"), ("z", "f8"), ("label", "u2")])
    records["label"] = LABELS
    np.save(tmp_path / "a.npy", records)
    np.savez(tmp_path / "records.npz", points=records)
    for name in ("a.parquet", "columns.npz", "a.npy", "records.npz"):
        np.testing.assert_array_equal(values_of(tmp_path / name), LABELS)


def test_what_cannot_be_read_is_one_line_that_names_it(tmp_path):
    np.savez(tmp_path / "a.npz", xyz=XYZ, label=LABELS, name=np.full(COUNT, "a"))
    with pytest.raises(MapFormatError, match=r"a\.npz: expected a field 'labels', found only"):
        values_of(tmp_path / "a.npz", "labels")
    with pytest.raises(MapFormatError, match="expected numbers in the field name"):
        values_of(tmp_path / "a.npz", "name")
    (tmp_path / "a.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
        "property float z\nproperty uchar label\nproperty list uchar int seen\nend_header\n"
        "0 0 0 1 2 5 6\n",
        encoding="ascii",
    )
    with pytest.raises(MapFormatError, match=r"fields can be read apart, found PLY"):
        values_of(tmp_path / "a.ply")


@pytest.mark.parametrize("order", ["", "<", ">"])
def test_ply_of_any_encoding(tmp_path, order):
    names = {"": "ascii", "<": "binary_little_endian", ">": "binary_big_endian"}
    header = (
        f"ply\nformat {names[order]} 1.0\nelement vertex {COUNT}\nproperty ushort label\n"
        "property float x\nproperty float y\nproperty float z\nproperty double time\nend_header\n"
    )
    fields = [("label", "u2"), ("xyz", "f4", 3), ("time", "f8")]
    records = np.zeros(COUNT, np.dtype(fields).newbyteorder(order or "<"))
    records["xyz"], records["label"], records["time"] = XYZ, LABELS, XYZ[:, 0] / 3
    data = records.tobytes()
    if not order:
        rows = zip(LABELS.tolist(), XYZ.tolist(), records["time"].tolist(), strict=True)
        data = "\n".join(f"{a} {x} {y} {z} {t!r}" for a, (x, y, z), t in rows).encode()
    (tmp_path / "a.ply").write_bytes(header.encode() + data)
    np.testing.assert_array_equal(values_of(tmp_path / "a.ply"), LABELS)
    np.testing.assert_array_equal(values_of(tmp_path / "a.ply", "time"), XYZ[:, 0] / 3)


def test_columns_without_names_are_numbered(tmp_path):
    for order in "CF":
        np.save(tmp_path / "a.npy", np.asarray(np.column_stack([XYZ, LABELS]), order=order))
        np.testing.assert_array_equal(values_of(tmp_path / "a.npy", "column 4"), LABELS)
