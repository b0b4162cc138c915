"""Maps with further fields: what points had stays as it was, and every peer reads what is new."""

from pathlib import Path

import laspy
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tiling.errors import MapFormatError
from tiling.formats import Field, MapReader, open_map
from tiling.formats.las.header import read_header

FIELDS = (Field("label", "uint8"), Field("density", "float64"))
VERSION_AND_FORMATS = [
    (f"1.{minor}", point_format)
    for minor, highest in ((1, 1), (2, 3), (3, 5), (4, 10))
    for point_format in range(highest + 1)
]


def values_of(count: int) -> list[np.ndarray]:
    density = np.exp(np.random.default_rng(5).normal(0, 20, count))
    density[::7], density[3::7] = np.nan, np.inf
    return [np.arange(count, dtype=np.uint8) % 6, density]


def extend(
    reader: MapReader, path: Path, values: list[np.ndarray], classes: np.ndarray | None = None
) -> MapReader:
    """Write the whole map with further fields, and open what was written."""
    form = reader.extended(FIELDS)
    with form.writer(path, reader.description.point_count) as writer:
        for batch in reader.batches(1000):
            rows = slice(batch.first_row, batch.first_row + len(batch.xyz))
            records = form.extend(batch, [column[rows] for column in values])
            if classes is not None:
                records = form.with_classes(records, classes[rows])
            writer.write(records)
    return open_map(path)


def las_file(path: Path, version: str, point_format: int, extra: int = 0, described: int = 0):
    """Write 2500 random points with VLRs, and extra bytes of which some are described."""
    header = laspy.LasHeader(version=version, point_format=point_format)
    header.scales, header.offsets = np.array([0.01, 0.02, 0.001]), np.array([5e5, -4e6, 0.1])
    if extra:
        header.add_extra_dim(laspy.ExtraBytesParams("colour of the day", f"{extra}u1"))
    header.vlrs.append(laspy.VLR("someone", 77, "a record of theirs", b"\x01\x02\x00\xff"))
    header.extra_vlr_bytes = b"before points"
    length = header.point_format.size
    raw = np.random.default_rng(1).integers(0, 256, (2500, length), dtype=np.uint8)
    las = laspy.LasData(header)
    las.points = laspy.ScaleAwarePointRecord(
        np.frombuffer(raw.tobytes(), header.point_format.dtype()).copy(),
        header.point_format,
        header.scales,
        header.offsets,
    )
    if version == "1.4":
        evlr = laspy.VLR("someone", 78, "a long record", bytes(range(256)) * 9)
        las.evlrs = laspy.vlrs.vlrlist.VLRList([evlr])
    las.write(path)


def vlrs_of(las: laspy.LasData) -> list[tuple[str, int, bytes]]:
    records = [*las.header.vlrs, *(las.evlrs or [])]
    return [
        (each.user_id, each.record_id, each.record_data_bytes())
        for each in records
        if (each.user_id, each.record_id) not in {("LASF_Spec", 4), ("laszip encoded", 22204)}
        and each.user_id != "copc"
        and (each.user_id or each.record_data_bytes())  # what laspy makes of one that is not there
    ]


def rows_of_bytes(las: laspy.LasData) -> list[bytes]:
    return [row.tobytes() for row in las.points.array]


