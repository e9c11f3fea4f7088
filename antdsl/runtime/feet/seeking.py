"""Ground for feet: what a leg can reach of surfaces, obstacles, solids and the plane, and on which side it is.

A foot seeks along the straight line from its hip to where it wants to stand, so that no leg passes through a sheet. Where that
leads far from the place (an edge, a wall, a step), it looks from above the place along the body's up, as far as the hip sees that
point, and last for the nearest place. What it finds is in sight of the hip and no farther than the leg is long."""

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
from antdsl.runtime.feet.footholds import FACE_BITS
from antdsl.runtime.feet.state import NOTHING, PLANE
from antdsl.runtime.moving.moving_geometry import vertices_at
from antdsl.runtime.world import Population, World

Places = NDArray[np.float64]  # (3, k)
Rows = NDArray[np.int64]
Arrays = tuple[NDArray[Any], ...]

_SHY = 1e-6  # of a way: how much shorter it is when it is asked whether something is on it
_RAYS = 256  # for which a thread pays


@dataclass(slots=True, eq=False)
class Found:
    """Where k rays met something: `place` float64[3, k], `part` of the way (inf: nothing), `on`, `face` and `weight` as in
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
    """All that feet can stand on, by numbers: surfaces, obstacles and solids that are drawn (all where none
    is), in the setting's order."""

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
        # By number of the ground, what starts of walks have above their faces.
        self._numbers = np.array(
            [self.names.index(name) << FACE_BITS if name in self.meshes else -1 for name in world.ground.names], np.int64
        )
        self._walked: set[int] = set()  # numbers of meshes that agents stand on

    def starts(self, population: Population) -> Rows:
        """The faces below agents by id, from which rays near their bodies walk: as `footholds.FACE_BITS` describes."""
        order, columns = population.in_id_order(), population.footing.columns
        if "face" not in columns or not self._numbers.size:
            return np.full(len(order), -1)
        mesh, face = columns["mesh"][order], columns["face"][order]
        number = np.where(mesh >= 0, self._numbers[mesh], -1)
        self._walked.update((self._numbers[np.flatnonzero(np.bincount(mesh + 1)[1:])] >> FACE_BITS).tolist())
        return np.where(number >= 0, number | face, -1)

    def cast(self, world: World, origin: Places, way: Places, starts: Rows, most_hit: bool = True) -> Found:
        """What the straight lines from `origin` by `way` hit first. `starts`: faces near the origins, or -1. `most_hit`: most are
        expected to end on what bodies walk on, so that Open3D need not test first which do. Neither changes an answer."""
        found, threads = Found.none(origin.shape[1]), world.options.threads
        walked = np.full(len(found.part), -1, np.int16)
        if isinstance(world.ground, Plane):
            _on_plane(world, origin, way, found)
        for k, name in enumerate(self.names):
            seen = world.obstacles.get(name)
            box = self._box_of(world, k, seen)
            if box is None:
                continue
            tables = seen.tables() if isinstance(seen, RayScene) and k not in self.moving else None
            if not isinstance(seen, RayScene) or tables is None:
                near = _meeting(box, origin, way)
            else:
                far = np.empty(len(found.part), np.int64)
                rings = seen.rings(threads) if k in self._walked else None
                if rings is not None:
                    work = partial(footholds.walk, tables, rings, k, origin, way, starts, found.columns, walked)
                    parallel.in_parts(work, len(far), threads, _RAYS)
                work = partial(footholds.cast, tables, box, k, origin, way, walked, found.columns, far)
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
        """The places nearest to points, of those within `reach` (mm, [k])."""
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
        """Put places, [3, …], on what moves where that is now."""
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
    """Feet that need ground: `requests` int64[k], the number of the agent times L plus that of the leg; `columns`: hip, wanted
    place and up of the body, (3, k), how far the foot joint may be from the hip (mm), and how high it is above its ground;
    `way` (3, k): from the hip past the wanted place; `starts` as `Floor.starts`. `is_quick`: the foot lifts, and looks again when
    it lands."""

    requests: Rows
    columns: Arrays
    way: Places
    starts: Rows
    is_quick: NDArray[np.bool_]

    @staticmethod
    def of(requests: Rows, given: tuple[Any, ...], threads: int) -> Seeking:
        """The feet of some requests; `given`: what `footholds.aim` takes next."""
        count = len(requests)
        room = np.empty((14, count))
        columns = room[:3], room[3:6], room[6:9], room[12], room[13]
        made = Seeking(requests, columns, room[9:12], np.empty(count, np.int64), np.empty(count, np.bool_))
        work = partial(footholds.aim, requests, *given, columns, (made.way, made.starts), made.is_quick)
        parallel.in_parts(work, count, threads, _RAYS)
        return made

    def settle(self, found: Found, columns: Arrays, threads: int) -> None:
        """Let feet have the ground that was found: `place`, `on`, `face` and `weight`, legs first."""
        work = partial(footholds.settle, self.requests, self.columns, found.columns, *columns)
        parallel.in_parts(work, len(self.requests), threads, _RAYS)


