"""A map, and its report in a browser."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.configuration.run import load_configuration
from pipeline.progress import LogDisplay, StageObserver
from pipeline.run import run

NASTY_NAME = "a<script>alert(1)<b>&\"'.npy"


def street() -> np.ndarray:
    """A floor, two walls, a pillar, and the trail of someone who walked between them."""
    rng = np.random.default_rng(7)
    floor = np.column_stack([rng.uniform(0, 20, 9_000), rng.uniform(0, 6, 9_000), np.zeros(9_000)])
    walls = [
        np.column_stack([rng.uniform(0, 20, 9_000), np.full(9_000, y), rng.uniform(0, 3, 9_000)])
        for y in (0.0, 6.0)
    ]
    around = rng.uniform(0, 2 * np.pi, 4_000)
    pillar = np.column_stack([5 + 0.3 * np.cos(around), 3 + 0.3 * np.sin(around),
                              rng.uniform(0, 3, 4_000)])  # fmt: skip
    trail = np.column_stack([rng.uniform(2, 18, 1_500), rng.normal(4, 0.2, 1_500),
                             rng.uniform(0.2, 1.8, 1_500)])  # fmt: skip
    noise = rng.normal(0, 0.005, (32_500, 3))
    return np.concatenate([floor, *walls, pillar, trail]) + noise


SCANS = 40


def write_timed_street(folder):
    """Write the street with scan numbers, the first not known, and the poses; return map, setting.

    Who walked was seen on the way; all else at any time.
    """
    xyz, rng = street(), np.random.default_rng(8)
    scan = rng.integers(0, SCANS, len(xyz))
    scan[-1_500:] = (np.clip(xyz[-1_500:, 0], 2, 17.9) - 2) / 16 * SCANS
    scan[0] = -1
    np.savez(folder / "timed.npz", points=xyz, scan=scan)
    poses = np.tile(np.eye(3, 4), (SCANS, 1, 1))
    poses[:, :, 3] = np.linspace([2, 2, 1.2], [18, 2, 1.2], SCANS)
    np.savetxt(folder / "poses.txt", poses.reshape(SCANS, 12), "%.17g")
    return folder / "timed.npz", f"input.poses={folder / 'poses.txt'}"


PAPER = ["removal.decision=paper"]
BY_EVIDENCE = ["removal.decision=auto", "removal.confidence=0.8"]


@pytest.fixture(scope="session")
def cleaned(tmp_path_factory):
    """The output folders of the same map, of a nasty name, cleaned in several ways."""
    folder = tmp_path_factory.mktemp("page")
    np.save(folder / "map.npy", street())
    (folder / "map.npy").rename(folder / NASTY_NAME)
    outputs = {}
    hall = street()
    ceiling = hall[:9_000] * [1, 1, 0] + [0, 0, 2.4]
    ceiling[:, 2] += 0.03 * (20 - ceiling[:, 0])  # as of a map that drifts
    for name, part in (("east", [*hall[hall[:, 0] > 10]]), ("west", [*hall[hall[:, 0] <= 10]])):
        np.save(folder / f"{name}.npy", np.array(part + [*ceiling[name == "east" :: 2]]))
    configuration = load_configuration(None, ["neighbours.k=30", "clustering.count=3"])
    files = [folder / "east.npy", folder / "west.npy"]
    observer = StageObserver(LogDisplay())
    outputs["hall"] = Path(run(files, folder / "hall", configuration, observer).output)
    plain, (timed, poses) = folder / NASTY_NAME, write_timed_street(folder)
    for name, path, tile, more in (
        ("whole", plain, 1_000_000, PAPER),
        ("tiled", plain, 5_000, PAPER),
        ("judged", plain, 1_000_000, BY_EVIDENCE),
        ("judged tiled", plain, 12_000, BY_EVIDENCE),
        ("timed", timed, 1_000_000, BY_EVIDENCE),
        ("posed", timed, 1_000_000, [*BY_EVIDENCE, poses]),
        ("posed tiled", timed, 12_000, [*BY_EVIDENCE, poses]),
    ):
        settings = ["clustering.count=3", f"tiling.max_points={tile}", "execution.cluster=none"]
        settings += more
        observer = StageObserver(LogDisplay())
        observer.warn("a warning with <b>bold</b> words")
        configuration = load_configuration(None, [*settings, "neighbours.k=30"])
        outputs[name] = Path(run([path], folder / name, configuration, observer).output)
    return outputs


@pytest.fixture
def opened(chromium, cleaned):
    """Open a report from disk; what it says, throws and asks for is kept."""
    pages = []

    def open_page(name="whole", browser="webgl", width=1280):
        page = chromium[browser].new_page(viewport={"width": width, "height": 900}, offline=True)
        page.set_default_timeout(120_000)
        page.heard = []
        page.on("console", lambda message: page.heard.append(message.text))
        page.on("pageerror", lambda error: page.heard.append(str(error)))
        page.on("dialog", lambda dialog: (page.heard.append(dialog.message), dialog.dismiss()))
        page.asked = []
        page.on("request", lambda request: page.asked.append(request.url))
        page.goto((cleaned[name] / "report.html").as_uri())
        page.wait_for_selector("html[data-ready=yes]")
        pages.append(page)
        return page

    yield open_page
    for page in pages:
        page.close()
