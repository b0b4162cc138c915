"""LAS, LAZ and COPC against laspy, against real files, and against broken ones."""

import random
import re
import struct
import time
from collections.abc import Callable
from pathlib import Path

import laspy
import lazrs
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tiling.errors import MapFormatError, PointCountError
from tiling.formats import Field, open_map
from tiling.formats.las.fields import standard_fields
from tiling.formats.las.header import read_header
from tiling.formats.las.reader import LasReader

VERSION_AND_FORMATS = [
    (f"1.{minor}", point_format)
    for minor, highest in ((1, 1), (2, 3), (3, 5), (4, 10))
    for point_format in range(highest + 1)
]
REFUSED = {
    "laszip-test__broken_compressor.laz": "LASzip compressor 1 or 2",
    "laszip-test__broken_size.laz": "LASzip items of version 1 or 2",
    "laszip-test__broken_type.laz": "LASzip items (type, bytes)",
    "pdal-test__1.2-no-points.las": "room for 0",
    "pdal-test__1.2-with-color-clipped.las": "room for 1064",
}
NOT_READ_BY_LASPY = {
    # Read by LASzip, which does not need the chunk tables that lazrs looks for.
    "laspy-test__fuck.laz": 1065,
    "laszip-test__test.laz": 1065,
}
VERSION_4_ITEMS = "loaders-gl__pdrf9-1.5.laz"


def records_of(reader: LasReader, max_points: int = 10_000) -> np.ndarray:
    batches = [batch.records for batch in reader.batches(max_points)]
    length = read_header(reader.description.path).record_length
    return np.concatenate(batches) if batches else np.empty((0, length), np.uint8)


def write_selected(reader: LasReader, path: Path, chosen: np.ndarray, max_points: int) -> None:
    with reader.writer(path, int(chosen.sum())) as writer:
        for batch in reader.batches(max_points):
            here = chosen[batch.first_row : batch.first_row + len(batch.records)]
            writer.write(batch.select(here))


def laspy_bytes(path: Path) -> bytes:
    return laspy.read(path).points.array.tobytes()


def las_file(
    path: Path,
    *,
    version: str = "1.4",
    point_format: int = 6,
    raw: np.ndarray | None = None,
    count: int = 100,
    extra_bytes: int = 0,
    evlrs: bool = False,
) -> np.ndarray:
    """Write a file with laspy, LAZ if the suffix says so, and return its raw records."""
    header = laspy.LasHeader(version=version, point_format=point_format)
    header.scales, header.offsets = np.array([0.01, 0.02, 0.001]), np.array([5e5, -4e6, 0.1])
    if extra_bytes:
        header.add_extra_dim(laspy.ExtraBytesParams("colour of the day", f"{extra_bytes}u1"))
    header.vlrs.append(laspy.VLR("someone", 77, "a record of theirs", b"\x01\x02\x00\xff"))
    header.extra_header_bytes, header.extra_vlr_bytes = b"after header", b"before points"
    length = header.point_format.size
    if raw is None:
        raw = np.random.default_rng(0).integers(0, 256, (count, length), dtype=np.uint8)
    las = laspy.LasData(header)
    array = np.frombuffer(raw.tobytes(), header.point_format.dtype()).copy()
    las.points = laspy.ScaleAwarePointRecord(
        array, header.point_format, header.scales, header.offsets
    )
    if evlrs:
        evlr = laspy.VLR("someone", 78, "a long record", bytes(range(256)) * 9)
        las.evlrs = laspy.vlrs.vlrlist.VLRList([evlr])
    las.write(path)
    return raw


def laszip_record_span(block: bytes) -> tuple[int, int]:
    """Bytes of the data of the laszip VLR."""
    start = block.index(b"laszip encoded") - 2
    return start + 54, start + 54 + struct.unpack_from("<H", block, start + 20)[0]


def without_counts_and_bounds(path: Path, laszip: bool = True) -> bytes:
    """The bytes before the points, but for what depends on them."""
    header = read_header(path)
    block = bytearray(header.block)
    spans = [(107, 131), (179, 227)]
    if header.minor_version >= 3:
        spans.append((227, 235))
    if header.minor_version >= 4:
        spans += [(235, 243), (247, 375)]
    if header.minor_version >= 5:
        spans.append((375, 391))
    if header.compressed and not laszip:
        spans.append(laszip_record_span(header.block))
    for start, end in spans:
        block[start:end] = bytes(end - start)
    return bytes(block)


