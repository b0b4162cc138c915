"""The whole map: one block of scene, or as many side by side as the wanted points need.

A block has a seed of its own, and so its own plan, people, noise and drift; the robot drives
through one after the other. Blocks do not see each other: a ray that leaves one meets nothing.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import ConfigurationError
from pipeline.simulation.parameters import POINTS_OF_A_BLOCK, RINGS, SimulationParameters
from pipeline.simulation.points import Floats, Points
from pipeline.simulation.scene import Scene
from pipeline.simulation.simulate import Drive, SimulatedScan, Stream

_TRIAL_SCANS, _TRIAL_COLUMNS = 24, 24
_MOST_COLUMNS = 3600
_SPARE = 1.02  # more rays than needed, so that the points are reached before the drive ends
_LONGEST = 10.0  # times the planned drive, after which a sensor that sees nothing is given up


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
