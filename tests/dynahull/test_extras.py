"""An extra is installed as the package itself was."""

import json
from importlib.metadata import PackageNotFoundError

import pytest

from dynahull import extras


class Installed:
    def __init__(self, **files):
        self._files = files

    def read_text(self, name):
        return self._files.get(name.partition(".")[0])


@pytest.mark.parametrize(
    ("files", "command"),
    [
        ({"INSTALLER": "pip\n"}, "pip install 'dynahull-pipeline[plot]'"),
        ({"INSTALLER": "conda"}, "conda install -c conda-forge matplotlib"),
        (
            {"direct_url": json.dumps({"url": "file:///a%20b", "dir_info": {"editable": True}})},
            "pip install -e '/a b[plot]'",
        ),
        (
            {"direct_url": json.dumps({"url": "file:///clone", "dir_info": {}})},
            "pip install '/clone[plot]'",
        ),
        (
            {"direct_url": json.dumps({"url": "https://there/x", "vcs_info": {"vcs": "git"}})},
            "pip install 'dynahull-pipeline[plot] @ git+https://there/x'",
        ),
    ],
)
def test_the_command_is_that_of_the_package_itself(monkeypatch, files, command):
    monkeypatch.setattr(extras, "distribution", lambda name: Installed(**files))
    assert extras.install_command("plot", "matplotlib") == command


def test_where_it_is_not_installed_its_parts_are(monkeypatch):
    def missing(name):
        raise PackageNotFoundError(name)

    monkeypatch.setattr(extras, "distribution", missing)
    assert extras.install_command("plot", "matplotlib") == "pip install matplotlib"
