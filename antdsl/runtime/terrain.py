"""Ground of meshes and solids together, behind the doors of `senses.ground.Ground`: who meets a hill steps up onto it, who meets
a mesh steps back down; ground inside undug solid is closed, and open again where the solid is dug away."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.runtime.senses.ground import Footing, Ground, MoveResult
from antdsl.runtime.senses.topology import facing
from antdsl.runtime.senses.walk import turned
from antdsl.runtime.solids import Volume
from antdsl.runtime.solids import move as walk_on
from antdsl.runtime.standing import Standing

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]

_SUNK = 0.05  # voxels that a mesh's ground may lie under a solid's surface and still be walked on
_HOPS = 4  # from mesh to solid and back in one step
_LIFT = 0.02  # of a body: how far above its way an agent looks for a mesh across it
_HALVINGS = 12
_PARTS = 8  # of a step at which it is looked whether it leads into a solid


@dataclass(slots=True)
class _Walk:
    """Agents on their way: where they stand and face, and what is left of their way (a vector)."""

    standing: Standing
    place: Floats
    up: Floats
    heading: Floats
    direction: Floats
    left: Floats
    gone: Floats
    blocked: NDArray[np.bool_]


class Terrain:
    """Meshes (a `Ground`, or None without any) and solids by name; names of solids come after those of meshes."""

    def __init__(self, ground: Ground | None, solids: Mapping[str, Volume]) -> None:
        self.meshes = ground
        self._volumes = tuple(solids.values())
        self.names = (*(ground.names if ground is not None else ()), *solids)
        self._count = len(self.names) - len(self._volumes)

    def with_meshes(self, ground: Ground) -> Terrain:
        """The same solids with other meshes of the same names."""
        return Terrain(ground, dict(zip(self.names[self._count :], self._volumes, strict=True)))

    # ---- asking

    def place(self, points: Floats, up: Floats, on: Iterable[str] | None = None) -> tuple[Standing, NDArray[np.bool_]]:
        """Footings below points [n,3]: the first that a ray from far above along -`up` meets, of the names in `on` or of all.

        Ground inside undug solid is no place to stand: there it is the solid's surface above, and False in the second array."""
        points = np.asarray(points, np.float64).reshape(-1, 3)
        names = self.names if on is None else tuple(on)
        unknown = [name for name in names if name not in self.names]
        if unknown:
            raise KeyError(f"no surface `{unknown[0]}` on this ground, which has {', '.join(self.names) or 'none'}")
        meshes = [name for name in names if name in self.names[: self._count]]
        standing, found = Standing.on_mesh(Footing.nowhere(len(points))), np.zeros(len(points), np.bool_)
        if meshes and self.meshes is not None:
            footing, found = self.meshes.place(points, up, meshes)
            standing = Standing.on_mesh(footing)
        up = np.broadcast_to(np.asarray(up, np.float64), points.shape)
        place = self.position(standing)
        known = standing.mesh >= 0
        height = np.where(known, ((place - points) * up).sum(axis=1), -np.inf)
        for k, volume in enumerate(self._volumes):
            asked = self.names[self._count + k] in names
            buried = known & (volume.sample(place) < -_SUNK * volume.voxel)
            rows = np.arange(len(points)) if asked else np.flatnonzero(buried)
            if not rows.size:
                continue
            top, met = _dropped(volume, points[rows], up[rows])
            higher = met & (((top - points[rows]) * up[rows]).sum(axis=1) > height[rows])
            higher |= met & buried[rows]
            chosen = rows[higher]
            standing.put(chosen, Standing.on_solid(self._count + k, top[higher]))
            place[chosen] = top[higher]
            height[chosen] = ((top[higher] - points[chosen]) * up[chosen]).sum(axis=1)
            found = found.copy()
            found[chosen] = asked
        return standing, found

    def nearest(self, points: Floats) -> tuple[Standing, Floats]:
        """Footings at the nearest point of the meshes, or of the solids where those are nearer, and the distance float64[n]."""
        points = np.asarray(points, np.float64).reshape(-1, 3)
        standing, distance = Standing.on_mesh(Footing.nowhere(len(points))), np.full(len(points), np.inf)
        if self.meshes is not None:
            footing, distance = self.meshes.nearest(points)
            standing, distance = Standing.on_mesh(footing), distance.copy()
        for k, volume in enumerate(self._volumes):
            hints = volume.gradient(points).astype(np.float64)
            landed = volume.project(points, hints / np.maximum(_length(hints), 1e-12)[:, None], volume.band[1])
            away = _length(landed.points - points)
            rows = np.flatnonzero(landed.found & (away < distance))
            standing.put(rows, Standing.on_solid(self._count + k, landed.points[rows]))
            distance[rows] = away[rows]
        return standing, distance

    def position(self, standing: Standing) -> Floats:
        """Places in the world, float64[n,3]; zero for footings nowhere."""
        place = np.stack([standing.x, standing.y, standing.z], axis=1)
        rows = self._mesh_rows(standing)
        if rows.size and self.meshes is not None:
            place[rows] = self.meshes.position(standing.footing(rows))
        return place

    def normal(self, standing: Standing) -> Floats:
        """Unit normals, float64[n,3]: of the faces by how they are wound, out of the solids; zero for footings nowhere."""
        normal = np.zeros((len(standing), 3))
        rows = self._mesh_rows(standing)
        if rows.size and self.meshes is not None:
            normal[rows] = self.meshes.normal(standing.footing(rows))
        for k, volume in enumerate(self._volumes):
            rows = self._solid_rows(standing, k)
            if rows.size:
                normal[rows] = _normals(volume, self.position(standing.take(rows)))
        return normal

    def sides(self, standing: Standing) -> NDArray[np.int64]:
        """Which of six ways the normals point most, as `Ground.sides`."""
        rows = self._mesh_rows(standing)
        if rows.size == len(standing) and self.meshes is not None:
            return self.meshes.sides(standing.footing(rows))
        return np.where(standing.mesh >= 0, facing(self.normal(standing)), 0)

    def upright(self, standing: Standing, up: Floats) -> Floats:
        """Smooth unit normals float64[n,3]: on meshes on the side that `up` points to, on solids outwards."""
        result = np.array(np.broadcast_to(np.asarray(up, np.float64), (len(standing), 3)))
        rows = self._mesh_rows(standing)
        if rows.size and self.meshes is not None:
            result[rows] = self.meshes.upright(standing.footing(rows), result[rows])
        for k, volume in enumerate(self._volumes):
            rows = self._solid_rows(standing, k)
            if rows.size:
                result[rows] = volume.upright(self.position(standing.take(rows)), result[rows])
        return result

    # ---- moving

    def move(
        self, standing: Standing, displacement: Floats, heading: Floats, up: Floats, body: Floats | float, threads: int = 1
    ) -> MoveResult:
        """As `Ground.move`, over meshes and solids."""
        n = len(standing)
        body = np.broadcast_to(np.asarray(body, np.float64), (n,))
        way = np.nan_to_num(np.asarray(displacement, np.float64), posinf=0.0, neginf=0.0)
        if way is displacement:
            way = way.copy()
        walk = _Walk(
            standing.take(np.arange(n)), self.position(standing), np.array(up, np.float64), np.array(heading, np.float64),
            np.array(heading, np.float64), way, np.zeros(n), np.zeros(n, np.bool_),
        )  # fmt: skip
        rows = np.flatnonzero(standing.mesh >= 0)
        for hop in range(_HOPS):
            if not rows.size:
                break
            rows = self._stretch(walk, rows, body, threads, last=hop == _HOPS - 1)
        return MoveResult(
            walk.standing,  # type: ignore[arg-type]  # a ground has footings of its own kind
            walk.place,
            walk.up,
            walk.heading,
            walk.direction,
            walk.gone,
            walk.blocked,
            standing.mesh < 0,
        )

    # ---- parts of moving

    def _stretch(self, walk: _Walk, rows: Rows, body: Floats, threads: int, last: bool) -> Rows:
        """Walk `rows` on what they stand on; those who meet something else stand on that, and are returned if way is left."""
        again = []
        on = walk.standing.mesh[rows]
        mesh = rows[on < self._count]
        if mesh.size:
            again.append(self._on_meshes(walk, mesh, body, threads, last))
        for k, volume in enumerate(self._volumes):
            mine = rows[on == self._count + k]
            if mine.size:
                again.append(self._on_volume(walk, mine, k, volume, body, threads, last))
        return np.concatenate(again)

    def _on_meshes(self, walk: _Walk, rows: Rows, body: Floats, threads: int, last: bool) -> Rows:
        assert self.meshes is not None
        start = walk.place[rows]
        moved = self.meshes.move(
            walk.standing.footing(rows), walk.left[rows], walk.heading[rows], walk.up[rows], body[rows], threads
        )
        entered, which, part = self._entering(start, moved.position)
        free = ~entered
        stay = rows[free]
        walk.standing.put(stay, Standing.on_mesh(moved.footing.take(free)))
        walk.place[stay], walk.up[stay] = moved.position[free], moved.up[free]
        walk.heading[stay], walk.direction[stay] = moved.heading[free], moved.direction[free]
        walk.gone[stay] += moved.travelled[free]
        walk.blocked[stay] |= moved.blocked[free]
        walk.left[stay] = 0.0
        return self._step_up(walk, rows, start, moved.position, moved, entered, which, part, body, threads, last)

    def _entering(self, start: Floats, end: Floats, but: int = -1) -> tuple[NDArray[np.bool_], NDArray[np.intp], Floats]:
        """Whose way leads into undug solid (any but one), into which, and after what part of it."""
        n = len(start)
        entered, which, part = np.zeros(n, np.bool_), np.zeros(n, np.intp), np.ones(n)
        for k, volume in enumerate(self._volumes):
            if k == but:
                continue
            deep = -_SUNK * volume.voxel
            near = np.flatnonzero(((end >= volume.low) & (end <= volume.high)).all(axis=1))
            inside = near[volume.sample(end[near]) < deep]
            if not inside.size:
                continue
            a, b = start[inside], end[inside]
            free, shut = np.zeros(len(inside)), np.ones(len(inside))
            for step in range(_PARTS - 1, -1, -1):  # the first of the parts that lies in it
                t = step / _PARTS
                solid = volume.sample(a + t * (b - a)) < 0
                shut = np.where(solid, t, shut)
                free = np.where(solid, max(t - 1 / _PARTS, 0.0), free)
            free = np.minimum(np.maximum(shut - 1 / _PARTS, 0.0), shut)
            for _ in range(_HALVINGS):
                middle = (free + shut) / 2
                solid = volume.sample(a + middle[:, None] * (b - a)) < 0
                free, shut = np.where(solid, free, middle), np.where(solid, middle, shut)
            sooner = ~entered[inside] | (free < part[inside])
            chosen = inside[sooner]
            entered[chosen], which[chosen], part[chosen] = True, k, free[sooner]
        return entered, which, part

    def _step_up(
        self,
        walk: _Walk,
        rows: Rows,
        start: Floats,
        end: Floats,
        moved: Any,
        entered: NDArray[np.bool_],
        which: NDArray[np.intp],
        part: Floats,
        body: Floats,
        threads: int,
        last: bool,
    ) -> Rows:
        """Those of `rows` who `entered` a solid after a `part` of their way step onto it; gives those with way left."""
        again = [np.empty(0, np.intp)]
        for k, volume in enumerate(self._volumes):
            of = np.flatnonzero(entered & (which == k))
            if not of.size:
                continue
            # From a little above: who stood at the very seam might find itself below a mesh with its next step.
            above = start[of] + part[of, None] * (end[of] - start[of]) + moved.up[of] * (_LIFT * body[rows[of]])[:, None]
            landed = volume.project(above, _normals(volume, above), 2 * volume.voxel)
            ok = landed.found
            if self.meshes is not None:
                ok &= ~self.meshes.met(above, landed.points - above, threads)[0]
            shut = rows[of[~ok]]
            walk.blocked[shut], walk.left[shut] = True, 0.0  # no place that can be reached: stay where the step began
            on, of = rows[of[ok]], of[ok]
            normal, place = landed.normals[ok], landed.points[ok]
            before, way = moved.up[of], moved.direction[of]
            walk.heading[on] = turned(moved.heading[of].T, before.T, normal.T, way.T).T
            walk.direction[on] = turned(way.T, before.T, normal.T, way.T).T
            walk.place[on], walk.up[on] = place, normal
            walk.gone[on] += moved.travelled[of] * part[of]
            rest = np.zeros(len(on)) if last else moved.travelled[of] * (1 - part[of])
            walk.left[on] = walk.direction[on] * rest[:, None]
            walk.standing.put(on, Standing.on_solid(self._count + k, place))
            again.append(on[rest > 0])
        return np.concatenate(again)

    def _on_volume(self, walk: _Walk, rows: Rows, k: int, volume: Volume, body: Floats, threads: int, last: bool) -> Rows:
        start = walk.place[rows]
        moved = walk_on(volume, start, walk.left[rows], walk.heading[rows], walk.up[rows], body[rows])
        met, part, footing = self._across(start, moved.points, walk.up[rows], moved.up, body[rows], threads)
        entered, which, sooner = self._entering(start, moved.points, k)
        entered &= sooner < part
        met &= ~entered
        self._fall(walk, rows[moved.lost & ~met & ~entered])
        free = ~met & ~entered & ~moved.lost
        stay = rows[free]
        walk.standing.put(stay, Standing.on_solid(self._count + k, moved.points[free]))
        walk.place[stay], walk.up[stay] = moved.points[free], moved.up[free]
        walk.heading[stay], walk.direction[stay] = moved.heading[free], moved.direction[free]
        walk.gone[stay] += moved.travelled[free]
        walk.blocked[stay] |= moved.blocked[free]
        walk.left[stay] = 0.0
        again = self._step_up(walk, rows, start, moved.points, moved, entered, which, sooner, body, threads, last)
        down = rows[met]
        if not down.size or self.meshes is None:
            return again
        onto = footing.take(met)
        normal = self.meshes.upright(onto, start[met] - moved.points[met])  # the side that they come from
        before, way = moved.up[met], moved.direction[met]
        walk.heading[down] = _level(turned(moved.heading[met].T, before.T, normal.T, way.T).T, normal)
        walk.direction[down] = turned(way.T, before.T, normal.T, way.T).T
        walk.standing.put(down, Standing.on_mesh(onto))
        walk.place[down], walk.up[down] = self.meshes.position(onto), normal
        walk.gone[down] += moved.travelled[met] * part[met]
        rest = np.zeros(len(down)) if last else moved.travelled[met] * (1 - part[met])
        walk.left[down] = walk.direction[down] * rest[:, None]
        return np.concatenate([again, down[rest > 0]])

    def _fall(self, walk: _Walk, rows: Rows) -> None:
        """Nothing of the solid is left near by: down to what is nearest."""
        if not rows.size:
            return
        onto, _ = self.nearest(walk.place[rows])
        walk.standing.put(rows, onto)
        walk.place[rows] = self.position(onto)
        normal = self.upright(onto, walk.up[rows])
        walk.heading[rows] = walk.direction[rows] = _level(walk.heading[rows], normal)
        walk.up[rows], walk.left[rows] = normal, 0.0

    def _across(
        self, start: Floats, end: Floats, up: Floats, up_after: Floats, body: Floats, threads: int
    ) -> tuple[NDArray[np.bool_], Floats, Footing]:
        """Whose way a mesh lies across, seen from a little above it; after what part, and the footing there."""
        n = len(start)
        if self.meshes is None:
            return np.zeros(n, np.bool_), np.ones(n), Footing.nowhere(n)
        lift = (_LIFT * body)[:, None]
        a, b = start + up * lift, end + up_after * lift
        return self.meshes.met(a, b - a, threads)

    # ---- footings

    def _mesh_rows(self, standing: Standing) -> Rows:
        return np.flatnonzero((standing.mesh >= 0) & (standing.mesh < self._count))

    def _solid_rows(self, standing: Standing, k: int) -> Rows:
        return np.flatnonzero(standing.mesh == self._count + k)


