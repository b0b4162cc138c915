"""`verify`: what a run wrote is proven from the files, and forgeries are found."""

import hashlib
import itertools
import json
import shutil

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.commands.app import main
from pipeline.configuration.run import load_configuration
from pipeline.errors import PipelineError, VerificationError
from pipeline.progress import LogDisplay, StageObserver
from pipeline.run import run
from pipeline.verifying import verify
from tiling.errors import TilingError

pytestmark = pytest.mark.usefixtures("nothing_waits_for_the_disk")

SETTINGS = ["neighbours.k=8", "clustering.count=3", "ground.method=none", "output.report=none"]
POINTS = np.random.default_rng(3).uniform(size=(800, 3)) * [9, 7, 2]


def cleaned(map_file, folder, *wanted):
    configuration = load_configuration("paper", [*SETTINGS, *wanted])
    run([map_file], folder, configuration, StageObserver(LogDisplay()))
    return folder


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    folder = tmp_path_factory.mktemp("results")
    np.save(folder / "map.npy", POINTS)
    cleaned(folder / "map.npy", folder / "plain", "output.labels=false")
    cleaned(folder / "map.npy", folder / "labels", "output.labels=true")
    wanted = ["output.labels=true", "removal.threshold=stepped", "tiling.max_points=200"]
    cleaned(folder / "map.npy", folder / "stepped", *wanted, "execution.cluster=none")
    auto = ["output.labels=true", "removal.decision=auto", "removal.confidence=0.012"]
    cleaned(folder / "map.npy", folder / "auto", *auto)
    named = np.empty(len(POINTS), [(axis, "f8") for axis in "xyz"])
    for number, axis in enumerate("xyz"):
        named[axis] = POINTS[:, number]
    np.save(folder / "named.npy", named)
    cleaned(folder / "named.npy", folder / "label", "output.mode=label", "output.labels=false")
    cleaned(folder / "named.npy", folder / "unasked", "output.mode=label")
    cleaned(folder / "named.npy", folder / "both", "output.mode=label", *auto)
    return folder


@pytest.mark.parametrize("boxes", [0, 2])
@pytest.mark.parametrize("decision", ["paper", "auto"])
def test_tiles_without_a_cluster_of_their_own_are_no_gap(decision, boxes, tmp_path):
    """With a model a tile, a tile of ground alone has none."""
    random = np.random.default_rng(5)
    parts = [random.uniform(size=(3000, 3)) * [30, 10, 0.004]]
    parts += [random.uniform([27 * n, 4, 0.6], [27 * n + 2, 6, 2], (300, 3)) for n in range(boxes)]
    np.save(tmp_path / "map.npy", np.concatenate(parts))
    wanted = ["tiling.max_points=900", "execution.cluster=none", f"removal.decision={decision}"]
    wanted += ["clustering.scope=tile", "ground.method=slope", "output.labels=true"]
    folder = cleaned(tmp_path / "map.npy", tmp_path / "out", *wanted)
    clusters = pq.read_table(folder / "labels.parquet")["cluster"].to_numpy()
    found = np.unique(clusters[clusters >= 0])
    assert len(found) == 3 * boxes
    if boxes:
        assert found.tolist() != list(range(len(found)))
    assert verify(folder)


NAMES = ["plain", "labels", "stepped", "auto", "label", "unasked", "both"]


@pytest.mark.parametrize("name", NAMES)
def test_true_results_are_verified(results, name):
    said = verify(results / name)
    assert said.startswith("800 points = ")
    assert ("labels follow" in said) == (name not in ("plain", "label"))


def test_a_line_a_map_and_exit_code_1(results, tmp_path, capsys, monkeypatch):
    shutil.copytree(results / "plain", tmp_path / "all" / "a")
    shutil.copytree(results / "plain", tmp_path / "all" / "b")
    monkeypatch.setattr("sys.argv", ["dynahull-pipeline", "verify", str(tmp_path / "all")])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 0
    edit_array(tmp_path / "all" / "b" / "static.npy", lambda points: points[::-1])
    with pytest.raises(SystemExit) as ended:
        main()
    lines = capsys.readouterr().out.splitlines()
    assert ended.value.code == 1
    assert [line.split(": ")[0] for line in lines] == ["verified"] * 3 + ["NOT VERIFIED"]
    several = [str(tmp_path / "nowhere"), str(tmp_path / "all" / "a")]
    monkeypatch.setattr("sys.argv", ["dynahull-pipeline", "verify", *several])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 1
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(": ")[0] for line in lines] == ["NOT VERIFIED", "verified"]
    monkeypatch.setattr("sys.argv", ["dynahull-pipeline", "verify", str(results / "map.npy")])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 1
    assert "found no run.json" in capsys.readouterr().err


def edit_array(path, change):
    np.save(path, change(np.load(path)))


def edit_report(folder, change):
    report = json.loads((folder / "run.json").read_text())
    change(report)
    (folder / "run.json").write_text(json.dumps(report))


def edit_table(folder, change):
    table = pq.read_table(folder / "labels.parquet")
    columns = {name: table[name].to_pylist() for name in table.schema.names}
    change(columns)
    titles = pa.array(["static", "dynamic", "ground", "above", "unscored", "invalid"])
    codes = [titles.to_pylist().index(each) for each in columns["label"]]
    label = pa.DictionaryArray.from_arrays(pa.array(codes, pa.int8()), titles)
    rest = [pa.array(columns[name], table.schema.field(name).type) for name in columns][1:]
    pq.write_table(pa.table([label, *rest], names=list(columns)), folder / "labels.parquet")


def swap(points):
    points = points.copy()
    points[[3, 4]] = points[[4, 3]]
    return points


def one_bit(points):
    points = points.copy()
    points.view(np.uint64)[7, 2] ^= 1
    return points


