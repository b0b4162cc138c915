"""Fixtures that the tests of the product share."""

import os
import shutil

import pytest

SOFTWARE_WEBGL = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")


@pytest.fixture(scope="module")
def nothing_waits_for_the_disk():
    """A process that ends leaves its page cache behind; only a power cut, not tested here, not."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda handle: None)
        yield


@pytest.fixture(scope="session")
def chromium():
    """The system's Chromium."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    names = ("chromium", "chromium-browser", "google-chrome")
    path = next(filter(None, map(shutil.which, names)), None)
    if path is None:
        pytest.skip("no Chromium on this machine (Debian: apt-get install chromium)")
    with playwright.sync_playwright() as driver:
        # Tests in containers run as root, where Chromium's own sandbox does not start.
        arguments = ["--no-sandbox", *SOFTWARE_WEBGL]
        with_webgl = driver.chromium.launch(executable_path=path, args=arguments)
        without = driver.chromium.launch(
            executable_path=path, args=["--no-sandbox", "--disable-3d-apis"]
        )
        yield {"webgl": with_webgl, "no webgl": without}
        with_webgl.close()
        without.close()
