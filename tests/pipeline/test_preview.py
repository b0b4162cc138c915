import json
import subprocess
import sys

import laspy
import numpy as np
import pytest

from pipeline.configuration.run import load_configuration
from pipeline.errors import ConfigurationError
from pipeline.preview import PART_FOLDER, SMALLEST_SIDE, WHOLE, Window, preview, typical_window
from pipeline.progress import LogDisplay, StageObserver
from tiling.collection import MapCollection
from tiling.formats import open_map
from tiling.formats.points import PointBatch
from tiling.survey import survey_batches

FAST = ("ground.method=none", "clustering.count=2", "neighbours.k=10")


def hall(count=6_000):
    rng = np.random.default_rng(0)
    return rng.uniform(size=(count, 3)) * [30, 20, 3]


def previewed(maps, folder, **wanted):
    configuration = load_configuration("paper", [*FAST, *wanted.pop("settings", [])])
    wanted.setdefault("points", 1_000)
    return preview([str(each) for each in maps], folder, configuration, observer(), **wanted)


def observer():
    return StageObserver(LogDisplay())


def part_of(folder, suffix=".npy"):
    (part,) = (folder / PART_FOLDER).glob(f"part_*{suffix}")
    return np.concatenate([batch.xyz for batch in open_map(part).batches()])


@pytest.fixture
def map_file(tmp_path):
    np.save(tmp_path / "hall.npy", hall())
    return tmp_path / "hall.npy"


def test_a_window_is_cleaned_as_a_map_of_its_own(map_file, tmp_path):
    window = Window((5.0, 5.0), (12.0, 11.0))
    report = previewed([map_file], tmp_path / "out", window=window, points=100_000)
    inside = hall()[window.holds(hall())]
    np.testing.assert_array_equal(part_of(tmp_path / "out"), inside)
    assert report.points == len(inside)
    assert (tmp_path / "out" / "report.html").is_file()
    (warning,) = report.warnings
    assert f"{len(inside)} of its 6,000 points" in warning
    assert "x from 5.00 to 12.00 m, y from 5.00 to 11.00 m" in warning
    assert "thinned" not in warning


def test_the_whole_map_thinned_is_evenly_thinned_and_told(map_file, tmp_path):
    report = previewed([map_file], tmp_path / "out", window=WHOLE)
    part = part_of(tmp_path / "out")
    assert len(part) == report.points == 1_000
    rows = np.flatnonzero((hall()[:, None] == part[None]).all(axis=2).any(axis=1))
    assert len(rows) == 1_000
    assert np.diff(rows).max() < 20
    assert "the whole map, thinned from 6,000" in report.warnings[0]


def test_what_is_thinned_does_not_depend_on_the_order_of_reading(tmp_path):
    np.save(tmp_path / "one.npy", hall())
    for number, piece in enumerate(np.split(hall(), [10, 4_000])):
        np.save(tmp_path / f"piece_{number}.npy", piece)
    previewed([tmp_path / "one.npy"], tmp_path / "one", window=WHOLE)
    pieces = [tmp_path / f"piece_{number}.npy" for number in range(3)]
    report = previewed(pieces, tmp_path / "many", window=WHOLE)
    parts = [np.load(file.path) for file in report.files]
    np.testing.assert_array_equal(np.concatenate(parts), part_of(tmp_path / "one"))


def test_a_small_map_is_taken_whole_and_nothing_is_said(map_file, tmp_path):
    report = previewed([map_file], tmp_path / "out", points=6_000)
    assert report.points == 6_000
    assert report.warnings == []
    assert not list((tmp_path / "out").rglob("part_*"))


def test_the_report_is_written_whatever_the_configuration_says(map_file, tmp_path):
    previewed([map_file], tmp_path / "out", settings=["output.report=none"])
    assert (tmp_path / "out" / "report.html").is_file()


def test_previews_can_be_repeated_in_the_same_folder(map_file, tmp_path):
    first = previewed([map_file], tmp_path / "out", window=Window((0, 0), (9, 9)))
    second = previewed([map_file], tmp_path / "out", window=Window((9, 9), (20, 20)))
    assert first.points != second.points
    assert len(part_of(tmp_path / "out")) == second.points


def test_a_window_without_points_is_refused_in_one_line(map_file, tmp_path):
    with pytest.raises(ConfigurationError, match=r"hall\.npy: no point in the window, x from 90"):
        previewed([map_file], tmp_path / "out", window=Window((90, 90), (99, 99)))
    assert not (tmp_path / "out").exists()


