"""Maps to learn from: simulated, cut to one size, and once more as sparser or noisier maps."""

import json
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynahull.algorithm import find_clusters, set_ground_aside
from dynahull.density import SPREAD_COLUMNS, cluster_densities
from dynahull.evidence.range_images import Returns, Views
from dynahull.evidence.summaries import ScoredPoints, summarise_ground, summarise_points
from dynahull.evidence.surroundings import Surroundings
from dynahull.evidence.terms import SEEN_TERMS, TERMS, TIMED_TERMS, evidence
from dynahull.evidence.viewpoints import Viewpoints, count_coordinates
from dynahull.evidence.voxels import Voxels
from dynahull.observer import SilentObserver
from dynahull.parameters import MethodParameters
from pipeline.simulation import SceneKind, SimulationParameters, simulate
from pipeline.simulation.meshes import MeshParameters, random_parameters, simulate_meshes

UNKNOWN, STATIC, MOVED = 0, 1, 2

_LARGEST, _MOST = 350_000, 1_500_000
"""Points of a map: a window of it is cut out where there are more; narrow windows hold more."""

_NARROW = 4.0
"""Metres from the middle of a window to its sides: as far as surroundings are looked at."""

_RIM = 1.6
"""Metres: nothing is learnt so near the edge of a window, where surroundings are missing."""

_TRIES, _SEEK_MOVED, _MOST_MOVED = 5, 0.6, 0.3

_BOXES_EACH = 5
"""Every so many maps, one is of the scenes of boxes."""

_FEWEST = 3_000
_APART = (1, 1, 2, 5, 10)
"""Scans from one of a map to the next, by seed."""

_BATCH = 100_000

PARAMETERS = MethodParameters.of({"removal": {"decision": "auto"}})

Random = np.random.Generator


@dataclass(frozen=True)
class TrainingMap:
    """A map whose terms and truth are known.

    Attributes
    ----------
    name : str
        Its seed, and a letter for each variant.
    kind, sensor : str
    xyz : (n, 3) float64 array
        Of the points that are scored.
    truth : (n,) int8 array
        `UNKNOWN`, `STATIC` or `MOVED`.
    terms : (n, len(TERMS)) or (n, len(TIMED_TERMS) + len(SEEN_TERMS)) float32 array
        Read from its file as it is asked for. The latter where scans are known: the last of
        `TIMED_TERMS` are those of scans looked at from their middles, what follows is the same
        from where the sensor was.
    unscored_static, unscored_moved : int
        Points that no decision can take: ground.
    """

    name: str
    kind: str
    sensor: str
    xyz: NDArray[np.float64]
    truth: NDArray[np.int8]
    terms: "NDArray[np.float32] | _ChosenColumns"
    unscored_static: int
    unscored_moved: int

    @property
    def is_timed(self) -> bool:
        """Whether the scans are known."""
        return bool(self.terms.shape[1] > len(TERMS))

    def posed(self) -> "TrainingMap":
        """Return the map as it is when poses are known."""
        seen = len(TIMED_TERMS) - len(SEEN_TERMS)
        columns = np.r_[:seen, len(TIMED_TERMS) : len(TIMED_TERMS) + len(SEEN_TERMS)]
        return replace(self, terms=_ChosenColumns(self.terms, columns))


class _ChosenColumns:
    """Some columns of a table in a file, as if they were all of it."""

    def __init__(
        self, table: "NDArray[np.float32] | _ChosenColumns", columns: NDArray[np.intp]
    ) -> None:
        self._table = table
        self._columns = columns
        self.shape = (len(table), len(columns))

    def __len__(self) -> int:
        return len(self._table)

    def __getitem__(self, wanted: Any) -> NDArray[np.float32]:
        rows, columns = wanted if isinstance(wanted, tuple) else (wanted, slice(None))
        return np.asarray(self._table[rows][:, self._columns[columns]])


