"""The page in a browser: it opens from disk, draws, and answers."""

import json
import re

import pytest

INK = """(name) => {
  const canvas = document.getElementById(name);
  const copy = document.createElement("canvas");
  copy.width = canvas.width; copy.height = canvas.height;
  const context = copy.getContext("2d");
  context.drawImage(canvas, 0, 0);
  const data = context.getImageData(0, 0, copy.width, copy.height).data;
  let drawn = 0, orange = 0;
  for (let i = 0; i < data.length; i += 4) {
    if (data[i + 3] && data[i] + data[i + 1] + data[i + 2] < 740) drawn++;
    if (data[i] > 180 && data[i + 1] > 50 && data[i + 1] < 140 && data[i + 2] < 60) orange++;
  }
  return [drawn, orange];
}"""
ORANGE = """() => {
  const canvas = document.getElementById("scene-canvas");
  const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d");
  copy.drawImage(canvas, 0, 0);
  const { data } = copy.getImageData(0, 0, canvas.width, canvas.height);
  const middle = [canvas.width / 2, canvas.height / 2];
  let best = null, least = Infinity;
  for (let i = 0; i < data.length; i += 4) {
    if (data[i] < 180 || data[i + 1] > 140 || data[i + 2] > 60) continue;
    const at = [(i / 4) % canvas.width, Math.floor(i / 4 / canvas.width)];
    const off = Math.hypot(at[0] - middle[0], at[1] - middle[1]);
    if (off < least) [best, least] = [at, off];
  }
  return best;
}"""
PLAYED = """async () => {
  const [button, told] = ["play", "scans-shown"].map((name) => document.getElementById(name));
  button.click();
  const seen = [button.textContent, told.textContent];
  while (told.textContent === seen[1]) await new Promise((done) => setTimeout(done, 5));
  seen.push(told.textContent);
  button.click();
  return [...seen, button.textContent];
}"""
VIEWS = ("top-before", "top-after", "section-before", "section-after")


def settle(page):
    page.evaluate("() => new Promise((done) => requestAnimationFrame(() => setTimeout(done, 150)))")


def ink(page, canvas):
    """Count the pixels drawn, and those of them in the colour of what is removed."""
    settle(page)
    return page.evaluate(INK, canvas)


def removed_count(page):
    return int(page.inner_text("#removed-count").replace(",", ""))


@pytest.fixture
def dynamic(cleaned):
    report = json.loads((cleaned["whole"] / "run.json").read_text(encoding="utf-8"))
    return report["counts"]["dynamic"]


@pytest.mark.parametrize("name", ["whole", "tiled"])
def test_it_opens_from_disk_draws_and_asks_for_nothing(opened, cleaned, name):
    page = opened(name)
    for canvas in ("scene-canvas", *VIEWS):
        drawn, _ = ink(page, canvas)
        assert drawn > 1_000, canvas
    assert ink(page, "top-before")[1] > 100
    assert ink(page, "top-after")[1] == 0
    assert page.asked == [(cleaned[name] / "report.html").as_uri()]
    assert page.heard == []
    assert not page.is_visible("#no-webgl")


def test_the_name_of_the_map_is_its_title(opened):
    page = opened()
    assert page.title() == "a<script>alert(1)<b>&\"'.npy"
    assert page.inner_text("h1") == page.title()


def test_the_slider_changes_the_count_and_the_views(opened, dynamic):
    page = opened()
    assert removed_count(page) == dynamic
    assert "removed in this run" in page.inner_text(".answer")
    before = ink(page, "scene-canvas")[1], ink(page, "top-before")[1]
    cut = page.get_attribute("path.cut >> nth=1", "d")
    page.fill("#percentage", "60")
    assert removed_count(page) > 2 * dynamic
    assert "would be removed" in page.inner_text(".answer")
    assert "--set removal.min_percent=15 --set removal.max_percent=60" in page.inner_text(
        "#settings"
    )
    assert ink(page, "scene-canvas")[1] > 1.3 * before[0]
    assert ink(page, "top-before")[1] > 1.3 * before[1]
    assert page.get_attribute("path.cut >> nth=1", "d") != cut
    page.fill("#percentage", "0")
    assert removed_count(page) == 0
    assert ink(page, "scene-canvas")[1] == ink(page, "top-before")[1] == 0
    page.click("#reset")
    assert removed_count(page) == dynamic
    assert ink(page, "top-before")[1] == before[1]
    assert page.heard == []


