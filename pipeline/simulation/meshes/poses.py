"""Where the sensor truly is, and where a SLAM system would believe it to be."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from pipeline.simulation.meshes.itineraries import (
    STEP,
    Stop,
    Track,
    along_lane,
    follow,
    interpolated,
    way_along,
)
from pipeline.simulation.meshes.parameters import DriveMode, MeshParameters
from pipeline.simulation.meshes.stage import Lane, Stage
from pipeline.simulation.meshes.walkways import Walkways
from pipeline.simulation.tables import Floats, Random

_FORGOTTEN = 25.0  # scans over which the error of the pose is forgotten


@dataclass(frozen=True, slots=True)
class Drive:
    """The sensor's way: s scans."""

    times: Floats  # when each scan begins, in seconds
    true: Floats  # (s, 3, 4), from the sensor's frame to the scene's
    true_in_map: Floats  # (s, 3, 4), from the sensor's frame to the map's
    estimated: Floats  # (s, 3, 4), the same as SLAM has it
    velocity: Floats  # (s, 3), in the scene's frame


def longest(parameters: MeshParameters) -> float:
    """Return how long the recording lasts at most, in seconds."""
    between = parameters.interval
    if parameters.key_distance and parameters.mode is not DriveMode.STAND:
        between = max(between, 1.6 * parameters.key_distance / parameters.speed)
    return parameters.scans * between + 2


def sensor_track(
    stage: Stage, walkways: Walkways, parameters: MeshParameters, random: Random
) -> Track:
    """Draw the way of the sensor's foot."""
    duration = longest(parameters)
    goals = walkways.draw(random, 10, room=0.6)
    if parameters.mode is DriveMode.STAND:
        here = int(goals[0])
        stops = [Stop(here, walkways.nodes[here], duration, float(random.uniform(-3, 3)))]
        return follow(stops, walkways.guide(goals[:1]), 1.0, duration, random, shift=0.0)
    if stage.robot_lane is not None:
        return _along(stage.robot_lane, parameters, duration, random)
    stops, going = [], 0.0
    while going < duration:
        wait = 0.0
        if parameters.mode is DriveMode.STOP_AND_GO:
            wait = float(random.exponential(12.0)) if random.random() < 0.7 else 0.0
        goal = int(random.choice(goals))
        stops.append(Stop(goal, walkways.nodes[goal], wait))
        going += wait + 2.0
    return follow(stops, walkways.guide(goals), parameters.speed, duration, random, shift=0.0)


def _along(lane: Lane, parameters: MeshParameters, duration: float, random: Random) -> Track:
    """Drive along a lane, once, as far as time goes."""
    count = int(np.ceil(duration / STEP)) + 2
    length = way_along(lane.line)[-1]
    pace = np.full(count, parameters.speed)
    if parameters.mode is DriveMode.STOP_AND_GO:
        for _ in range(1 + random.poisson(duration / 40)):
            begin = int(random.integers(count))
            pace[begin : begin + int(random.uniform(5, 30) / STEP)] = 0.0
    pace = gaussian_filter1d(pace, 8.0)
    gone = np.cumsum(pace) * STEP
    spare = max(0.0, length - gone[-1])
    at = np.minimum(gone + random.uniform(0, spare), length - 0.01)
    place, yaw = along_lane(lane.line, at, 1.0)
    zero = np.zeros(count)
    return Track(place, gaussian_filter1d(yaw, 5.0), gone, pace, zero, zero)


def drive(track: Track, parameters: MeshParameters, random: Random) -> Drive:
    """Choose the times of the scans, and say where the sensor is and is believed to be."""
    samples = (np.arange(len(track.yaw)) * STEP).astype(np.float64)
    times = _scan_times(track, samples, parameters)
    place = interpolated(times, samples, track.place)
    later = interpolated(times + 0.1, samples, track.place)
    yaw = np.interp(times, samples, track.yaw)
    count = len(times)
    tilt = np.radians(parameters.wobble) * random.normal(size=(count, 3)) * [1, 1, 0.3]
    tilt[:, 1] += np.radians(parameters.pitch)
    up = np.array([0, 0, parameters.sensor_height])
    swing = 0.02 * (parameters.wobble > 0) * random.normal(size=(count, 3))
    turn = Rotation.from_euler("zyx", np.column_stack([yaw, tilt[:, 1], tilt[:, 0]])).as_matrix()
    true = np.concatenate([turn, (place + up + swing)[:, :, None]], axis=2)
    believed = _estimated(true, parameters, random)
    return Drive(times, true, _in_map(true, true[0]), believed, (later - place) / 0.1)


def _in_map(poses: Floats, first: Floats) -> Floats:
    """Take poses to the map's frame: level, with the first scan at its origin, as SLAM has it."""
    level = Rotation.from_euler("z", -np.arctan2(first[1, 0], first[0, 0])).as_matrix()
    place = (poses[:, :, 3] - first[:, 3]) @ level.T
    return np.concatenate([level @ poses[:, :, :3], place[:, :, None]], axis=2)


def _scan_times(track: Track, samples: Floats, parameters: MeshParameters) -> Floats:
    """Return when scans enter the map: every so often, or only after so much way."""
    times = np.arange(parameters.scans) * parameters.interval
    if parameters.key_distance and parameters.mode is not DriveMode.STAND:
        turned = np.abs(np.gradient(track.yaw)).cumsum()
        way = track.gone + turned * parameters.key_distance / 0.8  # a turn counts as way, too
        marks = way[0] + np.arange(parameters.scans) * parameters.key_distance
        reached = marks <= way[-1]  # one at least, of a sensor that stands all the time
        times = samples[np.searchsorted(way, marks[reached])]
        times = times[np.append(True, np.diff(times) > 0)]
    in_time: Floats = times[times < samples[-1] - 1.0]
    return in_time


def _estimated(true: Floats, parameters: MeshParameters, random: Random) -> Floats:
    """Return poses with an error that wanders, jitters, and leaves a gap at a loop closure."""
    count = len(true)
    angle = np.radians(parameters.drift_angle) * np.array([0.3, 0.3, 1.0])
    wander = _ornstein_uhlenbeck(random, count)
    shift = wander[:, :3] * parameters.drift_position * [1, 1, 0.7]
    turn = wander[:, 3:] * angle
    shift += random.normal(size=(count, 3)) * parameters.jitter_position
    turn += random.normal(size=(count, 3)) * np.radians(parameters.jitter_angle) * [0.5, 0.5, 1]
    way = random.normal(size=3) * [1, 1, 0.4]
    gap = parameters.loop_gap * way / np.linalg.norm(way)
    begin = random.uniform(0.35, 0.75) * count
    share = np.clip((np.arange(count) - begin) / max(2.0, 0.03 * count), 0, 1)[:, None]
    shift += share * gap
    turn[:, 2] += share[:, 0] * float(random.normal(scale=0.02)) * parameters.loop_gap
    error = Rotation.from_rotvec(turn).as_matrix()
    place = true[:, :, 3] + shift
    believed = np.concatenate([error @ true[:, :, :3], place[:, :, None]], axis=2)
    return _in_map(believed, true[0])


def _ornstein_uhlenbeck(random: Random, count: int) -> Floats:
    """Return six wandering errors of deviation 1, smooth from scan to scan."""
    kept = np.exp(-1 / _FORGOTTEN)
    steps = random.normal(size=(count, 6)) * np.sqrt(1 - kept**2)
    error = np.zeros((count, 6))
    for scan in range(1, count):
        error[scan] = kept * error[scan - 1] + steps[scan]
    return gaussian_filter1d(error, 2.0, axis=0, mode="nearest")
