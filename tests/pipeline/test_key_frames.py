"""Folders of scans with poses, in every layout: one map, and each scan back under its own name."""

import json
from types import SimpleNamespace

import laspy
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from dynahull import Label, clean
from pipeline.apply import decide_again
from pipeline.commands.app import app
from pipeline.configuration.run import load_configuration
from pipeline.errors import EvaluationError, InputChangedError
from pipeline.evaluation.inputs import _read_run
from pipeline.info import inspect_map
from pipeline.outputs.reading import read_result
from pipeline.preview import WHOLE, preview
from pipeline.progress import LogDisplay, StageObserver
from pipeline.run import run
from pipeline.verifying import verify
from pipeline.work import job
from pipeline.work.folder import WORK_FOLDER
from tiling.collection import MapCollection, find_map_files
from tiling.errors import MapFormatError, NoMapError
from tiling.formats import open_map
from tiling.key_frames import ScanPoses, _of_quaternions, read_poses

pytestmark = pytest.mark.usefixtures("nothing_waits_for_the_disk")

FRAMES, EACH = 24, 90
TR = np.array([[0.0, -1, 0, 0.1], [0, 0, -1, -0.2], [1, 0, 0, 0.3]])


def square(pose):
    return np.vstack([pose, [0, 0, 0, 1]])


