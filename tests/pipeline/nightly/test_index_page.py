"""The page of the morning: every map is on it, with a link that leads somewhere."""

import json
from datetime import UTC, datetime
from html.parser import HTMLParser
from urllib.parse import unquote

import pytest


class Page(HTMLParser):
    """Links and text of a page, and whether all that is opened is closed."""

    def __init__(self, text):
        super().__init__()
        self.links, self.words, self.open, self.goes_on = [], [], [], False
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.links += [value for name, value in attrs if name in ("href", "src")]
        self.goes_on = tag == "wbr"
        if tag not in ("meta", "wbr"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        self.goes_on = False
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.goes_on:
            self.words[-1] += data
        else:
            self.words.append(data.strip())


def test_every_map_and_its_report_are_on_the_page(place):
    name = "a <b>&amp; 100%#1?.npy"
    place.write(f"incoming/{name}", "one")
    place.write("incoming/bad.npy", "corrupt <i>")
    place.write("incoming/gone.npy", "two")
    place.night()
    (place.incoming / "gone.npy").unlink()
    (place.folder / "surveys").rmdir()
    place.night()
    page = Page((place.output / "index.html").read_text())
    assert page.open == []
    for each in (name, "bad.npy", "gone.npy"):
        assert str(place.incoming / each) in page.words
    assert {"unchanged", "failed", "vanished"} <= set(page.words)
    assert "it is corrupt; set aside after 2 nights, until it changes (2 nights)" in page.words
    assert f"{place.folder}/surveys: no such file or folder" in page.words
    assert len(page.links) == 2 * 2 + 2
    for link in page.links:
        assert (place.output / unquote(link)).exists()


def test_the_report_is_linked_where_there_is_one(place):
    path = place.write("incoming/a.npy", "one")
    place.cleaner.after = lambda request: (request.output / "report.html").write_text("<html>")
    place.night()
    run = place.results(path).latest()
    page = Page((place.output / "index.html").read_text())
    assert f"{run.parent.name}/{run.name}/report.html" in page.links


def test_what_a_run_warned_of_is_there_every_morning(place):
    def warn(request):
        path = request.output / "run.json"
        report = json.loads(path.read_text())
        path.write_text(json.dumps(report | {"warnings": ["half of <it> went"]}))

    place.write("incoming/a.npy", "one")
    place.cleaner.after = warn
    for _ in range(2):
        place.night()
        page = Page((place.output / "index.html").read_text())
        assert "warning: half of <it> went" in page.words
        (line,) = json.loads((place.output / "nightly.json").read_text())["maps"]
        assert line["warnings"] == ["half of <it> went"]


@pytest.mark.parametrize("width", [360, 1280])
def test_it_is_read_on_a_telephone_as_well(place, chromium, width):
    place.write(f"incoming/{'a_very_long_name' * 8}.npy", "one")
    place.write("incoming/bad.npy", "corrupt")
    place.night()
    page = chromium["webgl"].new_page(viewport={"width": width, "height": 800}, offline=True)
    heard = []
    page.on("console", lambda message: heard.append(message.text))
    page.on("pageerror", lambda error: heard.append(str(error)))
    page.goto((place.output / "index.html").as_uri())
    assert page.evaluate("() => document.documentElement.scrollWidth") <= width
    seen = page.inner_text("body")
    assert "it is corrupt" in seen
    begun = place.clock.now()
    assert f"Night of {datetime.fromtimestamp(begun, UTC):%Y-%m-%d %H:%M} UTC" in seen
    assert f"report of {datetime.fromtimestamp(begun, UTC):%Y-%m-%d %H:%M} UTC" in seen
    page.close()
    assert heard == []


def test_a_map_has_its_picture_and_the_last_nights_are_drawn(place):
    picture = "data:image/png;base64,iVBORw0KGgo="
    icon = f'<link rel="icon" href="{picture}">'
    place.write("incoming/a.npy", "one")
    place.cleaner.after = lambda request: (request.output / "report.html").write_text(icon)
    place.night()
    place.cleaner.after = lambda request: None
    place.write("incoming/bad.npy", "corrupt")
    summary = place.night()
    text = (place.output / "index.html").read_text()
    assert picture in Page(text).links
    assert "The last 2 nights" in text
    assert text.count('class="cleaned"') == 2
    assert Page(text).open == []
    assert summary.to_text().endswith("; failed: bad.npy")
