"""Scenes of triangle meshes: the same again, true at every point, seen by every sensor."""

import sys

import numpy as np
import pytest
import yaml

from pipeline.errors import ConfigurationError, MissingPackageError
from pipeline.simulation import SimulationParameters, load_simulation, write_simulation
from pipeline.simulation.meshes import (
    DriveMode,
    MeshParameters,
    MeshSceneKind,
    SensorKind,
    random_parameters,
    simulate_meshes,
)
from pipeline.simulation.meshes.mesh import boxes, tubes
from pipeline.simulation.meshes.people import Postures, draw_bodies, people_mesh
from pipeline.simulation.meshes.raycasting import Caster, Target, open3d
from pipeline.simulation.meshes.simulate import Recording, sweep
from pipeline.simulation.meshes.stage import Body, Matter, Stage
from pipeline.simulation.scene import Surface
from pipeline.simulation.tables import Points

try:
    open3d()
    MISSING = ""
except MissingPackageError as error:
    MISSING = str(error)
with_open3d = pytest.mark.skipif(bool(MISSING), reason=MISSING or "Open3D is there")

SMALL = MeshParameters(kind="room", scans=6, rays=1500, interval=1.0, people=4, vehicles=1, seed=3)


@with_open3d
@pytest.mark.parametrize("kind", MeshSceneKind)
def test_each_scene_is_seen_by_each_sensor(kind):
    for number, sensor in enumerate(SensorKind):
        made = simulate_meshes(
            SMALL.model_copy(update={"kind": kind, "sensor": sensor, "scans": 3, "seed": number})
        )
        assert len(made.points) > 300, sensor
        assert np.isfinite(made.points.xyz).all()
        assert made.points.known.mean() > 0.5
        assert made.poses.shape == made.true_poses.shape == (3, 3, 4)
        assert set(made.points.scan) == {0, 1, 2}


@with_open3d
def test_the_same_parameters_give_the_same_map_and_another_seed_another():
    first, second = simulate_meshes(SMALL), simulate_meshes(SMALL)
    for name in ("xyz", "moving", "known", "scan", "time"):
        np.testing.assert_array_equal(getattr(first.points, name), getattr(second.points, name))
    other = simulate_meshes(SMALL.model_copy(update={"seed": 4}))
    assert len(other.points) != len(first.points) or (other.points.xyz != first.points.xyz).any()


@with_open3d
def test_a_scene_of_boxes_and_one_of_meshes_replace_each_other(tmp_path):
    of_boxes = SimulationParameters(scans=2, rotations_per_scan=5)
    for parameters in (SMALL, SMALL, of_boxes, SMALL):
        files = write_simulation(parameters, tmp_path, map_only=True)
        written = yaml.safe_load(files.parameters.read_bytes())
        assert written == parameters.model_dump(mode="json")


EXACT = {
    "range_noise": 0.0, "angle_noise": 0.0, "mixed": 0.0, "mirrors": 0.0,
    "drift_position": 0.0, "drift_angle": 0.0, "jitter_position": 0.0, "jitter_angle": 0.0,
    "lingering": 0.0, "seated": 0,
}  # fmt: skip


@with_open3d
def test_what_moved_lies_on_movers_and_the_rest_on_what_stands():
    parameters = SMALL.model_copy(update={**EXACT, "people": 8, "mode": DriveMode.STAND})
    recording = Recording(parameters)
    seen = 0
    for number, time in enumerate(recording.drive.times):
        points = recording.scan(number)
        true = recording.drive.true[number]
        inside = (
            points.xyz - recording.drive.true_in_map[number][:, 3]
        ) @ recording.drive.true_in_map[number][:, :3]
        places = inside @ true[:, :3].T + true[:, 3]
        ghosts = points.moving
        seen += ghosts.sum()
        nearest = np.min(
            [
                recording.movers.target(
                    np.full(len(recording.movers.albedo), time + share / parameters.rate),
                    true[:, 3],
                    100.0,
                ).clearance(places[ghosts])
                for share in np.linspace(0, 1, 11)
            ],
            axis=0,
        )
        assert nearest.max(initial=0) < 0.05
        assert recording.caster.clearance(places[~ghosts]).max() < 1e-3
    assert seen > 100


@with_open3d
def test_people_are_in_the_frame_as_high_as_people_are():
    parameters = SMALL.model_copy(
        update={**EXACT, "people": 8, "mode": DriveMode.STAND, "sensor": "os64"}
    )
    made = simulate_meshes(parameters)
    people = made.points.take(made.points.moving & (made.points.surface == Surface.PERSON))
    height = people.xyz[:, 2] + parameters.sensor_height
    assert len(people) > 200
    assert -0.06 < height.min() < 0.4
    assert 1.3 < height.max() < 2.1