def _normals(volume: Volume, place: Floats) -> Floats:
    """Unit normals float64[n,3] out of a solid; zero where its field is flat."""
    slope = volume.gradient(place).astype(np.float64)
    normal: Floats = slope / np.maximum(_length(slope), 1e-12)[:, None]
    return normal


def _length(v: Floats) -> Floats:
    length: Floats = np.sqrt((v * v).sum(axis=1))
    return length


def _level(v: Floats, normal: Floats) -> Floats:
    """Unit vectors at right angles to the normals."""
    flat = v - (v * normal).sum(axis=1)[:, None] * normal
    level: Floats = flat / np.maximum(_length(flat), 1e-12)[:, None]
    return level


def _dropped(volume: Volume, points: Floats, up: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """The first place of a solid that a ray from far above along -`up` meets, and whether there is one."""
    from antdsl.runtime.senses.solid_feelers import SolidFeelers

    height = float(_length((volume.high - volume.low)[None, :])[0])
    middle = (volume.low + volume.high) / 2
    start = points + up * (((middle - points) * up).sum(axis=1) + height)[:, None]
    hits = SolidFeelers(volume).feelers(*start.T, -up[:, 0], -up[:, 1], -up[:, 2], 2 * height)
    place = start - up * np.where(hits.hit, hits.t, 0.0)[:, None]
    landed = volume.project(place, up, 2 * volume.voxel)
    return landed.points, hits.hit & landed.found
