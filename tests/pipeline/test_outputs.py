"""The output folder: all or nothing, one run at a time, inputs never overwritten."""

import json
from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import OutputError
from pipeline.outputs.folder import OutputNames, default_folder, output_folder
from tiling.formats import open_map

RESULTS = [Path("static.pcd"), Path("dynamic.pcd"), Path("run.json")]


def write_results(staging, text="new", outputs=("static.pcd", "dynamic.pcd", "run.json")):
    for name in ("static.pcd", "dynamic.pcd"):
        (staging / name).write_text(text, encoding="utf-8")
    report = {"version": "1", "input_hash": "0", "outputs": outputs}
    (staging / "run.json").write_text(json.dumps(report), encoding="utf-8")


def listing(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def test_everything_appears_at_the_end(tmp_path):
    folder = tmp_path / "deep" / "out"
    with output_folder(folder, RESULTS) as staging:
        write_results(staging)
        (staging / "static").mkdir()
        (staging / "static" / "a.pcd").write_text("a", encoding="utf-8")
        assert not (folder / "run.json").exists()
    assert listing(folder) == ["dynamic.pcd", "run.json", "static", "static.pcd", "static/a.pcd"]


def test_nothing_appears_after_an_error_and_a_new_folder_goes_again(tmp_path):
    folder = tmp_path / "deep" / "out"
    with pytest.raises(RuntimeError), output_folder(folder, RESULTS) as staging:
        write_results(staging)
        raise RuntimeError
    assert listing(tmp_path) == []


def test_earlier_results_survive_an_error_and_are_replaced_by_success(tmp_path):
    folder = tmp_path / "out"
    with output_folder(folder, RESULTS) as staging:
        write_results(staging, "old")
    (folder / "my notes.txt").write_text("mine", encoding="utf-8")
    with pytest.raises(RuntimeError), output_folder(folder, RESULTS) as staging:
        write_results(staging)
        raise RuntimeError
    assert (folder / "static.pcd").read_text(encoding="utf-8") == "old"
    with output_folder(folder, RESULTS) as staging:
        write_results(staging)
    assert (folder / "static.pcd").read_text(encoding="utf-8") == "new"
    assert listing(folder) == ["dynamic.pcd", "my notes.txt", "run.json", "static.pcd"]


def test_results_of_an_earlier_run_do_not_linger_beside_new_ones(tmp_path):
    with output_folder(tmp_path, RESULTS) as staging:
        (staging / "labels.parquet").write_text("old", encoding="utf-8")
        (staging / "static").mkdir()
        (staging / "static" / "a.pcd").write_text("old", encoding="utf-8")
        write_results(staging, "old", ["labels.parquet", "static/a.pcd", "run.json"])
        (staging / "static.pcd").unlink()
        (staging / "dynamic.pcd").unlink()
    with output_folder(tmp_path, RESULTS) as staging:
        write_results(staging)
    assert listing(tmp_path) == ["dynamic.pcd", "run.json", "static.pcd"]


def test_what_a_killed_run_left_is_cleared(tmp_path):
    with pytest.raises(RuntimeError), output_folder(tmp_path, RESULTS) as staging:
        left = staging
        raise RuntimeError
    left.mkdir()
    (left / "static.pcd").write_text("half", encoding="utf-8")
    with output_folder(tmp_path, RESULTS) as staging:
        assert listing(staging) == []
        write_results(staging)
    assert listing(tmp_path) == ["dynamic.pcd", "run.json", "static.pcd"]


def test_a_second_run_into_the_same_folder_is_refused(tmp_path):
    with (
        output_folder(tmp_path, RESULTS),
        pytest.raises(OutputError, match="another run"),
        output_folder(tmp_path, RESULTS),
    ):
        pass
    with output_folder(tmp_path, RESULTS):
        pass


def test_an_input_where_a_result_goes_is_refused_before_any_work(tmp_path):
    original = tmp_path / "static.pcd"
    original.write_text("input", encoding="utf-8")
    with (
        pytest.raises(OutputError, match="this input lies where a result goes"),
        output_folder(tmp_path, RESULTS, [original]),
    ):
        pytest.fail("the work began")
    assert original.read_text(encoding="utf-8") == "input"


@pytest.mark.parametrize("report", [None, "[]", '{"outputs": ["static.pcd"]}'])
def test_a_file_that_no_run_wrote_is_never_replaced_nor_removed(report, tmp_path):
    (tmp_path / "static.pcd").write_text("mine", encoding="utf-8")
    if report is not None:
        (tmp_path / "run.json").write_text(report, encoding="utf-8")
    before = listing(tmp_path)
    with (
        pytest.raises(OutputError, match="there is a file that no run wrote"),
        output_folder(tmp_path, RESULTS),
    ):
        pytest.fail("the work began")
    assert listing(tmp_path) == before
    assert (tmp_path / "static.pcd").read_text(encoding="utf-8") == "mine"


def test_an_input_elsewhere_in_the_output_folder_is_fine(tmp_path):
    original = tmp_path / "map.pcd"
    original.write_text("input", encoding="utf-8")
    with output_folder(tmp_path, RESULTS, [original]) as staging:
        write_results(staging)
    assert listing(tmp_path) == ["dynamic.pcd", "map.pcd", "run.json", "static.pcd"]


def test_a_file_in_the_folder_s_place_is_refused(tmp_path):
    (tmp_path / "out").write_text("a file", encoding="utf-8")
    with (
        pytest.raises(OutputError, match="out: expected a folder"),
        output_folder(tmp_path / "out", RESULTS),
    ):
        pass


@pytest.fixture
def maps(tmp_path):
    paths = [tmp_path / name for name in ("a/1.npy", "a/2.npy", "b/1.npy")]
    for path in paths:
        path.parent.mkdir(exist_ok=True)
        np.save(path, np.zeros((1, 3)))
    return paths


def test_names_of_one_and_of_several_files(maps):
    def names(*paths):
        chosen = OutputNames.of([open_map(path) for path in paths])
        return [str(name) for name in (*chosen.static, *chosen.dynamic)]

    assert names(maps[0]) == ["static.npy", "dynamic.npy"]
    assert names(*maps[:2]) == ["static/1.npy", "static/2.npy", "dynamic/1.npy", "dynamic/2.npy"]
    assert names(maps[0], maps[2])[:2] == ["static/a/1.npy", "static/b/1.npy"]


def test_files_of_partitions_keep_their_places(tmp_path):
    names = ["table.parquet/day=1/part-0.npy", "table.parquet/day=2/part-1.npy"]
    for name in names:
        (tmp_path / name).parent.mkdir(parents=True)
        np.save(tmp_path / name, np.zeros((1, 3)))
    chosen = OutputNames.of([open_map(tmp_path / name) for name in names])
    assert [str(name) for name in chosen.static] == [
        "static/day=1/part-0.npy",
        "static/day=2/part-1.npy",
    ]
    with output_folder(tmp_path / "out", [*chosen.static, Path("run.json")]) as staging:
        for name in chosen.static:
            (staging / name).parent.mkdir(parents=True, exist_ok=True)
            (staging / name).write_text("new", encoding="utf-8")
        report = {
            "version": "",
            "input_hash": "",
            "outputs": [*map(str, chosen.static), "run.json"],
        }
        (staging / "run.json").write_text(json.dumps(report), encoding="utf-8")
    assert (tmp_path / "out/static/day=2/part-1.npy").exists()
    with output_folder(tmp_path / "out", RESULTS) as staging:
        write_results(staging)
    assert not (tmp_path / "out/static").exists()


def test_names_that_only_their_suffix_made_different_stay_different(tmp_path):
    for name in ("a.npy", "a.NPY"):
        with (tmp_path / name).open("wb") as stream:
            np.save(stream, np.zeros((1, 3)))
    chosen = OutputNames.of([open_map(tmp_path / name) for name in ("a.npy", "a.NPY")])
    assert len(set(chosen.static)) == 2


@pytest.mark.parametrize(
    ("paths", "expected"),
    [
        (["x/big_map.pcd"], "big_map_dynahull"),
        (["x/lone.copc.laz"], "lone_dynahull"),
        (["x/campus/1.pcd", "x/campus/2.pcd"], "campus_dynahull"),
        (["x/table.parquet/day=1/a", "x/table.parquet/day=2/a"], "table_dynahull"),
        (["x/v1.2/1.pcd", "x/v1.2/2.pcd"], "v1.2_dynahull"),
        (["x/dump/000000/cloud.pcd", "x/dump/000001/cloud.pcd"], "dump_dynahull"),
    ],
)
def test_the_default_folder_is_named_after_the_map(paths, expected):
    assert default_folder([Path(path) for path in paths]) == Path(expected)


@pytest.mark.parametrize("call", range(1, 9))
@pytest.mark.parametrize("earlier", [False, True])
def test_a_rename_that_fails_leaves_what_was_there(call, earlier, tmp_path, monkeypatch):
    if earlier:
        with output_folder(tmp_path, RESULTS) as staging:
            write_results(staging, "old")
    before = {path.name: path.read_text(encoding="utf-8") for path in tmp_path.iterdir()}
    replace, calls = Path.replace, iter(range(1, 100))

    def failing(self, target):
        if next(calls) == call:
            raise OSError(5, "Input/output error", str(self))
        return replace(self, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", failing)
        try:
            with output_folder(tmp_path, RESULTS) as staging:
                write_results(staging)
        except OutputError:
            assert {p.name: p.read_text(encoding="utf-8") for p in tmp_path.iterdir()} == before
    with output_folder(tmp_path, RESULTS) as staging:
        write_results(staging)
    assert (tmp_path / "static.pcd").read_text(encoding="utf-8") == "new"
    assert listing(tmp_path) == ["dynamic.pcd", "run.json", "static.pcd"]