def evlr_bytes(path: Path) -> list[bytes]:
    data = path.read_bytes()
    return [
        data[record.start : record.end]
        for record in read_header(path).evlrs
        if record.user_id != "copc"
    ]


# What is read, and what is written of it


@settings(max_examples=60, deadline=None)
@given(
    kind=st.sampled_from(VERSION_AND_FORMATS),
    suffix=st.sampled_from([".las", ".laz"]),
    extra_bytes=st.sampled_from([0, 1, 3]),
    count=st.integers(0, 300),
    max_points=st.integers(1, 200),
    seed=st.integers(0, 2**32 - 1),
    data=st.data(),
)
def test_any_selection_of_any_file_comes_back_bit_for_bit(
    tmp_path_factory, kind, suffix, extra_bytes, count, max_points, seed, data
):
    folder = tmp_path_factory.mktemp("las")
    version, point_format = kind
    path, output = folder / f"in{suffix}", folder / f"out{suffix}"
    generator = np.random.default_rng(seed)
    length = laspy.PointFormat(point_format).size + extra_bytes
    raw = generator.integers(0, 256, (count, length), dtype=np.uint8)
    # Stretches of equal points are what compressors treat differently.
    raw = raw[np.sort(generator.integers(0, count, count))] if data.draw(st.booleans()) else raw
    if point_format >= 9:
        # laspy compresses wave packets of several scanner channels wrongly; see the test of those.
        raw[:, 15] &= 0xCF
    las_file(
        path,
        version=version,
        point_format=point_format,
        raw=raw,
        extra_bytes=extra_bytes,
        evlrs=version == "1.4",
    )
    chosen = generator.random(count) < data.draw(st.sampled_from([0.0, 0.3, 1.0]))

    reader = LasReader(path)
    sizes = [len(batch.records) for batch in reader.batches(max_points)]
    assert records_of(reader, max_points).tobytes() == raw.tobytes()
    assert sum(sizes) == count == reader.description.point_count
    assert max(sizes, default=0) <= max_points
    write_selected(reader, output, chosen, max_points)

    assert laspy_bytes(output) == raw[chosen].tobytes()
    assert records_of(LasReader(output)).tobytes() == raw[chosen].tobytes()
    # These wave packets are compressed otherwise than laspy does it; see their own tests.
    laszip = point_format not in (4, 5, 9, 10)
    assert without_counts_and_bounds(output, laszip) == without_counts_and_bounds(path, laszip)
    assert evlr_bytes(output) == evlr_bytes(path)
    counts_and_bounds_are_those_of_laspy(output)


def counts_and_bounds_are_those_of_laspy(path: Path) -> None:
    las = laspy.read(path)
    assert las.header.point_count == len(las.points)
    if len(las.points) == 0:
        assert not las.header.mins.any()
        assert not las.header.maxs.any()
        return
    highest_return = 15 if las.header.version.minor >= 4 else 5
    returns = np.bincount(las.return_number, minlength=16)[1 : highest_return + 1]
    assert las.header.number_of_points_by_return[:highest_return].tolist() == returns.tolist()
    # A bound may keep the bits that the input's writer rounded it to: half a grid step at most.
    scales = las.header.scales
    assert np.all(np.abs(las.header.mins - las.xyz.min(axis=0)) < scales / 2)
    assert np.all(np.abs(las.header.maxs - las.xyz.max(axis=0)) < scales / 2)


@pytest.mark.parametrize("point_format", [1, 6])
def test_coordinates_and_classes_are_those_of_laspy(tmp_path, point_format):
    path = tmp_path / "map.laz"
    las_file(path, point_format=point_format)
    las = laspy.read(path)
    (batch,) = LasReader(path).batches()
    assert batch.xyz.dtype == np.float64
    assert np.array_equal(batch.xyz, las.xyz)
    assert batch.classification.dtype == np.uint8
    assert np.array_equal(batch.classification, np.asarray(las.classification))