def check_las(source: Path, target: Path, values: list[np.ndarray]) -> None:
    """Compare by laspy: all that was there, and what is new."""
    before, after = laspy.read(source), laspy.read(target)
    assert after.header.point_count == before.header.point_count
    assert after.header.version == before.header.version
    assert after.header.point_format.id == before.header.point_format.id
    if len(after.points):  # some real headers have bounds that are not those of their points
        half = np.abs(after.header.scales) / 2
        assert (np.abs(after.header.mins - after.xyz.min(axis=0)) <= half).all()
        assert (np.abs(after.header.maxs - after.xyz.max(axis=0)) <= half).all()
    returns = np.bincount(np.array(after.return_number), minlength=16)[1:]
    # Headers before LAS 1.4 count five returns; laspy fills up with zeros or not, by its version.
    counted = 15 if after.header.version.minor >= 4 else 5
    by_return = after.header.number_of_points_by_return
    assert np.array_equal(by_return[:counted], returns[:counted])
    names = [*before.point_format.dimension_names]
    if len(before.header.vlrs.get("ExtraBytesVlr")) > 1:  # laspy reads the first, we write one
        assert rows_of_bytes(before) == [row[:-9] for row in rows_of_bytes(after)]
        names.remove("ExtraBytes")
    else:
        assert [*after.point_format.dimension_names] == [*names, "label", "density"]
    for name in names:
        assert np.array(before[name]).tobytes() == np.array(after[name]).tobytes(), name
    for field, column in zip(FIELDS, values, strict=True):
        assert after[field.name].dtype == field.dtype
        np.testing.assert_array_equal(after[field.name], column)
    assert vlrs_of(after) == vlrs_of(before)


@pytest.mark.parametrize("suffix", [".las", ".laz"])
@pytest.mark.parametrize(("version", "point_format"), VERSION_AND_FORMATS)
def test_las_of_every_point_format_keeps_all_it_had(tmp_path, version, point_format, suffix):
    source, target = tmp_path / f"map{suffix}", tmp_path / f"longer{suffix}"
    las_file(source, version, point_format, extra=3 * (point_format % 2))
    reader, values = open_map(source), values_of(2500)
    written = extend(reader, target, values)
    check_las(source, target, values)
    assert written.description.fields == (*reader.description.fields, *FIELDS)
    assert b"before points" in read_header(target).block


@pytest.mark.parametrize("point_format", range(11))
def test_classes_are_replaced_and_the_flags_beside_them_kept(tmp_path, point_format):
    source, target = tmp_path / "map.laz", tmp_path / "classes.laz"
    las_file(source, "1.4", point_format)
    reader = open_map(source)
    largest = reader.description.largest_class
    assert largest == (31 if point_format < 6 else 255)
    classes = np.random.default_rng(2).integers(0, largest + 1, 2500).astype(np.uint8)
    extend(reader, target, values_of(2500), classes)
    before, after = laspy.read(source), laspy.read(target)
    np.testing.assert_array_equal(after.classification, classes)
    for name in before.point_format.dimension_names:
        if name != "classification":
            assert np.array(before[name]).tobytes() == np.array(after[name]).tobytes(), name


def test_extra_bytes_that_nobody_described_do_not_shift_the_new_ones(tmp_path):
    source, target = tmp_path / "map.las", tmp_path / "longer.las"
    las_file(source, "1.4", 6, extra=3)
    data = source.read_bytes().replace(b"LASF_Spec\0", b"nobody's\0\0")
    source.write_bytes(data)
    values = values_of(2500)
    written = extend(open_map(source), target, values)
    names = [field.name for field in written.description.fields]
    assert names[-3:] == ["ExtraBytes", "label", "density"]
    before, after = laspy.read(source), laspy.read(target)
    np.testing.assert_array_equal(before["ExtraBytes"], after["ExtraBytes"])
    np.testing.assert_array_equal(after["density"], values[1])


@pytest.mark.parametrize("extra", [1, 7, 8, 20, 24, 40, 255, 300])
def test_laspy_opens_what_is_behind_bytes_that_nobody_described(tmp_path, extra):
    source, target = tmp_path / "map.las", tmp_path / "longer.las"
    las_file(source, "1.4", 6, extra=extra)
    source.write_bytes(source.read_bytes().replace(b"LASF_Spec\0", b"nobody's\0\0"))
    values = values_of(2500)
    extend(open_map(source), target, values)
    before, after = laspy.read(source), laspy.read(target)
    pieces = [name for name in after.point_format.extra_dimension_names if "Extra" in name]
    found = np.hstack([np.array(after[name]).reshape(2500, -1) for name in pieces])
    np.testing.assert_array_equal(found, np.array(before["ExtraBytes"]).reshape(2500, -1))
    np.testing.assert_array_equal(after["density"], values[1])


