"""Scans taken along drives through one block of scene, or as many as the wanted points need.

A block has a seed of its own, and so its own plan, people, noise and drift; the robot drives
through one after the other. Blocks do not see each other: a ray that leaves one meets nothing.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import IntEnum
from itertools import count, islice

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import ConfigurationError
from pipeline.simulation.indoor import indoor_scene
from pipeline.simulation.motion import drift, drive, pose_matrix, rotations, to_map, to_sensor
from pipeline.simulation.movers import populate
from pipeline.simulation.parameters import POINTS_OF_A_BLOCK, RINGS, SimulationParameters
from pipeline.simulation.raycasting import Hits, first_hits, first_moving_hits
from pipeline.simulation.scene import Scene, SceneKind
from pipeline.simulation.street import street_scene
from pipeline.simulation.tables import Floats, Points, Random
from pipeline.simulation.two_levels import ramp_scene, storeys_scene

RING_ELEVATIONS = np.radians(np.linspace(-15.0, 15.0, RINGS))
"""Angle of each ring above the horizon, in radians: those of a Velodyne VLP-16 (User Manual
63-9243), whose lasers fire together at each azimuth of a rotation."""

# Of floor, wall, ceiling, furniture, person, machine, vehicle and vegetation.
_REFLECTIVITY = np.array([25.0, 60.0, 75.0, 40.0, 30.0, 50.0, 55.0, 45.0])
_REFLECTIVITY_SPREAD = 8.0

_TRIAL_SCANS, _TRIAL_COLUMNS = 24, 24
_MOST_COLUMNS = 3600
_SPARE = 1.02  # more rays than needed, so that the points are reached before the drive ends
_LONGEST = 10.0  # times the planned drive, after which a sensor that sees nothing is given up


def ray_directions(azimuth: Floats, elevation: Floats) -> Floats:
    """Return unit vectors, (n, 3): x forward, y left, z up. Angles are in radians."""
    level = np.cos(elevation)
    return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], axis=1)


def rotation(columns: int, random: Random) -> tuple[Floats, Floats]:
    """Turn the sensor once; the azimuth of the first firing is random, as its motor is free.

    Returns
    -------
    share : (c,) float64 array
        When each firing of all rings is, as a share of the turn.
    directions : (16 c, 3) float64 array
        Unit vectors in the sensor's frame, in the order of firing.
    """
    share = (np.arange(columns) + random.random()) / columns
    azimuth = np.repeat(2 * np.pi * share, RINGS)
    return share, ray_directions(azimuth, np.tile(RING_ELEVATIONS, columns))


def measured_ranges(distance: Floats, noise: Floats, parameters: SimulationParameters) -> Floats:
    """Return true distances as the sensor reports them, NaN where it reports none; in metres.

    The noise is standard normal; what a ray never meets is infinitely far.
    """
    ranges = distance + noise * parameters.range_noise
    if parameters.range_resolution:
        ranges = np.round(ranges / parameters.range_resolution) * parameters.range_resolution
    within = (distance >= parameters.min_range) & (distance <= parameters.max_range)
    return np.where(within, ranges, np.nan)


def intensities(surface: NDArray[np.uint8], noise: Floats) -> NDArray[np.float32]:
    """Return the calibrated reflectivity of each return, a whole number from 0 to 255."""
    spread = noise * _REFLECTIVITY_SPREAD
    return np.clip(np.round(_REFLECTIVITY[surface] + spread), 0, 255).astype(np.float32)


class Stream(IntEnum):
    """Streams of random numbers of their own, so that more people, say, change no noise."""

    SCENE = 0
    MOVERS = 1
    DRIFT = 2
    SENSOR = 3
    TRIAL = 4


@dataclass(frozen=True, slots=True)
class SimulatedScan:
    """One scan, free of motion distortion, as after perfect deskewing.

    Without what moves, the same noise and drift would have given `static_returns` at the same time.
    """

    number: int  # in the order of the map, from 0
    start: float  # when the rotation began, in seconds
    returns: Points
    static_returns: Points
    true_pose: Floats  # (3, 4), from the sensor's frame to the map's, at the beginning of the scan
    estimated_pose: Floats

    def in_sensor_frame(self) -> Floats:
        """Return the points as the sensor saw them, (n, 3)."""
        return to_sensor(self.estimated_pose, self.returns.xyz)

    def first(self, count: int) -> "SimulatedScan":
        """Return the scan as if it had ended after so many points."""
        returns = self.returns.take(slice(count))
        seen = np.searchsorted(self.static_returns.time, returns.time[-1], side="right")
        static_returns = self.static_returns.take(slice(int(seen)))
        return replace(self, returns=returns, static_returns=static_returns)

    def moved(self, number: int, seconds: float, metres: Floats) -> "SimulatedScan":
        """Return the scan as one of a later number, later by `seconds`, elsewhere by `metres`."""

        def shifted(points: Points) -> Points:
            return replace(
                points,
                xyz=points.xyz + metres,
                time=points.time + seconds,
                scan=points.scan + np.int32(number),
            )

        offset = np.column_stack([np.zeros((3, 3)), metres])
        return replace(
            self,
            number=self.number + number,
            start=self.start + seconds,
            returns=shifted(self.returns),
            static_returns=shifted(self.static_returns),
            true_pose=self.true_pose + offset,
            estimated_pose=self.estimated_pose + offset,
        )


def build_scene(parameters: SimulationParameters, block: int = 0) -> Scene:
    """Build one block of the scene: the same for every drive."""
    build = {
        SceneKind.INDOOR: indoor_scene,
        SceneKind.STOREYS: storeys_scene,
        SceneKind.RAMP: ramp_scene,
        SceneKind.STREET: street_scene,
    }[parameters.scene]
    return build(random_stream(parameters, block, Stream.SCENE), parameters.glass)


def random_stream(parameters: SimulationParameters, block: int, stream: Stream) -> Random:
    """Return the random numbers of one purpose, in one block, for one drive."""
    drive_number = 0 if stream is Stream.SCENE else parameters.drive
    key = (block, drive_number, int(stream))
    return np.random.default_rng(np.random.SeedSequence(parameters.seed, spawn_key=key))


class Drive:
    """A drive through one block of the scene: whoever is there, and the robot's way.

    All keep moving for `duration` seconds; what comes after finds everybody standing.
    """

    def __init__(
        self, parameters: SimulationParameters, block: int = 0, duration: float | None = None
    ) -> None:
        if duration is None:
            duration = parameters.scans * parameters.scan_interval
        self.parameters = parameters
        self.block = block
        self.scene = build_scene(parameters, block)
        self.robot = drive(self.scene.robot_route, parameters.robot_speed, duration)
        random = random_stream(parameters, block, Stream.MOVERS)
        moving = parameters.walkers, parameters.queuers, parameters.machines
        self.movers = populate(self.scene, *moving, duration, random)

    def scans(
        self, columns: int, *, every: int = 1, stream: Stream = Stream.SENSOR
    ) -> Iterator[SimulatedScan]:
        """Yield the scans of the drive one by one, without end.

        Every ray is cast from where the robot is at the moment it fires, at people where they are
        at that moment. The error of the pose displaces a scan as a whole.

        Parameters
        ----------
        columns : int
            Firings of each ring in a rotation.
        every : int, optional
            Scans of the map from one that is yielded to the next.
        stream : Stream, optional
            The random numbers of the sensor.
        """
        random = random_stream(self.parameters, self.block, stream)
        errors = drift(self.parameters, random_stream(self.parameters, self.block, Stream.DRIFT))
        for number, error in zip(count(step=every), errors, strict=False):
            yield self._scan(number, columns, error, random)

    def _scan(self, number: int, columns: int, error: Floats, random: Random) -> SimulatedScan:
        """Turn the sensor once."""
        parameters = self.parameters
        share, directions = rotation(columns, random)
        firings = np.repeat(np.arange(columns), RINGS)
        range_noise, intensity_noise = random.standard_normal((2, len(firings)))
        start = number * parameters.scan_interval
        times = start + share / parameters.rotation_rate
        robot = self.robot.at(np.append(times, start))
        up = np.array([0.0, 0.0, parameters.sensor_height])
        robot_turns = rotations(robot[:, 3], robot[:, 4])
        eyes = robot[:, :3] + robot_turns @ up
        origins = eyes[firings]
        directions = np.einsum("nij,nj->ni", robot_turns[firings], directions)
        still = first_hits(self.scene.shapes, origins, directions)
        movers, frames = self.movers, self.movers.at(times, robot[:-1])
        moving = first_moving_hits(
            movers.shapes, movers.starts, movers.reach, frames, firings, origins, directions
        )
        true_pose = pose_matrix(eyes[-1], robot[-1, 3], robot[-1, 4])
        estimated_pose = pose_matrix(eyes[-1] + error[:3], robot[-1, 3] + error[3], robot[-1, 4])

        def returns(hits: Hits, ghost: NDArray[np.bool_]) -> Points:
            ranges = measured_ranges(hits.distance, range_noise, parameters)
            returned = np.isfinite(ranges)
            seen = origins[returned] + ranges[returned, None] * directions[returned]
            return Points(
                xyz=to_map(estimated_pose, to_sensor(true_pose, seen)),
                intensity=intensities(hits.surface[returned], intensity_noise[returned]),
                time=times[firings[returned]],
                surface=hits.surface[returned],
                moving=ghost[returned],
                known=np.ones(len(seen), np.bool_),
                scan=np.full(len(seen), number, np.int32),
            )

        ghosts = moving.distance < still.distance
        return SimulatedScan(
            number=number,
            start=start,
            returns=returns(still.replaced(moving, ghosts), ghosts),
            static_returns=returns(still, np.zeros_like(ghosts)),
            true_pose=true_pose,
            estimated_pose=estimated_pose,
        )


@dataclass(frozen=True, slots=True)
class SimulatedMap:
    """A map of n points from s scans, and the truth about it."""

    parameters: SimulationParameters  # what made it
    xyz: NDArray[np.float32]  # (n, 3), in metres; the floor of the lowest storey is at z = 0
    intensity: NDArray[np.float32]  # (n,) like all that follow, as in `Points`
    time: Floats  # in seconds since the drive began
    scan: NDArray[np.uint32]
    moving: NDArray[np.uint8]
    surface: NDArray[np.uint8]
    true_poses: Floats  # (s, 3, 4), from the sensor's frame to the map's, when each scan begins
    estimated_poses: Floats


def simulate(parameters: SimulationParameters) -> SimulatedMap:
    """Drive through the scene and gather every scan into one map, in memory.

    The same parameters give the same map, bit for bit.
    """
    scans = list(simulate_scans(parameters))
    points = Points.joined([scan.returns for scan in scans])
    return SimulatedMap(
        parameters=parameters,
        xyz=points.xyz.astype(np.float32),
        intensity=points.intensity,
        time=points.time,
        scan=points.scan.astype(np.uint32),
        moving=points.moving.astype(np.uint8),
        surface=points.surface,
        true_poses=np.stack([scan.true_pose for scan in scans]),
        estimated_poses=np.stack([scan.estimated_pose for scan in scans]),
    )


def simulate_scans(parameters: SimulationParameters) -> Iterator[SimulatedScan]:
    """Yield the scans of the map one by one, each as it enters the map.

    Blocks give nearly the same number of points, a million at most. What is held in memory is one
    scan and one block of scene, whatever that number.

    Raises
    ------
    ConfigurationError
        When `points` are wanted and the sensor sees nothing.
    """
    if parameters.points is None:
        yield from islice(Drive(parameters).scans(parameters.columns), parameters.scans)
        return
    number, seconds = 0, 0.0
    blocks = -(-parameters.points // POINTS_OF_A_BLOCK)
    for block in range(blocks):
        points = parameters.points // blocks + (block < parameters.points % blocks)
        drive = Drive(parameters, block, 2 * parameters.scans * parameters.scan_interval)
        place = block_place(block, blocks, drive.scene)
        done = 0
        for scan in _scans_of_block(drive, points):
            done = scan.number + 1
            yield scan.moved(number, seconds, place)
        number += done
        seconds += done * parameters.scan_interval


def block_place(block: int, blocks: int, scene: Scene) -> Floats:
    """Return where a block lies: in rows that go back and forth, in a square about as a whole."""
    length, width = (side + scene.gap for side in scene.size)
    in_a_row = max(1, round(np.sqrt(blocks * width / length)))
    row, column = divmod(block, in_a_row)
    column = in_a_row - 1 - column if row % 2 else column
    return np.array([column * length, row * width, 0.0])


def _scans_of_block(drive: Drive, points: int) -> Iterator[SimulatedScan]:
    """Yield scans of one block until they have so many points, the last one cut short."""
    columns = _columns(drive, points)
    scans_needed = -(-points // (columns * RINGS))
    most_scans = int(_LONGEST * max(drive.parameters.scans, scans_needed))
    missing = points
    for scan in islice(drive.scans(columns), most_scans):
        if len(scan.returns) >= missing:
            yield scan.first(missing)
            return
        missing -= len(scan.returns)
        yield scan
    raise _too_few(points, points - missing, most_scans)


def _columns(drive: Drive, points: int) -> int:
    """Return the firings in a rotation that give so many points in about the planned scans."""
    scans = drive.parameters.scans
    trial = drive.scans(_TRIAL_COLUMNS, every=max(1, scans // _TRIAL_SCANS), stream=Stream.TRIAL)
    seen = sum(len(scan.returns) for scan in islice(trial, _TRIAL_SCANS))
    if not seen:
        raise _too_few(points, 0, _TRIAL_SCANS)
    of_a_column = seen / (_TRIAL_SCANS * _TRIAL_COLUMNS)
    return int(min(np.ceil(_SPARE * points / (scans * of_a_column)), _MOST_COLUMNS))


def _too_few(wanted: int, found: int, scans: int) -> ConfigurationError:
    return ConfigurationError(
        f"points: expected {wanted} from a block, found {found} in {scans} scans: the limits of "
        "the range leave too few"
    )
