"""Deciding again, a part of a map, and what is never removed: the same over tiles as in memory."""

import json

import laspy
import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynahull import Label, clean
from dynahull.protection import Area
from pipeline.apply import decide_again
from pipeline.areas import read_areas
from pipeline.commands.options import part_settings
from pipeline.configuration.run import load_configuration
from pipeline.eligibility import RIM
from pipeline.errors import (
    ConfigurationError,
    DiskSpaceError,
    InputChangedError,
    OutputError,
    VerificationError,
)
from pipeline.progress import Display, StageObserver
from pipeline.run import run
from pipeline.verifying import verify

FAST = [
    "neighbours.k=12", "clustering.count=3", "execution.cluster=none",
    "ground.slope.window=0.3", "ground.slope.expert.extension=0.3",
    "ground.slope.expert.storey_radius=0.5",
]  # fmt: skip
WAYS = {
    "paper": ["removal.decision=paper"],
    "stepped": ["removal.threshold=stepped"],
    "auto": ["removal.decision=auto"],
    "by tile": ["removal.decision=paper", "clustering.scope=tile"],
}
OTHER = {
    "paper": ["removal.min_percent=1", "removal.max_percent=35"],
    "stepped": ["removal.min_percent=1", "removal.max_percent=35"],
    "auto": ["removal.confidence=0.02"],
    "by tile": ["removal.min_percent=1", "removal.max_percent=35"],
}
TILES = ["tiling.max_points=1500", "tiling.halo=0.5"]

pytestmark = pytest.mark.usefixtures("nothing_waits_for_the_disk")


@pytest.fixture(scope="module")
def map_file(tmp_path_factory):
    """A floor, two walls and ghosts, with classes; some are noise."""
    random = np.random.default_rng(3)
    xyz = np.concatenate(
        [
            random.uniform(size=(2500, 3)) * [30, 12, 0.02],
            random.uniform(size=(1500, 3)) * [30, 0.02, 2.5],
            random.uniform(size=(1500, 3)) * [0.02, 12, 2.5],
            random.uniform(size=(400, 3)) * [3, 3, 1.5] + [14, 5, 0.3],
        ]
    )
    las = laspy.create(point_format=6, file_version="1.4")
    las.header.scales = [0.001] * 3
    las.xyz = xyz[random.permutation(len(xyz))]
    las.classification = random.choice([1, 5, 7], len(xyz), p=[0.8, 0.18, 0.02])
    path = tmp_path_factory.mktemp("map") / "room.las"
    las.write(path)
    return path


def cleaned(path, folder, *wanted):
    configuration = load_configuration(None, [*FAST, *wanted])
    return run([path], folder, configuration, StageObserver(Display()))


def applied(folder, output, wanted=(), protect=(), restore=()):
    return decide_again(folder, output, wanted, protect, restore, StageObserver(Display()))


def assert_same_folders(one, other):
    names = sorted(path.name for path in one.iterdir())
    assert names == sorted(path.name for path in other.iterdir())
    for name in set(names) - {"run.json", "report.html", "config.yaml"}:
        assert (one / name).read_bytes() == (other / name).read_bytes(), name
    reports = [json.loads((each / "run.json").read_text()) for each in (one, other)]
    varying = (
        "finished",
        "output",
        "seconds",
        "peak_memory_bytes",
        "peak_memory_all_bytes",
        "configuration",
        "warnings",
    )
    for report in reports:
        for name in varying:
            report.pop(name)
    assert reports[0] == reports[1]


def labels_of(folder):
    return np.array(pq.read_table(folder / "labels.parquet")["label"].to_pylist())


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("tiles", [[], TILES], ids=["in memory", "tiles"])
def test_to_decide_again_is_to_run_again(map_file, tmp_path, way, tiles):
    cleaned(map_file, tmp_path / "first", *WAYS[way], *tiles)
    area = Area.box([13, 4], [16, 6])
    applied(tmp_path / "first", tmp_path / "again", OTHER[way], [area])
    protect = f"removal.protect={json.dumps([area.model_dump()])}"
    cleaned(map_file, tmp_path / "anew", *WAYS[way], *tiles, *OTHER[way], protect)
    assert_same_folders(tmp_path / "again", tmp_path / "anew")
    assert "labels follow" in verify(tmp_path / "anew")
    before = (tmp_path / "first/static.las").read_bytes()
    applied(
        tmp_path / "again",
        None,
        [
            f"{each.partition('=')[0]}={value}"
            for each, value in zip(
                OTHER[way], ["5", "20"] if way != "auto" else ["0.5"], strict=True
            )
        ]
        + ["removal.protect=[]"],
    )
    assert (tmp_path / "again/static.las").read_bytes() == before  # nothing was forgotten


