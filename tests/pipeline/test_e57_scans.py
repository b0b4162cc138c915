"""E57 keeps the poses of its scans: they tell what scans saw, as those of key frames do."""

import numpy as np
import pyarrow.parquet as pq
import pytest

from dynahull import Label, clean
from pipeline.configuration.run import load_configuration
from pipeline.info import inspect_map
from pipeline.metres import open_collection
from pipeline.preview import WHOLE, preview
from pipeline.progress import LogDisplay, StageObserver
from pipeline.run import run
from pipeline.scan_numbers import find_scans
from tests.pipeline.test_key_frames import CLOUDS, EACH, FRAMES, POSES, WORLD, points_of, quaternion
from tests.tiling.test_e57 import libe57, real, structure, text

pytestmark = pytest.mark.usefixtures("nothing_waits_for_the_disk")

TOLD = f"scans of the file, {FRAMES} scans with poses"


def write(path, clouds=CLOUDS, poses=POSES, times=None):
    """Write scans in the frames of their sensors, and their poses; times, scaled, if given."""
    image = libe57.ImageFile(str(path), "w")
    image.extensionsAdd("", libe57.E57_V1_0_URI)
    root, scans = image.root(), libe57.VectorNode(image, True)
    for name, value in (("formatName", "ASTM E57 3D Imaging Data File"), ("guid", "{map}")):
        root.set(name, text(image, value))
    root.set("data3D", scans)
    names = [f"cartesian{axis}" for axis in "XYZ"]
    for cloud, pose in zip(clouds, poses, strict=True):
        scan = structure(image, guid=text(image, "{scan}"))
        turn = zip("wxyz", quaternion(pose[:, :3]), strict=True)
        rotation = structure(image, **{name: real(image, float(value)) for name, value in turn})
        place = {axis: real(image, float(v)) for axis, v in zip("xyz", pose[:, 3], strict=True)}
        scan.set("pose", structure(image, rotation=rotation, translation=structure(image, **place)))
        scans.append(scan)
        prototype = structure(image, **{name: real(image, 0.0) for name in names})
        if times is not None:
            stamp = libe57.ScaledIntegerNode(image, 0, 0, 10**9, 1e-3, 5.0)
            prototype.set("timeStamp", stamp)
        points = libe57.CompressedVectorNode(image, prototype, libe57.VectorNode(image, True))
        scan.set("points", points)
        buffers, columns = libe57.VectorSourceDestBuffer(), cloud.T.astype("f8").copy()
        for name, column in zip(names, columns, strict=True):
            buffers.append(libe57.SourceDestBuffer(image, name, column, len(column), False, False))
        if times is not None:
            stored = np.rint((times[: len(cloud)] - 5.0) * 1e3).astype("q")
            stamps = libe57.SourceDestBuffer(image, "timeStamp", stored, len(cloud), False, False)
            buffers.append(stamps)
        writer = points.writer(buffers)
        if len(cloud):
            writer.write(len(cloud))
        writer.close()
    image.close()
    return path


def configured(*wanted, most=10**6):
    chosen = ["execution.cluster=none", "ground.method=none", "neighbours.k=8"]
    return load_configuration("auto", [*chosen, f"tiling.max_points={most}", *wanted])


def source_of(paths, *wanted):
    collection = open_collection(paths, configured(*wanted).input)
    source = find_scans(collection, configured(*wanted))
    numbers = None
    if source is not None:
        batches = collection.batches(50)
        numbers = np.concatenate([source.numbers(collection, *each) for each in batches])
    return collection, source, numbers


@pytest.mark.parametrize("most", [10**6, 700])
def test_scans_are_looked_at_from_where_they_were_taken(tmp_path, most):
    clouds = [*CLOUDS[:5], CLOUDS[0][:0], *CLOUDS[5:]]  # a scan without a point among them
    path = write(tmp_path / "map.e57", clouds, POSES[[*range(6), *range(5, FRAMES)]])
    collection, source, _ = source_of([path])
    scan = np.repeat([*range(5), *range(6, FRAMES + 1)], EACH)
    np.testing.assert_allclose(source.sensor(collection)[6:], POSES[5:, :, 3])
    expected = clean(
        points_of(collection),
        {"removal": {"decision": "auto"}, "neighbours": {"k": 8}, "ground": {"method": "none"}},
        scan=scan,
        poses=collection.poses.poses,
    )
    wanted = configured("output.labels=true", "output.report=none", most=most)
    report = run([path], tmp_path / "out", wanted, StageObserver(LogDisplay()))
    assert report.time == TOLD.replace("24", "25")
    found = pq.read_table(tmp_path / "out" / "labels.parquet")
    titles = [Label(label).title for label in expected.labels]
    assert found["label"].to_pylist() == titles
    np.testing.assert_array_equal(found["score"].to_numpy(), expected.score)
    assert f"time        {report.time}" in inspect_map([path]).to_text()


def test_a_scan_a_file_is_the_same(tmp_path):
    paths = [
        write(tmp_path / f"{number:02d}.e57", CLOUDS[number : number + 1], POSES[[number]])
        for number in range(FRAMES)
    ]
    collection, source, numbers = source_of(paths)
    assert str(source) == TOLD
    np.testing.assert_array_equal(numbers, np.repeat(np.arange(FRAMES), EACH))
    np.testing.assert_allclose(points_of(collection), WORLD, atol=1e-6)


def test_places_are_in_the_unit_of_the_points(tmp_path):
    path = write(tmp_path / "map.e57")
    collection, source, _ = source_of([path], "input.unit=foot")
    np.testing.assert_allclose(source.sensor(collection), POSES[:, :, 3] * 0.3048)
    np.testing.assert_allclose(points_of(collection), WORLD * 0.3048, atol=1e-6)


def test_poses_that_tell_nothing_are_not_used(tmp_path):
    still = np.tile(POSES[:1], (FRAMES, 1, 1))
    assert source_of([write(tmp_path / "one.e57", poses=still)])[1] is None
    assert source_of([write(tmp_path / "off.e57")], "evidence.time=off")[1] is None
    order = np.lexsort(np.floor(WORLD[:, :2] / 1.5).T)  # tiles, each from a corner of its own
    tiles = np.array_split(WORLD[order], 4)
    corners = np.stack([np.column_stack([np.eye(3), tile.min(axis=0)]) for tile in tiles])
    clouds = [tile - pose[:, 3] for tile, pose in zip(tiles, corners, strict=True)]
    path = write(tmp_path / "tiles.e57", clouds, corners)
    assert open_collection([path], configured().input).poses is not None
    assert source_of([path])[1] is None


def test_times_are_those_of_a_file_of_one_scan(tmp_path):
    times = 7.05 + np.repeat(np.arange(FRAMES), EACH) * 0.1
    path = write(tmp_path / "one.e57", [WORLD], np.eye(3, 4)[None], times)
    _, source, numbers = source_of([path])
    assert str(source) == f"timeStamp, {FRAMES} scans"
    np.testing.assert_array_equal(numbers, np.repeat(np.arange(FRAMES), EACH))
    still = np.tile(np.eye(3, 4), (2, 1, 1))  # each counts from its own beginning
    path = write(tmp_path / "two.e57", np.array_split(WORLD, 2), still, times)
    assert source_of([path])[1] is None


def test_a_preview_has_the_poses(tmp_path):
    path = write(tmp_path / "map.e57")
    observer = StageObserver(LogDisplay())
    report = preview(
        [str(path)], tmp_path / "out", configured(), observer, points=900, window=WHOLE
    )
    assert report.points == 900
    assert report.time == TOLD
