"""One labelled map instead of two: the whole input, and what the run says of each point."""

import json

import laspy
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from dynahull import Label
from pipeline.configuration.run import load_configuration
from pipeline.errors import ConfigurationError
from pipeline.progress import LogDisplay, StageObserver
from pipeline.run import run
from pipeline.tiles import writing
from tiling.errors import MapFormatError
from tiling.formats import Field, field_values, open_map

pytestmark = pytest.mark.usefixtures("nothing_waits_for_the_disk")

FAST = [
    "neighbours.k=20",
    "clustering.count=2",
    "execution.cluster=none",
    "output.mode=label",
    "output.labels=true",
    "output.report=none",
    "ground.slope.window=0.3",
    "ground.slope.expert.extension=0.3",
    "ground.slope.expert.storey_radius=0.5",
    "max_height=2",
    # The classes and flags of the maps here are arbitrary.
    "input.leave_out=[]",
    "input.leave_out_withheld=false",
]
ONE_TILE, TILES = "tiling.max_points=1000000", "tiling.max_points=900"


def cleaned(maps, folder, *wanted):
    configuration = load_configuration("paper", [*FAST, *wanted])
    return run(maps, folder, configuration, StageObserver(LogDisplay()))


def hall(size=1500):
    random = np.random.default_rng(0)
    floor = np.column_stack([random.uniform(0, 8, (size, 2)), random.normal(0, 0.01, size)])
    wall = random.uniform(size=(size, 3)) * [8, 0.03, 2.5] + [0, 8, 0]
    ghost = random.uniform(size=(size // 20, 3)) * [3, 2, 1.5] + [2, 3, 0.3]
    return random.permutation(np.vstack([floor, wall, ghost])) + [5e5, 4e6, 12]


def las_file(path, point_format=3, version="1.2"):
    """Write the hall with a field of its own, classes and flags."""
    points = hall()
    header = laspy.LasHeader(version=version, point_format=point_format)
    header.scales, header.offsets = np.full(3, 0.001), np.array([5e5, 4e6, 0])
    header.add_extra_dim(laspy.ExtraBytesParams("ring", "uint16"))
    las = laspy.LasData(header)
    las.xyz = points
    las.ring = np.arange(len(points)) % 64
    las.classification = np.arange(len(points)) % 13
    las.synthetic = np.arange(len(points)) % 2
    las.withheld = np.arange(len(points)) % 3 == 0
    las.return_number = np.ones(len(points), np.uint8)
    las.write(path)
    return path


def table_of(folder):
    table = pq.read_table(folder / "labels.parquet")
    titles = [label.title for label in Label]
    labels = np.array([titles.index(title) for title in table["label"].to_pylist()], np.uint8)
    return labels, table["density"].to_numpy()


@pytest.mark.parametrize("suffix", [".las", ".laz"])
@pytest.mark.parametrize("tiles", [ONE_TILE, TILES])
def test_a_labelled_las_map_is_the_input_with_classes_label_and_density(tmp_path, suffix, tiles):
    source = las_file(tmp_path / f"hall{suffix}")
    report = cleaned([source], tmp_path / "out", tiles)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted(report.outputs)
    assert report.outputs[0] == report.files[0].labelled == f"labelled{suffix}"
    before, after = laspy.read(source), laspy.read(tmp_path / "out" / f"labelled{suffix}")
    names = [*before.point_format.dimension_names]
    assert [*after.point_format.dimension_names] == [*names, "label", "density", "original_class"]
    for name in set(names) - {"classification"}:
        np.testing.assert_array_equal(after[name], before[name])
    labels, density = table_of(tmp_path / "out")
    assert len(set(labels.tolist())) == 4  # static, dynamic, ground and above
    np.testing.assert_array_equal(after["label"], labels)
    assert np.array(after["density"]).tobytes() == density.tobytes()
    np.testing.assert_array_equal(after["original_class"], before.classification)
    expected = np.array(before.classification)
    expected[labels == Label.DYNAMIC], expected[labels == Label.GROUND] = 7, 2
    np.testing.assert_array_equal(after.classification, expected)


def hall_file(path):
    """Write the hall in the format that the name says."""
    kind = path.suffix
    if kind in (".las", ".laz"):
        return las_file(path)
    if kind == ".npy":
        np.save(path, hall())
    elif kind == ".npz":
        np.savez(path, **dict(zip("xyz", hall().T, strict=True)))
    elif kind == ".parquet":
        pq.write_table(pa.table(dict(zip("xyz", hall().T, strict=True))), path)
    elif kind == ".ply":
        points = (hall() - [5e5, 4e6, 0]).astype("<f4")
        properties = "".join(f"property float {axis}\n" for axis in "xyz")
        text = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n{properties}"
        path.write_bytes(f"{text}end_header\n".encode() + points.tobytes())
    else:
        points = (hall() - [5e5, 4e6, 0]).astype("<f4")
        text = (
            "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {0}\nHEIGHT 1\nPOINTS {0}\n"
        )
        path.write_bytes(f"{text.format(len(points))}DATA binary\n".encode() + points.tobytes())
    return path


@pytest.mark.parametrize("kind", [".las", ".laz", ".pcd", ".npy", ".parquet"])
def test_tiles_make_the_bytes_that_one_tile_makes(tmp_path, kind, monkeypatch):
    monkeypatch.setattr(writing, "DEFAULT_BATCH", 300)
    source = hall_file(tmp_path / f"hall{kind}")
    for folder, tiles in (("one", ONE_TILE), ("many", TILES)):
        cleaned([source], tmp_path / folder, tiles)
    one, many = (tmp_path / folder / f"labelled{kind}" for folder in ("one", "many"))
    assert one.read_bytes() == many.read_bytes()
    assert open_map(one).description.point_count == len(hall())


def score_of(path):
    """Read the scores of a labelled hall."""
    if path.suffix != ".ply":
        return np.concatenate(list(field_values(path, "score"))).astype(np.float32)
    record = [("x", "<f4", 3), ("label", "u1"), ("density", "<f8"), ("score", "<f4")]
    return np.frombuffer(path.read_bytes().split(b"end_header\n", 1)[1], record)["score"]


@pytest.mark.parametrize("kind", [".las", ".laz", ".pcd", ".ply", ".npz", ".parquet"])
@pytest.mark.parametrize("tiles", [ONE_TILE, TILES])
def test_where_evidence_is_weighed_the_score_is_there_too(tmp_path, kind, tiles, monkeypatch):
    monkeypatch.setattr(writing, "DEFAULT_BATCH", 300)
    source = hall_file(tmp_path / f"hall{kind}")
    cleaned([source], tmp_path / "out", "removal.decision=auto", tiles)
    labelled = tmp_path / "out" / f"labelled{kind}"
    fields = [field.name for field in open_map(source).description.fields]
    found = open_map(labelled).description.fields[len(fields) :]
    shown = "scalar_" if kind == ".ply" else ""  # by CloudCompare, at once
    names = [f"{shown}{name}" for name in ("label", "density", "score")]
    assert [field.name for field in found[:3]] == names
    assert found[2] == Field(names[2], "float32")
    wanted = pq.read_table(tmp_path / "out" / "labels.parquet")["score"].to_numpy()
    assert np.isfinite(wanted).sum() > 1000
    assert score_of(labelled).tobytes() == wanted.tobytes()


def test_an_array_without_names_gets_a_column_of_scores(tmp_path):
    source = hall_file(tmp_path / "hall.npy")
    for folder, tiles in (("one", ONE_TILE), ("many", TILES)):
        cleaned([source], tmp_path / folder, "removal.decision=auto", tiles)
        table = pq.read_table(tmp_path / folder / "labels.parquet")
        labelled = np.load(tmp_path / folder / "labelled.npy")
        assert labelled.shape[1] == 6
        np.testing.assert_array_equal(labelled[:, 5], table["score"].to_numpy())


def test_a_field_called_score_is_left_to_the_user(tmp_path):
    points = np.zeros(len(hall()), [("x", "f8"), ("y", "f8"), ("z", "f8"), ("score", "i4")])
    points["x"], points["y"], points["z"] = hall().T
    np.save(tmp_path / "hall.npy", points)
    for decision, last in (("paper", "density"), ("auto", "dynahull_score")):
        cleaned([tmp_path / "hall.npy"], tmp_path / decision, f"removal.decision={decision}")
        labelled = np.load(tmp_path / decision / "labelled.npy")
        assert labelled.dtype.names[3] == "score"
        assert labelled.dtype.names[-1] == last


def test_several_files_are_labelled_each(tmp_path):
    sources = [las_file(tmp_path / "a.las"), las_file(tmp_path / "b.laz", 6, "1.4")]
    report = cleaned(sources, tmp_path / "out", TILES)
    labels, _ = table_of(tmp_path / "out")
    half = len(labels) // 2
    for name, own in (("a.las", labels[:half]), ("b.laz", labels[half:])):
        las = laspy.read(tmp_path / "out" / "labelled" / name)
        np.testing.assert_array_equal(las["label"], own)
        # The same points twice: of two, one more or less is removed.
        assert (las.classification[own == Label.DYNAMIC] == 7).all()
    assert [file.labelled for file in report.files] == ["labelled/a.las", "labelled/b.laz"]
    assert f"written: {tmp_path / 'out' / 'labelled'}, " in report.summary()


def test_classes_are_the_users_choice(tmp_path):
    source = las_file(tmp_path / "hall.las", 6, "1.4")
    classes = "output.classes={static: 65, dynamic: 66, ground: keep, above: 67}"
    cleaned([source], tmp_path / "out", classes)
    las = laspy.read(tmp_path / "out" / "labelled.las")
    own, labels = np.array(las["original_class"]), np.array(las["label"])
    wanted = {Label.STATIC: 65, Label.DYNAMIC: 66, Label.ABOVE: 67}
    for label, number in wanted.items():
        assert (np.array(las.classification)[labels == label] == number).all()
    ground = labels == Label.GROUND
    np.testing.assert_array_equal(np.array(las.classification)[ground], own[ground])


def test_a_class_too_large_for_the_point_format_is_refused_before_any_work(tmp_path):
    source = las_file(tmp_path / "hall.las", 3)
    expected = r"hall\.las: LAS 1\.2, point format 3 has classes 0 to 31, found output\.classes\."
    with pytest.raises(ConfigurationError, match=expected + "dynamic 64"):
        cleaned([source], tmp_path / "out", "output.classes.dynamic=64")
    assert not (tmp_path / "out").exists()


def test_classes_mean_nothing_where_the_format_has_none(tmp_path):
    np.save(tmp_path / "hall.npy", hall())
    cleaned([tmp_path / "hall.npy"], tmp_path / "out", "output.classes.dynamic=200")
    assert np.load(tmp_path / "out" / "labelled.npy").shape[1] == 5


def test_fields_of_these_names_are_left_to_the_user(tmp_path):
    points = np.zeros(len(hall()), [("x", "f8"), ("y", "f8"), ("z", "f8"), ("label", "i4")])
    points["x"], points["y"], points["z"] = hall().T
    points["label"] = np.arange(len(points))
    np.save(tmp_path / "hall.npy", points)
    cleaned([tmp_path / "hall.npy"], tmp_path / "out")
    labelled = np.load(tmp_path / "out" / "labelled.npy")
    assert labelled.dtype.names == ("x", "y", "z", "label", "dynahull_label", "density")
    np.testing.assert_array_equal(labelled["label"], points["label"])
    with pytest.raises(ConfigurationError, match=r"the map has both; choose output\.mode split"):
        cleaned([tmp_path / "out" / "labelled.npy"], tmp_path / "again")


def test_a_map_with_no_place_for_fields_is_refused_before_any_work(tmp_path):
    np.save(tmp_path / "hall.npy", (hall() * 100).astype(np.int64))
    with pytest.raises(MapFormatError, match=r"hall\.npy: expected fields with names"):
        cleaned([tmp_path / "hall.npy"], tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_without_labels_the_run_still_knows_the_densities(tmp_path):
    source = las_file(tmp_path / "hall.las")
    report = cleaned([source], tmp_path / "out", "output.labels=false", TILES)
    assert report.outputs == ["labelled.las", "config.yaml", "run.json"]
    stored = json.loads((tmp_path / "out" / "run.json").read_text(encoding="utf-8"))
    assert stored["files"][0]["labelled"] == "labelled.las"
    assert stored["files"][0]["static"] is None
    density = np.array(laspy.read(tmp_path / "out" / "labelled.las")["density"])
    assert np.isfinite(density).sum() > 1000
