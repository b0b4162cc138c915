"""Rays that meet triangles: what stands, what moves, glass that passes and mirrors that turn."""

from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynahull.extras import install_command
from pipeline.errors import MissingPackageError
from pipeline.simulation.meshes.stage import Body, Matter, Stage
from pipeline.simulation.tables import Columns, Floats, Random

STATIC = -1
_GLASS_SPARKLE = 0.55
_GLASS_DUST = 0.06
_OFF_MIRROR = 1e-3  # metres: where a turned ray starts, so as not to meet the mirror again


def open3d() -> ModuleType:
    """Import Open3D.

    Raises
    ------
    MissingPackageError
        When it is not installed, or a library of the system that it needs is not.
    """
    try:
        import open3d as package  # noqa: PLC0415
    except (ImportError, OSError) as error:
        raise MissingPackageError(
            "scenes of meshes: expected Open3D, which casts their rays, found none that imports "
            f"({error}): {install_command('open3d', 'open3d')}"
        ) from error
    module: ModuleType = package
    return module


@dataclass(frozen=True, slots=True)
class Hits(Columns):
    """What n rays meet."""

    distance: Floats  # infinite where nothing is met; the whole way where a mirror turned the ray
    surface: NDArray[np.uint8]
    albedo: NDArray[np.float32]  # share of light that returns
    cosine: NDArray[np.float32]  # of the angle between ray and normal
    owner: NDArray[np.int64]  # number of the mover that is met, `STATIC` for none
    mirrored: NDArray[np.bool_]  # whether a mirror turned the ray


class Target:
    """Triangles that rays are cast at, and the mover that each belongs to, if any moves."""

    def __init__(self, body: Body, owner: NDArray[np.int64] | None = None) -> None:
        self._package = open3d()
        self._owner = owner
        self._body = body
        self.empty = not len(body.mesh.triangles)
        self._scene = self._package.t.geometry.RaycastingScene(nthreads=1)
        if not self.empty:
            self._scene.add_triangles(
                self._package.core.Tensor(np.ascontiguousarray(body.mesh.vertices, np.float32)),
                self._package.core.Tensor(np.ascontiguousarray(body.mesh.triangles, np.uint32)),
            )

    def hits(self, origins: Floats, directions: Floats) -> Hits:
        """Return the first hit of each ray."""
        count = len(origins)
        hits = Hits(
            np.full(count, np.inf),
            np.zeros(count, dtype=np.uint8),
            np.zeros(count, dtype=np.float32),
            np.zeros(count, dtype=np.float32),
            np.full(count, STATIC),
            np.zeros(count, dtype=np.bool_),
        )
        if self.empty or not count:
            return hits
        answer = self._cast(origins, directions)
        distance = answer["t_hit"].numpy()
        met = np.flatnonzero(np.isfinite(distance))
        triangle = answer["primitive_ids"].numpy()[met].astype(np.int64)
        normals = answer["primitive_normals"].numpy()[met]
        hits.distance[met] = distance[met]
        hits.surface[met] = self._body.surface[triangle]
        hits.albedo[met] = self._body.albedo[triangle]
        hits.cosine[met] = np.abs(np.sum(normals * directions[met], axis=1))
        if self._owner is not None:
            hits.owner[met] = self._owner[triangle]
        return hits

    def normals(self, origins: Floats, directions: Floats) -> Floats:
        """Return the unit normal where each ray meets something."""
        normals = self._cast(origins, directions)["primitive_normals"].numpy()
        return np.asarray(normals, np.float64)

    def _cast(self, origins: Floats, directions: Floats) -> Any:
        rays = np.concatenate([origins, directions], axis=1).astype(np.float32)
        return self._scene.cast_rays(self._package.core.Tensor(rays), nthreads=1)

    def clearance(self, points: Floats) -> Floats:
        """Return how far each point is from the nearest triangle."""
        if self.empty:
            return np.full(len(points), np.inf)
        tensor = self._package.core.Tensor(points.astype(np.float32))
        away = self._scene.compute_distance(tensor, nthreads=1).numpy()
        return np.asarray(away, np.float64)


class Caster:
    """All that stands in a scene, and what a ray finally meets."""

    def __init__(self, stage: Stage) -> None:
        self._solid = Target(stage.body(Matter.SOLID))
        self._glass = Target(stage.body(Matter.GLASS))
        self._mirror = Target(stage.body(Matter.MIRROR))

    def clearance(self, points: Floats) -> Floats:
        """Return how far each point is from anything that stands."""
        targets = (self._solid, self._glass, self._mirror)
        nearest: Floats = np.min([each.clearance(points) for each in targets], axis=0)
        return nearest

    def cast(self, origins: Floats, directions: Floats, movers: Target, random: Random) -> Hits:
        """Return what each ray meets: glass now and then, and what is seen in mirrors."""
        hits = self._through_glass(origins, directions, movers, random)
        mirror = self._mirror.hits(origins, directions)
        seen = np.flatnonzero(mirror.distance < hits.distance)
        if len(seen):
            way = directions[seen]
            normals = self._mirror.normals(origins[seen], way)
            turned = way - 2 * normals * np.sum(way * normals, axis=1, keepdims=True)
            to_mirror = mirror.distance[seen]
            start = origins[seen] + to_mirror[:, None] * way + _OFF_MIRROR * turned
            # Of their own, so that what a mirror shows changes no other ray's chances.
            (chances,) = random.spawn(1)
            there = self._through_glass(start, turned, movers, chances)
            for field in ("surface", "albedo", "cosine", "owner"):
                getattr(hits, field)[seen] = getattr(there, field)
            hits.distance[seen] = there.distance + to_mirror + _OFF_MIRROR
            hits.mirrored[seen] = True
        return hits

    def _through_glass(
        self, origins: Floats, directions: Floats, movers: Target, random: Random
    ) -> Hits:
        hits = self._solid.hits(origins, directions)
        moving = movers.hits(origins, directions)
        hits = hits.replaced(moving, moving.distance < hits.distance)
        glass = self._glass.hits(origins, directions)
        returns = _GLASS_DUST + _GLASS_SPARKLE * glass.cosine.astype(np.float64) ** 60
        shown = (glass.distance < hits.distance) & (random.random(len(origins)) < returns)
        return hits.replaced(glass, shown)
