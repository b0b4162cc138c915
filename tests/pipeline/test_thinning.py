"""The thinned map: a point a voxel, whole, the same however the map is cut."""

import json

import laspy
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynahull import Label
from pipeline.configuration.run import OutputParameters, load_configuration
from pipeline.outputs import thinning
from pipeline.progress import Display, StageObserver
from pipeline.run import run
from tiling.collection import MapCollection

pytestmark = pytest.mark.usefixtures("nothing_waits_for_the_disk")


def expected_rows(xyz, kept, voxel):
    """One row a voxel, found by looking at each in turn."""
    best = {}
    for row in np.flatnonzero(kept & np.isfinite(xyz).all(axis=1)):
        cell = np.floor(xyz[row] / voxel)
        off = float(((xyz[row] / voxel - cell - 0.5) ** 2).sum())
        key = tuple(cell)
        if key not in best or off < best[key][0]:
            best[key] = (off, row)
    return sorted(row for _, row in best.values())


@settings(deadline=None, max_examples=40)
@given(
    seed=st.integers(0, 2**32 - 1),
    counts=st.lists(st.integers(0, 300), min_size=1, max_size=3),
    voxel=st.sampled_from([0.05, 0.3, 2.0]),
    shift=st.sampled_from([0.0, -7.3, 652_345.5]),
    each=st.sampled_from([20, 10**6]),
)
def test_of_each_voxel_the_point_nearest_to_its_middle_stays(
    tmp_path_factory, seed, counts, voxel, shift, each
):
    folder, random = tmp_path_factory.mktemp("thin"), np.random.default_rng(seed)
    parts = [random.uniform(0, 2, (count, 3)) + shift for count in counts]
    parts[0][:3] = np.nan
    for number, part in enumerate(parts):
        np.save(folder / f"{number}.npy", part)
    collection = MapCollection([folder / f"{number}.npy" for number in range(len(parts))])
    xyz = np.concatenate(parts)
    labels = random.choice([Label.STATIC, Label.DYNAMIC, Label.GROUND], len(xyz)).astype(np.uint8)
    places = [folder / f"thin-{number}.npy" for number in range(len(parts))]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(thinning, "_POINTS_A_FILE", each)
        observer = StageObserver(Display())
        output = OutputParameters(voxel=voxel)
        count = thinning.write_thinned(collection, labels, output, places, folder, observer)
    rows = expected_rows(xyz, labels != Label.DYNAMIC, voxel)
    found = np.concatenate([np.load(place) for place in places])
    assert count == len(rows)
    np.testing.assert_array_equal(found, xyz[rows])
    assert not (folder / "voxels").exists()


def test_a_run_writes_it_with_all_fields_in_memory_and_over_tiles(tmp_path):
    random = np.random.default_rng(5)
    las = laspy.create(point_format=6, file_version="1.4")
    las.xyz = random.uniform(size=(6000, 3)) * [30, 12, 0.3]
    las.gps_time = np.arange(6000)
    las.write(tmp_path / "map.las")
    settings = [
        "neighbours.k=12",
        "execution.cluster=none",
        "ground.method=none",
        "output.voxel=0.5",
    ]
    bytes_of = []
    for tiles in ([], ["tiling.max_points=1500"]):
        configuration = load_configuration(None, [*settings, *tiles])
        report = run(
            [tmp_path / "map.las"], tmp_path / "out", configuration, StageObserver(Display())
        )
        assert "thinned.las" in json.loads((tmp_path / "out/run.json").read_text())["outputs"]
        bytes_of.append((tmp_path / "out/thinned.las").read_bytes())
    assert bytes_of[0] == bytes_of[1]
    thin, static = laspy.read(tmp_path / "out/thinned.las"), laspy.read(tmp_path / "out/static.las")
    assert 0 < len(thin.points) < len(static.points) == report.points - report.counts["dynamic"]
    rows = np.searchsorted(static.gps_time, thin.gps_time)
    np.testing.assert_array_equal(static.points.array[rows], thin.points.array)
    run([tmp_path / "map.las"], tmp_path / "out", load_configuration(None, settings[:3]),
        StageObserver(Display()))  # fmt: skip
    assert not (tmp_path / "out/thinned.las").exists()