@with_open3d
def test_nothing_moves_where_nobody_is():
    made = simulate_meshes(SMALL.model_copy(update={"people": 0, "vehicles": 0}))
    assert not made.points.moving.any()


@with_open3d
def test_who_stays_in_place_all_the_time_has_no_honest_truth():
    parameters = SMALL.model_copy(
        update={"people": 6, "lingering": 1.0, "vehicles": 0, "seated": 0}
    )
    recording = Recording(parameters)
    stays = ~recording.movers.changes_place
    assert stays.any()
    points = Points.joined([recording.scan(number) for number in range(6)])
    assert (~points.known).sum() > 20
    assert not points.moving[~points.known & (points.surface != Surface.PERSON)].any()


@with_open3d
def test_what_stands_is_seen_alike_without_movers():
    recording = Recording(SMALL.model_copy(update={"mirrors": 0.0, "mixed": 0.0}))
    for number in range(3):
        points, alone = recording.scan(number), recording.scan(number, movers=False)
        assert not alone.moving.any()
        rows = {tuple(row) for row in alone.xyz}
        still = points.xyz[~points.moving & (points.surface != Surface.PERSON)]
        assert all(tuple(row) in rows for row in still)


@with_open3d
def test_drift_thickens_walls_and_a_loop_closure_doubles_them():
    update = {**EXACT, "people": 0, "vehicles": 0, "scans": 40, "mode": DriveMode.STAND}
    exact = SMALL.model_copy(update=update)

    def error(**change):
        made = simulate_meshes(exact.model_copy(update=change))
        return np.linalg.norm((made.poses - made.true_poses)[:, :, 3], axis=1)

    assert error().max() == 0
    assert 0.002 < error(drift_position=0.02).mean() < 0.1
    gap = error(loop_gap=0.1)
    assert gap[0] == 0
    assert gap[-1] == pytest.approx(0.1)


@with_open3d
def test_mixed_pixels_lie_between_two_things():
    clean = SMALL.model_copy(update={**EXACT, "people": 0, "vehicles": 0, "mode": DriveMode.STAND})
    mixed = clean.model_copy(update={"mixed": 1.0, "beam": 0.3})
    away = [Recording(each) for each in (clean, mixed)]
    off = []
    for recording in away:
        points = recording.scan(0)
        true, placed = recording.drive.true[0], recording.drive.true_in_map[0]
        inside = (points.xyz - placed[:, 3]) @ placed[:, :3]
        off.append(recording.caster.clearance(inside @ true[:, :3].T + true[:, 3]) > 0.03)
    assert not off[0].any()
    assert 0.001 < off[1].mean() < 0.3


@with_open3d
def test_glass_lets_most_rays_pass_and_a_mirror_turns_them():
    stage = Stage(np.random.default_rng(0))
    stage.block([5, -9, -9], [5.1, 9, 9], Surface.WALL, 0.5)
    stage.block([-7.1, -9, -9], [-7, 9, 9], Surface.WALL, 0.5)
    stage.block([2, -9, -9], [2.01, 0, 9], Surface.WALL, 0.5, Matter.GLASS)
    stage.block([2, 0, -9], [2.01, 9, 9], Surface.WALL, 0.5, Matter.MIRROR)
    caster = Caster(stage)
    nothing = Target(Body(boxes([]), np.empty(0, np.uint8), np.empty(0, np.float32)))
    random = np.random.default_rng(1)
    directions = np.tile([0.8, -0.6, 0.0], (2000, 1))
    hits = caster.cast(np.zeros((2000, 3)), directions, nothing, random)
    assert 0.7 < (np.abs(hits.distance - 5 / 0.8) < 1e-3).mean() < 0.99
    assert not hits.mirrored.any()
    directions[:, 1] = 0.6
    hits = caster.cast(np.zeros((2000, 3)), directions, nothing, random)
    assert hits.mirrored.all()
    np.testing.assert_allclose(hits.distance, (2 + 9) / 0.8, atol=1e-3)


@pytest.mark.parametrize("kind", SensorKind)
def test_rays_of_a_sensor_keep_to_its_angles(kind):
    random = np.random.default_rng(0)
    directions, _ = sweep(kind, 8000, 0, 10.0, random)
    assert len(directions) == pytest.approx(8000, abs=64)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1)
    elevation = np.degrees(np.arcsin(directions[:, 2]))
    low, high = {
        "vlp16": (-15, 15),
        "ring32": (-30.67, 10.67),
        "ring64": (-24.33, 2),
        "os64": (-22.5, 22.5),
        "mid360": (-7, 52),
    }[kind]
    assert elevation.min() == pytest.approx(low, abs=0.5)
    assert elevation.max() == pytest.approx(high, abs=0.5)
    rings = len(np.unique(elevation.round(6)))
    assert rings == {"vlp16": 16, "ring32": 32, "ring64": 64, "os64": 64}.get(kind, rings)