def test_a_part_of_a_las_map_keeps_fields_and_classes(tmp_path):
    las = laspy.create(point_format=6, file_version="1.4")
    las.x, las.y, las.z = hall().T
    las.classification = np.arange(6_000) % 5
    las.write(tmp_path / "hall.laz")
    window = Window((5.0, 5.0), (12.0, 11.0))
    previewed([tmp_path / "hall.laz"], tmp_path / "out", window=window, points=100_000,
              settings=["ground.method=las_class"])  # fmt: skip
    whole = laspy.read(tmp_path / "hall.laz")
    inside = window.holds(np.column_stack([whole.x, whole.y, whole.z]))
    part = laspy.read(tmp_path / "out" / PART_FOLDER / "part_hall.laz")
    np.testing.assert_array_equal(part.classification, whole.classification[inside])


def occupancy_of(points):
    return survey_batches([PointBatch(0, points, None)]).occupancy


def test_the_chosen_window_holds_as_many_points_as_it_may_and_is_typical():
    rng = np.random.default_rng(1)
    # A street, a place where the sensor stood, and a sparse edge.
    street = np.column_stack([rng.uniform(0, 256, 60_000), rng.uniform(0, 16, 60_000)])
    stand = rng.normal([40, 8], 0.5, (15_000, 2))
    edge = rng.uniform(-500, 500, (5_000, 2))
    flat = np.concatenate([street, stand, edge])
    points = np.column_stack([flat, np.zeros(len(flat))])
    window = typical_window(occupancy_of(points), 1.0, 10_000)
    inside = window.holds(points)
    assert 2_500 < inside.sum() <= 10_000
    assert window.low[0] >= 0 and window.high[0] <= 256
    assert window.low[1] < 8 < window.high[1]
    assert not window.holds(np.array([[40.0, 8.0, 0.0]]))[0]
    # A sample of the map chooses much the same size.
    half = typical_window(occupancy_of(points[::2]), 2.0, 10_000)
    assert half.high[0] - half.low[0] == window.high[0] - window.low[0]


def test_a_map_too_dense_for_any_window_gets_one_of_the_smallest():
    points = np.random.default_rng(2).uniform(size=(50_000, 3)) * [9, 9, 3]
    window = typical_window(occupancy_of(points), 1.0, 1_000)
    assert window.high[0] - window.low[0] == SMALLEST_SIDE
    assert window.holds(points).sum() > 1_000


def test_a_map_of_no_finite_points_has_no_window():
    assert typical_window(occupancy_of(np.full((3, 3), np.nan)), 1.0, 1_000) == WHOLE


def command(*arguments, folder):
    program = [sys.executable, "-c", "from pipeline.commands.app import main; main()", "preview"]
    return subprocess.run(
        [*program, *map(str, arguments)], cwd=folder, capture_output=True, text=True, check=False
    )


@pytest.mark.parametrize(("suffix", "looks"), [(".las", 100), (".laz", 4)])
def test_a_large_map_is_looked_at_in_places_and_compressed_ones_in_few(
    tmp_path, monkeypatch, suffix, looks
):
    """To read a place of a chunk, all of the chunk before it must be decoded."""
    for name, value in (("_LOOKED_AT", 1_000), ("_LOOKS", 100), ("_LOOKS_INTO_CHUNKS", 4)):
        monkeypatch.setattr(f"pipeline.preview.{name}", value)
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.scales = np.full(3, 0.001)
    las = laspy.LasData(header)
    las.xyz = hall()
    las.write(tmp_path / f"hall{suffix}")
    read = []
    true_batches = MapCollection.batches

    def batches(collection, *arguments, rows=None):
        read.append(rows)
        return true_batches(collection, *arguments, rows=rows)

    monkeypatch.setattr(MapCollection, "batches", batches)
    previewed([tmp_path / f"hall{suffix}"], tmp_path / "out")
    looked_at = [rows for rows in read if rows is not None]
    assert [len(rows) for rows in looked_at] == [1_000 // looks] * looks
    assert looked_at[0].start == 0
    assert looked_at[-1].start == 6_000 * (looks - 1) // looks


def test_the_command_says_where_the_report_is(map_file, tmp_path):
    options = [f"--set={setting}" for setting in FAST]
    done = command(map_file, "--centre", 10, 10, "--size", 8, *options, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    page = tmp_path / "hall_preview" / "report.html"
    assert done.stdout.splitlines()[-1] == f"report: {page}"
    report = json.loads((tmp_path / "hall_preview" / "run.json").read_text(encoding="utf-8"))
    assert report["points"] == Window((6, 6), (14, 14)).holds(hall()).sum()


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        (["--thin", "--centre", "1", "1"], "found several"),
        (["--window", "5", "0", "1", "9"], "X0 < X1"),
        (["--centre", "1", "1", "--size", "nan"], "X0 < X1"),
        (["--size", "5"], "--size: expected --centre with it"),
    ],
)
def test_windows_that_are_none_are_refused(map_file, tmp_path, options, problem):
    done = command(map_file, *options, folder=tmp_path)
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert problem in done.stderr
