"""A run says in which steps coordinates are kept that are too coarse to measure neighbours."""

import numpy as np
import pytest

from pipeline.configuration.run import load_configuration
from pipeline.progress import LogDisplay, StageObserver
from pipeline.run import run

FAST = ["neighbours.k=8", "execution.cluster=none", "ground.method=none", "output.report=none"]


@pytest.mark.parametrize("most", [1_000_000, 150], ids=["one tile", "tiles"])
@pytest.mark.parametrize(("northing", "coarse"), [(5_000_000.0, True), (50.0, False)])
def test_a_run_names_the_step(most, northing, coarse, tmp_path):
    xyz = np.random.default_rng(0).uniform(size=(600, 3)) * [9, 7, 2] + [0, northing, 0]
    np.save(tmp_path / "map.npy", xyz.astype(np.float32))
    configuration = load_configuration(None, [*FAST, f"tiling.max_points={most}"])
    observer = StageObserver(LogDisplay())
    report = run([tmp_path / "map.npy"], tmp_path / "out", configuration, observer)
    said = [warning for warning in report.warnings if "keeps y in steps of 0.5 m" in warning]
    assert len(said) == coarse
