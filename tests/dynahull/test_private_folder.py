"""Code is loaded from folders that nobody else can have put it into, or from none."""

import os
from pathlib import Path

import pytest

from dynahull import private_folder as module
from dynahull.private_folder import private_folder

NOBODY = 65534
ROOT = Path(__file__).resolve().parents[2]

as_root = pytest.mark.skipif(os.getuid() != 0, reason="only root can make another user's folders")


@pytest.fixture
def places(tmp_path, monkeypatch):
    """The user's cache and the folder for temporary files; all above them is this user's."""
    cache, temporary = tmp_path / "cache", tmp_path / "tmp"
    temporary.mkdir()
    temporary.chmod(0o1777)
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache))
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(temporary))
    module._tell.cache_clear()
    return cache, temporary


def test_a_folder_is_made_that_only_this_user_can_enter(places):
    cache, _ = places
    before = os.umask(0o002)
    try:
        folder = private_folder("code")
    finally:
        os.umask(before)
    assert folder == cache / "dynahull/code"
    assert {each.stat().st_mode & 0o777 for each in (folder, folder.parent, cache)} == {0o700}
    (folder / "kept").touch()
    assert private_folder("code") == folder


@pytest.mark.parametrize("step", ["cache", "cache/dynahull"])
def test_a_folder_below_one_that_others_write_is_not_taken(step, places, tmp_path):
    _, temporary = places
    private_folder("code")
    (tmp_path / step).chmod(0o777)
    assert private_folder("code") == temporary / f"dynahull-{os.getuid()}" / "code"
    (tmp_path / step).chmod(0o770)
    assert private_folder("code") == temporary / f"dynahull-{os.getuid()}" / "code"


def test_a_folder_that_others_could_enter_is_taken_while_it_is_empty(places):
    _, temporary = places
    folder = private_folder("code")
    folder.chmod(0o777)
    assert private_folder("code") == folder
    assert folder.stat().st_mode & 0o777 == 0o700
    (folder / "theirs").touch()
    folder.chmod(0o755)
    assert private_folder("code") == temporary / f"dynahull-{os.getuid()}" / "code"


def squat(kind, place, tmp_path):
    """Let another user have the place first."""
    theirs = tmp_path / "theirs"
    theirs.mkdir()
    if kind == "folder":
        place.mkdir()
    elif kind == "link to own":
        place.symlink_to(theirs)
    elif kind == "link to theirs":
        place.symlink_to(theirs)
        os.chown(theirs, NOBODY, NOBODY)
        return
    elif kind == "file":
        place.touch()
    os.chown(place, NOBODY, NOBODY, follow_symlinks=False)


@as_root
@pytest.mark.parametrize("kind", ["folder", "link to own", "link to theirs", "file"])
@pytest.mark.parametrize("below", ["", "code"])
def test_what_another_user_had_first_is_never_taken(kind, below, places, tmp_path):
    cache, temporary = places
    cache.touch()  # cannot be used
    place = temporary / f"dynahull-{os.getuid()}" / below
    place.parent.mkdir(exist_ok=True)
    squat(kind, place, tmp_path)
    assert private_folder("code") is None
    assert not any((tmp_path / "theirs").iterdir())


@as_root
def test_a_configured_folder_of_another_user_is_named_and_not_taken(places, tmp_path):
    (tmp_path / "numba").mkdir()
    os.chown(tmp_path / "numba", NOBODY, NOBODY)
    with pytest.warns(RuntimeWarning, match="numba: others may put code there"):
        assert private_folder("code", str(tmp_path / "numba")) == places[0] / "dynahull/code"


def test_links_of_this_user_are_followed(places, tmp_path):
    cache, _ = places
    (tmp_path / "elsewhere/far").mkdir(parents=True)
    (tmp_path / "near").symlink_to("elsewhere/far")
    cache.symlink_to(tmp_path / "near" / ".." / "far")
    assert private_folder("code") == cache / "dynahull/code"
    assert (tmp_path / "elsewhere/far/dynahull/code").is_dir()
    cache.unlink()
    cache.symlink_to(cache)  # leads nowhere
    assert private_folder("code") != cache / "dynahull/code"


def test_no_cache_is_looked_for_in_the_current_folder(places, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    assert private_folder("code") == places[1] / f"dynahull-{os.getuid()}" / "code"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setattr("os.path.expanduser", lambda path: path)  # no home is known
    assert private_folder("code") == places[1] / f"dynahull-{os.getuid()}" / "code"
    assert not (tmp_path / "relative").exists()


@pytest.mark.parametrize("package", ["dynahull", "tiling", "pipeline"])
def test_nothing_else_lets_numba_choose_where_code_is_kept(package):
    for path in (ROOT / package).rglob("*.py"):
        assert "cache=True" not in path.read_text(encoding="utf-8"), path
