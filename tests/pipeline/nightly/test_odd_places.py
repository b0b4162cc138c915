"""Links into folders of maps, file systems without links or locks, pages that cannot be made."""

import errno
import fcntl
import logging
from pathlib import Path

import pytest

from pipeline.errors import NightlyError
from pipeline.nightly import night, results
from pipeline.nightly.one_map import Request, clean_one
from pipeline.progress import LogDisplay, StageObserver

SECRET = "root:$6$top.secret:19000\x1b[2J"


@pytest.fixture
def secret(tmp_path):
    (tmp_path / "etc").mkdir()
    path = tmp_path / "etc/shadow.npy"
    path.write_text(SECRET)
    return path


def everything_said(place, caplog):
    names = ("nightly.json", "nightly.jsonl", "index.html")
    return caplog.text + "".join((place.output / name).read_text() for name in names)


@pytest.mark.parametrize(
    "link", ["incoming/a.npy", "incoming/site", "surveys/north", "surveys/one/a.npy"]
)
def test_no_link_out_of_a_folder_of_maps_is_followed(place_in, tmp_path, secret, caplog, link):
    caplog.set_level(logging.DEBUG)
    (tmp_path / "home").mkdir()
    place = place_in(tmp_path / "home")
    place.write("incoming/good.npy", "one")
    there = place.folder / link
    there.parent.mkdir(exist_ok=True)
    there.symlink_to(secret if link.endswith(".npy") else secret.parent)
    for _ in range(2):
        summary = place.night()
        assert any("a link out of" in each for each in summary.problems)
        assert summary.exit_code == 4
    assert place.cleaner.asked == ["good.npy"]
    assert "secret" not in everything_said(place, caplog)
    assert secret.read_text() == SECRET


def test_a_link_within_the_folder_of_maps_is_a_map(place, outcomes_of):
    first = place.write("incoming/site/a.npy", "one")
    (place.incoming / "b.npy").symlink_to(first)
    assert "cleaned" in outcomes_of(place.night()).values()
    assert not place.night().problems


def test_a_folder_of_maps_that_is_itself_a_link_is_looked_into(place_in, tmp_path, outcomes_of):
    place = place_in(tmp_path)
    place.incoming.rename(tmp_path / "disk")
    place.incoming.symlink_to(tmp_path / "disk")
    place.write("incoming/a.npy", "one")
    assert outcomes_of(place.night()) == {"a.npy": "cleaned"}


def test_a_map_that_becomes_a_link_after_it_was_looked_at_is_not_read(place, secret):
    path = place.incoming / "a.npy"
    path.symlink_to(secret)
    settings = place.settings()
    configuration = settings.configuration_of(settings.inputs[0])
    request = Request(path, place.output / "run", configuration, place.incoming)
    ended = clean_one(request, StageObserver(LogDisplay()))
    assert ended.how == "failed"
    assert "became a link out of" in ended.reason


def test_a_link_in_the_place_of_a_map_s_results_is_not_followed(place, tmp_path):
    path = place.write("incoming/a.npy", "one")
    elsewhere = tmp_path / "elsewhere"
    (elsewhere / ".removed-mine").mkdir(parents=True)
    (elsewhere / ".removed-mine/thesis.tex").write_text("mine")
    place.output.mkdir()
    place.results(path).path.symlink_to(elsewhere)
    summary = place.night()
    assert any("found a link" in each for each in summary.problems)
    assert [str(each.relative_to(elsewhere)) for each in elsewhere.rglob("*")] == [
        ".removed-mine", ".removed-mine/thesis.tex",
    ]  # fmt: skip


def test_what_a_file_says_is_told_in_printable_characters(real_place, caplog):
    caplog.set_level(logging.DEBUG)
    place = real_place
    place.write("incoming/a\x1b[31m.pcd", b"\x1b]0;title\x07" * 500)
    place.source.write_text(place.source.read_text().replace("*.npy", "*.pcd"))
    place.night()
    assert "\x1b" not in everything_said(place, caplog)
    assert max(len(line["reason"]) for line in place.lines("failed")) <= 1_100


@pytest.mark.parametrize("fault", [errno.EPERM, errno.ENOTSUP, errno.ENOSYS])
def test_without_links_every_map_of_a_night_is_cleaned(
    place, monkeypatch, outcomes_of, caplog, fault
):
    def refused(*_, **__):
        raise OSError(fault, "no links here")

    results._warn_of_no_links.cache_clear()
    monkeypatch.setattr(Path, "symlink_to", refused)
    paths = [place.write(f"incoming/{name}.npy", name) for name in "abc"]
    assert set(outcomes_of(place.night()).values()) == {"cleaned"}
    assert set(outcomes_of(place.night()).values()) == {"unchanged"}
    assert place.results(paths[0]).latest().is_dir()
    assert caplog.text.count("no links here") <= len(paths)


@pytest.mark.parametrize("fault", [errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP])
def test_without_locks_a_night_goes_on_and_warns(
    real_place, map_bytes, monkeypatch, outcomes_of, caplog, fault
):
    def refused(*_):
        raise OSError(fault, "no locks here")

    monkeypatch.setattr(fcntl, "flock", refused)
    real_place.write("incoming/a.npy", map_bytes(1))
    assert outcomes_of(real_place.night()) == {"a.npy": "cleaned"}
    assert "has no locks" in caplog.text


def test_without_fsync_a_night_goes_on(tmp_path, place_in, monkeypatch, outcomes_of):
    def refused(handle):
        raise OSError(errno.EINVAL, "Invalid argument")

    place = place_in(tmp_path)
    monkeypatch.setattr("os.fsync", refused)
    place.write("incoming/a.npy", "one")
    assert outcomes_of(place.night()) == {"a.npy": "cleaned"}


def test_a_page_that_cannot_be_made_fails_no_night(place, monkeypatch, outcomes_of, caplog):
    def broken(*_):
        raise ValueError("no page today")

    monkeypatch.setattr(night, "write_index", broken)
    monkeypatch.setattr("pipeline.nightly.minutes.NightSummary.write", broken)
    place.write("incoming/a.npy", "one")
    summary = place.night()
    assert outcomes_of(summary) == {"a.npy": "cleaned"}
    assert summary.exit_code == 0
    assert "no page today" in caplog.text


@pytest.mark.parametrize("name", ["index.html", "nightly.json"])
def test_a_night_replaces_only_what_nights_wrote(place, name):
    place.output.mkdir()
    (place.output / name).write_text("mine")
    place.write("incoming/a.npy", "one")
    with pytest.raises(NightlyError, match="no night wrote"):
        place.night()
    assert (place.output / name).read_text() == "mine"
    (place.output / name).unlink()
    place.night()
    place.night()


def test_no_night_writes_through_a_link(place, tmp_path):
    (tmp_path / "mine").write_text("mine")
    place.output.mkdir(exist_ok=True)
    (place.output / "nightly.jsonl").symlink_to(tmp_path / "mine")
    with pytest.raises(Exception, match=r"symbolic link|found a link"):
        place.night()
    assert (tmp_path / "mine").read_text() == "mine"


def test_a_map_with_points_that_its_header_does_not_count_is_not_cleaned(
    real_place, map_bytes, outcomes_of
):
    content = map_bytes(0)
    fewer = content.replace(b"(150, 3)", b"(0, 3)  ")
    assert len(fewer) == len(content)
    (real_place.incoming / "whole.npy").write_bytes(fewer)
    summary = real_place.night()
    assert outcomes_of(summary) == {"whole.npy": "failed"}
    assert summary.exit_code == 4
