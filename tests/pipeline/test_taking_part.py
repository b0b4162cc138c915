"""What takes no part in the decision: the same in memory, in tiles, and after any cut."""

import laspy
import numpy as np
import pyarrow.parquet as pq
import pytest

from dynahull import Label, clean
from pipeline.configuration.run import load_configuration
from pipeline.info import inspect_map
from pipeline.metres import open_collection
from pipeline.progress import LogDisplay, StageObserver
from pipeline.run import run
from tiling.errors import CoordinateSystemError, GridError
from tiling.formats import open_map
from tiling.formats.units import FOOT

pytestmark = pytest.mark.usefixtures("nothing_waits_for_the_disk")

IN_MEMORY, IN_TILES = 1_000_000, 700
TITLES = np.array([label.title for label in Label])


def labelled(maps, folder, max_points, *wanted):
    """Run, and return the report and the label of every point."""
    settings = [
        "execution.cluster=none",
        "output.labels=true",
        "output.report=none",
        f"tiling.max_points={max_points}",
        *wanted,
    ]
    configuration = load_configuration(None, settings)
    maps = maps if isinstance(maps, list) else [maps]
    report = run(maps, folder, configuration, StageObserver(LogDisplay()))
    table = pq.read_table(folder / "labels.parquet")
    labels = np.array(table["label"].to_pylist())
    names, counts = np.unique(labels, return_counts=True)
    found = {name: count for name, count in report.counts.items() if count}
    assert found == dict(zip(names.tolist(), counts.tolist(), strict=True))
    return report, labels, table


@pytest.fixture(scope="module")
def cases(shared_data):
    return shared_data / "cases"


def points_of(path):
    return np.concatenate([batch.xyz for batch in open_map(path).batches()])


@pytest.mark.parametrize("max_points", [IN_MEMORY, IN_TILES])
class TestCases:
    """Small maps with one oddity each; see their README for what is right."""

    def test_invalid_returns_at_the_origin(self, cases, tmp_path, max_points):
        path = cases / "pcd06_ouster_origin.pcd"
        report, labels, _ = labelled(path, tmp_path / "o", max_points)
        without = labelled(cases / "pcd06_without_origin.pcd", tmp_path / "w", IN_MEMORY)[1]
        origin = (points_of(path) == 0).all(axis=1)
        assert (labels[origin] == "invalid").all()
        np.testing.assert_array_equal(labels[~origin], without)
        assert any("exactly (0, 0, 0)" in warning for warning in report.warnings)

    def test_a_handful_of_far_strays(self, cases, tmp_path, max_points):
        path = cases / "pcd12_far_away.pcd"
        report, labels, _ = labelled(path, tmp_path / "o", max_points)
        points = points_of(path)
        far = (np.abs(points) > 1e5).any(axis=1)
        np.save(tmp_path / "without.npy", points[~far])
        without = labelled(tmp_path / "without.npy", tmp_path / "w", IN_MEMORY)[1]
        assert (labels[far] == "unscored").all()
        np.testing.assert_array_equal(labels[~far], without)
        assert any("farther from the rest" in warning for warning in report.warnings)

    def test_noise_and_withheld_points(self, cases, tmp_path, max_points):
        path = cases / "las17_noise_withheld.las"
        report, labels, _ = labelled(path, tmp_path / "o", max_points)
        without = labelled(cases / "las17_without_noise.las", tmp_path / "w", IN_MEMORY)[1]
        map_ = laspy.read(path)
        noise = np.isin(map_.classification, [7, 18]) | np.asarray(map_.withheld, bool)
        assert (labels[noise] == "unscored").all()
        np.testing.assert_array_equal(labels[~noise], without)
        assert any("left out of the decision" in warning for warning in report.warnings)
        kept = laspy.read(tmp_path / "o" / report.files[0].static)
        assert (
            np.isin(kept.classification, [7, 18]).sum()
            == np.isin(map_.classification, [7, 18]).sum()
        )

    def test_feet_are_decided_as_metres(self, cases, tmp_path, max_points):
        report, feet, table = labelled(cases / "las15_feet.las", tmp_path / "f", max_points)
        said, metres, other = labelled(cases / "las15_metres.las", tmp_path / "m", IN_MEMORY)
        # On their grids points lie up to 0.6 mm apart, which is enough for other clusters.
        assert (feet == "dynamic").sum() == pytest.approx((metres == "dynamic").sum(), rel=0.02)
        assert ((feet == "ground") != (metres == "ground")).sum() <= 5
        same = "clustering.count=1"
        _, feet, _ = labelled(cases / "las15_feet.las", tmp_path / "f1", max_points, same)
        _, metres, _ = labelled(cases / "las15_metres.las", tmp_path / "m1", IN_MEMORY, same)
        assert (feet != metres).sum() <= 10
        scored = np.isfinite(table["density"]) & np.isfinite(other["density"])
        densities = table["density"].to_numpy()[scored], other["density"].to_numpy()[scored]
        assert np.median(densities[0] / densities[1]) == pytest.approx(1, abs=0.02)
        assert "US survey foot" in report.system
        assert "US survey foot" in report.summary()
        assert "metre" in said.system


