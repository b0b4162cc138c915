"""Scans of a scene of meshes, and the map that SLAM would make of them."""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import ConfigurationError
from pipeline.simulation.meshes.itineraries import Track
from pipeline.simulation.meshes.movers import Movers, populate
from pipeline.simulation.meshes.parameters import MeshParameters
from pipeline.simulation.meshes.poses import Drive, drive, longest, sensor_track
from pipeline.simulation.meshes.raycasting import STATIC, Caster, Hits
from pipeline.simulation.meshes.scenes import build_stage
from pipeline.simulation.meshes.sensors import Sweep, sweep
from pipeline.simulation.meshes.voxels import voxel_filter
from pipeline.simulation.meshes.walkways import Walkways
from pipeline.simulation.poses import to_map, to_sensor

_EDGE = 0.15  # metres between two ranges that a ray on an edge would mix
_FULL_SIGNAL = 0.02  # of albedo x cosine at a quarter of the longest range: returns surely


class _Stream(IntEnum):
    SCENE = 0
    MOVERS = 1
    DRIVE = 2
    DRIFT = 3
    SENSOR = 4
    MAP = 5


@dataclass(frozen=True, slots=True)
class Points:
    """n points.

    Attributes
    ----------
    xyz : (n, 3) float64 array
        In the map's frame.
    moved : (n,) bool array
        Whether each lies on something that changes its place during the recording.
    known : (n,) bool array
        Whether that can be told honestly.
    surface : (n,) uint8 array
        `Surface` of each.
    intensity : (n,) float32 array
    scan : (n,) int32 array
    time : (n,) float64 array
    """

    xyz: NDArray[np.float64]
    moved: NDArray[np.bool_]
    known: NDArray[np.bool_]
    surface: NDArray[np.uint8]
    intensity: NDArray[np.float32]
    scan: NDArray[np.int32]
    time: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.xyz)

    def take(self, which: NDArray[np.bool_] | NDArray[np.int64]) -> "Points":
        """Return some of the points."""
        return Points(
            self.xyz[which], self.moved[which], self.known[which], self.surface[which],
            self.intensity[which], self.scan[which], self.time[which],
        )  # fmt: skip

    @classmethod
    def joined(cls, parts: list["Points"]) -> "Points":
        """Put points one after the other."""
        return cls(
            np.concatenate([part.xyz for part in parts]),
            np.concatenate([part.moved for part in parts]),
            np.concatenate([part.known for part in parts]),
            np.concatenate([part.surface for part in parts]),
            np.concatenate([part.intensity for part in parts]),
            np.concatenate([part.scan for part in parts]),
            np.concatenate([part.time for part in parts]),
        )


@dataclass(frozen=True, slots=True)
class MeshMap:
    """A map, and the truth about it.

    Attributes
    ----------
    parameters : MeshParameters
    points : Points
    poses, true_poses : (s, 3, 4) float64 array
        From the sensor's frame to the map's as estimated, and to the scene's.
    """

    parameters: MeshParameters
    points: Points
    poses: NDArray[np.float64]
    true_poses: NDArray[np.float64]

    @property
    def xyz(self) -> NDArray[np.float64]:
        """Points in the map's frame."""
        return self.points.xyz

    @property
    def moved(self) -> NDArray[np.bool_]:
        """Whether each point lies on something that changes its place."""
        return self.points.moved

    @property
    def known(self) -> NDArray[np.bool_]:
        """Whether that can be told honestly."""
        return self.points.known

    @property
    def scan(self) -> NDArray[np.int32]:
        """The scan of each point."""
        return self.points.scan

    @property
    def time(self) -> NDArray[np.float64]:
        """When each point was measured, in seconds."""
        return self.points.time

    @property
    def sensor(self) -> str:
        """The sensor, in words."""
        told = self.parameters
        return f"{told.sensor}, {told.rays} rays a scan, {told.rate:g} Hz, {told.sensor_height:g} m"


def random_stream(parameters: MeshParameters, stream: int) -> np.random.Generator:
    """Return the random numbers of one purpose."""
    return np.random.default_rng(np.random.SeedSequence(parameters.seed, spawn_key=(stream,)))