def test_the_rosette_does_not_repeat():
    random = np.random.default_rng(0)
    first, second = (sweep(SensorKind.MID360, 4000, n, 10.0, random)[0] for n in (0, 1))
    nearest = np.min(np.linalg.norm(first[:200, None] - second[None], axis=2), axis=1)
    assert np.median(nearest) > 1e-3


def test_a_person_walks_with_feet_on_the_ground_and_sits_on_a_seat():
    bodies = draw_bodies(np.random.default_rng(0), 6, 0.0)
    zero = np.zeros(6)
    phase = np.linspace(0, 5, 6)

    def extent(sitting, stride):
        postures = Postures(
            np.zeros((6, 3)), zero, phase, zero + stride, zero + sitting, zero + 0.45, zero
        )
        mesh, owner = people_mesh(bodies, postures)
        z = mesh.vertices[:, 2]
        whose = np.repeat(owner.reshape(6, -1)[:, 0], len(z) // 6)
        return np.array([[z[whose == n].min(), z[whose == n].max()] for n in range(6)])

    standing, walking, sitting = extent(0, 0), extent(0, 1), extent(1, 0)
    for each in (standing, walking):
        assert (np.abs(each[:, 0]) < 0.08).all()
        np.testing.assert_allclose(each[:, 1], bodies.height, rtol=0.06)
    assert (sitting[:, 1] < standing[:, 1] - 0.08).all()


def test_boxes_and_tubes_are_closed():
    for mesh in (boxes([[0, 0, 0, 1, 2, 3]]), tubes([[[0, 0, 0], [0, 0, 1]]], 0.1)):
        edges = np.sort(
            np.concatenate(
                [mesh.triangles[:, [0, 1]], mesh.triangles[:, [1, 2]], mesh.triangles[:, [2, 0]]]
            ),
            axis=1,
        )
        assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()


def test_the_voxel_filter_keeps_centroids_and_the_majority():
    xyz = np.array([[0.01, 0.01, 0.01], [0.03, 0.03, 0.03], [0.02, 0.02, 0.02], [0.22, 0, 0]])
    points = Points(
        xyz, np.zeros(4, np.float32), np.zeros(4), np.zeros(4, np.uint8),
        np.array([True, True, False, False]), np.ones(4, bool), np.arange(4, dtype=np.int32),
    )  # fmt: skip
    kept = points.filtered(0.1)
    np.testing.assert_allclose(kept.xyz, [[0.02, 0.02, 0.02], [0.22, 0, 0]])
    assert kept.moving.tolist() == [True, False]


def test_random_parameters_are_drawn_widely_and_again_the_same():
    drawn = [random_parameters(seed) for seed in range(150)]
    assert drawn[7] == random_parameters(7)
    assert {each.kind for each in drawn} == set(MeshSceneKind)
    assert {each.sensor for each in drawn} == set(SensorKind)
    assert {each.mode for each in drawn} == set(DriveMode)
    assert any(each.people == 0 and each.vehicles == 0 for each in drawn)
    assert any(each.people > 60 for each in drawn)
    assert any(each.voxel for each in drawn) and any(each.loop_gap for each in drawn)
    standing = [each.jitter_position for each in drawn if each.mode is DriveMode.STAND]
    assert min(standing) == 0 < max(standing)  # on a tripod, or not
    assert random_parameters(7, kind=MeshSceneKind.PARK).kind is MeshSceneKind.PARK


def test_settings_choose_between_boxes_and_meshes():
    assert isinstance(load_simulation(["scene=street"]), SimulationParameters)
    assert isinstance(load_simulation(["scene=street", "sensor=mid360"]), MeshParameters)
    with pytest.raises(ConfigurationError, match=r"of indoor, .*street, .*warehouse, found 'moon'"):
        load_simulation(["scene=moon"])
    assert load_simulation(["scene=garage"]).kind is MeshSceneKind.GARAGE
    with pytest.raises(ConfigurationError, match="vlp16"):
        load_simulation(["scene=office", "sensor=vlp17"])


def test_without_open3d_one_line_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(MissingPackageError, match="pip install") as caught:
        simulate_meshes(SMALL)
    assert "\n" not in str(caught.value)
