"""Fixtures that every package's tests share."""

import sys
from pathlib import Path

import pytest
from hypothesis import settings

# On a busy machine any example may take long.
settings.register_profile("patient", deadline=None)
settings.load_profile("patient")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip, elsewhere, what looks at processes and memory as only Linux shows them."""
    if sys.platform.startswith("linux"):
        return
    for item in items:
        if item.get_closest_marker("linux_only"):
            item.add_marker(pytest.mark.skip(reason="this is about Linux"))


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real point clouds beside the project, which is not part of it."""
    folder = Path(__file__).resolve().parents[1] / "../shared/data"
    if not folder.is_dir():
        pytest.skip("../shared/data is absent")
    return folder
