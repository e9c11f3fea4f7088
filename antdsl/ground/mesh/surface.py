"""Surfaces of triangles. Agents can stand and walk on both sides of them. A footing is a point of a triangle; `MeshGround.move`
moves it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import partial
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.rays import MeshArrays, RayScene
from antdsl.ground.mesh import footings
from antdsl.ground.mesh.boxes import FaceBoxes
from antdsl.ground.mesh.creases import SlopeMap, find_bend_edges, find_inner_creases, find_sharp_edges
from antdsl.ground.mesh.surface_clearance import PieceClearances
from antdsl.ground.mesh.surroundings import EYE_HEIGHT_BODY_LENGTHS, GroundTolerances
from antdsl.ground.mesh.topology import MeshTopology, build_topology, classify_normal_directions
from antdsl.ground.mesh.walk_events import CrowdWalk, WalkTables
from antdsl.ground.protocol import Floats, Footing, GroundMove, Index
from antdsl.ground.sticking import move_agents_by_rays
from antdsl.numerics import parallel
from antdsl.numerics.vectors import dot

SHARP_EDGE_REACH_BODY_LENGTHS, BEND_REACH_BODY_LENGTHS = (
    1.6,
    0.9,
)  # body lengths around an agent within which its ground must be level, see `mark_bend_levels`


class MeshGround:
    """A ground of named surfaces, in a fixed order. Each surface has vertices float64[n,3] (mm) and faces int32[m,3].

    An obstacle that agents may climb is also such a surface. Meshes may overlap and need not be closed. With `by_rays`, agents do
    not walk over triangles but are placed at ray hits; see `sticking`."""

    def __init__(self, surfaces: Mapping[str, MeshArrays], by_rays: bool = False) -> None:
        self.names, self._by_rays = tuple(surfaces), by_rays
        meshes = [
            (np.asarray(v, np.float64).reshape(-1, 3), np.asarray(f, np.int32).reshape(-1, 3)) for v, f in surfaces.values()
        ]
        counts = [len(f) for _, f in meshes]
        self._first_face: Index = np.cumsum([0, *counts])
        self._mesh_of_face = np.repeat(np.arange(len(meshes), dtype=np.int32), counts)
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
        self._topology: MeshTopology = build_topology(self._vertices, self._faces, self._mesh_of_face, self.extent)
        self._facing_side = classify_normal_directions(self._topology.normal.T)
        self._ray_scenes: dict[tuple[int, ...], tuple[RayScene, Index]] = {}
        corners = self._vertices[self._faces]
        self._scale = GroundTolerances.from_extent(self.extent)
        self._box_tree = FaceBoxes.build(
            self._vertices, self._faces, np.flatnonzero(self._topology.is_live), self._group_surfaces()
        )
        self._clearances = PieceClearances(
            corners, self._topology.piece, self._topology.cuts.is_cut, self.low, self._scale.distance_noise
        )
        self._walk_tables: WalkTables | None = None
        # By size, computed on first use: where bodies must turn ahead of their feet, and faces that they must rise over.
        self._bends: dict[float, tuple[SlopeMap | None, NDArray[np.bool_]]] = {}
        self._sharp: SlopeMap | None = None
        self._slope_map: SlopeMap | None = None  # areas in which bodies may meet walls, computed on first use

    def _group_surfaces(self) -> NDArray[np.int32]:
        """Return a group number for each face. Faces of the same group move together."""
        return np.zeros(len(self._faces), np.int32)

    # ---- asking

    def create_unplaced(self, n: int) -> Footing:
        """Return footings for n agents that have no position on the ground yet."""
        return Footing.create_unplaced(n)

    def place_points(
        self, points: Floats, up: Floats, surface_names: Iterable[str] | None = None
    ) -> tuple[Footing, NDArray[np.bool_]]:
        """Return footings below points [n,3]: the first surface hit by a ray from far above along -`up` ([3] or [n,3]).

        If the ray hits nothing, the footing is the nearest point of the surfaces, with False in the second array.
        `surface_names`: the surfaces to use; None means all. On a ground without surfaces, no agent gets a footing. Raises
        KeyError for an unknown name."""
        points = np.asarray(points, np.float64).reshape(-1, 3)
        up = np.broadcast_to(np.asarray(up, np.float64), points.shape)
        scene, live = self._get_ray_scene(surface_names)
        middle = (self.low + self.high) / 2
        height = ((middle - points) * up).sum(axis=1) + self.extent * 1.8  # more than half the diagonal above the centre
        hits = scene.find_first_hits(points + up * height[:, None], -up)
        is_hit = hits.is_hit
        face = self._to_ground_faces(hits.mesh, hits.face, live)
        place = points + up * (height - np.where(is_hit, hits.t, 0.0))[:, None]
        missed = np.flatnonzero(~is_hit)
        if missed.size:
            mesh, near, nearest, _ = scene.find_closest(points[missed])
            face[missed] = self._to_ground_faces(mesh, near, live)
            place[missed] = nearest
        return self._build_footing(face, *self._topology.compute_weights(np.maximum(face, 0), place.T)), is_hit

    def find_nearest(self, points: Floats, surface_names: Iterable[str] | None = None) -> tuple[Footing, Floats]:
        """Return the surface point nearest to each of points [n,3] as a footing, and its distance float64[n].

        `surface_names`: the surfaces to search; None means all."""
        points = np.asarray(points, np.float64).reshape(-1, 3)
        scene, live = self._get_ray_scene(surface_names)
        mesh, local, place, distance = scene.find_closest(points)
        face = self._to_ground_faces(mesh, local, live)
        return self._build_footing(face, *self._topology.compute_weights(np.maximum(face, 0), place.T)), distance

    def find_path_hits(self, origin: Floats, displacement: Floats, threads: int = 1) -> tuple[NDArray[np.bool_], Floats, Footing]:
        """Return a mask of the straight paths from `origin` [n,3] by `displacement` [n,3] that hit a surface.

        Also return the fraction of each path before the hit, and the footing at the hit."""
        part, face = self._find_hits_along_steps(
            np.asarray(origin, np.float64).T, np.asarray(displacement, np.float64).T, threads
        )
        is_hit = face >= 0
        place = origin.T + displacement.T * np.where(is_hit, part, 0.0)
        return (
            is_hit,
            np.where(is_hit, part, 1.0),
            self._build_footing(face, *self._topology.compute_weights(np.maximum(face, 0), place)),
        )

    def find_hit_normals(self, origin: Floats, displacement: Floats, threads: int = 1) -> tuple[Index, Floats, Floats]:
        """Return the rows, ascending, of those straight paths from `origin` [n,3] by `displacement` [n,3] that hit a surface.

        For these k rows, also return the fraction of the path before the hit, and the face's unit normal (3, k), by its winding.
        """
        scene, live = self._get_ray_scene(None)
        return scene.find_hit_normals(origin, displacement, self._topology.normal, live, threads)

    def position(self, footing: Footing) -> Floats:
        """Return positions in the world, float64[n,3]; zero for agents without a footing. Raises IndexError for an invalid
        face."""
        positions, at = (np.empty((len(footing), 3)), (footing.mesh, footing.face, footing.b1, footing.b2, footing.over))
        if not footings.write_footing_positions(
            self._vertices.reshape(-1), self._faces, self._topology.normal, self._first_face, *at, positions
        ):
            raise IndexError("a footing is on a face that the ground does not have")
        return positions

    def normal(self, footing: Footing) -> Floats:
        """Return the unit normals of the faces, float64[n,3], by their winding. They are zero for agents without a footing."""
        face, known = self._compute_face_numbers(footing)
        if not self._faces.size:
            return np.zeros((len(footing), 3))
        return np.ascontiguousarray(np.where(known, self._topology.normal.take(face, axis=1), 0.0).T)

    def find_sides(self, footing: Footing, threads: int = 1) -> NDArray[np.int8]:
        """Return the axis direction nearest to each normal, int8[n]: 0 +x, 1 -x, 2 +y, 3 -y, 4 +z, 5 -z. Agents without a
        footing get 0."""
        face_sides = np.empty(len(footing), np.int8)
        on = (footing.mesh, footing.face, self._first_face, self._facing_side)
        parallel.run_in_parts(
            partial(footings.write_footing_sides, *on, face_sides), len(footing), threads, parallel.MIN_LIGHT_ITEMS_PER_THREAD
        )
        return face_sides

    def compute_upright_normals(self, footing: Footing, up: Floats) -> Floats:
        """Return smooth unit normals float64[n,3] on the side that `up` ([3] or [n,3]) points to; agents without a footing get
        `up`.

        The normal is continuous along the surface, except at creases, so that bodies do not jerk."""
        up = np.array(np.broadcast_to(np.asarray(up, np.float64), (len(footing), 3)).T, order="C")
        face, known = self._compute_face_numbers(footing)
        if not self._faces.size:
            return np.ascontiguousarray(up.T)
        side = np.where(dot(up, self._topology.normal.take(face, axis=1)) < 0, -1.0, 1.0)
        return np.ascontiguousarray(np.where(known, self._compute_smooth_normals(face, footing.b1, footing.b2) * side, up).T)

    @property
    def triangles(self) -> tuple[Floats, NDArray[np.int32], NDArray[np.int32], MeshTopology]:
        """Return all surfaces as one mesh: vertices (n, 3), faces (m, 3), the surface number of each face, and the topology."""
        return self._vertices, self._faces, self._mesh_of_face, self._topology

    @property
    def meshes(self) -> MeshGround:
        """Return the part of the ground that consists of meshes. For this class, this is the ground itself."""
        return self

    def get_face_numbers(self, footing: Footing) -> tuple[Index, NDArray[np.bool_]]:
        """Return each footing's face number, counted over all surfaces (0 for none), and whether it is on a face."""
        known = (footing.face >= 0) & (footing.mesh >= 0) & (footing.mesh < len(self.names))
        return np.where(known, self._first_face.take(np.where(known, footing.mesh, 0)) + footing.face, 0), known

    def find_rows_near_slopes(self, footing: Footing, place: Floats, reach: Floats, threads: int = 1) -> Index:
        """Return the ascending rows of the agents that may have a rising surface within `reach` [n] mm. `place`: their positions
        [n,3].

        A surface may rise at an inner crease, where another piece of the ground is near, or at a moving mesh. No agent near a
        rise is omitted, except agents with a `reach` of 0 or less. The result for an agent does not depend on other agents."""
        if self._slope_map is None:
            corners = self._vertices[self._faces]
            self._slope_map = SlopeMap(
                corners,
                self._topology,
                [own for own, _, _ in self.list_moving_boxes()],
                find_inner_creases(self._topology, corners),
            )
        moving = [(low, high) for _, low, high in self.list_moving_boxes()]
        return self._slope_map.find_rows_near_slopes(footing.mesh, footing.face, self._first_face, place, reach, moving, threads)

    def mark_bend_levels(
        self, footing: Footing, place: Floats, size: Floats, levels: NDArray[np.uint8], threads: int = 1
    ) -> NDArray[np.bool_]:
        """Write to `levels` how much the ground bends around each agent. Return a mask of wide faces. `place`: positions [n,3].
        `size`: sizes [n], mm.

        The level is 2 within 1.6 body lengths of a sharp edge, another piece of the ground, a cut or a moving mesh. It is 1 for
        other agents within 0.9 body lengths of narrow faces that rise or curve much, and 0 for all others. The mask bool[m] is
        true for wide faces at or near an edge at which the ground bends."""
        part, power = np.frexp(max(float(np.fmax.reduce(size, initial=0.0)), 1e-6))
        rung = float(np.ldexp(np.ceil(part * 8) / 8, power))  # rounded, so that tables exist for a few sizes only
        own = [mask for mask, _, _ in self.list_moving_boxes()]
        if rung not in self._bends:
            corners = self._vertices[self._faces]
            if self._sharp is None:
                self._sharp = SlopeMap(corners, self._topology, own, find_sharp_edges(self._topology, corners))
            half, has_bend = find_bend_edges(self._topology, corners, rung)
            self._bends[rung] = SlopeMap(corners, self._topology, own, half) if half.size else None, has_bend
        moving = [(low, high) for _, low, high in self.list_moving_boxes()]
        narrow, has_bend = self._bends[rung]
        levels.fill(0)
        for slopes, reach, level in ((narrow, BEND_REACH_BODY_LENGTHS, 1), (self._sharp, SHARP_EDGE_REACH_BODY_LENGTHS, 2)):
            if slopes is not None:
                at = (footing.mesh, footing.face, self._first_face, place, reach * size, moving, threads)
                levels[slopes.find_rows_near_slopes(*at)] = level
        return has_bend

    def list_moving_boxes(self) -> list[tuple[NDArray[np.bool_], Floats, Floats]]:
        """For each moving mesh, return a mask of its faces, and the lowest and highest corner of its bounding box at its current
        position."""
        return []

    def to_world_vectors(self, face: Index, c: Floats, s: Floats) -> Floats:
        """Return vectors (3, n) in world space, from their components `c` and `s` along the two axes of their faces."""
        return self._topology.to_world_vectors(face, c, s)

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
        """Walk every agent along its surface by its displacement [n,3], on the side that its `up` [n,3] points to.

        - `heading` [n,3]: rotates with the surface
        - `body`: the size of each agent (mm), which determines how high and how far it searches
        - `stop_at_borders`: whether a path ends at an open border

        The displacement is projected into the face. Its length is preserved if its angle to the face is at most 60 degrees. The
        path is unfolded across edges, so a slope does not change the speed. An agent climbs the nearest other surface in its
        path, as seen from slightly above the ground. At an open border, it steps over to a surface beyond the border, in as many
        steps as the height requires. Without such a surface, it follows the border or stops. A displacement that is not finite
        counts as zero.

        The thesis (see `sticking`) describes the choice of a surface in two ways: longer ray, and nearest hit. This method uses
        the nearest surface along the path."""
        n = len(footing)
        if not self._faces.size or not n:
            return _make_zero_move(footing, up, heading)
        body = np.ascontiguousarray(body, np.float64) if np.ndim(body) else np.full(n, body, np.float64)
        wish, heading_t, up_t = (np.ascontiguousarray(np.asarray(v, np.float64).T) for v in (displacement, heading, up))
        if self._by_rays:
            return move_agents_by_rays(self, footing, wish, heading_t, up_t, body, threads)
        with np.errstate(all="ignore"):
            parts = self._clearances.get_face_parts(self._compute_search_reach(wish, body))
        moved = Footing.from_faces(np.empty(n, np.int32), np.empty(n, np.int32), *np.empty((3, n)))
        place, above, ahead, along = np.empty((4, 3, n))
        distances, blocked = np.empty(n), np.zeros(n, np.bool_)
        at, to = ((f.mesh, f.face, f.b1, f.b2, f.over) for f in (footing, moved))
        results = (*to, place, above, ahead, along, distances, blocked)
        self._get_walk_tables().combine_with_clearances(parts, self._box_tree, self._scale).walk_agents(
            body, at, (wish, heading_t, up_t), results, threads, stop_at_borders
        )
        return GroundMove(moved, place.T, above.T, ahead.T, along.T, distances, blocked, moved.face < 0)

    def build_crowd_walk(self, max_displacement: float, max_body_size: float) -> CrowdWalk | None:
        """Return the data that kernels need to walk agents over triangles. Displacements are at most `max_displacement`, bodies
        at most `max_body_size` (mm).

        Return None if agents are placed by rays, or if there is no surface."""
        if self._by_rays or not self._faces.size:
            return None
        return self._get_walk_tables().build_crowd_walk(
            self._clearances, self._box_tree, self._scale, max_displacement, max_body_size
        )

    def _get_walk_tables(self) -> WalkTables:
        """Return the tables of walks, built on first use."""
        if self._walk_tables is None:
            self._walk_tables = WalkTables(self._topology, self._mesh_of_face, self._first_face)
        return self._walk_tables

    def _compute_search_reach(self, wish: Floats, body: Floats) -> float:
        """Return the greatest distance (mm) at which any agent searches for other surfaces on its path."""
        most, widest = footings.find_max_step_and_size(wish, body)
        return float(sqrt(most) + EYE_HEIGHT_BODY_LENGTHS * widest + 3 * self._scale.distance_noise)

    # ---- parts

    def _find_hits_along_steps(self, origin: Floats, step: Floats, threads: int) -> tuple[Floats, Index]:
        """Return the fraction of each step (3, k) before its first hit, and the hit face, numbered over all meshes.

        For a ray without a hit, they are infinity and -1."""
        scene, live = self._get_ray_scene(None)
        which, t, mesh, local = scene.find_hits_along_step(origin.T, step.T, threads)
        part, face = np.full(origin.shape[1], np.inf), np.full(origin.shape[1], -1, np.int64)
        part[which] = t
        face[which] = self._to_ground_faces(mesh, local, live)
        return part, face

    def _get_ray_scene(self, surface_names: Iterable[str] | None) -> tuple[RayScene, Index]:
        """Return a ray scene of the named surfaces. Also return, for each face of this scene, its face number in the ground."""
        chosen = self._find_surface_numbers(surface_names)
        if chosen not in self._ray_scenes:
            live = np.flatnonzero(self._topology.is_live & np.isin(self._mesh_of_face, chosen))
            self._ray_scenes[chosen] = (RayScene(self._vertices, self._faces[live]), live)
        return self._ray_scenes[chosen]

    def _find_surface_numbers(self, surface_names: Iterable[str] | None) -> tuple[int, ...]:
        """Return the numbers of the surfaces in `surface_names`; None means all. Raises KeyError for an unknown name."""
        names = self.names if surface_names is None else tuple(surface_names)
        for name in names:
            if name not in self.names:
                raise KeyError(f"this ground has no surface `{name}`; its surfaces are: {', '.join(self.names) or 'none'}")
        return tuple(sorted(self.names.index(name) for name in names))

    @staticmethod
    def _to_ground_faces(mesh: NDArray[np.int32], face: NDArray[np.int32], live_faces: Index) -> Index:
        """Convert the face hits of a ray scene to face numbers of the ground; -1 means no hit. `live_faces`: the ground's face
        number of each face in the scene."""
        result = np.full(len(face), -1, np.int64)
        hit = mesh >= 0
        result[hit] = live_faces[face[hit]]
        return result

    def _compute_face_numbers(self, footing: Footing) -> tuple[Index, NDArray[np.bool_]]:
        """Return each footing's face number, counted over all surfaces (0 for none), and whether it is on a face."""
        known = (footing.face >= 0) & (footing.mesh >= 0)
        if known.all():
            face: Index = self._first_face.take(footing.mesh) + footing.face
            return face, known
        return np.where(known, self._first_face.take(np.where(known, footing.mesh, 0)) + footing.face, 0), known

    def _build_footing(self, face: Index, b1: Floats, b2: Floats, heights: Floats | None = None) -> Footing:
        """Return footings on faces, which are numbered over all surfaces. The face -1 means no footing."""
        known = face >= 0
        heights = np.zeros(face.size) if heights is None else heights
        if known.all():
            mesh = self._mesh_of_face.take(face)
            return Footing.from_faces(mesh, (face - self._first_face.take(mesh)).astype(np.int32), b1, b2, heights)
        mesh = np.where(known, self._mesh_of_face.take(np.maximum(face, 0)) if self._mesh_of_face.size else -1, -1).astype(
            np.int32
        )
        local = np.where(known, face - self._first_face.take(np.maximum(mesh, 0)), -1).astype(np.int32)
        return Footing.from_faces(mesh, local, *(np.where(known, v, 0.0) for v in (b1, b2, heights)))

    def _compute_smooth_normals(self, face: Index, b1: Floats, b2: Floats) -> Floats:
        """Return smooth unit normals (3, n), on the side given by the winding of faces."""
        n = self._topology.smooth.take(face, axis=1)
        v = n[:3] * (1.0 - b1 - b2) + n[3:6] * b1 + n[6:] * b2
        return v / np.sqrt(np.maximum(dot(v, v), 1e-300))


def _make_zero_move(footing: Footing, up: Floats, heading: Floats) -> GroundMove:
    """Return the result of a step on a ground without surfaces, which is that all agents are lost."""
    n = len(footing)
    same = np.array(heading, np.float64).reshape(-1, 3)
    return GroundMove(
        Footing.create_unplaced(n),
        np.zeros((n, 3)),
        np.array(up, np.float64).reshape(-1, 3),
        same,
        same.copy(),
        np.zeros(n),
        np.zeros(n, bool),
        np.ones(n, bool),
    )
