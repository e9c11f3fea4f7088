"""Ground for feet: what a leg can reach of surfaces, obstacles, solids and the plane, and on which side.

A foot searches along the straight line from its hip to its target position, so that no leg passes through a sheet. If that ends
far from the target (an edge, a wall, a step), the foot searches from above the target, along the body's up. The start of this ray
is limited to what the hip sees. The last attempt is the nearest position. A result is visible from the hip and no farther away
than the leg is long."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.rays import RayScene
from antdsl.ground.plane import Plane
from antdsl.ground.solid_feelers import SolidFeelers
from antdsl.numerics import parallel
from antdsl.numerics import vectors as vec
from antdsl.runtime.feet import footholds
from antdsl.runtime.feet.state import NOTHING, PLANE
from antdsl.runtime.moving.moving_geometry import vertices_at
from antdsl.runtime.world import World

Places = NDArray[np.float64]  # (3, k)
Rows = NDArray[np.int64]
Arrays = tuple[NDArray[Any], ...]

_SHY = 1e-6  # of a distance: by how much a ray is shortened in the test for obstructions
_RAYS = 256  # for which a thread pays


@dataclass(slots=True, eq=False)
class Found:
    """Where k rays hit something: `place` float64[3, k], `part` of the ray (inf: no hit), `on`, `face` and `weight` as in
    `Feet`."""

    part: NDArray[np.float64]
    place: Places
    on: NDArray[np.int16]
    face: NDArray[np.int32]
    weight: NDArray[np.float64]

    @staticmethod
    def none(count: int) -> Found:
        """Nothing met."""
        return Found(
            np.full(count, np.inf), np.zeros((3, count)), np.full(count, NOTHING, np.int16), np.zeros(count, np.int32),
            np.zeros((2, count)),
        )  # fmt: skip

    @property
    def columns(self) -> Arrays:
        """As kernels read them."""
        return self.part, self.place, self.on, self.face, self.weight

    def put(self, rows: Rows, other: Found) -> None:
        """Put other hits into rows."""
        self.part[rows], self.on[rows], self.face[rows] = other.part, other.on, other.face
        self.place[:, rows], self.weight[:, rows] = other.place, other.weight


class Floor:
    """All that feet can stand on, by numbers: the drawn surfaces, obstacles and solids (all if none is drawn), in the setting's
    order."""

    def __init__(self, world: World) -> None:
        setting = world.setting
        meshes = {**setting.surfaces, **setting.obstacles}
        every = [*meshes, *world.solids]
        self.names = tuple(name for name in every if name not in setting.unseen) or tuple(every)
        self.meshes = {name: mesh for name, mesh in meshes.items() if name in self.names}
        self.moving = [k for k, name in enumerate(self.names) if name in setting.moves.meshes]
        self._still = {
            k: _box(self.meshes[name].vertices - world.origin)
            for k, name in enumerate(self.names)
            if name in self.meshes and k not in self.moving and len(self.meshes[name].vertices)
        }

    def cast(self, world: World, origin: Places, way: Places, most_hit: bool = True) -> Found:
        """Return the first hits of the straight lines from `origin` by `way`.

        `most_hit`: most lines are expected to hit walkable surfaces, so Open3D need not test first which do. It does not change
        the result."""
        found, threads = Found.none(origin.shape[1]), world.options.threads
        if isinstance(world.ground, Plane):
            _on_plane(world, origin, way, found)
        for k, name in enumerate(self.names):
            seen = world.obstacles.get(name)
            box = self._box_of(world, k, seen)
            if box is None:
                continue
            tables = seen.tables() if isinstance(seen, RayScene) and k not in self.moving else None
            if tables is None:
                near = _meeting(box, origin, way)
            else:
                far = np.empty(len(found.part), np.int64)
                work = partial(footholds.cast, tables, box, k, origin, way, found.columns, far)
                near = parallel.joined(parallel.in_parts(work, len(far), threads, _RAYS), far)[0]
            if not near.size:
                continue
            if isinstance(seen, RayScene):
                sure = most_hit and name in world.setting.surfaces
                near = near if sure else _close(seen, near, origin, way)
                if near.size:
                    self._on_mesh(world, k, seen, near, (origin, way), found, sure)
            elif isinstance(seen, SolidFeelers):
                _on_solid(k, seen, near, origin, way, found)
        return found

    def nearest(self, world: World, points: Places, reach: NDArray[np.float64]) -> Found:
        """Return the nearest positions to points, within `reach` (mm, [k])."""
        found = Found.none(points.shape[1])
        least = reach.copy()
        for k, name in enumerate(self.names):
            seen = world.obstacles.get(name)
            box = self._box_of(world, k, seen)
            if box is None:
                continue
            near = np.flatnonzero(((points - reach <= box[1][:, None]) & (points + reach >= box[0][:, None])).all(axis=0))
            near = _within(seen, near, points, reach) if isinstance(seen, RayScene) else near
            if not near.size:
                continue
            if isinstance(seen, RayScene):
                _, face, place, distance = seen.closest(points[:, near].T, world.options.threads, least[near])
            else:
                assert isinstance(seen, SolidFeelers)
                slope = seen.volume.gradient(points[:, near].T).astype(np.float64)
                landed = seen.volume.project(points[:, near].T, _unit_rows(slope), float(reach.max()))
                place, face = landed.points, np.zeros(near.size, np.int32)
                distance = np.where(landed.found, _length((landed.points - points[:, near].T).T), np.inf)
            nearer = distance < least[near]
            rows = near[nearer]
            least[rows] = distance[nearer]
            found.put(rows, self._hits(world, k, distance[nearer], place[nearer].T, face[nearer]))
        return found

    def carried(self, world: World, on: NDArray[np.int16], face: NDArray[np.int32], weight: Places, place: Places) -> None:
        """Move places [3, …] that are on moving things to their current positions."""
        for k in self.moving:
            rows = on == k
            if rows.any():
                vertices = vertices_at(world, self.names[k], world.shown)
                a, b, c = (vertices[self.meshes[self.names[k]].faces[face[rows], corner]].T for corner in range(3))
                place[:, rows] = a + weight[0][rows] * (b - a) + weight[1][rows] * (c - a)

    def _box_of(self, world: World, k: int, seen: object) -> tuple[Places, Places] | None:
        if isinstance(seen, SolidFeelers):
            return seen.volume.low, seen.volume.high
        if k in self.moving:
            return _box(vertices_at(world, self.names[k], world.shown))
        return self._still.get(k)

    def _on_mesh(
        self, world: World, k: int, seen: RayScene, near: Rows, rays: tuple[Places, Places], found: Found, most_hit: bool
    ) -> None:
        a, w = (each[:, near] for each in rays)
        begin, step = np.ascontiguousarray(a.T), np.ascontiguousarray(w.T)
        which, part, _, face = seen.cast_within(begin, step, world.options.threads, most_hit)
        nearer = part < found.part[near[which]]
        which, part, face = which[nearer], part[nearer], face[nearer]
        found.put(near[which], self._hits(world, k, part, a[:, which] + w[:, which] * part, face))

    def _hits(self, world: World, k: int, part: NDArray[np.float64], place: Places, face: NDArray[np.int32]) -> Found:
        made = Found(part, place, np.full(len(part), k, np.int16), np.zeros(len(part), np.int32), np.zeros((2, len(part))))
        if k in self.moving and len(part):
            made.face = face.astype(np.int32)
            vertices = vertices_at(world, self.names[k], world.shown)
            corners = tuple(vertices[self.meshes[self.names[k]].faces[face, corner]].T for corner in range(3))
            made.weight = _weights(place, *corners)
        return made


@dataclass(slots=True, eq=False)
class Seeking:
    """Feet that need ground. `requests` int64[k]: agent number times L plus leg number. `columns`: hip, requested position and up
    of the body, (3, k); greatest distance (mm) of the foot joint from the hip; its height above the ground. `way` (3, k): from
    the hip to beyond the requested position. `is_quick`: the foot lifts, and searches again when it lands."""

    requests: Rows
    columns: Arrays
    way: Places
    is_quick: NDArray[np.bool_]

    @staticmethod
    def of(requests: Rows, given: tuple[Any, ...], threads: int) -> Seeking:
        """Return the feet of some requests. `given`: the next arguments of `footholds.aim`."""
        count = len(requests)
        room = np.empty((14, count))
        columns = room[:3], room[3:6], room[6:9], room[12], room[13]
        made = Seeking(requests, columns, room[9:12], np.empty(count, np.bool_))
        work = partial(footholds.aim, requests, *given, columns, made.way, made.is_quick)
        parallel.in_parts(work, count, threads, _RAYS)
        return made

    def settle(self, found: Found, columns: Arrays, threads: int) -> None:
        """Write the ground that was found to the feet: `place`, `on`, `face` and `weight`, legs first."""
        work = partial(footholds.settle, self.requests, self.columns, found.columns, *columns)
        parallel.in_parts(work, len(self.requests), threads, _RAYS)


def seek(world: World, floor: Floor, seeking: Seeking) -> Found:
    """Return ground for feet. Quick ones only get what is on the straight line, at any distance from the target."""
    threads, count = world.options.threads, len(seeking.requests)
    found = floor.cast(world, seeking.columns[0], seeking.way)
    fits, rows = np.empty(count, np.bool_), np.empty(count, np.int64)
    work = partial(footholds.judge, seeking.columns, found.columns, seeking.is_quick, fits, rows)
    (rows,) = parallel.joined(parallel.in_parts(work, count, threads, _RAYS), rows)
    if rows.size:
        _look_around(world, floor, seeking, found, fits, rows)
    return found


def _look_around(world: World, floor: Floor, seeking: Seeking, found: Found, fits: NDArray[np.bool_], rows: Rows) -> None:
    """Find ground for feet that have no straight line to the requested position: from above it, then the nearest point."""
    threads, count = world.options.threads, len(rows)
    room = np.empty((13, count))
    above, to_above, down, hips, reach = room[:3], room[3:6], room[6:9], room[9:12], room[12]
    parallel.in_parts(partial(footholds.look_around, seeking.columns, rows, above, to_above, down, hips), count, threads, _RAYS)
    level = floor.cast(world, hips, to_above, most_hit=False)
    below = floor.cast(world, above, down)
    lost = np.empty(count, np.int64)
    given = seeking.columns, rows, found.columns, fits, level.columns, below.columns, lost, reach
    parts = parallel.in_parts(partial(footholds.choose, *given), count, threads, _RAYS)
    lost, reach = parallel.joined(parts, lost, reach)
    if lost.size:
        rows, hips = rows[lost], np.ascontiguousarray(hips[:, lost])
        close = floor.nearest(world, np.ascontiguousarray(seeking.columns[1][:, rows]), reach)
        seen = floor.cast(world, hips, (close.place - hips) * (1.0 - _SHY))
        footholds.accept(seeking.columns, rows, close.columns, seen.columns, found.columns, 0, len(rows))


def _meeting(box: tuple[Places, Places], origin: Places, way: Places) -> Rows:
    """The rays that may meet a box."""
    low, high = np.minimum(origin, origin + way), np.maximum(origin, origin + way)
    return np.flatnonzero(((low <= box[1][:, None]) & (high >= box[0][:, None])).all(axis=0))


def _close(seen: RayScene, rows: Rows, origin: Places, way: Places) -> Rows:
    """Return the rays that may hit a mesh, by a test with the bounding sphere of each ray."""
    half = way * 0.5
    return _within(seen, rows, origin + half, _length(half))


def _within(seen: RayScene, rows: Rows, points: Places, reach: NDArray[np.float64]) -> Rows:
    """Return the points that may be within `reach` of a mesh."""
    return rows[seen.clearance(*points[:, rows]) <= reach[rows] * (1 + 1e-4) + 1e-4]


def _on_plane(world: World, origin: Places, way: Places, found: Found) -> None:
    up = world.up
    height = (origin[0] * up[0] + origin[1] * up[1]) + origin[2] * up[2]
    fall = -((way[0] * up[0] + way[1] * up[1]) + way[2] * up[2])
    part = np.where(fall > 0, height / np.where(fall > 0, fall, 1.0), np.inf)
    met = np.flatnonzero((part >= 0) & (part <= 1))
    place = origin[:, met] + way[:, met] * part[met]
    made = Found.none(met.size)
    made.part, made.place, made.on = part[met], place, np.full(met.size, PLANE, np.int16)
    found.put(met, made)


def _on_solid(k: int, seen: SolidFeelers, near: Rows, origin: Places, way: Places, found: Found) -> None:
    a, w = origin[:, near], way[:, near]
    length = _length(w)
    unit = w / np.maximum(length, 1e-300)
    hits = seen.feelers(*a, *unit, length)  # type: ignore[call-arg]
    part = hits.t.astype(np.float64) / np.maximum(length, 1e-300)
    met = np.flatnonzero(hits.hit & (part < found.part[near]))
    place = a[:, met] + w[:, met] * part[met]
    normal = np.stack([hits.nx[met], hits.ny[met], hits.nz[met]]).astype(np.float64)
    landed = seen.volume.project(place.T, _unit_rows(normal.T), 2 * seen.volume.voxel)
    good = landed.found
    met = met[good]
    made = Found.none(met.size)
    made.part, made.place, made.on = part[met], landed.points[good].T, np.full(met.size, k, np.int16)
    found.put(near[met], made)


def _length(v: Places) -> NDArray[np.float64]:
    return np.asarray(np.sqrt((v[0] * v[0] + v[1] * v[1]) + v[2] * v[2]))


def _unit_rows(v: NDArray[np.float64]) -> NDArray[np.float64]:
    size = np.sqrt((v[:, 0] * v[:, 0] + v[:, 1] * v[:, 1]) + v[:, 2] * v[:, 2])
    return np.asarray(v / np.maximum(size, 1e-12)[:, None])


def _box(vertices: NDArray[np.float64]) -> tuple[Places, Places]:
    return vertices.min(axis=0), vertices.max(axis=0)


def _weights(place: Places, a: Places, b: Places, c: Places) -> NDArray[np.float64]:
    """The weights float64[2, k] of the second and third corner of triangles at places in them."""
    u, v, w = b - a, c - a, place - a
    uu, uv, vv, wu, wv = vec.dot(u, u), vec.dot(u, v), vec.dot(v, v), vec.dot(w, u), vec.dot(w, v)
    whole = uu * vv - uv * uv
    whole = np.where(whole > 0, whole, 1.0)
    return np.stack([(vv * wu - uv * wv) / whole, (uu * wv - uv * wu) / whole])