@pytest.mark.parametrize("way", ["paper", "auto"])
def test_what_is_protected_stays_however_the_map_is_cut(map_file, tmp_path, way):
    (tmp_path / "areas.wkt").write_text(
        "POLYGON ((13 4, 15 4, 15 7, 13 7), (14 5, 14 6, 15 6, 15 5))"
    )
    wanted = [
        *WAYS[way], *OTHER[way], "removal.protect_classes=[5]",
        *part_settings((13.5, 1, 28, 11), (-1, 1.2), tmp_path / "areas.wkt"),
    ]  # fmt: skip
    cleaned(map_file, tmp_path / "whole", *wanted)
    cleaned(map_file, tmp_path / "cut", *wanted, *TILES)
    assert_same_folders(tmp_path / "whole", tmp_path / "cut")
    applied(tmp_path / "cut", tmp_path / "again")
    assert_same_folders(tmp_path / "whole", tmp_path / "again")
    assert "labels follow" in verify(tmp_path / "whole")
    stored = json.loads((tmp_path / "cut/run.json").read_text())
    stored["configuration"]["removal"] |= {"protect": [], "protect_classes": []}
    (tmp_path / "cut/run.json").write_text(json.dumps(stored))
    with pytest.raises(VerificationError):  # what stays has no reason to
        verify(tmp_path / "cut")
    las = laspy.read(map_file)
    labels = labels_of(tmp_path / "whole")
    assert set(labels[las.x < 13.5 - RIM]) == {"unscored"}
    gone = labels == "dynamic"
    assert gone.any()
    assert not gone[las.classification == 5].any()
    (area,) = read_areas(tmp_path / "areas.wkt")
    assert not gone[area.holds(las.xyz)].any()
    x, y, z = las.xyz[gone].T
    assert (
        (x >= 5).all() and (x < 28).all() and (y >= 1).all() and (y < 11).all() and (z < 1.2).all()
    )


@pytest.fixture(scope="module")
def hooks(tmp_path_factory):
    """Two ghosts, each of which reaches into the box around the other: hooks, one turned over."""
    random = np.random.default_rng(5)
    floor = random.uniform(size=(9000, 3)) * [10, 8, 0.01]
    hook = np.concatenate(
        [random.uniform(size=(150, 3)) * size for size in ([4, 0.4, 1], [0.4, 3, 1])]
    )
    ghosts = [hook + [2, 3, 0.4], [5.4, 5.6, 0.4] - hook * [0.55, 0.4, -1]]
    xyz = np.concatenate([floor, *ghosts])
    las = laspy.create(point_format=6, file_version="1.4")
    las.header.scales = [0.001] * 3
    las.xyz = xyz[random.permutation(len(xyz))]
    path = tmp_path_factory.mktemp("hooks") / "hooks.las"
    las.write(path)
    return path


@pytest.mark.parametrize("way", ["paper", "auto"])
@pytest.mark.parametrize("tiles", [[], TILES], ids=["in memory", "tiles"])
def test_of_a_place_that_is_put_back_all_others_stay_removed(hooks, tmp_path, way, tiles):
    everything = ["removal.min_percent=100", "removal.max_percent=100", "removal.confidence=0.001"]
    report = cleaned(hooks, tmp_path / "out", *WAYS[way], *everything, *tiles)
    before = laspy.read(tmp_path / "out/dynamic.las").xyz
    place, other = report.places[:2]
    boxed = ((before >= place.low) & (before <= place.high)).all(axis=1)
    assert np.count_nonzero(boxed) > place.points, "nothing else is in the box"
    again = applied(tmp_path / "out", tmp_path / "again", restore=[place.number])
    after = laspy.read(tmp_path / "again/dynamic.las").xyz
    assert len(after) == len(before) - place.points == again.counts["dynamic"]
    assert np.count_nonzero(((after >= place.low) & (after <= place.high)).all(axis=1)) > 0
    assert again.places[0].points == other.points
    assert "labels follow" in verify(tmp_path / "again")
    last = applied(tmp_path / "again", None, restore=[again.places[0].number])
    assert last.counts["dynamic"] == again.counts["dynamic"] - other.points


