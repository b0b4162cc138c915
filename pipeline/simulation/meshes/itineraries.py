"""What people do: places they go to one after the other, and how that looks over time."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from pipeline.simulation.meshes.stage import Stage
from pipeline.simulation.meshes.walkways import Guide, Walkways
from pipeline.simulation.tables import Floats, Random

STEP = 0.1  # time between two samples of a track, in seconds

_UNREST = 3.0 / STEP  # steps over which one who stands forgets how he shifted


@dataclass(frozen=True, slots=True)
class Stop:
    """A place, (3,), near a node of the walkways, to be at for some seconds.

    One looks along the yaw, or as one came, and sits on a seat of some height, or stands.
    """

    node: int
    place: Floats
    wait: float
    yaw: float | None = None
    seat: float = 0.0


@dataclass(frozen=True, slots=True)
class Track:
    """A mover over time, every `STEP`."""

    place: Floats  # (t, 3)
    yaw: Floats  # unwrapped
    gone: Floats  # way gone so far, in metres
    pace: Floats  # in metres per second
    sitting: Floats  # 0 standing, 1 sitting
    seat: Floats  # its height, in metres


def follow(
    stops: Sequence[Stop],
    guide: Guide,
    speed: float,
    duration: float,
    random: Random,
    aside: float = 0.0,
    shift: float = 0.05,
) -> Track:
    """Go from stop to stop; stay at the last one.

    Parameters
    ----------
    guide : Guide
        Knows the ways to all of them.
    aside : float, optional
        How far beside the shortest way, in metres.
    shift : float, optional
        How far one who stands shifts about, in metres (deviation).
    """
    count = int(np.ceil(duration / STEP)) + 2
    parts: list[Floats] = []  # columns of place, yaw and seat

    def add(steps: Floats, yaw: float, seat: float) -> int:
        parts.append(np.column_stack([steps, np.full((len(steps), 2), [yaw, seat])]))
        return sum(map(len, parts))

    before, total = stops[0], 0
    for stop in stops:
        if stop is not before:
            way = guide.way(before.node, stop.node, aside)
            way = np.concatenate([before.place[None], way, stop.place[None]])
            along, pace = way_along(way), speed * random.uniform(0.85, 1.15)
            steps = np.linspace(0, along[-1], max(2, int(np.ceil(along[-1] / (pace * STEP)))))
            total = add(interpolated(steps, along, way), np.nan, 0.0)
        stays = max(1, int(stop.wait / STEP))
        if stop is stops[-1]:
            stays = max(stays, count - total)
        yaw = np.nan if stop.yaw is None else stop.yaw
        total = add(np.repeat(stop.place[None], stays, axis=0), yaw, stop.seat)
        before = stop
        if total >= count:
            break
    table = np.concatenate(parts)[:count]
    return _track(table[:, :3], table[:, 3], table[:, 4], random, shift)


def way_along(line: Floats) -> Floats:
    """Return how far each corner of a line, (n, 3), is from its beginning, in metres."""
    lengths = np.linalg.norm(np.diff(line, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(lengths)])


def interpolated(at: Floats, known: Floats, rows: Floats) -> Floats:
    """Return the rows of a table, (n, m), between those known at some numbers, (k,) and (k, m)."""
    return np.stack([np.interp(at, known, column) for column in rows.T], axis=1)


def along_lane(line: Floats, at: Floats, reach: float) -> tuple[Floats, Floats]:
    """Return places on a lane, (n, 3), and the headings of wheels there, unwrapped.

    The lane has corners, (m, 3); the places, (n,), are given by their way from its beginning. The
    axles are `reach` metres ahead and behind.
    """
    along = way_along(line)
    ahead = interpolated(at + reach, along, line[:, :2])
    ahead -= interpolated(at - reach, along, line[:, :2])
    return interpolated(at, along, line), np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))


def _track(place: Floats, wanted: Floats, seat: Floats, random: Random, shift: float) -> Track:
    """Add headings, gait and the unrest of those who stand."""
    count = len(place)
    place = gaussian_filter1d(place, 2.0, axis=0, mode="nearest")
    velocity = np.gradient(place, axis=0)[:, :2] / STEP
    pace = np.linalg.norm(velocity, axis=1)
    yaw = np.where(pace > 0.15, np.arctan2(velocity[:, 1], velocity[:, 0]), wanted)
    known = np.flatnonzero(np.isfinite(yaw))
    if len(known):  # as one came, until told otherwise
        last = np.maximum.accumulate(np.where(np.isfinite(yaw), np.arange(count), -1))
        yaw = yaw[np.where(last < 0, known[0], last)]
    else:
        yaw = np.full(count, random.uniform(-np.pi, np.pi))
    yaw = gaussian_filter1d(np.unwrap(yaw), 3.0, mode="nearest")
    standing = gaussian_filter1d((pace < 0.15).astype(np.float64), 4.0)
    sitting = gaussian_filter1d((seat > 0).astype(np.float64), 4.0)
    unrest = gaussian_filter1d(random.normal(size=(count, 3)), _UNREST, axis=0, mode="wrap")
    unrest *= np.sqrt(2 * np.sqrt(np.pi) * _UNREST)  # of deviation 1
    place[:, :2] += unrest[:, :2] * (shift * standing * (1 - sitting))[:, None]
    yaw = yaw + 6 * shift * unrest[:, 2] * standing * (1 - 0.8 * sitting)
    held = np.maximum.accumulate(np.where(seat > 0, np.arange(count), 0))
    seat = np.maximum(seat[held], 0.4)
    return Track(place, yaw, way_along(place), gaussian_filter1d(pace, 3.0), sitting, seat)


class Planner:
    """Draws what people do in a scene, for so many seconds."""

    def __init__(self, stage: Stage, walkways: Walkways, duration: float, random: Random) -> None:
        self._stage, self._walkways = stage, walkways
        self._duration, self._random = duration, random
        self._goals = walkways.draw(random, 24, room=0.5)
        self._seats = list(random.permutation(len(stage.seats)))

    def people(self, count: int, lingering: float) -> list[list[Stop]]:
        """Return the stops of people: some who linger, walkers, groups, sitters and a queue."""
        random = self._random
        weights = random.dirichlet([1.6, 1.0, 1.0, 0.6, 0.5])
        plans = [self._lingerer() for _ in range(random.binomial(count, lingering))]
        while len(plans) < count:
            kind = random.choice(5, p=weights)
            if kind == 1:
                plans += self._group(min(count - len(plans), int(random.integers(2, 7))))
            elif kind == 2 and self._seats:
                plans.append(self._sitter())
            elif kind == 3 and self._stage.queue is not None:
                plans += self._queue(min(count - len(plans), int(random.integers(2, 8))))
                weights = weights * [1, 1, 1, 0, 1]
                weights /= weights.sum()
            else:
                plans.append(self._walker(long_waits=kind == 4))
        return plans[:count]

    def errands(self, count: int) -> list[list[Stop]]:
        """Return the stops of things that drive where people go, or are put elsewhere once."""
        return [
            self._put_elsewhere() if self._random.random() < 0.4 else self._walker()
            for _ in range(count)
        ]

    def _at(self, node: int, wait: float, yaw: float | None = None) -> Stop:
        return Stop(int(node), self._walkways.nodes[node], wait, yaw)

    def _goal(self) -> int:
        return int(self._random.choice(self._goals))

    def _walker(self, long_waits: bool = False) -> list[Stop]:
        random = self._random
        left, stops = self._duration, []
        while left > 0:
            stands = random.random() < (0.8 if long_waits else 0.35)
            wait = random.exponential(40.0 if long_waits else 5.0) if stands else 0.0
            stops.append(self._at(self._goal(), wait))
            left -= wait + 4.0
        if random.random() < 0.5:
            stops[0] = self._at(stops[0].node, random.uniform(0, self._duration))
        return [*stops, self._at(self._goal(), 0.0)]

    def _lingerer(self) -> list[Stop]:
        """Stand at one place for most or all of the time."""
        random = self._random
        here = int(self._walkways.draw(random, 1)[0])
        wait = random.uniform(0.3, 0.97) * self._duration
        yaw = float(random.uniform(-np.pi, np.pi))
        if random.random() < 0.4:
            return [self._at(here, self._duration, yaw)]
        if random.random() < 0.5:
            return [self._at(self._goal(), self._duration - wait), self._at(here, wait, yaw)]
        return [self._at(here, wait, yaw), self._at(self._goal(), 0.0)]

    def _put_elsewhere(self) -> list[Stop]:
        """Stand at one place, and from some time on at another."""
        random = self._random
        here = int(self._walkways.draw(random, 1)[0])
        wait = random.uniform(0.1, 0.9) * self._duration
        yaw = float(random.uniform(-np.pi, np.pi))
        return [self._at(here, wait, yaw), self._at(self._goal(), 0.0)]

    def _group(self, count: int) -> list[list[Stop]]:
        """People who stand in a circle for a while, come one by one and leave about together."""
        random = self._random
        middle = int(self._walkways.draw(random, 1, room=1.0)[0])
        radius = 0.35 + 0.1 * count
        came = random.uniform(-0.5, 0.5) * self._duration
        lasts = random.uniform(0.15, 0.8) * self._duration
        plans = []
        for number in range(count):
            angle = 2 * np.pi * (number + random.uniform(-0.2, 0.2)) / count
            out = radius * np.array([np.cos(angle), np.sin(angle), 0])
            place = self._walkways.nodes[middle] + out
            wait = lasts + random.uniform(0, 4)
            arrives = came + random.uniform(0, 8)
            first = [self._at(self._goal(), arrives)] if arrives > 0 else []
            wait = wait if first else max(3.0, wait + came)
            here = Stop(middle, place, wait, angle + np.pi)
            plans.append([*first, here, *self._walker()])
        return plans

    def _sitter(self) -> list[Stop]:
        random = self._random
        seat = self._stage.seats[self._seats.pop()]
        place = np.array([seat.x, seat.y, seat.z])
        node = int(self._walkways.nearest(place)[0])
        here = Stop(node, place, random.uniform(0.15, 0.8) * self._duration, seat.yaw, seat.height)
        stops = [here, *self._walker()]
        if random.random() < 0.6:
            stops.insert(0, self._at(self._goal(), random.uniform(0, 0.5) * self._duration))
        return stops

    def _queue(self, count: int) -> list[list[Stop]]:
        """People in a line who move up each time that the first one leaves."""
        random = self._random
        slots = self._stage.queue
        if slots is None:
            return []
        nodes = self._walkways.nearest(slots)
        service = random.uniform(8, 40)
        plans = []
        for number in range(count):
            stops = []
            for slot in range(min(number, len(slots) - 1), -1, -1):
                ahead = slots[max(slot - 1, 0)] - slots[max(slot, 1)]
                yaw = float(np.arctan2(ahead[1], ahead[0]))
                place = slots[slot] + np.append(random.normal(scale=0.08, size=2), 0)
                stops.append(Stop(int(nodes[slot]), place, service * random.uniform(0.8, 1.2), yaw))
            plans.append([*stops, *self._walker()])
        return plans