def test_descriptions_in_several_vlrs_become_one(tmp_path):
    source, target = tmp_path / "map.las", tmp_path / "longer.las"
    header = laspy.LasHeader(version="1.4", point_format=6)
    for name in ("first", "second", "third"):
        header.add_extra_dim(laspy.ExtraBytesParams(name, "u2"))
    las = laspy.LasData(header)
    las.points = laspy.ScaleAwarePointRecord.zeros(2500, header=header)
    las["third"] = np.arange(2500)
    las.write(source)
    data = source.read_bytes()
    vlrs = [data[429 + at : 429 + at + 192] for at in (0, 192, 384)]
    head = data[375 : 375 + 20] + (192).to_bytes(2, "little") + data[375 + 22 : 429]
    block = bytearray(data[:375] + b"".join(head + each for each in vlrs))
    block[96:100] = len(block).to_bytes(4, "little")
    block[100:104] = (3).to_bytes(4, "little")
    source.write_bytes(bytes(block) + data[429 + 3 * 192 :])
    reader = open_map(source)
    names = ["first", "second", "third"]
    assert [field.name for field in reader.description.fields][-3:] == names
    extend(reader, target, values_of(2500))
    after = laspy.read(target)
    assert [*after.point_format.extra_dimension_names] == [*names, "label", "density"]
    np.testing.assert_array_equal(after["third"], np.arange(2500))
    assert len(after.header.vlrs) == 1


@pytest.mark.parametrize("case", ["las04_pf6_50bytes.las", "las05_three_extra_vlrs.las"])
def test_cases_open_in_laspy_when_labelled(shared_data, tmp_path, case):
    reader = open_map(shared_data / "cases" / case)
    values = values_of(6000)
    written = extend(reader, tmp_path / case, values)
    after = laspy.read(tmp_path / case)
    np.testing.assert_array_equal(after["label"], values[0])
    np.testing.assert_array_equal(after["density"], values[1])
    named = [field.name for field in written.description.fields]
    assert [*after.point_format.dimension_names] == named


def test_points_too_long_for_the_format_are_refused(tmp_path):
    source = tmp_path / "map.las"
    las_file(source, "1.4", 6)
    block = bytearray(source.read_bytes())
    block[105:107] = (65_530).to_bytes(2, "little")
    block[247:255] = (1).to_bytes(8, "little")
    source.write_bytes(block)
    with pytest.raises(
        MapFormatError, match=r"points of at most 65535 bytes .*, found 65539 bytes"
    ):
        open_map(source).extended(FIELDS)


@pytest.fixture(scope="module")
def table() -> np.ndarray:
    kinds = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("n", "<u2")]
    points = np.empty(2500, dtype=kinds)
    random = np.random.default_rng(11)
    for name in "xyz":
        points[name] = random.normal(size=len(points))
    points["n"] = np.arange(len(points))
    return points


def pcd_header(encoding: str) -> bytes:
    return (
        "VERSION 0.7\nFIELDS x y z n\nSIZE 4 4 4 2\nTYPE F F F U\nCOUNT 1 1 1 1\n"
        f"WIDTH 2500\nHEIGHT 1\nPOINTS 2500\nDATA {encoding}\n"
    ).encode()


def lines_of(points: np.ndarray, end: str) -> bytes:
    rows = [" ".join(map(str, row)) + end for row in points.tolist()]
    return "".join(rows).encode()


