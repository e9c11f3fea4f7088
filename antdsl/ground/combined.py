"""Ground of meshes and solids together. An agent that meets a solid steps up onto it; an agent on a solid that meets a mesh steps
down.

Ground inside undug solid is closed. It is open again where the solid is dug away."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.mesh.topology import facing_sides
from antdsl.ground.protocol import Floats, Footing, GroundMove, MeshSurfaces
from antdsl.ground.solid import Volume
from antdsl.ground.solid import move as walk_on
from antdsl.ground.solid_queries import cast_down, cast_from_above, entry_fraction, normals
from antdsl.numerics.vector_rows import contiguous_columns, length, rows_in_box, take_rows, unit_tangent
from antdsl.numerics.vectors import turned

Rows = NDArray[np.intp]

_SUNK_VOXELS = 0.05  # depth in voxels below a solid's surface up to which mesh ground is still open
_MAX_SURFACE_CHANGES = 4  # most changes between meshes and solids in one step
_EYE_HEIGHT_PER_BODY = 0.02  # in body lengths: height above the path at which an agent searches for meshes


@dataclass(slots=True)
class _WalkState:
    """Agents during a walk: footings, orientations and remaining displacements (`left`). Each component of a vector is
    contiguous."""

    footing: Footing
    place: Floats
    up: Floats
    heading: Floats
    direction: Floats
    left: Floats
    distance: Floats
    blocked: NDArray[np.bool_]
    straight: bool  # paths on meshes end at open borders


@dataclass(slots=True)
class _SolidEntries:
    """Agents that entered undug solid: their numbers, the solid, the part of their path before the entry, and the position of the
    entry."""

    who: Rows
    which: NDArray[np.intp]
    part: Floats
    place: Floats


class CombinedGround:
    """Meshes (None without any) and solids by name. The names of solids come after those of meshes."""

    def __init__(self, meshes: MeshSurfaces | None, solids: Mapping[str, Volume], up: Floats) -> None:
        self.meshes = meshes
        self._up = np.asarray(up, np.float64)
        self._volumes = tuple(solids.values())
        self.names: tuple[str, ...] = (*(meshes.names if meshes is not None else ()), *solids)
        self._count = len(self.names) - len(self._volumes)

    # ---- asking

    def nowhere(self, n: int) -> Footing:
        """Return footings for n agents that stand on nothing yet."""
        return Footing.nowhere(n).with_places()

    def place(self, points: Floats, up: Floats, on: Iterable[str] | None = None) -> tuple[Footing, NDArray[np.bool_]]:
        """Return footings below points [n,3]: the first hit of a ray from far above along -`up`, on the names in `on`, or on all.

        No agent can stand on ground inside undug solid. Such a footing is moved to the solid's surface above, with False in the
        second array."""
        points = np.asarray(points, np.float64).reshape(-1, 3)
        names = self.names if on is None else tuple(on)
        unknown = [name for name in names if name not in self.names]
        if unknown:
            raise KeyError(f"no surface `{unknown[0]}` on this ground, which has {', '.join(self.names) or 'none'}")
        meshes = [name for name in names if name in self.names[: self._count]]
        footing, is_placed = self.nowhere(len(points)), np.zeros(len(points), np.bool_)
        if meshes and self.meshes is not None:
            on_mesh, is_placed = self.meshes.place(points, up, meshes)
            footing = on_mesh.with_places()
        up = np.broadcast_to(np.asarray(up, np.float64), points.shape)
        place = self.position(footing)
        known = footing.mesh >= 0
        height = np.where(known, ((place - points) * up).sum(axis=1), -np.inf)
        for k, volume in enumerate(self._volumes):
            is_requested = self.names[self._count + k] in names
            buried = known & (volume.sample(place) < -_SUNK_VOXELS * volume.voxel)
            rows = np.arange(len(points)) if is_requested else np.flatnonzero(buried)
            if not rows.size:
                continue
            top, is_hit = cast_from_above(volume, points[rows], up[rows])
            higher = is_hit & (((top - points[rows]) * up[rows]).sum(axis=1) > height[rows])
            higher |= is_hit & buried[rows]
            chosen = rows[higher]
            footing.put(chosen, Footing.on_solids(self._count + k, top[higher]))
            place[chosen] = top[higher]
            height[chosen] = ((top[higher] - points[chosen]) * up[chosen]).sum(axis=1)
            is_placed = is_placed.copy()
            is_placed[chosen] = is_requested
        return footing, is_placed

    def nearest(self, points: Floats, on: Iterable[str] | None = None) -> tuple[Footing, Floats]:
        """Return footings at the nearest point of meshes and solids, and the distance float64[n]. `on` limits the search to these
        names, if given."""
        points = np.asarray(points, np.float64).reshape(-1, 3)
        footing, distance = self.nowhere(len(points)), np.full(len(points), np.inf)
        names = self.names if on is None else tuple(on)
        meshes = [name for name in self.names[: self._count] if name in names]
        if meshes and self.meshes is not None:
            on_mesh, distance = self.meshes.nearest(points, meshes)
            footing, distance = on_mesh.with_places(), distance.copy()
        for k, volume in enumerate(self._volumes):
            if self.names[self._count + k] not in names:
                continue
            hints = volume.gradient(points).astype(np.float64)
            landed = volume.project(points, hints / np.maximum(length(hints), 1e-12)[:, None], volume.band[1])
            away = length(landed.points - points)
            rows = np.flatnonzero(landed.is_in_reach & (away < distance))
            footing.put(rows, Footing.on_solids(self._count + k, landed.points[rows]))
            distance[rows] = away[rows]
        return footing, distance

    def position(self, footing: Footing) -> Floats:
        """Return positions in the world, float64[n,3]; zero for agents without a footing."""
        place = np.stack([footing.x, footing.y, footing.z], axis=1)
        rows = self._mesh_rows(footing)
        if rows.size and self.meshes is not None:
            place[rows] = self.meshes.position(footing.take_on_meshes(rows))
        return place

    def normal(self, footing: Footing) -> Floats:
        """Return unit normals, float64[n,3]: of faces by their winding, of solids outwards; zero for agents without a footing."""
        normal = np.zeros((len(footing), 3))
        rows = self._mesh_rows(footing)
        if rows.size and self.meshes is not None:
            normal[rows] = self.meshes.normal(footing.take_on_meshes(rows))
        for k, volume in enumerate(self._volumes):
            rows = self._solid_rows(footing, k)
            if rows.size:
                normal[rows] = normals(volume, self.position(footing.take(rows)))
        return normal

    def sides(self, footing: Footing, threads: int = 1) -> NDArray[np.int8]:
        """Return the axis direction nearest to each normal, numbered as in `MeshGround.sides`."""
        rows = self._mesh_rows(footing)
        if rows.size == len(footing) and self.meshes is not None:
            return self.meshes.sides(footing.take_on_meshes(rows), threads)
        return np.where(footing.mesh >= 0, facing_sides(self.normal(footing)), np.int8(0))

    def upright_normals(self, footing: Footing, up: Floats) -> Floats:
        """Return smooth unit normals float64[n,3]: on meshes on the side that `up` points to, on solids outwards."""
        result = np.array(np.broadcast_to(np.asarray(up, np.float64), (len(footing), 3)))
        rows = self._mesh_rows(footing)
        if rows.size and self.meshes is not None:
            result[rows] = self.meshes.upright_normals(footing.take_on_meshes(rows), result[rows])
        for k, volume in enumerate(self._volumes):
            rows = self._solid_rows(footing, k)
            if rows.size:
                result[rows] = volume.upright_normals(self.position(footing.take(rows)), result[rows])
        return result

    # ---- moving

    def move(
        self,
        footing: Footing,
        displacement: Floats,
        heading: Floats,
        up: Floats,
        body: Floats | float,
        threads: int = 1,
        straight: bool = False,
    ) -> GroundMove:
        """Move agents over meshes and solids, as `MeshGround.move`."""
        n = len(footing)
        body = np.broadcast_to(np.asarray(body, np.float64), (n,))
        remaining = contiguous_columns(displacement)
        np.nan_to_num(remaining, copy=False, posinf=0.0, neginf=0.0)
        ahead = contiguous_columns(heading)
        walk = _WalkState(
            footing.copy(),
            np.empty((3, n)).T,
            contiguous_columns(up),
            ahead,
            ahead.copy("K"),
            remaining,
            np.zeros(n),
            np.zeros(n, np.bool_),
            straight,
        )
        rows = np.flatnonzero(footing.mesh >= 0)
        if rows.size < n:
            walk.place[:] = 0.0
        for hop in range(_MAX_SURFACE_CHANGES):
            if not rows.size:
                break
            rows = self._walk_stretch(walk, rows, body, threads, last=hop == _MAX_SURFACE_CHANGES - 1)
        lost = footing.mesh < 0
        return GroundMove(walk.footing, walk.place, walk.up, walk.heading, walk.direction, walk.distance, walk.blocked, lost)

    # ---- parts of moving

    def _walk_stretch(self, walk: _WalkState, rows: Rows, body: Floats, threads: int, last: bool) -> Rows:
        """Walk `rows` on their current mesh or solid. Agents that meet another one are then placed on it; return those with
        distance left."""
        again = []
        on = walk.footing.mesh[rows]
        mesh = rows[on < self._count]
        if mesh.size:
            again.append(self._walk_on_meshes(walk, mesh, body, threads, last))
        for k, volume in enumerate(self._volumes):
            mine = rows[on == self._count + k]
            if mine.size:
                again.append(self._walk_on_solid(walk, mine, k, volume, body, threads, last))
        return np.sort(np.concatenate(again))

    def _walk_on_meshes(self, walk: _WalkState, rows: Rows, body: Floats, threads: int, last: bool) -> Rows:
        """Walk `rows` over meshes, up to the first solid; return those with distance left."""
        meshes = self.meshes
        assert meshes is not None
        previous_footing = walk.footing.take_on_meshes(rows)
        wish, ahead, up = (take_rows(v, rows) for v in (walk.left, walk.heading, walk.up))
        moved = meshes.move(previous_footing, wish, ahead, up, body[rows], threads, walk.straight)
        entries = self._find_entries(moved.position, lambda who: meshes.position(previous_footing.take(who)))
        self._finish_walks(walk, rows, entries.who, moved)
        return self._step_onto_solid(walk, rows, entries, moved, body, threads, last)

    @staticmethod
    def _finish_walks(walk: _WalkState, rows: Rows, but: Rows, moved: GroundMove) -> None:
        """Store the results of all agents in `rows` that have finished their walk. The agents in `but` have not."""
        footing, vectors = moved.footing, [moved.position, moved.up, moved.heading, moved.direction]
        travelled, blocked = moved.travelled, moved.blocked
        if but.size:
            has_ended = np.ones(rows.size, np.bool_)
            has_ended[but] = False
            of = np.flatnonzero(has_ended)
            rows, footing = rows[of], footing.take(of)
            vectors = [take_rows(v, of) for v in vectors]
            travelled, blocked = travelled[of], blocked[of]
        walk.footing.put(rows, footing)
        for into, vector in zip((walk.place, walk.up, walk.heading, walk.direction), vectors, strict=True):
            for axis in range(3):
                into[rows, axis] = vector[:, axis]
        walk.distance[rows] += travelled
        walk.blocked[rows] |= blocked
        walk.left[rows] = 0.0

    def _find_entries(self, end: Floats, start: Callable[[Rows], Floats], but: int = -1) -> _SolidEntries:
        """Return the agents that enter undug solid on the path to `end`.

        `start` is a function that returns the start positions of some rows. Solid number `but` is ignored."""
        part, which = np.full(len(end), np.inf), np.zeros(len(end), np.intp)
        positions = np.zeros((len(end), 3))
        for k, volume in enumerate(self._volumes):
            if k == but:
                continue
            near = rows_in_box(end, volume.low, volume.high)
            inside = near[volume.sample(take_rows(end, near)) < -_SUNK_VOXELS * volume.voxel]
            if not inside.size:
                continue
            a, b = start(inside), end[inside]
            free = entry_fraction(volume, a, b)
            sooner = free < part[inside]
            chosen = inside[sooner]
            part[chosen], which[chosen] = free[sooner], k
            positions[chosen] = (a + free[:, None] * (b - a))[sooner]
        who = np.flatnonzero(part <= 1)
        return _SolidEntries(who, which[who], part[who], positions[who])

    def _step_onto_solid(
        self, walk: _WalkState, rows: Rows, entries: _SolidEntries, moved: GroundMove, body: Floats, threads: int, last: bool
    ) -> Rows:
        """Place the agents in `rows` that entered a solid on it; return those with distance left."""
        again = [np.empty(0, np.intp)]
        for k, volume in enumerate(self._volumes):
            mine = np.flatnonzero(entries.which == k)
            if not mine.size:
                continue
            of, part = entries.who[mine], entries.part[mine]
            # From a little above: an agent exactly at the seam might be below a mesh after its next step.
            above = entries.place[mine] + moved.up[of] * (_EYE_HEIGHT_PER_BODY * body[rows[of]])[:, None]
            landed = volume.project(above, normals(volume, above), 2 * volume.voxel)
            ok = landed.is_in_reach
            if self.meshes is not None:
                ok &= ~self.meshes.trace_hits(above, landed.points - above, threads)[0]
            shut = rows[of[~ok]]  # no reachable position: return to the start of the step
            walk.blocked[shut], walk.left[shut] = True, 0.0
            walk.place[shut] = self.position(walk.footing.take(shut))
            on, of, part = rows[of[ok]], of[ok], part[ok]
            normal, place = landed.normals[ok], landed.points[ok]
            previous_up, direction = moved.up[of], moved.direction[of]
            walk.heading[on] = turned(moved.heading[of].T, previous_up.T, normal.T, direction.T).T
            walk.direction[on] = turned(direction.T, previous_up.T, normal.T, direction.T).T
            walk.place[on], walk.up[on] = place, normal
            walk.distance[on] += moved.travelled[of] * part
            rest = np.zeros(len(on)) if last else moved.travelled[of] * (1 - part)
            walk.left[on] = walk.direction[on] * rest[:, None]
            walk.footing.put(on, Footing.on_solids(self._count + k, place))
            again.append(on[rest > 0])
        return np.concatenate(again)

    def _walk_on_solid(
        self, walk: _WalkState, rows: Rows, k: int, volume: Volume, body: Floats, threads: int, last: bool
    ) -> Rows:
        """Walk `rows` over solid number `k`, up to the first mesh; return those with distance left."""
        previous_footing = walk.footing
        start = np.stack([previous_footing.x[rows], previous_footing.y[rows], previous_footing.z[rows]]).T
        wish, ahead, up = (take_rows(v, rows) for v in (walk.left, walk.heading, walk.up))
        moved = walk_on(volume, start, wish, ahead, up, body[rows], self._count + k)
        is_hit, part, footing = self._find_mesh_crossings(start, moved.position, up, moved.up, body[rows], threads)
        entries = self._find_entries(moved.position, lambda who: start[who], k)
        earlier = entries.part < part[entries.who]
        entries = _SolidEntries(entries.who[earlier], entries.which[earlier], entries.part[earlier], entries.place[earlier])
        is_hit[entries.who] = False
        lost = moved.lost & ~is_hit
        lost[entries.who] = False
        other = is_hit | lost
        other[entries.who] = True
        self._finish_walks(walk, rows, np.flatnonzero(other), moved)
        self._fall(walk, rows[lost])
        again = self._step_onto_solid(walk, rows, entries, moved, body, threads, last)
        down = rows[is_hit]
        if not down.size or self.meshes is None:
            return again
        onto = footing.take(is_hit)
        normal = self.meshes.upright_normals(onto, start[is_hit] - moved.position[is_hit])  # the side from which the agents come
        tilted, direction = moved.up[is_hit], moved.direction[is_hit]
        walk.heading[down] = unit_tangent(turned(moved.heading[is_hit].T, tilted.T, normal.T, direction.T).T, normal)
        walk.direction[down] = turned(direction.T, tilted.T, normal.T, direction.T).T
        walk.footing.put(down, onto)
        walk.place[down], walk.up[down] = self.meshes.position(onto), normal
        walk.distance[down] += moved.travelled[is_hit] * part[is_hit]
        rest = np.zeros(len(down)) if last else moved.travelled[is_hit] * (1 - part[is_hit])
        walk.left[down] = walk.direction[down] * rest[:, None]
        return np.concatenate([again, down[rest > 0]])

    def _fall(self, walk: _WalkState, rows: Rows) -> None:
        """Move agents without a solid nearby down, along the scene's up axis, onto the ground below. If there is none, move them
        to the nearest ground."""
        if not rows.size:
            return
        start = self.position(walk.footing.take(rows))
        onto, _ = self.nearest(start)
        least = np.full(len(rows), np.inf)
        for k, volume in enumerate(self._volumes):
            reach = length(np.maximum(np.abs(volume.high - start), np.abs(start - volume.low)))
            place, is_hit = cast_down(volume, start, np.broadcast_to(self._up, start.shape), reach)
            drop = length(place - start)
            first = np.flatnonzero(is_hit & (drop < least))
            onto.put(first, Footing.on_solids(self._count + k, place[first]))
            least[first] = drop[first]
        if self.meshes is not None:
            far = self.meshes.extent + length(start - (self.meshes.low + self.meshes.high) / 2)
            is_hit, part, footing = self.meshes.trace_hits(start, -self._up * far[:, None])
            first = np.flatnonzero(is_hit & (part * far < least))
            onto.put(first, footing.take(first))
        walk.footing.put(rows, onto)
        walk.place[rows] = self.position(onto)
        normal = self.upright_normals(onto, walk.up[rows])
        walk.heading[rows] = walk.direction[rows] = unit_tangent(walk.heading[rows], normal)
        walk.up[rows], walk.left[rows] = normal, 0.0

    def _find_mesh_crossings(
        self, start: Floats, end: Floats, up: Floats, up_after: Floats, body: Floats, threads: int
    ) -> tuple[NDArray[np.bool_], Floats, Footing]:
        """Return which agents have a mesh across their path, as seen from slightly above the path. Return also the part of the
        path before the mesh, and the footing at the mesh."""
        n = len(start)
        if self.meshes is None:
            return np.zeros(n, np.bool_), np.ones(n), Footing.nowhere(n)
        lift = (_EYE_HEIGHT_PER_BODY * body)[:, None]
        a, b = start + up * lift, end + up_after * lift
        return self.meshes.trace_hits(a, b - a, threads)

    # ---- footings

    def _mesh_rows(self, footing: Footing) -> Rows:
        """Return the rows of footings on meshes."""
        return np.flatnonzero((footing.mesh >= 0) & (footing.mesh < self._count))

    def _solid_rows(self, footing: Footing, k: int) -> Rows:
        """Return the rows of footings on solid number `k`."""
        return np.flatnonzero(footing.mesh == self._count + k)
