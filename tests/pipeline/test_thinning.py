"""The thinned map: a point a voxel, whole, the same however the map is cut."""

import json

import laspy
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynahull import Label
from pipeline.configuration.run import OutputParameters, load_configuration
from pipeline.outputs import thinning
from pipeline.progress import Display, StageObserver
from pipeline.run import run
from tiling.collection import MapCollection
from tiling.errors import MapFormatError
from tiling.formats import open_map

pytestmark = pytest.mark.usefixtures("nothing_waits_for_the_disk")


def expected_rows(xyz, kept, voxel):
    """One row a voxel, found by looking at each in turn."""
    best = {}
    for row in np.flatnonzero(kept & np.isfinite(xyz).all(axis=1)):
        cell = np.floor(xyz[row] / voxel)
        off = float(((xyz[row] / voxel - cell - 0.5) ** 2).sum())
        key = tuple(cell)
        if key not in best or off < best[key][0]:
            best[key] = (off, row)
    return sorted(row for _, row in best.values())


@settings(deadline=None, max_examples=40)
@given(
    seed=st.integers(0, 2**32 - 1),
    counts=st.lists(st.integers(0, 300), min_size=1, max_size=3),
    voxel=st.sampled_from([0.05, 0.3, 2.0]),
    shift=st.sampled_from([0.0, -7.3, 652_345.5]),
    each=st.sampled_from([20, 10**6]),
)
def test_of_each_voxel_the_point_nearest_to_its_middle_stays(
    tmp_path_factory, seed, counts, voxel, shift, each
):
    folder, random = tmp_path_factory.mktemp("thin"), np.random.default_rng(seed)
    parts = [random.uniform(0, 2, (count, 3)) + shift for count in counts]
    parts[0][:3] = np.nan
    for number, part in enumerate(parts):
        np.save(folder / f"{number}.npy", part)
    collection = MapCollection([folder / f"{number}.npy" for number in range(len(parts))])
    xyz = np.concatenate(parts)
    labels = random.choice([Label.STATIC, Label.DYNAMIC, Label.GROUND], len(xyz)).astype(np.uint8)
    places = [folder / f"thin-{number}.npy" for number in range(len(parts))]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(thinning, "_POINTS_A_FILE", each)
        observer = StageObserver(Display())
        output = OutputParameters(voxel=voxel)
        count = thinning.write_thinned(collection, labels, output, places, folder, observer)
    rows = expected_rows(xyz, labels != Label.DYNAMIC, voxel)
    found = np.concatenate([np.load(place) for place in places])
    assert count == len(rows)
    np.testing.assert_array_equal(found, xyz[rows])
    assert not (folder / "voxels").exists()


@pytest.mark.parametrize("fields", ["nearest", "mean"])
def test_a_run_writes_it_with_all_fields_in_memory_and_over_tiles(tmp_path, fields):
    random = np.random.default_rng(5)
    las = laspy.create(point_format=6, file_version="1.4")
    las.xyz = random.uniform(size=(6000, 3)) * [30, 12, 0.3]
    las.gps_time = np.arange(6000)
    las.write(tmp_path / "map.las")
    settings = [
        "neighbours.k=12",
        "execution.cluster=none",
        "ground.method=none",
        "output.voxel=0.5",
        f"output.voxel_fields={fields}",
    ]
    bytes_of = []
    for tiles in ([], ["tiling.max_points=1500"]):
        configuration = load_configuration("paper", [*settings, *tiles])
        report = run(
            [tmp_path / "map.las"], tmp_path / "out", configuration, StageObserver(Display())
        )
        assert "thinned.las" in json.loads((tmp_path / "out/run.json").read_text())["outputs"]
        bytes_of.append((tmp_path / "out/thinned.las").read_bytes())
    assert bytes_of[0] == bytes_of[1]
    thin, static = laspy.read(tmp_path / "out/thinned.las"), laspy.read(tmp_path / "out/static.las")
    assert 0 < len(thin.points) < len(static.points) == report.points - report.counts["dynamic"]
    if fields == "nearest":
        rows = np.searchsorted(static.gps_time, thin.gps_time)
        np.testing.assert_array_equal(static.points.array[rows], thin.points.array)
    run([tmp_path / "map.las"], tmp_path / "out", load_configuration(None, settings[:3]),
        StageObserver(Display()))  # fmt: skip
    assert not (tmp_path / "out/thinned.las").exists()


FIELDS = np.dtype(
    [
        ("x", "<f8"),
        ("y", "<f8"),
        ("z", "<f8"),
        ("intensity", "<u2"),
        ("heat", "<f4"),
        ("far", "<i8"),
    ]
    + [("stamp", "<u8"), ("label", "u1"), ("scan_id", "<i4"), ("scan_angle", "i1"), ("rgb", "<f4")]
)
AVERAGED = ("x", "y", "z", "intensity", "heat", "far", "stamp", "scan_angle")