@pytest.mark.parametrize("max_points", [IN_MEMORY, IN_TILES])
def test_noise_and_what_lies_outside_the_window_are_counted_apart(tmp_path, max_points):
    xyz = np.random.default_rng(2).uniform(size=(4000, 3)) * [60, 20, 3]
    las = laspy.create(point_format=6, file_version="1.4")
    las.header.scales = [0.001] * 3
    las.xyz = xyz
    las.classification = np.where(np.arange(4000) % 50, 1, 7)
    las.write(tmp_path / "map.las")
    window = "input.window=[0, 0, 20, 20]"
    report, labels, _ = labelled(tmp_path / "map.las", tmp_path / "o", max_points, window)
    outside = las.x >= 30
    noise = (las.classification == 7) & ~outside
    told = [each for each in report.warnings if "left out of the decision" in each]
    assert [each.partition(":")[0] for each in told] == [
        f"{outside.sum():,} points are more than 10 m outside the window",
        f"{noise.sum()} points are of class 7, 18 or withheld",
    ]
    assert (labels[outside | noise] == "unscored").all()


def test_maps_in_different_units_are_not_one(cases, tmp_path):
    both = [cases / "las15_feet.las", cases / "las15_metres.las"]
    with pytest.raises(CoordinateSystemError, match=r"EPSG:6420.*EPSG:6419"):
        labelled(both, tmp_path / "o", IN_MEMORY)


def test_degrees_are_refused_unless_the_unit_is_given(shared_data, tmp_path):
    path = shared_data / "formats/pdal-test__autzen-dd.las"
    with pytest.raises(CoordinateSystemError, match="in degrees"):
        labelled(path, tmp_path / "o", IN_MEMORY)
    report, _, _ = labelled(path, tmp_path / "o", IN_MEMORY, "input.unit=metre")
    assert "as configured" in report.system
    assert "degree" in inspect_map([path]).to_text()


@pytest.mark.parametrize("max_points", [IN_MEMORY, IN_TILES])
def test_degrees_of_which_the_file_says_nothing_are_warned_of(tmp_path, max_points):
    metres = np.random.default_rng(2).uniform(size=(1000, 3)) * [30, 20, 3]
    np.save(tmp_path / "degrees.npy", metres / [55_000, 111_000, 1] + [24.9, 60.1, 30])
    report, _, _ = labelled(tmp_path / "degrees.npy", tmp_path / "o", max_points)
    assert sum("as if x and y were degrees" in each for each in report.warnings) == 1
    np.save(tmp_path / "metres.npy", metres)
    report, _, _ = labelled(tmp_path / "metres.npy", tmp_path / "o", max_points)
    assert not any("degrees" in each for each in report.warnings)


def test_heights_in_another_unit(shared_data):
    path = shared_data / "formats/pdal-test__autzen-bmx-cc.las"
    collection = open_collection([path], load_configuration(None).input)
    np.testing.assert_allclose(collection.metres, [1, 1, 1200 / 3937])


def test_info_says_system_and_unit(cases, tmp_path):
    text = inspect_map([cases / "las15_feet.las"]).to_text()
    assert "EPSG:6420, US survey foot" in text
    assert "US ft)" in text
    np.save(tmp_path / "a.npy", np.eye(3))
    assert "none, metres assumed" in inspect_map([tmp_path / "a.npy"]).to_text()


def test_a_unit_that_is_given_counts_for_any_format(tmp_path):
    points = room()
    np.save(tmp_path / "feet.npy", points / FOOT)
    expected = clean((points / FOOT) * FOOT, load_configuration(None).method()).labels
    for max_points in (IN_MEMORY, IN_TILES):
        folder = tmp_path / str(max_points)
        _, labels, _ = labelled(tmp_path / "feet.npy", folder, max_points, "input.unit=foot")
        np.testing.assert_array_equal(labels, TITLES[expected])


def test_a_map_in_feet_is_not_cut_into_las(cases, tmp_path):
    with pytest.raises(GridError, match="use Parquet"):
        labelled(cases / "las15_feet.las", tmp_path / "o", IN_TILES, "tiling.format=las")


