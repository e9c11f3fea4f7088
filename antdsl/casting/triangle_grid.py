"""A regular grid of triangles that finds the first face on a short ray, or the nearest face within a few cells, in float64.

The search for a ray visits the cubes along the ray (J. Amanatides, A. Woo, A Fast Voxel Traversal Algorithm for Ray Tracing,
Eurographics 1987). The search for a point visits the cubes around it, ring by ring. Every face listed in a visited cube is tested
as in `TriangleFaces`; only faces that cannot be the result are skipped. So the result is the same as if all faces were tested. Of
equally near faces, the one with the lowest number is returned."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.casting import grid_rays, nearest_faces
from antdsl.casting.distance_grid import choose_cell_width, measure_sides_and_area
from antdsl.casting.faces import TriangleFaces
from antdsl.casting.rasterise import iterate_triangle_cells
from antdsl.casting.tolerances import MAX_RAY_CUBES, MAX_SEARCH_RINGS
from antdsl.numerics import parallel, stored_tables
from antdsl.numerics.vector_rows import dot

Floats = NDArray[np.float64]
Index = NDArray[np.int64]
Float32Array = NDArray[np.float32]
PointColumns = tuple[Float32Array, Float32Array, Float32Array]
Arrays = tuple[NDArray[Any], ...]
GridTableArrays = tuple[Floats, Index, NDArray[np.int32], NDArray[np.int32], Float32Array, Floats, Floats, Floats]

_CUBE_WIDTH_IN_FACE_EDGES = 1.0  # edge of a cube, in mean face edges
_MAX_CUBES = 400_000
_MAX_LISTED_FACES = 4_000_000  # pairs of a face and a cube that lists it
_MAX_MEAN_FACES_PER_CUBE = 48.0  # mean number of faces in a face's cube; above it, a tree tests fewer faces
_RAYS_PER_THREAD = 128  # fewer rays or points are not worth another thread
_CUBE_MARGIN = 1e-6  # in cubes; more than rounding and `EDGE_WEIGHT_TOLERANCE` move a point off a face
_THIN_CORNER_SINE = 1e-8  # sine of a corner angle; below it, a face defines no plane and rays pass through it


class TriangleGrid:
    """A grid of cubes, each of which lists the faces in it. `tables` contains:

    - lowest corner, edge length of cubes, error of bounds, tolerance of the faces, and origin (mm, float64[9])
    - number of cubes along each axis, int64[3]
    - a list of the face numbers of all cubes, int32, and the start of each cube in this list, int32
    - plane and bounding ball of each listed face, float32[e,8]
    - planes (m, 3, 4), corners (m, 3, 3) and unit normals (m, 3) of all faces"""

    def __init__(self, faces: TriangleFaces, planes: Floats, width: float, origin: Floats, store_tables: bool = True) -> None:
        corners = faces.corners
        low = corners.min(axis=(0, 1)) - width / 4
        size = np.floor((corners.max(axis=(0, 1)) + width / 4 - low) / width).astype(np.int64) + 1
        work, count = partial(_list_cube_faces, corners, low, size, width), len(corners) if store_tables else 0
        lists = stored_tables.get_or_compute("triangle grid", count, (corners, width), work)
        first, face_list = lists["first"], lists["listed"]
        normals = faces.get_normals(np.arange(len(corners)))
        slack = 1e-6 * (
            float(np.abs(corners).max()) + (MAX_RAY_CUBES + MAX_SEARCH_RINGS) * width
        )  # several times the rounding error of float32
        self.tables: GridTableArrays = (
            np.array([*low, width, slack, faces.tolerance, *origin]),  # lowest corner of the grid; world position of its zero
            size,
            first,
            face_list,
            _compute_face_bounds(corners, normals)[face_list],
            np.ascontiguousarray(_clear_planes_of_thin_faces(corners, planes)),
            np.ascontiguousarray(corners),
            normals,
        )
        faces_per_cube = np.diff(first).astype(np.float64)
        self.mean_faces_per_cube = float((faces_per_cube * faces_per_cube).sum() / max(faces_per_cube.sum(), 1.0))

    @staticmethod
    def from_faces(faces: TriangleFaces, origin: Floats, store_tables: bool = True) -> TriangleGrid | None:
        """Return a grid, or None if it would be useless or too large. Its size is computed before any allocation.

        - `origin`: the world position that the corners of the faces are relative to
        - `store_tables`: whether to store the tables, because later runs may have the same faces"""
        tables = faces.build_kernel_tables()
        width = None if tables is None else _choose_cube_width(faces.corners)
        if tables is None or width is None:
            return None
        grid = TriangleGrid(faces, tables[0], width, origin, store_tables)
        return grid if grid.mean_faces_per_cube <= _MAX_MEAN_FACES_PER_CUBE else None

    # ---- rays

    def find_first_faces(self, origin: Floats, displacement: Floats, threads: int = 1) -> tuple[Floats, Index]:
        """Return the ray parameter of the first hit of each ray from `origin` [n,3] to `origin + displacement`, and the face.

        Ray parameters are in lengths of `displacement`. Hits within the tolerance of the start are ignored. The face is NO_FACE
        without a hit, and FACE_BEYOND_GRID for rays that are too long."""
        t, face = np.empty(len(origin)), np.empty(len(origin), np.int64)
        work = partial(grid_rays.write_first_hits, self.tables, origin, displacement, t, face)
        parallel.run_in_parts(work, len(origin), threads, _RAYS_PER_THREAD)
        return t, face

    def find_hit_normals(
        self, origin: Floats, displacement: Floats, normals: Floats, normal_columns: Index, threads: int = 1
    ) -> tuple[tuple[Index, Floats, Floats], int]:
        """Return the ascending numbers of the k rays from world positions that hit a face, with ray parameters and normals (3,
        k). The number of rays that the grid cannot resolve is also returned.

        Hits are those of `find_first_faces`. `normals` (3, m): the normals to return. `normal_columns`: the column of `normals`
        for each face."""
        hit_rays, results = np.empty(len(origin), np.int64), np.empty((4, len(origin)))
        work = partial(grid_rays.write_hit_normals, self.tables, origin, displacement, normals, normal_columns, hit_rays, results)
        parts = parallel.run_in_parts(work, len(origin), threads, _RAYS_PER_THREAD)
        hit_rays, results = parallel.join_parts(parts, hit_rays, results)
        return (hit_rays, results[0], results[1:]), sum([unanswered for _, _, unanswered in parts])

    def cast_feelers(self, positions: PointColumns, direction: PointColumns, reach: Float32Array) -> tuple[Float32Array, int]:
        """Return the first hits of feelers from positions along unit directions, within `reach` (mm). Inputs are float32 columns
        in world coordinates.

        The result is float32[4,n]: the distance, and the unit normal on the side of the feeler's origin. The distance is infinite
        without a hit, and NaN if the grid cannot resolve the feeler. The number of such feelers is also returned."""
        results = np.empty((4, len(reach)), np.float32)
        return results, grid_rays.write_feeler_hits(self.tables, _make_contiguous(*positions, *direction, reach), results)

    def cast_requested_feelers(
        self, positions: Arrays, is_requested: NDArray[np.bool_], directions: Arrays, results: Arrays, threads: int = 1
    ) -> int:
        """Write the first hits of feelers for the agents in the mask `is_requested`. Return the number of feelers that the grid
        cannot resolve.

        - `positions`: four arrays [n]: x, y, z, and a distance within which there is no face
        - `directions`: four arrays [n]: x, y, z, of any length, and the reach
        - `results`: five arrays [n]: hit, distance and normal (x, y, z); written only for rows that hit or cannot be resolved"""
        work = partial(grid_rays.write_requested_feelers, self.tables, positions, is_requested, directions, results)
        return sum(parallel.run_in_parts(work, len(is_requested), threads))

    # ---- nearest faces

    def measure_signed_distances(self, positions: PointColumns, threads: int = 1) -> tuple[Float32Array, int]:
        """Return an array float32[4,n], the signed distance (mm) from the faces and the unit direction out of the surface. Also
        return the number of positions that the grid cannot resolve.

        The distance is negative behind the nearest face, and NaN for positions that cannot be resolved."""
        results = np.empty((4, len(positions[0])), np.float32)
        work = partial(nearest_faces.write_signed_distances, self.tables, _make_contiguous(*positions), results)
        return results, sum(parallel.run_in_parts(work, len(positions[0]), threads, _RAYS_PER_THREAD))

    def find_nearest(self, points: Floats) -> tuple[Floats, Floats, Index]:
        """Return the position nearest to each point [n,3], its squared distance and its face. The face is FACE_BEYOND_GRID if no
        face is near enough for the grid."""
        place, square, face = np.empty((len(points), 3)), np.empty(len(points)), np.empty(len(points), np.int64)
        nearest_faces.write_nearest_points(self.tables, points, place, square, face)
        return place, square, face


def _make_contiguous(*columns: Float32Array) -> tuple[Float32Array, ...]:
    """Return the columns as contiguous arrays, copied if necessary."""
    return tuple([np.ascontiguousarray(each) for each in columns])


def _list_cube_faces(corners: Floats, low: Floats, size: Index, width: float) -> stored_tables.Tables:
    """Return the faces that each cube contains, as one list of face numbers and the start of each cube in this list.

    The grid has `size` cubes of edge `width` (mm), from the corner `low` on."""
    count, keys = len(corners), [np.empty(0, np.int64)]
    for cell, face in iterate_triangle_cells((corners - low) / width, margin=_CUBE_MARGIN):
        cell = np.minimum(np.maximum(cell, 0), size - 1)
        keys.append(((cell[:, 0] * size[1] + cell[:, 1]) * size[2] + cell[:, 2]) * count + face)
    cells, face_list = np.divmod(np.unique(np.concatenate(keys)), count)
    first = np.zeros(int(np.prod(size)) + 1, np.int32)
    np.cumsum(np.bincount(cells, minlength=len(first) - 1), out=first[1:])
    return {"first": first, "listed": face_list.astype(np.int32)}


def _choose_cube_width(corners: Floats) -> float | None:
    """Return the edge length of cubes (mm), or None if a grid is not useful. It is about the typical edge length of faces, or
    more if there would be too many cubes."""
    if not len(corners):
        return None
    lengths, area = measure_sides_and_area(corners)
    perimeter = lengths.sum()
    extent = corners.max(axis=(0, 1)) - corners.min(axis=(0, 1))
    width = max(float(lengths.mean()) * _CUBE_WIDTH_IN_FACE_EDGES, choose_cell_width(extent, _MAX_CUBES))
    if not 0 < width < np.inf:
        return None
    # A face touches cubes by its area, its sides and its corners.
    for _ in range(40):
        if 3 * area / width**2 + 2 * perimeter / width + 8.0 * len(corners) <= _MAX_LISTED_FACES:
            return width
        width *= 1.25
    return None


def _compute_face_bounds(corners: Floats, normals: Floats) -> Float32Array:
    """Return planes and bounding balls of faces, float32[m,8].

    The first four numbers are the plane: the unit normal and the negated distance from the origin. The others are the ball: its
    centre, which is in the plane, and its radius."""
    plane = np.concatenate([normals, -dot(normals, corners[:, 0])[:, None]], axis=1)
    middle = (corners[:, 0] + corners[:, 1] + corners[:, 2]) / 3.0
    offset = corners - middle[:, None]
    radius = np.sqrt(((offset[:, :, 0] ** 2 + offset[:, :, 1] ** 2) + offset[:, :, 2] ** 2).max(axis=1))
    return np.concatenate([plane, middle, radius[:, None]], axis=1).astype(np.float32)


def _clear_planes_of_thin_faces(corners: Floats, planes: Floats) -> Floats:
    """Return planes [m,3,4], set to zero for faces that are too thin to define one."""
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    size = dot(planes[:, 0, :3], planes[:, 0, :3])
    thin = ~(size > _THIN_CORNER_SINE * _THIN_CORNER_SINE * (dot(one, one) * dot(two, two)))
    if not thin.any():
        return planes
    valid_planes: Floats = planes.copy()
    valid_planes[thin] = 0.0
    return valid_planes