def test_what_is_switched_off_is_not_drawn(opened):
    page = opened()
    everything = ink(page, "scene-canvas")
    assert everything[1] > 0
    page.uncheck("#show-removed")
    assert ink(page, "scene-canvas")[1] == 0
    assert ink(page, "top-before")[1] == 0
    without_removed = ink(page, "scene-canvas")[0]
    page.uncheck("#show-ground")
    assert 0 < ink(page, "scene-canvas")[0] < without_removed
    page.uncheck("#show-static")
    assert ink(page, "scene-canvas")[0] == 0
    page.check("#show-removed")
    assert ink(page, "scene-canvas")[1] > 0


def test_all_of_it_can_be_done_with_the_keyboard(opened, dynamic):
    page = opened()
    page.focus("#percentage")
    for _ in range(5):
        page.keyboard.press("PageUp")
    assert removed_count(page) > dynamic
    page.focus("#show-static")
    page.keyboard.press("Space")
    assert not page.is_checked("#show-static")
    page.keyboard.press("Space")
    picture = "() => document.getElementById('scene-canvas').toDataURL()"
    page.focus("#scene-canvas")
    settle(page)
    before = page.evaluate(picture)
    page.keyboard.press("ArrowLeft")
    settle(page)
    turned = page.evaluate(picture)
    page.keyboard.press("+")
    settle(page)
    assert len({before, turned, page.evaluate(picture)}) == 3


def test_the_colours_and_the_ways_to_look_change_the_view(opened):
    page = opened()
    picture = "() => document.getElementById('scene-canvas').toDataURL()"
    seen = set()
    for colour in ("0", "1", "2", "3"):
        page.select_option("#colour", colour)
        settle(page)
        seen.add(page.evaluate(picture))
    for button in ("#from-above", "#from-side"):
        page.click(button)
        settle(page)
        seen.add(page.evaluate(picture))
    assert len(seen) == 6


def test_the_section_goes_where_it_is_put(opened):
    page = opened()
    page.select_option("#direction", "0")
    page.select_option("#thickness", "0.5")
    page.fill("#place", "500")
    amid = ink(page, "section-before")[0]
    page.fill("#place", "0")
    wall = ink(page, "section-before")[0]
    assert wall > 2 * amid > 0
    assert "y = " in page.inner_text("#place-value")


def test_without_webgl_it_says_so_and_the_rest_works(opened, dynamic):
    page = opened(browser="no webgl")
    assert page.is_visible("#no-webgl")
    assert "WebGL" in page.inner_text("#no-webgl")
    assert page.is_disabled("#colour")
    for canvas in VIEWS:
        assert ink(page, canvas)[0] > 1_000
    page.fill("#percentage", "50")
    assert removed_count(page) > dynamic
    assert page.heard == []


@pytest.mark.parametrize("name", ["tiled", "posed tiled"])
def test_nothing_sticks_out_at_the_side(opened, name):
    page = opened(name, width=360)
    for width in (360, 390, 820, 1440):
        page.set_viewport_size({"width": width, "height": 900})
        settle(page)
        assert page.evaluate("() => document.documentElement.scrollWidth") <= width