@pytest.mark.parametrize("point_format", [9, 10])
def test_wave_packets_of_several_scanner_channels_survive_compression(tmp_path, point_format):
    path, output = tmp_path / "in.las", tmp_path / "out.laz"
    raw = las_file(path, point_format=point_format, count=400)
    assert len(np.unique((raw[:, 15] >> 4) & 3)) == 4
    # laspy writes such files wrongly, so the compressed input is one of a single channel.
    single = raw.copy()
    single[:, 15] &= 0xCF
    las_file(tmp_path / "in.laz", point_format=point_format, raw=single)
    with LasReader(tmp_path / "in.laz").writer(output, len(raw)) as writer:
        writer.write(raw[:150])
        writer.write(raw[150:])
    assert laspy_bytes(output) == raw.tobytes()
    assert records_of(LasReader(output), 33).tobytes() == raw.tobytes()


@pytest.mark.parametrize("point_format", [4, 5])
def test_wave_packets_are_named_as_laszip_knows_them(tmp_path, point_format):
    path, output = tmp_path / "in.laz", tmp_path / "out.laz"
    raw = las_file(path, version="1.3", point_format=point_format)
    write_selected(LasReader(path), output, np.ones(len(raw), dtype=bool), 50)
    block = read_header(output).block
    start, end = laszip_record_span(block)
    items = dict(struct.iter_unpack("<H2xH", block[start + 34 : end]))
    assert items[9] == 1
    assert laspy_bytes(output) == raw.tobytes()


def test_description_names_format_fields_and_crs(tmp_path):
    path = tmp_path / "map.LAZ"
    las_file(path, point_format=6, extra_bytes=3)
    path.rename(tmp_path / "map.laz")
    description = open_map(tmp_path / "map.laz").description
    assert description.format == "LAZ 1.4, point format 6"
    assert description.suffix == ".laz"
    assert description.point_count == 100
    assert [f.name for f in description.fields][:4] == ["X", "Y", "Z", "intensity"]
    last = description.fields[-1]
    assert (last.name, last.dtype, last.count) == ("colour of the day", "uint8", 3)
    assert description.has_classification
    assert description.crs is None
    assert description.notes == ()


def test_a_writer_refuses_another_number_of_points_than_promised(tmp_path):
    path = tmp_path / "map.laz"
    raw = las_file(path)
    writer = LasReader(path).writer(tmp_path / "out.laz", 3)
    with pytest.raises(PointCountError), writer:
        writer.write(raw[:2])


# Real files


def test_real_files_are_read_as_laspy_reads_them_and_written_back(shared_data, tmp_path):
    folders = [shared_data / "formats", shared_data / "ground"]
    paths = sorted(p for f in folders for p in f.iterdir() if p.suffix in (".las", ".laz"))
    assert len(paths) > 60
    for path in paths:
        if path.name in REFUSED or path.name == VERSION_4_ITEMS:
            continue
        reader = LasReader(path)
        records = records_of(reader, 7_000)
        if path.name in NOT_READ_BY_LASPY:
            assert len(records) == NOT_READ_BY_LASPY[path.name]
        else:
            las = laspy.read(path)
            assert records.tobytes() == las.points.array.tobytes(), path.name
            xyz = np.concatenate([batch.xyz for batch in reader.batches()])
            assert np.array_equal(xyz, las.xyz), path.name
        chosen = np.random.default_rng(1).random(len(records)) < 0.5
        output = tmp_path / f"{path.stem}{reader.description.suffix}"
        write_selected(reader, output, chosen, 5_000)
        assert laspy_bytes(output) == records[chosen].tobytes(), path.name
        counts_and_bounds_are_those_of_laspy(output)
        assert evlr_bytes(output) == evlr_bytes(path), path.name
        if not reader.description.format.startswith("COPC"):
            before = without_counts_and_bounds(path, laszip=False)
            assert without_counts_and_bounds(output, laszip=False) == before, path.name


@pytest.mark.parametrize("name", REFUSED)
def test_broken_real_files_are_refused_in_one_line(shared_data, name):
    with pytest.raises(MapFormatError) as caught:
        LasReader(shared_data / "formats" / name)
    assert REFUSED[name] in str(caught.value)
    assert name in str(caught.value)
    assert "byte" in caught.value.at


