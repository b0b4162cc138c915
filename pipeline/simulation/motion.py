"""How the robot and the people move: poses at given times, and straight lines between them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

TURN_RATE = np.radians(90.0)
"""How fast the robot turns on the spot, in radians per second."""

CLEARANCE = 0.9
"""How far people keep from the robot, axis to axis, in metres."""


@dataclass(frozen=True, slots=True)
class Trajectory:
    """A way through the floor plan, straight between known times.

    Attributes
    ----------
    times : (m,) float64 array
        Ascending, in seconds.
    states : (m, d) float64 array
        State at each time: x and y in metres, and the heading in radians for the robot.
    """

    times: NDArray[np.float64]
    states: NDArray[np.float64]

    def at(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the state at each of n times, (n, d); before and after, the mover stands."""
        columns = [np.interp(times, self.times, column) for column in self.states.T]
        return np.stack(columns, axis=1)


def drive(route: NDArray[np.float64], speed: float, duration: float) -> Trajectory:
    """Drive along a closed route, again and again, turning on the spot at its corners.

    Parameters
    ----------
    route : (m, 2) float64 array
        Corners, in metres; the last leads back to the first.
    speed : float
        In metres per second.
    duration : float
        How long the trajectory must last, in seconds.

    Returns
    -------
    Trajectory
        Of x, y and heading.
    """
    legs = np.roll(route, -1, axis=0) - route
    lengths = np.hypot(legs[:, 0], legs[:, 1])
    headings = np.arctan2(legs[:, 1], legs[:, 0])
    time, heading, corner = 0.0, headings[0], 0
    times, states = [time], [(*route[0], heading)]
    while time <= duration:
        time += lengths[corner] / speed
        following = (corner + 1) % len(route)
        times.append(time)
        states.append((*route[following], heading))
        turn = (headings[following] - headings[corner] + np.pi) % (2 * np.pi) - np.pi
        time += abs(turn) / TURN_RATE
        heading += turn
        times.append(time)
        states.append((*route[following], heading))
        corner = following
    return Trajectory(np.array(times), np.array(states))


def keep_clear(people: NDArray[np.float64], robot: NDArray[np.float64]) -> NDArray[np.float64]:
    """Push people away from the robot, to `CLEARANCE` at least.

    Parameters
    ----------
    people : (n, p, 2) float64 array
        Where p people would be at n times, in metres.
    robot : (n, 2) float64 array
        Where the robot is, in metres.

    Returns
    -------
    (n, p, 2) float64 array
    """
    apart = people - robot[:, None, :]
    distance = np.maximum(np.hypot(apart[..., 0], apart[..., 1]), 1e-6)
    return robot[:, None, :] + apart * np.maximum(1.0, CLEARANCE / distance)[..., None]