class Recording:
    """A scene, what moves in it, and the way of the sensor.

    Parameters
    ----------
    parameters : MeshParameters

    Raises
    ------
    MissingPackageError
        When Open3D is not installed.
    """

    def __init__(self, parameters: MeshParameters) -> None:
        self.parameters = parameters
        self.stage = build_stage(parameters, random_stream(parameters, _Stream.SCENE))
        spacing = 0.35 if parameters.kind.indoors else 0.6
        walkways = Walkways.of(self.stage, Caster(self.stage), spacing)
        self.movers: Movers = populate(
            self.stage, walkways, parameters, longest(parameters),
            random_stream(parameters, _Stream.MOVERS),
        )  # fmt: skip
        self.caster = Caster(self.stage)
        random = random_stream(parameters, _Stream.DRIVE)
        track: Track = sensor_track(self.stage, walkways, parameters, random)
        drift = random_stream(parameters, _Stream.DRIFT)
        self.drive: Drive = drive(track, parameters, drift)

    def scans(self) -> Iterator[Points]:
        """Yield the points of each scan in the map's frame."""
        random = random_stream(self.parameters, _Stream.SENSOR)
        for number in range(len(self.drive.times)):
            yield self._scan(number, random)

    def _scan(self, number: int, random: np.random.Generator) -> Points:
        told = self.parameters
        start, true = float(self.drive.times[number]), self.drive.true[number]
        turn = sweep(told.sensor, told.rays, number, told.rate, random)
        origins = true[:, 3] + turn.share[:, None] / told.rate * self.drive.velocity[number]
        aimed = turn.directions @ true[:, :3].T
        hits, mixed = self._cast(number, turn, origins, aimed, random)
        met = self._returned(hits, random)
        distance = np.where(np.isfinite(hits.distance), hits.distance, 0.0)
        apart = np.where(np.isfinite(mixed.distance), mixed.distance - distance, 0.0)
        between = met & (np.abs(apart) > _EDGE)
        share = np.where(between, random.random(len(distance)), 0.0)
        ranges = distance + share * apart + random.normal(size=len(met)) * told.range_noise
        seen = origins + np.where(met, ranges, 0)[:, None] * aimed
        flat = np.hypot(*(seen - true[:, 3])[:, :2].T)
        met &= (ranges > told.min_range) & (ranges < told.max_range) & (flat > told.own_body)
        changes = np.append(self.movers.changes_place, False)  # `STATIC` is the last
        vague = np.append(~self.movers.changes_place, False)
        ghost, behind = changes[hits.owner], changes[mixed.owner] & between
        near = np.where(ghost, 1 - share, 0) + np.where(behind, share, 0)
        mirrored = hits.mirrored | (mixed.mirrored & between)
        points = Points(
            xyz=to_map(self.drive.estimated[number], to_sensor(true, seen)),
            moved=ghost | behind,
            known=~(mirrored | vague[hits.owner] | (vague[mixed.owner] & between))
            & ~((ghost | behind) & (near < 0.2)),
            surface=hits.surface,
            intensity=np.round(hits.albedo * 200 + random.normal(size=len(met)) * 6).clip(0, 255),
            scan=np.full(len(met), number, dtype=np.int32),
            time=start + turn.share / told.rate,
        ).take(met)  # fmt: skip
        return voxel_filter(points, told.scan_voxel)

    def _cast(
        self,
        number: int,
        turn: Sweep,
        origins: NDArray[np.float64],
        aimed: NDArray[np.float64],
        random: np.random.Generator,
    ) -> tuple[Hits, Hits]:
        """Return what each ray meets, and what its other half meets where it lies on an edge."""
        told = self.parameters
        start, true = float(self.drive.times[number]), self.drive.true[number]
        offset = self.movers.places(start) - true[:, 3]
        offset = offset @ true[:, :3]
        when = start + (np.arctan2(offset[:, 1], offset[:, 0]) / (2 * np.pi) % 1) / told.rate
        target = self.movers.target(when, true[:, 3], told.max_range)
        noisy = aimed + random.normal(size=aimed.shape) * np.radians(told.angle_noise)
        noisy /= np.linalg.norm(noisy, axis=1, keepdims=True)
        halves = np.flatnonzero(random.random(len(aimed)) < told.mixed)
        wide = noisy[halves] + random.normal(size=(len(halves), 3)) * np.radians(told.beam)
        wide /= np.linalg.norm(wide, axis=1, keepdims=True)
        all_hits = self.caster.cast(
            np.concatenate([origins, origins[halves]]), np.concatenate([noisy, wide]), target, random
        )
        count = len(aimed)
        row = np.arange(count)
        row[halves] = count + np.arange(len(halves))

        def part(rows: NDArray[np.int64]) -> Hits:
            return Hits(
                all_hits.distance[rows], all_hits.surface[rows], all_hits.albedo[rows],
                all_hits.cosine[rows], all_hits.owner[rows], all_hits.mirrored[rows],
            )  # fmt: skip

        return part(np.arange(count)), part(row)

    def _returned(self, hits: Hits, random: np.random.Generator) -> NDArray[np.bool_]:
        """Say which rays return: not those that are lost at random, grazed, dark or far."""
        told = self.parameters
        distance = np.where(np.isfinite(hits.distance), hits.distance, 1e6)
        near = np.minimum(1.0, (0.25 * told.max_range / np.maximum(distance, 0.1)) ** 2)
        signal = told.sensitivity * hits.albedo * hits.cosine * near
        chance = np.minimum(1.0, signal / _FULL_SIGNAL) * (1 - told.dropouts)
        return (random.random(len(distance)) < chance) & np.isfinite(hits.distance)


def simulate_meshes(parameters: MeshParameters) -> MeshMap:
    """Record a scene and make the map.

    Parameters
    ----------
    parameters : MeshParameters

    Returns
    -------
    MeshMap
        The same for the same parameters, on one machine.

    Raises
    ------
    MissingPackageError
        When Open3D is not installed.
    ConfigurationError
        When the sensor sees nothing.
    """
    recording = Recording(parameters)
    points = Points.joined(list(recording.scans()))
    if not len(points):
        raise ConfigurationError(
            "simulate: expected something within the sensor's range, found nothing from "
            f"min_range {parameters.min_range:g} to max_range {parameters.max_range:g} m"
        )
    if parameters.keep < 1:
        random = random_stream(parameters, _Stream.MAP)
        points = points.take(random.random(len(points)) < parameters.keep)
    points = voxel_filter(points, parameters.voxel)
    return MeshMap(parameters, points, recording.drive.estimated, recording.drive.true)


assert STATIC == -1  # the last of the arrays that owners index
