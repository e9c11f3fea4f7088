"""A ground with meshes that move between steps. Vertex positions are set for each frame; the topology does not change. Only the
data of moved meshes is updated. Moving meshes are in a separate ray scene."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from copy import copy
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.rays import MeshArrays, RayHitArrays, RayScene
from antdsl.ground.mesh.surface import MeshGround
from antdsl.ground.mesh.surface_clearance import FacePartClearances, PieceClearances
from antdsl.ground.mesh.surroundings import RELATIVE_DISTANCE_NOISE
from antdsl.ground.mesh.topology import update_face_shapes
from antdsl.ground.protocol import Floats, Footing, Index

FaceAxes = tuple[Floats, Floats, Floats]


class MovingGround(MeshGround):
    """A `MeshGround` in which the meshes named in `moving` change their positions or shapes.

    `rest`: the ground with all meshes at their initial positions, to which the cells of fields refer."""

    def __init__(self, surfaces: Mapping[str, MeshArrays], moving_names: Iterable[str], by_rays: bool = False) -> None:
        self._is_moving = np.isin(list(surfaces), list(moving_names))
        super().__init__(surfaces, by_rays)
        counts = [len(np.reshape(v, (-1, 3))) for v, _ in surfaces.values()]
        ends = np.cumsum([0, *counts])
        self._vertex_slices = {name: slice(int(ends[k]), int(ends[k + 1])) for k, name in enumerate(self.names)}
        self._face_slices = {
            name: slice(int(self._first_face[k]), int(self._first_face[k + 1])) for k, name in enumerate(self.names)
        }
        self._rest_topology = self._topology.copy()
        self._static_face_count = int((self._topology.is_live & ~self._is_moving.take(self._mesh_of_face)).sum())
        self._box_by_mesh = {name: _compute_box(self._vertices[rows]) for name, rows in self._vertex_slices.items()}
        self._static_scenes: dict[tuple[int, ...], tuple[RayScene, Index]] = {}
        self._clearances = _MovingPieceClearances(self)  # type: ignore[assignment]
        # A moving mesh may rise above feet by any height, so a face with its back to an agent always counts as below.
        self._scale = replace(self._scale, max_below_height=np.inf)

    def copy(self) -> MovingGround:
        """Return a copy of this ground. Moving the meshes of the copy does not move those of this ground."""
        ground = copy(self)
        ground._vertices, ground._topology = self._vertices.copy(), self._topology.copy()
        ground._box_tree = replace(self._box_tree, bounds=self._box_tree.bounds.copy())
        ground._ray_scenes, ground._walk_tables, ground._box_by_mesh = {}, None, dict(self._box_by_mesh)
        ground._clearances = _MovingPieceClearances(ground)  # type: ignore[assignment]
        return ground

    def set_mesh_vertices(self, vertices_by_name: Mapping[str, Floats]) -> None:
        """Set the current vertices (n, 3) of moving meshes."""
        for name, vertices in vertices_by_name.items():
            rows = self._face_slices[name]
            self._vertices[self._vertex_slices[name]] = vertices
            update_face_shapes(self._topology, self._vertices, self._faces, rows)
            if self._walk_tables is not None:
                self._walk_tables.update_faces(rows)
            self._box_by_mesh[name] = _compute_box(vertices)
        self.low = np.min([low for low, _ in self._box_by_mesh.values()], axis=0)
        self.high = np.max([high for _, high in self._box_by_mesh.values()], axis=0)
        self.extent = max(self.extent, float((self.high - self.low).max()))
        self._box_tree.refit_boxes(self._vertices, self._faces, self._static_face_count)
        self._ray_scenes = {}
        self._clearances.reset()  # type: ignore[attr-defined]

    def find_rows_on_moving_meshes(self, mesh: NDArray[np.int32]) -> NDArray[np.intp]:
        """Return the rows of the agents that stand on a moving mesh. `mesh`: the mesh number of each agent; numbers out of range
        are ignored."""
        known = (mesh >= 0) & (mesh < len(self._is_moving))
        return np.flatnonzero(known & self._is_moving.take(np.where(known, mesh, 0)))

    def compute_axes(self, footing: Footing) -> FaceAxes:
        """Return the three axes (3, n) of the face below each agent: along its first edge, across this edge, and along its
        normal.

        The normal follows the winding of the face."""
        face, _ = self._compute_face_numbers(footing)
        t = self._topology
        return t.axis1.take(face, axis=1), t.axis2.take(face, axis=1), t.normal.take(face, axis=1)

    def compute_rest_axes(self, footing: Footing) -> FaceAxes:
        """Return the axes of the face below each agent as they are in the face's rest position, in the form of `compute_axes`."""
        face, _ = self._compute_face_numbers(footing)
        t = self._rest_topology
        return t.axis1.take(face, axis=1), t.axis2.take(face, axis=1), t.normal.take(face, axis=1)

    def compute_rest_positions(self, footing: Footing) -> Floats:
        """Return the rest positions (n, 3) of the surface points below agents."""
        face, known = self._compute_face_numbers(footing)
        t = self._rest_topology
        place = t.corner.take(face, axis=1) + footing.b1 * t.edge1.take(face, axis=1) + footing.b2 * t.edge2.take(face, axis=1)
        return np.ascontiguousarray(np.where(known, place, 0.0).T)

    def list_moving_boxes(self) -> list[tuple[NDArray[np.bool_], Floats, Floats]]:
        """For each moving mesh, return a mask of its faces, and the lowest and highest corner of its bounding box at its current
        position."""
        return [(self._mesh_of_face == k, *self._box_by_mesh[name]) for k, name in enumerate(self.names) if self._is_moving[k]]

    def _group_surfaces(self) -> NDArray[np.int32]:
        return np.where(self._is_moving.take(self._mesh_of_face), self._mesh_of_face + 1, 0).astype(np.int32)

    def _get_ray_scene(self, surface_names: Iterable[str] | None) -> tuple[RayScene, Index]:
        """Return the ray scenes of static and of moving surfaces, combined. Also return, for each face of these scenes, its face
        number in the ground."""
        chosen = self._find_surface_numbers(surface_names)
        if chosen not in self._ray_scenes:
            still = tuple(k for k in chosen if not self._is_moving[k])
            if still not in self._static_scenes:
                self._static_scenes[still] = self._build_ray_scene(still)
            moved, live = self._build_ray_scene(tuple(k for k in chosen if self._is_moving[k]), store_tables=False)
            first, first_live = self._static_scenes[still]
            self._ray_scenes[chosen] = _StillAndMovingRayScenes(first, moved, len(first_live)), np.concatenate([first_live, live])  # type: ignore[assignment]
        return self._ray_scenes[chosen]

    def _build_ray_scene(self, surfaces: tuple[int, ...], store_tables: bool = True) -> tuple[RayScene, Index]:
        """Return a ray scene of the given surfaces. Also return, for each face of this scene, its face number in the ground."""
        live = np.flatnonzero(self._topology.is_live & np.isin(self._mesh_of_face, surfaces))
        return RayScene(self._vertices, self._faces[live], store_tables=store_tables), live


