import io
import json
import struct
from decimal import Decimal

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from tiling.errors import MapFormatError
from tiling.formats import open_map

# Earlier versions of Arrow cannot write lists of one length of which some are null.
NO_PAIR = None if int(pa.__version__.split(".")[0]) >= 25 else [3, 4]
FLOATS = [pa.float16(), pa.float32(), pa.float64()]
INTEGERS = [pa.int8(), pa.uint8(), pa.int16(), pa.uint16(), pa.int32(), pa.uint32(), pa.int64()]


def parquet(table: pa.Table, **options) -> bytes:
    content = io.BytesIO()
    pq.write_table(table, content, **options)
    return content.getvalue()


def repeated(values: list, count: int, kind: pa.DataType) -> pa.Array:
    return pa.array((values * count)[:count], kind)


def table_of_all_kinds(count: int) -> pa.Table:
    """A table with nulls, nesting and the types that lose something most easily."""
    point = pa.struct([("id", pa.int16()), ("name", pa.string())])
    columns = {
        "y": repeated([1.5, None, -2.0], count, pa.float32()),
        "class": repeated(["car", None, "person", "car"], count, pa.string()).dictionary_encode(),
        "x": repeated([7, -9, None, 2**40], count, pa.int64()),
        "seen": repeated([[1, 2], None, [], [None]], count, pa.list_(pa.int32())),
        "pair": repeated([[1, 2], NO_PAIR], count, pa.list_(pa.float32(), 2)),
        "of": repeated([{"id": 1, "name": None}, None], count, point),
        "tags": repeated([[("a", 1)], [], None], count, pa.map_(pa.string(), pa.int8())),
        "stamp": repeated([10**18 + 1, None], count, pa.timestamp("ns", "Europe/Helsinki")),
        "raw": repeated([b"\0\xff", None], count, pa.large_binary()),
        "half": repeated([np.float16(0.1)], count, pa.float16()),
        "z": repeated([0.1, float("inf"), float("nan")], count, pa.float64()),
        "price": repeated([None, 5], count, pa.decimal128(12, 3)),
        "flag": repeated([True, None], count, pa.bool_()),
        "whole": repeated([4_000_000_000], count, pa.uint32()),
    }
    fields = [pa.field(name, column.type) for name, column in columns.items()]
    fields[-1] = fields[-1].with_nullable(False).with_metadata({"unit": "mm"})
    schema = pa.schema(fields, metadata={"pandas": "{}", "made by": "hand"})
    return pa.table(list(columns.values()), schema=schema)


def values_of(table: pa.Table) -> str:
    """All values as text, in which NaN equals NaN and is not null."""
    # Python's own datetime has no nanoseconds.
    stamps = table["stamp"].cast(pa.int64())
    return str([table.drop_columns("stamp").to_pylist(), stamps.to_pylist()])


@pytest.mark.parametrize("most", [1, 4, 1000])
@pytest.mark.parametrize("compression", ["NONE", "SNAPPY", "GZIP", "BROTLI", "LZ4", "ZSTD"])
@pytest.mark.parametrize("compliant", [True, False])
def test_columns_of_all_kinds(tmp_path, rewrite, read_xyz, most, compression, compliant):
    table = table_of_all_kinds(50)
    path = tmp_path / "map.parquet"
    path.write_bytes(
        parquet(
            table,
            compression=compression,
            row_group_size=20,
            use_compliant_nested_type=compliant,
        )
    )
    reader = open_map(path)
    types = {field.name: field.dtype for field in reader.description.fields}
    assert types["y"] == "float32"
    assert types["pair"].startswith("fixed_size_list")
    x = [np.nan if value is None else value for value in table["x"].to_pylist()]
    xyz = read_xyz(reader, most)
    np.testing.assert_array_equal(xyz[:, 0], x)
    assert np.isnan(xyz[1, 1])
    chosen = np.arange(50) % 4 != 1
    copy = pq.ParquetFile(rewrite(reader, tmp_path / "copy.parquet", chosen, most))
    source = pq.ParquetFile(path)
    assert copy.schema_arrow.equals(source.schema_arrow, check_metadata=True)
    assert copy.schema.equals(source.schema)
    assert values_of(copy.read()) == values_of(table.filter(pa.array(chosen)))
    groups = [copy.metadata.row_group(n) for n in range(copy.metadata.num_row_groups)]
    assert [group.num_rows for group in groups] == [20, 17]
    codec = "UNCOMPRESSED" if compression == "NONE" else compression
    assert groups[0].column(0).compression == codec