def points_with_fields(random, count, shift):
    """Points of all kinds of fields, whose integers no float64 holds."""
    points = np.zeros(count, FIELDS)
    for name in "xyz":
        points[name] = random.uniform(0, 2, count) + shift
    points["heat"] = np.where(random.random(count) < 0.3, np.nan, random.normal(size=count))
    points["far"] = random.integers(-(2**63), 2**63 - 1, count)
    points["stamp"] = 2**64 - 1 - random.integers(0, 2**62, count, np.uint64)
    points["scan_angle"] = random.integers(-128, 128, count)
    for name in ("intensity", "label", "scan_id"):
        points[name] = random.integers(0, 200, count)
    points["rgb"] = random.integers(0, 256, (count, 4), np.uint8).view(np.float32)[:, 0]
    return points


def expected_means(points, kept, voxel, file):
    """Averaged voxel by voxel, integers as Python has them; only points of the nearest's file."""
    xyz = np.column_stack([points[name] for name in "xyz"])
    cells = np.floor(xyz / voxel)
    for row in expected_rows(xyz, kept, voxel):
        own = kept & (cells == cells[row]).all(axis=1) & (file == file[row])
        mean = points[row].copy()
        for name in AVERAGED:
            values = points[name][own]
            if values.dtype.kind == "f":
                finite = values[np.isfinite(values)].astype(np.longdouble)
                mean[name] = finite.mean() if len(finite) else mean[name]
            else:
                total, count = sum(values.tolist()), len(values)
                mean[name] = (2 * total + count) // (2 * count)
        channels = points["rgb"][own].copy().view(np.uint8).reshape(-1, 4).astype(int)
        rounded = (2 * channels.sum(axis=0) + len(channels)) // (2 * len(channels))
        mean["rgb"] = rounded.astype(np.uint8).view(np.float32)[0]
        yield mean


@settings(deadline=None, max_examples=30)
@given(
    seed=st.integers(0, 2**32 - 1),
    counts=st.lists(st.integers(1, 150), min_size=1, max_size=3),
    voxel=st.sampled_from([0.05, 0.6, 4.0]),
    shift=st.sampled_from([0.0, -7.3, 652_345.5]),
    each=st.sampled_from([20, 10**6]),
    batch=st.sampled_from([7, 500_000]),
)
def test_fields_are_averaged_over_the_points_of_a_voxel(
    tmp_path_factory, seed, counts, voxel, shift, each, batch
):
    folder, random = tmp_path_factory.mktemp("mean"), np.random.default_rng(seed)
    parts = [points_with_fields(random, count, shift) for count in counts]
    for number, part in enumerate(parts):
        np.save(folder / f"{number}.npy", part)
    collection = MapCollection([folder / f"{number}.npy" for number in range(len(parts))])
    points = np.concatenate(parts)
    labels = random.choice([Label.STATIC, Label.DYNAMIC], len(points)).astype(np.uint8)
    places = [folder / f"thin-{number}.npy" for number in range(len(parts))]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(thinning, "_POINTS_A_FILE", each)
        patch.setattr(thinning, "DEFAULT_BATCH", batch)
        output = OutputParameters(voxel=voxel, voxel_fields="mean")
        observer = StageObserver(Display())
        thinning.write_thinned(collection, labels, output, places, folder, observer)
    found = np.concatenate([np.load(place) for place in places])
    file = np.repeat(np.arange(len(counts)), counts)
    wanted = np.array([*expected_means(points, labels != Label.DYNAMIC, voxel, file)], FIELDS)
    assert len(found) == len(wanted)
    for name in FIELDS.names:
        if FIELDS[name].kind == "f" and name != "rgb":
            np.testing.assert_allclose(
                found[name], wanted[name], rtol=3e-7 if name == "heat" else 1e-14
            )
        else:
            assert found[name].tobytes() == wanted[name].tobytes(), name


