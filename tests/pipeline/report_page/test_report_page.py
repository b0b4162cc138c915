"""The page without a browser: what it holds, and that it holds nothing of what it should not."""

import base64
import json
import re
from html import unescape
from html.parser import HTMLParser

import numpy as np
import pytest
import yaml

from pipeline.apply import decide_again
from pipeline.configuration.run import load_configuration
from pipeline.errors import InputChangedError
from pipeline.outputs.map_sample import MapSample
from pipeline.progress import LogDisplay, StageObserver
from pipeline.report_page.encoding import encode
from pipeline.report_page.percentages import removal_percentages
from pipeline.run import run
from tests.pipeline.report_page.conftest import BY_EVIDENCE, write_timed_street
from tests.pipeline.test_key_frames import hdl


def page_of(folder):
    return (folder / "report.html").read_text(encoding="utf-8")


def array(page, name):
    return re.search(rf'<script type="text/plain" id="array-{name}">([^<]*)</script>', page)[1]


def numbers(page, name):
    held = base64.b64decode(array(page, name))
    return np.frombuffer(held, np.uint8 if len(held) == facts(page)["count"] else "<u2")


def facts(page):
    return json.loads(re.search(r'id="facts">([^<]*)</script>', page)[1])


class Reader(HTMLParser):
    """Notes the elements and the words of a page."""

    def __init__(self):
        super().__init__()
        self.tags, self.words, self.within, self.links = [], [], None, []

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.within = tag
        self.links += [value for name, value in attributes if name in ("src", "href")]

    def handle_endtag(self, tag):
        self.within = None

    def handle_data(self, data):
        if self.within not in ("script", "style"):
            self.words.append(data)


def read(page):
    reader = Reader()
    reader.feed(page)
    return reader


def test_the_page_by_evidence_does_not_depend_on_how_the_map_is_cut(cleaned):
    whole, tiled = page_of(cleaned["judged"]), page_of(cleaned["judged tiled"])
    for name in ("places", "percentages", "labels", "clusters", "densities"):
        assert array(whole, name) == array(tiled, name)
    assert facts(whole) | {"apply": None} == facts(tiled) | {"apply": None}
    assert facts(whole)["confidence"] == 0.8
    assert facts(whole)["removed_points"][20] == facts(whole)["removed"] > 0


SEEN = ("scans", "met", "through")


def test_the_page_holds_the_scan_of_each_point(cleaned):
    folder = cleaned["posed"].parent
    scan = np.load(folder / "timed.npz")["scan"]
    for name in ("timed", "posed", "posed tiled"):
        page = page_of(cleaned[name])
        assert facts(page)["scans"] == [0, 39]
        assert facts(page)["count"] == len(scan)
        np.testing.assert_array_equal(numbers(page, "scans"), scan + 1)
    assert 'id="array-met"' not in page_of(cleaned["timed"])


def test_what_scans_saw_does_not_depend_on_how_the_map_is_cut(cleaned):
    whole, tiled = page_of(cleaned["posed"]), page_of(cleaned["posed tiled"])
    for name in SEEN:
        assert array(whole, name) == array(tiled, name)
    met, through = numbers(whole, "met"), numbers(whole, "through")
    wall, who_walked = slice(18_000, 27_000), slice(31_000, None)
    assert np.median(met[wall]) > 4 * np.median(through[wall])
    assert np.median(through[who_walked]) > 4 * np.median(met[who_walked])


def assert_same_views(one, other):
    pages = page_of(one), page_of(other)
    ids = [re.findall(r' id="((?:array|scan)-[^"]*|play)"', page) for page in pages]
    assert ids[0] == ids[1]
    arrays = [name.removeprefix("array-") for name in ids[0] if name.startswith("array-")]
    assert {name for name in arrays if array(pages[0], name) != array(pages[1], name)} == set()
    assert facts(pages[0]) | {"apply": None} == facts(pages[1]) | {"apply": None}


@pytest.mark.parametrize("name", ["judged", "timed", "posed", "posed tiled"])
def test_after_apply_the_page_shows_scans_as_that_of_the_run_does(cleaned, tmp_path, name):
    decide_again(cleaned[name], tmp_path / "again", [], [], [], observer())
    assert_same_views(cleaned[name], tmp_path / "again")
    assert ('id="array-scans"' in page_of(tmp_path / "again")) == (name != "judged")


