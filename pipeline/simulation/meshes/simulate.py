"""Scans of a scene of meshes, and the map that SLAM would make of them."""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from pipeline.simulation.meshes.movers import populate, seat_people
from pipeline.simulation.meshes.parameters import MeshParameters, SensorKind
from pipeline.simulation.meshes.poses import drive, longest, sensor_track
from pipeline.simulation.meshes.raycasting import Caster, Hits
from pipeline.simulation.meshes.scenes import SCENES
from pipeline.simulation.meshes.stage import Stage
from pipeline.simulation.meshes.walkways import Walkways
from pipeline.simulation.motion import to_map, to_sensor
from pipeline.simulation.parameters import nothing_seen
from pipeline.simulation.scans import SimulatedScan, ray_directions
from pipeline.simulation.tables import Floats, Points, Random

_RINGS = {  # of Velodyne's VLP-16, HDL-32E and HDL-64E (its lower half is coarser), and OS1-64
    SensorKind.VLP16: np.linspace(-15.0, 15.0, 16),
    SensorKind.RING32: np.linspace(-30.67, 10.67, 32),
    SensorKind.RING64: np.append(np.linspace(-24.33, -8.83, 32), np.linspace(-8.33, 2.0, 32)),
    SensorKind.OS64: np.linspace(-22.5, 22.5, 64),
}
_MID360_LOW, _MID360_HIGH = np.radians(-7.0), np.radians(52.0)
_MID360_TURNS = 61.803  # turns of the prism a second, and of its nodding: never in step
_MID360_NODS = 23.607


def sweep(
    kind: SensorKind, rays: int, number: int, rate: float, random: Random
) -> tuple[Floats, Floats]:
    """Return the rays of a scan, about so many.

    Returns
    -------
    directions : (n, 3) float64 array
        Unit vectors in the sensor's frame: x ahead, y left, z up.
    share : (n,) float64 array
        When each fires, as a share of the scan.
    """
    if kind is SensorKind.MID360:
        return _rosette(rays, number, rate, random)
    elevations = np.radians(_RINGS[kind])
    columns = max(4, round(rays / len(elevations)))
    share = np.repeat((np.arange(columns) + random.random()) / columns, len(elevations))
    return ray_directions(2 * np.pi * share, np.tile(elevations, columns)), share


