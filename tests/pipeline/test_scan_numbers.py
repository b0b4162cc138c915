"""What tells when the points of a map were seen: fields by name, the order of rows, or nothing."""

import json
import os

import laspy
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from dynahull import clean
from pipeline.configuration.run import load_configuration
from pipeline.errors import ConfigurationError
from pipeline.info import inspect_map
from pipeline.progress import LogDisplay, StageObserver
from pipeline.run import run
from pipeline.scan_numbers import find_scans
from pipeline.tiles.stages import TASKS
from pipeline.work.folder import WORK_FOLDER
from tiling.collection import MapCollection

pytestmark = pytest.mark.usefixtures("nothing_waits_for_the_disk")

COUNT, SCANS = 3000, 25
SCAN = np.arange(COUNT) * SCANS // COUNT
TIME = SCAN * 0.1 + 0.05
XYZ = np.random.default_rng(0).uniform(size=(COUNT, 3)) * [6, 5, 2]


def write(path, **fields):
    """Write a structured array with fields beside the coordinates."""
    described = [(name, "f8") for name in "xyz"]
    described += [(name, values.dtype) for name, values in fields.items()]
    records = np.zeros(len(XYZ), described)
    for axis, name in enumerate("xyz"):
        records[name] = XYZ[:, axis]
    for name, values in fields.items():
        records[name] = values
    np.save(path, records)
    return path