@pytest.mark.parametrize("merge", ["true", "false"])
def test_the_page_of_key_frames_is_the_same_after_apply(tmp_path, merge):
    settings = ["execution.cluster=none", "ground.method=none", "neighbours.k=8"]
    configuration = load_configuration("auto", [*settings, f"output.merge={merge}"])
    run([hdl(tmp_path / "in")], tmp_path / "out", configuration, observer())
    decide_again(tmp_path / "out", tmp_path / "again", [], [], [], observer())
    assert_same_views(tmp_path / "out", tmp_path / "again")
    assert 'id="array-met"' in page_of(tmp_path / "again")


@pytest.mark.parametrize("tile", [1_000_000, 12_000])
def test_points_that_take_no_part_hide_nothing_after_apply_either(tmp_path, tile):
    path, poses = write_timed_street(tmp_path)
    xyz, scan = np.load(path)["points"], np.load(path)["scan"]
    around = np.linspace(0, 2 * np.pi, 28)  # far away, all around the first scans
    xyz[:28] = np.stack([np.cos(around), np.sin(around), 0 * around], axis=1) * 9_000 + [2, 2, 1.2]
    scan[:28], xyz[28] = 1, np.nan
    np.savez(path, points=xyz, scan=scan)
    settings = [*BY_EVIDENCE, poses, "clustering.count=3", "neighbours.k=30"]
    settings += [f"tiling.max_points={tile}", "execution.cluster=none"]
    run([path], tmp_path / "out", load_configuration(None, settings), observer())
    decide_again(tmp_path / "out", tmp_path / "again", [], [], [], observer())
    assert_same_views(tmp_path / "out", tmp_path / "again")
    decide_again(
        tmp_path / "out", tmp_path / "paper", ["removal.decision=paper"], [], [], observer()
    )
    assert 'id="array-scans"' not in page_of(tmp_path / "paper")
    (tmp_path / "poses.txt").write_text((tmp_path / "poses.txt").read_text().replace("1.2", "1.3"))
    with pytest.raises(InputChangedError, match="its poses changed since it was cleaned"):
        decide_again(tmp_path / "out", None, [], [], [], observer())


def test_where_no_scans_are_known_the_page_says_nothing_of_them(cleaned):
    for name in ("whole", "tiled", "judged", "judged tiled"):
        page = page_of(cleaned[name])
        assert "scans" not in facts(page)
        ids = re.findall(r' id="([^"]*)"', page)
        assert not {"scan-from", "play", *(f"array-{seen}" for seen in SEEN)} & set(ids)
        assert '<option value="5">' not in page
        assert '<option value="6">' not in page


def test_scan_numbers_that_are_far_apart_are_rounded():
    scan = np.array([7, -1, 7 + 10**6, 7 + 5 * 10**5], np.int32)
    sample = MapSample.of_map(
        np.zeros((4, 3)), np.zeros(4, np.uint8), np.zeros(4, np.int32), np.ones(4),
        np.ones(4, np.float32),
    ).seen(scan, None)  # fmt: skip
    encoded = encode(sample, removal_percentages(sample, [], {"min_percent": 5, "max_percent": 20}))
    assert encoded.facts["scans"] == [7, 7 + 10**6]
    codes = np.frombuffer(base64.b64decode(encoded.arrays["scans"]), "<u2")
    assert codes.tolist() == [1, 0, 65_535, 32_768]


@pytest.mark.parametrize("name", ["judged", "judged tiled", "whole", "tiled"])
def test_the_places_are_in_a_list_that_says_why(cleaned, name):
    report = json.loads((cleaned[name] / "run.json").read_text(encoding="utf-8"))
    page = page_of(cleaned[name])
    words = " ".join(read(page).words)
    assert report["places"]
    numbers = [int(number) for number in re.findall(r'data-place="(\d+)"', page)]
    assert numbers == [place["number"] for place in report["places"]]
    assert f"{report['places'][0]['points']:,}" in words
    assert report["places"][0]["reasons"][0]["words"] in words
    assert f"removed in {report['place_count']} place" in words
    by_evidence = name.startswith("judged")
    assert (facts(page)["confidence"] is not None) == by_evidence
    assert (" m, score " in words) == by_evidence
    uncertain = f"{report['uncertain_points'] or 0:,} points are uncertain and kept"
    assert (uncertain in words) == by_evidence


@pytest.mark.parametrize("name", ["whole", "tiled"])
def test_the_figures_are_those_of_run_json(cleaned, name):
    report = json.loads((cleaned[name] / "run.json").read_text(encoding="utf-8"))
    page = page_of(cleaned[name])
    words = " ".join(read(page).words)
    assert json.loads(re.search(r'id="run">([^<]*)</script>', page)[1]) == report
    assert f"{report['counts']['dynamic']:,}" in words
    assert facts(page)["removed"] == report["counts"]["dynamic"]
    for cluster in report["clusters"]:
        assert f"{cluster['count']:,}" in words
        assert f"{cluster['threshold']:.4g}" in words
    for stage in report["seconds"]:
        assert stage in words
    assert report["seconds"]["report"] > 0
    written = re.search(r"<pre>(.*?)</pre>", page, re.DOTALL)[1]
    assert yaml.safe_load(unescape(written)) == report["configuration"]
    assert "report.html" in report["outputs"]