def training_maps(
    seeds: range, folder: Path, workers: int, timed: bool = True
) -> Iterator[TrainingMap]:
    """Simulate maps and measure them, or read those that lie in the folder already.

    `timed` says whether scans are to be known.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(workers) as pool:
        for names in pool.map(partial(_make, folder, timed), seeds):
            for name in names:
                yield _read(folder, name)


def _make(folder: Path, timed: bool, seed: int) -> list[str]:
    done = folder / f"{seed:05d}.json"
    if done.exists():
        return list(json.loads(done.read_text(encoding="utf-8")))
    random = np.random.default_rng(seed)
    whole = window(_simulated(seed, random), random)
    names = []
    for letter, variant in {"a": whole, "b": _variant(whole, random)}.items():
        name = f"{seed:05d}{letter}"
        if _measure(folder / name, variant if timed else replace(variant, scan=None)):
            names.append(name)
    done.write_text(json.dumps(names), encoding="utf-8")
    return names


@dataclass(frozen=True, slots=True)
class Made:
    """A simulated map, or a part of it, and the scans that it was made of.

    `scan` is None where a voxel filter mixed the scans. What `scans` saw goes beyond the part.
    """

    xyz: NDArray[np.float64]
    truth: NDArray[np.int8]
    scan: NDArray[np.int32] | None
    scans: "_Scans"
    kind: str
    sensor: str


@dataclass(frozen=True, slots=True)
class _Scans:
    """All points of a simulated map, the scan of each, and where the sensor was in each scan."""

    xyz: NDArray[np.float64]
    scan: NDArray[np.int32]
    places: NDArray[np.float64]

    def thinned(self, share: float, random: Random) -> "_Scans":
        keep = random.random(len(self.xyz)) < share
        return replace(self, xyz=self.xyz[keep], scan=self.scan[keep])

    def views(self, viewpoints: Viewpoints) -> Views:
        returns = Returns.of(self.xyz, viewpoints.rows(self.scan), viewpoints.places)
        return Views(viewpoints.places, returns.images)

    def both_views(self) -> list[Views]:
        """Return what is seen from the middles of scans, and from where the sensor was."""
        counts = count_coordinates(self.xyz, self.scan, 0)
        middles = Viewpoints.of_counts(lambda: [counts])
        return [self.views(middles), self.views(Viewpoints.of_poses(self.places))]


def _simulated(seed: int, random: Random) -> Made:
    return _boxes(seed, random) if seed % _BOXES_EACH == _BOXES_EACH - 1 else _meshes(seed)


def _meshes(seed: int) -> Made:
    return made_of_meshes(random_parameters(seed))


def made_of_meshes(parameters: MeshParameters) -> Made:
    """Simulate a scene of meshes."""
    made = simulate_meshes(parameters)
    points = made.points
    truth = np.where(points.known, np.where(points.moving, MOVED, STATIC), UNKNOWN).astype(np.int8)
    xyz = points.xyz.astype(np.float32).astype(np.float64)  # as files of maps hold them
    scans = _Scans(xyz, points.scan, made.poses[:, :, 3])
    scan = _scan_numbers(parameters.seed, points.scan) if parameters.voxel == 0 else None
    return Made(xyz, truth, scan, scans, str(parameters.kind), str(parameters.sensor))


def _scan_numbers(seed: int, scan: NDArray[np.integer[Any]]) -> NDArray[np.int32]:
    """Return numbers of the scans: on end, or as key frames some time apart have."""
    return scan.astype(np.int32) * _APART[seed % len(_APART)]


def _boxes(seed: int, random: Random) -> Made:
    """Simulate a scene of boxes: other shapes and another sensor than those of the meshes."""
    u = random.uniform
    kind = SceneKind(str(random.choice([str(each) for each in SceneKind])))
    still = random.random() < 0.15
    made = simulate(
        SimulationParameters(
            scene=kind,
            seed=seed,
            scans=int(u(60, 200)),
            rotations_per_scan=int(random.choice([1, 5, 15])),
            azimuth_step=float(u(0.2, 1.0)),
            range_noise=float(u(0.005, 0.03)),
            drift_position=float(u(0.0, 0.03)),
            drift_heading=float(u(0.0, 0.15)),
            walkers=0 if still else int(u(2, 20)),
            queuers=0 if still else int(u(0, 6)),
            machines=0 if still else int(random.integers(0, 5)),
        )
    )
    truth = np.where(made.moving, MOVED, STATIC).astype(np.int8)
    xyz = made.xyz.astype(np.float64)
    scans = _Scans(xyz, made.scan.astype(np.int32), made.estimated_poses[:, :, 3])
    scan = _scan_numbers(seed, made.scan)
    return Made(xyz, truth, scan, scans, f"boxes_{kind}", "boxes")


def window(made: Made, random: Random, most: int = _MOST) -> Made:
    """Return the points about one of them, in a square that holds as many as are wanted.

    The one has moved more often than not, as most windows would hold nothing that did. Where most
    of a window moved, another is tried. A narrow square may hold more, but at most `most`.
    """
    xyz, truth = made.xyz, made.truth
    if len(xyz) <= _LARGEST:
        return made
    for _ in range(_TRIES):
        seek = random.random() < _SEEK_MOVED
        among = np.flatnonzero(truth == MOVED) if seek else np.zeros(0, np.intp)
        centre = xyz[random.choice(among) if len(among) else random.integers(len(xyz)), :2]
        away = np.abs(xyz[:, :2] - centre).max(axis=1)
        last = min(most, len(away) - 1)
        ranked = np.partition(away, (_LARGEST, last))
        half = min(max(ranked[_LARGEST], _NARROW), ranked[last])
        inside = np.flatnonzero(away <= half)
        if np.mean(truth[inside] == MOVED) < _MOST_MOVED:
            break
    rim = away[inside] > max(half - _RIM, 0.7 * half)
    within = np.where(rim, np.int8(UNKNOWN), truth[inside])
    return _of(made, xyz[inside], within, inside)


def _of(made: Made, xyz: NDArray[np.float64], truth: NDArray[np.int8], rows: NDArray[Any]) -> Made:
    scan = None if made.scan is None else made.scan[rows]
    return replace(made, xyz=xyz, truth=truth, scan=scan)


def _variant(made: Made, random: Random) -> Made:
    """Return the map as a voxel filter would leave it, or thinned, often with more noise."""
    xyz, truth = made.xyz, made.truth
    chance = random.random()
    if chance < 0.35 and made.scan is not None:
        xyz, truth = _voxel_filter(xyz, truth, float(random.choice([0.03, 0.05, 0.05, 0.1])))
        return replace(made, xyz=xyz, truth=truth, scan=None)
    share = random.uniform(0.15, 0.6)
    fewer = thinned(made, share, random)
    noise = random.uniform(0.005, 0.025) if chance < 0.7 else 0.0
    noisy = fewer.xyz + random.normal(size=fewer.xyz.shape) * noise
    return replace(fewer, xyz=noisy, scans=made.scans.thinned(share, random))


def thinned(made: Made, share: float, random: Random) -> Made:
    """Return the map with some of its points, drawn at random."""
    keep = random.random(len(made.xyz)) < share
    return _of(made, made.xyz[keep], made.truth[keep], keep)


def _voxel_filter(
    xyz: NDArray[np.float64], truth: NDArray[np.int8], side: float
) -> tuple[NDArray[np.float64], NDArray[np.int8]]:
    """Replace the points of each voxel by their mean; its truth is that of most of them."""
    _, place, count = np.unique(
        np.floor(xyz / side).astype(np.int64), axis=0, return_inverse=True, return_counts=True
    )
    place = place.ravel()
    means = np.column_stack([np.bincount(place, xyz[:, axis]) / count for axis in range(3)])
    shares = [np.bincount(place, truth == label) / count for label in (UNKNOWN, STATIC, MOVED)]
    return means, np.argmax(shares, axis=0).astype(np.int8)


def _measure(path: Path, made: Made) -> bool:
    """Measure the terms of a map as `clean` does, and keep them."""
    xyz, truth, scan = np.ascontiguousarray(made.xyz), made.truth, made.scan
    points, rows = scored(xyz, PARAMETERS)
    if len(points) < _FEWEST:
        return False
    aside = np.ones(len(xyz), np.bool_)
    aside[rows] = False
    if scan is not None:
        points = replace(points, scan=scan[rows])
    ground = summarise_ground(xyz[aside], None if scan is None else scan[aside])
    voxels = Voxels.merged([summarise_points(points), ground])
    middles, places = [None, None] if scan is None else made.scans.both_views()
    surroundings = Surroundings.of(voxels, middles)
    posed = None if places is None else Surroundings.of(voxels, places)
    count = len(TERMS) if posed is None else len(TIMED_TERMS) + len(SEEN_TERMS)
    terms = np.lib.format.open_memmap(
        path.with_suffix(".terms.npy"), "w+", np.float32, (len(points), count)
    )
    for begin in range(0, len(points), _BATCH):
        part, own = points.part(slice(begin, begin + _BATCH)), slice(begin, begin + _BATCH)
        found = evidence(part, PARAMETERS.neighbours.k, surroundings)
        terms[own, : found.shape[1]] = found
        if posed is not None:
            seen = evidence(part, PARAMETERS.neighbours.k, posed)[:, -len(SEEN_TERMS) :]
            terms[own, found.shape[1] :] = seen
    np.savez(
        path.with_suffix(".npz"),
        xyz=points.xyz,
        truth=truth[rows],
        names=np.array([made.kind, made.sensor]),
        unscored=[np.count_nonzero(truth[aside] == label) for label in (STATIC, MOVED)],
    )
    return True


def scored(
    xyz: NDArray[np.float64], parameters: MethodParameters
) -> tuple[ScoredPoints, NDArray[np.intp]]:
    """Measure points as the first four steps of Algorithm 1 do; return them and their rows."""
    silent = SilentObserver()
    aside = set_ground_aside(xyz, np.ones(len(xyz), np.bool_), parameters, None, silent)
    rows = np.flatnonzero(~aside.ground & ~aside.above)
    clusters = find_clusters(xyz[rows], rows, len(xyz), parameters, silent)
    nearest = clusters.nearest(xyz[rows])
    density = np.full(len(rows), np.nan)
    spread = np.full((len(rows), SPREAD_COLUMNS), np.nan, np.float32)
    for cluster in np.unique(nearest):
        members = np.flatnonzero(nearest == cluster)
        density[members], spread[members] = cluster_densities(
            xyz[rows[members]], rows[members], parameters
        )
    return ScoredPoints(xyz[rows], density, spread, aside.height[rows]), rows


def _read(folder: Path, name: str) -> TrainingMap:
    with np.load(folder / f"{name}.npz") as kept:
        kind, sensor = kept["names"].tolist()
        static, moved = kept["unscored"].tolist()
        terms = np.load(folder / f"{name}.terms.npy", mmap_mode="r")
        return TrainingMap(name, kind, sensor, kept["xyz"], kept["truth"], terms, static, moved)