def test_chunk_tables_are_not_needed_where_chunks_have_one_size(shared_data):
    formats = shared_data / "formats"
    intact = records_of(LasReader(formats / "laspy-test__simple.laz"))
    damaged = records_of(LasReader(formats / "laspy-test__fuck.laz"))
    assert damaged.tobytes() == intact.tobytes()


def test_version_4_items_are_read_by_laszip(shared_data):
    reader = LasReader(shared_data / "formats" / VERSION_4_ITEMS)
    assert len(records_of(reader, 100)) == 1024


def test_copc_is_written_as_plain_laz(shared_data, tmp_path):
    path = shared_data / "formats" / "pdal-test__1.2-with-color.copc.laz"
    reader = LasReader(path)
    assert reader.description.format == "COPC (LAZ 1.4, point format 7)"
    assert reader.description.suffix == ".laz"
    assert "COPC index" in reader.description.notes[0]
    output = tmp_path / "out.laz"
    write_selected(reader, output, np.ones(1065, dtype=bool), 400)
    written = read_header(output)
    assert [r.user_id for r in written.vlrs + written.evlrs if r.user_id == "copc"] == []
    assert len(written.vlrs) == len(read_header(path).vlrs) - 1
    assert LasReader(output).description.format == "LAZ 1.4, point format 7"
    assert LasReader(output).description.crs == reader.description.crs


def test_waveform_packets_inside_the_file_are_copied(shared_data, tmp_path):
    path = shared_data / "formats" / "laspy-test__simple1_3.las"
    output = tmp_path / "out.las"
    write_selected(LasReader(path), output, np.arange(999) < 10, 1_000)
    packets = []
    for file in (path, output):
        start, end = read_header(file).waveforms
        packets.append(file.read_bytes()[start:end])
    assert packets[0] == packets[1]
    assert len(packets[0]) >= 60
    assert output.stat().st_size < path.stat().st_size


def test_external_waveform_packets_are_noted(shared_data):
    reader = LasReader(shared_data / "formats" / "laspy-test__fullwave.laz")
    assert ".wdp" in reader.description.notes[0]


@pytest.mark.parametrize(
    ("name", "crs"),
    [
        ("pdal-test__utm15.las", "EPSG:26915"),
        ("laspy-test__1_4_w_evlr.las", "EPSG:2903"),
        ("pdal-test__bad-geotiff-keys.las", "EPSG:32617"),
        ("pdal-test__autzen-bmx-cc.las", "NAD83 / Oregon LCC (m) + NAVD88 height (ftUS)"),
        ("laspy-test__simple.laz", None),
    ],
)
def test_crs_of_real_files(shared_data, name, crs):
    assert LasReader(shared_data / "formats" / name).description.crs == crs


@pytest.mark.parametrize(
    ("text", "crs"),
    [
        (
            'PROJCS["A ""b""",GEOGCS["B",AUTHORITY["EPSG","1"]],AUTHORITY["EPSG","26910"]]',
            "EPSG:26910",
        ),
        ('PROJCRS["UTM [10]",BASEGEOGCRS["B",ID["EPSG",4269]],ID["EPSG",26910]]', "EPSG:26910"),
        ('GEOGCS["WGS 84",DATUM["D",AUTHORITY["EPSG","6326"]]]', "WGS 84"),
        ("no well-known text ]](((", None),
        ("", None),
    ],
)
def test_crs_in_well_known_text_is_named_by_the_outermost_authority(tmp_path, text, crs):
    path = tmp_path / "map.las"
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.vlrs.append(laspy.VLR("LASF_Projection", 2112, "", text.encode() + b"\0"))
    laspy.LasData(header).write(path)
    assert LasReader(path).description.crs == crs


# Broken files


def patched(path: Path, at: int, data: bytes) -> None:
    content = bytearray(path.read_bytes())
    content[at : at + len(data)] = data
    path.write_bytes(content)


def cut(path: Path, size: int) -> None:
    path.write_bytes(path.read_bytes()[:size])