@st.composite
def tables(draw):
    count = draw(st.integers(0, 30))
    columns = {}
    for name in draw(st.permutations(["x", "y", "z", "extra"])):
        kind = draw(st.sampled_from(FLOATS + INTEGERS))
        content = draw(st.binary(min_size=1, max_size=40)) * (8 * count + 8)
        values = np.frombuffer(content[: count * kind.bit_width // 8], numpy_type(kind))
        mask = draw(hnp.arrays(bool, count))
        columns[name] = pa.array(values, kind, mask=mask)
    return pa.table(columns)


def numpy_type(kind: pa.DataType) -> np.dtype:
    return np.dtype({"halffloat": "f2", "float": "f4", "double": "f8"}.get(str(kind), str(kind)))


def raw_bits(column: pa.ChunkedArray) -> list[bytes | None]:
    """The bits of each value, so that every NaN is told from every other."""
    width = column.type.bit_width // 8
    array = column.combine_chunks()
    values = array.buffers()[1].to_pybytes() if len(array) else b""
    return [
        values[(array.offset + n) * width : (array.offset + n + 1) * width] if valid else None
        for n, valid in enumerate(array.is_valid().to_pylist())
    ]


@settings(max_examples=60, deadline=None)
@given(tables(), st.integers(1, 40), st.integers(1, 40), st.data())
def test_numbers_keep_every_bit(tmp_path_factory, rewrite, read_xyz, table, group, most, data):
    folder = tmp_path_factory.mktemp("parquet")
    path = folder / "map.parquet"
    path.write_bytes(parquet(table, row_group_size=group))
    reader = open_map(path)
    xyz = read_xyz(reader, most)
    for column, name in enumerate("xyz"):
        expected = [np.nan if v is None else float(v) for v in table[name].to_pylist()]
        np.testing.assert_array_equal(xyz[:, column], expected)
    chosen = data.draw(hnp.arrays(bool, table.num_rows))
    copy = pq.read_table(rewrite(reader, folder / "copy.parquet", chosen, most))
    assert copy.schema.equals(table.schema, check_metadata=True)
    for name in table.column_names:
        kept = [b for b, keep in zip(raw_bits(table[name]), chosen, strict=True) if keep]
        assert raw_bits(copy[name]) == kept


def test_a_dictionary_that_differs_between_row_groups(tmp_path, rewrite):
    path = tmp_path / "map.parquet"
    parts = [
        pa.table(
            {"x": [1.0], "y": [2.0], "z": [3.0], "class": pa.array([name]).dictionary_encode()}
        )
        for name in ("car", "person", "car", "tree")
    ]
    with pq.ParquetWriter(path, parts[0].schema) as writer:
        for part in parts:
            writer.write_table(part)
    copy = rewrite(open_map(path), tmp_path / "copy.parquet", np.array([1, 1, 0, 1], bool), 3)
    assert pq.read_table(copy)["class"].to_pylist() == ["car", "person", "tree"]
    assert pq.read_table(copy).schema == parts[0].schema


def test_files_without_an_arrow_schema_stay_without(tmp_path, rewrite):
    table = pa.table(
        {"X": [1.0, 2], "Y": [3, 4], "Z": [5, 6], "stamp": pa.array([1, 2], pa.timestamp("ns"))}
    )
    path = tmp_path / "map.parquet"
    path.write_bytes(parquet(table, store_schema=False, use_deprecated_int96_timestamps=True))
    reader = open_map(path)
    assert reader.description.point_count == 2
    copy = pq.ParquetFile(rewrite(reader, tmp_path / "copy.parquet", np.ones(2, bool), 9))
    assert copy.metadata.metadata is None
    assert copy.metadata.schema.column(3).physical_type == "INT96"
    assert copy.read().equals(table)


@pytest.mark.parametrize(
    ("crs", "short"),
    [
        ({"crs": {"name": "UTM 15N", "id": {"authority": "EPSG", "code": 32615}}}, "EPSG:32615"),
        ({"crs": {"name": "somewhere"}}, "somewhere"),
        ({"crs": None}, None),
        ({}, "OGC:CRS84"),
    ],
)
def test_the_crs_of_geoparquet(tmp_path, rewrite, crs, short):
    geo = json.dumps({"primary_column": "geometry", "columns": {"geometry": crs}})
    table = pa.table({"x": [1.0], "y": [1.0], "z": [1.0], "geometry": [b"\1"]})
    path = tmp_path / "map.parquet"
    path.write_bytes(parquet(table.replace_schema_metadata({"geo": geo})))
    reader = open_map(path)
    assert reader.description.crs == short
    copy = rewrite(reader, tmp_path / "copy.parquet", np.ones(1, bool), 9)
    assert pq.read_schema(copy).metadata[b"geo"] == geo.encode()


def test_large_row_groups_are_read_in_small_batches(tmp_path):
    count = 300_000
    table = pa.table({name: np.arange(count, dtype=float) for name in "xyz"})
    path = tmp_path / "map.parquet"
    path.write_bytes(parquet(table, compression="NONE", use_dictionary=False))
    before = pa.total_allocated_bytes()
    held = []
    for batch in open_map(path).batches(1000):
        assert len(batch.xyz) <= 1000
        held.append(pa.total_allocated_bytes() - before)
    assert max(held) < table.nbytes


def wkb(points: np.ndarray, order: str, kind: int) -> list[bytes]:
    head = struct.pack(f"{order}BI", order == "<", kind)
    return [head + struct.pack(f"{order}3d", *point) for point in points]


POINTS = np.random.default_rng(2).normal(size=(9, 3)).round(3)
GEO = json.dumps({"primary_column": "geometry", "columns": {"geometry": {"crs": None}}})
OF_ONE_COLUMN = {
    "xyz": pa.FixedSizeListArray.from_arrays(POINTS.reshape(-1), 3),
    "xyz of any length": pa.array(POINTS.tolist(), pa.list_(pa.float32())),
    "geometry little": pa.array(wkb(POINTS, "<", 1001)),
    "geometry big, PostGIS": pa.array(wkb(POINTS, ">", 0x80000001), pa.large_binary()),
    "geometry native": pa.StructArray.from_arrays([*POINTS.T], names=[*"xyz"]),
    "geometry interleaved": pa.FixedSizeListArray.from_arrays(POINTS.reshape(-1), 3),
}


@pytest.mark.parametrize("kind", OF_ONE_COLUMN)
@pytest.mark.parametrize("missing", [False, True])
def test_points_in_one_column(tmp_path, rewrite, read_xyz, kind, missing):
    points, expected = OF_ONE_COLUMN[kind], POINTS.copy()
    if kind == "xyz of any length":
        expected = expected.astype("f4").astype("f8")
    if missing and pa.types.is_fixed_size_list(points.type) and NO_PAIR is not None:
        pytest.skip("this version of Arrow cannot read lists of one length of which one is null")
    if missing:
        points = pa.concat_arrays([points[:4], pa.nulls(1, points.type), points[5:]])
        expected[4] = np.nan
    table = pa.table({kind.split()[0]: points, "n": np.arange(9)})
    table = table.replace_schema_metadata({"geo": GEO})
    path = tmp_path / "map.parquet"
    path.write_bytes(parquet(table, row_group_size=5))
    reader = open_map(path)
    np.testing.assert_array_equal(read_xyz(reader, 2), expected)
    chosen = np.arange(9) % 3 > 0
    copy = pq.read_table(rewrite(reader, tmp_path / "copy.parquet", chosen, 2))
    stored = pq.read_table(path)
    assert copy.schema.equals(stored.schema, check_metadata=True)
    assert copy.equals(stored.filter(pa.array(chosen)))


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ([b"\1" + bytes(20)], "expected points of 29 bytes .* found one of 21 bytes"),
        (wkb(POINTS[:1], "<", 1), "found one of type 1"),
        ([b"\7" + wkb(POINTS[:1], "<", 1001)[0][1:]], "found 7"),
    ],
)
def test_geometry_that_is_no_points(tmp_path, points, message):
    path = tmp_path / "map.parquet"
    table = pa.table({"geometry": points}).replace_schema_metadata({"geo": GEO})
    path.write_bytes(parquet(table))
    with pytest.raises(MapFormatError, match=message):
        list(open_map(path).batches())