def _compute_box(vertices: Floats) -> tuple[Floats, Floats]:
    """Return the lowest and highest corner (3,) of a box around vertices."""
    empty = not len(vertices)
    return (np.full(3, np.inf), np.full(3, -np.inf)) if empty else (vertices.min(axis=0), vertices.max(axis=0))


def _compute_face_boxes(vertices: Floats, faces: NDArray[np.int32]) -> tuple[Floats, Floats]:
    """Return the lowest and the highest corners of the bounding boxes of faces, both (n, 3)."""
    a, b, c = (vertices.take(faces[:, k], axis=0) for k in range(3))
    return np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)


class _StillAndMovingRayScenes:
    """Two ray scenes with one mesh each, combined to one. Faces of the second scene are numbered after the faces of the first."""

    def __init__(self, first: RayScene, second: RayScene, faces: int) -> None:
        self._first_scene, self._second_scene, self._first_face_count = first, second, faces

    def find_first_hits(self, origin: Floats, direction: Floats, threads: int = 1) -> RayHitArrays:
        """Return the first hits over both scenes, like `RayScene.find_first_hits`."""
        a, b = (scene.find_first_hits(origin, direction, threads) for scene in (self._first_scene, self._second_scene))
        second = b.is_hit & (b.t < a.t)
        face = np.where(second, b.face + np.int32(self._first_face_count), a.face)
        u, v = np.where(second, b.u, a.u), np.where(second, b.v, a.v)
        normal = np.where(second[:, None], b.normal, a.normal)
        return RayHitArrays(np.where(second, b.t, a.t), np.where(second, b.mesh, a.mesh), face, u, v, normal)

    def find_hits_along_step(
        self, origin: Floats, step: Floats, threads: int = 1
    ) -> tuple[Index, Floats, NDArray[np.int32], NDArray[np.int32]]:
        """Return the first hits within a step over both scenes, like `RayScene.find_hits_along_step`."""
        n = len(origin)
        part, mesh, face = np.full(n, np.inf), np.full(n, -1, np.int32), np.full(n, -1, np.int32)
        for scene, first_face in ((self._first_scene, 0), (self._second_scene, self._first_face_count)):
            which, t, _, local = scene.find_hits_along_step(origin, step, threads)
            nearer = t < part[which]
            which = which[nearer]
            part[which], mesh[which], face[which] = t[nearer], 0, local[nearer] + first_face
        hit_rows = np.flatnonzero(mesh >= 0)
        return hit_rows, part[hit_rows], mesh[hit_rows], face[hit_rows]

    def find_hit_normals(
        self, origin: Floats, displacement: Floats, normals: Floats, normal_columns: Index, threads: int = 1
    ) -> tuple[Index, Floats, Floats]:
        """Return the hits over both scenes and their normals, like `RayScene.find_hit_normals`."""
        which, part, _, face = self.find_hits_along_step(origin, displacement, threads)
        return which, part, normals.take(normal_columns.take(face), axis=1)

    def find_closest(self, points: Floats, threads: int = 1) -> tuple[NDArray[np.int32], NDArray[np.int32], Floats, Floats]:
        """Return the nearest surface points over both scenes, like `RayScene.find_closest`."""
        a, b = (scene.find_closest(points, threads) for scene in (self._first_scene, self._second_scene))
        second = b[3] < a[3]
        face = np.where(second, b[1] + np.int32(self._first_face_count), a[1])
        return np.where(second, b[0], a[0]), face, np.where(second[:, None], b[2], a[2]), np.where(second, b[3], a[3])


