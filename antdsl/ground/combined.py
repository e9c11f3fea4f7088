"""A ground of meshes and solids. Agents can step from meshes onto solids and back.

Agents cannot walk on parts of a mesh that are inside a solid, until the solid is dug away there."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.mesh.topology import classify_normal_directions
from antdsl.ground.protocol import Floats, Footing, GroundMove, MeshSurfaces
from antdsl.ground.solid import Volume
from antdsl.ground.solid import move_over_solid as walk_on
from antdsl.ground.solid_queries import compute_solid_normals, find_entry_fraction, find_points_below, find_top_points
from antdsl.numerics.vector_rows import compute_unit_tangents, find_rows_in_box, length, make_columns_contiguous, take_rows
from antdsl.numerics.vectors import rotate_between_normals

Rows = NDArray[np.intp]

_OPEN_DEPTH_VOXELS = 0.05  # voxels below a solid's surface; mesh ground down to this depth is still open
_MAX_SURFACE_CHANGES = 4  # maximum number of changes between meshes and solids in one step
_EYE_HEIGHT_BODY_LENGTHS = 0.02  # body lengths above the path from which an agent searches for meshes


@dataclass(slots=True)
class _CombinedWalk:
    """The state of n agents during a walk. Vectors are float64[n,3], with contiguous components."""

    footing: Footing
    place: Floats
    up: Floats
    heading: Floats
    direction: Floats
    remaining_displacements: Floats
    distance: Floats
    is_blocked: NDArray[np.bool_]
    stops_at_borders: bool  # paths on meshes end at open borders


@dataclass(slots=True)
class _SolidEntries:
    """The agents that enter a solid: rows, numbers of the solids, fractions of the paths before the entries, and entry
    positions."""

    rows: Rows
    solids: NDArray[np.intp]
    path_fraction: Floats
    place: Floats


class CombinedGround:
    """A ground of meshes and named solids. `meshes` is None if the ground has no meshes. Names of solids come after names of
    meshes."""

    def __init__(self, meshes: MeshSurfaces | None, solids: Mapping[str, Volume], up: Floats) -> None:
        self.meshes = meshes
        self._up = np.asarray(up, np.float64)
        self._volumes = tuple(solids.values())
        self.names: tuple[str, ...] = (*(meshes.names if meshes is not None else ()), *solids)
        self._count = len(self.names) - len(self._volumes)

    # ---- asking

    def create_unplaced(self, n: int) -> Footing:
        """Return footings for n agents that have no position on the ground yet."""
        return Footing.create_unplaced(n).with_position_columns()

    def place_points(
        self, points: Floats, up: Floats, surface_names: Iterable[str] | None = None
    ) -> tuple[Footing, NDArray[np.bool_]]:
        """Return footings below points [n,3]. Each is the first hit of a ray from far above the point along -`up`.

        `surface_names`: the surfaces and solids that rays can hit; None means all. A footing inside a solid is moved up to the
        solid's surface. The second array is False if this solid is not in `surface_names`, or if the ray hits nothing."""
        points = np.asarray(points, np.float64).reshape(-1, 3)
        names = self.names if surface_names is None else tuple(surface_names)
        unknown = [name for name in names if name not in self.names]
        if unknown:
            raise KeyError(f"this ground has no surface `{unknown[0]}`; its surfaces are: {', '.join(self.names) or 'none'}")
        meshes = [name for name in names if name in self.names[: self._count]]
        footing, is_placed = self.create_unplaced(len(points)), np.zeros(len(points), np.bool_)
        if meshes and self.meshes is not None:
            on_mesh, is_placed = self.meshes.place_points(points, up, meshes)
            footing = on_mesh.with_position_columns()
        up = np.broadcast_to(np.asarray(up, np.float64), points.shape)
        place = self.position(footing)
        known = footing.mesh >= 0
        height = np.where(known, ((place - points) * up).sum(axis=1), -np.inf)
        for k, volume in enumerate(self._volumes):
            is_requested = self.names[self._count + k] in names
            buried = known & (volume.sample_distances(place) < -_OPEN_DEPTH_VOXELS * volume.voxel)
            rows = np.arange(len(points)) if is_requested else np.flatnonzero(buried)
            if not rows.size:
                continue
            top, is_hit = find_top_points(volume, points[rows], up[rows])
            higher = is_hit & (((top - points[rows]) * up[rows]).sum(axis=1) > height[rows])
            higher |= is_hit & buried[rows]
            chosen = rows[higher]
            footing.write_rows(chosen, Footing.from_solids(self._count + k, top[higher]))
            place[chosen] = top[higher]
            height[chosen] = ((top[higher] - points[chosen]) * up[chosen]).sum(axis=1)
            is_placed = is_placed.copy()
            is_placed[chosen] = is_requested
        return footing, is_placed

    def find_nearest(self, points: Floats, surface_names: Iterable[str] | None = None) -> tuple[Footing, Floats]:
        """Return the nearest point of meshes and solids as a footing, and its distance float64[n].

        `surface_names`: the names to search; None means all."""
        points = np.asarray(points, np.float64).reshape(-1, 3)
        footing, distance = self.create_unplaced(len(points)), np.full(len(points), np.inf)
        names = self.names if surface_names is None else tuple(surface_names)
        meshes = [name for name in self.names[: self._count] if name in names]
        if meshes and self.meshes is not None:
            on_mesh, distance = self.meshes.find_nearest(points, meshes)
            footing, distance = on_mesh.with_position_columns(), distance.copy()
        for k, volume in enumerate(self._volumes):
            if self.names[self._count + k] not in names:
                continue
            hints = volume.sample_gradients(points).astype(np.float64)
            landed = volume.project_to_surface(points, hints / np.maximum(length(hints), 1e-12)[:, None], volume.distance_band[1])
            away = length(landed.points - points)
            rows = np.flatnonzero(landed.is_in_reach & (away < distance))
            footing.write_rows(rows, Footing.from_solids(self._count + k, landed.points[rows]))
            distance[rows] = away[rows]
        return footing, distance

    def position(self, footing: Footing) -> Floats:
        """Return positions in the world, float64[n,3]; zero for agents without a footing."""
        place = np.stack([footing.x, footing.y, footing.z], axis=1)
        rows = self._find_mesh_rows(footing)
        if rows.size and self.meshes is not None:
            place[rows] = self.meshes.position(footing.select_rows_on_meshes(rows))
        return place

    def normal(self, footing: Footing) -> Floats:
        """Return unit normals, float64[n,3]: by winding on faces, outwards on solids, and zero for agents without a footing."""
        normal = np.zeros((len(footing), 3))
        rows = self._find_mesh_rows(footing)
        if rows.size and self.meshes is not None:
            normal[rows] = self.meshes.normal(footing.select_rows_on_meshes(rows))
        for k, volume in enumerate(self._volumes):
            rows = self._find_solid_rows(footing, k)
            if rows.size:
                normal[rows] = compute_solid_normals(volume, self.position(footing.select_rows(rows)))
        return normal

    def find_sides(self, footing: Footing, threads: int = 1) -> NDArray[np.int8]:
        """Return the axis direction nearest to each normal, int8[n], with the numbers of `MeshGround.find_sides`."""
        rows = self._find_mesh_rows(footing)
        if rows.size == len(footing) and self.meshes is not None:
            return self.meshes.find_sides(footing.select_rows_on_meshes(rows), threads)
        return np.where(footing.mesh >= 0, classify_normal_directions(self.normal(footing)), np.int8(0))

    def compute_upright_normals(self, footing: Footing, up: Floats) -> Floats:
        """Return smooth unit normals float64[n,3]. On meshes they are on the side of `up`, on solids they point outwards."""
        result = np.array(np.broadcast_to(np.asarray(up, np.float64), (len(footing), 3)))
        rows = self._find_mesh_rows(footing)
        if rows.size and self.meshes is not None:
            result[rows] = self.meshes.compute_upright_normals(footing.select_rows_on_meshes(rows), result[rows])
        for k, volume in enumerate(self._volumes):
            rows = self._find_solid_rows(footing, k)
            if rows.size:
                result[rows] = volume.compute_upright_normals(self.position(footing.select_rows(rows)), result[rows])
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
        stop_at_borders: bool = False,
    ) -> GroundMove:
        """Move agents over meshes and solids. The arguments are those of `MeshGround.move`."""
        n = len(footing)
        body = np.broadcast_to(np.asarray(body, np.float64), (n,))
        remaining = make_columns_contiguous(displacement)
        np.nan_to_num(remaining, copy=False, posinf=0.0, neginf=0.0)
        ahead = make_columns_contiguous(heading)
        walk = _CombinedWalk(
            footing.copy(),
            np.empty((3, n)).T,
            make_columns_contiguous(up),
            ahead,
            ahead.copy("K"),
            remaining,
            np.zeros(n),
            np.zeros(n, np.bool_),
            stop_at_borders,
        )
        rows = np.flatnonzero(footing.mesh >= 0)
        if rows.size < n:
            walk.place[:] = 0.0
        for hop in range(_MAX_SURFACE_CHANGES):
            if not rows.size:
                break
            rows = self._walk_until_surface_change(walk, rows, body, threads, is_last=hop == _MAX_SURFACE_CHANGES - 1)
        lost = footing.mesh < 0
        return GroundMove(walk.footing, walk.place, walk.up, walk.heading, walk.direction, walk.distance, walk.is_blocked, lost)

    # ---- parts of moving

    def _walk_until_surface_change(self, walk: _CombinedWalk, rows: Rows, body: Floats, threads: int, is_last: bool) -> Rows:
        """Walk `rows` on their current mesh or solid. Place agents that reach another mesh or solid on it. Return the rows of
        agents that have not finished."""
        again = []
        on = walk.footing.mesh[rows]
        mesh = rows[on < self._count]
        if mesh.size:
            again.append(self._walk_on_meshes(walk, mesh, body, threads, is_last))
        for k, volume in enumerate(self._volumes):
            mine = rows[on == self._count + k]
            if mine.size:
                again.append(self._walk_on_solid(walk, mine, k, volume, body, threads, is_last))
        return np.sort(np.concatenate(again))

    def _walk_on_meshes(self, walk: _CombinedWalk, rows: Rows, body: Floats, threads: int, is_last: bool) -> Rows:
        """Walk `rows` over meshes, up to the first solid. Return the rows of agents that have not finished."""
        meshes = self.meshes
        assert meshes is not None
        previous_footing = walk.footing.select_rows_on_meshes(rows)
        wish, ahead, up = (take_rows(v, rows) for v in (walk.remaining_displacements, walk.heading, walk.up))
        moved = meshes.move(previous_footing, wish, ahead, up, body[rows], threads, walk.stops_at_borders)
        entries = self._find_solid_entries(moved.position, lambda rows: meshes.position(previous_footing.select_rows(rows)))
        self._finish_walks(walk, rows, entries.rows, moved)
        return self._step_onto_solid(walk, rows, entries, moved, body, threads, is_last)

    @staticmethod
    def _finish_walks(walk: _CombinedWalk, rows: Rows, unfinished_rows: Rows, move: GroundMove) -> None:
        """Store the walk results of the agents in `rows`. Leave out `unfinished_rows`, which are indices into `rows`."""
        footing, vectors = move.footing, [move.position, move.up, move.heading, move.direction]
        travelled, blocked = move.travelled, move.is_blocked
        if unfinished_rows.size:
            has_ended = np.ones(rows.size, np.bool_)
            has_ended[unfinished_rows] = False
            of = np.flatnonzero(has_ended)
            rows, footing = rows[of], footing.select_rows(of)
            vectors = [take_rows(v, of) for v in vectors]
            travelled, blocked = travelled[of], blocked[of]
        walk.footing.write_rows(rows, footing)
        for into, vector in zip((walk.place, walk.up, walk.heading, walk.direction), vectors, strict=True):
            for axis in range(3):
                into[rows, axis] = vector[:, axis]
        walk.distance[rows] += travelled
        walk.is_blocked[rows] |= blocked
        walk.remaining_displacements[rows] = 0.0

    def _find_solid_entries(self, end: Floats, start: Callable[[Rows], Floats], ignored_solid: int = -1) -> _SolidEntries:
        """Return the agents that enter a solid on their paths to `end` [n,3].

        `start`: a function that returns the start positions of given rows. `ignored_solid`: the number of a solid to ignore."""
        part, which = np.full(len(end), np.inf), np.zeros(len(end), np.intp)
        positions = np.zeros((len(end), 3))
        for k, volume in enumerate(self._volumes):
            if k == ignored_solid:
                continue
            near = find_rows_in_box(end, volume.low, volume.high)
            inside = near[volume.sample_distances(take_rows(end, near)) < -_OPEN_DEPTH_VOXELS * volume.voxel]
            if not inside.size:
                continue
            a, b = start(inside), end[inside]
            free = find_entry_fraction(volume, a, b)
            sooner = free < part[inside]
            chosen = inside[sooner]
            part[chosen], which[chosen] = free[sooner], k
            positions[chosen] = (a + free[:, None] * (b - a))[sooner]
        who = np.flatnonzero(part <= 1)
        return _SolidEntries(who, which[who], part[who], positions[who])

    def _step_onto_solid(
        self, walk: _CombinedWalk, rows: Rows, entries: _SolidEntries, move: GroundMove, body: Floats, threads: int, is_last: bool
    ) -> Rows:
        """Place each agent of `entries` on the surface of the solid that it enters. Return the rows of agents that have not
        finished."""
        again = [np.empty(0, np.intp)]
        for k, volume in enumerate(self._volumes):
            mine = np.flatnonzero(entries.solids == k)
            if not mine.size:
                continue
            of, part = entries.rows[mine], entries.path_fraction[mine]
            # From slightly above: an agent exactly at the seam might be below a mesh after its next step.
            above = entries.place[mine] + move.up[of] * (_EYE_HEIGHT_BODY_LENGTHS * body[rows[of]])[:, None]
            landed = volume.project_to_surface(above, compute_solid_normals(volume, above), 2 * volume.voxel)
            ok = landed.is_in_reach
            if self.meshes is not None:
                ok &= ~self.meshes.find_path_hits(above, landed.points - above, threads)[0]
            shut = rows[of[~ok]]  # no reachable position, so they return to the start of the step
            walk.is_blocked[shut], walk.remaining_displacements[shut] = True, 0.0
            walk.place[shut] = self.position(walk.footing.select_rows(shut))
            on, of, part = rows[of[ok]], of[ok], part[ok]
            normal, place = landed.normals[ok], landed.points[ok]
            previous_up, direction = move.up[of], move.direction[of]
            walk.heading[on] = rotate_between_normals(move.heading[of].T, previous_up.T, normal.T, direction.T).T
            walk.direction[on] = rotate_between_normals(direction.T, previous_up.T, normal.T, direction.T).T
            walk.place[on], walk.up[on] = place, normal
            walk.distance[on] += move.travelled[of] * part
            rest = np.zeros(len(on)) if is_last else move.travelled[of] * (1 - part)
            walk.remaining_displacements[on] = walk.direction[on] * rest[:, None]
            walk.footing.write_rows(on, Footing.from_solids(self._count + k, place))
            again.append(on[rest > 0])
        return np.concatenate(again)

    def _walk_on_solid(
        self, walk: _CombinedWalk, rows: Rows, k: int, volume: Volume, body: Floats, threads: int, is_last: bool
    ) -> Rows:
        """Walk `rows` over solid number `k`, up to the first mesh. Return the rows of agents that have not finished."""
        previous_footing = walk.footing
        start = np.stack([previous_footing.x[rows], previous_footing.y[rows], previous_footing.z[rows]]).T
        wish, ahead, up = (take_rows(v, rows) for v in (walk.remaining_displacements, walk.heading, walk.up))
        moved = walk_on(volume, start, wish, ahead, up, body[rows], self._count + k)
        is_hit, part, footing = self._find_mesh_crossings(start, moved.position, up, moved.up, body[rows], threads)
        entries = self._find_solid_entries(moved.position, lambda rows: start[rows], k)
        earlier = entries.path_fraction < part[entries.rows]
        entries = _SolidEntries(
            entries.rows[earlier], entries.solids[earlier], entries.path_fraction[earlier], entries.place[earlier]
        )
        is_hit[entries.rows] = False
        lost = moved.is_lost & ~is_hit
        lost[entries.rows] = False
        other = is_hit | lost
        other[entries.rows] = True
        self._finish_walks(walk, rows, np.flatnonzero(other), moved)
        self._project_to_ground(walk, rows[lost])
        again = self._step_onto_solid(walk, rows, entries, moved, body, threads, is_last)
        down = rows[is_hit]
        if not down.size or self.meshes is None:
            return again
        onto = footing.select_rows(is_hit)
        normal = self.meshes.compute_upright_normals(
            onto, start[is_hit] - moved.position[is_hit]
        )  # the side from which the agents come
        tilted, direction = moved.up[is_hit], moved.direction[is_hit]
        walk.heading[down] = compute_unit_tangents(
            rotate_between_normals(moved.heading[is_hit].T, tilted.T, normal.T, direction.T).T, normal
        )
        walk.direction[down] = rotate_between_normals(direction.T, tilted.T, normal.T, direction.T).T
        walk.footing.write_rows(down, onto)
        walk.place[down], walk.up[down] = self.meshes.position(onto), normal
        walk.distance[down] += moved.travelled[is_hit] * part[is_hit]
        rest = np.zeros(len(down)) if is_last else moved.travelled[is_hit] * (1 - part[is_hit])
        walk.remaining_displacements[down] = walk.direction[down] * rest[:, None]
        return np.concatenate([again, down[rest > 0]])

    def _project_to_ground(self, walk: _CombinedWalk, rows: Rows) -> None:
        """Move agents that have lost their solid straight down onto the ground below, against the scene's up axis.

        If there is no ground below, move them to the nearest ground."""
        if not rows.size:
            return
        start = self.position(walk.footing.select_rows(rows))
        onto, _ = self.find_nearest(start)
        least = np.full(len(rows), np.inf)
        for k, volume in enumerate(self._volumes):
            reach = length(np.maximum(np.abs(volume.high - start), np.abs(start - volume.low)))
            place, is_hit = find_points_below(volume, start, np.broadcast_to(self._up, start.shape), reach)
            drop = length(place - start)
            first = np.flatnonzero(is_hit & (drop < least))
            onto.write_rows(first, Footing.from_solids(self._count + k, place[first]))
            least[first] = drop[first]
        if self.meshes is not None:
            far = self.meshes.extent + length(start - (self.meshes.low + self.meshes.high) / 2)
            is_hit, part, footing = self.meshes.find_path_hits(start, -self._up * far[:, None])
            first = np.flatnonzero(is_hit & (part * far < least))
            onto.write_rows(first, footing.select_rows(first))
        walk.footing.write_rows(rows, onto)
        walk.place[rows] = self.position(onto)
        normal = self.compute_upright_normals(onto, walk.up[rows])
        walk.heading[rows] = walk.direction[rows] = compute_unit_tangents(walk.heading[rows], normal)
        walk.up[rows], walk.remaining_displacements[rows] = normal, 0.0

    def _find_mesh_crossings(
        self, start: Floats, end: Floats, up: Floats, end_up: Floats, body: Floats, threads: int
    ) -> tuple[NDArray[np.bool_], Floats, Footing]:
        """Return a mask of the agents that have a mesh in their path. The view is from slightly above the path.

        Also return the fraction of each path before the mesh, and the footing on the mesh."""
        n = len(start)
        if self.meshes is None:
            return np.zeros(n, np.bool_), np.ones(n), Footing.create_unplaced(n)
        lift = (_EYE_HEIGHT_BODY_LENGTHS * body)[:, None]
        a, b = start + up * lift, end + end_up * lift
        return self.meshes.find_path_hits(a, b - a, threads)

    # ---- footings

    def _find_mesh_rows(self, footing: Footing) -> Rows:
        """Return the rows of footings on meshes."""
        return np.flatnonzero((footing.mesh >= 0) & (footing.mesh < self._count))

    def _find_solid_rows(self, footing: Footing, k: int) -> Rows:
        """Return the rows of footings on solid number `k`."""
        return np.flatnonzero(footing.mesh == self._count + k)