def _rosette(rays: int, number: int, rate: float, random: Random) -> tuple[Floats, Floats]:
    """Return four lines of a turning, nodding beam, which go elsewhere in each scan."""
    share = (np.arange(rays // 4) + 0.5) / (rays // 4)
    time = np.repeat((number * 1.0371 + share) / rate, 4) + random.random() * 1e-3
    line = np.tile(np.arange(4), rays // 4)
    azimuth = 2 * np.pi * (_MID360_TURNS * time + line * 0.0171)
    nod = np.sin(2 * np.pi * (_MID360_NODS * time + line * 0.06))
    # An angle by arcsine: lines are as dense in the middle as at the edges.
    spread = 0.5 + np.arcsin(nod) / np.pi
    elevation = _MID360_LOW + (_MID360_HIGH - _MID360_LOW) * spread
    return ray_directions(azimuth, elevation), np.repeat(share, 4)


_EDGE = 0.15  # metres between two ranges that a ray on an edge would mix
_FULL_SIGNAL = 0.02  # of albedo x cosine at a quarter of the longest range: returns surely
_CLEAR = 0.2  # share of a mixed range that a mover needs for its truth to be told


class _Stream(IntEnum):
    """Streams of random numbers of their own, so that more people, say, change no noise."""

    SCENE = 0
    MOVERS = 1
    DRIVE = 2
    DRIFT = 3
    SENSOR = 4


@dataclass(frozen=True, slots=True)
class MeshMap:
    """A map, and the truth about it."""

    parameters: MeshParameters
    points: Points
    poses: Floats  # (s, 3, 4), from the sensor's frame to the map's, as estimated
    true_poses: Floats  # and truly


class Recording:
    """A scene, what moves in it, and the way of the sensor."""

    def __init__(self, parameters: MeshParameters) -> None:
        self.parameters = parameters
        self.stage = Stage(self._random(_Stream.SCENE))
        SCENES[parameters.kind](self.stage, parameters)
        seat_people(self.stage, parameters.seated)
        self.caster = Caster(self.stage)
        spacing = 0.35 if parameters.kind.indoors else 0.6
        walkways = Walkways.of(self.stage, self.caster, spacing)
        random, lasts = self._random(_Stream.MOVERS), longest(parameters)
        self.movers = populate(self.stage, walkways, parameters, lasts, random)
        track = sensor_track(self.stage, walkways, parameters, self._random(_Stream.DRIVE))
        self.drive = drive(track, parameters, self._random(_Stream.DRIFT))

    def _random(self, stream: _Stream, number: int = 0) -> Random:
        drive_number = 0 if stream is _Stream.SCENE else self.parameters.drive
        key = (int(stream), drive_number, number)
        return np.random.default_rng(np.random.SeedSequence(self.parameters.seed, spawn_key=key))

    def scan(self, number: int, *, movers: bool = True) -> Points:
        """Return the points of a scan in the map's frame, with what moves or without."""
        told, random = self.parameters, self._random(_Stream.SENSOR, number)
        start, true = float(self.drive.times[number]), self.drive.true[number]
        directions, share = sweep(told.sensor, told.rays, number, told.rate, random)
        origins = true[:, 3] + share[:, None] / told.rate * self.drive.velocity[number]
        aimed = directions @ true[:, :3].T
        hits, other = self._cast(number, (origins, aimed), movers, random)
        met = np.isfinite(hits.distance)
        distance = np.where(met, hits.distance, 0.0)
        # Not those that are lost at random, grazed, dark or far.
        near = np.minimum(1.0, (0.25 * told.max_range / np.maximum(distance, 0.1)) ** 2)
        signal = told.sensitivity * hits.albedo * hits.cosine * near
        chance = np.minimum(1.0, signal / _FULL_SIGNAL) * (1 - told.dropouts)
        met &= random.random(len(met)) < chance
        apart = np.where(np.isfinite(other.distance), other.distance - distance, 0.0)
        between = met & (np.abs(apart) > _EDGE)
        mix = np.where(between, random.random(len(met)), 0.0)
        ranges = distance + mix * apart + random.normal(size=len(met)) * told.range_noise
        seen = origins + ranges[:, None] * aimed
        flat = np.hypot(*(seen - true[:, 3])[:, :2].T)
        met &= (ranges > told.min_range) & (ranges < told.max_range) & (flat > told.own_body)
        moving, known = self._truth(hits, other, mix)
        noise = random.normal(size=len(met)) * 6
        kept = met & (random.random(len(met)) < told.keep)
        points = Points(
            xyz=to_map(self.drive.estimated[number], to_sensor(true, seen)),
            intensity=np.round(hits.albedo * 200 + noise).clip(0, 255).astype(np.float32),
            time=start + share / told.rate,
            surface=hits.surface,
            moving=moving,
            known=known,
            scan=np.full(len(met), number, dtype=np.int32),
        )
        return points.take(kept).filtered(told.scan_voxel)

    def _truth(
        self, hits: Hits, other: Hits, share: Floats
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Say which rays meet what changes its place, and for which that can be told.

        A range between two things is there because of both: it moved if either did, but where
        it nearly is that of the one that stands.
        """
        # `STATIC` is -1: the last of these.
        changes = np.append(self.movers.changes_place, False)
        vague = np.append(~self.movers.changes_place, False)
        between = share > 0
        first, second = changes[hits.owner], changes[other.owner] & between
        told_by = np.where(first, 1 - share, 0) + np.where(second, share, 0)
        unclear = (first | second) & (told_by < _CLEAR)
        unclear |= hits.mirrored | vague[hits.owner]
        unclear |= between & (other.mirrored | vague[other.owner])
        return first | second, ~unclear

    def _cast(
        self, number: int, rays: tuple[Floats, Floats], movers: bool, random: Random
    ) -> tuple[Hits, Hits]:
        """Return what each ray meets, and what its other half meets where it may be on an edge."""
        told, (origins, aimed) = self.parameters, rays
        start, true = float(self.drive.times[number]), self.drive.true[number]
        offset = (self.movers.places(start) - true[:, 3]) @ true[:, :3]
        # A turning sensor meets each mover when it looks there.
        azimuth = np.arctan2(offset[:, 1], offset[:, 0]) / (2 * np.pi) % 1
        reach = told.max_range if movers else 0.0
        target = self.movers.target(start + azimuth / told.rate, true[:, 3], reach)
        noisy = _unit(aimed + random.normal(size=aimed.shape) * np.radians(told.angle_noise))
        halves = np.flatnonzero(random.random(len(aimed)) < told.mixed)
        spread = random.normal(size=(len(halves), 3)) * np.radians(told.beam)
        begin = np.concatenate([origins, origins[halves]])
        way = np.concatenate([noisy, _unit(noisy[halves] + spread)])
        hits = self.caster.cast(begin, way, target, random)
        own = np.arange(len(aimed))
        other = own.copy()
        other[halves] = len(aimed) + np.arange(len(halves))
        return hits.take(own), hits.take(other)


def _unit(vectors: Floats) -> Floats:
    unit: Floats = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    return unit


def mesh_scans(parameters: MeshParameters, *, static: bool = True) -> Iterator[SimulatedScan]:
    """Yield the scans of the map one by one, before the map's own voxel filter.

    With `static`, all rays are cast once more for what stands alone; otherwise that is left empty.
    """
    recording = Recording(parameters)
    for number, start in enumerate(recording.drive.times):
        points = recording.scan(number)
        alone = recording.scan(number, movers=False) if static else points.take(np.array([], int))
        yield SimulatedScan(
            number=number,
            start=float(start),
            returns=points,
            static_returns=alone,
            true_pose=recording.drive.true_in_map[number],
            estimated_pose=recording.drive.estimated[number],
        )


def simulate_meshes(parameters: MeshParameters) -> MeshMap:
    """Record a scene and make the map.

    The same parameters give the same map, on one machine.

    Raises
    ------
    MissingPackageError
        When Open3D is not installed.
    ConfigurationError
        When the sensor sees nothing.
    """
    recording = Recording(parameters)
    parts = [recording.scan(number) for number in range(len(recording.drive.times))]
    points = Points.joined(parts).filtered(parameters.voxel)
    if not len(points):
        raise nothing_seen(parameters.min_range, parameters.max_range)
    return MeshMap(parameters, points, recording.drive.estimated, recording.drive.true_in_map)