def drive():
    """Poses of a sensor that moves and turns, 20 m off the origin, and points around it."""
    random = np.random.default_rng(5)
    poses, clouds = [], []
    for number in range(FRAMES):
        angle, tilt = 0.3 * number, 0.05 * number
        turn = np.array(
            [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
        ) @ np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
        place = np.array([20 + 0.1 * number, -15, 1])
        world = random.uniform([17, -18, 0], [24, -12, 2.5], (EACH, 3))
        poses.append(np.column_stack([turn, place]))
        clouds.append(((world - place) @ turn).astype("f4"))
    return np.array(poses), clouds


POSES, CLOUDS = drive()
WORLD = np.concatenate(
    [cloud.astype("f8") @ p[:, :3].T + p[:, 3] for cloud, p in zip(CLOUDS, POSES, strict=True)]
)


def records(cloud, number):
    found = np.zeros(len(cloud), [("xyz", "<f4", 3), ("intensity", "<f4")])
    found["xyz"], found["intensity"] = cloud, number + np.arange(len(cloud)) / 100
    return found


def write_pcd(path, cloud, number, viewpoint="0 0 0 1 0 0 0"):
    path.parent.mkdir(parents=True, exist_ok=True)
    head = (
        "VERSION 0.7\nFIELDS x y z intensity\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\n"
        f"WIDTH {len(cloud)}\nHEIGHT 1\nVIEWPOINT {viewpoint}\nPOINTS {len(cloud)}\nDATA binary\n"
    )
    path.write_bytes(head.encode() + records(cloud, number).tobytes())


def quaternion(turn):
    """w, x, y, z."""
    w = np.sqrt(max(0.0, 1 + np.trace(turn))) / 2
    x, y, z = np.array(
        [turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]
    ) / (4 * w)
    return w, x, y, z


def lines(poses):
    return "\n".join(" ".join(f"{v:.17g}" for v in pose.ravel()) for pose in poses) + "\n"


def hdl(folder):
    for number, (pose, cloud) in enumerate(zip(POSES, CLOUDS, strict=True)):
        place = folder / f"{number:06d}"
        write_pcd(place / "cloud.pcd", cloud, number)
        matrix = "\n".join("  ".join(f"{v:.17g}" for v in row) for row in square(pose))
        (place / "data").write_text(
            f"stamp {number} 5\nestimate\n{matrix}\nodom\n{matrix}\naccum_distance {number}\nid 7\n"
        )
    (folder / "graph.g2o").write_text("")
    write_pcd(folder / "map.pcd", CLOUDS[0], 0)  # what else may lie there
    return folder


def sc_lio_sam(folder, name="optimized_poses.txt"):
    for number, cloud in enumerate(CLOUDS):
        write_pcd(folder / "Scans" / f"{number:06d}.pcd", cloud, number)
    (folder / name).write_text(lines(POSES))
    write_pcd(folder / "cornerMap.pcd", CLOUDS[0], 0)
    return folder


def removert(folder):
    return sc_lio_sam(folder, "poses.txt")


def kitti(folder):
    sequence = folder / "sequences" / "07"
    (sequence / "velodyne").mkdir(parents=True)
    for number, cloud in enumerate(CLOUDS):
        (sequence / "velodyne" / f"{number:06d}.bin").write_bytes(records(cloud, number).tobytes())
    camera = [(square(TR) @ square(p) @ np.linalg.inv(square(TR)))[:3] for p in POSES]
    other = "P0: " + " ".join(["1.0"] * 12)
    numbers = " ".join(f"{v:.17g}" for v in TR.ravel())
    (sequence / "calib.txt").write_text(f"{other}\nTr: {numbers}\n")
    (folder / "poses").mkdir()
    (folder / "poses" / "07.txt").write_text(lines(camera))
    return sequence


def semantic_kitti(folder):
    sequence = kitti(folder)
    (folder / "poses" / "07.txt").rename(sequence / "poses.txt")
    return sequence


def benchmark(folder):
    clouds = np.split(WORLD.astype("f4"), FRAMES)
    for number, (pose, cloud) in enumerate(zip(POSES, clouds, strict=True)):
        viewpoint = " ".join(f"{v:.9g}" for v in (*pose[:, 3], *quaternion(pose[:, :3])))
        write_pcd(folder / "pcd" / f"{number:06d}.pcd", cloud, number, viewpoint)
    write_pcd(folder / "gt_cloud.pcd", CLOUDS[0], 0)
    return folder


def viewpoints_of_sensor_frames(folder):
    for number, (pose, cloud) in enumerate(zip(POSES, CLOUDS, strict=True)):
        viewpoint = " ".join(f"{v:.9g}" for v in (*pose[:, 3], *quaternion(pose[:, :3])))
        write_pcd(folder / f"{number:06d}.pcd", cloud, number, viewpoint)
    return folder


LAYOUTS = [
    *(hdl, sc_lio_sam, removert, kitti, semantic_kitti, benchmark),
    viewpoints_of_sensor_frames,
]


def points_of(collection, size=50):
    return np.concatenate([batch.xyz for _, batch in collection.batches(size)])


def cleaned(folder, output, *wanted, most=10**6):
    chosen = ["execution.cluster=none", "ground.method=none", "neighbours.k=8"]
    chosen += ["output.report=none", f"tiling.max_points={most}", *wanted]
    configuration = load_configuration("auto", chosen)
    return run([folder], output, configuration, StageObserver(LogDisplay()))


@pytest.mark.parametrize("layout", LAYOUTS)
def test_each_layout_is_one_map_and_each_scan_comes_back(tmp_path, layout):
    folder = layout(tmp_path / "in")
    collection = MapCollection(find_map_files([folder]))
    assert len(collection.readers) == FRAMES
    np.testing.assert_allclose(points_of(collection), WORLD, atol=2e-5)
    np.testing.assert_array_equal(points_of(collection, 7), points_of(collection, 1000))
    np.testing.assert_allclose(collection.poses.poses, POSES, atol=1e-6)
    expected = clean(
        points_of(collection),
        {"removal": {"decision": "auto"}, "neighbours": {"k": 8}, "ground": {"method": "none"}},
        scan=np.repeat(np.arange(FRAMES), EACH),
        poses=collection.poses.poses,
    ).labels
    for most in (10**6, 700):
        output = tmp_path / f"out{most}"
        report = cleaned(folder, output, most=most)
        assert report.time == f"key frames, {FRAMES} scans with poses"
        for number, file in enumerate(report.files):
            scan = expected[number * EACH : (number + 1) * EACH]
            before = collection.paths[number].read_bytes()[-16 * EACH :]
            rows = np.frombuffer(before, "V16")
            for name, chosen in (
                (file.static, scan != Label.DYNAMIC),
                (file.dynamic, scan == Label.DYNAMIC),
            ):
                after = (output / name).read_bytes()
                assert after[len(after) - 16 * chosen.sum() :] == rows[chosen].tobytes()
                assert open_map(output / name).description.point_count == chosen.sum()
                assert name.endswith(collection.paths[number].name)
        np.testing.assert_allclose(
            np.sort(read_result(output).xyz, axis=0), np.sort(WORLD, axis=0), atol=2e-5
        )
    assert f"time        key frames, {FRAMES} scans with poses" in inspect_map([folder]).to_text()


def test_poses_that_are_given(tmp_path):
    sc_lio_sam(tmp_path / "in", "elsewhere.txt")
    tum = [[n, *p[:, 3], *np.roll(quaternion(p[:, :3]), -1)] for n, p in enumerate(POSES)]
    np.savetxt(tmp_path / "tum.txt", tum, "%.17g", header="time x y z qx qy qz qw")
    with_times = np.column_stack([np.arange(FRAMES), POSES.reshape(FRAMES, 12)])
    np.savetxt(tmp_path / "times.txt", with_times, "%.17g")
    for name in ("tum.txt", "times.txt"):
        np.testing.assert_allclose(read_poses(tmp_path / name)[0], POSES, atol=1e-9)
    named = ["--scans", str(tmp_path / "in" / "Scans"), "--poses", str(tmp_path / "tum.txt")]
    command = ["run", *named, "-o", str(tmp_path / "out"), "-c", "auto"]
    for setting in ("neighbours.k=8", "ground.method=none", "output.report=none"):
        command += ["--set", setting]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 0, result.output
    report = json.loads((tmp_path / "out" / "run.json").read_text())
    assert report["time"] == f"key frames, {FRAMES} scans with poses"
    assert report["configuration"]["input"]["poses"] == str(tmp_path / "tum.txt")
    told = CliRunner().invoke(app, ["info", *named])
    assert f"time        key frames, {FRAMES} scans" in told.output
    low, high = WORLD[:, 0].min(), WORLD[:, 0].max()
    assert f"x           {low:.3f} to {high:.3f}" in told.output, "bounds are the map's"
    script = CliRunner().invoke(app, ["submit", *named, "-c", "slurm", "--dry-run", "-o", "out"])
    assert script.exit_code == 0, script.output
    assert str(tmp_path / "in" / "Scans") in script.output
    for name in ("run", "info", "submit"):
        assert CliRunner().invoke(app, [name]).exit_code == 2
        assert CliRunner().invoke(app, [name, "a.pcd", *named]).exit_code == 2


def test_a_job_is_told_the_poses(tmp_path, monkeypatch):
    sc_lio_sam(tmp_path / "in", "elsewhere.txt")
    monkeypatch.chdir(tmp_path)
    np.savetxt("poses.txt", POSES.reshape(FRAMES, 12))
    system = SimpleNamespace(
        name="slurm", script_suffix=".sh", require=lambda: None, submit_script=lambda path: "1"
    )
    monkeypatch.setattr("pipeline.cluster.submitting._system", lambda _: system)
    monkeypatch.setattr("pipeline.cluster.submitting._script", lambda *_: "#!/bin/bash\n")
    command = ["submit", "--scans", "in/Scans", "--poses", "poses.txt", "-c", "slurm", "-o", "out"]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, done.output
    (written,) = (tmp_path / "out").rglob("config.yaml")
    assert load_configuration(str(written)).input.poses == str(tmp_path / "poses.txt")


def test_some_of_the_scans_are_placed_by_their_numbers(tmp_path):
    folder = removert(tmp_path / "in")
    some = [folder / "Scans" / f"{number:06d}.pcd" for number in (7, 3)]
    collection = MapCollection(some)
    np.testing.assert_array_equal(collection.poses.poses, POSES[[7, 3]])
    one = MapCollection([hdl(tmp_path / "hdl") / "000004" / "cloud.pcd"])
    np.testing.assert_allclose(points_of(one), WORLD[4 * EACH : 5 * EACH], atol=1e-9)


def test_what_is_not_sure_is_refused_in_one_line(tmp_path):
    folder = hdl(tmp_path / "hdl")
    (folder / "000003" / "data").unlink()
    with pytest.raises(MapFormatError, match=r"000003/data: expected the data of a key frame"):
        MapCollection(find_map_files([folder]))
    (folder / "000003" / "data").write_text("stamp 1 2\nodom\n")
    with pytest.raises(MapFormatError, match=r"expected a line `estimate`"):
        MapCollection(find_map_files([folder]))
    folder = removert(tmp_path / "removert")
    (folder / "poses.txt").write_text(lines(POSES[:5]))
    with pytest.raises(MapFormatError, match=r"expected a pose for each of 24 scans, found 5"):
        MapCollection(find_map_files([folder]))
    (folder / "poses.txt").write_text(lines(POSES * 1.1))
    with pytest.raises(MapFormatError, match=r"expected a rotation and a place"):
        MapCollection(find_map_files([folder]))
    (folder / "poses.txt").write_text("1 2 3\n4 5 6\n")
    with pytest.raises(MapFormatError, match=r"expected 12 numbers a line"):
        MapCollection(find_map_files([folder]))
    (folder / "poses.txt").write_text("1 2 3\n4 5\n")
    with pytest.raises(MapFormatError, match=r"expected 12 numbers a line"):
        MapCollection(find_map_files([folder]))


@pytest.mark.parametrize(
    "names",
    [
        ("GlobalMap", "CornerMap", "SurfMap", "trajectory", "transformations"),
        ("static", "dynamic"),
    ],
)
def test_several_maps_of_one_place_are_not_merged(tmp_path, names):
    for name in names:
        write_pcd(tmp_path / "in" / f"{name}.pcd", CLOUDS[0], 0)
    with pytest.raises(NoMapError, match="several maps of one place"):
        find_map_files([tmp_path / "in"])
    assert len(find_map_files([tmp_path / "in" / f"{names[0]}.pcd"])) == 1


def test_a_folder_of_parts_with_one_viewpoint_stays_what_it_is(tmp_path):
    for number, cloud in enumerate(CLOUDS[:3]):
        write_pcd(tmp_path / f"cell_{number}.pcd", cloud, number)
    collection = MapCollection(find_map_files([tmp_path]))
    assert collection.poses is None
    np.testing.assert_array_equal(points_of(collection), np.concatenate(CLOUDS[:3]).astype("f8"))


@pytest.mark.parametrize(("moves_from", "known"), [(FRAMES // 2, True), (FRAMES, True), (0, False)])
def test_a_sensor_that_stands_still_has_a_pose_if_its_scans_tell_it(tmp_path, moves_from, known):
    folder = benchmark(tmp_path / "in")
    for number in range(FRAMES):
        path, pose = folder / "pcd" / f"{number:06d}.pcd", POSES[max(number, moves_from) % FRAMES]
        place = "0 0 0 1 0 0 0" if not known else " ".join(map(str, [*pose[:, 3], 1, 0, 0, 0]))
        cloud = WORLD[number * EACH : (number + 1) * EACH].astype("f4")
        write_pcd(path, cloud, number, place)
    files = find_map_files([folder])
    if not known:
        assert [path.name for path in files] == ["gt_cloud.pcd"]
        files = find_map_files([folder / "pcd"])
        assert MapCollection(files).poses is None
        return
    collection = MapCollection(files)
    expected = [POSES[max(number, moves_from) % FRAMES, :, 3] for number in range(FRAMES)]
    np.testing.assert_allclose(collection.poses.poses[:, :, 3], expected)
    np.testing.assert_allclose(points_of(collection), WORLD, atol=1e-4)


def test_other_files_in_like_places_stay_maps(tmp_path):
    write_pcd(tmp_path / "2024" / "cloud.pcd", CLOUDS[0], 0)
    write_pcd(tmp_path / "scans" / "map.pcd", CLOUDS[0], 0)
    (tmp_path / "poses.txt").write_text(lines(POSES))
    for name in ("2024/cloud.pcd", "scans/map.pcd"):
        assert MapCollection([tmp_path / name]).poses is None
    (tmp_path / "2024" / "weights.bin").write_bytes(b"of a network")
    assert len(find_map_files([tmp_path / "2024"])) == 1
    assert len(find_map_files([tmp_path / "2024" / "weights.bin"])) == 1


def test_scans_whose_poses_are_nowhere_are_refused(tmp_path):
    folder = kitti(tmp_path / "in")
    (tmp_path / "in" / "poses" / "07.txt").unlink()
    with pytest.raises(MapFormatError, match="velodyne: expected poses of the scans"):
        MapCollection(find_map_files([folder / "velodyne"]))


def test_a_preview_of_scans_keeps_their_places(tmp_path):
    folder = hdl(tmp_path / "in")
    wanted = ["execution.cluster=none", "ground.method=none", "neighbours.k=8"]
    configuration = load_configuration("auto", wanted)
    report = preview(
        [str(folder)], tmp_path / "out", configuration, StageObserver(LogDisplay()), points=1000,
        window=WHOLE,
    )  # fmt: skip
    found = read_result(tmp_path / "out").xyz
    assert 900 < report.points <= 1000
    distance, _ = cKDTree(WORLD).query(found)
    assert distance.max() < 1e-4


def test_scans_are_not_evaluated_in_their_own_frames(tmp_path):
    cleaned(hdl(tmp_path / "in"), tmp_path / "out")
    with pytest.raises(EvaluationError, match=r"run with output\.merge=true"):
        _read_run(tmp_path / "out")


def test_poses_that_change_are_noticed(tmp_path, monkeypatch):
    folder = removert(tmp_path / "in")

    def killing(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("pipeline.run.write_maps", killing)
        with pytest.raises(KeyboardInterrupt):
            cleaned(folder, tmp_path / "out", most=700)
    (folder / "poses.txt").write_text(lines(POSES + 0.5 * (np.arange(4) == 3)))
    job._opened.cache_clear()  # a worker is another process
    with pytest.raises(InputChangedError, match="its poses changed"):
        _ = job.Job.open(str(tmp_path / "out" / WORK_FOLDER)).collection
    report = cleaned(folder, tmp_path / "out", most=700)
    assert any("another map or configuration" in each for each in report.warnings)


@pytest.mark.parametrize("layout", [hdl, semantic_kitti, benchmark])
@pytest.mark.parametrize("most", [10**6, 700])
def test_scans_are_merged_into_one_file_in_the_frame_of_the_map(tmp_path, layout, most):
    folder = layout(tmp_path / "in")
    collection = MapCollection(find_map_files([folder]))
    apart = cleaned(folder, tmp_path / "apart", most=most)
    report = cleaned(folder, tmp_path / "out", "output.merge=true", most=most)
    assert report.counts == apart.counts
    suffix = collection.paths[0].suffix
    assert set(report.outputs) == {
        *(f"static{suffix}", f"dynamic{suffix}", "config.yaml", "labels.parquet", "run.json"),
    }
    found = MapCollection([tmp_path / "out" / f"static{suffix}"])
    assert found.readers[0].description.viewpoint in (None, (0, 0, 0, 1, 0, 0, 0))
    (batch,) = found.readers[0].batches()
    kept = np.isin(
        np.concatenate([records(c, n)["intensity"] for n, c in enumerate(CLOUDS)]),
        found.readers[0].values(batch.records, "intensity"),
    )
    assert kept.sum() == len(batch.xyz)
    np.testing.assert_allclose(batch.xyz, WORLD[kept], atol=2e-5)
    assert len(read_result(tmp_path / "out").xyz) == FRAMES * EACH
    assert "labels follow" in verify(tmp_path / "out")


@pytest.mark.parametrize("labels", ["true", "false"])
def test_a_merged_map_is_thinned_verified_and_decided_again(tmp_path, labels):
    folder = hdl(tmp_path / "in")
    wanted = ["output.merge=true", "output.voxel=0.5", f"output.labels={labels}"]
    report = cleaned(folder, tmp_path / "out", *wanted)
    assert verify(tmp_path / "out").startswith(f"{FRAMES * EACH:,} points = ")
    (thinned,) = MapCollection([tmp_path / "out/thinned.pcd"]).readers[0].batches()
    cells = np.floor(thinned.xyz / 0.5)
    assert 0 < len(np.unique(cells, axis=0)) == len(cells)
    if labels == "true":
        observer = StageObserver(LogDisplay())
        decide_again(tmp_path / "out", tmp_path / "again", [], [], [], observer)
        for name in ("static.pcd", "dynamic.pcd", "thinned.pcd"):
            assert (tmp_path / "again" / name).read_bytes() == (
                tmp_path / "out" / name
            ).read_bytes()
    assert f"thinned{report.files[0].static[len('static') :]}" in report.outputs


def test_a_merged_map_can_be_labelled(tmp_path):
    folder = hdl(tmp_path / "in")
    cleaned(folder, tmp_path / "out", "output.merge=true", "output.mode=label")
    found = read_result(tmp_path / "out")
    np.testing.assert_allclose(found.xyz, WORLD, atol=2e-5)
    assert found.density is not None


@pytest.mark.parametrize("named", [True, False])
@pytest.mark.parametrize("order", "CF")
def test_arrays_are_merged(tmp_path, named, order):
    for number, cloud in enumerate(CLOUDS):
        array = np.column_stack([cloud, np.full(len(cloud), number)]).astype(">f8", order=order)
        if named:
            array = array.copy().view([(name, ">f8") for name in ("z", "x", "y", "scan")])[:, 0]
        (tmp_path / "in").mkdir(exist_ok=True)
        np.save(tmp_path / "in" / f"{number}.npy", array)
    np.savetxt(tmp_path / "poses.txt", POSES.reshape(FRAMES, 12), "%.17g")
    given = [f"input.poses={tmp_path}/poses.txt", "output.merge=true"]
    expected = points_of(
        MapCollection(find_map_files([tmp_path / "in"]), 1, tmp_path / "poses.txt")
    )
    cleaned(tmp_path / "in", tmp_path / "out", *given, "removal.confidence=0.999")
    found = read_result(tmp_path / "out").xyz
    np.testing.assert_array_equal(np.sort(found, axis=0), np.sort(expected, axis=0))


def test_what_cannot_be_merged_is_refused_before_any_work(tmp_path):
    for name in ("a.npz", "b.npz"):
        np.savez(tmp_path / name, WORLD)
    with pytest.raises(MapFormatError, match="npy or KITTI's, to be merged"):
        cleaned(tmp_path, tmp_path / "out", "output.merge=true")
    folder = benchmark(tmp_path / "in")
    path = folder / "pcd" / "000005.pcd"
    path.write_bytes(path.read_bytes().replace(b" intensity", b" reflected"))
    with pytest.raises(MapFormatError, match=r"000005\.pcd: expected format and fields of"):
        cleaned(folder, tmp_path / "out", "output.merge=true")


@given(st.lists(st.floats(-1, 1), min_size=4, max_size=4), st.integers(1, 40))
@settings(deadline=None)
def test_points_are_turned_as_scipy_turns_them_however_many_come_at_a_time(wxyz, count):
    assume(np.linalg.norm(wxyz) > 1e-3)
    w, x, y, z = wxyz
    turn = Rotation.from_quat([x, y, z, w])
    (pose,) = _of_quaternions(np.array([[1.0, 2.0, 3.0]]), np.array([wxyz]))
    poses = ScanPoses(pose[None])
    points = np.random.default_rng(count).normal(size=(count, 3)) * 50
    moved = poses.to_map(0, points)
    np.testing.assert_allclose(moved, turn.apply(points) + [1, 2, 3], atol=1e-9)
    one_by_one = [poses.to_map(0, points[n : n + 1]) for n in range(count)]
    np.testing.assert_array_equal(moved, np.concatenate(one_by_one))


@pytest.mark.parametrize("suffix", [".laz", ".npz"])
def test_scans_that_are_decoded_once_are_moved_once(tmp_path, suffix):
    folder = tmp_path / "in"
    folder.mkdir()
    for number, cloud in enumerate(CLOUDS):
        if suffix == ".npz":
            np.savez(folder / f"{number}.npz", xyz=cloud)
            continue
        header = laspy.LasHeader(version="1.4", point_format=6)
        header.scales = [1e-4] * 3
        scan = laspy.LasData(header)
        scan.xyz = cloud.astype("f8")
        scan.write(folder / f"{number}.laz")
    np.savetxt(tmp_path / "poses.txt", POSES.reshape(FRAMES, 12), "%.17g")
    wanted = [f"input.poses={tmp_path}/poses.txt", "output.labels=true"]
    tables = []
    for most in (10**6, 700):
        cleaned(folder, tmp_path / f"out{most}", *wanted, most=most)
        tables.append((tmp_path / f"out{most}" / "labels.parquet").read_bytes())
        found = read_result(tmp_path / f"out{most}").xyz
        np.testing.assert_allclose(np.sort(found, axis=0), np.sort(WORLD, axis=0), atol=2e-4)
    assert tables[0] == tables[1]