@pytest.mark.parametrize("name", ["judged", "judged tiled"])
def test_by_evidence_the_slider_is_the_confidence(opened, cleaned, name):
    report = json.loads((cleaned[name] / "run.json").read_text(encoding="utf-8"))
    page = opened(name)
    assert removed_count(page) == report["counts"]["dynamic"]
    assert page.inner_text("#percentage-value") == "0.8"
    before = ink(page, "top-before")[1]
    page.fill("#percentage", "0.4")
    assert removed_count(page) == report["counts"]["dynamic"] + report["uncertain_points"]
    assert "would be removed" in page.inner_text(".answer")
    assert page.inner_text("#settings").endswith(
        f"{name}' --confidence 0.4" if " " in name else f"{name} --confidence 0.4"
    )
    assert ink(page, "top-before")[1] > before
    page.fill("#percentage", "0.95")
    assert removed_count(page) < report["counts"]["dynamic"]
    page.click("#reset")
    assert removed_count(page) == report["counts"]["dynamic"]
    assert page.inner_text("#settings").startswith("dynahull-pipeline apply ")
    assert ink(page, "top-before")[1] == before
    assert page.heard == []


def test_scores_are_a_colour_of_their_own(opened):
    page = opened("judged")
    picture = "() => document.getElementById('scene-canvas').toDataURL()"
    seen = set()
    for colour in ("0", "2", "4"):
        page.select_option("#colour", colour)
        settle(page)
        seen.add(page.evaluate(picture))
    assert len(seen) == 3


def test_a_place_is_framed_when_it_is_clicked(opened):
    page = opened("judged")
    for kind in ("static", "removed", "ground"):
        page.uncheck(f"#show-{kind}")
    assert ink(page, "scene-canvas")[0] == 0
    before = page.inner_text("#place-value")
    page.fill("#place", "0")
    page.click('[data-place="1"]')
    assert not page.is_visible("#picked")  # no scans are known
    assert ink(page, "scene-canvas")[0] > 100
    assert page.inner_text("#place-value") != before
    page.check("#show-removed")
    assert ink(page, "scene-canvas")[1] > 0
    assert page.heard == []


def test_without_webgl_a_place_is_shown_in_the_sections(opened):
    page = opened("judged", browser="no webgl")
    page.fill("#place", "0")
    before = page.inner_text("#place-value")
    page.click('[data-place="1"]')
    assert page.inner_text("#place-value") != before
    assert page.heard == []


@pytest.mark.parametrize("width", [390, 1440])
def test_the_view_and_the_places_are_above_the_fold(opened, width):
    page = opened("judged", width=width)
    box = page.locator("#scene").bounding_box()
    assert box["y"] < 200
    assert box["y"] + box["height"] < 900
    if width > 820:
        assert page.locator('[data-place="1"]').bounding_box()["y"] < 300
        figures = page.locator(".figure").all()
        assert len({each.bounding_box()["y"] for each in figures}) == 1  # none alone in a row


def test_the_swipe_shows_what_is_left_beside_what_was_there(opened):
    page = opened("judged")
    before = ink(page, "scene-canvas")
    page.fill("#swipe", "500")
    half = ink(page, "scene-canvas")[1]
    assert 0 < half < before[1]
    page.fill("#swipe", "0")
    assert ink(page, "scene-canvas")[1] == 0
    assert page.is_visible("#swipe-line")
    page.fill("#swipe", "1000")
    assert ink(page, "scene-canvas") == before
    assert not page.is_visible("#swipe-line")


def test_the_time_slider_hides_what_other_scans_saw(opened):
    page = opened("posed tiled")
    whole = ink(page, "scene-canvas")
    assert page.inner_text("#scans-shown") == "all"
    page.fill("#scan-from", "20")
    late = ink(page, "scene-canvas")
    page.fill("#scan-to", "25")
    few = ink(page, "scene-canvas")
    assert 0 < few[0] < late[0] < whole[0]
    assert 0 < few[1] < late[1] < whole[1]
    assert page.inner_text("#scans-shown") == "20 to 25"
    page.focus("#scan-from")
    for _ in range(6):
        page.keyboard.press("ArrowRight")
    assert page.inner_text("#scans-shown") == "26 to 26"  # the other end is pushed along
    page.fill("#scan-from", "0")
    page.fill("#scan-to", "39")
    assert ink(page, "scene-canvas") == whole
    assert page.evaluate(PLAYED) == ["Stop", "0 to 2", "1 to 3", "Play"]
    assert ink(page, "scene-canvas")[0] < whole[0]
    assert page.heard == []


