"""Fields as sensors and programs call them: those that tell scans, and those that do not."""

import laspy
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pipeline.configuration.run import load_configuration
from pipeline.progress import LogDisplay, StageObserver
from pipeline.run import run
from pipeline.scan_fields import Overlap
from pipeline.scan_numbers import find_scans
from tiling.collection import MapCollection

pytestmark = pytest.mark.usefixtures("nothing_waits_for_the_disk")

SCANS, EACH = 30, 120
COUNT = SCANS * EACH
SCAN = np.repeat(np.arange(SCANS), EACH)
TIME = np.arange(COUNT) / COUNT * SCANS * 0.1
XYZ = np.random.default_rng(0).uniform(size=(COUNT, 3)) * [6, 5, 2]
FLOOR = np.random.default_rng(1).uniform(size=(30_000, 3)) * [60, 50, 0.02]
TILE = (FLOOR[:, :2] // 10 @ [5, 1]).astype(np.int64)


def write(path, xyz=XYZ, **fields):
    """Write points and fields as PLY or npy."""
    kinds = {"f": "float", "d": "double", "I": "uint", "i": "int", "H": "ushort"}
    described = [(axis, "<f8") for axis in "xyz"]
    described += [(name, values.dtype) for name, values in fields.items()]
    records = np.zeros(len(xyz), described)
    for axis, column in zip("xyz", xyz.T, strict=True):
        records[axis] = column
    for name, values in fields.items():
        records[name] = values
    if path.suffix == ".npy":
        np.save(path, records)
        return path
    lines = [f"property {kinds[records.dtype[name].char]} {name}" for name in records.dtype.names]
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(xyz)}", *lines]
    path.write_bytes("\n".join([*head, "end_header\n"]).encode() + records.tobytes())
    return path


def found(path):
    """Return the source of a map's scan numbers, and the numbers."""
    collection = MapCollection([path])
    source = find_scans(collection, load_configuration("auto"))
    if source is None:
        return None, None
    batches = collection.batches(700)
    return source, np.concatenate([source.numbers(collection, *each) for each in batches])


@pytest.mark.parametrize("suffix", ["ply", "npy"])
@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("scalar_Original_cloud_index", SCAN.astype("f4")),  # CloudCompare, merged
        ("scalar_GpsTime", TIME + 1e6),  # CloudCompare
        ("GpsTime", TIME + 3e5),
        ("timestamp", TIME + 1.7e9),  # Hesai, RoboSense: seconds
        ("timestamp", (TIME + 1.7e9) * 1e9),  # Livox: nanoseconds
        ("frame_id", SCAN.astype("u4")),
        ("scan_id", SCAN.astype("u2")),
        ("scan_idx", SCAN.astype("f8")),
        ("source_id", SCAN.astype("u2")),
    ],
)
def test_what_tells_scans_is_found(tmp_path, suffix, name, values):
    source, numbers = found(write(tmp_path / f"map.{suffix}", **{name: values}))
    assert source is not None
    assert source.name == name
    np.testing.assert_array_equal(numbers, SCAN)


def test_point_source_ids_are_scans_where_they_saw_the_same_places(tmp_path):
    for name, xyz, values in (("scans", XYZ, SCAN + 1), ("tiles", FLOOR, TILE + 1)):
        cloud = laspy.create(point_format=3, file_version="1.2")
        cloud.header.scales = [0.001] * 3
        cloud.xyz, cloud.point_source_id = xyz, values
        cloud.write(tmp_path / f"{name}.las")
    source, numbers = found(tmp_path / "scans.las")
    assert source.name == "point_source_id"
    np.testing.assert_array_equal(numbers, SCAN)
    assert found(tmp_path / "tiles.las") == (None, None)


