"""Formats on their way through a run: one tile, tiles that failed and went on, one file of several.

Whatever the way, `verify` proves from the files that nothing is lost, and the bytes are the same.
"""

import io

import laspy
import numpy as np
import pytest

from pipeline.configuration.run import load_configuration
from pipeline.errors import TasksFailedError
from pipeline.info import inspect_map
from pipeline.progress import LogDisplay, StageObserver
from pipeline.run import run
from pipeline.tiles import stages
from pipeline.verifying import verify
from tests.tiling.test_row_ranges import COUNT, MAPS, NUMBER, XYZ

pytestmark = pytest.mark.usefixtures("nothing_waits_for_the_disk")

SETTINGS = [
    "neighbours.k=8",
    "clustering.count=2",
    "ground.method=none",
    "tiling.halo=0.3",
    "execution.workers=1",
    "output.labels=true",
    "output.report=none",
]
TILES = "tiling.max_points=130"
ONE_TILE = "tiling.max_points=100000"


def npz_with_objects() -> bytes:
    stream = io.BytesIO()
    np.savez(stream, cloud=XYZ, n=NUMBER, meta=np.array({"by": "hand"}, dtype=object))
    return stream.getvalue()


def las_with_short_header() -> bytes:
    header = laspy.LasHeader(point_format=3, version="1.2")
    header.scales = [0.001] * 3
    cloud = laspy.LasData(header)
    cloud.xyz = XYZ
    stream = io.BytesIO()
    cloud.write(stream)
    content = bytearray(stream.getvalue())
    content[25] = 3  # of a version whose header has eight bytes more
    content[100:104] = (1).to_bytes(4, "little")  # and a VLR that is not there
    return bytes(content)


def e57(folder) -> bytes:
    pytest.importorskip("pye57", reason="pye57 is not installed (extra e57)")
    from tests.tiling.test_e57 import write_e57  # noqa: PLC0415 - needs pye57

    write_e57(folder / "made.e57", (400, 0, 300), picture=1000)
    return (folder / "made.e57").read_bytes()


NEW = ["points.parquet", "organised.npy", "kitti.bin", "nuscenes.pcd.bin", "counted.pts"]
KINDS = {
    **{name: MAPS[name][0] for name in [*NEW, "named.csv"]},
    "objects.npz": npz_with_objects(),
    "short.las": las_with_short_header(),
    "scans.e57": None,
}


def cleaned(files, folder, *wanted):
    configuration = load_configuration("paper", [*SETTINGS, *wanted])
    return run(files, folder, configuration, StageObserver(LogDisplay()))


@pytest.fixture(params=KINDS)
def map_file(request, tmp_path):
    content = KINDS[request.param]
    path = tmp_path / request.param
    path.write_bytes(e57(tmp_path) if content is None else content)
    return path


def results(folder):
    names = [path for path in folder.iterdir() if path.suffix not in (".json", ".yaml")]
    return {path.name: path.read_bytes() for path in names if not path.name.startswith(".")}


def test_all_ways_through_a_run(map_file, tmp_path, monkeypatch):
    report = cleaned([map_file], tmp_path / "one", ONE_TILE)
    assert report.points == COUNT
    assert report.counts["dynamic"] > 0
    assert "labels follow" in verify(tmp_path / "one")
    static = next((tmp_path / "one").glob("static.*"))
    assert static.name == f"static{map_file.name[map_file.name.index('.') :]}"
    failing, task = [True], stages.TASKS["density"]

    def fails_once(job, number):
        if failing and number == 3:
            raise ValueError("no luck")
        return task(job, number)

    monkeypatch.setitem(stages.TASKS, "density", fails_once)
    with pytest.raises(TasksFailedError):
        cleaned([map_file], tmp_path / "tiles", TILES)
    failing.clear()
    cleaned([map_file], tmp_path / "tiles", TILES)
    assert results(tmp_path / "tiles") == results(tmp_path / "one")
    verify(tmp_path / "tiles")
    np.save(tmp_path / "other.npy", XYZ + [3, 0, 0])
    cleaned([tmp_path / "other.npy", map_file], tmp_path / "several", TILES)
    assert (tmp_path / "several" / "static" / map_file.name).exists()
    assert (tmp_path / "several" / "dynamic" / "other.npy").exists()
    verify(tmp_path / "several")


def test_info_says_what_is_known(map_file):
    info = inspect_map([map_file])
    (file,) = info.files
    assert file.points == info.points == COUNT
    assert file.format
    names = " ".join(field.split(":")[0].lower() for field in file.fields)
    assert all(axis in names for axis in "xyz")
    if map_file.name in ("organised.npy", "objects.npz", "short.las"):
        assert file.notes


def test_partitions_go_through_a_run(tmp_path):
    table = tmp_path / "table.parquet"
    for day in (1, 2):
        (table / f"day={day}").mkdir(parents=True)
        (table / f"day={day}" / f"part-{day}.parquet").write_bytes(MAPS["groups.parquet"][0])
    (table / "_SUCCESS").touch()
    cleaned([table], tmp_path / "out", TILES)
    names = [str(path.relative_to(tmp_path / "out")) for path in (tmp_path / "out").rglob("part*")]
    assert sorted(names) == [
        f"{k}/day={d}/part-{d}.parquet" for k in ("dynamic", "static") for d in (1, 2)
    ]
    verify(tmp_path / "out")


@pytest.mark.parametrize("case", ["pq05_spark.parquet", "ask_map.pcd.bin", "npz02_meta.npz"])
def test_cases_go_through_a_run(shared_data, tmp_path, case):
    cleaned([shared_data / "cases" / case], tmp_path / "out", ONE_TILE)
    assert "6,000 points" in verify(tmp_path / "out")
