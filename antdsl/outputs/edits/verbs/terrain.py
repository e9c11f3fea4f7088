"""The ground of a cache: its points and normals above and below agents, along their up direction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.transforms import Floats
from antdsl.bodies.body import compute_vertex_normals
from antdsl.casting.rays import RayScene
from antdsl.outputs.cache.cache_reader import Arrays, Cache
from antdsl.outputs.cache.dug_solids import DugSolids
from antdsl.outputs.cache.manifest import MeshEntry
from antdsl.scene.thing_models import UNIT_MM

Mesh = tuple[Floats, NDArray[np.int32]]


@dataclass(frozen=True, slots=True, eq=False)
class GroundPoints:
    """Points of the ground in scene units: `position` [n, 3] and unit `normal` [n, 3]. `is_hit`: whether ground was found."""

    is_hit: NDArray[np.bool_]
    position: Floats
    normal: Floats


class Terrain:
    """The meshes on which agents walk, in scene units."""

    def __init__(self, meshes: Sequence[Mesh], unit_mm: float) -> None:
        self._unit_mm = unit_mm
        self._rays = RayScene.from_meshes([(vertices * unit_mm, faces) for vertices, faces in meshes])
        self._faces = [faces for _, faces in meshes]
        self._normals = [compute_vertex_normals(vertices, faces).astype(np.float64) for vertices, faces in meshes]

    def find_along(self, points: Floats, up: Floats, lift: Floats, reach: Floats) -> GroundPoints:
        """Return the nearest ground above or below points [n, 3], along `up`, within the distance `reach` [n].

        Ground that is up to `lift` [n] above a point counts as below it."""
        start = points + up * lift[:, None]
        below, above = self._cast_rays(start, -up, reach + lift), self._cast_rays(start, up, reach)
        use_below = below[0] - lift <= above[0] + lift
        distance = np.where(use_below, -(below[0] - lift), above[0] + lift)
        normal = np.where(use_below[:, None], below[1], above[1])
        is_hit = np.isfinite(distance)
        normal = np.where((normal * up).sum(axis=1, keepdims=True) < 0, -normal, normal)
        return GroundPoints(is_hit, points + up * np.where(is_hit, distance, 0.0)[:, None], np.where(is_hit[:, None], normal, up))

    def find_below(self, points: Floats, up: Floats, lift: Floats) -> GroundPoints:
        """Return the first ground below points [n, 3] or, if there is none, the first ground above them."""
        far = np.full(len(points), np.inf)
        start = points + up * lift[:, None]
        down = self._cast_rays(start, -up, far)
        rows = np.flatnonzero(~np.isfinite(down[0]))
        distance, normal = lift - down[0], down[1]
        if len(rows):
            above = self._cast_rays(start[rows], up[rows], far[rows])
            distance[rows], normal[rows] = above[0] + lift[rows], above[1]
        is_hit = np.isfinite(distance)
        normal = np.where((normal * up).sum(axis=1, keepdims=True) < 0, -normal, normal)
        return GroundPoints(is_hit, points + up * np.where(is_hit, distance, 0.0)[:, None], np.where(is_hit[:, None], normal, up))

    def measure_free_shares(self, start: Floats, end: Floats) -> Floats:
        """Return the fraction of each line from `start` to `end` [n, 3] that is in front of the first ground. 1 if no ground is
        hit."""
        hits = self._rays.find_first_hits(start * self._unit_mm, (end - start) * self._unit_mm)
        shares: Floats = np.minimum(hits.t, 1.0)
        return shares

    def _cast_rays(self, points: Floats, direction: Floats, reach: Floats) -> tuple[Floats, Floats]:
        """Return the distances of the first hits within `reach` (inf for none), and the normals at these hits."""
        hits = self._rays.find_first_hits(points * self._unit_mm, direction * self._unit_mm)
        normal = np.tile(np.array([0.0, 1.0, 0.0]), (len(points), 1))
        for mesh, (faces, normals) in enumerate(zip(self._faces, self._normals, strict=True)):
            rows = np.flatnonzero(hits.mesh == mesh)
            corners = normals[faces[hits.face[rows]]]
            weights = np.stack([1 - hits.u[rows] - hits.v[rows], hits.u[rows], hits.v[rows]], axis=1)
            mixed = (corners * weights[:, :, None]).sum(axis=1)
            length = np.sqrt((mixed * mixed).sum(axis=1, keepdims=True))
            normal[rows] = np.where(length > 1e-9, mixed / np.maximum(length, 1e-9), hits.normal[rows])
        return np.where(hits.t <= reach, hits.t, np.inf), normal


class Ground:
    """The ground of a cache in each frame. `entries`: its meshes, by default all meshes on which agents walk.

    If no mesh moves or is dug, it is built only once."""

    def __init__(self, cache: Cache, entries: Sequence[MeshEntry] | None = None) -> None:
        self._cache = cache
        self._entries = [mesh for mesh in cache.manifest.meshes if mesh.row.is_ground] if entries is None else entries
        self._last: tuple[int, Terrain] | None = None

    @cached_property
    def _static(self) -> Arrays:
        """Return the arrays that apply to all frames."""
        return self._cache.read_static()

    @cached_property
    def _dug_solids(self) -> DugSolids:
        """Return the reader of dug solids."""
        return DugSolids(self._cache, self._static)

    def at(self, number: int) -> Terrain | None:
        """Return the ground in frame `number`. None if the cache has no ground."""
        if not self._entries:
            return None
        changes = any(mesh.moves or mesh.row.is_dug for mesh in self._entries)
        if self._last is None or (changes and self._last[0] != number):
            moved = self._cache.frame(number) if any(mesh.moves for mesh in self._entries) else {}
            meshes = [
                (
                    np.asarray(moved.get(f"mesh.{mesh.name}.vertices", self._static[f"mesh.{mesh.name}.vertices"]), np.float64),
                    np.asarray(self._static[f"mesh.{mesh.name}.faces"], np.int32),
                )
                for mesh in self._entries
                if not mesh.row.is_dug
            ]
            dug = {mesh.name for mesh in self._entries if mesh.row.is_dug}
            solids = self._dug_solids.at(number) if dug else ()
            meshes += [(solid.vertices, solid.faces) for solid in solids if solid.name in dug]
            self._last = number, Terrain(meshes, UNIT_MM[self._cache.manifest.units])
        return self._last[1]


@dataclass(frozen=True, slots=True, eq=False)
class MirroredTerrain:
    """Ground that is mirrored across a plane.

    `sign` [3]: -1 for the axis perpendicular to the plane, else 1. `shift` [3]: twice the coordinate of the plane on this
    axis."""

    terrain: Terrain
    sign: Floats
    shift: Floats

    def find_along(self, points: Floats, up: Floats, lift: Floats, reach: Floats) -> GroundPoints:
        """Return the nearest ground above or below points. Same as `Terrain.find_along`."""
        hits = self.terrain.find_along(points * self.sign + self.shift, up * self.sign, lift, reach)
        return GroundPoints(hits.is_hit, hits.position * self.sign + self.shift, hits.normal * self.sign)