def maps_of_all_formats(folder):
    """A map of 400 points in each format that can be averaged, with an intensity, and a class."""
    random = np.random.default_rng(8)
    xyz = np.round(random.uniform(0, 4, (400, 3)), 3)
    intensity = random.integers(0, 60_000, 400).astype(np.uint16)
    kind = random.integers(0, 20, 400).astype(np.uint8)
    las = laspy.create(point_format=7, file_version="1.4")
    las.header.scales = [0.001] * 3
    las.add_extra_dim(
        laspy.ExtraBytesParams("heat", np.int16, scales=np.array([0.5]), offsets=np.array([3.0]))
    )
    las.xyz, las.intensity, las.classification = xyz, intensity, kind
    las.red, las.heat = intensity, random.integers(0, 99, 400) * 0.5
    las.write(folder / "a.las")
    las.write(folder / "a.laz")
    dtype = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<u2"), ("class", "u1")]
    rows = np.empty(400, dtype)
    for name, values in zip(rows.dtype.names, [*xyz.T, intensity, kind], strict=True):
        rows[name] = values
    np.save(folder / "a.npy", rows)
    np.save(folder / "columns.npy", np.column_stack([xyz, intensity]))
    np.savez(folder / "a.npz", points=xyz, intensity=intensity, label=kind)
    np.column_stack([xyz, intensity]).astype("<f4").tofile(folder / "a.bin")
    table = pa.table({name: pa.array(rows[name]) for name in rows.dtype.names})
    nulls = pa.array(rows["x"], mask=np.arange(400) % 5 == 0)
    pq.write_table(table.append_column("heat", nulls), folder / "a.parquet")
    for order, words in (("<", "binary_little_endian"), (">", "binary_big_endian")):
        head = f"ply\nformat {words} 1.0\nelement vertex 400\n" + "".join(
            f"property {name} {each}\n"
            for name, each in zip(
                ("float",) * 3 + ("ushort", "uchar"), rows.dtype.names, strict=True
            )
        )
        content = rows.astype(rows.dtype.newbyteorder(order)).tobytes()
        (folder / f"{words}.ply").write_bytes(f"{head}end_header\n".encode() + content)
    head = (
        "VERSION .7\nFIELDS x y z intensity class\nSIZE 4 4 4 2 1\nTYPE F F F U U\n"
        "COUNT 1 1 1 1 1\n"
        "WIDTH 400\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 400\nDATA binary"
    )
    (folder / "a.pcd").write_bytes(f"{head}\n".encode() + rows.tobytes())
    raw = b"".join(rows[name].tobytes() for name in rows.dtype.names)
    literal = [raw[start : start + 32] for start in range(0, len(raw), 32)]
    stored = b"".join(bytes([len(part) - 1]) + part for part in literal)
    sizes = np.array([len(stored), len(raw)], "<u4").tobytes()
    (folder / "packed.pcd").write_bytes(f"{head}_compressed\n".encode() + sizes + stored)


def test_every_binary_format_takes_means(tmp_path):
    maps_of_all_formats(tmp_path)
    paths = [path for path in sorted(tmp_path.iterdir()) if path.is_file()]
    assert len(paths) == 11
    labels = np.zeros(400, np.uint8)
    for path in paths:
        collection = MapCollection([path])
        (reader,) = collection.readers
        place, staging = tmp_path / "thin" / path.name, tmp_path / path.stem
        staging.mkdir(exist_ok=True)
        output = OutputParameters(voxel=1.0, voxel_fields="mean")
        thinning.write_thinned(
            collection, labels, output, [place], staging, StageObserver(Display())
        )
        (before,), (after,) = reader.batches(), open_map(place).batches()
        assert len(after.xyz) == 64
        cells = np.floor(before.xyz).astype(int) @ [16, 4, 1]
        count = np.bincount(cells)
        found = np.floor(after.xyz).astype(int) @ [16, 4, 1]
        for axis in range(3):
            mean = np.bincount(cells, before.xyz[:, axis]) / count
            np.testing.assert_allclose(after.xyz[:, axis], mean[found], atol=6e-4)
        names = [field.name for field in reader.description.fields]
        for name in {"intensity", "red", "column 4", "heat"} & set(names):
            values = np.asarray(reader.values(before.records, name), float)
            there = np.isfinite(values)
            mean = np.bincount(cells[there], values[there]) / np.bincount(cells[there])
            own = np.asarray(reader.values(after.records, name), float)
            np.testing.assert_allclose(own, mean[found], atol=0.51)
        for name in {"class", "classification", "label"} & set(names):
            off = ((before.xyz % 1 - 0.5) ** 2).sum(axis=1)
            nearest = np.lexsort((np.arange(400), off, cells))[np.cumsum([0, *count[:-1]])]
            own = np.asarray(reader.values(after.records, name))
            np.testing.assert_array_equal(
                own, np.asarray(reader.values(before.records, name))[nearest][found]
            )


def test_text_is_refused_before_any_work_where_means_are_asked_for(tmp_path):
    np.savetxt(tmp_path / "map.xyz", np.random.default_rng(0).uniform(size=(50, 3)))
    configuration = load_configuration(None, ["output.voxel=0.5", "output.voxel_fields=mean"])
    with pytest.raises(
        MapFormatError, match=r"a binary format with fields, as output\.voxel_fields"
    ):
        run([tmp_path / "map.xyz"], tmp_path / "out", configuration, StageObserver(Display()))
    assert not (tmp_path / "out/run.json").exists()
