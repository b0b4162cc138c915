"""The part of a preview knows of each point's scan what the whole map knows."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from pipeline import preview as previews
from pipeline.configuration.run import load_configuration
from pipeline.metres import open_collection
from pipeline.preview import WHOLE, Window, preview
from pipeline.progress import LogDisplay, StageObserver
from pipeline.scan_numbers import find_scans
from tests.pipeline import test_key_frames as key_frames

pytestmark = pytest.mark.usefixtures("nothing_waits_for_the_disk")

SCANS, EACH = 25, 80
SCAN = np.repeat(np.arange(SCANS), EACH)
PLACES = np.linspace([1, 1, 1], [29, 4, 1], SCANS)
XYZ = PLACES[SCAN] + np.random.default_rng(0).uniform(-6, 6, (len(SCAN), 3))


def write_poses(path, places, times=None):
    turns = np.tile(np.eye(3), (len(places), 1, 1))
    rows = np.concatenate([turns, places[:, :, None]], axis=2).reshape(-1, 12)
    np.savetxt(path, rows if times is None else np.column_stack([times, rows]), "%.17g")


def known(paths, configuration):
    """Return points, and where the sensor was when it saw each; NaN where that is not known."""
    collection = open_collection(paths, configuration.input)
    source = find_scans(collection, configuration)
    sensor = None if source is None else source.sensor(collection)
    xyz, places = [], []
    for file, batch in collection.batches():
        found = np.full((len(batch.xyz), 3), np.nan)
        if sensor is not None:
            numbers = source.numbers(collection, file, batch)
            found[numbers >= 0] = sensor[numbers[numbers >= 0]]
        xyz.append(batch.xyz)
        places.append(found)
    return np.concatenate(xyz), np.concatenate(places)


def previewed(monkeypatch, path, folder, configuration, window, points=10**9):
    """Return points and places of the part that is cleaned, and the warnings."""
    taken, observer = [], StageObserver(LogDisplay())
    with monkeypatch.context() as patch:
        patch.setattr(
            previews,
            "run",
            lambda files, _, configuration, __: taken.append((files, configuration)),
        )
        preview([str(path)], folder, configuration, observer, points=points, window=window)
    return *known(*taken[0]), observer.warnings


def assert_known_alike(whole, part):
    (xyz, places), (some, their_places) = whole, part
    apart, rows = cKDTree(xyz).query(some)
    assert apart.max() < 1e-5
    np.testing.assert_allclose(their_places, places[rows], atol=1e-9)


NUMBERED = {
    "each": (lambda scan: scan, 0),
    "ranks": (lambda scan: scan * 10 + 1000, 0),
    "every second": (lambda scan: scan * 2, 0),
    "some missing": (lambda scan: np.where(scan % 5 == 2, 0, scan), 0),
    "some unknown": (lambda scan: np.where(scan % 5 == 2, -1, scan * 3), 5),
    "times": (lambda scan: scan * 0.1 + 0.05, 0),
}


@given(
    kind=st.sampled_from([*NUMBERED]),
    left=st.floats(-5, 28),
    width=st.floats(2, 40),
    points=st.sampled_from([60, 10**9]),
)
@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_scans_of_the_part_have_their_poses(tmp_path, kind, left, width, points):
    number, missing = NUMBERED[kind]
    name = "t" if kind == "times" else "scan"
    np.savez(tmp_path / "map.npz", points=XYZ, **{name: number(SCAN)})
    placed = PLACES if not missing else PLACES[np.arange(SCANS) % 5 != 2]
    write_poses(
        tmp_path / "poses.txt", placed, np.arange(SCANS) * 0.1 + 0.06 if name == "t" else None
    )
    configuration = load_configuration("auto", [f"input.poses={tmp_path}/poses.txt"])
    window = Window((left, -9.0), (left + width, 20.0))
    inside = window.holds(XYZ)
    if not inside.any():
        return
    whole = known([tmp_path / "map.npz"], configuration)
    with pytest.MonkeyPatch.context() as patch:
        *part, warnings = previewed(
            patch, tmp_path / "map.npz", tmp_path / "out", configuration, window, points
        )
    too_few = any("too few scans" in each for each in warnings)
    if too_few:
        assert np.isnan(part[1]).all()
        rows = cKDTree(XYZ).query(part[0])[1]
        assert len(np.unique(SCAN[rows])) < 10
    else:
        assert_known_alike(whole, part)


@pytest.mark.parametrize("layout", key_frames.LAYOUTS)
def test_parts_of_key_frames_stay_in_their_places(tmp_path, monkeypatch, layout):
    folder = layout(tmp_path / "in")
    configuration = load_configuration("auto")
    paths = previews.find_map_files([folder])
    whole = known(paths, configuration)
    for window in (WHOLE, Window((20.0, -18.0), (22.0, -16.0))):
        *part, _ = previewed(monkeypatch, folder, tmp_path / "out", configuration, window, 1000)
        assert not np.isnan(part[1]).any()
        assert_known_alike(whole, part)


def test_a_window_at_the_origin_is_no_sensor_s_frame(tmp_path, monkeypatch):
    random = np.random.default_rng(1)
    places = np.linspace([15, 0, 1], [25, 0, 1], 12)
    for number, place in enumerate(places):
        cloud = random.uniform([-3, -9, 0], [40, 9, 2], (300, 3)).astype("f4")
        viewpoint = " ".join(map(str, (*place, 1, 0, 0, 0)))
        key_frames.write_pcd(
            tmp_path / "in" / "pcd" / f"{number:02d}.pcd", cloud, number, viewpoint
        )
    configuration = load_configuration("auto")
    whole = known(previews.find_map_files([tmp_path / "in"]), configuration)
    window = Window((-3.0, -3.0), (3.0, 3.0))
    *part, _ = previewed(monkeypatch, tmp_path / "in", tmp_path / "out", configuration, window)
    assert_known_alike(whole, part)


@pytest.mark.parametrize("frame", ["sensor", "map"])
def test_the_frame_of_scans_can_be_told(tmp_path, frame):
    folder = key_frames.sc_lio_sam(tmp_path / "in")
    configuration = load_configuration("auto", [f"input.frame={frame}"])
    xyz, places = known(previews.find_map_files([folder]), configuration)
    own = np.concatenate(key_frames.CLOUDS).astype("f8")
    np.testing.assert_allclose(xyz, key_frames.WORLD if frame == "sensor" else own, atol=1e-9)
    expected = np.repeat(key_frames.POSES[:, :, 3], key_frames.EACH, axis=0)
    np.testing.assert_allclose(places, expected)
