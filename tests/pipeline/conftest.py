"""Fixtures that the tests of the product share."""

import os

import pytest


@pytest.fixture(scope="module")
def nothing_waits_for_the_disk():
    """A process that ends leaves its page cache behind; only a power cut, not tested here, not."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda handle: None)
        yield