def test_only_places_of_the_report_are_put_back(map_file, tmp_path):
    cleaned(map_file, tmp_path / "out", *WAYS["paper"])
    with pytest.raises(
        ConfigurationError, match="--restore 9999: expected the number of a place in the report"
    ):
        applied(tmp_path / "out", None, restore=[9999])


def test_what_cannot_be_applied_is_refused_in_one_line(map_file, tmp_path):
    cleaned(map_file, tmp_path / "out", *WAYS["paper"])
    for wanted, message in [
        (["neighbours.k=20"], "neighbours: expected settings of removal, output, execution alone"),
        (["removal.decision=auto"], "run again with -c auto"),
        (["removal.confidence=0.7"], "removal.confidence has no effect .* is paper: give removal"),
        (["output.labels=false"], "output.labels: expected true, .* labels.parquet again"),
        (["output.keep_work=true"], "output.keep_work has no effect on apply"),
        (["execution.cluster=slurm"], "execution.cluster has no effect on apply"),
    ]:
        with pytest.raises(ConfigurationError, match=message):
            applied(tmp_path / "out", None, wanted)
    with pytest.raises(DiskSpaceError, match="are to stay so"):
        applied(tmp_path / "out", None, ["output.keep_free=900TiB"])
    cleaned(map_file, tmp_path / "auto", "removal.decision=auto")
    with pytest.raises(
        ConfigurationError, match=r"max_percent has no effect .* give removal.confidence"
    ):
        applied(tmp_path / "auto", None, ["removal.max_percent=30"])
    cleaned(map_file, tmp_path / "short", "output.labels=false")
    with pytest.raises(OutputError, match=r"found none; run again with --labels"):
        applied(tmp_path / "short", None)
    with pytest.raises(OutputError, match="expected the output of a run"):
        applied(tmp_path, None)
    (tmp_path / "run.json").write_text("{")
    with pytest.raises(OutputError, match=r"run.json: expected .* found a damaged file; run again"):
        applied(tmp_path, None)
    other = tmp_path / "room.las"
    other.write_bytes(map_file.read_bytes())
    cleaned(other, tmp_path / "changed")
    other.write_bytes(map_file.read_bytes()[:-1] + b"x")
    before = (tmp_path / "changed/run.json").read_bytes()
    with pytest.raises(InputChangedError, match="the map changed since it was cleaned"):
        applied(tmp_path / "changed", None)
    assert (tmp_path / "changed/run.json").read_bytes() == before


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 2**32 - 1), st.integers(3, 9), st.sampled_from([0.0, 652_345.5]))
def test_an_area_holds_what_lies_in_its_polygon(seed, corners, shift):
    random = np.random.default_rng(seed)
    turns = np.sort(random.uniform(0, 2 * np.pi, corners))
    ring = np.column_stack([np.cos(turns), np.sin(turns)]) * 5  # convex
    xyz = random.uniform(-6, 6, (300, 3))
    sides = np.roll(ring, -1, axis=0) - ring
    flat = xyz[:, np.newaxis, :2] - ring
    inside = (sides[:, 0] * flat[..., 1] - sides[:, 1] * flat[..., 0] > 0).all(axis=1)
    clear = np.abs(sides[:, 0] * flat[..., 1] - sides[:, 1] * flat[..., 0]).min(axis=1) > 1e-6
    area = Area(rings=(tuple(map(tuple, (ring + shift).tolist())),), high=2.0)
    found = area.holds(xyz + [shift, shift, 0])
    np.testing.assert_array_equal(found[clear], (inside & (xyz[:, 2] <= 2.0))[clear])


