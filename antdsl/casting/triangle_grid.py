"""Triangles in the cubes of a regular grid: the first that a short ray meets, and the nearest within some cells, in float64.

A ray visits the cubes along it (J. Amanatides, A. Woo, A Fast Voxel Traversal Algorithm for Ray Tracing, Eurographics 1987), a
place those around it, ring by ring; every face listed there is measured as `Faces` measures one. So the answer is that of all
faces, the least distance and then the least number, whatever the cubes are: they only say which faces need not be asked.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.casting import grid_rays, nearest_faces
from antdsl.casting.distance_grid import cell_width, sides_and_area
from antdsl.casting.faces import Faces
from antdsl.casting.rasterise import triangle_cells
from antdsl.casting.tolerances import LONGEST, RINGS
from antdsl.numerics import parallel, stored_tables
from antdsl.numerics.vector_rows import dot

Floats = NDArray[np.float64]
Index = NDArray[np.int64]
Singles = NDArray[np.float32]
Columns = tuple[Singles, Singles, Singles]
Arrays = tuple[NDArray[Any], ...]
Tables = tuple[Floats, Index, NDArray[np.int32], NDArray[np.int32], Singles, Floats, Floats, Floats]

_FACE_EDGES = 1.0  # cube's edge, in mean edges of faces
_CELLS = 400_000
_LISTED = 4_000_000  # faces in cubes, one in several counted as often
_CROWDED = 48.0  # faces in the cube of a face, on average: from there on a tree asks about fewer
_RAYS = 128  # rays or places for which a thread pays
_MARGIN = 1e-6  # cubes: further than rounding and `CLOSED` move a place off a face
_THIN = 1e-8  # sine of the corner of a face, below which its plane is noise and rays go through it


class TriangleGrid:
    """A grid of all faces. `tables`: lowest corner, edge, error of a bound, hair and origin (mm, float64[9]); cubes along each
    axis, int64[3]; where the faces of each cube begin and their numbers, int32; of each of these, side by side, its plane and a
    ball around it, float32[e,8]; planes (m, 3, 4), corners (m, 3, 3) and unit normals (m, 3) of all faces."""

    def __init__(self, faces: Faces, planes: Floats, width: float, origin: Floats, lasting: bool = True) -> None:
        corners = faces.corners
        low = corners.min(axis=(0, 1)) - width / 4
        size = np.floor((corners.max(axis=(0, 1)) + width / 4 - low) / width).astype(np.int64) + 1
        work, count = partial(_lists, corners, low, size, width), len(corners) if lasting else 0
        lists = stored_tables.stored("triangle grid", count, (corners, width), work)
        first, listed = lists["first"], lists["listed"]
        normals = faces.normal(np.arange(len(corners)))
        off = 1e-6 * (float(np.abs(corners).max()) + (LONGEST + RINGS) * width)  # several times what float32 makes of it
        self._hair = faces.hair
        self.tables: Tables = (
            np.array([*low, width, off, faces.hair, *origin]),  # the grid's lowest corner and the world's place of its zero
            size,
            first,
            listed,
            _bounds(corners, normals)[listed],
            np.ascontiguousarray(_sound(corners, planes)),
            np.ascontiguousarray(corners),
            normals,
        )
        many = np.diff(first).astype(np.float64)
        self.crowded = float((many * many).sum() / max(many.sum(), 1.0))

    @staticmethod
    def of(faces: Faces, origin: Floats, lasting: bool = True) -> TriangleGrid | None:
        """A grid where one is of use and not too large: its size is reckoned before anything is allocated. `origin`: where in the
        world the faces' zero is; `lasting`: whether another run may ask for the same faces."""
        tables = faces.tables()
        width = None if tables is None else _width(faces.corners)
        if tables is None or width is None:
            return None
        grid = TriangleGrid(faces, tables[0], width, origin, lasting)
        return grid if grid.crowded <= _CROWDED else None

    # ---- rays

    def first(self, origin: Floats, way: Floats, threads: int = 1) -> tuple[Floats, Index]:
        """The first face that rays from `origin` [n,3] meet within their `way` [n,3], after what part of it, but not within a
        hair of their start. NOTHING where there is none, FURTHER for rays that are too long."""
        t, face = np.empty(len(origin)), np.empty(len(origin), np.int64)
        work = partial(grid_rays.firsts, self.tables, origin, way, t, face)
        parallel.in_parts(work, len(origin), threads, _RAYS)
        return t, face

    def faced(
        self, origin: Floats, way: Floats, normals: Floats, named: Index, threads: int = 1
    ) -> tuple[tuple[Index, Floats, Floats], int]:
        """Of rays from places in the world those that `first` finds a face for: their numbers, ascending, after what part of
        their way, and the normal (3, k), of those of (3, m) which each face has by its `named` number; and for how many the grid
        cannot tell."""
        which, found = np.empty(len(origin), np.int64), np.empty((4, len(origin)))
        work = partial(grid_rays.faced, self.tables, origin, way, normals, named, which, found)
        parts = parallel.in_parts(work, len(origin), threads, _RAYS)
        which, found = parallel.joined(parts, which, found)
        return (which, found[0], found[1:]), sum([left for _, _, left in parts])

    def feelers(self, place: Columns, direction: Columns, reach: Singles) -> tuple[Singles, int]:
        """What feelers touch that are as long as `reach`, from places along unit directions, float32 columns in the world:
        distance (inf = nothing, NaN for who has to ask elsewhere) and unit normal towards the asker, float32[4,n]; and how many
        have to."""
        found = np.empty((4, len(reach)), np.float32)
        return found, grid_rays.feelers(self.tables, _plain(*place, *direction, reach), found)

    def felt(self, places: Arrays, asking: NDArray[np.bool_], ways: Arrays, found: Arrays, threads: int = 1) -> int:
        """As `feelers`, for those of n places (x y z and how far these have no face) who are `asking`, along `ways` of any
        length, the last of which is how far they reach; into `found` (whether, distance, normal x y z) of those who touch
        something or have to ask elsewhere."""
        work = partial(grid_rays.felt, self.tables, places, asking, ways, found)
        return sum(parallel.in_parts(work, len(asking), threads))

    # ---- nearest faces

    def apart(self, place: Columns, threads: int = 1) -> tuple[Singles, int]:
        """How far (mm) places are out of the faces, below 0 behind the nearest, NaN for who has to ask elsewhere, and the unit
        way out, float32[4,n]; and how many have to."""
        found = np.empty((4, len(place[0])), np.float32)
        work = partial(nearest_faces.apart, self.tables, _plain(*place), found)
        return found, sum(parallel.in_parts(work, len(place[0]), threads, _RAYS))

    def nearest(self, points: Floats) -> tuple[Floats, Floats, Index]:
        """The place nearest to each point [n,3], its square distance and its face; FURTHER where none is near enough to tell."""
        place, square, face = np.empty((len(points), 3)), np.empty(len(points)), np.empty(len(points), np.int64)
        nearest_faces.nearests(self.tables, points, place, square, face)
        return place, square, face


