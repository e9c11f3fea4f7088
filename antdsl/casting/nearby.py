"""Queries about the triangles near agents: distances, hits of feelers, and directions away from the triangles.

Most agents are too far from all triangles. They are skipped, using a grid of lower bounds of the distance."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.distance_grid import DistanceGrid
from antdsl.casting.faces import TriangleFaces
from antdsl.casting.tolerances import TOUCHING_DISTANCE_MM
from antdsl.casting.triangle_grid import Arrays, GridTableArrays, TriangleGrid
from antdsl.numerics.vectors import VectorComponents

Vectors = NDArray[np.float64]
Index = NDArray[np.int64]

FeelerQuery = tuple[NDArray[np.bool_], Arrays, Arrays]  # mask of the requesting agents; operands and results, n each

RAY_LENGTH_SAFETY_FACTOR = 1.1  # factor of the ray's length for Open3D's search; exceeds its rounding error except for tiny rays
_MIN_POINTS_TO_REFINE = 2_000  # fewer simultaneous queries are not worth refined distances
_SHORT_LIVED_GRID_CELLS = 1000


@dataclass(frozen=True, slots=True)
class FeelerHits:
    """Hits of feelers.

    - `hit`: whether a feeler hits
    - `t`: the distance of the hit (mm), infinite without a hit
    - `nx`, `ny`, `nz`: the unit normal of the face, on the side of the feeler's origin"""

    hit: NDArray[np.bool_]
    t: NDArray[np.float32]
    nx: NDArray[np.float32]
    ny: NDArray[np.float32]
    nz: NDArray[np.float32]


def list_query_rows(queries: Sequence[FeelerQuery]) -> list[tuple[int, NDArray[np.intp]]]:
    """Return, for each query, its number in `queries` and the rows of the agents that request it."""
    return [(number, np.flatnonzero(is_requested)) for number, (is_requested, *_) in enumerate(queries)]