def save(kind: str, folder: Path, points: np.ndarray) -> Path:
    """Write the table as one kind of map."""
    path = folder / f"map.{kind.rsplit(maxsplit=1)[-1]}"
    ply = (
        "ply\nformat {} 1.0\ncomment kept\nelement vertex 2500\nproperty float x\n"
        "property float y\nproperty float z\nproperty ushort n\n"
        "element note 1\nproperty list uchar uchar text\nend_header\n"
    )
    if kind == "binary pcd":
        path.write_bytes(pcd_header("binary") + points.tobytes())
    elif kind == "ascii pcd":
        path.write_bytes(pcd_header("ascii") + lines_of(points, " \r\n").rstrip())
    elif kind == "little ply":
        text = ply.format("binary_little_endian").encode()
        path.write_bytes(text + points.tobytes() + b"\2hi")
    elif kind == "big ply":
        text = ply.format("binary_big_endian").encode()
        path.write_bytes(text + points.astype(points.dtype.newbyteorder(">")).tobytes() + b"\2hi")
    elif kind == "ascii ply":
        path.write_bytes(ply.format("ascii").encode() + lines_of(points, "\n") + b"2 104 105\n")
    elif kind == "npy":
        np.save(path, points)
    elif kind == "npz":
        np.savez_compressed(path, points=points, note=np.array([1, 2]))
    else:
        columns = {name: points[name] for name in points.dtype.names}
        pq.write_table(pa.table(columns), path, compression="zstd", row_group_size=900)
    return path


KINDS = ["binary pcd", "ascii pcd", "little ply", "big ply", "ascii ply", "npy", "npz", "parquet"]


def columns_of(path: Path) -> dict[str, np.ndarray]:
    """Read all fields of a map as a peer would."""
    if path.suffix == ".parquet":
        read = pq.read_table(path)
        return {name: read.column(name).to_numpy() for name in read.column_names}
    if path.suffix == ".npy":
        read = np.load(path)
        return {name: read[name] for name in read.dtype.names}
    if path.suffix == ".npz":
        with np.load(path) as archive:
            columns = {name: archive["points"][name] for name in archive["points"].dtype.names}
            return columns | {name: archive[name] for name in ("label", "density")}
    data = path.read_bytes()
    text, _, body = data.partition(b"end_header\n" if path.suffix == ".ply" else b"\nDATA ")
    words = text.decode().split("\n")
    if path.suffix == ".ply":
        names = [line.split()[-1] for line in words if line.startswith("property")][:6]
        codes = {"float": "f4", "ushort": "u2", "uchar": "u1", "double": "f8"}
        kinds = [codes.get(line.split()[1]) for line in words if line.startswith("property")][:6]
    else:
        header = {line.split()[0]: line.split()[1:] for line in words}
        names = header["FIELDS"]
        kinds = [
            f"{kind.lower()}{size}"
            for kind, size in zip(header["TYPE"], header["SIZE"], strict=True)
        ]
        assert header["COUNT"] == ["1"] * len(names)
        body = body.partition(b"\n")[2]
    if b"ascii" in data[:300]:
        rows = body.split(b"\n")[:2500]
        values = np.array([[float(word) for word in row.split()] for row in rows])
        return {
            name: values[:, column].astype(kind)
            for column, (name, kind) in enumerate(zip(names, kinds, strict=True))
        }
    order = ">" if b"big_endian" in text else "<"
    dtype = np.dtype([(name, order + kind) for name, kind in zip(names, kinds, strict=True)])
    read = np.frombuffer(body, dtype, count=2500)
    return {name: read[name] for name in names}


@pytest.mark.parametrize("kind", KINDS)
def test_every_format_gets_fields_by_those_names(tmp_path, table, kind):
    source = save(kind, tmp_path, table)
    values = values_of(2500)
    reader = open_map(source)
    written = extend(reader, tmp_path / f"longer{source.suffix}", values)
    read = columns_of(written.description.path)
    assert set(read) == {"x", "y", "z", "n", "label", "density"}
    for name in table.dtype.names:
        np.testing.assert_array_equal(read[name], table[name])
    np.testing.assert_array_equal(read["label"], values[0])
    np.testing.assert_array_equal(read["density"], values[1])
    assert read["label"].dtype == (np.uint32 if source.suffix == ".pcd" else np.uint8)
    names = [field.name for field in written.description.fields]
    assert names[-2:] == ["label", "density"]
    assert written.description.format == reader.description.format
    for old, new in zip(reader.batches(700), written.batches(700), strict=True):
        np.testing.assert_array_equal(old.xyz, new.xyz)
    if source.suffix == ".ply":
        end = written.description.path.read_bytes()[-11:]
        assert end.endswith(b"\n2 104 105\n" if kind == "ascii ply" else b"\2hi")