def _plain(*columns: Singles) -> tuple[Singles, ...]:
    """The same in one piece."""
    return tuple([np.ascontiguousarray(each) for each in columns])


def _lists(corners: Floats, low: Floats, size: Index, width: float) -> stored_tables.Tables:
    """Where the faces of each cube begin, and their numbers, of a grid of so many cubes from its lowest corner on."""
    count, keys = len(corners), [np.empty(0, np.int64)]
    for cell, face in triangle_cells((corners - low) / width, margin=_MARGIN):
        cell = np.minimum(np.maximum(cell, 0), size - 1)
        keys.append(((cell[:, 0] * size[1] + cell[:, 1]) * size[2] + cell[:, 2]) * count + face)
    cells, listed = np.divmod(np.unique(np.concatenate(keys)), count)
    first = np.zeros(int(np.prod(size)) + 1, np.int32)
    np.cumsum(np.bincount(cells, minlength=len(first) - 1), out=first[1:])
    return {"first": first, "listed": listed.astype(np.int32)}


def _width(corners: Floats) -> float | None:
    """The edge of cubes (mm): about that of the faces, larger where there would be too many cubes or faces in them."""
    if not len(corners):
        return None
    lengths, area = sides_and_area(corners)
    around = lengths.sum()
    extent = corners.max(axis=(0, 1)) - corners.min(axis=(0, 1))
    width = max(float(lengths.mean()) * _FACE_EDGES, cell_width(extent, _CELLS))
    if not 0 < width < np.inf:
        return None
    # A face touches cubes by its area, its sides and its corners.
    for _ in range(40):
        if 3 * area / width**2 + 2 * around / width + 8.0 * len(corners) <= _LISTED:
            return width
        width *= 1.25
    return None


def _bounds(corners: Floats, normals: Floats) -> Singles:
    """Planes (unit normal and -distance from the origin) and balls (middle, in the plane, and radius) of faces, float32[m,8]."""
    plane = np.concatenate([normals, -dot(normals, corners[:, 0])[:, None]], axis=1)
    middle = (corners[:, 0] + corners[:, 1] + corners[:, 2]) / 3.0
    away = corners - middle[:, None]
    radius = np.sqrt(((away[:, :, 0] ** 2 + away[:, :, 1] ** 2) + away[:, :, 2] ** 2).max(axis=1))
    return np.concatenate([plane, middle, radius[:, None]], axis=1).astype(np.float32)


def _sound(corners: Floats, planes: Floats) -> Floats:
    """Planes [m,3,4], all zero of faces that are too thin to have one."""
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    size = dot(planes[:, 0, :3], planes[:, 0, :3])
    thin = ~(size > _THIN * _THIN * (dot(one, one) * dot(two, two)))
    if not thin.any():
        return planes
    sound: Floats = planes.copy()
    sound[thin] = 0.0
    return sound