def test_lists_of_too_few_numbers_are_refused(tmp_path):
    path = tmp_path / "map.parquet"
    path.write_bytes(parquet(pa.table({"xyz": [[1.0, 2.0, 3.0], [1.0, 2.0]]})))
    with pytest.raises(MapFormatError, match="expected a whole Parquet file"):
        list(open_map(path).batches())


def test_decimals(tmp_path, rewrite, read_xyz):
    numbers = [Decimal("1.0001"), Decimal("-12345678.9012"), None]
    columns = {axis: pa.array(numbers, pa.decimal128(12, 4)) for axis in "xyz"}
    path = tmp_path / "map.parquet"
    path.write_bytes(parquet(pa.table(columns)))
    expected = np.repeat([[1.0001], [-12345678.9012], [np.nan]], 3, axis=1)
    np.testing.assert_array_equal(read_xyz(open_map(path)), expected)
    copy = rewrite(open_map(path), tmp_path / "copy.parquet", np.ones(3, bool), 2)
    assert pq.read_table(copy).equals(pa.table(columns))


@pytest.mark.parametrize("case", ["pq01_pdal_arrow.parquet", "pq04_decimal.parquet"])
def test_cases_are_read(shared_data, read_xyz, case):
    assert np.isfinite(read_xyz(open_map(shared_data / "cases" / case))).all()


