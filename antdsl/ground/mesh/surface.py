"""Surfaces that agents stand and walk on, with any side up. A footing is a point of a triangle; `MeshGround.move` moves it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import partial
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.rays import MeshArrays, RayScene
from antdsl.ground.mesh import footings
from antdsl.ground.mesh.boxes import FaceBoxes
from antdsl.ground.mesh.creases import SlopeMap, bend_edges, inner_creases, sharp_edges
from antdsl.ground.mesh.surface_clearance import PieceClearances
from antdsl.ground.mesh.surroundings import EYE_HEIGHT_PER_BODY, GroundScale
from antdsl.ground.mesh.topology import MeshTopology, build_topology, facing_sides
from antdsl.ground.mesh.walk_events import CrowdWalk, WalkTables
from antdsl.ground.protocol import Floats, Footing, GroundMove, Index
from antdsl.ground.sticking import move_by_rays
from antdsl.numerics import parallel
from antdsl.numerics.vectors import dot

SHARP_REACH, BEND_REACH = 1.6, 0.9  # bodies around an agent in which its ground must be level, see `mark_bends`


class MeshGround:
    """One or more surfaces, by name, in the given order: (vertices float64[n,3], faces int32[m,3]) in mm.

    An obstacle that agents may climb is a normal surface. Meshes may overlap and need not be closed. With `by_rays`, agents do
    not walk over triangles, but are placed at ray hits: see `sticking`."""

    def __init__(self, surfaces: Mapping[str, MeshArrays], by_rays: bool = False) -> None:
        self.names, self._by_rays = tuple(surfaces), by_rays
        meshes = [
            (np.asarray(v, np.float64).reshape(-1, 3), np.asarray(f, np.int32).reshape(-1, 3)) for v, f in surfaces.values()
        ]
        counts = [len(f) for _, f in meshes]
        self._first: Index = np.cumsum([0, *counts])
        self._mesh = np.repeat(np.arange(len(meshes), dtype=np.int32), counts)
        shift = np.cumsum([0, *(len(v) for v, _ in meshes)])[:-1]
        self._vertices = np.concatenate([v for v, _ in meshes]) if meshes else np.empty((0, 3))
        self._faces = (
            np.concatenate([f + s for (_, f), s in zip(meshes, shift, strict=True)]) if meshes else np.empty((0, 3), np.int32)
        )
        self._faces = self._faces.astype(np.int32)
        used = self._vertices[self._faces.ravel()]
        self.low = used.min(axis=0) if used.size else np.zeros(3)
        self.high = used.max(axis=0) if used.size else np.zeros(3)
        self.extent = float((self.high - self.low).max())
        self._table: MeshTopology = build_topology(self._vertices, self._faces, self._mesh, self.extent)
        self._side = facing_sides(self._table.normal.T)
        self._scenes: dict[tuple[int, ...], tuple[RayScene, Index]] = {}
        corners = self._vertices[self._faces]
        self._scale = GroundScale.of(self.extent)
        self._boxes = FaceBoxes.of(self._vertices, self._faces, np.flatnonzero(self._table.live), self._surface_groups())
        self._clearances = PieceClearances(corners, self._table.piece, self._table.cuts.cut, self.low, self._scale.noise)
        self._fast: WalkTables | None = None
        # Where bodies must turn ahead of their feet, and faces that they must rise over, by size; computed on first use.
        self._bends: dict[float, tuple[SlopeMap | None, NDArray[np.bool_]]] = {}
        self._sharp: SlopeMap | None = None
        self._rises: SlopeMap | None = None  # where bodies may meet walls, computed on first use

    def _surface_groups(self) -> NDArray[np.int32]:
        """Return a group number for each face; the faces of one group move together."""
        return np.zeros(len(self._faces), np.int32)

    # ---- asking

    def nowhere(self, n: int) -> Footing:
        """Return footings for n agents that stand on nothing yet."""
        return Footing.nowhere(n)

    def place(self, points: Floats, up: Floats, on: Iterable[str] | None = None) -> tuple[Footing, NDArray[np.bool_]]:
        """Return footings below points [n,3]: the first surface hit by a ray from far above along -`up` ([3] or [n,3]).

        If the ray hits nothing, the footing is the nearest point of the surfaces, with False in the second array. `on` names the
        allowed surfaces; None means all. Without any surface, no agent gets a footing. Raises KeyError for an unknown name."""
        points = np.asarray(points, np.float64).reshape(-1, 3)
        up = np.broadcast_to(np.asarray(up, np.float64), points.shape)
        scene, live = self._ray_scene(on)
        middle = (self.low + self.high) / 2
        height = ((middle - points) * up).sum(axis=1) + self.extent * 1.8  # more than half the diagonal above the centre
        hits = scene.cast(points + up * height[:, None], -up)
        is_hit = hits.hit
        face = self._face_of(hits.mesh, hits.face, live)
        place = points + up * (height - np.where(is_hit, hits.t, 0.0))[:, None]
        missed = np.flatnonzero(~is_hit)
        if missed.size:
            mesh, near, nearest, _ = scene.closest(points[missed])
            face[missed] = self._face_of(mesh, near, live)
            place[missed] = nearest
        return self._footing(face, *self._table.weights(np.maximum(face, 0), place.T)), is_hit

    def nearest(self, points: Floats, on: Iterable[str] | None = None) -> tuple[Footing, Floats]:
        """Return footings at the points of the surfaces in `on` (None: all) that are nearest to points [n,3], and the distance
        float64[n]."""
        points = np.asarray(points, np.float64).reshape(-1, 3)
        scene, live = self._ray_scene(on)
        mesh, local, place, distance = scene.closest(points)
        face = self._face_of(mesh, local, live)
        return self._footing(face, *self._table.weights(np.maximum(face, 0), place.T)), distance

    def trace_hits(self, origin: Floats, displacement: Floats, threads: int = 1) -> tuple[NDArray[np.bool_], Floats, Footing]:
        """Return which straight paths from `origin` [n,3] by `displacement` [n,3] hit a surface.

        Return also the part of the path before the hit, and the footing at the hit."""
        part, face = self._cast(np.asarray(origin, np.float64).T, np.asarray(displacement, np.float64).T, threads)
        is_hit = face >= 0
        place = origin.T + displacement.T * np.where(is_hit, part, 0.0)
        return is_hit, np.where(is_hit, part, 1.0), self._footing(face, *self._table.weights(np.maximum(face, 0), place))

    def trace_normals(self, origin: Floats, displacement: Floats, threads: int = 1) -> tuple[Index, Floats, Floats]:
        """Return the numbers, ascending, of straight paths from `origin` [n,3] by `displacement` [n,3] that hit a surface.

        Return also the part of the path before the hit, and the face's unit normal (3, k), by its winding."""
        scene, live = self._ray_scene(None)
        return scene.trace_normals(origin, displacement, self._table.normal, live, threads)

    def position(self, footing: Footing) -> Floats:
        """Return positions in the world, float64[n,3]; zero for agents without a footing. Raises IndexError for an invalid
        face."""
        positions, at = np.empty((len(footing), 3)), (footing.mesh, footing.face, footing.b1, footing.b2, footing.over)
        if not footings.write_positions(self._vertices.reshape(-1), self._faces, self._table.normal, self._first, *at, positions):
            raise IndexError("a footing is on a face that the ground does not have")
        return positions

    def normal(self, footing: Footing) -> Floats:
        """Return unit normals of the faces, float64[n,3], by their winding; zero for agents without a footing."""
        face, known = self._face_numbers(footing)
        if not self._faces.size:
            return np.zeros((len(footing), 3))
        return np.ascontiguousarray(np.where(known, self._table.normal.take(face, axis=1), 0.0).T)

    def sides(self, footing: Footing, threads: int = 1) -> NDArray[np.int8]:
        """Return the axis direction nearest to each face's normal, int8[n]: 0 +x, 1 -x, 2 +y, 3 -y, 4 +z, 5 -z; 0 for agents
        without a footing."""
        face_sides = np.empty(len(footing), np.int8)
        on = (footing.mesh, footing.face, self._first, self._side)
        parallel.in_parts(
            partial(footings.write_sides, *on, face_sides), len(footing), threads, parallel.MIN_LIGHT_ITEMS_PER_THREAD
        )
        return face_sides

    def upright_normals(self, footing: Footing, up: Floats) -> Floats:
        """Return smooth unit normals float64[n,3] on the side that `up` ([3] or [n,3]) points to; `up` itself for agents without
        a footing.

        Creases are not smoothed. Elsewhere the normal is continuous along the surface, so that bodies do not jerk."""
        up = np.array(np.broadcast_to(np.asarray(up, np.float64), (len(footing), 3)).T, order="C")
        face, known = self._face_numbers(footing)
        if not self._faces.size:
            return np.ascontiguousarray(up.T)
        side = np.where(dot(up, self._table.normal.take(face, axis=1)) < 0, -1.0, 1.0)
        return np.ascontiguousarray(np.where(known, self._smooth_normals(face, footing.b1, footing.b2) * side, up).T)

    @property
    def triangles(self) -> tuple[Floats, NDArray[np.int32], NDArray[np.int32], MeshTopology]:
        """Return all surfaces as one: vertices (n, 3), faces (m, 3), the surface number of each face, and the topology."""
        return self._vertices, self._faces, self._mesh, self._table

    @property
    def meshes(self) -> MeshGround:
        """Return the part of the ground that consists of meshes: the ground itself."""
        return self

    def on_faces(self, footing: Footing) -> tuple[Index, NDArray[np.bool_]]:
        """Return the face of each footing, numbered over all surfaces (0 for none), and whether the footing is on a face."""
        known = (footing.face >= 0) & (footing.mesh >= 0) & (footing.mesh < len(self.names))
        return np.where(known, self._first.take(np.where(known, footing.mesh, 0)) + footing.face, 0), known

    def rows_near_rises(self, footing: Footing, place: Floats, reach: Floats, threads: int = 1) -> Index:
        """Return the rows, ascending, of agents at positions [n,3] for which a surface may rise within `reach` [n] mm.

        A surface rises at an inner crease, at another piece, or at a moving mesh. Agents with a `reach` of 0 or less are left
        out. No other agent near a rise is missing. The result for an agent does not depend on the others."""
        if self._rises is None:
            corners = self._vertices[self._faces]
            self._rises = SlopeMap(corners, self._table, [own for own, _, _ in self.boxes()], inner_creases(self._table, corners))
        moving = [(low, high) for _, low, high in self.boxes()]
        return self._rises.rows_near_rises(footing.mesh, footing.face, self._first, place, reach, moving, threads)

    def mark_bends(
        self, footing: Footing, place: Floats, size: Floats, levels: NDArray[np.uint8], threads: int = 1
    ) -> NDArray[np.bool_]:
        """Write how the ground bends around agents of `size` [n] mm at positions [n,3] into `levels`.

        Agents within 1.6 bodies of a sharp edge, another piece, a cut or a moving mesh get 2. Others within 0.9 bodies of narrow
        faces that rise get 1, and all others 0. Return which faces have an edge at which the ground rises, but not sharply."""
        part, power = np.frexp(max(float(np.fmax.reduce(size, initial=0.0)), 1e-6))
        rung = float(np.ldexp(np.ceil(part * 8) / 8, power))  # tables for a few sizes only
        own = [mask for mask, _, _ in self.boxes()]
        if rung not in self._bends:
            corners = self._vertices[self._faces]
            if self._sharp is None:
                self._sharp = SlopeMap(corners, self._table, own, sharp_edges(self._table, corners))
            half, has_bend = bend_edges(self._table, corners, rung)
            self._bends[rung] = SlopeMap(corners, self._table, own, half) if half.size else None, has_bend
        moving = [(low, high) for _, low, high in self.boxes()]
        narrow, has_bend = self._bends[rung]
        levels.fill(0)
        for slopes, reach, level in ((narrow, BEND_REACH, 1), (self._sharp, SHARP_REACH, 2)):
            if slopes is not None:
                at = (footing.mesh, footing.face, self._first, place, reach * size, moving, threads)
                levels[slopes.rows_near_rises(*at)] = level
        return has_bend

    def boxes(self) -> list[tuple[NDArray[np.bool_], Floats, Floats]]:
        """Return the moving meshes at their current position: mask of their faces, lowest and highest corner."""
        return []

    def to_world_vectors(self, face: Index, c: Floats, s: Floats) -> Floats:
        """Return vectors (3, n) in the world, from their components along the two axes of their faces."""
        return self._table.to_space(face, c, s)

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
        """Walk every agent along its surface by a displacement [n,3], on the side that its `up` [n,3] points to.

        - `heading` [n,3]: rotates with the surface
        - `body`: the size (mm) that determines how high and far agents search
        - `straight`: a path ends at an open border

        The displacement is projected into the face. It keeps its length, unless it is more than 60 degrees off the surface. The
        path unfolds across edges, so a slope does not change the speed. A surface in the path is climbed: the nearest along the
        path, seen from slightly above the ground, within the displacement. At an open border, the agent steps over to a surface
        that continues beyond, in as many steps as the height requires. If there is none, it follows the border or stops. A
        displacement that is not finite counts as zero.

        The thesis has two versions of the surface pass: longer ray, and nearest hit. This method uses the nearest surface along
        the path."""
        n = len(footing)
        if not self._faces.size or not n:
            return _stay_in_place(footing, up, heading)
        body = np.ascontiguousarray(body, np.float64) if np.ndim(body) else np.full(n, body, np.float64)
        wish, heading_t, up_t = (np.ascontiguousarray(np.asarray(v, np.float64).T) for v in (displacement, heading, up))
        if self._by_rays:
            return move_by_rays(self, footing, wish, heading_t, up_t, body, threads)
        with np.errstate(all="ignore"):
            parts = self._clearances.parts_within(self._search_reach(wish, body))
        moved = Footing.on_faces(np.empty(n, np.int32), np.empty(n, np.int32), *np.empty((3, n)))
        place, above, ahead, along = np.empty((4, 3, n))
        distances, blocked = np.empty(n), np.zeros(n, np.bool_)
        at, to = ((f.mesh, f.face, f.b1, f.b2, f.over) for f in (footing, moved))
        results = (*to, place, above, ahead, along, distances, blocked)
        self._walk().over(parts, self._boxes, self._scale).step(body, at, (wish, heading_t, up_t), results, threads, straight)
        return GroundMove(moved, place.T, above.T, ahead.T, along.T, distances, blocked, moved.face < 0)

    def crowd_walk(self, longest: float, widest: float) -> CrowdWalk | None:
        """Return the walk over triangles for kernels, for displacements up to `longest` and bodies up to `widest` (mm).

        None if agents are placed by rays, or if there is nothing to walk on."""
        if self._by_rays or not self._faces.size:
            return None
        return self._walk().crowd_walk_for(self._clearances, self._boxes, self._scale, longest, widest)

    def _walk(self) -> WalkTables:
        """Return the tables of walks, built on first use."""
        if self._fast is None:
            self._fast = WalkTables(self._table, self._mesh, self._first)
        return self._fast

    def _search_reach(self, wish: Floats, body: Floats) -> float:
        """Return the greatest distance (mm) at which agents search for other surfaces on their path."""
        most, widest = footings.find_farthest(wish, body)
        return float(sqrt(most) + EYE_HEIGHT_PER_BODY * widest + 3 * self._scale.noise)

    # ---- parts

    def _cast(self, origin: Floats, step: Floats, threads: int) -> tuple[Floats, Index]:
        """Return the part of the step at which each ray (3, k) hits (infinite for no hit), and the face over all meshes (-1)."""
        scene, live = self._ray_scene(None)
        which, t, mesh, local = scene.cast_within(origin.T, step.T, threads)
        part, face = np.full(origin.shape[1], np.inf), np.full(origin.shape[1], -1, np.int64)
        part[which] = t
        face[which] = self._face_of(mesh, local, live)
        return part, face

    def _ray_scene(self, on: Iterable[str] | None) -> tuple[RayScene, Index]:
        """Return a ray scene of some surfaces, and the ground's face number of each face of that scene."""
        chosen = self._surface_numbers(on)
        if chosen not in self._scenes:
            live = np.flatnonzero(self._table.live & np.isin(self._mesh, chosen))
            self._scenes[chosen] = (RayScene(self._vertices, self._faces[live]), live)
        return self._scenes[chosen]

    def _surface_numbers(self, on: Iterable[str] | None) -> tuple[int, ...]:
        """Return the numbers of the surfaces in `on`; None means all. Raises KeyError for an unknown name."""
        names = self.names if on is None else tuple(on)
        for name in names:
            if name not in self.names:
                raise KeyError(f"no surface `{name}` on this ground, which has {', '.join(self.names) or 'none'}")
        return tuple(sorted(self.names.index(name) for name in names))

    @staticmethod
    def _face_of(mesh: NDArray[np.int32], face: NDArray[np.int32], live: Index) -> Index:
        """Return the ground's numbers of hit faces of a ray scene, -1 for no hit. `live`: number of each scene face."""
        result = np.full(len(face), -1, np.int64)
        hit = mesh >= 0
        result[hit] = live[face[hit]]
        return result

    def _face_numbers(self, footing: Footing) -> tuple[Index, NDArray[np.bool_]]:
        """Return the face number over all meshes, 0 for agents without a footing, and whether the footing is on a face."""
        known = (footing.face >= 0) & (footing.mesh >= 0)
        if known.all():
            face: Index = self._first.take(footing.mesh) + footing.face
            return face, known
        return np.where(known, self._first.take(np.where(known, footing.mesh, 0)) + footing.face, 0), known

    def _footing(self, face: Index, b1: Floats, b2: Floats, over: Floats | None = None) -> Footing:
        """Return footings on faces, numbered over all surfaces; -1 is nowhere."""
        known = face >= 0
        over = np.zeros(face.size) if over is None else over
        if known.all():
            mesh = self._mesh.take(face)
            return Footing.on_faces(mesh, (face - self._first.take(mesh)).astype(np.int32), b1, b2, over)
        mesh = np.where(known, self._mesh.take(np.maximum(face, 0)) if self._mesh.size else -1, -1).astype(np.int32)
        local = np.where(known, face - self._first.take(np.maximum(mesh, 0)), -1).astype(np.int32)
        return Footing.on_faces(mesh, local, *(np.where(known, v, 0.0) for v in (b1, b2, over)))

    def _smooth_normals(self, face: Index, b1: Floats, b2: Floats) -> Floats:
        """Return smooth unit normals (3, n), by the faces' winding."""
        n = self._table.smooth.take(face, axis=1)
        v = n[:3] * (1.0 - b1 - b2) + n[3:6] * b1 + n[6:] * b2
        return v / np.sqrt(np.maximum(dot(v, v), 1e-300))


def _stay_in_place(footing: Footing, up: Floats, heading: Floats) -> GroundMove:
    """Return the result of a step on a ground without surfaces: all agents are lost."""
    n = len(footing)
    same = np.array(heading, np.float64).reshape(-1, 3)
    return GroundMove(
        Footing.nowhere(n),
        np.zeros((n, 3)),
        np.array(up, np.float64).reshape(-1, 3),
        same,
        same.copy(),
        np.zeros(n),
        np.zeros(n, bool),
        np.ones(n, bool),
    )