def seek(world: World, floor: Floor, seeking: Seeking) -> Found:
    """Ground for feet. Quick ones have only what is on the straight line, wherever that is."""
    threads, count = world.options.threads, len(seeking.requests)
    found = floor.cast(world, seeking.columns[0], seeking.way, seeking.starts)
    fits, rows = np.empty(count, np.bool_), np.empty(count, np.int64)
    work = partial(footholds.judge, seeking.columns, found.columns, seeking.is_quick, fits, rows)
    (rows,) = parallel.joined(parallel.in_parts(work, count, threads, _RAYS), rows)
    if rows.size:
        _look_around(world, floor, seeking, found, fits, rows)
    return found


def _look_around(world: World, floor: Floor, seeking: Seeking, found: Found, fits: NDArray[np.bool_], rows: Rows) -> None:
    """Ground for feet whose straight line does not lead to the wanted place: from above it, then the nearest."""
    threads, count = world.options.threads, len(rows)
    room = np.empty((13, count))
    above, to_above, down, hips, reach = room[:3], room[3:6], room[6:9], room[9:12], room[12]
    parallel.in_parts(partial(footholds.look_around, seeking.columns, rows, above, to_above, down, hips), count, threads, _RAYS)
    starts = seeking.starts[rows]
    level = floor.cast(world, hips, to_above, starts, most_hit=False)
    below = floor.cast(world, above, down, starts)
    lost = np.empty(count, np.int64)
    given = seeking.columns, rows, found.columns, fits, level.columns, below.columns, lost, reach
    parts = parallel.in_parts(partial(footholds.choose, *given), count, threads, _RAYS)
    lost, reach = parallel.joined(parts, lost, reach)
    if lost.size:
        rows, hips = rows[lost], np.ascontiguousarray(hips[:, lost])
        close = floor.nearest(world, np.ascontiguousarray(seeking.columns[1][:, rows]), reach)
        seen = floor.cast(world, hips, (close.place - hips) * (1.0 - _SHY), starts[lost])
        footholds.accept(seeking.columns, rows, close.columns, seen.columns, found.columns, 0, len(rows))


def _meeting(box: tuple[Places, Places], origin: Places, way: Places) -> Rows:
    """The rays that may meet a box."""
    low, high = np.minimum(origin, origin + way), np.maximum(origin, origin + way)
    return np.flatnonzero(((low <= box[1][:, None]) & (high >= box[0][:, None])).all(axis=0))


def _close(seen: RayScene, rows: Rows, origin: Places, way: Places) -> Rows:
    """Those of some rays that a mesh may be near: by the ball about each one's middle."""
    half = way * 0.5
    return _within(seen, rows, origin + half, _length(half))


def _within(seen: RayScene, rows: Rows, points: Places, reach: NDArray[np.float64]) -> Rows:
    """Those of some points that a mesh may be within `reach` of."""
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
