"""How the robot, people and machines move, and where a robot is believed to be.

Movers have poses at given times, and straight lines between them.
A pose is x, y and z in metres, the heading in radians, and the slope: the rise over the distance
ahead.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from pipeline.simulation.parameters import SimulationParameters
from pipeline.simulation.tables import Floats, Random

TURN_RATE = np.radians(90.0)  # how fast the robot turns on the spot, in radians per second
TILT_RATE = 0.2  # how fast it takes on the slope of a ramp, in rise over distance per second
CLEARANCE = 0.9  # how far people keep from the robot, axis to axis, in metres
DRIFT_SECONDS = 10.0  # time over which the error of the estimated pose is forgotten

_STOREY = 2.0  # metres; nobody makes way for what is farther above or below


@dataclass(frozen=True, slots=True)
class Trajectory:
    """A way through the scene, straight between known times."""

    times: Floats  # (m,), ascending, in seconds
    poses: Floats  # (m, 5): x, y, z, heading and slope

    def at(self, times: Floats) -> Floats:
        """Return the pose at each of n times, (n, 5); before and after, the mover stands."""
        after = np.searchsorted(self.times, times, side="right").clip(1, len(self.times) - 1)
        begin, end = self.times[after - 1], self.times[after]
        lasting = np.maximum(end - begin, 1e-12)
        share = ((times - begin) / lasting).clip(0.0, 1.0)[:, None]
        poses: Floats = self.poses[after - 1] * (1 - share) + self.poses[after] * share
        return poses


def drive(route: Floats, speed: float, duration: float, ahead: float = 0.0) -> Trajectory:
    """Drive along a closed route, again and again, turning on the spot at its corners.

    Parameters
    ----------
    route : (m, 3) float64 array
        Corners, in metres; the last leads back to the first.
    speed : float
        Along the ground plan, in metres per second.
    duration : float
        How long the trajectory must last, in seconds.
    ahead : float, optional
        Share of a lap that is done at time 0.
    """
    legs = np.roll(route, -1, axis=0) - route
    lengths = np.hypot(legs[:, 0], legs[:, 1])
    headings = np.arctan2(legs[:, 1], legs[:, 0])
    slopes = legs[:, 2] / lengths
    turns = (np.roll(headings, -1) - headings + np.pi) % (2 * np.pi) - np.pi
    tilts = np.roll(slopes, -1) - slopes
    pauses = np.maximum(np.abs(turns) / TURN_RATE, np.abs(tilts) / TILT_RATE)
    done = ahead * float((lengths / speed + pauses).sum())
    time, heading, corner = 0.0, headings[0], 0
    times, poses = [time], [(*route[0], heading, slopes[0])]
    while time <= duration + done:
        following = (corner + 1) % len(route)
        time += lengths[corner] / speed
        times.append(time)
        poses.append((*route[following], heading, slopes[corner]))
        time += pauses[corner]
        heading += turns[corner]
        times.append(time)
        poses.append((*route[following], heading, slopes[following]))
        corner = following
    return Trajectory(np.array(times) - done, np.array(poses))


def keep_clear(places: Floats, other: Floats, clearance: float = CLEARANCE) -> Floats:
    """Push people away from something on wheels, to `clearance` at least.

    Parameters
    ----------
    places : (n, p, 3 or more) float64 array
        x, y, z of p people at n times, in metres; what follows them is left as it is.
    other : (n, 3 or more) float64 array
        Where the other is at these times.
    clearance : float, optional
        In metres, axis to axis.
    """
    apart = places[..., :3] - other[:, None, :3]
    distance = np.maximum(np.hypot(apart[..., 0], apart[..., 1]), 1e-6)
    distance[np.abs(apart[..., 2]) > _STOREY] = np.inf
    moved = places.copy()
    moved[..., :2] += apart[..., :2] * np.maximum(0.0, clearance / distance - 1)[..., None]
    return moved


def rotations(heading: Floats, slope: Floats) -> Floats:
    """Return the (n, 3, 3) rotations from the sensor's frame to the map's.

    The sensor turns by its heading about z, after it was pitched up by the slope ahead.
    """
    cosine, sine = np.cos(heading), np.sin(heading)
    level = 1 / np.sqrt(1 + slope**2)
    rise = slope * level
    zero = np.zeros_like(cosine)
    rows = [
        [cosine * level, -sine, -cosine * rise],
        [sine * level, cosine, -sine * rise],
        [rise, zero, level],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def pose_matrix(position: Floats, heading: float, slope: float) -> Floats:
    """Return the (3, 4) transform from the sensor's frame to the map's."""
    (rotation,) = rotations(np.array([heading]), np.array([slope]))
    return np.column_stack([rotation, position])


def to_map(pose: Floats, points: Floats) -> Floats:
    """Take (n, 3) points from the sensor's frame to the map's."""
    return points @ pose[:, :3].T + pose[:, 3]


def to_sensor(pose: Floats, points: Floats) -> Floats:
    """Take (n, 3) points from the map's frame to the sensor's."""
    return (points - pose[:, 3]) @ pose[:, :3]


def drift(parameters: SimulationParameters, random: Random) -> Iterator[Floats]:
    """Yield the error of the estimated pose, scan after scan: x, y and z in metres, heading.

    An Ornstein-Uhlenbeck process from 0: the error wanders, and loop closures hold it near 0, so
    that a wall seen several times becomes thicker and not two walls.
    """
    deviation = np.array([parameters.drift_position] * 3 + [np.radians(parameters.drift_heading)])
    kept = float(np.exp(-parameters.scan_interval / DRIFT_SECONDS))
    error = np.zeros(4)
    while True:
        yield error
        error = kept * error + random.normal(size=4) * deviation * np.sqrt(1 - kept**2)
