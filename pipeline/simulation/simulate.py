"""The simulation: scans taken along the drive, gathered into one map."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.simulation.indoor import indoor_floor_plan
from pipeline.simulation.motion import drive
from pipeline.simulation.parameters import SimulationParameters
from pipeline.simulation.people import populate
from pipeline.simulation.poses import drift, pose_matrix, to_map, to_sensor, turned
from pipeline.simulation.scene import MOVING_SURFACES, first_hits
from pipeline.simulation.sensor import intensities, measured_ranges, rotation


@dataclass(frozen=True, slots=True)
class SimulatedScan:
    """One scan of n returns, free of motion distortion, as after perfect deskewing.

    Attributes
    ----------
    xyz : (n, 3) float64 array
        In the map's frame, placed by the estimated pose, in metres.
    intensity : (n,) float32 array
        Calibrated reflectivity, 0 to 255.
    time : (n,) float64 array
        Since the drive began, in seconds.
    surface : (n,) uint8 array
        `Surface` each point lies on.
    true_pose, estimated_pose : (3, 4) float64 array
        From the sensor's frame to the map's, at the beginning of the scan.
    """

    xyz: NDArray[np.float64]
    intensity: NDArray[np.float32]
    time: NDArray[np.float64]
    surface: NDArray[np.uint8]
    true_pose: NDArray[np.float64]
    estimated_pose: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SimulatedMap:
    """A map of n points from s scans, and the truth about it.

    Attributes
    ----------
    parameters : SimulationParameters
        What made it.
    xyz : (n, 3) float32 array
        In metres; the floor is at z = 0.
    intensity : (n,) float32 array
        Calibrated reflectivity, 0 to 255.
    time : (n,) float64 array
        Since the drive began, in seconds.
    scan : (n,) uint32 array
        The scan that saw the point.
    moving : (n,) uint8 array
        1 where the point lies on something that moves: a ghost.
    surface : (n,) uint8 array
        `Surface` the point lies on.
    true_poses, estimated_poses : (s, 3, 4) float64 array
        From the sensor's frame to the map's, at the beginning of each scan.
    """

    parameters: SimulationParameters
    xyz: NDArray[np.float32]
    intensity: NDArray[np.float32]
    time: NDArray[np.float64]
    scan: NDArray[np.uint32]
    moving: NDArray[np.uint8]
    surface: NDArray[np.uint8]
    true_poses: NDArray[np.float64]
    estimated_poses: NDArray[np.float64]


def simulate(parameters: SimulationParameters) -> SimulatedMap:
    """Drive through the building and gather every scan into one map.

    Parameters
    ----------
    parameters : SimulationParameters

    Returns
    -------
    SimulatedMap
        The same, bit for bit, for the same parameters.
    """
    scans = list(simulate_scans(parameters))
    surface = np.concatenate([scan.surface for scan in scans])
    return SimulatedMap(
        parameters=parameters,
        xyz=np.concatenate([scan.xyz for scan in scans]).astype(np.float32),
        intensity=np.concatenate([scan.intensity for scan in scans]),
        time=np.concatenate([scan.time for scan in scans]),
        scan=np.repeat(
            np.arange(len(scans), dtype=np.uint32), [len(scan.surface) for scan in scans]
        ),
        moving=np.isin(surface, MOVING_SURFACES).astype(np.uint8),
        surface=surface,
        true_poses=np.stack([scan.true_pose for scan in scans]),
        estimated_poses=np.stack([scan.estimated_pose for scan in scans]),
    )


def simulate_scans(parameters: SimulationParameters) -> Iterator[SimulatedScan]:
    """Yield the scans of the drive one by one, each as it enters the map.

    Every ray is cast from where the robot is at the moment it fires, at people where they are at
    that moment. The error of the pose displaces a scan as a whole.
    """
    # Streams of their own, so that more people, say, change neither the noise nor the drift.
    seeds = np.random.SeedSequence(parameters.seed).spawn(3)
    people_random, drift_random, sensor_random = map(np.random.default_rng, seeds)
    plan = indoor_floor_plan(parameters.glass)
    robot = drive(plan.robot_route, parameters.robot_speed, parameters.duration)
    people = populate(
        plan, parameters.walkers, parameters.queuers, parameters.duration, people_random
    )
    for number, error in enumerate(drift(parameters, drift_random)):
        turn = rotation(parameters, sensor_random)
        time = number * parameters.scan_interval + turn.delay
        states = robot.at(time)
        position, heading = _sensor_pose(states, parameters.sensor_height)
        directions = turned(turn.directions, heading)
        hits = first_hits(plan.boxes, position, directions)
        for cylinders in (plan.cylinders, people.at(time, states[:, :2])):
            hits = hits.nearer(first_hits(cylinders, position, directions))

        ranges = measured_ranges(hits.distance, parameters, sensor_random)
        returned = np.isfinite(ranges)
        seen = (position + ranges[:, None] * directions)[returned]
        start = robot.at(np.array([number * parameters.scan_interval]))
        (origin,), (facing,) = _sensor_pose(start, parameters.sensor_height)
        true_pose = pose_matrix(origin, facing)
        estimated_pose = pose_matrix(origin + error[:3], facing + error[3])
        yield SimulatedScan(
            xyz=to_map(estimated_pose, to_sensor(true_pose, seen)),
            intensity=intensities(hits.surface[returned], sensor_random),
            time=time[returned],
            surface=hits.surface[returned],
            true_pose=true_pose,
            estimated_pose=estimated_pose,
        )


def _sensor_pose(
    states: NDArray[np.float64], height: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the positions (n, 3) and headings (n,) of the sensor on the robot."""
    above_floor = np.full(len(states), height)
    return np.column_stack([states[:, :2], above_floor]), states[:, 2]