@pytest.mark.parametrize("kind", [kind for kind in KINDS if "ascii" not in kind])
def test_parts_make_the_file_that_a_stream_makes(tmp_path, table, kind):
    source = save(kind, tmp_path, table)
    reader, values = open_map(source), values_of(2500)
    form = reader.extended(FIELDS)
    if not form.writes_parts:
        assert not reader.writes_parts
        return
    whole = extend(reader, tmp_path / f"stream{source.suffix}", values).description.path
    parts = form.part_writer(tmp_path / f"parts{source.suffix}", 2500)
    parts.create()
    summaries = []
    for rows in (range(1200, 2500), range(1200)):
        with parts.open_part(rows.start) as part:
            for batch in reader.batches(500, rows):
                own = slice(batch.first_row, batch.first_row + len(batch.xyz))
                part.write(form.extend(batch, [column[own] for column in values]))
        summaries.append(part.summary)
    parts.finish(summaries)
    assert parts.path.read_bytes() == whole.read_bytes()


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("kind", ["<f4", ">f8"])
def test_columns_of_numbers_get_columns_of_their_type(tmp_path, order, kind):
    points = np.asarray(np.random.default_rng(0).normal(size=(2500, 4)), dtype=kind, order=order)
    np.save(tmp_path / "map.npy", points)
    values = values_of(2500)
    values[1] = np.clip(values[1], 0, 1e30)
    written = extend(open_map(tmp_path / "map.npy"), tmp_path / "longer.npy", values)
    read = np.load(written.description.path)
    assert read.dtype == kind and read.shape == (2500, 6)
    np.testing.assert_array_equal(read[:, :4], points)
    np.testing.assert_array_equal(read[:, 4], values[0])
    np.testing.assert_array_equal(read[:, 5], values[1].astype(kind))


def test_whole_numbers_without_names_have_no_place_for_densities(tmp_path):
    np.save(tmp_path / "map.npy", np.zeros((5, 3), np.int32))
    with pytest.raises(MapFormatError, match="expected fields with names, or columns of floating"):
        open_map(tmp_path / "map.npy").extended(FIELDS)


def test_an_array_by_the_name_of_a_new_one_is_refused(tmp_path):
    np.savez(tmp_path / "map.npz", points=np.zeros((5, 3)), label=np.arange(2))
    with pytest.raises(MapFormatError, match="expected no array 'label'"):
        open_map(tmp_path / "map.npz").extended(FIELDS)


def test_real_files_of_every_kind_are_extended(tmp_path, shared_data):
    """Every file that can be read comes back with its points, its fields and the new ones."""
    extended = 0
    for source in sorted((shared_data / "formats").iterdir()):
        try:
            reader = open_map(source)
            old = list(reader.batches())
        except MapFormatError:
            continue
        count = reader.description.point_count
        target = tmp_path / f"{source.stem}{reader.description.suffix}"
        written = extend(reader, target, values_of(count))
        assert written.description.fields[:-2] == reader.description.fields, source
        assert written.description.crs == reader.description.crs
        new = [np.empty((0, 3)), *(batch.xyz for batch in written.batches())]
        np.testing.assert_array_equal(
            np.concatenate(new), np.concatenate([np.empty((0, 3)), *(b.xyz for b in old)])
        )
        if target.suffix in (".las", ".laz") and "copc" not in source.name:
            _compare_where_laspy_reads(source, target, values_of(count))
        extended += 1
        target.unlink()
    assert extended > 60


def _compare_where_laspy_reads(source: Path, target: Path, values: list[np.ndarray]) -> None:
    try:
        laspy.read(source)
    except BaseException:  # laspy's own limits, panics of lazrs among them, see test_las.py
        return
    check_las(source, target, values)