def one_bit_of_a_field(points):
    points["y"].view(np.uint64)[7] ^= 1
    return points


def shorter(columns):
    for values in columns.values():
        values.pop()


def longer(columns):
    for values in columns.values():
        values.append(values[0])


def other_label(columns):
    """A dynamic point changes places with a denser, static one of its cluster."""
    first = columns["label"].index("dynamic")
    cluster = columns["cluster"][first]
    second = next(
        row
        for row, label in enumerate(columns["label"])
        if label == "static" and columns["cluster"][row] == cluster
    )
    columns["label"][first], columns["label"][second] = "static", "dynamic"


def labels_and_outputs(folder):
    """A forgery of labels that the outputs agree with: only the densities tell."""
    edit_table(folder, other_label)
    labels = pq.read_table(folder / "labels.parquet")["label"].to_pylist()
    gone = np.array([label == "dynamic" for label in labels])
    np.save(folder / "static.npy", POINTS[~gone])
    np.save(folder / "dynamic.npy", POINTS[gone])


FORGERIES = {
    "two points change places": (NAMES[:4], lambda f: edit_array(f / "static.npy", swap)),
    "one bit": (NAMES[:4], lambda f: edit_array(f / "dynamic.npy", one_bit)),
    "one bit of a labelled map": (
        ["label", "both"], lambda f: edit_array(f / "labelled.npy", one_bit_of_a_field)
    ),
    "a point is lost": (NAMES[:4], lambda f: edit_array(f / "static.npy", lambda p: p[1:])),
    "a point comes twice": (
        NAMES[:4], lambda f: edit_array(f / "static.npy", lambda p: np.concatenate([p[:1], p[:-1]]))
    ),
    "another type": (NAMES[:4], lambda f: edit_array(f / "static.npy", lambda p: p.astype("f4"))),
    "static is dynamic": (
        NAMES[:4], lambda f: shutil.copy(f / "static.npy", f / "dynamic.npy")
    ),
    "no file": (NAMES[:4], lambda f: (f / "dynamic.npy").unlink()),
    "another input": (
        NAMES, lambda f: edit_report(f, lambda r: r.update(input_hash="0" * 64))
    ),
    "counts": (
        NAMES, lambda f: edit_report(f, lambda r: r["counts"].update(ground=1))
    ),
    "no configuration": (
        NAMES, lambda f: edit_report(f, lambda r: r.update(configuration={"k": 1}))
    ),
    "not JSON": (NAMES, lambda f: (f / "run.json").write_text("{")),
    "labels": (["labels", "auto"], lambda f: edit_table(f, other_label)),
    "labels and outputs": (["labels", "stepped", "auto"], labels_and_outputs),
    "densities": (
        ["labels", "stepped"],
        lambda f: edit_table(f, lambda c: c["density"].sort(key=lambda value: -value)),
    ),
    "scores": (["auto", "both"], lambda f: edit_table(f, lambda c: c["score"].reverse())),
    "fewer labels": (["labels", "both"], lambda f: edit_table(f, shorter)),
    "more labels": (["labels", "both"], lambda f: edit_table(f, longer)),
    "another share": (
        ["labels"],
        lambda f: edit_report(f, lambda r: r["configuration"]["removal"].update(max_percent=30)),
    ),
    "another confidence": (
        ["auto", "both"],
        lambda f: edit_report(f, lambda r: r["configuration"]["removal"].update(confidence=0.001)),
    ),
}  # fmt: skip


@pytest.mark.parametrize(
    ("name", "forgery"), [(n, f) for f, (names, _) in FORGERIES.items() for n in names]
)
def test_forgeries_are_found_in_one_line(results, tmp_path, name, forgery):
    shutil.copytree(results / name, tmp_path / "forged")
    FORGERIES[forgery][1](tmp_path / "forged")
    with pytest.raises((PipelineError, TilingError)) as raised:
        verify(tmp_path / "forged")
    assert str(raised.value).isprintable()


def is_interleaving(whole, one, other):
    """Every choice of the places of `one`."""
    places = itertools.combinations(range(len(whole)), len(one))
    return any(
        [whole[n] for n in chosen] == one
        and [each for n, each in enumerate(whole) if n not in chosen] == other
        for chosen in places
    )


@settings(max_examples=150)
@given(
    st.lists(st.integers(0, 2), max_size=7), st.lists(st.booleans(), min_size=7, max_size=7),
    st.randoms(use_true_random=False), st.booleans(),
)  # fmt: skip
def test_equal_points_are_told_from_none(results, tmp_path_factory, values, mask, random, mixed):
    """Outputs are accepted where some choice of places makes them, and only there."""
    one = [value for value, gone in zip(values, mask, strict=False) if not gone]
    other = [value for value, gone in zip(values, mask, strict=False) if gone]
    if mixed:
        random.shuffle(one)
    folder = tmp_path_factory.mktemp("mixed")
    shutil.copytree(results / "plain", folder / "out")
    for name, numbers in (("map", values), ("out/static", one), ("out/dynamic", other)):
        np.save(folder / f"{name}.npy", np.repeat(np.array(numbers, float)[:, None], 3, axis=1))
    counts = dict.fromkeys(("ground", "above", "unscored", "invalid"), 0)
    digest = hashlib.sha256((folder / "map.npy").read_bytes()).hexdigest()

    def change(report):
        report["files"][0].update(path=str(folder / "map.npy"))
        report.update(points=len(values), input_hash=digest)
        report.update(counts={"static": len(one), "dynamic": len(other), **counts})

    edit_report(folder / "out", change)
    if is_interleaving(values, one, other):
        verify(folder / "out")
    else:
        with pytest.raises(VerificationError, match="in none, or not in its place"):
            verify(folder / "out")