GOOD = table_of_all_kinds(40)


@pytest.mark.parametrize(
    ("content", "expected", "found"),
    [
        (b"", "a Parquet file", "an empty file"),
        (b"version https://git-lfs.github.com/spec/v1\n", "a Parquet file", "git-LFS"),
        (parquet(GOOD)[:-100], "PAR1 at the end", "other bytes"),
        (b"PAR1" + struct.pack("<I", 2**31) + b"PAR1", "whole Parquet file", ""),
        (parquet(pa.table({"x": [1.0], "y": [1.0]})), "columns x, y and z", "x, y"),
        (parquet(pa.table({"x": ["a"], "y": [1], "z": [1]})), "numbers in column x", "type string"),
        (
            parquet(pa.table([[1.0]] * 4, names=["x", "y", "z", "x"])),
            "one column x",
            "several",
        ),
    ],
)
def test_broken_files_are_refused(tmp_path, content, expected, found):
    path = tmp_path / "map.parquet"
    path.write_bytes(content)
    with pytest.raises(MapFormatError) as raised:
        open_map(path)
    assert expected in raised.value.expected
    assert found in raised.value.found


@pytest.mark.parametrize(
    "options", [{}, {"compression": "ZSTD", "row_group_size": 15}, {"write_page_checksum": True}]
)
def test_damaged_files_are_read_or_refused(tmp_path, survives, options):
    table = GOOD.select(["x", "y", "z", "class", "seen"])
    _, refused = survives(parquet(table, **options), tmp_path / "map.parquet", 150)
    assert refused > 100


def test_a_text_stored_once_and_meant_often_is_read_in_bounded_batches(tmp_path):
    path = tmp_path / "map.parquet"
    count = 3000
    columns = {axis: np.arange(count, dtype=np.float32) for axis in "xyz"}
    text = pa.array(["a" * 100_000, None, "b"] * (count // 3), pa.large_string())
    path.write_bytes(parquet(pa.table(columns | {"text": text})))
    assert path.stat().st_size < 200_000
    reader = open_map(path)
    batches = [batch.records for batch in reader.batches()]
    assert sum(batch.num_rows for batch in batches) == count
    assert max(batch.nbytes for batch in batches) < 1 << 27
    assert pa.concat_tables(batches)["text"].equals(pa.chunked_array([text]))


def test_columns_of_other_names_are_refused_with_the_shape(tmp_path):
    path = tmp_path / "map.parquet"
    path.write_bytes(parquet(pa.table({axis: np.arange(9.0) for axis in ("0", "1", "2")})))
    with pytest.raises(MapFormatError, match="9 rows of 3 columns: 0, 1, 2"):
        open_map(path)