@pytest.mark.parametrize("tiles", [[], TILES])
def test_a_window_where_the_map_is_not_is_refused_and_such_areas_are_told(
    map_file, tmp_path, tiles
):
    with pytest.raises(ConfigurationError, match="points in the window, found none within 10 m"):
        cleaned(map_file, tmp_path / "out", "input.window=[900, 900, 910, 910]", *tiles)
    assert not (tmp_path / "out").exists()
    with pytest.raises(ConfigurationError, match=r"in the window, found x from .* 29.* m, y"):
        cleaned(map_file, tmp_path / "out", "input.window=[31, 0, 40, 9]", *tiles)
    elsewhere = Area.box([900, 0], [901, 1]).model_dump_json()
    here = Area.box([0, 0, 1], [9, 9, 0]).model_dump_json()
    report = cleaned(map_file, tmp_path / "out", f"removal.protect=[{elsewhere}, {here}]", *tiles)
    assert any("1 of 2 areas to protect lie outside the map" in w for w in report.warnings)
    again = applied(tmp_path / "out", None, protect=[Area.box([-9, -9], [-8, -8])])
    assert any("2 of 3 areas to protect" in warning for warning in again.warnings)


def test_areas_come_as_geojson_wkt_and_boxes(tmp_path):
    square = [[0, 0], [2, 0], [2, 2], [0, 2], [0, 0]]
    feature = {
        "type": "Feature",
        "properties": {},
        "geometry": {"type": "Polygon", "coordinates": [square]},
    }
    nowhere = {"type": "Feature", "properties": {}, "geometry": None}
    texts = {
        "a.geojson": json.dumps({"type": "FeatureCollection", "features": [feature]}),
        "b.wkt": "MULTIPOLYGON (((0 0, 2 0, 2 2, 0 2, 0 0)))",
        "c.txt": "# a box\n0 0 2 2\n",
        "d.txt": "0, 0, 9, 2, 2, -9",
        "e.geojson": "\ufeff" + json.dumps({"type": "GeometryCollection", "geometries": [feature]}),
        "f.geojson": json.dumps({"type": "FeatureCollection", "features": [feature, nowhere]}),
    }
    points = np.array([[1.0, 1.0, 0.0], [3.0, 1.0, 0.0], [1.0, 1.0, 20.0]])
    for name, text in texts.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
        (area,) = read_areas(tmp_path / name)
        assert area.holds(points).tolist() == [True, False, name != "d.txt"]
    for text in (
        "",
        "1 2 3",
        '{"type": "Point"}',
        "POLYGON ((0 0, 1 1))",
        "POLYGON ((a b, 1 1, 2 2))",
    ):
        (tmp_path / "bad").write_text(text)
        with pytest.raises(ConfigurationError, match="expected polygons or boxes") as error:
            read_areas(tmp_path / "bad")
        assert "pydantic" not in str(error.value)


def test_a_window_is_refused_the_wrong_way_round():
    with pytest.raises(ConfigurationError, match="lower number first"):
        load_configuration(None, ["input.window=[3, 0, 1, 9]"])
    with pytest.raises(ConfigurationError, match="corners of an area are finite"):
        load_configuration(None, ["removal.protect=[{rings: [[[0, 0], [1, 1], [.nan, 2]]]}]"])


def test_dynahull_itself_protects(map_file):
    las = laspy.read(map_file)
    removal = {
        "protect_classes": [5],
        "protect": [{"rings": [[[13, 4], [16, 4], [16, 7], [13, 7]]]}],
    }
    safe = np.arange(len(las.xyz)) % 2 == 0
    free = clean(las.xyz, neighbours={"k": 12})
    kept = clean(
        las.xyz, classification=np.array(las.classification), neighbours={"k": 12},
        removal=removal, protected=safe,
    )  # fmt: skip
    never = (np.array(las.classification) == 5) | safe
    never |= Area.box([13, 4], [16, 7]).holds(np.asarray(las.xyz))
    assert kept.protected.tolist() == never.tolist()
    gone = (free.labels == Label.DYNAMIC) & ~never
    np.testing.assert_array_equal(kept.labels == Label.DYNAMIC, gone)
    assert sum(each.removed for each in kept.clusters) == gone.sum()


def test_labels_are_kept_unasked_of_small_maps_alone():
    configuration = load_configuration(None)
    assert configuration.of_size(20_000_000).output.labels is True
    assert configuration.of_size(20_000_001).output.labels is False
    asked = load_configuration(None, ["output.labels=true"])
    assert asked.of_size(10**12).output.labels is True