def found(paths, time="auto"):
    """Return the source, and the numbers of all points."""
    collection = MapCollection(paths if isinstance(paths, list) else [paths])
    configuration = load_configuration(None, [f"evidence.time={time}"])
    source = find_scans(collection, configuration)
    if source is None:
        return None, None
    batches = collection.batches(700)
    return source, np.concatenate([source.numbers(collection, *each) for each in batches])


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("scan", SCAN.astype("u4")),
        ("Scan_ID", SCAN.astype("i8") + 100),
        ("keyframe", SCAN.astype("u2")),
        ("point_source_id", SCAN.astype("u2") + 1),
        ("time", TIME),
        ("t", TIME.astype("f4")),
        ("GPS_Time", TIME + 1.3e9),
        ("timestamp", TIME * 1e9 + 1.7e18),
        ("timestamp", ((TIME + 1.7e9) * 1e9).astype("i8")),
        ("stamp", ((TIME + 1.7e9) * 1e6).astype("u8")),
        ("time_stamp", ((TIME + 1.7e9) * 1e3).astype("i8")),
    ],
)
def test_names_and_units(tmp_path, name, values):
    source, numbers = found(write(tmp_path / "a.npy", intensity=np.ones(COUNT), **{name: values}))
    assert str(source) == f"{name}, 25 scans"
    np.testing.assert_array_equal(numbers, SCAN)
    assert numbers.dtype == np.int32


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("scan", SCAN % 7),
        ("scan", np.arange(COUNT)),  # a number of the point
        ("scan_angle", SCAN),
        ("ring", SCAN),
        ("scan", SCAN.astype("f4") + 0.5),
        ("scan", np.where(SCAN == 24, 24.5, SCAN)),
        ("time", np.full(COUNT, 1.7e9)),
        ("time", np.zeros(COUNT)),
        ("time", np.full(COUNT, np.nan)),
        ("time", np.linspace(0, 0.1, COUNT)),  # of one sweep, as raw clouds carry it
        ("time", np.tile(np.linspace(0, 100, 100), COUNT // 100)),  # the same in milliseconds
        ("t", np.tile(np.linspace(0, 1e8, 100), COUNT // 100).astype("u4")),  # in nanoseconds
        ("offset_time", np.tile(np.linspace(0, 1e8, 100), COUNT // 100)),
        ("time", np.linspace(0, 1e6, COUNT).astype("i8")),  # of any unit
        ("time", (TIME * 1000 + 1.7e9).astype("f4")),  # steps of two minutes
        ("time", np.where(SCAN % 2, 1e-9, 1e9) * (SCAN + 1)),  # no numbers of 32 bits
    ],
)
def test_what_does_not_tell_for_sure_is_not_used(tmp_path, name, values):
    assert found(write(tmp_path / "a.npy", **{name: values})) == (None, None)
    assert "time        none" in inspect_map([tmp_path / "a.npy"]).to_text()


def test_scan_numbers_are_asked_before_times_and_useless_ones_passed_over(tmp_path):
    path = write(tmp_path / "a.npy", gps_time=TIME, scan=SCAN, t=TIME)
    assert found(path)[0].name == "scan"
    path = write(tmp_path / "c.npy", point_source_id=SCAN.astype("u2"), gps_time=TIME)
    assert found(path)[0].name == "gps_time"  # lines of flight are no scans
    path = write(tmp_path / "b.npy", gps_time=TIME, scan=SCAN * 0, frame=SCAN % 3)
    assert found(path)[0].name == "gps_time"


def test_points_without_a_time_have_no_number(tmp_path):
    gone = np.arange(COUNT) % 7 == 0
    _, numbers = found(write(tmp_path / "a.npy", time=np.where(gone, np.nan, TIME + 1e9)))
    np.testing.assert_array_equal(numbers, np.where(gone, -1, SCAN))
    _, numbers = found(write(tmp_path / "b.npy", scan=np.where(gone, -1, SCAN)))
    np.testing.assert_array_equal(numbers, np.where(gone, -1, SCAN))


def test_a_field_that_is_named(tmp_path):
    path = write(tmp_path / "a.npy", scan=SCAN, when=TIME, sweeps=SCAN[::-1].copy(), few=SCAN % 3)
    np.testing.assert_array_equal(found(path, "when")[1], SCAN)
    np.testing.assert_array_equal(found(path, "sweeps")[1], SCAN[::-1])
    assert found(path, "few") == (None, None)
    assert found(path, "off") == (None, None)
    with pytest.raises(ConfigurationError, match=r"a\.npy \(x, y, z, scan, when, .*found 'wenn'"):
        found(path, "wenn")


def test_files_that_count_anew_do_not_collide(tmp_path):
    again = [write(tmp_path / f"{n}.npy", scan=SCAN) for n in range(3)]
    source, numbers = found(again)
    assert source.scans == 3 * SCANS
    np.testing.assert_array_equal(numbers, np.concatenate([SCAN + n * SCANS for n in range(3)]))
    _, numbers = found([write(tmp_path / f"t{n}.npy", time=TIME) for n in range(2)])
    np.testing.assert_array_equal(numbers, np.concatenate([SCAN, SCAN + SCANS]))
    # Parts of one map: their numbers are those of the whole.
    parts = [write(tmp_path / f"p{n}.npy", scan=SCAN + 9 * n) for n in range(2)]
    np.testing.assert_array_equal(found(parts)[1], np.concatenate([SCAN, SCAN + 9]))
    times = [write(tmp_path / f"g{n}.npy", gps_time=TIME + 1e9) for n in range(2)]
    np.testing.assert_array_equal(found(times)[1], np.concatenate([SCAN, SCAN]))


def las(path):
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.scales = [0.001] * 3
    cloud = laspy.LasData(header)
    cloud.xyz, cloud.gps_time = XYZ, TIME + 2e8
    cloud.write(path)


def text_pcd(path):
    head = "FIELDS x y z Scan\nSIZE 4 4 4 4\nTYPE F F F U\nCOUNT 1 1 1 1\n"
    rows = "\n".join(f"{x:.3f} {y:.3f} {z:.3f} {s}" for (x, y, z), s in zip(XYZ, SCAN, strict=True))
    path.write_text(f"{head}WIDTH {COUNT}\nHEIGHT 1\nPOINTS {COUNT}\nDATA ascii\n{rows}\n")


def table(path):
    stamps = pa.array(((TIME + 1.7e9) * 1e6).astype("i8"), pa.timestamp("us"))
    columns = dict(zip("xyz", XYZ.T, strict=True))
    pq.write_table(pa.table({**columns, "stamp": stamps}), path)


def npy(path):
    write(path, time=TIME)


@pytest.mark.parametrize(
    ("make", "suffix"),
    [(las, "las"), (las, "laz"), (text_pcd, "pcd"), (table, "parquet"), (npy, "npy")],
)
def test_the_method_is_given_the_numbers_in_memory_and_in_tiles(
    tmp_path, monkeypatch, make, suffix
):
    path = tmp_path / f"map.{suffix}"
    make(path)
    seen = []
    monkeypatch.setattr(
        "pipeline.in_memory.clean",
        lambda *a, scan=None, **k: seen.append(scan) or clean(*a, scan=scan, **k),
    )
    monkeypatch.setattr("pipeline.work.job.ROWS_AT_A_TIME", 900)
    label_tile = TASKS["label"]
    monkeypatch.setitem(
        TASKS,
        "label",
        lambda job, tile: seen.append(job.scans_of(np.arange(COUNT))) or label_tile(job, tile),
    )
    for most in (COUNT, 1000):
        wanted = ["execution.cluster=none", f"tiling.max_points={most}", "ground.method=none"]
        configuration = load_configuration("auto", [*wanted, "neighbours.k=8"])
        observer = StageObserver(LogDisplay())
        report = run([path], tmp_path / f"out{most}", configuration, observer)
        assert report.time.endswith(", 25 scans")
        stored = json.loads((tmp_path / f"out{most}" / "run.json").read_text(encoding="utf-8"))
        assert stored["time"] == report.time
        assert f"time: {report.time}" in report.summary()
        page = (tmp_path / f"out{most}" / "report.html").read_text(encoding="utf-8")
        assert report.time in page
    assert len(seen) > 2
    for numbers in seen:
        np.testing.assert_array_equal(numbers, SCAN)


def test_nothing_is_looked_for_where_the_evidence_is_not_weighed(tmp_path, monkeypatch):
    path = write(tmp_path / "a.npy", scan=SCAN)
    monkeypatch.setattr("pipeline.in_memory.find_scans", None)
    wanted = ["ground.method=none", "neighbours.k=8", "output.report=none"]
    configuration = load_configuration("paper", wanted)
    assert run([path], tmp_path / "o", configuration, StageObserver(LogDisplay())).time is None


def flip(path):
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 4
    path.write_bytes(content)


@pytest.mark.parametrize("name", ["scan.rows", "scans.json", "times.done"])
@pytest.mark.parametrize("damage", [flip, lambda path: os.truncate(path, 9), os.unlink])
def test_numbers_that_were_damaged_are_made_again(tmp_path, monkeypatch, name, damage):
    path = write(tmp_path / "map.npy", scan=SCAN)
    wanted = ["execution.cluster=none", "tiling.max_points=1000", "ground.method=none"]
    configuration = load_configuration("auto", [*wanted, "neighbours.k=8", "output.report=none"])
    monkeypatch.setattr("pipeline.work.job.ROWS_AT_A_TIME", 900)
    weigh_tile, seen = TASKS["evidence"], []

    def killed(job, tile):
        if tile == 1:
            raise KeyboardInterrupt
        return weigh_tile(job, tile)

    def cleaned(task):
        monkeypatch.setitem(TASKS, "evidence", task)
        return run([path], tmp_path / "out", configuration, StageObserver(LogDisplay()))

    with pytest.raises(KeyboardInterrupt):
        cleaned(killed)
    damage(tmp_path / "out" / WORK_FOLDER / name)
    report = cleaned(
        lambda job, tile: seen.append(job.scans_of(np.arange(COUNT))) or weigh_tile(job, tile)
    )
    assert any("not as it was written" in each for each in report.warnings) or name == "times.done"
    assert report.time == "scan, 25 scans"
    for numbers in seen:
        np.testing.assert_array_equal(numbers, SCAN)
    assert seen


@given(
    times=arrays(np.float64, 60, elements=st.floats(0, 2e6)),
    unit=st.sampled_from([1, 10**3, 10**6, 10**9]),
)
@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_numbers_are_tenths_of_a_second_in_order(tmp_path, times, unit):
    times = np.repeat(1.6e9 + times, COUNT // 60)
    values, tenths = times, np.floor(times * 10)
    if unit > 1:
        milliseconds = np.floor(times * 1e3).astype("i8")
        values, tenths = milliseconds * (unit // 1000), milliseconds // 100
    source, numbers = found(write(tmp_path / "a.npy", timestamp=values))
    different = len(np.unique(tenths))
    assert (source is None) == (different < 8)
    if source is not None:
        assert source.scans == different
        np.testing.assert_array_equal(numbers, tenths - tenths.min())