BROKEN: dict[str, tuple[str, Callable[[Path], None], str]] = {
    "empty": (".las", lambda p: p.write_bytes(b""), "an empty file"),
    "pointer": (
        ".laz",
        lambda p: p.write_bytes(b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n"),
        "git-LFS pointer",
    ),
    "text": (".las", lambda p: p.write_bytes(b"x y z\n1 2 3\n" * 99), '"LASF", found'),
    "cut header": (".las", lambda p: cut(p, 200), "a header of 227 bytes"),
    "version": (".las", lambda p: patched(p, 25, b"\x09"), "found 1.9 at byte 24"),
    "header size": (".las", lambda p: patched(p, 94, b"\xe2\x00"), "375 bytes or more"),
    "shorter header": (".las", lambda p: patched(p, 94, b"\xe3\x00"), "points counted"),
    "points beyond": (".las", lambda p: patched(p, 96, b"\xff\xff\xff\x7f"), "at byte 96"),
    "format": (".las", lambda p: patched(p, 104, b"\x0b"), "found 11 at byte 104"),
    "record of 0": (".las", lambda p: patched(p, 105, b"\0\0"), "found 0 bytes at byte 105"),
    "scale": (".las", lambda p: patched(p, 131, bytes(8)), "scale of x other than 0"),
    "scale nan": (".laz", lambda p: patched(p, 139, b"\xff" * 8), "scale nan"),
    "offset inf": (".las", lambda p: patched(p, 171, struct.pack("<d", np.inf)), "offset inf"),
    "count": (".las", lambda p: patched(p, 247, b"\xff" * 7), "room for"),
    "cut points": (".las", lambda p: cut(p, 1000), "found room for"),
    "no laszip VLR": (".las", lambda p: patched(p, 104, b"\x86"), "a laszip VLR"),
    "LAZ count": (".laz", lambda p: patched(p, 247, b"\xff" * 7), "LAZ chunks up to byte"),
    "cut LAZ": (".laz", lambda p: cut(p, p.stat().st_size - 3000), "LAZ chunks up to byte"),
}


def without_evlrs(path: Path) -> None:
    cut(path, int.from_bytes(path.read_bytes()[235:243], "little"))


HARMLESS: dict[str, tuple[Callable[[Path], None], str]] = {
    "one VLR too many": (lambda p: patched(p, 100, bytes([2 + p.match("*.laz")])), "counts . VLRs"),
    "VLR count": (lambda p: patched(p, 100, b"\xff\xff\xff\xff"), "counts 4294967295 VLRs"),
    "EVLR count": (lambda p: patched(p, 243, b"\xff\xff\xff\xff"), "counts 4294967295 EVLRs"),
    "EVLR offset": (without_evlrs, "counts 1 EVLRs, but the file has 0"),
    "EVLR cut off": (lambda p: cut(p, p.stat().st_size - 7), "counts 1 EVLRs, but the file has 0"),
    "header of 227 bytes": (lambda p: shorten_header(p, 227), "has 227 bytes, and that of LAS 1.4"),
    "header of 374 bytes": (lambda p: shorten_header(p, 374), "has 374 bytes, and that of LAS 1.4"),
}


def shorten_header(path: Path, size: int) -> None:
    content = bytearray(path.read_bytes())
    evlrs = int.from_bytes(content[235:243], "little")
    start = int.from_bytes(content[94:96], "little")
    cut_off = start - size
    content[107:111] = content[247:251]  # the older count, which is what is left
    content[94:96] = size.to_bytes(2, "little")
    points = int.from_bytes(content[96:100], "little")
    content[96:100] = (points - cut_off).to_bytes(4, "little")
    if path.match("*.laz"):
        table = int.from_bytes(content[points : points + 8], "little", signed=True)
        content[points : points + 8] = (table - cut_off).to_bytes(8, "little", signed=True)
    path.write_bytes(bytes(content[:size] + content[start:evlrs]))


@pytest.mark.parametrize("suffix", [".las", ".laz"])
@pytest.mark.parametrize("case", HARMLESS)
@pytest.mark.parametrize("labelled", [False, True])
def test_headers_that_lie_harmlessly_are_read_with_a_note(tmp_path, suffix, case, labelled):
    """The points are all there; what is written of them is sound, and opens in laspy."""
    spoil, note = HARMLESS[case]
    path, output = tmp_path / f"map{suffix}", tmp_path / f"out{suffix}"
    las_file(path, evlrs=True)
    expected = records_of(LasReader(path))
    spoil(path)
    reader = LasReader(path)
    assert any(re.search(note, each) for each in reader.description.notes), reader.description
    assert np.array_equal(records_of(reader), expected)
    if labelled:
        extended = reader.extended([Field("label", "uint8")])
        with extended.writer(output, len(expected)) as writer:
            for batch in reader.batches():
                labels = np.full(len(batch.xyz), 3, np.uint8)
                writer.write(extended.extend(batch, [labels]))
        las = laspy.read(output)
        assert (las["label"] == 3).all()
        assert np.array_equal(las.X, expected[:, :4].copy().view("<i4")[:, 0])
    else:
        write_selected(reader, output, np.ones(len(expected), bool), 1000)
        assert np.array_equal(records_of(LasReader(output)), expected)
        if "header" not in case:
            assert laspy_bytes(output) == expected.tobytes()
            assert LasReader(output).description.notes == ()


@pytest.mark.parametrize("name", ["las01_13_header227.las", "las02_vlr_count.las"])
def test_cases_that_lie_harmlessly(shared_data, name):
    reader = LasReader(shared_data / "cases" / name)
    assert len(reader.description.notes) == 1
    assert len(records_of(reader)) == 6000


@pytest.mark.parametrize("case", BROKEN)
def test_broken_files_are_refused_in_one_line(tmp_path, case):
    suffix, spoil, message = BROKEN[case]
    path = tmp_path / f"map{suffix}"
    las_file(path, evlrs=True)
    spoil(path)
    with pytest.raises(MapFormatError) as caught:
        records_of(LasReader(path))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("point_format", [3, 7])
@pytest.mark.parametrize("share", [0.2, 0.7, 0.95])
def test_a_cut_laz_file_is_refused(tmp_path, point_format, share):
    path = tmp_path / "map.laz"
    las_file(path, version="1.4", point_format=point_format)
    start = read_header(path).points_offset
    cut(path, int(start + (path.stat().st_size - start) * share))
    with pytest.raises(MapFormatError, match=r"compressed points|LAZ chunks"):
        records_of(LasReader(path))


def test_layers_that_claim_gigabytes_are_refused(tmp_path):
    path = tmp_path / "map.laz"
    las_file(path, point_format=6)
    first_layer_size = read_header(path).points_offset + 8 + 30 + 4
    patched(path, first_layer_size, b"\xff\xff\xff\x7f" * 4)
    with pytest.raises(MapFormatError, match="LAZ chunks up to byte"):
        records_of(LasReader(path))


@pytest.mark.parametrize("point_format", [1, 7])
def test_chunks_of_various_sizes_are_read(tmp_path, point_format):
    path = tmp_path / "map.laz"
    raw = las_file(path, point_format=point_format, count=100)
    block = bytearray(read_header(path).block)
    start, end = laszip_record_span(bytes(block))
    vlr = lazrs.LazVlr.new_for_compression(point_format, 0, True)
    block[start:end] = vlr.record_data()
    with path.open("wb") as file:
        file.write(block)
        compressor = lazrs.LasZipCompressor(file, vlr)
        for first, last in ((0, 1), (1, 70), (70, 100)):
            compressor.compress_many(raw[first:last].reshape(-1))
            compressor.finish_current_chunk()
        compressor.done()
    reader = LasReader(path)
    assert records_of(reader, 30).tobytes() == raw.tobytes()
    write_selected(reader, tmp_path / "out.laz", np.ones(100, dtype=bool), 30)
    assert laspy_bytes(tmp_path / "out.laz") == raw.tobytes()


@pytest.mark.parametrize(("at", "data"), [(4, b"\xff\xff\xff\xff"), (0, b"\x01")])
def test_a_chunk_table_that_lies_is_refused(shared_data, tmp_path, at, data):
    source = shared_data / "formats" / "pdal-test__1.2-with-color.copc.laz"
    path = tmp_path / "map.laz"
    path.write_bytes(source.read_bytes())
    start = read_header(path).points_offset
    (table,) = struct.unpack_from("<Q", path.read_bytes(), start)
    patched(path, table + at, data)
    with pytest.raises(MapFormatError, match="chunk table of version 0"):
        records_of(LasReader(path))


def test_a_chunk_table_is_found_at_the_end_of_a_streamed_file(shared_data, tmp_path):
    source = shared_data / "formats" / "pdal-test__1.2-with-color.copc.laz"
    intact = records_of(LasReader(source))
    path = tmp_path / "map.laz"
    start = read_header(source).points_offset
    content = source.read_bytes()
    path.write_bytes(content + content[start : start + 8])
    patched(path, start, b"\xff" * 8)
    assert records_of(LasReader(path)).tobytes() == intact.tobytes()


def test_less_than_a_point_behind_the_last_one_is_noted(tmp_path):
    path = tmp_path / "map.las"
    raw = las_file(path)
    patched(path, path.stat().st_size, b"garbage")
    reader = LasReader(path)
    assert records_of(reader).tobytes() == raw.tobytes()
    assert reader.description.notes == ("The 7 bytes after the last point are left out.",)


def test_points_that_are_not_counted_are_refused(tmp_path):
    path = tmp_path / "map.las"
    las_file(path)
    patched(path, 247, struct.pack("<Q", 60))
    with pytest.raises(MapFormatError, match="no points but the 60 points counted, found"):
        LasReader(path)


def test_a_fault_of_the_disk_is_not_the_files(tmp_path, monkeypatch):
    path = tmp_path / "map.laz"
    las_file(path)
    reader = LasReader(path)

    def fail(self, size):
        self.fault = OSError("the disk is gone")
        raise self.fault

    monkeypatch.setattr("tiling.formats.las.laz._Window._read_points", fail)
    with pytest.raises(OSError, match="the disk is gone"):
        records_of(reader)


def mutate(content: bytes, generator: random.Random) -> bytes:
    """Spoil some bytes, mostly of what the header and the start of the points say."""
    spoilt = bytearray(content)
    (points,) = struct.unpack_from("<I", content, 96)
    for _ in range(generator.choice((1, 1, 2, 8))):
        end = generator.choice((len(content), min(len(content), points + 60), 375))
        at = generator.randrange(94, max(95, min(end, len(content))))
        data = generator.choice((b"\xff" * 4, bytes(4), b"\xff" * 8, generator.randbytes(1)))
        spoilt[at : at + len(data)] = data
    if generator.random() < 0.25:
        del spoilt[generator.randrange(len(spoilt)) :]
    return bytes(spoilt)


def check_mutations(sources: list[Path], folder: Path, seeds: range) -> None:
    """Every spoilt file is read in full or refused, soon."""
    contents = {source.name: source.read_bytes() for source in sources}
    path = folder / "spoilt.laz"
    refused = 0
    for seed in seeds:
        generator = random.Random(seed)
        name = generator.choice(sorted(contents))
        path.write_bytes(mutate(contents[name], generator))
        started = time.monotonic()
        try:
            reader = LasReader(path)
            count = sum(len(batch.records) for batch in reader.batches())
            assert count == reader.description.point_count, (name, seed)
        except MapFormatError as error:
            assert "\n" not in str(error), (name, seed)
            refused += 1
        assert time.monotonic() - started < 2, (name, seed)
    assert 0 < refused < len(seeds)


def test_spoilt_files_are_read_or_refused(tmp_path):
    sources = []
    for version, point_format in (("1.2", 3), ("1.3", 5), ("1.4", 6), ("1.4", 10)):
        for suffix in (".las", ".laz"):
            sources.append(tmp_path / f"{version}-{point_format}{suffix}")
            las_file(sources[-1], version=version, point_format=point_format, extra_bytes=3)
    check_mutations(sources, tmp_path, range(300))


def test_spoilt_real_files_are_read_or_refused(shared_data, tmp_path):
    folder = shared_data / "formats"
    sources = [p for p in folder.iterdir() if p.suffix in (".las", ".laz")]
    sources = [p for p in sources if p.stat().st_size < 40_000 and p.name not in REFUSED]
    check_mutations(sources, tmp_path, range(300))


@pytest.mark.parametrize("point_format", range(11))
def test_fields_are_named_as_laspy_names_them(point_format):
    expected = [
        (dimension.name, "uint8" if dimension.dtype is None else dimension.dtype.name)
        for dimension in laspy.PointFormat(point_format).standard_dimensions
    ]
    assert [(field.name, field.dtype) for field in standard_fields(point_format)] == expected