@pytest.mark.parametrize("name", ["scan", "frame_id", "scalar_Original_cloud_index"])
def test_numbers_of_tiles_are_none_of_scans(tmp_path, name):
    assert len(np.unique(TILE)) == 30
    assert found(write(tmp_path / "map.npy", FLOOR, **{name: TILE})) == (None, None)
    assert (
        found(write(tmp_path / "other.npy", FLOOR, **{name: np.arange(len(FLOOR)) // 1000}))[0]
        is not None
    )


NAMES = ["t", "time", "timestamp", "stamp", "offset_time", "time_offset", "gps_time", "GpsTime",
         "scalar_GpsTime", "point_time", "scan", "frame"]  # fmt: skip


@given(
    name=st.sampled_from(NAMES),
    period=st.floats(0.05, 2.0),
    unit=st.sampled_from([1, 10**3, 10**6, 10**9]),
    kind=st.sampled_from(["f4", "f8", "u4", "i8"]),
    rings=st.sampled_from([1, 4]),
    is_before=st.booleans(),
)
@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_offsets_within_a_scan_are_never_used(tmp_path, name, period, unit, kind, rings, is_before):
    one = np.tile(np.linspace(0, 1, EACH // rings, endpoint=False), rings)
    offsets = np.tile(one, SCANS) * period
    if is_before and kind != "u4":
        offsets -= period  # Velodyne: before the end of the scan
    values = (offsets * unit).clip(max=2.0**32 - 1024).astype(kind)
    assert found(write(tmp_path / "map.npy", **{name: values})) == (None, None)


@given(name=st.sampled_from(NAMES), value=st.floats(-1e18, 1e18), kind=st.sampled_from("fdiq"))
@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_constants_are_never_used(tmp_path, name, value, kind):
    most = np.iinfo(kind).max if kind in "iq" else 1e18
    values = np.full(COUNT, min(max(value, -most), most)).astype(kind)
    assert found(write(tmp_path / "map.npy", **{name: values})) == (None, None)


@pytest.mark.parametrize("tiles", [10**6, 1500])
def test_what_is_not_used_changes_no_bit(tmp_path, tiles):
    offset = (np.tile(np.linspace(0, 1e8, EACH), SCANS)).astype("u4")
    path = write(tmp_path / "map.npy", t=offset, frame=np.zeros(COUNT, "u4"), scan=SCAN % 3)
    wanted = ["execution.cluster=none", f"tiling.max_points={tiles}", "neighbours.k=8"]
    tables = []
    for time in ("auto", "off"):
        settings = [*wanted, f"evidence.time={time}", "output.labels=true", "output.report=none"]
        configuration = load_configuration("auto", settings)
        run([path], tmp_path / time, configuration, StageObserver(LogDisplay()))
        tables.append((tmp_path / time / "labels.parquet").read_bytes())
    assert tables[0] == tables[1]


@given(seed=st.integers(0, 2**32 - 1), parts=st.integers(1, 9), most=st.sampled_from([10, 1 << 18]))
@settings(deadline=None)
def test_what_scans_share_does_not_depend_on_how_points_come(seed, parts, most):
    random = np.random.default_rng(seed)
    xyz = random.uniform(-9, 9, (400, 3))
    xyz[:3] = np.nan, np.inf, 1e300
    scan = random.integers(-(2**62), 2**62, 1 + seed % 5)[random.integers(0, 1 + seed % 5, 400)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("pipeline.scan_fields._MOST_PAIRS", most)
        found = []
        for pieces in (1, parts):
            order = random.permutation(400)
            overlap = Overlap()
            for rows in np.array_split(order, pieces):
                overlap.add(xyz[rows], scan[rows])
            found.append((overlap._pairs.tolist(), overlap._places.tolist(), overlap.is_shared()))
    assert found[0] == found[1]
    places = np.floor(xyz[3:] / 0.5)
    pairs = np.unique(np.column_stack([places, scan[3:].astype("f8")]), axis=0)
    _, counts = np.unique(pairs[:, :3], axis=0, return_counts=True)
    if most > 400:
        assert found[0][2] == ((counts > 1).sum() >= max(0.12 * len(counts), 1))
    else:
        assert len(found[0][0]) <= most