def test_names_and_warnings_are_text_and_never_markup(cleaned):
    reader = read(page_of(cleaned["whole"]))
    assert "a<script>alert(1)<b>&\"'.npy" in "".join(reader.words)
    assert "a warning with <b>bold</b> words" in "".join(reader.words)
    report = json.loads((cleaned["whole"] / "run.json").read_text(encoding="utf-8"))
    assert reader.tags.count("b") == len(report["places"])  # their numbers
    (icon,) = reader.links
    assert icon.startswith("data:image/png;base64,")


def test_the_page_does_not_depend_on_how_the_map_is_cut(cleaned):
    whole, tiled = page_of(cleaned["whole"]), page_of(cleaned["tiled"])
    for name in ("places", "percentages", "labels", "clusters", "densities"):
        assert array(whole, name) == array(tiled, name)
    assert facts(whole) | {"apply": None} == facts(tiled) | {"apply": None}


def test_numbers_over_the_charts_leave_room_for_their_names(cleaned):
    told = re.findall(r">([^<]* points · R_i [^<]*)<", page_of(cleaned["whole"]))
    assert told
    for words in told:
        assert re.fullmatch(r"[\d.]+( k)? points · R_i [\d.]{1,4} % · removed [\d.]+( k)?", words)


def test_tiles_are_drawn_with_their_points_time_and_state(cleaned):
    page = page_of(cleaned["tiled"])
    tiles = re.findall(r"<title>tile (\d+): ([\d,]+) points, ([\d.]+) s, ([^<]*)</title>", page)
    assert len(tiles) > 4
    assert sum(int(points.replace(",", "")) for _, points, _, _ in tiles) == 32_500
    assert {state for *_, state in tiles} == {"done in this run"}
    assert "One tile of 32,500 points" in page_of(cleaned["whole"])


def test_tiles_kept_from_an_interrupted_run_are_told_apart(cleaned, tmp_path, monkeypatch):
    from pipeline.tiles import stages  # noqa: PLC0415

    (tmp_path / "map.npy").write_bytes(next(cleaned["whole"].parent.glob("*.npy")).read_bytes())
    settings = ["clustering.count=3", "tiling.max_points=5000", "execution.cluster=none"]
    configuration = load_configuration(None, [*settings, "neighbours.k=30"])
    work = stages.TASKS["density"]

    def fails_once(job, tile, *sides):
        if tile == 1:
            raise ValueError("no luck")
        return work(job, tile, *sides)

    with monkeypatch.context() as patch:
        patch.setitem(stages.TASKS, "density", fails_once)
        with pytest.raises(Exception, match="no luck"):
            run([tmp_path / "map.npy"], tmp_path / "out", configuration, observer())
    run([tmp_path / "map.npy"], tmp_path / "out", configuration, observer())
    states = re.findall(r"<title>tile (\d+): [^<]* s, ([^<]*)</title>", page_of(tmp_path / "out"))
    assert dict(states).pop("1") == "done in this run"
    others = {state for number, state in states if number != "1"}
    assert others == {"kept from an interrupted run"}


def observer():
    return StageObserver(LogDisplay())


def test_without_a_report_there_is_none(cleaned, tmp_path):
    source = next(cleaned["whole"].parent.glob("*.npy"))
    for tile in (1_000_000, 5_000):
        settings = ["output.report=none", f"tiling.max_points={tile}", "execution.cluster=none"]
        folder = tmp_path / str(tile)
        report = run([source], folder, load_configuration(None, settings), observer())
        assert not (folder / "report.html").exists()
        assert "report.html" not in report.outputs
        assert "report.html" not in report.summary()


@pytest.mark.parametrize("points", [0, 1, 3, 40])
@pytest.mark.parametrize(("decision", "shares"), [("paper", 1_001), ("auto", 101)])
def test_maps_of_next_to_nothing_have_a_page(tmp_path, points, decision, shares):
    np.save(tmp_path / "map.npy", np.random.default_rng(0).normal(size=(points, 3)))
    run([tmp_path / "map.npy"], tmp_path / "out", load_configuration(decision), observer())
    page = page_of(tmp_path / "out")
    assert facts(page)["total"] == points
    assert len(facts(page)["removed_points"]) == shares