def room(seed=0, count=1500):
    random = np.random.default_rng(seed)
    floor = random.uniform(size=(count, 3)) * [9, 7, 0.02]
    wall = random.uniform(size=(count, 3)) * [9, 0.02, 2.5]
    ghost = random.uniform(size=(count // 5, 3)) * [3, 2, 1.6] + [2, 3, 0.3]
    return random.permutation(np.vstack([floor, wall, ghost]))


@pytest.mark.parametrize("kept", [False, True])
def test_everything_at_once_is_the_same_however_it_is_cut(tmp_path, kept):
    """Strays, a heap, noise, and coordinates that cannot be measured; of text and LAS, and npz."""
    random = np.random.default_rng(3)
    points = room() + [100, 200, 50]
    points = np.insert(points, random.integers(0, len(points), 40), 0.0, axis=0)
    points = np.insert(points, [0, 900, len(points)], [[1e7, 0, 0], [0, 0, 9e5], [9e6] * 3], axis=0)
    points = np.insert(points, [5, 1200], [[np.nan, 0, 0], [1e200, 0, 0]], axis=0)
    maps = [tmp_path / "a.npz"]
    if kept:
        np.savez_compressed(maps[0], points)
        out = np.zeros(len(points), bool)
    else:
        # Of these together, coordinates are kept when they are decoded, not records.
        np.savetxt(tmp_path / "a.xyz", points)
        maps = [tmp_path / "a.pcd", tmp_path / "b.las"]
        write_text(maps[0], points)
        noise = np.tile([[100.0, 200, 50]], (2000, 1)) + random.uniform(0, 5, (2000, 3))
        header = laspy.LasHeader(point_format=6, version="1.4")
        header.scales = np.full(3, 0.001)
        file = laspy.LasData(header)
        file.xyz = noise
        file.classification = random.choice([1, 7, 18], 2000)
        file.withheld = random.random(2000) < 0.1
        file.write(maps[1])
        marked = np.isin(file.classification, [7, 18]) | np.asarray(file.withheld, bool)
        points = np.concatenate([points_of(path) for path in maps])
        out = np.append(np.zeros(len(points) - 2000, bool), marked)
    parameters = load_configuration(None).method()
    expected = clean(points, parameters, left_out=out)
    assert expected.counts()["invalid"] == 42
    assert expected.counts()["unscored"] == 3 + out.sum()
    for max_points in (IN_MEMORY, 500, 2500):
        _, labels, table = labelled(maps, tmp_path / str(max_points), max_points)
        np.testing.assert_array_equal(labels, TITLES[expected.labels])
        assert table["density"].to_numpy().tobytes() == expected.density.tobytes()
        assert table["cluster"].to_numpy().tobytes() == expected.cluster.tobytes()


def write_text(path, points):
    header = f"""VERSION .7
FIELDS x y z
SIZE 8 8 8
TYPE F F F
COUNT 1 1 1
WIDTH {len(points)}
HEIGHT 1
VIEWPOINT 0 0 0 1 0 0 0
POINTS {len(points)}
DATA ascii
"""
    rows = "\n".join(" ".join(map(repr, row)) for row in points.tolist())
    path.write_text(header + rows + "\n")


@pytest.mark.parametrize("point_format", range(11))
@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_classes_and_flags_of_every_point_format(tmp_path, point_format, suffix):
    if suffix == ".laz" and point_format in (4, 5, 9, 10):
        pytest.skip("laspy writes no LAZ with waveforms")
    version = "1.4" if point_format >= 6 else "1.3"
    map_ = laspy.LasData(laspy.LasHeader(point_format=point_format, version=version))
    map_.xyz = np.random.default_rng(0).uniform(size=(64, 3))
    classes = np.arange(64) % 32
    map_.classification = classes
    map_.synthetic = np.arange(64) % 3 == 0
    map_.key_point = np.arange(64) % 5 == 0
    map_.withheld = np.arange(64) % 7 == 0
    path = tmp_path / f"a{suffix}"
    map_.write(path)
    (batch,) = open_map(path).batches()
    np.testing.assert_array_equal(batch.classification, classes)
    np.testing.assert_array_equal(batch.withheld, np.arange(64) % 7 == 0)


def test_what_is_left_out_can_be_chosen(cases, tmp_path):
    path = cases / "las17_noise_withheld.las"
    settings = {
        "nothing": ["input.leave_out=[]", "input.leave_out_withheld=false"],
        "low noise": ["input.leave_out=[7]", "input.leave_out_withheld=false"],
        "what is deleted": ["input.leave_out=[]"],
    }
    map_ = laspy.read(path)
    expected = {
        "nothing": 0,
        "low noise": int((map_.classification == 7).sum()),
        "what is deleted": int(np.asarray(map_.withheld, bool).sum()),
    }
    for kind, wanted in settings.items():
        report, _, _ = labelled(path, tmp_path / kind, IN_MEMORY, *wanted)
        assert report.counts["unscored"] == expected[kind]


def test_a_map_that_is_all_noise_passes_through(cases, tmp_path):
    classes = f"[{', '.join(map(str, range(256)))}]"
    for max_points in (IN_MEMORY, IN_TILES):
        folder = tmp_path / str(max_points)
        wanted = f"input.leave_out={classes}"
        report, _, _ = labelled(cases / "las17_without_noise.las", folder, max_points, wanted)
        assert report.counts["unscored"] == report.points


def test_files_that_tell_no_system_are_taken_for_that_of_the_others(cases, tmp_path):
    np.save(tmp_path / "a.npy", np.eye(3))
    parameters = load_configuration(None).input
    collection = open_collection([cases / "las15_feet.las", tmp_path / "a.npy"], parameters)
    assert collection.metres is not None
    auto = parameters.model_copy(update={"unit": "metre"})
    assert open_collection([cases / "las15_feet.las"], auto).metres is None
