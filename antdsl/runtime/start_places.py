"""Where a line of the crowd may start: places drawn one after another for each agent, every draw a function of (seed, species,
id, number of the try)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.runtime import kernels, randomness
from antdsl.runtime import vectors as vec
from antdsl.runtime.spacing import Drawn
from antdsl.runtime.surface_area import Area, areas
from antdsl.runtime.world import World
from antdsl.scene.setting import CrowdData, MeshData

Ids = NDArray[np.int64]
Floats = NDArray[np.float64]

PLACEMENT_FRAME = 0  # placement belongs to no frame
TURN = np.float32(2 * np.pi)
_DISC = 100.0  # mm: without any ground and any place


class StartPlaces:
    """The places of one line of the crowd. `area` (mm²): what they lie on, None where that is not known."""

    def __init__(self, world: World, crowd: CrowdData) -> None:
        self._world, self._species, self.place = world, crowd.species, crowd.place
        self.given = crowd.place.points is not None and len(crowd.place.points) > 0
        setting = world.setting
        self._grounds = {**setting.surfaces, **{name: solid.mesh for name, solid in setting.solids.items()}}
        self._on = crowd.place.on or tuple(setting.surfaces) or tuple(self._grounds)
        self._faces: Area | None = None
        self._dense: Area | None = None
        if crowd.place.by_area and not self.given and self._grounds:
            self._faces = areas(world, self._on, crowd.place.density, crowd.place.around, crowd.place.radius)

    @property
    def area(self) -> float | None:
        place = self.place
        if self._faces is not None:
            return self._faces.total
        if self.given or place.inside is not None or place.density is not None:
            return None
        if place.around is not None or not self._grounds:
            radius = _DISC if place.radius is None else place.radius
            return float(np.pi * radius * radius)
        return areas(self._world, self._on, None, None, None).total

    def draw(self, ids: Ids, tries: range) -> Drawn:
        """Places for agents: those of the first try, then those of the next."""
        world, place = self._world, self.place
        if place.inside is not None and world.ground.meshes is not None:
            return self._seen_from(np.asarray(place.inside, np.float64) - world.origin, ids, tries)
        if self._faces is not None:
            return self._by_area(self._faces, ids, tries)
        points = np.concatenate([self._points(ids, attempt) for attempt in tries])
        if self.given and place.by_area:
            footing, found = world.ground.nearest(points, place.on or None)[0], np.ones(len(points), np.bool_)
            return Drawn(footing, world.ground.position(footing), world.ground.normal(footing), found)
        footing, found = world.ground.place(points, world.up, place.on or None)
        at = world.ground.position(footing)
        up = np.array(np.broadcast_to(world.up, at.shape))
        return Drawn(footing, at, up, found & ~inside_obstacle(world, at) if not self.given else found)

    def _uniform(self, ids: Ids, index: int, site: str = "place") -> NDArray[np.float32]:
        return randomness.uniform(self._world.setting.seed, PLACEMENT_FRAME, self._species, site, index, ids)

    def _points(self, ids: Ids, attempt: int) -> Floats:
        """Wanted places (n, 3), to be dropped onto the ground."""
        world, place = self._world, self.place
        if place.points is not None and len(place.points):
            return np.asarray(place.points, np.float64)[ids % len(place.points)] - world.origin
        u, v, w = (self._uniform(ids, 4 * attempt + k) for k in range(3))
        if place.around is not None or not self._grounds:
            middle = np.zeros(3) if place.around is None else np.asarray(place.around, np.float64) - world.origin
            radius = _DISC if place.radius is None else place.radius
            away, angle = np.sqrt(u).astype(np.float64) * radius, v * TURN
            up = vec.columns(np.broadcast_to(world.up, (len(ids), 3)), np.float64)
            side = vec.across(up)
            ahead = vec.cross(up, side)
            disc = vec.add(vec.scale(side, away * kernels.cos(angle)), vec.scale(ahead, away * kernels.sin(angle)))
            return middle + vec.rows(disc)
        if place.density is not None:
            if self._dense is None:
                self._dense = areas(world, place.on or tuple(world.surface_index), place.density, None, None)
            return self._dense.points(u, v, w, self._uniform(ids, 4 * attempt + 3))[3]
        return _on_faces([self._grounds[name] for name in self._on], u, v, w) - world.origin

    def _by_area(self, faces: Area, ids: Ids, tries: range) -> Drawn:
        """Places evenly over faces, whichever way they look, up being off them."""
        draws = [np.concatenate([self._uniform(ids, 4 * attempt + k) for attempt in tries]) for k in range(4)]
        footing, up, found = faces.at(*draws)
        at = self._world.ground.position(footing)
        return Drawn(footing, at, up, found & ~inside_obstacle(self._world, at))

    def _seen_from(self, start: Floats, ids: Ids, tries: range) -> Drawn:
        """Where lines from a place in drawn directions first meet a mesh, ups towards it. A line that meets none, or another than
        those in `on`, leads nowhere: the surface nearest to where it began."""
        world = self._world
        meshes = world.ground.meshes
        wanted = [meshes.names.index(name) for name in (self.place.on or meshes.names) if name in meshes.names]
        far = meshes.extent * 1.8 + float(np.abs(start - (meshes.low + meshes.high) / 2).max())
        u, v = (np.concatenate([self._uniform(ids, 2 * attempt + k, "inside") for attempt in tries]) for k in range(2))
        height = 1.0 - 2.0 * u.astype(np.float64)  # even over a ball, by a theorem of Archimedes
        flat, angle = np.sqrt(np.maximum(1.0 - height * height, 0.0)), v * TURN
        way = np.stack([flat * kernels.cos(angle), height, flat * kernels.sin(angle)], axis=1)
        begin = np.broadcast_to(start, way.shape)
        found, part, footing = meshes.met(begin, way * far)
        good = found & np.isin(footing.mesh, wanted)
        at = np.where(good[:, None], begin + way * (far * part)[:, None], begin)
        good &= ~inside_obstacle(world, at)
        standing = world.ground.nearest(at)[0]
        up = np.where(good[:, None], -way, world.up)
        return Drawn(standing, world.ground.position(standing), up, good)


def _on_faces(meshes: list[MeshData], u: NDArray[np.float32], v: NDArray[np.float32], w: NDArray[np.float32]) -> Floats:
    """Points spread evenly over the area of some meshes."""
    corners = np.concatenate([m.vertices[m.faces] for m in meshes])
    edge, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = vec.cross(vec.columns(edge, np.float64), vec.columns(other, np.float64))
    area = np.cumsum(vec.length(normal))
    face = np.minimum(np.searchsorted(area, u.astype(np.float64) * area[-1], side="right"), len(area) - 1)
    fold = v + w > 1
    a, b = np.where(fold, 1 - v, v), np.where(fold, 1 - w, w)
    points: Floats = corners[face, 0] + a[:, None] * edge[face] + b[:, None] * other[face]
    return points


def inside_obstacle(world: World, points: Floats) -> NDArray[np.bool_]:
    """Whether points lie in an obstacle: the first face above them shows its back."""
    found = np.zeros(len(points), np.bool_)
    up = np.broadcast_to(world.up, points.shape)
    for name in world.plan.obstacles:
        mesh = world.setting.obstacles.get(name)
        if mesh is None or not len(mesh.faces):
            continue
        hits = world.obstacles[name].cast(points, up)
        corners = mesh.vertices[mesh.faces[np.maximum(hits.face, 0)]]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])  # edges: the origin does not matter
        found |= hits.hit & ((normal * up).sum(axis=1) > 0)
    return found