class ProximityQueries(ABC):
    """Queries about the triangles near positions. The subclass in `casting.rays` implements the basic queries."""

    origin: Vectors
    _is_short_lived: bool
    _stores_tables: bool
    _faces: TriangleFaces
    _first_face_of_mesh: Index
    _is_empty: bool
    _grid: DistanceGrid | None
    _has_refined_grid: bool

    @property
    def corners(self) -> Vectors:
        """Return the corners of all faces in world space, float64[m,3,3] (mm)."""
        return self._faces.corners + self.origin

    @abstractmethod
    def find_closest(
        self, points: Vectors, threads: int = 1, max_distance: NDArray[Any] | float = np.inf
    ) -> tuple[NDArray[np.int32], NDArray[np.int32], Vectors, Vectors]:
        """Return the surface point nearest to each point: its mesh, its face, its position and its distance."""

    @abstractmethod
    def _find_hits_within(
        self, origin: Vectors, displacement: Vectors, threads: int, most_hit: bool = False
    ) -> tuple[Index, Vectors, Index]:
        """Return the rays that hit a face between `origin` and `origin + displacement`: their ascending numbers, ray parameters
        and faces."""

    @abstractmethod
    def _get_facing_normals(self, face: Index, direction: NDArray[Any]) -> NDArray[np.float32]:
        """Return the normals of faces, each on the side that a ray with the given direction hits."""

    @abstractmethod
    def _get_triangle_grid(self) -> TriangleGrid | None:
        """Return the grid for short rays and near faces; None if there is none."""

    @abstractmethod
    def _measure_approximate_distances(self, points: Vectors) -> Vectors:
        """Return approximate distances [n] (mm) from points [n,3] to the nearest face, which limit later searches."""

    def measure_clearance(self, x: NDArray[Any], y: NDArray[Any], z: NDArray[Any], threads: int = 1) -> NDArray[np.float32]:
        """Return a distance (mm), float32[n], around each position within which there is no face. It is 0 near a face, and
        infinite if there are no faces."""
        if self._is_empty:
            return np.full(len(x), np.inf, np.float32)
        if self._grid is None:
            self._grid = self._get_distance_grid()
        if len(x) >= _MIN_POINTS_TO_REFINE and not self._has_refined_grid and not self._is_short_lived:
            self._has_refined_grid = True
            self._grid.refine_near_cells(self._measure_approximate_distances)
        return self._grid.compute_lower_bounds(x, y, z, threads)

    def _get_distance_grid(self) -> DistanceGrid:
        """Return the grid of lower bounds, built on first use."""
        corners = self._faces.corners + self.origin
        return (
            DistanceGrid(corners, _SHORT_LIVED_GRID_CELLS, False)
            if self._is_short_lived
            else DistanceGrid(corners, store_tables=self._stores_tables)
        )

    def cast_feelers(
        self, positions: VectorComponents, directions: VectorComponents, reach: NDArray[Any] | float, threads: int = 1
    ) -> FeelerHits:
        """Return the first hits of feelers from `positions` along the unit vectors `directions`, within `reach` (mm, one or
        float[n]).

        Positions and directions are given as three arrays [n], x, y and z. Agents that are too far from all faces are skipped;
        this does not change the result."""
        (x, y, z), (dx, dy, dz) = positions, directions
        if np.ndim(reach) == 0 or reach.dtype != np.float32:  # type: ignore[union-attr]
            reach = np.broadcast_to(np.asarray(reach, np.float32), (len(x),))
        assert isinstance(reach, np.ndarray)
        rays = (x, y, z, dx, dy, dz)
        grid = self._get_usable_grid(rays)
        if grid is not None:
            results, left = grid.cast_feelers((x, y, z), (dx, dy, dz), reach)
            if left:
                unknown_rows = np.flatnonzero(np.isnan(results[0]))
                unknown = tuple(each.take(unknown_rows) for each in rays)
                results[0, unknown_rows], results[1:, unknown_rows] = self._cast_rays(unknown, reach.take(unknown_rows), threads)
            t, normal = results[0], results[1:]
        else:
            t, normal = self._cast_rays(rays, reach, threads)
        return FeelerHits(t < np.inf, t, *normal)

    def cast_feeler_batch(
        self, positions: Arrays, queries: Sequence[FeelerQuery], threads: int = 1
    ) -> list[tuple[int, NDArray[np.intp]]]:
        """Answer several queries of feelers at once, each for some of n agents. Write the results to the arrays of the queries.

        - `positions`: four arrays [n]: x, y, z, and a distance (mm) within which there is no face
        - `queries`: for each query, a mask of the agents, the directions (x, y, z, of any length), the reach, and the result
          arrays
        - result arrays: five arrays [n], hit, distance and normal (x, y, z), which the caller has initialised to no hit

        All arrays are contiguous float32. Returns the number of each query and the rows for which `cast_feelers` must still be
        called. Without a grid, `cast_feelers` must be called for all rows of the query."""
        grid = self._get_triangle_grid()
        if grid is None:
            return list_query_rows(queries)
        left = []
        for number, (is_requested, directions, results) in enumerate(queries):
            if grid.cast_requested_feelers(positions, is_requested, directions, results, threads):
                unknown_rows = np.flatnonzero(is_requested & np.isnan(results[1]))
                results[1][unknown_rows] = np.inf
                left.append((number, unknown_rows))
        return left

    def get_tables(self) -> GridTableArrays | None:
        """Return the arrays of the triangle grid that kernels read, or None if there is no grid."""
        grid = self._get_triangle_grid()
        return None if grid is None else grid.tables

    def _get_usable_grid(self, columns: tuple[NDArray[Any], ...]) -> TriangleGrid | None:
        """Return the grid if there is one and its kernels accept these columns, else None."""
        return self._get_triangle_grid() if all(each.dtype == np.float32 for each in columns) else None

    def _cast_rays(
        self, rays: tuple[NDArray[Any], ...], reach: NDArray[np.float32], threads: int
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return distances and normals of the first hits of feelers, using array operations. `rays`: six columns, origins and
        directions."""
        x, y, z, dx, dy, dz = rays
        t = np.full(len(x), np.inf, np.float32)
        normal = np.zeros((3, len(x)), np.float32)
        near = self._select_possible_hits(rays, reach)
        if near.size:
            length = reach.take(near)
            origin, displacement = np.empty((3, near.size)), np.empty((3, near.size))
            for axis, (place, step) in enumerate(((x, dx), (y, dy), (z, dz))):
                np.subtract(place.take(near), self.origin[axis], out=origin[axis])
                np.multiply(step.take(near), length, out=displacement[axis], dtype=np.float64)
            hit_rows, part, face = self._find_hits_within(origin.T, displacement.T, threads)
            if hit_rows.size:
                near = near.take(hit_rows)
                t[near] = part * length.take(hit_rows)
                normal[:, near] = self._get_facing_normals(face, displacement.T[hit_rows]).T
        return t, normal

    def find_nearest_within(
        self, x: NDArray[Any], y: NDArray[Any], z: NDArray[Any], reach: NDArray[Any] | float, threads: int = 1
    ) -> FeelerHits:
        """Return the nearest face within `reach` (mm, one or float[n]) of positions (1-D arrays).

        The normal of a hit is the unit direction from the face to the position."""
        n = len(x)
        reach = np.broadcast_to(np.asarray(reach, np.float32), (n,))
        t = np.full(n, np.inf, np.float32)
        normal = np.zeros((3, n), np.float32)
        if not self._is_empty and n:
            if self._grid is None:
                self._grid = self._get_distance_grid()
            candidates = np.flatnonzero(self._grid.compute_lower_bounds(x, y, z) <= reach)
            points = np.stack([x[candidates], y[candidates], z[candidates]], axis=1).astype(np.float64)
            _, _, place, distance = self.find_closest(points, threads, reach[candidates] * RAY_LENGTH_SAFETY_FACTOR)
            hit_rows = np.flatnonzero(distance.astype(np.float32) <= reach[candidates])
            unit_offsets = (points[hit_rows] - place[hit_rows]) / np.maximum(distance[hit_rows], 1e-12)[:, None]
            t[candidates[hit_rows]] = distance[hit_rows]
            normal[:, candidates[hit_rows]] = unit_offsets.T
        return FeelerHits(np.isfinite(t), t, *normal)

    def measure_signed_distances(
        self, x: NDArray[Any], y: NDArray[Any], z: NDArray[Any], max_distance: NDArray[Any] | float, threads: int = 1
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the signed distance (mm), float32[n], of each position from the meshes, and the unit direction out of them,
        float32[3,n].

        The distance is negative inside a mesh, which means behind the nearest face. The query is slow far from the surface."""
        grid = self._get_usable_grid((x, y, z))
        if grid is None:
            return self._measure_signed_distances_to_faces(np.stack([x, y, z], axis=1).astype(np.float64), max_distance, threads)
        results, left = grid.measure_signed_distances((x, y, z), threads)
        if left:
            unknown_rows = np.flatnonzero(np.isnan(results[0]))
            points = np.stack([each.take(unknown_rows) for each in (x, y, z)], axis=1).astype(np.float64)
            max_distances = np.broadcast_to(np.asarray(max_distance), (len(x),)).take(unknown_rows)
            results[0, unknown_rows], results[1:, unknown_rows] = self._measure_signed_distances_to_faces(
                points, max_distances, threads
            )
        return results[0], results[1:]

    def _measure_signed_distances_to_faces(
        self, points: Vectors, max_distance: NDArray[Any] | float, threads: int
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the results of `measure_signed_distances` for points [n,3], computed from their nearest faces."""
        mesh, face, place, distance = self.find_closest(points, threads, max_distance)
        if self._is_empty or not len(points):
            return distance.astype(np.float32), np.zeros((3, len(points)), np.float32)
        normal = self._faces.get_normals(face + self._first_face_of_mesh[mesh])
        offset = points - place
        side = np.where((offset[:, 0] * normal[:, 0] + offset[:, 1] * normal[:, 1]) + offset[:, 2] * normal[:, 2] < 0, -1.0, 1.0)
        touching = distance < TOUCHING_DISTANCE_MM
        outward = np.where(touching[:, None], normal, offset * (side / np.maximum(distance, TOUCHING_DISTANCE_MM))[:, None])
        return (distance * side).astype(np.float32), np.ascontiguousarray(outward.T, np.float32)

    def _select_possible_hits(self, rays: Arrays, reach: NDArray[Any]) -> NDArray[np.int64]:
        """Return the rows of feelers that may hit. A feeler is excluded if, by the lower bounds, there is no face in the smallest
        ball around it."""
        if self._is_empty:
            return np.empty(0, np.int64)
        if self._grid is None:
            self._grid = self._get_distance_grid()
        x, y, z, dx, dy, dz = rays
        half = reach * np.float32(0.5)
        clearance = self._grid.compute_lower_bounds(x + dx * half, y + dy * half, z + dz * half)
        return np.flatnonzero(clearance <= half * np.float32(1 + 1e-4) + np.float32(1e-4))
