"""Queries of triangle meshes: ray hits, occlusion, closest points and feelers. Results are bit-identical for any batch size and
number of threads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.distance_grid import DistanceGrid
from antdsl.casting.faces import TriangleFaces, find_nearest_on_triangle
from antdsl.casting.nearby import RAY_LENGTH_SAFETY_FACTOR, Index, ProximityQueries, Vectors
from antdsl.casting.open3d_module import load_open3d, require_open3d
from antdsl.casting.ray_walks import Arrays, build_ring_tables
from antdsl.casting.tolerances import FACE_BEYOND_GRID, NO_FACE
from antdsl.casting.triangle_grid import TriangleGrid

MeshArrays = tuple[Vectors, NDArray[np.int32]]
RayHits = tuple[Index, Vectors, Index, Vectors]

_RAYS_PER_CHUNK = 1 << 16  # rays per chunk
_MAX_RECASTS = 16  # maximum number of faces that a ray may miss by less than the tolerance
# A point moved this far from its face is nearer to an equally near face on another side.
_RECAST_NUDGE_IN_TOLERANCES = 8.0
_MAX_RAYS_IN_ONE_CAST = 128  # for up to this number of rays, one cast to the end of the scene is faster than two queries
_MAX_NEAREST_DISTANCE_MM = 1e15  # much farther away, Open3D reports no nearest face, because squares overflow in float32
FAR_FROM_ORIGIN_MM = 2000.0  # mm; nearer to zero, float32 is exact to a ten-thousandth of a millimetre


@dataclass(frozen=True, slots=True)
class RayHitArrays:
    """The first hits of n rays.

    - `t`: the distance of the hit, in lengths of the ray's direction; infinite without a hit
    - `mesh`, `face`: the mesh, and the face in this mesh; -1 without a hit
    - `u`, `v`: the weights of the face's second and third corner
    - `normal` float32[n,3]: the face's unit normal, on the side of the ray's origin; 0 without a hit"""

    t: Vectors
    mesh: NDArray[np.int32]
    face: NDArray[np.int32]
    u: Vectors
    v: Vectors
    normal: NDArray[np.float32]

    @property
    def is_hit(self) -> NDArray[np.bool_]:
        """Return a mask of the rays that hit, bool[n]."""
        return self.face >= 0


class RayScene(ProximityQueries):
    """Triangle meshes that rays can be cast at. Vertices are float64[n,3], faces int[m,3]; lengths are in mm.

    Open3D computes in float32, and its last bits depend on the processor. It is therefore used only to find candidate faces, on
    slightly enlarged triangles. Hit points and nearest points are computed in float64, from the candidate and the faces that
    share its corner there. Of equally near faces, the one with the lowest mesh number, then the lowest face number, is returned.

    A short-lived scene, for a single step, is faster to build but has coarser lower bounds of distances. With `store_tables`,
    tables are stored for later runs. The tolerance of `TriangleFaces`, the smallest resolved length, is proportional to the
    largest coordinate. If meshes beyond `largest_coordinate` (mm) are only a backdrop, it is proportional to this length.

    Rays with an end, and nearest-face queries within a distance, use a `TriangleGrid` if there is one. The grid tests all nearby
    faces in float64. Open3D answers longer rays, and queries too far from all faces. The choice depends only on the scene and the
    query, so no result depends on other queries. Two faces without a common corner may be closer than float32 resolves. The grid
    then returns the nearer one, Open3D either of them."""

    _is_short_lived = False
    _stores_tables = True
    _largest_coordinate: float | None = None

    def __init__(
        self,
        vertices: Vectors,
        faces: NDArray[np.int32],
        is_short_lived: bool = False,
        largest_coordinate: float | None = None,
        store_tables: bool = True,
    ) -> None:
        self._is_short_lived, self._largest_coordinate, self._stores_tables = is_short_lived, largest_coordinate, store_tables
        self._set_meshes([(vertices, faces)])

    @classmethod
    def from_meshes(cls, meshes: Sequence[MeshArrays]) -> RayScene:
        """Return a scene of several meshes. `RayHitArrays.mesh` is the index of the mesh that was hit, from 0."""
        scene = cls.__new__(cls)
        scene._set_meshes(meshes)
        return scene

    def _set_meshes(self, meshes: Sequence[MeshArrays]) -> None:
        """Store the triangles of the scene relative to an origin near their centre."""
        arrays = [(np.asarray(v, np.float64).reshape(-1, 3), np.asarray(f, np.int32).reshape(-1, 3)) for v, f in meshes]
        counts = np.array([len(f) for _, f in arrays], np.int64)
        corners = np.concatenate([np.empty((0, 3, 3)), *(v[f] for v, f in arrays)])
        self._first_face_of_mesh = np.cumsum(np.concatenate(([0], counts)))
        self._mesh_of_face = np.repeat(np.arange(len(arrays), dtype=np.int32), counts)
        middle = (corners.min(axis=(0, 1)) + corners.max(axis=(0, 1))) / 2 if corners.size else np.zeros(3)
        # Multiples of a metre, and zero near the origin, so that another mesh at the border changes no bit of other results.
        self.origin = np.round(middle / 1000.0) * 1000.0 if np.abs(middle).max() > FAR_FROM_ORIGIN_MM else np.zeros(3)
        self._faces = TriangleFaces(corners - self.origin, self._is_short_lived, self._largest_coordinate)
        self._is_empty = not len(corners)
        if not self._is_empty:
            require_open3d()
        self._open3d_scene: Any = None
        self._grid: DistanceGrid | None = None
        self._has_refined_grid = False
        self._exact_scene: Any = None
        self._short_ray_grid: TriangleGrid | None = None
        self._has_built_grid = False
        self._ring_tables: Arrays | None = None

    @property
    def _widened_scene(self) -> Any:
        """Return the Open3D scene of slightly enlarged triangles. It is built on first use, because most runs need only the
        grid."""
        if self._open3d_scene is None:
            self._open3d_scene = self._build_scene(self._faces.compute_widened_corners())
        return self._open3d_scene

    def _build_scene(self, corners: NDArray[np.float32]) -> Any:
        """Return an Open3D scene of triangles with corners float32[3m,3]."""
        # Built by one thread, so that the tree is the same on all machines of one kind.
        scene = load_open3d().t.geometry.RaycastingScene(nthreads=1)
        scene.add_triangles(self._to_tensor(corners), self._to_tensor(np.arange(len(corners), dtype=np.uint32).reshape(-1, 3)))
        return scene

    @staticmethod
    def _to_tensor(array: NDArray[Any]) -> Any:
        return load_open3d().core.Tensor.from_numpy(np.ascontiguousarray(array))

    # ---- rays

    def find_first_hits(self, origin: Vectors, direction: Vectors, threads: int = 1) -> RayHitArrays:
        """Return the first hit of each ray from `origin` [n,3] along `direction` [n,3], which may have any length."""
        n = len(origin)
        t, mesh, local = np.full(n, np.inf), np.full(n, -1, np.int32), np.full(n, -1, np.int32)
        weights, normal = np.zeros((n, 3)), np.zeros((n, 3), np.float32)
        for start in range(0, n, _RAYS_PER_CHUNK):
            rays = slice(start, start + _RAYS_PER_CHUNK)
            directions = np.ascontiguousarray(direction[rays], np.float64)
            hit_rows, fractions, face, hit_weights = self._find_open3d_hits(
                np.asarray(origin[rays], np.float64) - self.origin, directions, np.inf, threads
            )
            rows = start + hit_rows
            t[rows], weights[rows], normal[rows] = fractions, hit_weights, self._get_facing_normals(face, directions[hit_rows])
            mesh[rows], local[rows] = self._split_face_numbers(face)
        return RayHitArrays(t, mesh, local, weights[:, 1], weights[:, 2], normal)

    def find_hits_along_step(
        self, origin: Vectors, step: Vectors, threads: int = 1, most_hit: bool = False
    ) -> tuple[Index, Vectors, NDArray[np.int32], NDArray[np.int32]]:
        """Return the ascending numbers of the rays that hit between `origin` [n,3] and `origin + step`, with ray parameters,
        meshes and faces.

        `most_hit`: whether most rays are expected to hit. If so, the occlusion query before the search is skipped."""
        hit_rays, t, face = self._find_hits_within(origin - self.origin, step, threads, most_hit)
        return hit_rays, t, *self._split_face_numbers(face)

    def find_hit_normals(
        self, origin: Vectors, displacement: Vectors, normals: Vectors, normal_columns: Index, threads: int = 1
    ) -> tuple[Index, Vectors, Vectors]:
        """Return the ascending numbers of the k rays that hit between `origin` [n,3] and `origin + displacement`, with ray
        parameters and normals (3, k).

        Ray parameters are in lengths of `displacement`. `normals` (3, m): the normals to return. `normal_columns`: the column of
        `normals` for each face."""
        grid = self._get_triangle_grid()
        if grid is not None:
            results, left = grid.find_hit_normals(origin, displacement, normals, normal_columns, threads)
            if not left:
                return results
        hit_rays, part, face = self._find_hits_within(origin - self.origin, displacement, threads)
        return hit_rays, part, normals.take(normal_columns.take(face), axis=1)

    def get_ring_tables(self, threads: int = 1) -> Arrays | None:
        """Return the tables that ray walks need in addition to the grid, or None if there is no grid. They are built on first
        use."""
        grid = self._get_triangle_grid()
        if grid is not None and self._ring_tables is None:
            self._ring_tables = build_ring_tables(self._faces, grid.tables, self._stores_tables, threads)
        return self._ring_tables

    def _get_triangle_grid(self) -> TriangleGrid | None:
        """Return the grid for short rays and near faces, or None for a short-lived scene. It is built on first use."""
        if not self._has_built_grid:
            self._has_built_grid = True
            self._short_ray_grid = TriangleGrid.from_faces(self._faces, self.origin, self._stores_tables)
        return self._short_ray_grid

    def _find_hits_within(
        self, origin: Vectors, displacement: Vectors, threads: int, most_hit: bool = False
    ) -> tuple[Index, Vectors, Index]:
        """Return the rays that hit a face between `origin` and `origin + displacement`: their ascending numbers, ray parameters
        and faces.

        Short rays use the grid, the others use Open3D."""
        grid = self._get_triangle_grid()
        if grid is None:
            return self._find_open3d_hits(origin, displacement, 1.0, threads, most_hit)[:3]
        t, face = grid.find_first_faces(origin, displacement, threads)
        distant = np.flatnonzero(face == FACE_BEYOND_GRID)
        if distant.size:
            face[distant] = NO_FACE
            rows, part, faces, _ = self._find_open3d_hits(origin[distant], displacement[distant], 1.0, threads, most_hit)
            t[distant[rows]], face[distant[rows]] = part, faces
        hit_rows = np.flatnonzero(face >= 0)
        return hit_rows, t.take(hit_rows), face.take(hit_rows)

    def _find_open3d_hits(
        self, origin: Vectors, displacement: Vectors, max_parameter: float, threads: int, most_hit: bool = False
    ) -> RayHits:
        """Find the rays that hit within `max_parameter` lengths of `displacement` [n,3]. `origin` [n,3] is relative to the
        scene's origin.

        The result has the ascending numbers of these rays, ray parameters (in lengths of `displacement`), faces numbered over all
        meshes, and barycentric weights.

        Hits within the tolerance of a ray's start do not count. Open3D therefore searches slightly past the end of a ray. A
        reported face does not count if the ray starts on it, or misses it by less than the tolerance. The search is then repeated
        behind this face."""
        no_hits = np.empty(0, np.int64), np.empty(0), np.empty(0, np.int64), np.empty((0, 3))
        if self._is_empty:
            return no_hits
        rows, a, w = np.arange(len(origin)), origin, displacement
        begin: Vectors | None = None
        batches: list[RayHits] = []
        for _ in range(_MAX_RECASTS):
            if not rows.size:
                break
            rays = np.empty((len(rows), 6), np.float32)
            rays[:, :3] = a if begin is None else a + w * begin[:, None]
            rays[:, 3:] = w
            are_many = len(rows) > _MAX_RAYS_IN_ONE_CAST and not most_hit
            if max_parameter < np.inf and are_many:
                # A ray without a hit traverses the complete scene. Only occlusion queries can limit its length.
                maybe = self._test_open3d_occlusions(rays, max_parameter * RAY_LENGTH_SAFETY_FACTOR, threads).nonzero()[0]
                rows, rays = rows.take(maybe), rays.take(maybe, axis=0)
                a, w = a.take(maybe, axis=0), w.take(maybe, axis=0)
                begin = None if begin is None else begin[maybe]
            if not rows.size:
                break
            part, reported = self._cast_open3d_rays(rays, threads)
            if (
                max_parameter < np.inf and not are_many
            ):  # a ray is occluded before the end exactly if its first hit lies before the end
                reported[part > np.float32(max_parameter * RAY_LENGTH_SAFETY_FACTOR)] = -1
            t: NDArray[Any] = part if begin is None else begin + part
            if reported.min() < 0:
                named_rows = np.flatnonzero(reported >= 0)
                if not named_rows.size:
                    break
                rows, t, reported = (rows.take(named_rows), t.take(named_rows), reported.take(named_rows))
                a, w = a.take(named_rows, axis=0), w.take(named_rows, axis=0)
            fractions, weights, hit, tolerances = self._faces.recompute_reported_hits(reported, a, w, t)
            if hit.all():
                batches.append((rows, fractions, reported, weights))
                break
            batches.append((rows[hit], fractions[hit], reported[hit], weights[hit]))
            rays_behind = np.flatnonzero(~hit)
            rows, a, w, begin = rows[rays_behind], a[rays_behind], w[rays_behind], (t + 2.0 * tolerances)[rays_behind]
        if not batches:
            return no_hits
        if len(batches) > 1:
            row_batches, parts, faces, at_weights = zip(*batches, strict=True)
            rows, fractions = np.concatenate(row_batches), np.concatenate(parts)
            reported, weights = np.concatenate(faces), np.concatenate(at_weights)
            order = np.argsort(rows)
            batches = [(rows[order], fractions[order], reported[order], weights[order])]
        rows, fractions, reported, weights = batches[0]
        near = fractions <= max_parameter
        if near.all():
            return batches[0]
        near_rows = np.flatnonzero(near)
        return rows.take(near_rows), fractions.take(near_rows), reported.take(near_rows), weights.take(near_rows, axis=0)

    def _cast_open3d_rays(self, rays: NDArray[np.float32], threads: int) -> tuple[NDArray[np.float32], Index]:
        """Cast prepared rays by Open3D. Return the approximate ray parameter of each first hit, and the face numbered over all
        meshes (-1 for none)."""
        answer = self._widened_scene.cast_rays(self._to_tensor(rays), nthreads=threads)
        t = answer["t_hit"].numpy()
        face = answer["primitive_ids"].numpy().astype(np.int64)
        is_miss = ~np.isfinite(t)
        if is_miss.any():
            face[is_miss] = -1
        return t, face

    def _split_face_numbers(self, face: Index) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Convert face numbers over all meshes to mesh numbers and face numbers within these meshes."""
        mesh = self._mesh_of_face.take(face)
        return mesh, (face - self._first_face_of_mesh.take(mesh)).astype(np.int32)

    def _get_facing_normals(self, face: Index, direction: NDArray[Any]) -> NDArray[np.float32]:
        """Return the normals of faces, each on the side that a ray with the given direction hits."""
        normal = self._faces.get_normals(face)
        projection = (normal[:, 0] * direction[:, 0] + normal[:, 1] * direction[:, 1]) + normal[:, 2] * direction[:, 2]
        facing: NDArray[np.float32] = np.where(projection[:, None] > 0, -normal, normal).astype(np.float32)
        return facing

    def find_occluded_rays(
        self, origin: Vectors, direction: Vectors, max_parameter: float = np.inf, threads: int = 1
    ) -> NDArray[np.bool_]:
        """Return whether each ray hits anything within `max_parameter` lengths of its direction. This is Open3D's result, for
        pictures only."""
        rays = np.empty((len(origin), 6), np.float32)
        np.subtract(origin, self.origin, out=rays[:, :3], casting="unsafe")
        rays[:, 3:] = direction
        return self._test_open3d_occlusions(rays, max_parameter, threads)

    def _test_open3d_occlusions(self, rays: NDArray[np.float32], max_parameter: float, threads: int) -> NDArray[np.bool_]:
        """Return, as Open3D finds it, whether each prepared ray hits anything within `max_parameter` lengths of its direction."""
        if self._is_empty or len(rays) == 0:
            return np.zeros(len(rays), bool)
        is_occluded: NDArray[np.bool_] = self._widened_scene.test_occlusions(
            self._to_tensor(rays), tnear=0.0, tfar=max_parameter, nthreads=threads
        ).numpy()
        return is_occluded

    # ---- nearest faces

    def find_closest(
        self, points: Vectors, threads: int = 1, max_distance: NDArray[Any] | float = np.inf
    ) -> tuple[NDArray[np.int32], NDArray[np.int32], Vectors, NDArray[np.float64]]:
        """Return the surface point nearest to each point [n,3]: its mesh, face, position [n,3] in float64, and distance [n] (mm).
        Far from the surface, a query costs as much as 10 to 30 rays. Use it only for the few points that no other search
        resolves. Beyond `max_distance` (mm, one or float[n]), the result may be another, equally near face."""
        n = len(points)
        if self._is_empty or n == 0:
            no_faces = np.full(n, -1, np.int32)
            return no_faces, no_faces.copy(), np.array(points, np.float64).reshape(-1, 3), np.full(n, np.inf)
        local = np.asarray(points, np.float64) - self.origin
        endless = isinstance(max_distance, float) and max_distance == np.inf
        grid = None if endless else self._get_triangle_grid()
        if grid is None:
            place, distance, face = self._find_closest_by_open3d(local, threads, max_distance)
        else:
            place, square, face = grid.find_nearest(local)
            distance = np.sqrt(square)
            rows = np.flatnonzero(face == FACE_BEYOND_GRID)
            if rows.size:
                max_distances = np.broadcast_to(np.asarray(max_distance), (n,))[rows]
                place[rows], distance[rows], face[rows] = self._find_closest_by_open3d(local[rows], threads, max_distances)
        return *self._split_face_numbers(face), place + self.origin, distance

    def _find_closest_by_open3d(
        self, local_points: Vectors, threads: int, max_distance: NDArray[Any] | float
    ) -> tuple[Vectors, Vectors, Index]:
        """Return the surface position nearest to each point, its distance and its face, using Open3D. Points and positions are
        relative to the scene's origin."""
        place, square, face = self._faces.find_nearest(local_points, self._query_open3d_nearest(local_points, threads))
        # At a slightly larger distance, an equally near face on another side is nearer. So both are found in any case.
        distance = np.sqrt(square)
        candidates = np.flatnonzero(distance <= max_distance)
        if candidates.size:
            local_points, square, one = local_points[candidates], square[candidates], face[candidates]
            nudge = (local_points - place[candidates]) * (
                _RECAST_NUDGE_IN_TOLERANCES * self._faces.tolerance / np.maximum(distance[candidates], 1e-30)
            )[:, None]
            other_places, other_squares, other = self._faces.find_nearest(
                local_points, self._query_open3d_nearest(local_points + nudge, threads)
            )
            nearer = np.flatnonzero((other_squares < square) | ((other_squares == square) & (other < one)))
            rows = candidates[nearer]
            place[rows], face[rows], distance[rows] = (other_places[nearer], other[nearer], np.sqrt(other_squares[nearer]))
        return place, distance, face

    def _measure_approximate_distances(self, points: Vectors) -> Vectors:
        """Return the distance [n] from each point to the nearest face, up to float32 errors. Later searches use it as a limit."""
        local = points - self.origin
        gap = find_nearest_on_triangle(local, self._faces.corners.take(self._query_open3d_nearest(local, 1), axis=0)) - local
        return np.sqrt((gap[:, 0] * gap[:, 0] + gap[:, 1] * gap[:, 1]) + gap[:, 2] * gap[:, 2])

    def _query_open3d_nearest(self, points: Vectors, threads: int) -> Index:
        """Return the face that Open3D reports as nearest to each point. Points are relative to the scene's origin."""
        if self._exact_scene is None:
            self._exact_scene = (
                self._widened_scene
                if self._is_short_lived
                else self._build_scene(self._faces.corners.reshape(-1, 3).astype(np.float32))
            )
        near = np.fmin(np.fmax(points, -_MAX_NEAREST_DISTANCE_MM), _MAX_NEAREST_DISTANCE_MM).astype(
            np.float32
        )  # NaN gets an arbitrary nearest face
        answer = self._exact_scene.compute_closest_points(self._to_tensor(near), nthreads=threads)
        face: Index = answer["primitive_ids"].numpy().astype(np.int64)
        return face

    def measure_depth_inside(self, points: Vectors, threads: int = 1) -> NDArray[np.float64]:
        """Return the depth of each point [n,3] inside the meshes: its distance to the surface in mm. Meshes are assumed to be
        closed.

        A point is inside if at least two of three rays from it cross an odd number of faces. Outside, the depth is 0."""
        depths = np.zeros(len(points))
        if not self._is_empty and len(points):
            local = self._to_tensor((np.asarray(points, np.float64) - self.origin).astype(np.float32))
            inside = np.flatnonzero(self._widened_scene.compute_occupancy(local, nthreads=threads, nsamples=3).numpy() > 0.5)
            depths[inside] = self.find_closest(points[inside], threads)[3]
        return depths
