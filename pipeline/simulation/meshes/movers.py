"""Everything that changes its place while the map is recorded, as triangles at any time."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pipeline.simulation.meshes.itineraries import (
    STEP,
    Planner,
    Track,
    along_lane,
    follow,
    way_along,
)
from pipeline.simulation.meshes.mesh import Mesh, boxes
from pipeline.simulation.meshes.parameters import MeshParameters
from pipeline.simulation.meshes.people import Bodies, Postures, draw_bodies, people_mesh
from pipeline.simulation.meshes.raycasting import Target
from pipeline.simulation.meshes.stage import Body, Lane, Stage
from pipeline.simulation.meshes.vehicles import VEHICLES
from pipeline.simulation.meshes.walkways import Walkways
from pipeline.simulation.scene import Surface
from pipeline.simulation.tables import Floats, Random

STANDS = 0.35  # who never gets farther than this from where he began has no honest truth, in metres

_AWAY = np.array([0.0, 0.0, -1000.0])
_PUSHED = 0.75


@dataclass(frozen=True, slots=True)
class Rigid:
    """Something rigid that moves: its mesh, and where it is every `STEP`."""

    mesh: Mesh
    place: Floats
    yaw: Floats
    surface: Surface

    @property
    def radius(self) -> float:
        """How far it reaches from its middle, and a little more, in metres."""
        return float(np.hypot(*self.mesh.vertices[:, :2].T).max()) * 0.8 + 0.2


@dataclass(frozen=True, slots=True)
class Movers:
    """p people and r rigid things; numbers of movers count people first."""

    bodies: Bodies
    tracks: tuple[Track, ...]  # of the people
    rigid: tuple[Rigid, ...]
    albedo: NDArray[np.float32]
    changes_place: NDArray[np.bool_]  # whether each ever leaves the place where it began

    @property
    def surfaces(self) -> NDArray[np.uint8]:
        """The `Surface` of each mover."""
        rest = [thing.surface for thing in self.rigid]
        return np.array([Surface.PERSON] * len(self.tracks) + rest, dtype=np.uint8)

    def places(self, time: float) -> Floats:
        """Return where each mover is: (p + r, 3)."""
        tables = [track.place for track in self.tracks] + [thing.place for thing in self.rigid]
        rows = [_between(table, time) for table in tables]
        return np.array(rows).reshape(-1, 3)

    def target(self, times: Floats, sensor: Floats, reach: float) -> Target:
        """Return what rays can meet, each mover when the rays get to it: (p + r,) times.

        People make way for the sensor, (3,), and what is more than `reach` metres from it is left
        out.
        """
        people, whose = self._people(times, sensor, reach)
        parts, owners = [people], [whose]
        for number, thing in enumerate(self.rigid):
            time = float(times[len(self.tracks) + number])
            place = _between(thing.place, time)
            away = float(np.hypot(*(place - sensor)[:2]))
            # Nothing drives over the sensor: what would is not there for that scan.
            if thing.radius < away < reach and place[2] > _AWAY[2] / 2:
                yaw = float(np.interp(time / STEP, np.arange(len(thing.yaw)), thing.yaw))
                parts.append(thing.mesh.placed(place[0], place[1], place[2], yaw))
                owners.append(np.full(len(thing.mesh.triangles), len(self.tracks) + number))
        owner = np.concatenate(owners)
        return Target(Body(Mesh.joined(parts), self.surfaces[owner], self.albedo[owner]), owner)

    def _people(
        self, times: Floats, sensor: Floats, reach: float
    ) -> tuple[Mesh, NDArray[np.int64]]:
        at = zip(self.tracks, times.tolist(), strict=False)
        rows = np.array([_posture(track, time) for track, time in at]).reshape(-1, 8)
        away = rows[:, :2] - sensor[:2]
        distance = np.maximum(np.hypot(away[:, 0], away[:, 1]), 1e-3)
        near = np.abs(rows[:, 2] + 1 - sensor[2]) < 2.5
        push = np.where(near, np.maximum(0.0, _PUSHED - distance), 0.0)
        rows[:, :2] += away / distance[:, None] * push[:, None]
        seen = np.flatnonzero((distance < reach) & (rows[:, 2] > _AWAY[2] / 2))
        bodies, place = self.bodies.take(seen), rows[seen, :3]
        yaw, gone, pace, sitting, seat = rows[seen, 3:].T
        phase = 2 * np.pi * gone / (0.83 * bodies.height)
        stride = np.clip(pace / (0.76 * bodies.height), 0, 1.3)
        postures = Postures(place, yaw, phase, stride, sitting, seat, 0.06 * sitting)
        mesh, owner = people_mesh(bodies, postures)
        return mesh, seen[owner]


def _between(table: Floats, time: float) -> Floats:
    """Return a row of a table between its samples; none between where a thing jumps."""
    at = min(max(time / STEP, 0.0), len(table) - 1.001)
    low = int(at)
    begin: Floats = table[low]
    step = table[low + 1] - begin
    return begin if np.abs(step).max() > 20 else begin + step * (at - low)


def _posture(track: Track, time: float) -> tuple[float, ...]:
    """Return place, yaw, way gone, pace, sitting and seat of a person."""
    at = min(max(time / STEP, 0.0), len(track.yaw) - 1.001)
    low = int(at)
    begin, end = (np.array([*track.place[n], track.yaw[n], track.gone[n]]) for n in (low, low + 1))
    held = (track.pace[low], track.sitting[low], track.seat[low])
    return (*(begin + (end - begin) * (at - low)), *held)


def populate(
    stage: Stage, walkways: Walkways, parameters: MeshParameters, duration: float, random: Random
) -> Movers:
    """Draw who and what moves."""
    planner = Planner(stage, walkways, duration, random)
    plans = planner.people(parameters.people, parameters.lingering)
    count = parameters.vehicles
    driven = [lane for lane in stage.lanes if lane.kinds]
    pushed = random.integers(0, count + 1) if driven else count
    errands = planner.errands(int(pushed))
    nodes = [stop.node for plan in (*plans, *errands) for stop in plan]
    guide = walkways.guide(np.array(nodes or [0]))
    tracks = []
    for plan in plans:
        speed = float(np.clip(random.normal(1.15, 0.25), 0.4, 1.9))
        aside = float(random.normal(scale=0.5))
        track = follow(plan, guide, speed, duration, random, aside)
        visits = parameters.visiting > 0 and random.random() < parameters.visiting
        tracks.append(_visit(track, random) if visits else track)
    rigid = []
    for plan in errands:
        track = follow(plan, guide, float(random.uniform(0.4, 1.6)), duration, random, shift=0.0)
        kind = str(random.choice(["robot", "robot", "dog", "chair", "crate"]))
        rigid.append(Rigid(VEHICLES[kind](random), track.place, track.yaw, Surface.MACHINE))
    for _ in range(count - len(errands)):
        rigid.append(_driver(driven[int(random.integers(len(driven)))], duration, random))
    rigid += _doors(stage, duration, random, parameters.vehicles)
    total = len(tracks) + len(rigid)
    away = [np.linalg.norm(track.place - track.place[0], axis=1).max() for track in tracks]
    changes = [farthest > STANDS for farthest in away] + [True] * len(rigid)
    return Movers(
        bodies=draw_bodies(random, len(tracks), float(random.uniform(0.1, 0.7))),
        tracks=tuple(tracks),
        rigid=tuple(rigid),
        albedo=random.uniform(0.06, 0.8, total).astype(np.float32),
        changes_place=np.array(changes, dtype=np.bool_),
    )


def _visit(track: Track, random: Random) -> Track:
    """Return who is there for 4 to 25 seconds only, and comes walking if he ever walks."""
    walks = np.flatnonzero(track.pace > 0.3)
    begin = random.choice(walks) if len(walks) else random.integers(len(track.pace))
    there = slice(begin, begin + int(random.uniform(4, 25) / STEP))
    place = np.broadcast_to(_AWAY, track.place.shape).copy()
    place[there] = track.place[there]
    return replace(track, place=place)


def seat_people(stage: Stage, count: int) -> None:
    """Put people who sit all the time into the scene that stands; their seats are taken."""
    random = stage.random
    order = random.permutation(len(stage.seats))
    seats = [stage.seats[number] for number in order[:count]]
    stage.seats = [stage.seats[number] for number in order[count:]]
    if not seats:
        return
    bodies = draw_bodies(random, len(seats), 0.0)
    rows = np.array([[seat.x, seat.y, seat.z, seat.yaw, seat.height] for seat in seats])
    zero, lean = np.zeros(len(seats)), random.uniform(-0.1, 0.3, len(seats))
    postures = Postures(rows[:, :3], rows[:, 3], zero, zero, zero + 1, rows[:, 4], lean)
    stage.mesh(people_mesh(bodies, postures)[0], Surface.PERSON)


def _driver(lane: Lane, duration: float, random: Random) -> Rigid:
    """Drive along a lane again and again, with stops, or pull out once after a long stand."""
    kind = str(random.choice(lane.kinds))
    count = int(np.ceil(duration / STEP)) + 2
    length = way_along(lane.line)[-1]
    speed = random.uniform(*lane.speed) * (0.5 if kind in ("bicycle", "bus") else 1.0)
    pace = np.full(count, speed)
    for _ in range(random.poisson(duration / 60)):
        begin = int(random.integers(count))
        pace[begin : begin + int(random.uniform(3, 40) / STEP)] = 0.0
    gone = np.cumsum(np.convolve(pace, np.ones(15) / 15, mode="same")) * STEP
    if random.random() < 0.25:  # stands, then leaves for good
        leaves = int(random.uniform(0.2, 0.9) * count)
        gone = np.maximum(0.0, gone - gone[leaves])
    lap = length + (0.0 if lane.closed else random.uniform(10, 60))
    at = (gone + random.uniform(0, length)) % lap
    place, yaw = along_lane(lane.line, at, 0.5)
    place[at > length] = _AWAY
    mesh = VEHICLES[kind](random)
    if kind == "bicycle":
        body, zero = draw_bodies(random, 1, 0.2), np.zeros(1)
        stride, lean = zero + random.uniform(0.2, 0.8), zero + random.uniform(0.2, 0.6)
        saddle = np.array([[-0.2, 0.0, 0.0]])
        rider = Postures(saddle, zero, zero, stride, zero + 0.55, zero + 0.88, lean)
        mesh = Mesh.joined([mesh, people_mesh(body, rider)[0]])
    surface = Surface.MACHINE if kind in ("forklift", "robot") else Surface.VEHICLE
    return Rigid(mesh, place, yaw, surface)


def _doors(stage: Stage, duration: float, random: Random, most: int) -> list[Rigid]:
    """Open and close some doors."""
    count = min(len(stage.doors), int(random.integers(0, most + 1)))
    rigid = []
    for number in random.permutation(len(stage.doors))[:count]:
        door = stage.doors[number]
        samples = int(np.ceil(duration / STEP)) + 2
        opened = np.zeros(samples)
        for _ in range(1 + random.poisson(duration / 60)):
            begin = int(random.integers(samples))
            opened[begin : begin + int(random.uniform(2, 60) / STEP)] = random.uniform(0.8, 1.7)
        opened = np.convolve(opened, np.ones(12) / 12, mode="same")
        leaf = boxes([door.width / 2, 0, door.height / 2, door.width, 0.045, door.height])
        place = np.repeat([[door.x, door.y, door.z]], samples, axis=0)
        rigid.append(Rigid(leaf, place, door.yaw + opened, Surface.FURNITURE))
    return rigid