class _MovingPieceClearances:
    """Clearances for a ground with moving meshes. Distances between static meshes are measured once. An agent near the box of a
    moving mesh always searches for nearby surfaces. An agent on a moving mesh searches if another mesh is near."""

    def __init__(self, ground: MovingGround) -> None:
        self._ground = ground
        self.distance_noise = ground.extent * RELATIVE_DISTANCE_NOISE
        self._is_moving_face = ground._is_moving.take(ground._mesh_of_face)
        self._static_faces = np.flatnonzero(~self._is_moving_face)
        corners = ground._vertices[ground._faces[self._static_faces]]
        low = corners.min(axis=(0, 1)) if len(corners) else np.zeros(3)
        piece, cut = ground._topology.piece, ground._topology.cuts.is_cut
        self._static_clearances = PieceClearances(
            corners, piece[self._static_faces], cut[self._static_faces], low, self.distance_noise
        )
        several = {name: cut[rows].any() or (np.unique(piece[rows]) >= 0).sum() > 1 for name, rows in ground._face_slices.items()}
        self._low, self._high = _compute_face_boxes(ground._vertices, ground._faces)
        self._multi_piece_meshes = [name for k, name in enumerate(ground.names) if ground._is_moving[k] and several[name]]
        self._parts: FacePartClearances | None = None

    def reset(self) -> None:
        """Discard the clearances that are invalid after meshes have moved."""
        self._parts = None

    def get_face_parts(self, reach: float) -> FacePartClearances:
        """Return the clearances for the current positions of the meshes, measured up to `reach` mm."""
        if self._parts is None or self._parts.reach < reach:
            self._parts = self._build_face_parts(1.5 * reach)
        return self._parts

    def _build_face_parts(self, reach: float) -> FacePartClearances:
        """Return the clearances between static meshes. The clearance is 0 for all faces near moving meshes."""
        ground = self._ground
        still = self._static_clearances.get_face_parts(reach)
        count, first = np.zeros(len(ground._faces), np.int32), np.zeros(len(ground._faces), np.int64)
        count[self._static_faces], first[self._static_faces] = still.parts_per_edge, still.first_parts
        at = self._find_faces_near_moving(reach)
        count[at], first[at] = 1, len(still.clearances)
        return FacePartClearances(reach, first, count, np.append(still.clearances, 0.0))

    def _find_faces_near_moving(self, reach: float) -> Index:
        """Return the faces that may have another mesh within `reach` mm, counting only pairs of meshes of which at least one
        moves."""
        ground = self._ground
        wide = reach + 2 * self.distance_noise
        for k, rows in enumerate(ground._face_slices.values()):
            if ground._is_moving[k]:
                self._low[rows], self._high[rows] = _compute_face_boxes(ground._vertices, ground._faces[rows])
        is_near = np.zeros(len(self._low), np.bool_)
        for k, (name, rows) in enumerate(ground._face_slices.items()):
            low, high = ground._box_by_mesh[name]
            candidates = np.arange(len(is_near)) if ground._is_moving[k] else np.flatnonzero(self._is_moving_face)
            near = candidates[((self._low[candidates] <= high + wide) & (self._high[candidates] >= low - wide)).all(axis=1)]
            own = (near >= rows.start) & (near < rows.stop)
            is_near[near if name in self._multi_piece_meshes else near[~own]] = True
        return np.flatnonzero(is_near)