def test_ghosts_are_coloured_by_when_they_were_seen(opened):
    page = opened("posed")
    picture = "() => document.getElementById('scene-canvas').toDataURL()"
    seen = set()
    for colour, ends in (
        ("0", None),
        ("5", "scan 0 scan 39"),
        ("6", "met by all seen through by all"),
    ):
        page.select_option("#colour", colour)
        settle(page)
        seen.add(page.evaluate(picture))
        told = page.inner_text("#ramp") if page.is_visible("#ramp") else None
        assert told is None if ends is None else told.split() == ends.split()
    assert len(seen) == 3


def test_a_place_tells_how_many_scans_saw_through_it(opened):
    page = opened("posed")
    page.click('[data-place="1"]')
    words = r"place 1: scans (\d+) to (\d+); typically met by (\d+) scans?, seen through by (\d+)"
    first, last, met, through = map(int, re.fullmatch(words, page.inner_text("#picked")).groups())
    assert 0 <= first < last <= 39
    assert through > 4 * met
    page.uncheck("#show-static")
    page.uncheck("#show-ground")
    settle(page)
    box = page.locator("#scene-canvas").bounding_box()
    pixel = page.evaluate(ORANGE)
    page.mouse.click(box["x"] + pixel[0], box["y"] + pixel[1])
    words = r".* m: removed; scan (\d+); met by (\d+) scans?, seen through by (\d+)"
    assert first <= int(re.fullmatch(words, page.inner_text("#picked"))[1]) <= last
    assert page.heard == []


def test_without_poses_a_place_tells_when_it_was_seen(opened):
    page = opened("timed")
    page.click('[data-place="1"]')
    assert re.fullmatch(r"place 1: scans \d+ to \d+", page.inner_text("#picked"))


def test_the_clip_box_hides_what_is_outside_of_it(opened):
    page = opened()
    whole = ink(page, "scene-canvas")[0]
    page.click(".clip summary")
    page.fill('[data-clip="z"][data-end="1"]', "500")
    low = ink(page, "scene-canvas")[0]
    page.fill('[data-clip="x"][data-end="0"]', "900")
    corner = ink(page, "scene-canvas")[0]
    assert 0 < corner < low < whole
    page.click("#unclip")
    assert ink(page, "scene-canvas")[0] == whole
    assert page.inner_text("#clipped") == "all is shown"


def test_a_ceiling_is_hidden_at_first(opened, cleaned):
    assert opened().inner_text("#clipped") == "all is shown"  # a street
    page = opened("hall")
    words = page.inner_text("#clipped")
    assert words.startswith("z up to ")
    assert 2.1 < float(words.split()[3]) < 2.4


def test_a_click_tells_where_a_point_is(opened):
    page = opened()
    page.click("#from-above")
    settle(page)
    box = page.locator("#scene-canvas").bounding_box()
    page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    x, y, z = (float(part) for part in page.inner_text("#picked").split(" m: ")[0].split(", "))
    assert abs(x - 10) < 1.5
    assert abs(y - 3) < 1.5
    assert -0.1 < z < 3.1


def test_of_many_files_each_is_a_choice_away(opened):
    page = opened("hall")
    assert page.locator("#file option").all_inner_texts() == ["a file", "east.npy", "west.npy"]
    picture = "() => document.getElementById('scene-canvas').toDataURL()"
    seen = set()
    for choice in ("0", "1"):
        page.select_option("#file", choice)
        settle(page)
        seen.add(page.evaluate(picture))
    assert len(seen) == 2


def test_a_dark_page_for_those_who_want_one(opened):
    page = opened("judged")
    light, _ = ink(page, "top-before")
    page.emulate_media(color_scheme="dark")
    page.reload()
    page.wait_for_selector("html[data-ready=yes]")
    settle(page)
    colour = "() => getComputedStyle(document.body).backgroundColor"
    assert page.evaluate(colour) == "rgb(16, 22, 29)"
    assert ink(page, "top-before")[0] > 1.5 * light  # the paper is ink, then
    assert page.heard == []
